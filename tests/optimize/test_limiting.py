"""Shapes of tables and equalities, against a general convex solver."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.base.errors import ArgumentError
from kennfeld.domain.constraints import Equality, Shape, Term
from kennfeld.domain.criteria import Criterion
from kennfeld.graph.interpolation import cell_weights, position, table_weights
from kennfeld.optimize import Options, Problem, Seconds, run
from kennfeld.optimize.fit.fit import FitRun
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.table_penalties import Roughness
from tests.draws import few_or_many, mostly_slow

FREE = (-np.inf, np.inf)


class Fit:
    """A noisy map over uneven axes: the fit, and the same as a convex program."""

    def __init__(self, seed, shape=(8, 6), samples=300, smoothness=0.01):
        random = np.random.default_rng(seed)
        self.axes = [np.cumsum(0.1 + random.uniform(size=n)) for n in shape]
        self.u, self.v = (random.uniform(a[0], a[-1], samples) for a in self.axes)
        middle = self.axes[0].mean()
        self.w = 3 * np.tanh(self.u - middle) + self.v + random.standard_normal(samples)
        self.smoothness = smoothness
        self.table = kf.Map("M", *self.axes, np.zeros(shape))

    def problem(self, constraints, table=None):
        parameters = kf.ParameterSet([table or self.table])
        return Problem(
            kf.formula("w = M(u, v)", parameters=["M"]),
            (kf.Dataset.of("d", {"u": self.u, "v": self.v, "z": self.w}),),
            parameters,
            (Criterion("w", "z"),),
            smoothness={"M": self.smoothness},
            constraints=tuple(constraints),
        )

    def fitted(self, constraints, table=None):
        return run(self.problem(constraints, table), Options())

    def judged(self, conditions):
        """The values of the convex program; `conditions` makes the constraints of its variable, shaped as the table."""
        import cvxpy

        shape = self.table.values.shape
        sides = [
            cell_weights(position(x, a, "clip"), a.size)[0] for x, a in zip((self.u, self.v), self.axes, strict=True)
        ]
        weights = table_weights(sides, shape)

        packed = SimpleNamespace(offsets={"M": 0}, free=int(np.prod(shape)))
        factors = {"M": (self.smoothness,) * 2}
        _, rough = Roughness.of(kf.ParameterSet([self.table]), packed, factors).rows(np.zeros(packed.free))
        z = cvxpy.Variable(shape)
        flat = cvxpy.reshape(z, (packed.free,), order="C")
        cost = cvxpy.sum_squares(weights @ flat - self.w) + cvxpy.sum_squares(rough @ flat)
        program = cvxpy.Problem(cvxpy.Minimize(cost), conditions(z))
        program.solve(solver=cvxpy.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
        return z.value

    def slopes(self, z, axis):
        """dz/dx along an axis, of a table or of a variable."""
        import cvxpy

        gaps = np.diff(self.axes[axis])
        return cvxpy.diag(1 / gaps) @ (z[1:] - z[:-1]) if axis == 0 else (z[:, 1:] - z[:, :-1]) @ cvxpy.diag(1 / gaps)


@pytest.mark.parametrize("seed", mostly_slow(range(4), 2))
def test_a_monotonic_map_is_that_of_a_convex_solver(seed):
    fit = Fit(seed)
    result = fit.fitted([Shape("M", 0, "slope", lower=0.0), Shape("M", 1, "slope", lower=0.0, upper=1.5)])
    expected = fit.judged(lambda z: [fit.slopes(z, 0) >= 0, fit.slopes(z, 1) >= 0, fit.slopes(z, 1) <= 1.5])
    assert result.status == "converged"
    np.testing.assert_allclose(result.parameters["M"].values, expected, atol=1e-6)
    assert result.trace[-1].active > 5


def test_locks_and_bounds_hold_together_with_slopes():
    fit = Fit(7)
    locked = np.zeros((8, 6), dtype=bool)
    locked[2, 3] = locked[5, 1] = True
    start = np.zeros((8, 6))
    start[2, 3], start[5, 1] = -0.7, 0.4
    table = kf.Map("M", *fit.axes, start).changed(locked=locked).with_bounds(-2.0, 2.5)
    result = fit.fitted([Shape("M", 0, "slope", lower=0.0)], table)
    values = result.parameters["M"].values
    expected = fit.judged(lambda z: [fit.slopes(z, 0) >= 0, z[2, 3] == -0.7, z[5, 1] == 0.4, z >= -2.0, z <= 2.5])
    np.testing.assert_allclose(values, expected, atol=1e-6)
    assert values[2, 3] == -0.7
    assert values[5, 1] == 0.4
    assert values.min() >= -2.0
    assert values.max() <= 2.5


def test_a_convex_map_is_that_of_a_convex_solver():
    fit = Fit(3)
    result = fit.fitted([Shape("M", 1, "curvature", lower=0.0), Shape("M", 0, "curvature", lower=-5.0, upper=5.0)])

    def curvature(z, axis):
        import cvxpy

        x = fit.axes[axis]
        slopes = fit.slopes(z, axis)
        between = cvxpy.diag(2 / (x[2:] - x[:-2]))
        return between @ (slopes[1:] - slopes[:-1]) if axis == 0 else (slopes[:, 1:] - slopes[:, :-1]) @ between

    expected = fit.judged(lambda z: [curvature(z, 1) >= 0, curvature(z, 0) >= -5, curvature(z, 0) <= 5])
    np.testing.assert_allclose(result.parameters["M"].values, expected, atol=1e-6)


def test_values_can_be_made_equal_and_summed():
    import cvxpy

    fit = Fit(5)
    x, y = fit.axes
    equal = Equality([Term("M", (x[1], y[2])), Term("M", (x[6], y[2]), -1.0)])
    total = Equality([Term("M")], 12.0)
    values = fit.fitted([equal, total]).parameters["M"].values
    expected = fit.judged(lambda z: [z[1, 2] == z[6, 2], cvxpy.sum(z) == 12.0])
    np.testing.assert_allclose(values, expected, atol=1e-6)
    assert values.sum() == pytest.approx(12.0, rel=1e-9)


def test_two_tables_on_a_group_axis_stay_monotonic():
    random = np.random.default_rng(2)
    axis = kf.Axis(np.array([0.0, 1.0, 2.5, 3.0, 5.0]), name="Shared")
    tables = kf.ParameterSet([kf.Curve("A", axis, np.zeros(5)), kf.Curve("B", axis, np.zeros(5))])
    u, v = random.uniform(0, 5, (2, 200))
    target = np.sin(2 * u) + v + np.cos(3 * v) + 0.3 * random.standard_normal(200)
    problem = Problem(
        kf.formula("w = A(u) + B(v)", parameters=["A", "B"]),
        (kf.Dataset.of("d", {"u": u, "v": v, "z": target}),),
        tables,
        (Criterion("w", "z"),),
        smoothness={"A": 1e-3, "B": 1e-3},
        pins=(kf.Pin("A", (0.0,), 0.0),),
        constraints=(Shape("A", 0, "slope", lower=0.0), Shape("B", 0, "slope", upper=0.5)),
    )
    parameters = run(problem, Options()).parameters
    assert np.diff(parameters["A"].values).min() >= -1e-9
    assert (np.diff(parameters["B"].values) / np.diff(axis.breakpoints)).max() <= 0.5 + 1e-9


def test_limits_hold_at_every_iterate():
    fit = Fit(1)
    problem = fit.problem([Shape("M", 0, "slope", lower=0.0), Shape("M", 1, "slope", lower=-0.2, upper=0.9)])
    running = FitRun(problem, Options(), None, Seconds())
    limits = linear_limits(problem, running.exact.values)
    violations = []
    running.record = lambda stage, line, values: violations.append(limits.violation(values))
    running.result()
    assert len(violations) > 1
    assert max(violations) <= 1e-9


@pytest.mark.slow
@few_or_many(st.integers(0, 10_000), st.floats(-3, 0), st.floats(0, 3), few=5, many=20)
def test_any_range_of_slopes_holds(seed, lower, upper):
    fit = Fit(seed, (5, 4), 60)
    result = fit.fitted(
        [Shape("M", 0, "slope", lower=lower, upper=upper), Shape("M", 1, "slope", lower=lower, upper=upper)]
    )
    assert result.status == "converged"
    for axis in (0, 1):
        slopes = np.diff(result.parameters["M"].values, axis=axis) / np.expand_dims(np.diff(fit.axes[axis]), 1 - axis)
        assert slopes.min() >= lower - 1e-8
        assert slopes.max() <= upper + 1e-8


def test_contradictory_limits_are_named():
    fit = Fit(0)
    locked = np.zeros((8, 6), dtype=bool)
    locked[0, 0] = locked[7, 0] = True
    start = np.zeros((8, 6))
    start[0, 0], start[7, 0] = 5.0, -5.0
    result = fit.fitted([Shape("M", 0, "slope", lower=0.0)], kf.Map("M", *fit.axes, start).changed(locked=locked))
    assert result.status == "infeasible"
    assert "slope of M along x between" in result.message
    assert np.array_equal(result.parameters["M"].values, start)


@pytest.mark.parametrize(
    ("constraint", "message"),
    [
        (Shape("M", 2, "slope", lower=0.0), "axis 2 does not exist"),
        (Shape("N", 0, "slope", lower=0.0), "N is not free"),
        (Equality([Term("M", (1.0,))]), "has 1 coordinates for 2 axes"),
        (Equality([Term("K")]), "K is not free"),
    ],
)
def test_constraints_of_missing_axes_and_parameters_are_refused(constraint, message):
    with pytest.raises(kf.InputError, match=message):
        Fit(0).fitted([constraint])


@pytest.mark.parametrize("make", [lambda: Shape("M", 0, "slope", lower=1.0, upper=0.0), lambda: Equality([])])
def test_constraints_without_meaning_are_refused(make):
    with pytest.raises(ArgumentError):
        make()
