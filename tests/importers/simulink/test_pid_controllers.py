"""PID controllers in all their forms, against recurrences written out and solutions of scipy."""

import itertools

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

RNG = np.random.default_rng(23)
COUNT, T = 60, 0.1
E = np.cumsum(RNG.normal(size=COUNT)) / 3
TR = np.sin(np.arange(COUNT) / 5)
RESET = np.array([0.0, 0, 1, 1, 0, 0, 0, 0, 0, 1] * 6)
GAINS = {"P": 1.5, "I": 2.0, "D": 0.3, "N": 4.0}
WRITTEN = {"P": "1.5", "I": "2", "D": "0.3", "N": "4"}


def drawn_as(inputs=1, kind="PID 1dof", solver="FixedStepDiscrete", **parameters):
    domain = "Discrete-time" if solver == "FixedStepDiscrete" else "Continuous-time"
    return alone("Reference", inputs, special=kind, model=Model(solver=solver, step="0.1"), TimeDomain=domain,
                 **WRITTEN, **parameters)  # fmt: skip


def simulated(
    e, parts="PID", form="Parallel", windup="none", limits=(-np.inf, np.inf), within=(-np.inf, np.inf), tracked=None,
    reset=None, kb=3.0, kt=0.7, start=(0.0, 0.0), weights=None, gains=None,
):  # fmt: skip
    """Forward Euler for the integral and the filter, step by step."""
    g = gains or GAINS
    x, f = start
    y = np.empty(len(e))
    ep, ei, ed = weights if weights is not None else (e, e, e)
    for k in range(len(e)):
        if reset is not None and k and reset[k - 1] <= 0 < reset[k]:
            x, f = start
        slope = g["N"] * (g["D"] * ed[k] - f) if "D" in parts else 0.0
        p = (ep[k] if form == "Ideal" else g["P"] * ep[k]) if "P" in parts else 0.0
        before = (p + (x if "I" in parts else 0.0)) + slope
        before = g["P"] * before if form == "Ideal" else before
        y[k] = np.clip(before, *limits)
        inner = g["I"] * ei[k] + (kt * (tracked[k] - y[k]) if tracked is not None else 0.0)
        if windup == "back-calculation":
            inner += kb * (y[k] - before)
        elif windup == "clamping" and before != y[k] and (inner > 0) == ((before - y[k]) * (
            g["P"] if form == "Ideal" else 1.0) > 0):  # fmt: skip
            inner = 0.0
        x = np.clip(x + T * inner, *within)
        f += T * slope
    return y


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_controller(layout, tmp_path):
    output = run(imported(drawn_as(), tmp_path, layout), {"u1": E})["y1"]
    np.testing.assert_allclose(output, simulated(E), rtol=1e-12, atol=1e-12)


LIMITS = {"LimitOutput": "on", "UpperSaturationLimit": "1.5", "LowerSaturationLimit": "-1", "Kb": "3"}


@pytest.mark.parametrize(
    ("parts", "form", "windup"),
    list(
        itertools.product(
            ["PID", "PI", "PD", "P", "I"], ["Parallel", "Ideal"], ["none", "back-calculation", "clamping"]
        )
    ),
)
def test_limits_and_anti_windup_follow_the_simulation(parts, form, windup, tmp_path):
    form = "Parallel" if parts == "I" else form
    drawn = drawn_as(Controller=parts, Form=form, AntiWindupMode=windup, InitialConditionForIntegrator="0.5", **LIMITS)
    output = run(imported(drawn, tmp_path), {"u1": E})["y1"]
    expected = simulated(E, parts, form, windup, (-1, 1.5), start=(0.5, 0.0))
    np.testing.assert_allclose(output, expected, rtol=1e-11, atol=1e-11)
    assert output.max() == 1.5 or output.min() == -1


