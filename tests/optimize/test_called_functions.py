"""Functions that are called for all samples at once, or that run through trajectories, against formula text."""

from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.models.formula.frontend import read
from kennfeld.optimize import Problem
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.validation import check_problem, trajectory_findings
from kennfeld.optimize.search.multistart import run
from kennfeld.optimize.sums.compiled import CompiledProblem, smoothable
from kennfeld.optimize.sums.sample_slopes import SampleSlopes
from tests.draws import mostly_slow
from tests.optimize.trajectory_functions import TEXT, lag_function

RNG = np.random.default_rng(5)
TIME = 0.1 * np.arange(300)
U = np.repeat(RNG.uniform(1.0, 3.0, 30), 10)
AXIS = [0.0, 1.0, 2.0, 3.0]


def smooth_step(x, a):
    """Return a saturated product."""
    return np.tanh(a * x) * 2 + x


def wave(x):
    """Return two results."""
    return np.sin(x), x**2 / 4


def values():
    table = kf.Curve("C", kf.Axis(AXIS, "u"), [0.4, 0.5, 0.7, 0.6])
    return kf.ParameterSet([table, kf.Scalar("a", 0.8), kf.Scalar("b", 1.2), kf.Scalar("T", 0.5)])


# formula text with calls, and the same without
PAIRS = {
    "algebra": ("y = b * f(C(u), a)", "y = b * (tanh(a * C(u)) * 2 + C(u))"),
    "nested": ("y = f(f(u, a) * b, C(u))", "i = (tanh(a * u) * 2 + u) * b\ny = tanh(C(u) * i) * 2 + i"),
    "results": ("y = b * w.s(C(u)) + a * w.q(C(u))", "y = b * sin(C(u)) + a * C(u)^2 / 4"),
    "lagged": ("y = PT1(f(C(u), a), T) * b", "y = PT1(tanh(a * C(u)) * 2 + C(u), T) * b"),
    "loop": ("y = f(prev(y, 0) * C(u), a) / 4", "i = prev(y, 0) * C(u)\ny = (tanh(a * i) * 2 + i) / 4"),
    "kinked": ("y = C(f(u, a) / 2) * b", "y = C((tanh(a * u) * 2 + u) / 2) * b"),
}
DATA = kf.Dataset.of("drive", {"u": U, "z": 2 * U}, time=np.where(TIME < 15.0, TIME, TIME + 50.0))


def problem(text, datasets=(DATA,)):
    initial = values()
    functions = {"f": smooth_step, "w": kf.function(wave, outputs=["s", "q"])}
    model = kf.formula(text, parameters=list(initial), functions=functions)
    return Problem(model, datasets, initial, (kf.Criterion("y", "z"),))


def order_of(compiled):
    """Return the places of the values, parameter by parameter in the order of their names."""
    offsets, free = compiled.values.offsets, compiled.problem.parameters
    return np.concatenate([offsets[name] + np.arange(free[name].size) for name in sorted(offsets)])


def assert_equal_sums(own, reference, factor=1.0, tolerance=1e-8):
    """Compare cost, gradient and matrix of two compiled problems at the same values."""
    ours, theirs = (each.values.pack(each.problem.parameters) * factor for each in (own, reference))
    assert own.sums.cost(ours) == pytest.approx(reference.sums.cost(theirs), rel=1e-10)
    a, b = own.sums.normal(ours), reference.sums.normal(theirs)
    first, second = order_of(own), order_of(reference)
    scale = np.abs(b.gradient).max(), np.abs(b.matrix).max()
    assert np.allclose(a.gradient[first], b.gradient[second], rtol=tolerance, atol=tolerance * scale[0])
    assert np.allclose(
        a.matrix[np.ix_(first, first)], b.matrix[np.ix_(second, second)], rtol=tolerance, atol=tolerance * scale[1]
    )


@pytest.mark.guests
@pytest.mark.parametrize(("calls", "text"), PAIRS.values(), ids=PAIRS)
def test_cost_and_derivatives_are_those_of_the_formula(calls, text):
    own, reference = CompiledProblem(problem(calls)), CompiledProblem(problem(text))
    for factor in (1.0, 1.1, 1.0):
        assert_equal_sums(own, reference, factor)


@pytest.mark.guests
@pytest.mark.parametrize(("calls", "text"), PAIRS.values(), ids=PAIRS)
def test_slopes_at_a_sample_are_those_of_the_formula(calls, text):
    initial, slopes = values(), []
    for each in (problem(calls), problem(text)):
        at = SampleSlopes(each, initial).at(each.bind(DATA), 123, initial)
        slopes.append(dict(at))
    for name, slope in slopes[1].items():
        assert slopes[0][name] == pytest.approx(slope, rel=1e-7, abs=1e-9)


