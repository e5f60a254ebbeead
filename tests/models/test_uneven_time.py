"""Integrators and solvers on uneven time: plain loops, closed forms, orders, and derivatives by differences."""

import math
from itertools import pairwise

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.graph.integration import SOLVERS
from kennfeld.models.formula import formula
from kennfeld.models.formula.printer import to_text
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from tests.draws import mostly_slow

SAMPLES = 61
RNG = np.random.default_rng(5)
TIMES = {
    "alternating": np.concatenate([[0.0], np.cumsum(np.resize([0.4, 0.02], SAMPLES - 1))]),
    "two rasters": np.union1d(np.arange(0.0, 4.0, 0.1), np.arange(0.0, 4.0, 0.13))[:SAMPLES],
    "a long step": np.where(np.arange(SAMPLES) > 30, 1.8, 0.0) + 0.1 * np.arange(SAMPLES),
    "random": np.concatenate([[0.0], np.cumsum(RNG.uniform(0.02, 0.3, SAMPLES - 1))]),
}
U = RNG.normal(size=SAMPLES)
every_time = pytest.mark.parametrize(
    "time",
    [pytest.param(time, id=name, marks=[pytest.mark.slow][: name != "alternating"]) for name, time in TIMES.items()],
)


def simulated(text, time, parameters=None, start=7.0):
    """The node y at the samples; time begins at `start`."""
    return kf.simulate(text, {"time": time + start, "u": U[: time.size]}, parameters or {})["y"].values


def euler(time, slope, init, limited=lambda x: x):
    """X by forward Euler: its value at a sample, and the step to the next one with what is known there."""
    values = [limited(init)]
    for k, (now, then) in enumerate(pairwise(time.tolist())):
        values.append(limited(values[-1] + (then - now) * slope(k, values[-1])))
    return np.array(values)


def runge_kutta(time, slope, init, solver):
    """States by a solver, Float[samples, states]; `slope(t, x, k)` is the derivative within step k."""
    method, values = SOLVERS[solver], [np.array(init, dtype=float)]
    for k, (now, then) in enumerate(pairwise(time.tolist())):
        step, stages = then - now, []
        for node, row in zip(method.nodes, method.rows, strict=True):
            inner = values[-1] + step * sum((a * s for a, s in zip(row, stages, strict=False)), np.zeros(len(init)))
            stages.append(np.array(slope(now + node * step, inner, k)))
        values.append(values[-1] + step * sum(w * s for w, s in zip(method.weights, stages, strict=True)))
    return np.array(values)


def test_a_sample_counts_for_the_step_that_begins_with_it():
    data = {"time": [0, 1, 2, 12, 13, 14], "x": [0, 0, 1, 0, 0, 0]}
    simulation = kf.simulate("y = integrator(x, 0)\nz = prev(z, 0) + dt * prev(x, 0)", data, {})
    assert simulation["y"].values.tolist() == simulation["z"].values.tolist() == [0, 0, 0, 10, 10, 10]


@every_time
def test_integrators_without_a_solver_are_forward_euler(time):
    u = U[: time.size]
    np.testing.assert_allclose(simulated("y = integrator(u, 2)", time), euler(time, lambda k, x: u[k], 2.0), atol=1e-12)
    states = simulated("y = integrator(3 * u, x0, -0.2, high)", time, {"x0": 0.1, "high": 0.3})
    expected = euler(time, lambda k, x: 3 * u[k], 0.1, lambda x: min(max(x, -0.2), 0.3))
    np.testing.assert_allclose(states, expected, atol=1e-12)
    chained = simulated("y = integrator(v, 1)\nv = integrator(u - y, -1)", time)
    both = euler(time, lambda k, x: np.array([x[1], u[k] - x[0]]), np.array([1.0, -1.0]))
    np.testing.assert_allclose(chained, both[:, 0], atol=1e-12)


