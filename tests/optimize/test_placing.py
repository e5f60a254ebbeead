import numpy as np
import pytest

import kennfeld as kf
from kennfeld.models.formula import formula
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings
from kennfeld.optimize.strategies.breakpoint_placement import (
    axis_groups,
    cell_divisions,
    coarsen,
    subdivide,
    with_dense_axes,
)
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective


def problem(*tables, smoothness=None):
    random = np.random.default_rng(0)
    data = kf.Dataset.of("bench", {name: random.uniform(-1, 11, 300) for name in ("x", "z", "y")})
    text = "m = C(x) + M(x, z)" if len(tables) > 1 else f"m = {tables[0].name}(x)"
    model = formula(text, parameters=[table.name for table in tables])
    return Problem(model, (data,), kf.ParameterSet(tables), (kf.Criterion("m", "y"),), smoothness=smoothness or {})


def tables():
    random = np.random.default_rng(1)
    x = kf.Axis([0, 2, 3, 7, 10], name="AxisX", free=True)
    z = kf.Axis([0, 4, 10])
    return kf.Curve("C", x, random.standard_normal(5)), kf.Map("M", x, z, random.standard_normal((5, 3)))


def dense(posed):
    return with_dense_axes(posed, cell_divisions(posed, posed.free_axes))


def test_original_breakpoints_stay_in_the_dense_axis_bit_for_bit():
    points = np.array([0.1, 0.7, 2.9, 3.3])
    dense_points = subdivide(points, np.array([3, 1, 7]))
    assert dense_points.size == 12
    assert np.isin(points, dense_points).all()
    assert np.all(np.diff(dense_points) > 0)


def test_a_dense_problem_has_the_same_surfaces_and_the_same_cost():
    posed = problem(*tables())
    assert LeastSquaresObjective(CompiledProblem(dense(posed))).cost(
        CompiledProblem(dense(posed)).start
    ) == pytest.approx(LeastSquaresObjective(CompiledProblem(posed)).cost(CompiledProblem(posed).start), rel=1e-12)
    axes = [table.axes[0] for table in dense(posed).parameters.parameters]
    assert axes[0] == axes[1]
    assert not axes[0].free
    assert dense(posed).parameters["M"].axes[1] == posed.parameters["M"].axes[1]


def test_a_smooth_surface_has_about_the_same_roughness_on_a_dense_axis():
    x = kf.Axis(np.linspace(0, 10, 21), free=True)
    posed = problem(kf.Curve("C", x, np.sin(x.breakpoints / 3)), smoothness={"C": 2.0})
    thick = dense(posed)
    fine = thick.parameters["C"].axes[0].breakpoints
    smooth = thick.parameters.with_parameters(thick.parameters["C"].with_values(np.sin(fine / 3)))
    compiled = CompiledProblem(thick)
    before = CompiledProblem(posed)
    assert compiled.roughness.cost(compiled.values.pack(smooth)) == pytest.approx(
        before.roughness.cost(before.start), rel=0.1
    )


def test_cells_are_not_narrower_than_the_least_distance_of_breakpoints():
    x = kf.Axis([0, 1, 4, 10], free=True, min_distance=0.4)
    posed = problem(kf.Curve("C", x, np.zeros(4)))
    (parts,) = cell_divisions(posed, posed.free_axes).values()
    assert parts.tolist() == [2, 7, 8]
    assert np.diff(dense(posed).parameters["C"].axes[0].breakpoints).min() >= 0.4


def test_a_dense_problem_stays_moderate():
    for count, together in ((60, []), (25, [1, 1]), (8, [2])):
        x, z = (kf.Axis(np.linspace(0, 10, count), free=True) for _ in range(2))
        posed = problem(kf.Map("M", x, z, np.zeros((count, count))), kf.Curve("C", [0, 1], [0, 0]))
        assert [len(keys) for keys in axis_groups(posed)] == together
    x, z = (kf.Axis(np.linspace(0, 10, 8), free=True) for _ in range(2))
    posed = problem(kf.Map("M", x, z, np.zeros((8, 8))), kf.Curve("C", [0, 1], [0, 0]))
    assert 400 < dense(posed).parameters["M"].size <= 1000


def test_values_between_locked_ones_are_locked_and_have_the_wider_bounds():
    x = kf.Axis([0, 2, 4, 6], free=True)
    table = kf.Curve(
        "C", x, [0.0, 1.0, 2.0, 3.0], locked=[True, True, False, True], lower=[-np.inf, -1, -2, -3], upper=[1, 2, 3, 4]
    )
    curve = with_dense_axes(problem(table), {key: np.full(3, 2) for key in problem(table).free_axes}).parameters["C"]
    assert curve.locked.tolist() == [True, True, True, False, False, False, True]
    assert curve.lower.tolist() == [-np.inf, -np.inf, -1, -2, -2, -3, -3]
    assert curve.upper.tolist() == [1, 2, 2, 3, 3, 4, 4]


def test_the_search_for_breakpoints_has_a_coarse_tolerance():
    assert coarsen(SolverSettings(tolerance=1e-8)).tolerance == 1e-5
    assert coarsen(SolverSettings(tolerance=1e-3)).tolerance == 1e-3
