"""Blocks with memory, against recurrences written out, scipy.signal and closed forms."""

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import alone, crossings, imported, run, slopes, switch_case

RNG = np.random.default_rng(3)
U = RNG.normal(size=40)
T = 0.1


def first(kind, folder, **parameters):
    return run(imported(alone(kind, **parameters), folder), {"u1": U})["y1"]


def test_a_unit_delay_starts_at_its_initial_value(tmp_path):
    output = first("UnitDelay", tmp_path, InitialCondition="3", SampleTime="0.1")
    np.testing.assert_array_equal(output, [3, *U[:-1]])


def test_a_delay_of_several_steps_has_one_or_several_initial_values(tmp_path):
    np.testing.assert_array_equal(first("Delay", tmp_path), [0, 0, *U[:-2]])
    output = first("Delay", tmp_path, DelayLength="3", InitialCondition="[7 8 9]")
    np.testing.assert_array_equal(output, [7, 8, 9, *U[:-3]])
    np.testing.assert_array_equal(first("Delay", tmp_path, DelayLength="0"), U)


def test_a_slower_delay_counts_its_own_hits(tmp_path):
    output = first("Delay", tmp_path, DelayLength="2", InitialCondition="5", SampleTime="0.2")
    hits = U[::2]
    np.testing.assert_array_equal(output, np.repeat([5, 5, *hits[:-2]], 2))


def test_a_zero_order_hold_keeps_the_value_of_the_last_hit(tmp_path):
    output = first("ZeroOrderHold", tmp_path, SampleTime="0.3")
    np.testing.assert_array_equal(output, np.repeat(U[::3], 3)[: U.size])
    output = first("ZeroOrderHold", tmp_path, SampleTime="[0.3 0.1]")
    np.testing.assert_array_equal(output[1:], np.repeat(U[1::3], 3)[: U.size - 1])


def test_a_slow_block_holds_its_output(tmp_path):
    output = first("Gain", tmp_path, Gain="2", SampleTime="0.4")
    np.testing.assert_array_equal(output, 2 * np.repeat(U[::4], 4)[: U.size])


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        ("Forward Euler", lambda: np.concatenate([[1.0], 1 + 2 * T * np.cumsum(U)[:-1]])),
        ("Backward Euler", lambda: 1 + 2 * T * np.cumsum(U)),
        ("Trapezoidal", lambda: 1 + T * (np.cumsum(U) + np.concatenate([[0.0], np.cumsum(U)[:-1]]))),
    ],
)
def test_discrete_integration(method, expected, tmp_path):
    output = first("DiscreteIntegrator", tmp_path, gainval="2", InitialCondition="1", SampleTime="0.1",
                  IntegratorMethod=f"Integration: {method}",
                  InitialConditionSetting="State (most efficient)")  # fmt: skip
    np.testing.assert_allclose(output, expected(), rtol=1e-13, atol=1e-13)


def test_a_discrete_integrator_may_begin_with_its_output_at_the_initial_value(tmp_path):
    output = first("DiscreteIntegrator", tmp_path, InitialCondition="1", SampleTime="0.1",
                  IntegratorMethod="Integration: Backward Euler", InitialConditionSetting="Output")  # fmt: skip
    np.testing.assert_allclose(output, np.concatenate([[1.0], 1 + T * np.cumsum(U[1:])]), rtol=1e-13)


def test_a_discrete_integrator_accumulates_at_its_own_sample_time(tmp_path):
    output = first("DiscreteIntegrator", tmp_path, SampleTime="0.2", IntegratorMethod="Accumulation: Forward Euler")
    np.testing.assert_allclose(output, np.repeat(np.concatenate([[0.0], np.cumsum(U[::2])[:-1]]), 2))
    output = first("DiscreteIntegrator", tmp_path, SampleTime="0.2", IntegratorMethod="Integration: Forward Euler")
    np.testing.assert_allclose(output, np.repeat(np.concatenate([[0.0], 0.2 * np.cumsum(U[::2])[:-1]]), 2))