@every_time
def test_a_controller_with_limits_and_anti_windup_follows_its_loop(time):
    text = """
    e = u - n
    raw = Kp * e + I
    y = clip(raw, -0.5, 0.5)
    I = integrator(Ki * e + (y - raw) * Kb, I0)
    n = PT1(integrator(y - 0.3 * n_before, 0.2), 0.1)
    n_before = prev(n, 0.2)
    """
    K = {"Kp": 0.8, "Ki": 0.5, "Kb": 1.5, "I0": 0.1}
    n_last, I, x, expected = 0.2, K["I0"], 0.2, []  # noqa: E741
    for k, now in enumerate(time):
        before = time[k] - time[k - 1] if k else time[1] - time[0]
        after = time[k + 1] - now if k + 1 < time.size else before
        n = x if k == 0 else n_last + before / (0.1 + before) * (x - n_last)
        e = U[k] - n
        raw = K["Kp"] * e + I
        y = min(max(raw, -0.5), 0.5)
        expected.append(y)
        I += after * (K["Ki"] * e + (y - raw) * K["Kb"])  # noqa: E741
        x += after * (y - 0.3 * n_last)
        n_last = n
    np.testing.assert_allclose(simulated(text, time, K), expected, rtol=1e-12, atol=1e-12)


@every_time
@pytest.mark.parametrize("solver", mostly_slow(list(SOLVERS), ["ode1", "ode4"]))
def test_solvers_advance_states_to_the_next_sample(time, solver):
    text = f"solver {solver}\ny = integrator(v, 1)\nv = integrator(u - k * y - 0.3 * v + sin(t), v0)"
    expected = runge_kutta(
        time, lambda t, x, k: (x[1], U[k] - 2 * x[0] - 0.3 * x[1] + math.sin(t)), (1.0, -0.5), solver
    )
    states = simulated(text, time, {"k": 2.0, "v0": -0.5})
    np.testing.assert_allclose(states, expected[:, 0], rtol=1e-11, atol=1e-12)


def grid(steps, pattern):
    """Times from 0 to 2 whose steps have the lengths of a pattern in turn."""
    lengths = np.resize(pattern, steps)
    return np.concatenate([[0.0], np.cumsum(lengths / lengths.sum() * 2.0)])


PATTERNS = {"alternating": [20.0, 1.0], "two rasters": [3, 2, 1, 3, 1, 2, 3], "one long": [1.0] * 9 + [9.0]}


@pytest.mark.parametrize("pattern", mostly_slow(list(PATTERNS), ["alternating"]))
@pytest.mark.parametrize("solver", mostly_slow(list(SOLVERS), ["ode1", "ode3"]))
def test_the_error_of_a_solver_falls_with_its_order_on_uneven_time(solver, pattern):
    order = int(solver[-1])
    sizes = (20, 40, 80) if order > 4 else (160, 320, 640)
    errors = []
    for steps in sizes:
        data = {"time": grid(steps, PATTERNS[pattern]), "u": np.zeros(steps + 1)}
        y = kf.simulate(f"solver {solver}\ny = integrator(y * cos(t) + 0 * u, 1)", data, {})["y"].values
        errors.append(abs(y[-1] - math.exp(math.sin(2.0))))
    slope = np.polyfit(np.log(sizes), np.log(np.maximum(errors, 1e-16)), 1)[0]
    assert -slope == pytest.approx(order, abs=0.6) or errors[-1] < 1e-13


@every_time
def test_the_sum_of_a_constant_is_the_time(time):
    data = {"time": time, "u": np.ones(time.size)}
    for solver in ("", "solver ode4\n"):
        y = kf.simulate(f"{solver}y = integrator(u, 0)", data, {})["y"].values
        np.testing.assert_allclose(y, time, rtol=1e-12, atol=1e-12)


