import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.domain.constraints import Equality, Shape, Term
from kennfeld.domain.free_axes import AxisKey
from kennfeld.models.formula import formula
from kennfeld.optimize import run
from kennfeld.optimize.limits.linear_limits import breakpoint_bounds, linear_limits
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from tests.draws import mostly_slow

KINKS, HEIGHTS = [0, 1.2, 2.1, 6.5, 10.0], [0, 4.0, 1.0, 2.0, 8.0]


def bent(seed=0, noise=0.05, samples=800):
    """Samples of a curve of four straight parts."""
    random = np.random.default_rng(seed)
    x = random.uniform(0, 10, samples)
    return {"x": x, "y": np.interp(x, KINKS, HEIGHTS) + noise * random.standard_normal(samples)}


def even(count=5, **attributes):
    return kf.Curve("C", kf.Axis(np.linspace(0, 10, count), input="x", free=True), np.zeros(count), **attributes)


def fitted(table, data=None, text="m = C(x)", **arguments):
    return kf.calibrate(text, data or bent(), kf.ParameterSet([table]), target="y", **arguments)


def points(result, name="C", axis=0):
    return result.parameters[name].axes[axis].breakpoints


def test_kinks_are_recovered_from_even_breakpoints():
    result = fitted(even())
    assert result.status == "converged"
    np.testing.assert_allclose(points(result), KINKS, atol=0.02)
    np.testing.assert_allclose(result.parameters["C"].values, HEIGHTS, atol=0.06)
    assert result.quality[0].rmse_after == pytest.approx(0.05, rel=0.1)


def test_exact_kinks_are_recovered_exactly():
    result = fitted(even(), bent(noise=0.0))
    np.testing.assert_allclose(points(result), KINKS, atol=1e-6)
    assert result.cost_after < 1e-10


@pytest.mark.parametrize("seed", mostly_slow(range(6), [1]))
def test_the_end_equals_that_of_a_start_at_the_truth(seed):
    random = np.random.default_rng(seed)
    while True:
        kinks = np.array([0, *np.sort(random.uniform(0, 10, 4)), 10])
        if np.diff(kinks).min() > 0.6:
            break
    heights, x = random.uniform(-5, 5, 6), random.uniform(0, 10, 600)
    data = {"x": x, "y": np.interp(x, kinks, heights) + 0.05 * random.standard_normal(600)}
    truth = kf.Curve("C", kf.Axis(kinks, free=True), heights)
    assert fitted(even(6), data).cost_after <= 1.01 * fitted(truth, data).cost_after


def test_the_ends_stay_bit_for_bit_and_the_start_is_not_changed():
    start = even()
    result = fitted(start)
    assert points(result)[[0, -1]].tolist() == [0.0, 10.0]
    np.testing.assert_array_equal(start.axes[0].breakpoints, np.linspace(0, 10, 5))
    assert result.start["C"].axes[0] == start.axes[0]


def test_the_result_lists_moved_breakpoints():
    result = fitted(even())
    before, after = result.moved["C.x"]
    assert before.tolist() == [0.0, 2.5, 5.0, 7.5, 10.0]
    np.testing.assert_array_equal(after, points(result))
    assert result.as_json()["breakpoints"]["C.x"] == {"before": before.tolist(), "after": after.tolist()}
    assert result.free_values == 8
    assert result.fixed_values == 2


def test_axes_can_be_freed_by_name():
    table = kf.Curve("C", np.linspace(0, 10, 5), np.zeros(5))
    np.testing.assert_allclose(points(fitted(table, free_axes=["C.x"])), KINKS, atol=0.02)
    assert points(fitted(table)).tolist() == [0.0, 2.5, 5.0, 7.5, 10.0]


def test_with_a_range_the_ends_move_as_well():
    data = bent()
    data["y"] = np.clip(data["x"], 3.0, 7.0)
    table = kf.Curve("C", kf.Axis([1.0, 9.0], free=True, range=(0, 10)), [0.0, 1.0])
    result = fitted(table, data)
    np.testing.assert_allclose(points(result), [3, 7], atol=1e-6)
    np.testing.assert_allclose(result.parameters["C"].values, [3, 7], atol=1e-6)