def test_limits_and_resets_of_a_discrete_integrator(tmp_path):
    drawn = alone("DiscreteIntegrator", 2, SampleTime="0.1", LimitOutput="on", UpperSaturationLimit="0.25",
                  LowerSaturationLimit="-0.1", ExternalReset="rising", InitialCondition="0.05")  # fmt: skip
    trigger = np.array([0, 0, 1, 1, 0, -1, 1, 0] * 5, dtype=float)
    output = run(imported(drawn, tmp_path), {"u1": U, "u2": trigger})["y1"]
    x, before = 0.05, None
    for k, u in enumerate(U):
        if before is not None and before <= 0 < trigger[k]:
            x = 0.05
        assert output[k] == pytest.approx(x, abs=1e-14)
        x, before = np.clip(x + T * u, -0.1, 0.25), trigger[k]


@pytest.mark.parametrize("setting", ["Auto", "State (most efficient)", "Output"])
@pytest.mark.parametrize("method", ["Backward Euler", "Trapezoidal"])
def test_a_reset_is_one_of_the_state_or_of_the_output(setting, method, tmp_path):
    drawn = alone("DiscreteIntegrator", 2, SampleTime="0.1", InitialCondition="2", ExternalReset="rising",
                  IntegratorMethod=f"Integration: {method}", InitialConditionSetting=setting)  # fmt: skip
    trigger = np.array([0, 0, 1, 1, 0, -1, 1, 0] * 5, dtype=float)
    output = run(imported(drawn, tmp_path), {"u1": U, "u2": trigger})["y1"]
    share = 0.5 if method == "Trapezoidal" else 1.0
    x = 2.0
    for k, u in enumerate(U):
        anew = k > 0 and trigger[k - 1] <= 0 < trigger[k]
        x = 2.0 if anew else x
        y = 2.0 if setting == "Output" and (k == 0 or anew) else x + share * T * u
        assert output[k] == pytest.approx(y, abs=1e-13), k
        x = y + (T * u / 2 if method == "Trapezoidal" else 0.0)


def test_a_discrete_state_space_model_is_that_of_scipy(tmp_path):
    A, B, C, D = np.array([[0.5, 0.2], [-0.1, 0.9]]), np.array([[1.0], [0.5]]), np.array([[1.0, -1.0]]), 0.3
    output = first("DiscreteStateSpace", tmp_path, A="[0.5 0.2; -0.1 0.9]", B="[1; 0.5]", C="[1 -1]", D="0.3",
                  InitialCondition="[1 2]", SampleTime="0.1")  # fmt: skip
    expected = scipy.signal.dlsim((A, B, C, np.array([[D]]), T), U, x0=[1, 2])[1][:, 0]
    np.testing.assert_allclose(output, expected, atol=1e-13)


@pytest.mark.parametrize("mode", ["continuous", "inherited"])
@pytest.mark.parametrize("solver", ["FixedStepDiscrete", "ode1"])
def test_a_rate_limiter_follows_from_its_initial_value_or_from_its_first_input(mode, solver, tmp_path):
    drawn = alone("RateLimiter", model=Model(step="0.1", solver=solver), RisingSlewLimit="4", FallingSlewLimit="-2",
                  InitialCondition="3", SampleTimeMode=mode)  # fmt: skip
    if solver == "ode1":
        drawn.block("Integrator", "I", ports=(1, 1))
        drawn.outport("x")
        drawn.line("u1", "I")
        drawn.line("I", "x")
    output = run(imported(drawn, tmp_path), {"u1": U})["y1"]
    y = 3.0 if (mode, solver) == ("inherited", "FixedStepDiscrete") else U[0]
    for k, u in enumerate(U):
        y += np.clip(u - y, -2 * T, 4 * T)
        assert output[k] == pytest.approx(y, abs=1e-14)


