"""Breakpoints that are fitted: what is known of them, against repeated measurements."""

import csv

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize import Problem, run
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.project.results import write_trust
from tests.optimize.repetitions import agree, counts, own_targets

KINKS, HEIGHTS = np.array([0, 1.2, 2.1, 6.5, 10.0]), np.array([0, 4.0, 1.0, 2.0, 8.0])
X = np.random.default_rng(0).uniform(0, 10, 800)
CLEAN = np.interp(X, KINKS, HEIGHTS)
NOISE = 0.1


def bent(points=KINKS, heights=HEIGHTS, **axis):
    return kf.Curve("C", kf.Axis(points, input="x", free=True, **axis), heights)


def problem(table, target, **more):
    data = kf.Dataset.of("d", {"x": X, "y": target})
    return Problem(
        kf.formula("m = C(x)", parameters=["C"]), (data,), kf.ParameterSet([table]), (kf.Criterion("m", "y"),), **more
    )


def noisy(target=CLEAN, seed=1, noise=NOISE):
    return target + noise * np.random.default_rng(seed).standard_normal(X.size)


def repeated(posed, count):
    """Values and breakpoints from many measurements, in the order of the trust."""
    compiled = CompiledProblem(posed)
    targets = own_targets(compiled)
    objective, limits = LeastSquaresObjective(compiled), linear_limits(posed, compiled.values)
    start, rng, ends = objective.start, np.random.default_rng(7), []
    for _ in range(count):
        targets[:] = CLEAN + NOISE * rng.standard_normal(X.size)
        compiled.samples.wanted.reread()
        ends.append(
            levenberg_marquardt(
                objective, start, limits, SolverSettings(tolerance=1e-6, damping_limited_ratio=np.inf)
            ).values
        )
    first, axis = compiled.values.offsets["C"], next(iter(compiled.values.moving.values()))
    return np.array(ends)[:, np.r_[first : first + 5, axis : axis + 5]]


@pytest.mark.slow
@counts
@pytest.mark.parametrize(
    "smoothness", [pytest.param({}, id="plain", marks=pytest.mark.slow), pytest.param({"C": 1e-3}, id="smooth")]
)
def test_breakpoints_and_values_scatter_as_predicted(smoothness, count):
    posed = problem(bent(), noisy(), smoothness=smoothness)
    trust = run(posed, kf.Options()).trust
    assert list(trust.deviation) == ["C", "C.x"]
    assert trust.covariance(["C", "C.x"]).shape == (10, 10)
    assert agree(trust.covariance(scatter=True), repeated(posed, count)) == 8
    assert trust.deviation["C.x"][[0, -1]].tolist() == [0.0, 0.0]  # the ends stay


def test_a_breakpoint_has_the_same_facts_as_a_value():
    trust = run(problem(bent(), noisy()), kf.Options()).trust
    inner = slice(1, 4)
    assert trust.samples["C.x"][1] == np.count_nonzero(X < 2.1)
    assert trust.leverage["C.x"][inner] == pytest.approx(1.0)
    assert sum(float(np.sum(each)) for each in trust.leverage.values()) == pytest.approx(trust.freedom) == 8.0
    assert trust.informed["C.x"].all()
    assert not trust.by_smoothness["C.x"].any()


def test_a_breakpoint_and_its_value_move_together_on_a_slope():
    table = bent(np.array([0, 3.0, 5.0, 10.0]), np.array([0, 6.0, 10.0, 20.0]))
    trust = run(problem(table, 2 * X), kf.Options()).trust
    assert np.isinf(trust.deviation["C.x"][1:3]).all()
    assert {d.sentence for d in trust.directions} == {
        "Raising the second breakpoint (3) of C.x and C at 3 together has no effect on the fit.",
        "Raising the third breakpoint (5) of C.x and C at 5 together has no effect on the fit.",
    }
    remedy = "Record samples that distinguish them, use fewer breakpoints for C.x, or increase the smoothness of C."
    assert {d.remedy for d in trust.directions} == {remedy}


def test_a_breakpoint_is_undetermined_if_the_curve_is_flat():
    table = bent(np.array([0, 3.0, 5.0, 10.0]), np.full(4, 2.0))
    trust = run(problem(table, np.full(X.size, 2.0)), kf.Options()).trust
    assert trust.informed["C.x"][1:3].tolist() == [False, False]
    assert np.isinf(trust.deviation["C.x"][1:3]).all()
    (direction,) = trust.directions
    assert direction.sentence == (
        "The position of the second breakpoint (3) and the third breakpoint (5) of C.x is not determined: "
        "the tables are flat there or have no data. They stay where they are."
    )
    assert direction.remedy == "Use fewer breakpoints on this axis, or fix them."