def test_a_range_is_never_left():
    data = {"x": np.linspace(0, 10, 400), "y": np.clip(np.linspace(0, 10, 400), 2.0, 9.0)}
    result = fitted(kf.Curve("C", kf.Axis([4.0, 5.0, 6.0], free=True, range=(3.5, 7.0)), np.zeros(3)), data)
    assert points(result)[0] >= 3.5
    assert points(result)[-1] == 7.0


def test_breakpoints_keep_their_distance_and_the_result_says_so():
    axis = kf.Axis(np.linspace(0, 10, 5), free=True, min_distance=1.5)
    result = fitted(kf.Curve("C", axis, np.zeros(5)))
    assert np.diff(points(result)).min() >= 1.5 * (1 - 1e-9)
    assert "Breakpoints of C.x ended at their minimum distance" in result.message
    assert result.status == "converged"


@pytest.mark.slow
def test_more_breakpoints_than_kinks_still_fit():
    result = fitted(even(9), bent(samples=300))
    assert result.status == "converged"
    assert result.quality[0].rmse_after < 0.051


def test_a_group_axis_moves_in_all_its_tables_together():
    data = bent()
    data["z"] = np.interp(data["x"], KINKS, [5, 3, 4, -1, 0])
    axis = kf.Axis(np.linspace(0, 10, 5), name="AxisX", free=True)
    start = kf.ParameterSet([kf.Curve("C", axis, np.zeros(5)), kf.Curve("D", axis, np.zeros(5))])
    criteria = [kf.Criterion("m", "y"), kf.Criterion("n", "z")]
    result = kf.calibrate("m = C(x)\nn = D(x)", data, start, criteria=criteria)
    np.testing.assert_allclose(points(result), KINKS, atol=0.02)
    np.testing.assert_array_equal(points(result, "D"), points(result, "C"))
    assert list(result.moved) == ["AxisX"]


def test_a_table_that_is_not_fitted_prevents_a_group_axis_from_moving():
    axis = kf.Axis(np.linspace(0, 10, 5), name="AxisX", free=True)
    start = kf.ParameterSet([kf.Curve("C", axis, np.zeros(5)), kf.Curve("Other", axis, np.zeros(5))])
    with pytest.raises(InputError, match="axis AxisX: its breakpoints are free, but Other on it is not fitted"):
        kf.calibrate("m = C(x)", bent(), start, target="y")


def test_axes_of_tables_that_are_not_fitted_stay():
    start = kf.ParameterSet([even(), kf.Scalar("k", 0.0)])
    result = kf.calibrate("m = C(x) + k", bent(), start, target="y", free=["k"])
    assert points(result).tolist() == [0.0, 2.5, 5.0, 7.5, 10.0]
    assert result.moved == {}


def test_a_pin_holds_exactly_with_the_breakpoints_around_it():
    result = fitted(even(6), pins=[kf.Pin("C", (5.0,), 3.0)])
    assert points(result)[[2, 3]].tolist() == [4.0, 6.0]
    where = kf.simulate("m = C(x)", {"x": [5.0]}, result.parameters)["m"].values[0]
    assert where == pytest.approx(3.0, abs=1e-8)
    assert points(result)[1] != 2.0


@pytest.mark.slow
def test_breakpoints_of_locked_grid_points_stay():
    locked = np.arange(5) == 2
    result = fitted(even(locked=locked))
    assert points(result)[2] == 5.0
    assert result.parameters["C"].values[2] == 0.0
    assert points(result)[1] != 2.5


@pytest.mark.slow
def test_bounds_of_values_hold_while_breakpoints_move():
    result = fitted(even(upper=6.0, lower=0.5))
    assert result.parameters["C"].values.max() <= 6.0
    assert result.parameters["C"].values.min() >= 0.5


@pytest.mark.slow
def test_the_cost_after_is_that_of_the_breakpoints_after():
    result = fitted(even(), smoothness=0.5)
    after = kf.calibrate(
        "m = C(x)", bent(), result.parameters, target="y", smoothness=0.5, options=kf.Options(max_iterations=1)
    )
    assert after.cost_before == pytest.approx(result.cost_after, rel=1e-9)