def test_each_piece_is_integrated_from_its_own_begin():
    first, second = TIMES["alternating"][:31], TIMES["random"][:25]
    data = kf.Dataset.of("d", {"u": U[:56]}, time=np.concatenate([first, second]), piece_starts=[0, 31])
    y = kf.simulate("y = integrator(u, 0.5)", data, {})["y"].values
    np.testing.assert_allclose(y[:31], euler(first, lambda k, x: U[k], 0.5), rtol=1e-12)
    np.testing.assert_allclose(y[31:], euler(second, lambda k, x: U[31 + k], 0.5), rtol=1e-12)


def test_steps_of_two_rasters_are_not_pauses():
    time = np.concatenate([[0.0], np.cumsum(np.resize([0.02, 0.5], 60))])  # 25 to 1
    np.testing.assert_allclose(simulated("y = integrator(u, 0)", time), euler(time, lambda k, x: U[k], 0.0), atol=1e-12)


@pytest.mark.parametrize("solver", ["", "solver ode4\n"])
def test_text_that_is_printed_and_read_again_gives_the_same_on_uneven_time(solver):
    model = formula(f"{solver}y = integrator(u - 0.4 * y, 1, -2, 0.8) + PT1(u, 0.3)")
    again = formula(to_text(model.graph))
    time = TIMES["random"]
    np.testing.assert_array_equal(simulated(again, time), simulated(model, time))


def problem_of(text, time, *parameters):
    data = kf.Dataset.of("d", {"u": U[: time.size], "m": np.cos(3 * time)}, time=time)
    values = kf.ParameterSet(parameters)
    return CompiledProblem(Problem(formula(text, parameters=list(values)), (data,), values, (kf.Criterion("y", "m"),)))


FEW = [kf.Scalar("a", 0.4), kf.Scalar("b", 0.7), kf.Scalar("x0", 0.3)]
MANY = kf.Curve("C", np.linspace(-2.5, 2.5, 40), np.linspace(-0.5, 1.0, 40) ** 2)
DERIVED = {
    "sum": "y = integrator(a * u - b * y, x0, -2, 2)",
    "solver": "solver ode4\ny = integrator(a * u - b * y * abs(y) + v, x0)\nv = integrator(u - a * v - y)",
    "with PT1": "y = PT1(integrator(a * u - y, x0), b)",
    "exact lag": "y = PT1exact(a * u, b, x0)",
}


@pytest.mark.parametrize("time", mostly_slow(list(TIMES), ["alternating"]))
@pytest.mark.parametrize("more", ["", " + C(u)"], ids=["few values", "many values"])
@pytest.mark.parametrize("text", DERIVED.values(), ids=DERIVED)
def test_gradients_and_rows_are_those_of_differences(text, more, time):
    tables = [*FEW, MANY] if more else FEW
    compiled = problem_of(text.replace("a * u", f"(a * u{more})"), TIMES[time], *tables)
    values = compiled.start
    exact = compiled.sums.normal(values).gradient
    cost = compiled.sums.cost
    steps = 1e-6 * np.eye(values.size)
    differences = np.array([(cost(values + h) - cost(values - h)) / 2e-6 for h in steps])
    np.testing.assert_allclose(2 * exact, differences, rtol=2e-6, atol=2e-7)


def test_factors_of_integrators_are_recovered():
    time = TIMES["alternating"]
    data = {"time": time, "u": U, "m": 2.0 * euler(time, lambda k, x: U[k], 0.0)}
    for solver in ("", "solver ode4\n"):
        result = kf.calibrate(f"{solver}y = k * integrator(u, 0)", data, {"k": 1.0}, "m")
        assert result.converged
        assert result.parameters["k"].value == pytest.approx(2.0, rel=1e-7)


def test_a_model_with_a_step_of_its_own_refuses_uneven_data():
    data = {"time": TIMES["alternating"], "u": U}
    with pytest.raises(kf.InputError, match=r"the model's step is 0.01 s, but the samples are 0.02 to 0.4 s apart"):
        kf.simulate("step 0.01\nsolver ode4\ny = integrator(u)", data, {})
