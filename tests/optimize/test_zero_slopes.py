"""Starts that cannot move: they are detected, left with few changes, and never called converged."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.ends.zero_slopes import departure
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.project.demo import torque

RANDOM = np.random.default_rng(0)
U, V, W = RANDOM.uniform(0, 5, (3, 400))
GRID = np.arange(6.0)
A, B = 10 + 3 * np.sin(GRID), 2 + np.cos(GRID)
DATA = {"u": U, "v": V, "w": W, "t": np.interp(U, GRID, A) * np.interp(V, GRID, B)}


def curve(name, values=0.0, **attributes):
    return kf.Curve(name, GRID, np.broadcast_to(values, 6), **attributes)


def departed(text, *parameters, data=DATA, **arguments):
    problem = ProblemSetup(text, data, kf.ParameterSet(parameters), "t", node="y", **arguments).problem()
    compiled = CompiledProblem(problem)
    limits = linear_limits(problem, compiled.values)
    start, _ = project(compiled.start[: compiled.values.free], limits)
    return departure(LeastSquaresObjective(compiled), compiled, start, limits)


def fitted(text, *parameters, data=DATA, **arguments):
    return kf.calibrate(text, data, kf.ParameterSet(parameters), "t", node="y", **arguments)


def rmse(result):
    return result.quality[0].rmse_after


SCALARS = [kf.Scalar(name, 0.0) for name in "abc"]


@pytest.mark.parametrize(
    ("text", "parameters", "stuck", "levels"),
    [
        ("y = A(u) * B(v)", [curve("A"), curve("B")], ("A", "B"), {"B": 1.0}),
        ("y = A(u) * B(v) + a", [curve("A"), curve("B"), SCALARS[0]], ("A", "B"), {"B": 1.0}),
        ("y = A(u) * B(v) * a", [curve("A"), curve("B"), SCALARS[0]], ("A", "B", "a"), {"B": 1.0, "a": 1.0}),
        ("y = A(u) * (B(v) + a)", [curve("A"), curve("B"), SCALARS[0]], ("A", "B", "a"), {"a": 1.0}),
        ("y = A(u) * a + B(v) * b", [curve("A"), curve("B"), *SCALARS[:2]], ("A", "a", "B", "b"), {"a": 1.0, "b": 1.0}),
        ("y = abs(a) * u", SCALARS[:1], ("a",), {"a": 1.0}),
        ("y = max(0, a * u)", SCALARS[:1], ("a",), {"a": 1.0}),
        ("y = 1e-9 * a^2 * u", SCALARS[:1], ("a",), {"a": 1e4}),
    ],
)
def test_the_fewest_parameters_leave_zero(text, parameters, stuck, levels):
    moved = departed(text, *parameters)
    assert moved.stuck == stuck
    assert moved.levels == levels


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_a_square_of_any_size_at_zero_is_fitted(scale):
    result = fitted(f"y = {scale} * a^2 * u", SCALARS[0], data=DATA | {"t": 4 * U})
    assert result.converged
    assert abs(result.parameters["a"].value) == pytest.approx(2 / np.sqrt(scale), rel=1e-6)


def test_parameters_without_a_unit_are_the_factors():
    moved = departed("y = A(u) * B(v)", curve("A", unit="-"), curve("B", unit="Nm"))
    assert moved.levels == {"A": 1.0}


@pytest.mark.parametrize(
    ("text", "parameters"),
    [
        ("y = A(u) + B(v)", [curve("A"), curve("B")]),
        ("y = A(u) * B(v)", [curve("A"), curve("B", 1.0)]),
        ("y = A(u) * B(v)", [curve("A"), curve("B", locked=True)]),
        ("y = A(u) * a", [curve("A"), kf.Scalar("a", 0.0, lower=0.0, upper=0.0)]),
        ("y = A(a * u)", [curve("A"), SCALARS[0]]),
        ("y = if(a > 0.5, b * u, 0)", SCALARS[:2]),
        ("y = A(100 + u)", [curve("A")]),
        ("y = A(u) / a", [curve("A"), SCALARS[0]]),
    ],
    ids=["sum", "one factor", "locked factor", "bounded factor", "lookup", "condition", "outside the data", "failing"],
)
def test_starts_that_can_move_or_cannot_be_improved_stay(text, parameters):
    assert departed(text, *parameters) is None


def test_a_product_of_two_tables_of_zeros_is_fitted():
    result = fitted("y = A(u) * B(v)", curve("A"), curve("B"))
    assert result.converged
    assert rmse(result) < 1e-6
    assert (
        "The search could not move from the start: all derivatives of A and B vanish at 0. "
        "It started with B = 1 instead of 0." in result.message
    )
    assert result.start["B"].values.tolist() == [0.0] * 6
    assert all(result.trust.informed[name].all() for name in "AB")


def test_the_torque_formula_is_fitted_from_zeros_as_from_a_good_start():
    data, start = torque.bench(), torque.start()
    start = start.with_parameters(*(p.with_values(np.zeros(p.values.shape)) for p in start.values()))
    options = kf.Options(continuation="off")
    result = kf.calibrate(torque.FORMULA, data, start, "Torque", smoothness=torque.SMOOTHNESS, options=options)
    assert result.converged
    assert rmse(result) < 2.0
    assert all(result.parameters[name].values.any() for name in start)
    assert "CurveEtaDeltaSpark = 1 instead of 0" in result.message


def test_bounds_locks_and_pins_hold_if_a_start_is_moved():
    locked = np.arange(6) == 2
    pins = [kf.Pin("B", (3.5,), 0.4)]
    member = curve("B", lower=-0.5, upper=0.5, locked=locked)
    result = fitted("y = A(u) * B(v)", curve("A"), member, pins=pins)
    values = result.parameters["B"].values
    assert values[2] == 0.0
    assert np.all((values >= -0.5) & (values <= 0.5))
    assert np.interp(3.5, GRID, values) == pytest.approx(0.4, abs=1e-9)
    assert rmse(result) < 0.5 * result.quality[0].rmse_before


def test_a_factor_that_may_only_be_negative_moves_down():
    moved = departed("y = A(u) * a", curve("A", upper=0.0, lower=-100), kf.Scalar("a", 0.0, lower=-0.5, upper=0.0))
    assert moved.levels == {"a": -0.5}


def test_zeros_at_the_optimum_stay():
    nothing = DATA | {"t": np.zeros(400)}
    result = fitted("y = A(u) * B(v)", curve("A"), curve("B"), data=nothing)
    assert result.converged
    assert not result.parameters["A"].values.any()
    assert not result.parameters["B"].values.any()


def test_zeros_that_no_move_within_the_bounds_improves_stay():
    below = DATA | {"t": -DATA["t"]}
    result = fitted("y = A(u) * B(v)", curve("A", lower=0.0), curve("B", lower=0.0), data=below)
    assert result.converged
    assert not result.parameters["B"].values.any()
    assert "could not move" not in result.message


@pytest.mark.slow
def test_a_value_at_its_bound_that_switches_another_off_does_not_count_as_a_saddle():
    data = DATA | {"t": 2 * U}
    result = fitted("y = a * u + b * c * (v - 10)^2", *SCALARS[:2], kf.Scalar("c", 1.0), data=data)
    assert result.converged
    assert rmse(result) < 1e-9


@pytest.mark.slow
def test_a_descent_that_ends_at_a_saddle_continues():
    """The coordinate of the table is clipped at its end until the table has a slope there."""
    data = DATA | {"t": 1.0 + np.interp(2 * V, GRID, B) * U}
    result = fitted("y = b * u + c * w * B(a * v)", *SCALARS, curve("B"), data=data)
    assert rmse(result) < result.quality[0].rmse_before
    informed = result.trust.informed
    assert all(np.asarray(informed[name]).any() for name in "abcB")


def test_steps_of_a_sequence_that_fit_one_factor_each_do_not_stay_at_zero():
    steps = [kf.Step(free=["A"]), kf.Step(free=["B"]), kf.Step()]
    result = fitted("y = A(u) * B(v)", curve("A"), curve("B"), options=kf.Options(steps=steps))
    assert result.converged
    assert rmse(result) < 1e-6


@pytest.mark.slow
def test_the_first_of_several_starts_moves():
    options = kf.Options(starts=2, workers=1)
    result = fitted("y = A(u) * B(v)", curve("A"), curve("B"), options=options)
    assert all(row.cost_after < 1e-6 for row in result.starts)


@pytest.mark.slow
@pytest.mark.parametrize("smoothness", [1e-3, pytest.param("auto", marks=pytest.mark.slow)])
def test_a_start_without_slope_is_detected_despite_smoothness(smoothness):
    result = fitted("y = A(u) * B(v)", curve("A"), curve("B"), smoothness=smoothness)
    assert rmse(result) < 0.1 * result.quality[0].rmse_before


def test_a_model_with_memory_leaves_zero():
    time = 0.1 * np.arange(400)
    data = kf.Dataset.of("drive", {"u": np.repeat(U[:20], 20), "v": np.repeat(V[:10], 40)}, time=time)
    truth = kf.ParameterSet([curve("A", A), curve("B", B), kf.Scalar("T", 0.7)])
    text = "y = PT1(A(u) * B(v), T)"
    data = data.with_channels(kf.Channel("t", kf.simulate(text, data, truth)["y"].values))
    result = fitted(text, curve("A"), curve("B"), kf.Scalar("T", 0.0), data=data)
    assert result.converged
    assert result.parameters["T"].value == pytest.approx(0.7, abs=1e-3)
    assert rmse(result) < 1e-4


@pytest.mark.slow
def test_leaving_a_start_is_reproducible():
    ends = [fitted("y = A(u) * B(v)", curve("A"), curve("B")).parameters["A"].values for _ in range(2)]
    assert np.array_equal(*ends)


@pytest.mark.parametrize(
    ("text", "target", "start"),
    [
        ("y = max(0, a*u - 5)", lambda u: np.maximum(0, 4 * u - 5), 0.0),
        ("y = min(a*u, 1)", lambda u: np.minimum(0.3 * u, 1), 50.0),
        ("y = if(u > a, 1, 0)", lambda u: 1.0 * (u > 1.5), 0.5),
    ],
    ids=["dead zone", "saturation", "threshold"],
)
def test_an_end_without_any_slope_has_not_converged(text, target, start):
    u = np.linspace(0.1, 3, 50)
    result = kf.calibrate(text, {"u": u, "z": target(u)}, {"a": start}, "z")
    assert result.status == "failed"
    assert result.message.startswith("All derivatives are zero")


LOCKED = np.array([True, True, False, False])
PIN = kf.Pin("C", (2.0,), 5.0)
STEP = kf.Equality([kf.Term("C", (3.0,)), kf.Term("C", (2.0,), -1.0)], 1.0)


def fitted_beside_locked_values(upper=np.inf, **limits):
    """Fit a curve whose values at the data are locked."""
    u = np.linspace(0.0, 1.0, 21)
    start = kf.Curve("C", [0, 1, 2, 3], [1.0, 2.0, 0.0, 0.0], locked=LOCKED, upper=upper)
    return kf.calibrate("y = C(u)", {"u": u, "z": 1 + u**2}, kf.ParameterSet([start]), "z", **limits)


@pytest.mark.parametrize(
    ("limits", "values"),
    [
        ({"pins": [PIN], "constraints": [STEP]}, [5.0, 6.0]),
        ({"upper": 3.0, "constraints": [kf.Equality([kf.Term("C", (2.0,)), kf.Term("C", (3.0,))], 6.0)]}, [3.0, 3.0]),
        ({"upper": [9, 9, 4.0, 9], "constraints": [STEP, kf.Equality([kf.Term("C", (2.5,))], 4.5)]}, [4.0, 5.0]),
    ],
    ids=["pin and equality", "bounds and equality", "two equalities"],
)
def test_values_that_limits_determine_are_the_best_ones_without_any_slope(limits, values):
    result = fitted_beside_locked_values(**limits)
    assert result.converged, result.message
    assert result.parameters["C"].values[2:] == pytest.approx(values)


def test_values_that_limits_leave_free_do_not_converge_without_any_slope():
    assert fitted_beside_locked_values(pins=[PIN]).status == "failed"