def test_breakpoints_of_both_axes_of_a_map_are_recovered():
    random = np.random.default_rng(1)
    x, y = random.uniform(0, 10, (2, 1000))
    target = np.interp(x, [0, 2, 3, 10], [0, 3, 0, 1]) * np.interp(y, [0, 6, 7.5, 10], [1, 1, 2, 0])
    axes = [kf.Axis(np.linspace(0, 10, 4), free=True) for _ in range(2)]
    result = fitted(
        kf.Map("M", *axes, np.zeros((4, 4))),
        {"x": x, "z": y, "y": target + 0.02 * random.standard_normal(1000)},
        "m = M(x, z)",
    )
    np.testing.assert_allclose(points(result, "M", 0), [0, 2, 3, 10], atol=0.05)
    np.testing.assert_allclose(points(result, "M", 1), [0, 6, 7.5, 10], atol=0.05)


@pytest.mark.slow
def test_breakpoints_of_nested_lookups_are_recovered():
    random = np.random.default_rng(2)
    u = random.uniform(0, 10, 1500)
    inner = np.interp(u, [0, 5, 10], [0, 8, 10])
    target = np.interp(inner, [0, 3, 10], [0, 6, 1])
    start = kf.ParameterSet(
        [
            kf.Curve("A", [0, 5, 10], [0.0, 7.0, 10.0], locked=[True, False, True]),
            kf.Curve("B", kf.Axis([0, 5, 10], free=True), np.zeros(3)),
        ]
    )
    result = kf.calibrate("m = B(A(u))", {"u": u, "y": target}, start, target="y")
    assert result.quality[0].rmse_after < 1e-3
    np.testing.assert_allclose(points(result, "B"), [0, 3, 10], atol=0.01)


def test_breakpoints_before_a_memory_are_recovered():
    random = np.random.default_rng(3)
    x = np.repeat(random.uniform(0, 10, 120), 10)
    data = kf.Dataset.of("drive", {"x": x}, time=0.1 * np.arange(x.size))
    truth = kf.ParameterSet([kf.Curve("C", [0, 2, 3, 10], [0, 4, 1, 3])])
    text = "m = PT1(C(x), 0.4)"
    target = kf.simulate(text, data, truth)["m"].values
    data = kf.Dataset.of("drive", {"x": x, "y": target}, time=0.1 * np.arange(x.size))
    result = fitted(even(4), data, text)
    np.testing.assert_allclose(points(result), [0, 2, 3, 10], atol=1e-3)


def problem(*constraints, limits=()):
    model = formula("m = C(x)", parameters=["C"])
    data = (kf.Dataset.of("bench", bent()),)
    criteria = (kf.Criterion("m", "y"),)
    return Problem(model, data, kf.ParameterSet([even()]), criteria, constraints=constraints, limits=limits)


def test_slope_limits_hold_between_breakpoints_that_move():
    result = run(problem(Shape("C", 0, "slope", lower=-1.0, upper=2.0)), kf.Options())
    table = result.parameters["C"]
    slopes = np.diff(table.values) / np.diff(table.axes[0].breakpoints)
    assert slopes.min() >= -1.0 - 1e-8
    assert slopes.max() <= 2.0 + 1e-8
    assert min(abs(slopes - 2).min(), abs(slopes + 1).min()) < 1e-6
    assert "C.x" in result.moved


def test_rows_of_slope_limits_agree_with_the_slopes():
    posed = problem(Shape("C", 0, "slope", lower=-1.0, upper=2.0))
    compiled = CompiledProblem(posed)
    limits = linear_limits(posed, compiled.values)
    at = compiled.values.offsets["C"]
    for steep, allowed in ((2.1, False), (1.9, True), (-1.1, False), (-0.9, True)):
        values = compiled.start.copy()
        values[at : at + 5] = steep * np.linspace(0, 10, 5)
        assert (limits.violation(values) == 0) == allowed


def test_a_limit_of_the_curvature_requires_fixed_breakpoints():
    posed = problem(Shape("C", 0, "curvature", lower=0.0))
    with pytest.raises(InputError, match="the breakpoints along this axis are free"):
        linear_limits(posed, CompiledProblem(posed).values)


def test_breakpoints_around_an_equality_do_not_move():
    posed = problem(Equality([Term("C", (2.5,)), Term("C", (6.0,), -1.0)]))
    axis = posed.free_axes[AxisKey("C", "x")]
    lower, upper = breakpoint_bounds(axis, posed.parameters, posed.held)
    assert (lower == upper).tolist() == [True, True, True, True, True]
    lower, upper = breakpoint_bounds(axis, posed.parameters, [("C", (2.5,))])
    assert (lower == upper).tolist() == [True, True, False, False, True]


