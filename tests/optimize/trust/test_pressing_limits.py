"""Bounds and rows that determine values, beside those that are merely touched."""

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.domain.constraints import Limit, Shape
from kennfeld.optimize.solver.linear_constraints import LinearLimits, LinearRows
from kennfeld.optimize.trust.pressing_limits import TouchedLimits

UNBOUNDED = np.full(2, np.inf)


def pressing(limits, values, gradient):
    curvature = np.ones(values.size)
    return TouchedLimits.of(limits, values, curvature).pressing(gradient, curvature, cost=1.0)


def test_locks_and_active_bounds_fix_a_value():
    lower, upper = np.array([0.0, 0.0, 0.0, 2.0, -np.inf]), np.array([1.0, 1.0, 1.0, 2.0, np.inf])
    values = np.array([0.0, 1.0, 1.0, 2.0, 5.0])
    gradient = np.array([3.0, 3.0, -3.0, 0.0, 0.0])  # the cost falls against it
    assert pressing(LinearLimits(lower, upper), values, gradient).fixed.tolist() == [True, False, True, True, False]


def test_a_bound_may_be_active_only_because_of_a_pin():
    """Min (a - 3)^2 + (b - 5)^2 with a + b = 2, a >= 0, b >= 0: at (0, 2) the cost pulls a up, and b more."""
    matrix, two = np.ones((1, 2)), np.array([2.0])
    limits = LinearLimits(np.zeros(2), UNBOUNDED, LinearRows.of(matrix, two, two))
    assert pressing(limits, np.array([0.0, 2.0]), np.array([-3.0, -4.0])).fixed.tolist() == [True, False]
    assert pressing(limits, np.array([0.0, 2.0]), np.array([-5.0, -1.0])).fixed.tolist() == [False, False]


@pytest.mark.parametrize("slope", [0.0, 1e-13, -1e-13])
def test_a_bound_with_a_slope_of_rounding_size_is_inactive(slope):
    limits = LinearLimits(np.zeros(2), UNBOUNDED)
    assert not pressing(limits, np.zeros(2), np.array([slope, 0.0])).fixed.any()


def test_rows_with_a_multiplier_are_active():
    rows = LinearRows.of(
        np.array([[1.0, -1.0], [1.0, 1.0], [2.0, 0.0]]), np.array([0.0, -5.0, 1.0]), np.array([3.0, 2.0, 1.0])
    )
    limits, values = LinearLimits(np.zeros(2), np.full(2, 9.0), rows), np.array([0.5, 0.5])
    assert TouchedLimits.of(limits, values, np.ones(2)).all_rows.tolist() == [[2.0, 0.0], [-1.0, 1.0]]
    assert pressing(limits, values, np.array([0.0, -1.0])).all_rows.tolist() == [[2.0, 0.0], [-1.0, 1.0]]
    assert pressing(limits, values, np.array([0.5, 0.0])).all_rows.tolist() == [[2.0, 0.0]]


def test_a_corner_of_a_flat_cell_is_fixed_by_its_neighbours():
    """Values z00 <= z10, z01 <= z11 of which z00 is pulled up: z01 without data has no choice between equal ones."""
    rising = np.array([[-1.0, 0, 1, 0], [0, -1.0, 0, 1], [-1.0, 1, 0, 0], [0, 0, -1.0, 1]])
    limits = LinearLimits(*np.outer([-np.inf, np.inf], np.ones(4)), LinearRows.of(rising, np.zeros(4), np.full(4, 9.0)))
    assert np.linalg.matrix_rank(pressing(limits, np.ones(4), np.array([-1.0, 0, 0, 1])).all_rows) == 3