def test_a_rate_limiter_in_continuous_time_moves_between_the_hits_of_its_input(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("ZeroOrderHold", "Z", SampleTime="0.4")
    drawn.block("RateLimiter", "L", RisingSlewLimit="4", FallingSlewLimit="-2", SampleTimeMode="continuous")
    drawn.outport("y")
    drawn.chain("u", "Z", "L", "y")
    output = run(imported(drawn, tmp_path), {"u": U})["y"]
    y = U[0]
    for k in range(U.size):
        y += np.clip(U[k - k % 4] - y, -2 * T, 4 * T)
        assert output[k] == pytest.approx(y, abs=1e-14), k


def test_a_relay_keeps_its_state_between_the_values(tmp_path):
    output = first(
        "Relay", tmp_path, OnSwitchValue="0.5", OffSwitchValue="-0.5", OnOutputValue="7", OffOutputValue="-7"
    )
    on = False
    for k, u in enumerate(U):
        on = u >= 0.5 or (on and u > -0.5)
        assert output[k] == (7 if on else -7)


def test_backlash(tmp_path):
    output = first("Backlash", tmp_path, BacklashWidth="1")
    y = 0.0
    for k, u in enumerate(U):
        y = min(max(y, u - 0.5), u + 0.5)
        assert output[k] == pytest.approx(y)


def linked(kind, folder, **parameters):
    return run(imported(alone("Reference", special=kind, **parameters), folder), {"u1": U})["y1"]


def test_discrete_blocks_of_the_library(tmp_path):
    before = np.concatenate([[0.0], U[:-1]])
    np.testing.assert_allclose(linked("Discrete Derivative", tmp_path, gainval="2"), 2 / T * (U - before), rtol=1e-12)
    np.testing.assert_allclose(linked("Difference", tmp_path), U - before)
    np.testing.assert_array_equal(linked("Detect Increase", tmp_path), before < U)
    np.testing.assert_array_equal(linked("Detect Decrease", tmp_path), before > U)
    np.testing.assert_array_equal(linked("Detect Change", tmp_path), np.ones(U.size))
    np.testing.assert_array_equal(linked("Detect Rise Positive", tmp_path), (U > 0) & (before <= 0))
    np.testing.assert_array_equal(linked("Detect Fall Negative", tmp_path), (U < 0) & ~(before < 0))
    output = linked("First Order Transfer Fcn", tmp_path, PoleZ="0.8")
    np.testing.assert_allclose(output, scipy.signal.lfilter([0.2], [1, -0.8], U), atol=1e-13)


def test_an_initial_condition_counts_in_the_first_step_alone(tmp_path):
    np.testing.assert_array_equal(first("InitialCondition", tmp_path, Value="9"), [9, *U[1:]])


@pytest.mark.parametrize("delay", [0.1, 0.25, 0.3, 1.0])
def test_a_transport_delay_interpolates_between_steps_once_more_than_its_time_has_passed(delay, tmp_path):
    output = first("TransportDelay", tmp_path, DelayTime=str(delay), InitialOutput="2")
    t = T * np.arange(U.size)
    expected = np.where(t - delay < 1e-9, 2.0, np.interp(t - delay, t, U))
    np.testing.assert_allclose(output, expected, atol=1e-12)


def test_feedback_through_a_delay_takes_the_width_of_what_is_fed_back(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("a")
    drawn.inport("b")
    drawn.block("Mux", "M", ports=(2, 1), Inputs="2")
    drawn.block("Sum", "S", ports=(2, 1))
    drawn.block("UnitDelay", "Z", SampleTime="-1")
    drawn.outport("y")
    drawn.line("a", "M:1")
    drawn.line("b", "M:2")
    drawn.line("M", "S:1")
    drawn.line("Z", "S:2")
    drawn.line("S", "Z", "y")
    outputs = run(imported(drawn, tmp_path), {"a": U, "b": -2 * U})
    np.testing.assert_allclose(outputs["y[1]"], np.cumsum(U))
    np.testing.assert_allclose(outputs["y[2]"], -2 * np.cumsum(U))


@pytest.mark.slow
def test_a_long_chain_of_delays_takes_the_width_of_its_input(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", PortDimensions="2")
    names = [f"Z{at}" for at in range(40)]
    for name in names:
        drawn.block("UnitDelay", name, SampleTime="-1")
    drawn.outport("y")
    drawn.chain("u", *names, "y")
    model = imported(drawn, tmp_path)
    long = np.arange(60.0)
    outputs = run(model, {"u[1]": long, "u[2]": -long})
    assert (outputs["y[1]"][-1], outputs["y[2]"][-1]) == (19.0, -19.0)


def test_a_vector_that_grows_by_its_own_feedback_is_reported(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Mux", "M", ports=(2, 1), Inputs="2")
    drawn.block("UnitDelay", "Z", SampleTime="-1")
    drawn.outport("y")
    drawn.line("u", "M:1")
    drawn.line("Z", "M:2")
    drawn.line("M", "Z", "y")
    with pytest.raises(InputError, match="cannot be determined"):
        imported(drawn, tmp_path)


# continuous states


TABLEAUS = {
    "ode1": lambda f, t, x, h: x + h * f(t, x),
    "ode2": lambda f, t, x, h: x + h / 2 * (f(t, x) + f(t + h, x + h * f(t, x))),
}


def oscillator(solver, step="0.1"):
    """X'' = -x - 0.3 x' + u with x(0) = 1, x'(0) = v0."""
    drawn = Model("osc", solver=solver, step=step)
    drawn.inport("u")
    drawn.block("Sum", "S", ports=(3, 1), Inputs="+--")
    drawn.block("Integrator", "V", ports=(1, 1), InitialCondition="v0")
    drawn.block("Integrator", "X", ports=(1, 1), InitialCondition="1")
    drawn.block("Gain", "D", Gain="d")
    drawn.outport("x")
    drawn.outport("v")
    drawn.line("u", "S:1")
    drawn.chain("S", "V")
    drawn.line("V", "X", "D", "v")
    drawn.line("D", "S:2")
    drawn.line("X", "S:3", "x")
    return drawn


GIVEN = {"v0": 0.5, "d": 0.3}


def closed(t):
    """The oscillation without input."""
    w = np.sqrt(1 - 0.15**2)
    return np.exp(-0.15 * t) * (np.cos(w * t) + (0.5 + 0.15) / w * np.sin(w * t))


@pytest.mark.parametrize(("solver", "order"), [("ode1", 1), ("ode2", 2), ("ode3", 3), ("ode4", 4), ("ode5", 5)])
def test_solvers_have_their_order(solver, order, tmp_path):
    errors = []
    for step, samples in (("0.2", 21), ("0.1", 41)):
        model = imported(oscillator(solver, step), tmp_path, parameters=[GIVEN])
        output = run(model, {"u": np.zeros(samples)})["x"]
        errors.append(abs(output[-1] - closed(4.0)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.45)


@pytest.mark.parametrize("solver", ["ode1", "ode2"])
def test_a_solver_follows_its_formula(solver, tmp_path):
    outputs = run(imported(oscillator(solver), tmp_path, parameters=[GIVEN]), {"u": U})
    x = np.array([0.5, 1.0])
    for k, u in enumerate(U):
        np.testing.assert_allclose([outputs["v"][k], outputs["x"][k]], x, rtol=1e-12, atol=1e-13)
        x = TABLEAUS[solver](lambda t, x, u=u: np.array([u - 0.3 * x[0] - x[1], x[0]]), 0.0, x, T)


WIDE = {
    "a reset": {"ExternalReset": "level hold"},
    "a start from outside": {"InitialConditionSource": "external"},
    "limits": {"LimitOutput": "on", "UpperSaturationLimit": "[0.3 0.9]", "LowerSaturationLimit": "-inf"},
}


@pytest.mark.parametrize(("message", "given"), WIDE.items())
def test_an_integrator_of_a_scalar_is_as_wide_as(message, given, tmp_path):
    drawn = Model(step="0.1", solver="ode1")
    drawn.inport("u")
    drawn.block("Integrator", "I", ports=(1 + (message != "limits"), 1), **given)
    drawn.line("u", "I:1")
    if message != "limits":
        drawn.inport("w", PortDimensions="2")
        drawn.line("w", "I:2")
    drawn.outport("y")
    drawn.line("I", "y")
    wide = np.array([np.arange(12) % 4 == 3, np.arange(12) % 5 == 4], dtype=float)
    wide[:, 0] = 3, 7
    u = np.full(12, 1.5)
    outputs = run(imported(drawn, tmp_path), {"u": u, "w[1]": wide[0], "w[2]": wide[1]})
    for at in range(2):
        x = wide[at][0] if message == "a start from outside" else 0.0
        for k in range(12):
            x = 0.0 if message == "a reset" and wide[at][k] else x
            x = min(x, (0.3, 0.9)[at]) if message == "limits" else x
            assert outputs[f"y[{at + 1}]"][k] == pytest.approx(x, abs=1e-12), k
            x += T * u[k]


def test_an_integrator_that_begins_beyond_its_limits_begins_at_them(tmp_path):
    settings = {
        "LimitOutput": "on",
        "UpperSaturationLimit": "0.2",
        "InitialCondition": "5",
        "ExternalReset": "level hold",
    }
    drawn = alone("Integrator", 2, model=Model(solver="ode1", step="0.1"), **settings)
    reset = np.array([0, 0, 0, 1, 0, 0], dtype=float)
    output = run(imported(drawn, tmp_path), {"u1": np.full(6, -1.0), "u2": reset})["y1"]
    np.testing.assert_allclose(output, [0.2, 0.1, 0.0, 0.2, 0.1, 0.0], atol=1e-15)


def test_slopes_through_a_solver_are_those_of_finite_differences(tmp_path):
    model = imported(oscillator("ode4"), tmp_path, parameters=[GIVEN])
    for name in ("d", "v0"):
        exact, differences = slopes(model, {"u": U}, name, "x")
        np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-8)
        assert np.abs(exact).max() > 0.1


@pytest.mark.parametrize(
    ("b", "a"),
    [([1.0], [1.0, 2.0, 1.0]), ([2.0, 1.0], [0.5, 1.0, 4.0]), ([1.0, 0.0, 3.0], [2.0, 1.0, 4.0]), ([3.0], [2.0])],
)
def test_transfer_functions_are_those_of_scipy(b, a, tmp_path):
    drawn = alone("TransferFcn", Numerator=str(b), Denominator=str(a), model=Model(solver="ode5", step="0.02"))
    t = 0.02 * np.arange(60)
    step = np.ones(60)
    output = run(imported(drawn, tmp_path), {"u1": step})["y1"]
    expected = scipy.signal.lsim((b, a), step, t)[1] if len(a) > 1 else step * b[0] / a[0]
    np.testing.assert_allclose(output, expected, atol=1e-7)


def test_a_lag_with_a_parameter_in_front_closes_a_loop(tmp_path):
    drawn = Model(solver="ode5", step="0.02")
    drawn.inport("u")
    drawn.block("Sum", "S", ports=(2, 1), Inputs="+-")
    drawn.block("TransferFcn", "F", ports=(1, 1), Numerator="[3]", Denominator="[T 1]")
    drawn.outport("y")
    drawn.line("u", "S:1")
    drawn.chain("S", "F")
    drawn.line("F", "y", "S:2")
    t = 0.02 * np.arange(200)
    output = run(imported(drawn, tmp_path, parameters=[{"T": 0.5}]), {"u": np.ones(200)})["y"]
    np.testing.assert_allclose(output, 0.75 * (1 - np.exp(-8 * t)), atol=1e-7)


@pytest.mark.slow
def test_a_state_space_model_is_that_of_scipy(tmp_path):
    drawn = alone("StateSpace", A="[0 1; -2 -0.5]", B="[0; 1]", C="[1 0.5]", D="0.2", X0="[1; 0]",
                  model=Model(solver="ode5", step="0.02"))  # fmt: skip
    t = 0.02 * np.arange(200)
    output = run(imported(drawn, tmp_path), {"u1": np.ones(200)})["y1"]
    system = scipy.signal.StateSpace([[0, 1], [-2, -0.5]], [[0], [1]], [[1, 0.5]], [[0.2]])
    np.testing.assert_allclose(output, scipy.signal.lsim(system, np.ones(200), t, X0=[1, 0])[1], atol=1e-7)


def test_an_integrator_rests_at_its_limits(tmp_path):
    drawn = alone("Integrator", LimitOutput="on", UpperSaturationLimit="0.3", LowerSaturationLimit="-0.3",
                  model=Model(solver="ode3", step="0.1"))  # fmt: skip
    u = np.array([1.0] * 6 + [-1.0] * 10)
    output = run(imported(drawn, tmp_path), {"u1": u})["y1"]
    x = 0.0
    for k, one in enumerate(u):
        assert output[k] == pytest.approx(x, abs=1e-12)
        x = np.clip(x + T * one, -0.3, 0.3)


def test_a_wrapped_integrator_goes_on_at_the_other_end_of_its_range(tmp_path):
    drawn = alone("Integrator", WrapState="on", WrappedStateUpperValue="180", WrappedStateLowerValue="-180",
                  InitialCondition="170", model=Model(solver="ode3", step="0.1"))  # fmt: skip
    u = np.array([150.0] * 8 + [-900.0] * 8)
    output = run(imported(drawn, tmp_path), {"u1": u})["y1"]
    turned = 170 + np.concatenate([[0], np.cumsum(u * T)])[:-1]
    np.testing.assert_allclose(output, (turned + 180) % 360 - 180, atol=1e-10)
    assert (np.abs(np.diff(output)) > 180).sum() == 3


def test_an_integrator_is_reset_to_its_external_initial_value(tmp_path):
    drawn = alone("Integrator", 3, InitialConditionSource="external", ExternalReset="rising",
                  model=Model(solver="ode1", step="0.1"))  # fmt: skip
    trigger = np.array([0.0, 0, 1, 1, 0, 1, 1, 1])
    start = np.arange(8.0)
    output = run(imported(drawn, tmp_path), {"u1": np.ones(8), "u2": trigger, "u3": start})["y1"]
    np.testing.assert_allclose(output, [0, 0.1, 2, 2.1, 2.2, 5, 5.1, 5.2])


def test_time_runs_within_the_minor_steps(tmp_path):
    drawn = Model(solver="ode4", step="0.1")
    drawn.block("Clock", "C", ports=(0, 1))
    drawn.block("Fcn", "F", Expr="3*u^2")
    drawn.block("Integrator", "I", ports=(1, 1))
    drawn.outport("y")
    drawn.chain("C", "F", "I", "y")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), samples=11)["y"][-1], 1.0, rtol=1e-12)


def test_a_discrete_controller_holds_its_output_within_the_minor_steps(tmp_path):
    drawn = Model(solver="ode4", step="0.1")
    drawn.block("ZeroOrderHold", "Z", SampleTime="0.2")
    drawn.block("Gain", "K", Gain="-1")
    drawn.block("Integrator", "I", ports=(1, 1), InitialCondition="1")
    drawn.outport("y")
    drawn.line("I", "Z", "y")
    drawn.chain("Z", "K", "I")
    output = run(imported(drawn, tmp_path), samples=9)["y"]
    x = applied = 1.0
    for k in range(9):
        applied = x if k % 2 == 0 else applied
        assert output[k] == pytest.approx(x, rel=1e-12)
        x -= T * applied


def test_the_replacement_of_a_variable_step_is_reported(tmp_path):
    result = import_simulink(oscillator("ode45").write(tmp_path), parameters=[GIVEN])
    assert result.model.step is None
    assert any("ode45 -> ode4" in one for one in result.report.substitutions)
    x = run(result.model, {"u": np.zeros(41)}, dt=0.1)["x"]
    assert x[-1] == pytest.approx(closed(4.0), abs=1e-5)


# conditional subsystems


@pytest.mark.parametrize("solver", ["ode14x", "ode1be", "odeN"])
def test_a_fixed_step_solver_that_is_replaced_leaves_its_step(solver, tmp_path):
    result = import_simulink(oscillator(solver).write(tmp_path), parameters=[GIVEN])
    same = import_simulink(oscillator("ode4").write(tmp_path), parameters=[GIVEN])
    assert result.model.step == same.model.step == 0.1
    assert result.model.graph == same.model.graph
    assert result.report.substitutions[0] == f"{solver} -> ode4"
    assert not same.report.substitutions


def conditional(port, states="held", output="held", inside="UnitDelay", **options):
    """An accumulator in a subsystem that a second inport controls."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.inport("c")
    inner = drawn.subsystem("Sub")
    inner.inport("x")
    inner.block(port, "P", **({"StatesWhenEnabling": states} if port == "EnablePort" else {}), **options)
    inner.block("Sum", "S", ports=(2, 1))
    inner.block("UnitDelay", "Z", SampleTime="-1")
    inner.outport("y", InitialOutput="-1", OutputWhenDisabled=output)
    inner.line("x", "S:1")
    inner.line("Z", "S:2")
    inner.line("S", "Z", "y")
    drawn.outport("y")
    drawn.chain("u", "Sub", "y")
    drawn.line("c", "Sub#enable" if port == "EnablePort" else "Sub#trigger")
    return drawn


C = np.array([0, 1, 1, 0, -1, 2, 0, 0, 1, 1, -1, 0, 3, 0, 0, -2, 0, 0, -1, 0] * 2, dtype=float)


@pytest.mark.parametrize("states", ["held", "reset"])
@pytest.mark.parametrize("output", ["held", "reset"])
def test_an_enabled_subsystem_runs_where_its_control_is_above_0(states, output, tmp_path):
    result = run(imported(conditional("EnablePort", states, output), tmp_path), {"u": U, "c": C})["y"]
    y, z, was = -1.0, 0.0, False
    for k, u in enumerate(U):
        if C[k] > 0:
            z = 0.0 if states == "reset" and not was else z
            y = z = z + u
        elif output == "reset":
            y = -1.0
        was = C[k] > 0
        assert result[k] == pytest.approx(y, abs=1e-13), k


@pytest.mark.parametrize("kind", ["rising", "falling", "either"])
def test_a_triggered_subsystem_runs_at_the_edges_of_its_control(kind, tmp_path):
    drawn = conditional("TriggerPort", TriggerType=kind)
    output = run(imported(drawn, tmp_path), {"u": U, "c": C})["y"]
    y, z, (up, down) = -1.0, 0.0, crossings(C)
    for k, u in enumerate(U):
        if {"rising": up[k], "falling": down[k], "either": up[k] or down[k]}[kind]:
            y = z = z + u
        assert output[k] == pytest.approx(y, abs=1e-13), k


@pytest.mark.parametrize("kind", ["rising", "falling", "either"])
def test_a_vector_triggers_a_subsystem_by_any_of_its_elements(kind, tmp_path):
    drawn = conditional("TriggerPort", TriggerType=kind)
    next(block for block in drawn.blocks if block.name == "c").parameters["PortDimensions"] = "2"
    second = np.roll(C, 7)
    output = run(imported(drawn, tmp_path), {"u": U, "c[1]": C, "c[2]": second})["y"]
    y, edges = -1.0, list(zip(*crossings(C), *crossings(second), strict=True))
    z = 0.0
    for k, u in enumerate(U):
        up, down = edges[k][0] or edges[k][2], edges[k][1] or edges[k][3]
        if {"rising": up, "falling": down, "either": up or down}[kind]:
            y = z = z + u
        assert output[k] == pytest.approx(y, abs=1e-13), k


def triggered_and_enabled():
    """The accumulator, triggered by c where `on` enables it, with states that begin anew when that comes again."""
    drawn = conditional("TriggerPort", TriggerType="rising")
    inner = next(block.system for block in drawn.blocks if block.name == "Sub")
    inner.block("EnablePort", "E", StatesWhenEnabling="reset")
    drawn.inport("on")
    drawn.line("on", "Sub#enable")
    return drawn


def test_states_of_a_triggered_subsystem_are_reset_at_the_first_trigger_that_finds_it_enabled_again(tmp_path):
    on = np.tile([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, 0.0, 0.0, 1.0, 1.0], 4)[: len(U)]
    output = run(imported(triggered_and_enabled(), tmp_path), {"u": U, "c": C, "on": on})["y"]
    y, z, was, (up, _) = -1.0, 0.0, False, crossings(C)
    for k, u in enumerate(U):
        if up[k] and on[k] > 0:
            y = z = (z if was else 0.0) + u
        was = on[k] > 0 if up[k] else was
        assert output[k] == pytest.approx(y, abs=1e-13), k


def test_a_vector_triggers_a_subsystem_that_begins_anew_as_well(tmp_path):
    drawn = triggered_and_enabled()
    next(block for block in drawn.blocks if block.name == "c").parameters["PortDimensions"] = "4"
    assert import_simulink(drawn.write(tmp_path)).report.findings == ()


def test_a_vector_of_calls_is_refused(tmp_path):
    drawn = conditional("TriggerPort", TriggerType="function-call")
    next(block for block in drawn.blocks if block.name == "c").parameters["PortDimensions"] = "2"
    report = import_simulink(drawn.write(tmp_path)).report
    assert [one.why for one in report.unsupported] == [
        "its trigger port receives 2 function calls, which is not supported"
    ]


@pytest.mark.parametrize("kind", ["rising", "falling", "either"])
def test_a_discrete_integrator_is_reset_where_a_signal_begins_or_ceases_to_be_positive(kind, tmp_path):
    drawn = alone("DiscreteIntegrator", 2, SampleTime="0.1", ExternalReset=kind, InitialCondition="1")
    output = run(imported(drawn, tmp_path), {"u1": U, "u2": C})["y1"]
    x = 1.0
    for k, u in enumerate(U):
        rising, falling = k > 0 and C[k - 1] <= 0 < C[k], k > 0 and C[k - 1] > 0 >= C[k]
        x = 1.0 if {"rising": rising, "falling": falling, "either": rising or falling}[kind] else x
        assert output[k] == pytest.approx(x, abs=1e-13), k
        x += T * u


def test_an_if_block_runs_one_of_its_subsystems_and_merge_takes_the_last(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("If", "If", ports=(1, 3), IfExpression="u1 > 0.5", ElseIfExpressions="u1 < -limit", ShowElse="on")
    drawn.line("u", "If")
    drawn.block("Merge", "M", ports=(2, 1))
    for at, gain in ((1, "10"), (2, "100")):
        inner = drawn.subsystem(f"A{at}")
        inner.inport("x")
        inner.block("ActionPort", "P")
        inner.block("Gain", "G", Gain=gain)
        inner.outport("y")
        inner.chain("x", "G", "y")
        drawn.line("u", f"A{at}")
        drawn.line(f"If:{at}", f"A{at}#ifaction")
        drawn.line(f"A{at}", f"M:{at}")
    drawn.outport("y")
    drawn.line("M", "y")
    output = run(imported(drawn, tmp_path, parameters=[{"limit": 0.5}]), {"u": U})["y"]
    y = 0.0
    for k, u in enumerate(U):
        y = 10 * u if u > 0.5 else 100 * u if u < -0.5 else y
        assert output[k] == pytest.approx(y)


def merged_buses(*names):
    """A bus of two signals, 10 u and u, from where u is above 0, else 100 u and u, each with its own names."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("If", "If", ports=(1, 2), IfExpression="u1 > 0", ShowElse="on")
    drawn.line("u", "If")
    drawn.block("Merge", "M", ports=(2, 1), InitialOutput="0")
    for at, (gain, name) in enumerate(zip(("10", "100"), names, strict=True), 1):
        inner = drawn.subsystem(f"A{at}")
        inner.inport("x")
        inner.block("ActionPort", "P")
        inner.block("Gain", "G", Gain=gain)
        inner.block("BusCreator", "B", ports=(2, 1), Inputs="2")
        inner.outport("y")
        inner.line("x", "G", "B:2", name="plain")
        inner.line("G", "B:1", name=name)
        inner.line("B", "y")
        drawn.line("u", f"A{at}")
        drawn.line(f"If:{at}", f"A{at}#ifaction")
        drawn.line(f"A{at}", f"M:{at}")
    drawn.block("BusSelector", "S", ports=(1, 2), OutputSignals=f"plain,{names[0]}")
    drawn.outport("plain")
    drawn.outport("scaled")
    drawn.line("M", "S")
    drawn.line("S:1", "plain")
    drawn.line("S:2", "scaled")
    return drawn


def test_buses_are_merged_signal_by_signal(tmp_path):
    outputs = run(imported(merged_buses("scaled", "scaled"), tmp_path), {"u": U})
    assert outputs["plain"] == pytest.approx(U)
    assert outputs["scaled"] == pytest.approx(np.where(U > 0, 10 * U, 100 * U))


def test_buses_of_other_signals_are_not_merged(tmp_path):
    report = import_simulink(merged_buses("scaled", "other").write(tmp_path)).report
    assert [one.why for one in report.unsupported] == ["it merges buses with different signals"]


def test_a_switch_case_chooses_by_whole_numbers(tmp_path):
    drawn = switch_case("{1,[2 -3]}", 11, 22, 33)
    output = run(imported(drawn, tmp_path), {"u": [1.0, 1.9, 2.0, -3.4, 5.0, -2.0]})["y"]
    assert output.tolist() == [11, 11, 22, 22, 33, 33]


def test_an_integrator_in_an_enabled_subsystem_stands_still(tmp_path):
    drawn = conditional("EnablePort")
    inner = drawn.blocks[2].system
    drawn.solver["SolverName"] = "ode4"
    inner.blocks[3].kind, inner.blocks[3].parameters = "Integrator", {}
    inner.wires[2:] = []
    inner.wires[0].ends[0] = ("Z", "in", 1)
    inner.wires[1].ends[0] = ("y", "in", 1)
    output = run(imported(drawn, tmp_path), {"u": U, "c": C})["y"]
    y, x = -1.0, 0.0
    for k, u in enumerate(U):
        if C[k] > 0:
            y, x = x, x + T * u
        assert output[k] == pytest.approx(y, abs=1e-13), k


def test_unsupported_settings_are_reported(tmp_path):
    for kind, options, reason in (
        ("Lookup_n-D", {"NumberOfTableDimensions": "1", "InterpMethod": "Lagrange"}, "InterpMethod 'Lagrange'"),
        ("Integrator", {"WrapState": "on", "LimitOutput": "on"}, "its state is wrapped and has limits"),
        ("SwitchCase", {"CaseConditions": "{1, Mode.idle}"}, "variable Mode.idle: undefined"),
        ("SignalGenerator", {"WaveForm": "random"}, "its wave form 'random'"),
    ):
        with pytest.raises(InputError, match=reason):
            imported(alone(kind, **options), tmp_path)
