"""Discrete filters, against those of scipy.signal and recurrences written out."""

import numpy as np
import pytest
import scipy

from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

U = np.random.default_rng(3).normal(size=40)
T = 0.1


def first(kind, folder, **parameters):
    return run(imported(alone(kind, **parameters), folder), {"u1": U})["y1"]


@pytest.mark.parametrize(
    ("b", "a"), [([1.0], [1.0, 0.5]), ([0.2, 0.3], [1.0, -0.9, 0.3]), ([0.5, 0.1, 0.2], [2.0, -0.9, 0.3])]
)
def test_discrete_filters_are_those_of_scipy(b, a, tmp_path):
    written = {"Numerator": str(b), "Denominator": str(a)}
    padded = [0.0] * (len(a) - len(b)) + b
    np.testing.assert_allclose(first("DiscreteFilter", tmp_path, **written), scipy.signal.lfilter(b, a, U), atol=1e-13)
    output = first("DiscreteTransferFcn", tmp_path, **written)
    np.testing.assert_allclose(output, scipy.signal.lfilter(padded, a, U), atol=1e-13)


@pytest.mark.parametrize("kind", ["TransferFcn", "DiscreteTransferFcn"])
def test_a_lag_with_a_named_time_constant_feeds_nothing_through(kind, tmp_path):
    drawn = Model(step="0.1", solver="ode1")
    drawn.inport("u")
    drawn.block(kind, "Lag", ports=(1, 1), Numerator="[1]", Denominator="[tau 1]")
    drawn.block("Sum", "S", ports=(2, 1), Inputs="+-")
    drawn.outport("y")
    drawn.line("u", "S:1")
    drawn.chain("S", "Lag", "S:2")
    drawn.line("Lag", "y")
    model = imported(drawn, tmp_path, parameters=[{"tau": 2.0}])
    output, y = run(model, {"u": U})["y"], 0.0
    for k, u in enumerate(U):
        assert output[k] == pytest.approx(y, abs=1e-12)
        y = y + T * (u - 2 * y) / 2 if kind == "TransferFcn" else (u - 2 * y) / 2
    exact, differences = slopes(model, {"u": U}, "tau", "y")
    np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-8)


def test_a_fir_filter(tmp_path):
    output = first("DiscreteFir", tmp_path, Coefficients="[0.5 0.25 -1]")
    np.testing.assert_allclose(output, scipy.signal.lfilter([0.5, 0.25, -1], [1.0], U), atol=1e-13)


@pytest.mark.parametrize("kind", ["DiscreteFilter", "DiscreteTransferFcn"])
def test_the_states_of_a_filter_are_those_behind_its_leading_coefficient(kind, tmp_path):
    b, a = [0.5, 0.1, 0.2], [2.0, -0.9, 0.3]
    model = imported(alone(kind, Numerator=str(b), Denominator=str(a), InitialStates="[s 3]"), tmp_path,
                     parameters=[{"s": -1.5}])  # fmt: skip
    output = run(model, {"u1": U})["y1"]
    states = [-1.5, 3.0]
    for k, u in enumerate(U):
        w = (u - a[1] * states[0] - a[2] * states[1]) / a[0]
        assert output[k] == pytest.approx(b[0] * w + b[1] * states[0] + b[2] * states[1], abs=1e-13), k
        states = [w, states[0]]
    exact, differences = slopes(model, {"u1": U}, "s", "y1")
    np.testing.assert_allclose(exact, differences, atol=1e-9)


def test_structures_are_the_same_filter_from_rest(tmp_path):
    b, a = [0.5, 0.1, 0.2], [2.0, -0.9, 0.3]
    expected = scipy.signal.lfilter(b, a, U)
    for structure in ("Direct form I", "Direct form I transposed", "Direct form II", "Direct form II transposed"):
        drawn = alone("DiscreteFilter", Numerator=str(b), Denominator=str(a), FilterStructure=structure)
        np.testing.assert_allclose(run(imported(drawn, tmp_path), {"u1": U})["y1"], expected, atol=1e-13)