def test_a_stop_ends_with_the_best_breakpoints_so_far():
    lines = []

    def stop_when_placed(line):
        lines.append(line)
        if line.stage == "placed":
            raise kf.Stop

    result = fitted(even(), progress=stop_when_placed)
    assert result.status == "stopped"
    assert result.cost_after == min(line.cost for line in lines if line.stage != "dense")


@pytest.mark.slow
def test_breakpoints_move_across_intervals_without_data():
    data = {"x": np.repeat([0.0, 1.0, 2.0, 9.0, 10.0], 20), "y": np.repeat([0.0, 1.0, 2.0, 9.0, 1.0], 20)}
    result = fitted(even(6), data)
    assert result.status == "converged"
    assert result.quality[0].rmse_after < 1e-6


@pytest.mark.slow
def test_limits_of_outputs_hold_while_breakpoints_move():
    result = run(problem(limits=(kf.Limit("m", upper=6.0),)), kf.Options())
    assert result.status == "converged"
    reached = kf.simulate("m = C(x)", bent(), result.parameters)["m"].values
    assert 5.9 < reached.max() <= 6.0 + 1e-5
    assert "C.x" in result.moved


@pytest.mark.slow
def test_creases_of_a_chain_are_smoothed_while_its_free_axis_is_dense():
    random = np.random.default_rng(4)
    u, v = random.uniform(0, 10, (2, 1500))
    best = np.interp(u, np.linspace(0, 10, 6), [1, 4, 2, 6, 8, 5])
    target = np.interp(v - best, [-10, -2, 0.5, 10], [0.2, 0.9, 1.0, 0.1])
    axis = kf.Axis(np.linspace(-10, 10, 4), free=True)
    start = kf.ParameterSet(
        [
            kf.Curve("Best", np.linspace(0, 10, 6), np.full(6, 4.0)),
            kf.Curve("Eta", axis, [0.3, 0.8, 0.8, 0.2]),
        ]
    )
    result = kf.calibrate("m = Eta(v - Best(u))", {"u": u, "v": v, "y": target}, start, target="y")
    assert result.quality[0].rmse_after < 0.005


def cost_of(result):
    """The cost of the parameters of a result, from its simulation."""
    data = bent()
    reached = kf.simulate("m = C(x)", data, result.parameters)["m"].values
    return float(np.sum((reached - data["y"]) ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_several_starts_keep_the_breakpoints_of_the_best(workers):
    result = fitted(even(), options=kf.Options(starts=2, workers=workers))
    np.testing.assert_allclose(points(result), KINKS, atol=0.02)
    assert cost_of(result) == pytest.approx(result.cost_after, rel=1e-9)
    best = min(result.starts, key=lambda row: row.cost_after)
    assert best.cost_after == pytest.approx(result.cost_after, rel=1e-9)


@pytest.mark.slow
def test_breakpoints_do_not_move_in_a_step_that_reduces_the_grid_but_in_the_next():
    steps = (kf.Step(name="few", grid_reduction=2), kf.Step(name="all"), kf.Step(name="again"))
    result = fitted(even(), options=kf.Options(steps=steps))
    stages = {line.stage.split(": ")[1] for line in result.trace if line.stage.startswith("few")}
    assert "placed" not in stages
    np.testing.assert_allclose(points(result), KINKS, atol=0.02)
    assert cost_of(result) == pytest.approx(result.cost_after, rel=1e-9)


@pytest.mark.slow
def test_breakpoints_fitted_by_a_step_stay_in_place_in_the_next():
    data = bent()
    data["y"] += 3.0
    start = kf.ParameterSet([even(), kf.Scalar("k", 0.0)])
    steps = (kf.Step(free=["C"]), kf.Step(free=["k"]))
    result = kf.calibrate("m = C(x) + k", data, start, target="y", options=kf.Options(steps=steps))
    np.testing.assert_allclose(points(result), KINKS, atol=0.02)
    assert result.quality[0].rmse_after == pytest.approx(0.05, rel=0.1)
