"""Sequences of steps, from the problem of one step to what comes out at the end."""

from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld import Step
from kennfeld.domain.constraints import Equality, Shape, Term
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.step_problem import sequence_problem, step_problem, with_fixed_limits
from kennfeld.project.demo import torque

X = np.linspace(0.0, 3.0, 61)
BREAKPOINTS = np.linspace(0, 3, 9)
DATA = {"x": X, "y": 2 + np.sin(2 * X), "z": 1.0 + 0 * X}
TEXT = "m = C(x) * k\nn = k + 0 * x"


def members(**attributes):
    return kf.ParameterSet([kf.Curve("C", BREAKPOINTS, np.ones(9), **attributes), kf.Scalar("k", 1.5)])


CRITERIA = (kf.Criterion("m", "y"), kf.Criterion("n", "z"))


def sequence(*steps, criteria=CRITERIA, parameters=None, **arguments):
    options = kf.Options(steps=steps, **arguments.pop("options", {}))
    start = members() if parameters is None else parameters
    return kf.calibrate(TEXT, DATA, start, criteria=criteria, options=options, **arguments)


def problem(**changes):
    settings = {"smoothness": {"C": 2.0}, "pins": (kf.Pin("C", (1.0,), 2.0),)} | changes
    criteria = (kf.Criterion("m", "y"), kf.Criterion("n", "z", weight=0.0))
    return Problem(
        kf.formula(TEXT, parameters=["C", "k"]), (kf.Dataset.of("d", DATA),), members(), criteria, **settings
    )


def test_a_step_frees_locks_and_smooths_by_name_or_pattern():
    changed = step_problem(problem(), Step(free=["C"], lock={"C*": BREAKPOINTS < 1}, smoothness={"C": 7.0}))
    assert changed.free_names == ("C",)
    assert changed.parameters["C"].locked.tolist() == (BREAKPOINTS < 1).tolist()
    assert changed.factors("C") == (7.0,)
    assert step_problem(problem(), Step(smoothness=3)).factors("C") == (3.0,)
    assert step_problem(problem(), Step()).factors("C") == (2.0,)


def test_a_step_drops_the_pins_of_its_fixed_values():
    assert with_fixed_limits(step_problem(problem(), Step(free=["k"]))).pins == ()
    assert len(with_fixed_limits(step_problem(problem(), Step(free=["C"]))).pins) == 1


def test_an_equality_counts_fixed_values_of_a_step_as_constants():
    sums = Equality([Term("C", (0.75,), 2.0), Term("k", (), -1.0)], 0.3)
    shape = Shape("C", 0, "slope", lower=0.0)
    posed = problem(pins=(), constraints=(sums, shape))
    assert with_fixed_limits(step_problem(posed, Step())).constraints == (sums, shape)
    assert with_fixed_limits(step_problem(posed, Step(free=["C"]))).constraints == (
        Equality([Term("C", (0.75,), 2.0)], 1.8),
        shape,
    )
    assert with_fixed_limits(step_problem(posed, Step(free=["k"]))).constraints == (
        Equality([Term("k", (), -1.0)], -1.7),
    )


def test_another_weight_does_not_change_the_rest_of_a_criterion():
    regions = [kf.Region("q > 1", 4.0)]
    own = kf.Criterion("m", "y", 3.0, "huber", delta=0.5, scale=2.0, weight_channel="q", regions=regions)
    posed = problem()
    (criterion,) = step_problem(replace(posed, criteria=(own,)), Step(criteria={"m": 7.0})).criteria
    assert criterion == replace(own, weight=7.0)


