"""Calibrations from start to result: limits, weights, memory, and ends of every kind."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.criteria import ROBUST_LOSSES
from kennfeld.optimize.fit.fit import FitRun, default_tolerance
from kennfeld.optimize.fit.result import Seconds
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.setup import ProblemSetup
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from tests.native import reference

X = np.linspace(0.0, 3.0, 61)
WAVE = {"x": X, "y": 2 + np.sin(2 * X)}
BREAKPOINTS = np.linspace(0, 3, 7)


def curve(values=1.0, **attributes):
    return kf.Curve("C", BREAKPOINTS, np.broadcast_to(values, 7), **attributes)


def fitted(member, data=WAVE, text="m = C(x)", **arguments):
    return kf.calibrate(text, data, kf.ParameterSet([member]), target="y", **arguments)


def iterates(member, pins=(), text="m = C(x)^3 / 9"):
    """The values of a curve after each accepted step, the projected start first."""
    problem = Problem(
        kf.formula(text),
        (kf.Dataset.of("d", WAVE),),
        kf.ParameterSet([member]),
        (kf.Criterion("m", "y"),),
        pins=tuple(pins),
    )
    exact = CompiledProblem(problem)
    objective, limits = LeastSquaresObjective(exact), linear_limits(problem, exact.values)
    start, _ = project(objective.start, limits)
    steps = [start]
    levenberg_marquardt(objective, start, limits, SolverSettings(), lambda line, values: steps.append(values.copy()))
    assert len(steps) > 2
    return steps


def test_bounds_and_locks_hold_bit_for_bit_at_every_iterate():
    lower, upper = np.full(7, 0.1), np.array([2.1, 2.2, 2.3, 2.0 / 3, 2.5, 2.6, 2.7])
    locked = np.arange(7) == 2
    for values in iterates(curve(0.3, lower=lower, upper=upper, locked=locked)):
        assert np.all((values >= lower) & (values <= upper))
        assert values[2] == 0.3


def test_pins_hold_at_every_iterate():
    pins = [kf.Pin("C", (0.7,), 1.3), kf.Pin("C", (3.0,), 2.0), kf.Pin("C", (1.25,), 0.9)]
    for values in iterates(curve(1.5, lower=0.0, upper=2.4), pins):
        for pin in pins:
            assert np.interp(pin.at[0], BREAKPOINTS, values) == pytest.approx(pin.value, rel=1e-9)


@pytest.mark.parametrize("at", [0.0, 0.75, 1.0])
def test_a_pin_of_zero_holds(at):
    result = fitted(curve(5.0), pins=[kf.Pin("C", (at,), 0.0)])
    assert result.status == "converged"
    assert np.interp(at, BREAKPOINTS, result.parameters["C"].values) == pytest.approx(0.0, abs=1e-9)


def test_a_pin_that_locked_values_satisfy_holds():
    locked = np.arange(7) < 2
    values = np.array([0.1, 0.3, 1, 1, 1, 1, 1])
    result = fitted(curve(values, locked=locked, upper=2.5), pins=[kf.Pin("C", (0.35,), 0.1 * 0.3 + 0.3 * 0.7)])
    assert result.status == "converged"
    assert np.all(result.parameters["C"].values <= 2.5)


@pytest.mark.parametrize(
    ("member", "pins"),
    [
        (curve(), [kf.Pin("C", (0.0,), 1.0), kf.Pin("C", (0.0,), 2.0)]),
        (curve(upper=2.0), [kf.Pin("C", (0.2,), 3.0)]),
        (curve(locked=True), [kf.Pin("C", (0.2,), 3.0)]),
        (curve(locked=np.arange(7) < 2), [kf.Pin("C", (0.2,), 3.0)]),
        (curve(1e-12, lower=0.0, upper=5e-12), [kf.Pin("C", (0.0,), 1e-10)]),
    ],
    ids=["each other", "a bound", "locks", "some locks", "a bound of tiny values"],
)
def test_contradictory_pins_make_the_problem_infeasible(member, pins):
    result = fitted(member, pins=pins)
    assert result.status == "infeasible"
    assert "pin" in result.message
    assert result.parameters["C"] == member


def test_a_start_outside_its_bounds_is_moved_with_a_message():
    result = fitted(curve(9.0, upper=2.5))
    assert "3" not in result.message
    assert "7 start values outside the bounds were clipped" in result.message
    assert np.all(result.parameters["C"].values <= 2.5)


def test_a_start_that_misses_a_pin_is_moved_with_a_message():
    assert "The start violated its limits" in fitted(curve(), pins=[kf.Pin("C", (0.2,), 3.0)]).message


@pytest.mark.parametrize("points", [7, 90], ids=["rows", "normal equations"])
def test_values_without_data_keep_their_start_exactly_with_a_message(points):
    breakpoints = np.linspace(0, 6, points)
    member = kf.Curve("C", breakpoints, np.full(points, 0.1))
    result = fitted(member)
    beyond = breakpoints > 3.0 + breakpoints[1]
    assert result.parameters["C"].values[beyond].tolist() == [0.1] * int(beyond.sum())
    assert "kept at their start values" in result.message
    assert not result.trust.informed["C"][beyond].any()


def test_smoothness_informs_values_without_data():
    result = fitted(kf.Curve("C", np.linspace(0, 6, 13), np.full(13, 0.1)), smoothness=1e-3)
    assert result.trust.informed["C"].all()
    assert "kept at their start values" not in result.message


def test_a_problem_with_all_values_locked_has_converged():
    result = fitted(curve(locked=True))
    assert (result.status, result.iterations, result.free_values) == ("converged", 0, 0)
    assert result.cost_after == result.cost_before


@pytest.mark.parametrize("weights", [(1.0, 3.0), (2.0, 0.5)])
def test_weights_of_criteria_multiply_squares(weights):
    data = {"x": [0.0, 0.0], "a": [1.0, 1.0], "b": [5.0, 5.0]}
    criteria = [kf.Criterion("m", "a", weights[0]), kf.Criterion("m", "b", weights[1])]
    result = kf.calibrate("m = k + 0 * x", data, {"k": 0.0}, criteria=criteria)
    assert result.parameters["k"].value == pytest.approx(np.average([1.0, 5.0], weights=weights))
    assert result.cost_before == pytest.approx(2 * weights[0] + 50 * weights[1])


def test_weights_of_datasets_multiply_squares():
    data = [
        kf.Dataset.of("a", {"x": [0.0], "y": [1.0]}, weight=3.0),
        kf.Dataset.of("b", {"x": [0.0, 0.0], "y": [5.0, 5.0]}, weight=0.5),
    ]
    result = kf.calibrate("m = k + 0 * x", data, {"k": 0.0}, target="y")
    assert result.parameters["k"].value == pytest.approx((3 * 1 + 2 * 0.5 * 5) / 4)


def test_a_weight_of_zero_switches_off():
    data = [
        kf.Dataset.of("a", {"x": [0.0], "y": [1.0], "z": [7.0]}),
        kf.Dataset.of("b", {"x": [0.0], "y": [5.0], "z": [7.0]}, weight=0.0),
    ]
    criteria = [kf.Criterion("m", "y"), kf.Criterion("m", "z", weight=0.0)]
    assert kf.calibrate("m = k + 0 * x", data, {"k": 0.0}, criteria=criteria).parameters["k"].value == pytest.approx(1)


def test_a_scale_divides_the_error():
    data = {"x": [0.0, 0.0], "y": [4.0, 4.0]}
    result = kf.calibrate("m = k + 0 * x", data, {"k": 0.0}, criteria=[kf.Criterion("m", "y", scale=2.0)])
    assert result.cost_before == pytest.approx(2 * (4 / 2) ** 2)
    assert result.parameters["k"].value == pytest.approx(4.0)


@pytest.mark.parametrize("loss", ROBUST_LOSSES)
def test_losses_are_those_of_the_reference(loss):
    criterion = kf.Criterion("m", "y", loss=loss, delta=0.5, scale=2.0)
    result = kf.calibrate("m = k * x", {"x": [1.0], "y": [8.0]}, {"k": 2.0}, criteria=[criterion])
    assert result.cost_before == pytest.approx(reference.loss(np.array(-3.0), loss, 0.5)[0])


@pytest.mark.parametrize("loss", ROBUST_LOSSES)
def test_robust_losses_are_not_misled_by_outliers(loss):
    random = np.random.default_rng(0)
    y = 3 * X - 1 + 0.01 * random.standard_normal(X.size)
    y[::9] += 40.0
    criterion = kf.Criterion("m", "y", loss=loss, delta=0.02)
    result = kf.calibrate("m = a * x + b", {"x": X, "y": y}, {"a": 0.0, "b": 0.0}, criteria=[criterion])
    assert result.status == "converged"
    assert result.parameters["a"].value == pytest.approx(3.0, abs=0.02)


def test_a_target_may_be_a_number_a_node_or_a_channel():
    text = "m = k + 0 * x\nother = 2 * x"
    for target, expected in ((4.0, 4.0), ("other", 2.0), ("y", 9.0)):
        result = kf.calibrate(text, {"x": [1.0], "y": [9.0]}, {"k": 0.0}, target=target, node="m")
        assert result.parameters["k"].value == pytest.approx(expected)


def test_a_target_node_may_depend_on_free_values():
    result = kf.calibrate("m = k * x\nother = 6 - k", {"x": [1.0, 2.0]}, {"k": 0.0}, target="other", node="m")
    assert result.parameters["k"].value == pytest.approx((6 * 2 + 6 * 3) / (4 + 9))


def test_a_missing_target_removes_the_sample_from_its_criterion_only():
    data = {"x": [0.0, 0.0], "a": [1.0, np.nan], "b": [np.nan, 5.0]}
    criteria = [kf.Criterion("m", "a"), kf.Criterion("m", "b")]
    result = kf.calibrate("m = k + 0 * x", data, {"k": 0.0}, criteria=criteria)
    assert result.parameters["k"].value == pytest.approx(3.0)
    assert [row.samples for row in result.quality] == [1, 1]


def test_a_dataset_without_samples_does_not_affect_the_others():
    data = [{"x": [np.nan, np.nan], "y": [1.0, 2.0]}, {"x": [1.0, 2.0], "y": [2.0, 4.0]}]
    result = kf.calibrate("m = k * x", data, {"k": 0.0}, target="y")
    assert result.parameters["k"].value == pytest.approx(2.0)
    assert [row.samples for row in result.quality] == [0, 2]


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_the_fit_does_not_depend_on_the_unit_of_a_target(scale):
    result = fitted(curve(0.0), {"x": X, "y": scale * WAVE["y"]})
    reference = fitted(curve(0.0))
    assert result.status == "converged"
    np.testing.assert_allclose(result.parameters["C"].values / scale, reference.parameters["C"].values, rtol=1e-6)


def test_a_request_to_stop_ends_with_the_best_values():
    def stop(line):
        if line.iteration == 2:
            raise kf.Stop

    text = "m = a * exp(b * x)"
    result = kf.calibrate(text, {"x": X, "y": np.exp(-X)}, {"a": 3.0, "b": 1.0}, target="y", progress=stop)
    assert (result.status, result.iterations) == ("stopped", 2)
    assert result.cost_after == result.trace[-1].cost < result.cost_before


def test_a_start_where_the_model_fails_is_a_failure():
    result = kf.calibrate("m = log(k * x)", {"x": [1.0, 2.0], "y": [0.0, 1.0]}, {"k": -1.0}, target="y")
    assert result.status == "failed"
    assert result.parameters["k"].value == -1.0
    assert result.as_json()["cost"] == {"before": None, "after": None}


def test_reaching_the_iteration_limit_is_a_status():
    text = "m = a * exp(b * x)"
    options = Options(max_iterations=1)
    result = kf.calibrate(text, {"x": X, "y": np.exp(-X)}, {"a": 3.0, "b": 1.0}, target="y", options=options)
    assert (result.status, result.iterations) == ("max_iterations", 1)


def recording(samples=1500, step=0.1, seed=0):
    """Speed, quantity and air mass that wander, at an even step."""
    random = np.random.default_rng(seed)
    moves = np.cumsum(random.standard_normal((3, samples)), axis=1) / 4
    return {name: np.sin(m) for name, m in zip(("n", "q", "air"), moves, strict=True)}, step * np.arange(samples)


EXHAUST = "static = MapT(n, q)\nm = PT1(static, CurveTau(air))"
GRID = np.linspace(-1, 1, 5)


def exhaust(heat, tau, **attributes):
    return kf.ParameterSet(
        [kf.Map("MapT", GRID, GRID, heat), kf.Curve("CurveTau", np.linspace(-1, 1, 3), tau, **attributes)]
    )


def test_the_exhaust_model_recovers_its_values_from_data_without_noise():
    columns, time = recording()
    truth = exhaust(300 + 100 * np.add.outer(GRID, GRID**2), [2.0, 1.0, 0.4])
    measured = kf.simulate(EXHAUST, kf.Dataset.of("d", columns, time=time), truth)["m"].values
    data = kf.Dataset.of("d", columns | {"y": measured}, time=time)
    start = exhaust(np.full((5, 5), 250.0), [1.0, 1.0, 1.0])
    result = kf.calibrate(EXHAUST, data, start, target="y", node="m", options=Options(tolerance=1e-12))
    assert result.status == "converged"
    np.testing.assert_allclose(result.parameters["CurveTau"].values, [2.0, 1.0, 0.4], rtol=1e-5)
    np.testing.assert_allclose(result.parameters["MapT"].values, truth["MapT"].values, rtol=1e-5)


def test_every_piece_of_a_recording_starts_its_states_anew():
    columns, time = recording(300)
    truth = exhaust(np.add.outer(GRID, GRID), [2.0, 1.0, 0.4])
    whole = kf.Dataset.of("d", columns, time=time, piece_starts=[0, 100, 120])
    measured = kf.simulate(EXHAUST, whole, truth)
    pieces = [slice(0, 100), slice(100, 120), slice(120, 300)]
    for piece in pieces:
        alone = kf.Dataset.of("p", {n: v[piece] for n, v in columns.items()}, time=time[piece])
        np.testing.assert_allclose(measured["m"].values[piece], kf.simulate(EXHAUST, alone, truth)["m"].values)
    single = kf.calibrate(
        EXHAUST,
        whole.with_channels(kf.Channel("y", columns["n"])),
        truth,
        target="y",
        node="m",
        options=Options(max_iterations=2),
    )
    parts = [
        kf.Dataset.of(f"p{i}", {n: v[p] for n, v in columns.items()} | {"y": columns["n"][p]}, time=time[p])
        for i, p in enumerate(pieces)
    ]
    several = kf.calibrate(EXHAUST, parts, truth, target="y", node="m", options=Options(max_iterations=2))
    assert several.cost_before == pytest.approx(single.cost_before, rel=1e-12)
    assert several.cost_after == pytest.approx(single.cost_after, rel=1e-9)


def test_trial_steps_to_a_negative_time_constant_are_rejected():
    columns, time = recording(400)
    truth = exhaust(np.add.outer(GRID, GRID), [0.02, 0.01, 0.01])
    measured = kf.simulate(EXHAUST, kf.Dataset.of("d", columns, time=time), truth)["m"].values
    data = kf.Dataset.of("d", columns | {"y": measured}, time=time)
    result = kf.calibrate(EXHAUST, data, exhaust(np.zeros((5, 5)), [3.0, 3.0, 3.0]), target="y", node="m")
    assert result.status == "converged"
    assert np.all(np.isfinite([line.cost for line in result.trace]))
    assert np.all(np.interp(columns["air"], np.linspace(-1, 1, 3), result.parameters["CurveTau"].values) >= 0)


def test_a_negative_time_constant_at_the_start_is_moved_to_zero():
    columns, time = recording(50)
    data = kf.Dataset.of("d", columns | {"y": columns["n"]}, time=time)
    start = exhaust(np.zeros((5, 5)), [-1.0, -1.0, -1.0])
    result = kf.calibrate(EXHAUST, data, start, target="y", node="m")
    assert result.status == "converged"
    assert "3 start values outside the bounds were clipped" in result.message
    assert np.all(result.parameters["CurveTau"].values >= 0)


def test_values_before_a_dead_time_of_several_steps_are_recovered():
    columns, time = recording(500)
    text = "m = gain * delay(C(n) + offset * q, 7, 0) + prev(C(q), 0)"
    breakpoints = np.linspace(-1, 1, 5)
    truth = kf.ParameterSet(
        [kf.Scalar("gain", 2.0, locked=True), kf.Scalar("offset", 0.7), kf.Curve("C", breakpoints, breakpoints**3)]
    )
    measured = kf.simulate(text, kf.Dataset.of("d", columns, time=time), truth)["m"].values
    data = kf.Dataset.of("d", columns | {"y": measured}, time=time)
    start = truth.with_parameters(kf.Scalar("offset", 0.0), kf.Curve("C", breakpoints, np.zeros(5)))
    result = kf.calibrate(text, data, start, target="y")
    assert result.parameters["offset"].value == pytest.approx(0.7, rel=1e-6)
    np.testing.assert_allclose(result.parameters["C"].values, breakpoints**3, atol=1e-7)


def test_free_patterns_choose_what_is_fitted():
    result = kf.calibrate("m = a * x + b", {"x": X, "y": 2 * X + 1}, {"a": 0.0, "b": 0.5}, target="y", free=["a*"])
    assert result.parameters["b"].value == 0.5
    assert (result.free_values, result.fixed_values) == (1, 1)


def test_a_calibration_does_not_change_its_arguments():
    values = np.full(7, 0.5)
    member = curve(values)
    columns = {name: column.copy() for name, column in WAVE.items()}
    fitted(member, columns)
    assert member.values.tolist() == values.tolist() == [0.5] * 7
    assert all(np.array_equal(columns[name], WAVE[name]) for name in WAVE)


def test_a_weight_does_not_enter_the_rmse_of_the_trace():
    data = {"x": [1.0, 2.0], "y": [3.0, 3.0]}
    result = kf.calibrate("m = k * x", data, {"k": 0.0}, criteria=[kf.Criterion("m", "y", weight=100.0)])
    assert result.trace[-1].rmse == pytest.approx(result.quality[0].rmse_after)


@pytest.mark.slow
def test_values_without_information_keep_their_start():
    start = kf.ParameterSet([kf.Scalar("k", 2.0), kf.Curve("C", [0, 1, 2, 3], [0.0, 1.0, 2.0, 3.0])])
    x = np.linspace(0, 1, 50)
    options = kf.Options(tolerance=1e-3)
    result = kf.calibrate("m = C(k * x)", {"x": x, "y": 0.2 * x}, start, target="y", options=options)
    unseen = ~result.trust.informed["C"]
    assert unseen.any()
    assert result.parameters["C"].values[unseen].tolist() == start["C"].values[unseen].tolist()


@pytest.mark.parametrize(
    ("count", "samples", "tolerance"), [(5, 40, 1e-8), (10, 400, 3e-5), (10, 200_000, 2.5e-5), (4, 400_000, 2e-6)]
)
def test_a_descent_without_a_tolerance_ends_at_the_resolution_of_the_data(count, samples, tolerance):
    random = np.random.default_rng(0)
    data = {name: random.random(samples) for name in ("u", "v", "y")}
    axis = np.linspace(0, 1, count)
    start = kf.ParameterSet([kf.Map("A", axis, axis, np.zeros((count, count)))])
    compiled = CompiledProblem(ProblemSetup("m = A(u, v)", data, start, "y").problem())
    assert compiled.residuals == samples
    assert default_tolerance(compiled, LeastSquaresObjective(compiled)) == pytest.approx(tolerance)


@pytest.mark.parametrize(
    ("text", "count", "samples", "tolerance", "significant"),
    [
        ("m = C(A(u, v))", 10, 2000, None, 1e-3),
        ("m = C(A(u, v))", 10, 60_000, None, 0.05 * 110 / 60_000),
        ("m = C(A(u, v))", 10, 2000, 1e-6, 0.0),  # as asked for
        ("m = C(A(u, v))", 7, 2000, None, 0.0),  # few values are solved to the last digit
        ("m = A(u, v) + C(v)", 10, 2000, None, 0.0),  # without kinks
    ],
)
def test_slopes_at_kinks_have_to_promise_what_the_data_can_distinguish(text, count, samples, tolerance, significant):
    random = np.random.default_rng(0)
    data = {name: random.random(samples) for name in ("u", "v", "y")}
    axis = np.linspace(0, 1, count)
    start = kf.ParameterSet([kf.Map("A", axis, axis, np.zeros((count, count))), kf.Curve("C", axis, axis)])
    problem = ProblemSetup(text, data, start, "y").problem()
    run = FitRun(problem, kf.Options(tolerance=tolerance), None, Seconds())
    assert run.significant == pytest.approx(significant)


@pytest.mark.parametrize("start", [0.0, -1000.0, 1e-8])
def test_the_factor_of_a_line_through_an_inner_point_is_exact(start):
    """A step of a linear function is exact, so that what remains is rounding."""
    x = np.linspace(0, 100, 101)
    result = kf.calibrate("y = a * (x - 50)", {"x": x, "m": 3 * (x - 50)}, {"a": start}, target="m")
    assert result.parameters["a"].value == pytest.approx(3.0, rel=1e-13)


def test_a_sequence_that_starts_at_an_optimum_ends_there():
    x = np.random.default_rng(0).uniform(0, 10, 300)
    data = {"x": x, "m": np.sin(x) + 0.1 * np.cos(37 * x)}
    curve = kf.ParameterSet([kf.Curve("C", np.linspace(0, 10, 11), np.zeros(11))])
    optimum = kf.calibrate("y = C(x)", data, curve, target="m")
    options = kf.Options(steps=(kf.Step(grid_reduction=5), kf.Step(grid_reduction=2), kf.Step()))
    result = kf.calibrate("y = C(x)", data, optimum.parameters, target="m", options=options)
    assert result.converged
    assert result.cost_after == pytest.approx(optimum.cost_after, rel=1e-8)