def active_by_linear_program(rows, gradient):
    """Mark rows a such that no change d with a'd < 0 keeps all other ones <= 0 and the cost."""
    count, size = rows.shape
    objective = np.concatenate([np.zeros(size), -np.ones(count)])
    bounds = [(None, None)] * size + [(0, 1)] * count
    inside = np.hstack([rows, np.eye(count)])
    level = np.concatenate([gradient, np.zeros(count)])[None]
    end = scipy.optimize.linprog(objective, inside, np.zeros(count), level, [0.0], bounds)
    return end.x[size:] < 0.5


@pytest.mark.slow
@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 9))
def test_active_rows_are_those_of_a_linear_program(seed, size, count):
    rng = np.random.default_rng(seed)
    rows = rng.integers(-1, 2, (count, size)) * 1.0
    rows = rows[np.any(rows != 0, axis=1)]
    gradient = -rows.T @ (rng.uniform(0.5, 2.0, len(rows)) * (rng.random(len(rows)) < 0.4))
    open_ends = np.full(size, -np.inf), np.full(size, np.inf)
    sides = np.full(len(rows), -np.inf), np.zeros(len(rows))
    touched = TouchedLimits.of(LinearLimits(*open_ends, LinearRows.of(rows, *sides)), np.zeros(size), np.ones(size))
    active = touched.pressing(gradient, np.ones(size), cost=1.0).rows
    expected = rows[active_by_linear_program(rows, gradient)]
    rank = np.linalg.matrix_rank(np.vstack([active, expected])) if active.size or expected.size else 0
    assert rank == (np.linalg.matrix_rank(active) if active.size else 0)
    assert rank == (np.linalg.matrix_rank(expected) if expected.size else 0)


X = np.random.default_rng(0).uniform(0, 10, 300)


def curve_and_slope(seed=0, slope=2.0, start=0.5, corner=4.0, **more):
    """Fit y = C(x) + k*x, in which k and a part of C that rises with x are one."""
    noise = 0.1 * np.random.default_rng(seed).standard_normal(X.size)
    data = {"x": X, "m": np.interp(X, [0, 5, 10], [1, 3, corner]) + slope * X + noise}
    tables = kf.ParameterSet([kf.Curve("C", [0, 5, 10], np.ones(3)), kf.Scalar("k", start)])
    return kf.calibrate("y = C(x) + k * x", data, tables, target="m", **more)


TOUCHED = {
    "bound": {"bounds": {"C": (0.0, 10.0), "k": (0.0, 5.0)}},
    "falling": {"constraints": [Shape("C", 0, "slope", upper=0.0)]},
    "rising": {"constraints": [Shape("C", 0, "slope", lower=0.0)], "start": 3.0},
    "limit of an output": {"limits": [Limit("C(x)", upper=10.0)], "start": 0.2},
}


@pytest.mark.parametrize("kind", TOUCHED)
def test_a_limit_that_is_merely_touched_hides_no_null_direction(kind):
    result = curve_and_slope(**TOUCHED[kind])
    touched = (result.parameters["C"].values[2] == 10.0, *np.isclose(np.diff(result.parameters["C"].values), 0.0))
    assert any(touched) or result.trust.holdings
    assert result.trust.null_space.dimension == 1
    assert np.isinf(result.trust.deviation["k"])
    assert np.isinf(result.trust.deviation["C"][1:]).all()
    assert result.trust.deviation["C"][0] < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(24))
def test_a_touched_bound_hides_no_null_direction_in_any_draw(seed):
    assert np.isinf(curve_and_slope(seed, **TOUCHED["bound"]).trust.deviation["k"])


def test_active_limits_fix_their_values():
    result = curve_and_slope(
        corner=2.0, start=3.0, bounds={"k": (2.0, 2.0)}, **{"constraints": TOUCHED["rising"]["constraints"]}
    )
    first, second, third = result.trust.deviation["C"]
    assert second == third < 0.1
    assert result.trust.deviation["k"] == 0
    above = curve_and_slope(bounds={"C": (2.0, 9.0)})
    assert above.trust.deviation["C"][0] == 0  # truth is 1
    assert first > 0