@pytest.mark.parametrize(
    ("criteria", "weights"),
    [
        (None, {"m": 1.0}),
        (["m"], {"m": 1.0}),
        ([1], {"m": 1.0}),
        ({"n": 2.5}, {"n": 2.5}),
        ({1: 3.0, "n": 0.5}, {"m": 3.0, "n": 0.5}),
        ({"m": 0.0, 2: 4.0}, {"n": 4.0}),
    ],
)
def test_a_step_names_its_criteria_and_their_weights(criteria, weights):
    changed = step_problem(problem(), Step(criteria=criteria))
    assert {c.node: c.weight for c in changed.criteria if c.weight} == weights


def test_the_problem_of_a_sequence_frees_values_that_any_step_frees():
    first, second = Step(free=["C"], lock={"C": BREAKPOINTS < 2}), Step(free=["k"])
    union = sequence_problem(problem(), [first, second])
    assert set(union.free_names) == {"C", "k"}
    assert union.parameters["C"].locked.tolist() == (BREAKPOINTS < 2).tolist()
    locking = sequence_problem(problem(), [first, Step(lock={"C": BREAKPOINTS > 1})])
    assert locking.parameters["C"].locked.tolist() == ((BREAKPOINTS > 1) & (BREAKPOINTS < 2)).tolist()


def test_steps_follow_each_other_and_the_trace_names_them():
    result = sequence(Step(free=["k"], criteria=["n"]), Step(name="curve", free=["C"]))
    assert result.parameters["k"].value == pytest.approx(1.0)
    assert result.status == "converged"
    stages = list(dict.fromkeys(line.stage for line in result.trace))
    assert stages == ["step 1: plain", "curve: plain"]
    assert [q.criterion for q in result.quality] == ["m", "n"]
    assert result.cost_after < result.cost_before


def test_a_parameter_that_no_step_frees_keeps_its_values():
    result = sequence(Step(free=["C"]), Step(free=["C"]))
    assert result.parameters["k"].value == 1.5
    assert (result.free_values, result.fixed_values) == (9, 1)


def test_a_step_may_free_fixed_values_of_the_problem():
    result = sequence(Step(free=["k"]), free=["C"])
    assert result.parameters["k"].value != 1.5
    assert result.parameters["C"].values.tolist() == [1.0] * 9


def test_a_coarse_step_ends_on_the_full_grid_with_a_surface_of_the_coarse_one():
    result = sequence(Step(grid_reduction=2))
    values = result.parameters["C"].values
    assert values.shape == (9,)
    assert values[1::2] == pytest.approx((values[:-1:2] + values[2::2]) / 2)
    assert np.ptp(values) > 0.5


def test_locks_bounds_and_pins_hold_after_a_coarse_step():
    start = members(locked=np.arange(9) == 3, lower=0.2, upper=1.7)
    pin = kf.Pin("C", (1.9,), 0.77)
    result = sequence(Step(grid_reduction=2), parameters=start, pins=[pin])
    values = result.parameters["C"].values
    assert values[3] == 1.0
    assert np.all((values >= 0.2) & (values <= 1.7))
    assert np.interp(1.9, BREAKPOINTS, values) == pytest.approx(0.77, rel=1e-9)


@pytest.mark.slow
def test_slopes_and_equalities_hold_after_a_coarse_step():
    limits = [Shape("C", 0, "slope", upper=0.05), Equality([Term("C", (0.4,)), Term("C", (2.7,), -1.0)], 0.4)]
    for steps in ([Step(grid_reduction=3)], [Step(grid_reduction=2), Step(free=["k"]), Step(free=["C"])]):
        values = sequence(*steps, constraints=limits).parameters["C"].values
        assert np.all(np.diff(values) / np.diff(BREAKPOINTS) <= 0.05 + 1e-9)
        assert np.interp(0.4, BREAKPOINTS, values) - np.interp(2.7, BREAKPOINTS, values) == pytest.approx(0.4, rel=1e-9)