def test_a_remedy_locks_values_before_it_fixes_breakpoints():
    slope = bent(np.array([0, 3.0, 5.0, 10.0]), np.array([0, 6.0, 10.0, 20.0]))
    result = run(problem(slope, 2 * X), kf.Options())
    space = result.trust.null_space
    assert (space.dimension, space.remedy.pins, space.remedy.axes) == (2, (), ())
    (where,) = space.remedy.locks.values()
    assert where.tolist() == [False, True, True, False]
    locked = result.parameters["C"].changed(locked=where)
    assert run(problem(locked, 2 * X), kf.Options()).trust.null_space.dimension == 0
    flat = bent(np.array([0, 3.0, 5.0, 10.0]), np.full(4, 2.0))
    space = run(problem(flat, np.full(X.size, 2.0)), kf.Options()).trust.null_space
    assert (space.dimension, space.remedy.axes) == (2, ("C.x",))
    assert space.advice == "To determine all of them, fix the breakpoints of C.x."


@pytest.mark.slow
def test_a_superfluous_breakpoint_is_described_by_its_number():
    target = noisy(np.interp(X, [0, 5, 10], [0, 5, 0]))
    trust = run(problem(bent(np.linspace(0, 10, 5), np.zeros(5)), target), kf.Options()).trust
    directions = [d for d in trust.directions if "breakpoint (" in d.sentence and "of C.x" in d.sentence]
    assert directions
    assert "use fewer breakpoints for C.x" in directions[0].remedy
    assert set(directions[0].parts) <= {"C", "C.x"}


def test_breakpoints_at_their_least_distance_move_as_one():
    """A jump wants its two breakpoints on one place."""
    target = noisy(np.where(X < 4, 1.0, 3.0))
    table = bent(np.array([0, 3.0, 5.0, 10.0]), np.array([1.0, 1.0, 3.0, 3.0]), min_distance=0.5)
    result = run(problem(table, target), kf.Options())
    points, trust = result.parameters["C"].axes[0].breakpoints, result.trust
    assert points[2] - points[1] == pytest.approx(0.5)
    assert trust.deviation["C.x"][1] > 0
    assert trust.deviation["C.x"][1] == pytest.approx(trust.deviation["C.x"][2])
    assert trust.correlation(["C.x"])[1, 2] == pytest.approx(1.0)
    (holding,) = trust.holdings
    assert holding.sentence == (
        f"Breakpoints 2 and 3 of C.x ({points[1]:.6g} and {points[2]:.6g}) are at their minimum distance (0.5). "
        "Consider fewer breakpoints."
    )
    assert trust.freedom == pytest.approx(5.0)


def test_a_group_axis_has_one_row_for_each_of_its_breakpoints(tmp_path):
    axis = kf.Axis(KINKS, name="AxisX", input="x", unit="rpm", free=True)
    tables = kf.ParameterSet([kf.Curve("A", axis, HEIGHTS), kf.Curve("B", axis, HEIGHTS[::-1].copy())])
    z = np.random.default_rng(4).uniform(0, 1, X.size)
    target = noisy(CLEAN + z * np.interp(X, KINKS, HEIGHTS[::-1]))
    data = kf.Dataset.of("d", {"x": X, "z": z, "y": target})
    model = kf.formula("m = A(x) + z * B(x)", parameters=["A", "B"])
    result = run(Problem(model, (data,), tables, (kf.Criterion("m", "y"),)), kf.Options())
    trust = result.trust
    assert list(trust.deviation) == ["A", "B", "AxisX"]
    write_trust(trust, result.parameters, tmp_path / "trust.csv")
    with (tmp_path / "trust.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["parameter"] == "AxisX"]
    assert [float(row["x"]) for row in rows] == [1, 2, 3, 4, 5]
    assert [float(row["value"]) for row in rows] == pytest.approx(result.parameters["A"].axes[0].breakpoints)
    assert [float(row["deviation"]) for row in rows] == pytest.approx(trust.deviation["AxisX"], rel=1e-5)
    assert {row["unit"] for row in rows} == {"rpm"}


def test_a_parameter_and_an_axis_of_the_same_name_are_distinguished():
    axis = kf.Axis(KINKS, name="C", input="x", free=True)
    posed = problem(kf.Curve("C", axis, HEIGHTS), noisy())
    trust = run(posed, kf.Options()).trust
    assert list(trust.deviation) == ["C", "axis C"]