def test_clamping_in_the_ideal_form_goes_by_the_sign_of_the_gain(tmp_path):
    drawn = drawn_as(Form="Ideal", AntiWindupMode="clamping", **LIMITS)
    model = imported(drawn, tmp_path, parameters=[{"B:P": -1.5}])
    output = run(model, {"u1": E})["y1"]
    expected = simulated(E, form="Ideal", windup="clamping", limits=(-1, 1.5), gains=GAINS | {"P": -1.5})
    np.testing.assert_allclose(output, expected, rtol=1e-11, atol=1e-11)


def test_a_controller_tracks_a_signal(tmp_path):
    drawn = drawn_as(2, TrackingMode="on", Kt="0.7")
    output = run(imported(drawn, tmp_path), {"u1": E, "u2": TR})["y1"]
    np.testing.assert_allclose(output, simulated(E, tracked=TR), rtol=1e-11, atol=1e-11)


def test_the_signal_that_is_tracked_may_come_from_the_output(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("e")
    drawn.link("B", "simulink/Discrete/Discrete PID Controller", "PID 1dof", ports=(2, 1), Controller="PI", P="1.5",
               I="2", TimeDomain="Discrete-time", TrackingMode="on", Kt="0.7")  # fmt: skip
    drawn.block("Saturate", "S", UpperLimit="1", LowerLimit="-1")
    drawn.outport("y")
    drawn.line("e", "B:1")
    drawn.chain("B", "S")
    drawn.line("S", "y", "B:2")
    output = run(imported(drawn, tmp_path), {"e": E})["y"]
    x = 0.0
    for k in range(COUNT):
        u = 1.5 * E[k] + x
        assert output[k] == pytest.approx(np.clip(u, -1, 1), abs=1e-11), k
        x += T * (2 * E[k] + 0.7 * (np.clip(u, -1, 1) - u))


def test_a_controller_is_reset_and_its_integral_limited(tmp_path):
    drawn = drawn_as(2, ExternalReset="rising", InitialConditionForIntegrator="0.5", InitialConditionForFilter="-0.2",
                     LimitIntegrator="on", UpperIntegratorSaturationLimit="0.8",
                     LowerIntegratorSaturationLimit="-0.8")  # fmt: skip
    output = run(imported(drawn, tmp_path), {"u1": E, "u2": RESET})["y1"]
    expected = simulated(E, reset=RESET, start=(0.5, -0.2), within=(-0.8, 0.8))
    np.testing.assert_allclose(output, expected, rtol=1e-11, atol=1e-11)


def test_a_reset_of_an_unfiltered_derivative_is_one_of_its_last_input(tmp_path):
    drawn = drawn_as(2, Controller="PD", ExternalReset="rising", UseFilter="off", DifferentiatorICPrevScaledInput="0.4")
    output = run(imported(drawn, tmp_path), {"u1": E, "u2": RESET})["y1"]
    before = 0.4
    for k, e in enumerate(E):
        before = 0.4 if k > 0 and RESET[k - 1] <= 0 < RESET[k] else before
        scaled = GAINS["D"] * e / T
        assert output[k] == pytest.approx(GAINS["P"] * e + scaled - before, abs=1e-11), k
        before = scaled


@pytest.mark.parametrize("method", ["Backward Euler", "Trapezoidal"])
def test_a_reset_of_a_controller_is_one_of_the_state_of_its_integral(method, tmp_path):
    drawn = drawn_as(2, Controller="PI", ExternalReset="rising", InitialConditionForIntegrator="0.5",
                     IntegratorMethod=method)  # fmt: skip
    output = run(imported(drawn, tmp_path), {"u1": E, "u2": RESET})["y1"]
    share, x = 0.5 if method == "Trapezoidal" else 1.0, 0.5
    for k, e in enumerate(E):
        x = 0.5 if k > 0 and RESET[k - 1] <= 0 < RESET[k] else x
        integral = x + share * T * GAINS["I"] * e
        assert output[k] == pytest.approx(GAINS["P"] * e + integral, abs=1e-11), k
        x = integral + (1 - share) * T * GAINS["I"] * e


def test_initial_values_and_gains_may_be_inputs(tmp_path):
    drawn = drawn_as(3, InitialConditionSource="external")
    one = np.ones(COUNT)
    output = run(imported(drawn, tmp_path), {"u1": E, "u2": 0.5 * one, "u3": -0.2 * one})["y1"]
    np.testing.assert_allclose(output, simulated(E, start=(0.5, -0.2)), rtol=1e-11, atol=1e-11)
    drawn = drawn_as(5, ControllerParametersSource="external")
    columns = {f"u{at}": GAINS[name] * one for at, name in enumerate("PIDN", 2)}
    output = run(imported(drawn, tmp_path), {"u1": E, **columns})["y1"]
    np.testing.assert_allclose(output, simulated(E), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("form", ["Parallel", "Ideal"])
def test_a_controller_of_two_degrees_of_freedom_weights_the_set_point(form, tmp_path):
    r, y = E, TR
    drawn = drawn_as(2, "PID 2dof", b="0.6", c="0.2", Form=form, AntiWindupMode="clamping", **LIMITS)
    output = run(imported(drawn, tmp_path), {"u1": r, "u2": y})["y1"]
    weights = (0.6 * r - y, r - y, 0.2 * r - y)
    expected = simulated(r, form=form, windup="clamping", limits=(-1, 1.5), weights=weights)
    np.testing.assert_allclose(output, expected, rtol=1e-11, atol=1e-11)


FILTERS = {
    "Forward Euler": ([4.0, -4.0], [1.0, 4 * T - 1]),
    "Backward Euler": ([4.0, -4.0], [1 + 4 * T, -1.0]),
    "Trapezoidal": ([4.0, -4.0], [1 + 4 * T / 2, 4 * T / 2 - 1]),
}
SUMS = {
    "Forward Euler": ([0, T], [1, -1]),
    "Backward Euler": ([T, 0], [1, -1]),
    "Trapezoidal": ([T / 2, T / 2], [1, -1]),
}


@pytest.mark.parametrize("sums", SUMS)
@pytest.mark.parametrize("filters", FILTERS)
def test_methods_of_integral_and_filter_are_transfer_functions(sums, filters, tmp_path):
    output = run(imported(drawn_as(IntegratorMethod=sums, FilterMethod=filters), tmp_path), {"u1": E})["y1"]
    expected = 1.5 * E + 2 * scipy.signal.lfilter(*SUMS[sums], E) + 0.3 * scipy.signal.lfilter(*FILTERS[filters], E)
    np.testing.assert_allclose(output, expected, rtol=1e-11, atol=1e-11)


def test_a_derivative_without_a_filter_is_a_difference(tmp_path):
    drawn = drawn_as(Controller="PD", UseFilter="off", DifferentiatorICPrevScaledInput="0.4")
    output = run(imported(drawn, tmp_path), {"u1": E})["y1"]
    scaled = 0.3 * E / T
    np.testing.assert_allclose(output, 1.5 * E + scaled - np.concatenate([[0.4], scaled[:-1]]), rtol=1e-11, atol=1e-11)


def test_a_discrete_controller_runs_at_its_sample_time(tmp_path):
    output = run(imported(drawn_as(Controller="I", SampleTime="0.2"), tmp_path), {"u1": E})["y1"]
    sums = np.concatenate([[0.0], np.cumsum(2 * 0.2 * E[::2])[:-1]])
    np.testing.assert_allclose(output, np.repeat(sums, 2), rtol=1e-11, atol=1e-11)


def test_a_continuous_controller_ignores_the_sample_time_of_a_discrete_one(tmp_path):
    drawn = drawn_as(solver="ode5", SampleTime="0.5")
    output = run(imported(drawn, tmp_path), {"u1": np.ones(COUNT)})["y1"]
    t = T * np.arange(COUNT)
    np.testing.assert_allclose(output, 1.5 + 2 * t + 0.3 * 4 * np.exp(-4 * t), rtol=1e-4)


@pytest.mark.parametrize("windup", ["none", "back-calculation", "clamping"])
def test_a_continuous_controller_has_limits_and_a_reset(windup, tmp_path):
    drawn = drawn_as(2, solver="ode1", AntiWindupMode=windup, ExternalReset="rising", **LIMITS)
    output = run(imported(drawn, tmp_path), {"u1": E, "u2": RESET})["y1"]
    expected = simulated(E, windup=windup, limits=(-1, 1.5), reset=RESET)
    np.testing.assert_allclose(output, expected, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("windup", ["none", "back-calculation", "clamping"])
@pytest.mark.parametrize("name", ["Kp", "Ki", "Kd"])
def test_slopes_with_respect_to_the_gains(windup, name, tmp_path):
    drawn = alone("Reference", special="PID 1dof", TimeDomain="Discrete-time", P="Kp", I="Ki", D="Kd", N="4",
                  AntiWindupMode=windup, **LIMITS)  # fmt: skip
    model = imported(drawn, tmp_path, parameters=[{"Kp": 1.5, "Ki": 2.0, "Kd": 0.3}])
    exact, differences = slopes(model, {"u1": E}, name, "y1")
    np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-7)
    assert np.abs(exact).max() > 0.05


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"IntegratorMethod": "Backward Euler", "AntiWindupMode": "clamping", **LIMITS}, "form an algebraic loop"),
        ({"IntegratorMethod": "Trapezoidal", "TrackingMode": "on"}, "Use Forward Euler for the integrator"),
        ({"SatLimitsSource": "external"}, "SatLimitsSource 'external'"),
        ({"FilterMethod": "Trapezoidal", "InitialConditionForFilter": "1"}, "its derivative has an initial value"),
    ],
)
def test_unsupported_controllers_are_refused_with_the_reason(parameters, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        imported(drawn_as(2, **parameters), tmp_path)


def test_the_old_controllers_of_the_extras(tmp_path):
    t = 0.1 * np.arange(COUNT)
    drawn = alone(
        "Reference", special="PID Controller", model=Model(solver="ode4", step="0.1"), P="1.5", I="2", D="0.3"
    )
    output = run(imported(drawn, tmp_path), {"u1": E})["y1"]
    integral = np.concatenate([[0.0], np.cumsum(E * T)[:-1]])
    slope = np.concatenate([[0.0], np.diff(E) / T])
    np.testing.assert_allclose(output, 1.5 * E + 2 * integral + 0.3 * slope, rtol=1e-10, atol=1e-10)
    drawn = alone("Reference", special="PID(2) Controller", model=Model(solver="ode5", step="0.1"), **WRITTEN)
    drawn.blocks[0].parameters["SourceBlock"] = (
        "simulink_extras/Additional\nLinear/PID Controller\n(with Approximate\nDerivative)"
    )
    output = run(imported(drawn, tmp_path), {"u1": np.ones(COUNT)})["y1"]
    np.testing.assert_allclose(output, 1.5 + 2 * t + 0.3 * 4 * np.exp(-4 * t), rtol=1e-4)


@pytest.mark.parametrize(("domain", "continuous"), [("Discrete-time", False), ("Continuous-time", True)])
def test_a_controller_states_whether_a_solver_advances_it(domain, continuous, tmp_path):
    drawn = alone("Reference", special="PID 1dof", model=Model(solver="ode45", step="auto"), TimeDomain=domain,
                  SampleTime="0.1" if not continuous else "-1", **WRITTEN)  # fmt: skip
    report = import_simulink(drawn.write(tmp_path)).report
    assert any("ode45 -> ode4" in line for line in report.substitutions) is continuous
    assert imported(drawn, tmp_path).stepped is continuous


def test_the_initial_output_is_the_state_of_an_explicit_method(tmp_path):
    settings = {"InitialConditionSetting": "Output", "InitialConditionForIntegrator": "0.4"}
    output = run(imported(drawn_as(**settings), tmp_path), {"u1": E})["y1"]
    np.testing.assert_allclose(output, simulated(E, start=(0.4, 0.0)), rtol=1e-12, atol=1e-12)
    with pytest.raises(InputError, match="InitialConditionSetting 'Output' is only supported with the method Forward"):
        imported(drawn_as(IntegratorMethod="Trapezoidal", **settings), tmp_path)