@pytest.mark.slow
def test_limits_of_outputs_hold_at_the_end_of_a_sequence():
    limits = {"m": (-np.inf, 2.4)}
    free = sequence(Step(grid_reduction=2), Step())
    result = sequence(Step(grid_reduction=2), Step(), limits=limits)
    values = [kf.simulate(TEXT, DATA, each.parameters)["m"].values.max() for each in (free, result)]
    assert values[0] > 2.5
    assert values[1] <= 2.4 + 1e-5
    assert result.status == "converged"


@pytest.fixture(scope="module")
def limited():
    return limited_starts(workers=1)


def limited_starts(workers):
    options = kf.Options(starts=2, workers=workers)
    return kf.calibrate(TEXT, DATA, members(), criteria=CRITERIA, limits={"m": (-np.inf, 2.4)}, options=options)


@pytest.mark.slow
def test_limits_of_outputs_hold_for_every_start(limited):
    assert kf.simulate(TEXT, DATA, limited.parameters)["m"].values.max() <= 2.4 + 1e-5


@pytest.mark.slow
def test_limits_of_outputs_hold_in_worker_processes(limited):
    again = limited_starts(workers=2)
    assert [row.as_json() for row in limited.starts] == [row.as_json() for row in again.starts]


def test_a_step_has_its_own_iterations():
    result = sequence(Step(max_iterations=2), Step(max_iterations=3), options={"continuation": "off"})
    assert result.status == "max_iterations"
    assert [line.stage for line in result.trace] == ["step 1: plain"] * 2 + ["step 2: plain"] * 3


def test_a_failing_step_ends_the_sequence_and_is_named():
    steps = Step(free=["k"]), Step(name="held", lock={"C": True}), Step()
    result = sequence(*steps, pins=[kf.Pin("C", (0.0,), 3.0)])
    assert result.status == "infeasible"
    assert result.message.startswith("held: The limits contradict")
    assert {line.stage for line in result.trace} == {"step 1: plain"}


def test_a_sequence_with_contradictory_pins_does_not_start():
    pins = [kf.Pin("C", (0.0,), 1.0), kf.Pin("C", (0.0,), 2.0)]
    result = sequence(Step(), Step(), pins=pins)
    assert (result.status, len(result.starts), len(result.trace)) == ("infeasible", 1, 0)


def test_a_request_to_stop_ends_the_whole_sequence():
    def stop(line):
        if line.stage.startswith("step 2"):
            raise kf.Stop

    result = sequence(Step(grid_reduction=2), Step(), Step(), progress=stop)
    assert result.status == "stopped"
    assert not any(line.stage.startswith("step 3") for line in result.trace)
    assert result.cost_after < result.cost_before


@pytest.mark.slow
def test_a_sequence_from_several_starts_does_not_depend_on_the_starts_before():
    steps = (Step(free=["k"], criteria=["n"]), Step(free=["C"], grid_reduction=2), Step())
    first, second = (sequence(*steps, options={"starts": 3, "workers": n, "seed": 5}) for n in (1, 2))
    assert [row.as_json() for row in first.starts] == [row.as_json() for row in second.starts]
    assert first.parameters["C"].values.tolist() == second.parameters["C"].values.tolist()


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (Step(free=["D"]), "step 2 free: D matches no parameter"),
        (Step(lock={"CC": True}), "step 2 lock: CC matches no parameter. Did you mean C?"),
        (Step(lock={"C": [True]}), r"step 2 lock C: the mask has shape \[1\], but the parameter has \[9\]"),
        (Step(criteria=["q"]), "step 2 criteria: there is no criterion for q"),
        (Step(criteria=[3]), "there is no criterion 3. Use numbers from 1 to 2"),
        (Step(criteria={"m": -1.0}), "step 2 criteria m: the weight must be >= 0, got -1.0"),
        (Step(criteria={"m": 0.0}), "no criterion has a weight > 0"),
        (Step(grid_reduction={"C": (2, 2)}), "must have one number for each of 1 axes"),
        (Step(smoothness={"K": 1.0}), "step 2 smoothness: K matches no parameter"),
        (Step(free=[]), "no parameter that the function uses is free"),
    ],
)
def test_errors_of_a_step_are_reported_with_its_number(step, message):
    with pytest.raises(kf.InputError, match=message):
        sequence(Step(), step)