@pytest.mark.guests
@pytest.mark.parametrize("calls", mostly_slow(["algebra", "lagged", "kinked"], 2))
def test_a_calibration_ends_at_the_values_of_the_formula(calls):
    measured = kf.simulate(kf.formula(PAIRS[calls][1], parameters=list(values())), DATA, values())["y"].values
    data = kf.Dataset.of("drive", {"u": U, "z": measured}, time=DATA.time)
    initial = values()
    start = initial.with_parameters(initial["a"].with_values(0.6), initial["b"].with_values(0.9))
    results = [
        run(replace(problem(text, (data,)), parameters=start, free=("a", "b")), Options()) for text in PAIRS[calls]
    ]
    assert [result.status for result in results] == ["converged"] * 2
    for name in ("a", "b"):
        assert results[0].parameters[name].value == pytest.approx(initial[name].value, rel=1e-6)


# calls of a function that keeps memory, and the same in formula text
TRAJECTORIES = {
    "alone": ("y = lag.y(u)", f"driven = u\n{TEXT}y = lagged"),
    "between": ("y = b * lag.twice(C(u)) + a * C(u)", f"driven = C(u)\n{TEXT}y = b * twice + a * C(u)"),
    "loop": ("y = lag.y(b * u - prev(y, 0) / 2)", f"driven = b * u - prev(y, 0) / 2\n{TEXT}y = lagged"),
    "two": ("y = lag.y(C(u)) * a", f"driven = C(u)\n{TEXT}y = lagged * a"),
}


def trajectory_problem(text, free=("*",), datasets=(DATA,), initial=None):
    initial = initial or values().with_parameters(kf.Scalar("k", 1.5))
    model = read("lag.kf", list(initial), text=text, functions=[lag_function()])
    return Problem(model, datasets, initial, (kf.Criterion("y", "z"),), free)


@pytest.mark.parametrize(("calls", "text"), TRAJECTORIES.values(), ids=TRAJECTORIES)
def test_trajectories_have_the_derivatives_of_the_formula(calls, text):
    own, reference = CompiledProblem(trajectory_problem(calls)), CompiledProblem(trajectory_problem(text))
    for factor in (1.0, 1.1, 1.0):
        assert_equal_sums(own, reference, factor, tolerance=1e-7)


@pytest.mark.parametrize(("calls", "text"), TRAJECTORIES.values(), ids=TRAJECTORIES)
def test_slopes_of_trajectories_at_a_sample_are_those_of_the_formula(calls, text):
    slopes = []
    for each in (trajectory_problem(calls), trajectory_problem(text)):
        at = SampleSlopes(each, each.parameters).at(each.bind(DATA), 123, each.parameters)
        slopes.append(at)
    for name, slope in slopes[1].items():
        assert slopes[0][name] == pytest.approx(slope, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("name", mostly_slow(TRAJECTORIES, ["loop", "between"]))
def test_parameters_of_a_trajectory_are_calibrated(name):
    calls, text = TRAJECTORIES[name]
    true = trajectory_problem(text)
    measured = kf.simulate(true.model, DATA, true.parameters)["y"].values
    data = kf.Dataset.of("drive", {"u": U, "z": measured}, time=DATA.time)
    start = true.parameters.with_parameters(kf.Scalar("k", 0.7, lower=0.0), kf.Scalar("T", 1.5, lower=0.2, upper=1.5))
    result = run(trajectory_problem(calls, ("k", "T"), (data,), start), Options())
    assert result.status == "converged"
    assert result.parameters["k"].value == pytest.approx(1.5, rel=1e-6)
    assert result.parameters["T"].value == pytest.approx(0.5, rel=1e-6)


def test_locked_values_are_not_changed_for_slopes():
    problem = trajectory_problem("y = lag.y(C(u))")
    table = problem.parameters["C"]
    locked = problem.parameters.with_parameters(table.changed(locked=np.array([True, False, True, False])))
    compiled = CompiledProblem(replace(problem, parameters=locked))
    assert [value.place for value in compiled._called.trajectories.values if value.table == "C"] == [(1,), (3,)]


@pytest.mark.guests
def test_lookups_before_a_trajectory_are_not_smoothed():
    assert not smoothable(trajectory_problem("y = C(lag.y(u))"))
    assert smoothable(problem("y = C(f(u, a))"))


def test_breakpoints_before_a_trajectory_cannot_be_fitted():
    problem = trajectory_problem("y = lag.y(C(u)) * a")
    table = problem.parameters["C"]
    free = problem.parameters.with_parameters(table.changed(axes=(kf.Axis(AXIS, "u", free=True),)))
    [finding] = check_problem(replace(problem, parameters=free))
    assert str(finding).startswith("axis C.x: its breakpoints are free, and lag depends on them through whole")
    behind = trajectory_problem("y = lag.y(u) * C(u)")
    assert not list(trajectory_findings(replace(behind, parameters=free)))


def test_slopes_that_do_not_fit_into_memory_are_refused(monkeypatch):
    monkeypatch.setattr("kennfeld.optimize.problem.validation.MAX_BYTES", 8 * 300 * 5)
    [finding] = trajectory_findings(trajectory_problem("y = lag.y(C(u))"))
    assert "slopes of lag along 6 free values at all samples need 1.44e-05 GB of memory" in str(finding)


@pytest.mark.guests
def test_a_call_in_a_loop_is_a_remark():
    [remark] = problem(PAIRS["loop"][0]).model.remarks
    assert str(remark) == "formula: f is called in a loop, so its code runs sample by sample, which is slow"
    assert not problem(PAIRS["lagged"][0]).model.remarks
