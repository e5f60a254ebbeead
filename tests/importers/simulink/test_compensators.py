"""Zeros and poles, lead and lag, moving averages and sample times, against scipy.signal and closed forms."""

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

RNG = np.random.default_rng(29)
COUNT, T = 50, 0.1
U = RNG.normal(size=COUNT)

FORMS = [([], [-2.0], 3.0), ([-1.0], [-2.0, -0.5], 1.5), ([0.5], [-1.0], -2.0), ([], [], 4.0), ([-1, -3], [0, -1], 1)]


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl"]))
@pytest.mark.parametrize(("zeros", "poles", "gain"), FORMS)
def test_zeros_and_poles_are_those_of_scipy(zeros, poles, gain, layout, tmp_path):
    drawn = alone(
        "ZeroPole", Zeros=str(zeros), Poles=str(poles), Gain=str(gain), model=Model(solver="ode5", step="0.02")
    )
    output = run(imported(drawn, tmp_path, layout), {"u1": np.ones(100)})["y1"]
    expected = np.full(100, gain) if not poles else scipy.signal.step((zeros, poles, gain), T=0.02 * np.arange(100))[1]
    np.testing.assert_allclose(output, expected, atol=2e-7)


@pytest.mark.parametrize(("zeros", "poles", "gain"), [([], [0.8], 3.0), ([-0.5], [0.2, 0.9], 1.5), ([0.5], [0.1], 2.0)])
def test_discrete_zeros_and_poles_are_those_of_scipy(zeros, poles, gain, tmp_path):
    drawn = alone("DiscreteZeroPole", Zeros=str(zeros), Poles=str(poles), Gain=str(gain), SampleTime="0.1")
    output = run(imported(drawn, tmp_path), {"u1": U})["y1"]
    b, a = scipy.signal.zpk2tf(zeros, poles, gain)
    padded = np.concatenate([np.zeros(len(a) - len(np.atleast_1d(b))), np.atleast_1d(b)])
    np.testing.assert_allclose(output, scipy.signal.lfilter(padded, a, U), atol=1e-12)


def test_slopes_with_respect_to_poles(tmp_path):
    drawn = alone("ZeroPole", Zeros="z", Poles="[p -1]", Gain="k", model=Model(solver="ode4", step="0.1"))
    model = imported(drawn, tmp_path, parameters=[{"z": -2.0, "p": -0.5, "k": 1.5}])
    for name in ("z", "p", "k"):
        exact, differences = slopes(model, {"u1": U}, name, "y1")
        np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-8)
        assert np.abs(exact).max() > 0.01


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"Zeros": "[1 2 3]"}, "it has more zeros \\(3\\) than poles"),
        ({"Poles": "[-1+2i -1-2i]"}, "complex numbers are not supported"),
        ({"Zeros": "[1 2; 3 4]"}, "its Zeros are a matrix"),
    ],
)
def test_unsupported_zeros_and_poles_are_refused_with_the_reason(parameters, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        imported(alone("ZeroPole", model=Model(solver="ode4"), **parameters), tmp_path)


def linked(kind, folder, **parameters):
    return run(imported(alone("Reference", special=kind, **parameters), folder), {"u1": U})["y1"]


def test_lead_and_lag_and_real_zeros(tmp_path):
    output = linked("Lead or Lag Compensator", tmp_path, PoleZ="0.8", ZeroZ="0.3")
    np.testing.assert_allclose(output, scipy.signal.lfilter([1, -0.3], [1, -0.8], U), atol=1e-12)
    output = linked("Transfer Fcn Lead or Lag", tmp_path, PoleZ="0.8", ZeroZ="0.3", ICPrevOutput="2", ICPrevInput="1")
    state = scipy.signal.lfiltic([1, -0.3], [1, -0.8], [2.0], [1.0])
    np.testing.assert_allclose(output, scipy.signal.lfilter([1, -0.3], [1, -0.8], U, zi=state)[0], atol=1e-12)
    output = linked("Transfer Fcn Real Zero", tmp_path, ZeroZ="0.3", ICPrevInput="1")
    np.testing.assert_allclose(output, U - 0.3 * np.concatenate([[1.0], U[:-1]]), atol=1e-12)


def test_a_moving_average_has_weights(tmp_path):
    output = linked("Weighted Moving Average", tmp_path, mgainval="[0.5 0.3 0.2]")
    np.testing.assert_allclose(output, scipy.signal.lfilter([0.5, 0.3, 0.2], [1], U), atol=1e-12)


@pytest.mark.parametrize(
    ("operation", "expected"),
    [("+", U + 0.3), ("-", U - 0.3), ("*", U * 0.3), ("/", U / 0.3), ("Ts Only", 0.3), ("1/Ts Only", 1 / 0.3)],
)
def test_the_sample_time_in_sums_and_products(operation, expected, tmp_path):
    drawn = alone("SampleTimeMath", TsampMathOp=operation, weightValue="3")
    output = run(imported(drawn, tmp_path), {"u1": U})["y1"]
    np.testing.assert_allclose(output, np.broadcast_to(expected, COUNT), rtol=1e-12)


def test_the_sample_time_is_that_of_the_block(tmp_path):
    drawn = alone("SampleTimeMath", TsampMathOp="*", SampleTime="0.2")
    output = run(imported(drawn, tmp_path), {"u1": U})["y1"]
    np.testing.assert_allclose(output, np.repeat(0.2 * U[::2], 2), rtol=1e-12)


def test_two_integrals_at_once(tmp_path):
    drawn = alone("SecondOrderIntegrator", 1, 2, ICX="1", ICDXDT="-0.5", model=Model(solver="ode4", step="0.1"))
    outputs = run(imported(drawn, tmp_path), {"u1": np.full(COUNT, 2.0)})
    t = T * np.arange(COUNT)
    np.testing.assert_allclose(outputs["y1"], 1 - 0.5 * t + t**2, rtol=1e-10)
    np.testing.assert_allclose(outputs["y2"], -0.5 + 2 * t, rtol=1e-10)
    with pytest.raises(InputError, match="LimitX 'on'"):
        imported(alone("SecondOrderIntegrator", 1, 2, LimitX="on", model=Model(solver="ode4")), tmp_path)