@pytest.mark.parametrize(
    ("key", "value"),
    [("free", "C"), ("grid_reduction", 0), ("grid_reduction", {"C": 1.5}), ("max_iterations", 0), ("tolerance", 0.0)],
)
def test_an_invalid_step_is_refused(key, value):
    with pytest.raises(ValueError, match=key):
        Step(**{key: value})


@pytest.mark.slow
def test_the_torque_maps_from_coarse_to_fine_end_no_higher_than_the_direct_fit():
    def cost(**options):
        return kf.calibrate(
            kf.formula(torque.FORMULA, parameters=list(torque.start())),
            torque.bench(),
            torque.start(),
            "Torque",
            node="TorquePredict",
            smoothness=torque.SMOOTHNESS,
            bounds=torque.BOUNDS,
            pins=[kf.Pin(*torque.PIN)],
            options=kf.Options(continuation="off", **options),
        ).cost_after

    assert cost(steps=[Step(grid_reduction=3), Step(grid_reduction=2), Step()]) <= 1.01 * cost()


def hinge(points):
    """A curve of five points, to be fitted to a kink between even ones."""
    return kf.ParameterSet([kf.Curve("C", kf.Axis(points, free=True), np.zeros(5)), kf.Scalar("k", 1.0, locked=True)])


KINKED = {"x": X, "y": np.abs(X - 1.13)}


@pytest.mark.parametrize(
    "options",
    [
        {"steps": [Step(grid_reduction=2), Step()]},
        pytest.param(
            {"steps": [Step(), Step(free=["k"], lock={"k": False}, max_iterations=1)]}, marks=pytest.mark.slow
        ),
        {"starts": 2, "workers": 1},
        pytest.param({"starts": 2, "workers": 2}, marks=pytest.mark.slow),
    ],
)
def test_breakpoints_that_move_are_carried_from_step_to_step_and_from_start_to_result(options):
    settings = kf.Options(continuation="off", **options)
    result = kf.calibrate(TEXT, KINKED, hinge(np.linspace(0, 3, 5)), "y", node="m", options=settings)
    points = result.parameters["C"].axes[0].breakpoints
    assert np.abs(points - 1.13).min() < 0.02
    assert result.quality[0].rmse_after < 0.01
    error = kf.simulate(TEXT, KINKED, result.parameters)["m"].values - KINKED["y"]
    assert np.sum(error**2) == pytest.approx(result.cost_after, rel=1e-9, abs=1e-20)


def test_breakpoints_do_not_move_on_a_coarse_grid():
    start = hinge(np.linspace(0, 3, 5))
    options = kf.Options(steps=[Step(grid_reduction=2)])
    result = kf.calibrate(TEXT, KINKED, start, "y", node="m", options=options)
    assert result.parameters["C"].axes[0].breakpoints.tolist() == start["C"].axes[0].breakpoints.tolist()


def test_a_group_axis_does_not_move_in_a_step_that_fits_one_of_its_tables():
    axis = kf.Axis(np.linspace(0, 3, 5), name="AxisX", free=True)
    start = kf.ParameterSet([kf.Curve("A", axis, np.zeros(5)), kf.Curve("B", axis, np.zeros(5))])
    for steps, moves in (([Step(free=["A"])], False), ([Step(free=["A"]), Step()], True)):
        options = kf.Options(steps=steps, continuation="off")
        result = kf.calibrate("m = A(x) + 0.5 * B(x)", KINKED, start, "y", options=options)
        ends = [result.parameters[name].axes[0].breakpoints.tolist() for name in "AB"]
        assert ends[0] == ends[1]
        assert (ends[0] != axis.breakpoints.tolist()) == moves
