from itertools import product

import numpy as np
import pytest
import scipy
from hypothesis import strategies as st

from kennfeld.native import Factor
from kennfeld.optimize.solver.linear_constraints import LinearLimits, LinearRows
from kennfeld.optimize.solver.quadratic_program import QuadraticProgram, nonnegative_dual
from tests.draws import few_or_many, mostly_slow


def limited(lower, upper, matrix=None, target=None):
    """Bounds and equalities."""
    rows = LinearRows.none() if matrix is None or not len(matrix) else LinearRows.of(matrix, target, target)
    return LinearLimits(lower, upper, rows)


def equalities(limits, size):
    """Their full matrix and right-hand side."""
    return limits.rows.matrix(np.arange(limits.rows.count), size), limits.rows.lower


def convex(size, random, condition=1e2):
    """A positive definite matrix and a gradient."""
    q, _ = np.linalg.qr(random.standard_normal((size, size)))
    matrix = (q * np.geomspace(1.0, condition, size)) @ q.T
    return (matrix + matrix.T) / 2, 3 * random.standard_normal(size)


def solved(matrix, gradient, at, limits, guess=None):
    factor = Factor.of(np.asarray(scipy.linalg.cholesky(matrix, lower=True)))
    return QuadraticProgram(limits).solve(factor, -np.linalg.solve(matrix, gradient), at, guess)


def worth(matrix, gradient, step):
    return 0.5 * step @ matrix @ step + gradient @ step


def best_of_all_active_sets(matrix, gradient, at, limits):
    """The least value over every choice of active bounds that leaves a step within the limits."""
    size, (equal, target) = at.size, equalities(limits, at.size)
    best, best_step = np.inf, None
    for signs in product((-1, 0, 1), repeat=size):
        fixed = np.flatnonzero(signs)
        bound = np.where(np.array(signs) > 0, limits.upper, limits.lower)[fixed]
        if not np.all(np.isfinite(bound)):
            continue
        rows = np.vstack([equal, np.eye(size)[fixed]])
        right = np.concatenate([target - equal @ at, bound - at[fixed]])
        system = np.block([[matrix, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
        step = np.linalg.lstsq(system, np.concatenate([-gradient, right]), rcond=1e-12)[0][:size]
        inside = np.all(at + step <= limits.upper + 1e-8) and np.all(at + step >= limits.lower - 1e-8)
        met = np.allclose(rows @ step, right, atol=1e-8)
        if inside and met and worth(matrix, gradient, step) < best:
            best, best_step = worth(matrix, gradient, step), step
    return best_step


def some_limits(size, random, equalities):
    """A point, bounds around it of which some are far and some touch it, and equalities that it meets."""
    at = random.standard_normal(size)
    room = random.choice([0.0, 0.3, 1.0, np.inf], (2, size), p=[0.1, 0.4, 0.3, 0.2])
    room[1] = np.where(room.sum(axis=0) == 0, 1.0, room[1])
    matrix = random.standard_normal((equalities, size))
    return at, limited(at - room[0], at + room[1], matrix, matrix @ at)


@pytest.mark.parametrize("seed", mostly_slow(range(12), 2))
@pytest.mark.parametrize("equalities", [0, 1, 2])
def test_small_programs_end_at_the_best_active_set(seed, equalities):
    random = np.random.default_rng([seed, equalities])
    size = int(random.integers(2 + equalities, 6))
    matrix, gradient = convex(size, random)
    at, limits = some_limits(size, random, equalities)
    step = solved(matrix, gradient, at, limits).step
    np.testing.assert_allclose(step, best_of_all_active_sets(matrix, gradient, at, limits), atol=1e-8)


@pytest.mark.parametrize("seed", mostly_slow(range(15), 2))
@pytest.mark.parametrize("equalities", [0, 1])
def test_a_wrong_guess_of_active_bounds_does_not_change_the_solution(seed, equalities):
    random = np.random.default_rng([seed, equalities, 7])
    matrix, gradient = convex(5, random)
    at, limits = some_limits(5, random, equalities)
    guess = np.append(random.integers(-1, 2, 5), np.zeros(equalities, dtype=int))
    step = solved(matrix, gradient, at, limits, guess).step
    np.testing.assert_allclose(step, best_of_all_active_sets(matrix, gradient, at, limits), atol=1e-8)


@pytest.mark.parametrize("seed", range(10))
def test_programs_with_bounds_agree_with_scipy(seed):
    random = np.random.default_rng([seed, 1])
    rows = random.standard_normal((120, 60))
    right = random.standard_normal(120)
    at, limits = some_limits(60, random, 0)
    limits = LinearLimits(limits.lower - 1e-3, limits.upper + 1e-3)
    step = solved(rows.T @ rows, rows.T @ (rows @ at - right), at, limits).step
    judge = scipy.optimize.lsq_linear(rows, right, (limits.lower, limits.upper), method="bvls", tol=1e-14)
    np.testing.assert_allclose(at + step, judge.x, atol=1e-7)


@pytest.mark.filterwarnings("ignore:Values in x were outside bounds:RuntimeWarning")  # of SLSQP before SciPy 1.15
@pytest.mark.parametrize("seed", range(6))
def test_programs_with_bounds_and_equalities_agree_with_scipy(seed):
    random = np.random.default_rng([seed, 2])
    matrix, gradient = convex(25, random)
    at, limits = some_limits(25, random, 3)
    step = solved(matrix, gradient, at, limits).step
    judge = scipy.optimize.minimize(
        lambda d: worth(matrix, gradient, d),
        np.zeros(25),
        jac=lambda d: matrix @ d + gradient,
        bounds=list(zip(limits.lower - at, limits.upper - at, strict=True)),
        constraints=scipy.optimize.LinearConstraint(equalities(limits, 25)[0], 0.0, 0.0),
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    )
    assert worth(matrix, gradient, step) <= judge.fun + 1e-9 * abs(judge.fun)
    np.testing.assert_allclose(limits.rows.times(step), 0.0, atol=1e-9)
    assert np.all(limits.clip(at + step) - (at + step) <= 1e-9)


def test_a_free_step_within_the_bounds_is_taken_as_it_is():
    matrix, gradient = convex(4, np.random.default_rng(0))
    free = -np.linalg.solve(matrix, gradient)
    solution = solved(matrix, gradient, np.zeros(4), LinearLimits.none(4))
    assert np.array_equal(solution.step, free)
    assert not solution.active.any()


def test_active_marks_the_bounds_that_are_reached():
    solution = solved(
        np.eye(3), np.array([-2.0, 2.0, 0.1]), np.zeros(3), LinearLimits(np.full(3, -1.0), np.full(3, 1.0))
    )
    assert solution.active.tolist() == [1, -1, 0]
    assert solution.step.tolist() == pytest.approx([1.0, -1.0, -0.1])


def test_a_repeated_equality_holds():
    random = np.random.default_rng(3)
    matrix, gradient = convex(6, random)
    row = random.standard_normal((1, 6))
    once = solved(matrix, gradient, np.zeros(6), limited(*np.outer([-1, 1], np.ones(6)), row, np.array([0.4])))
    twice = solved(
        matrix,
        gradient,
        np.zeros(6),
        limited(*np.outer([-1, 1], np.ones(6)), np.vstack([row, 2 * row]), np.array([0.4, 0.8])),
    )
    np.testing.assert_allclose(twice.step, once.step, atol=1e-7)
    assert row @ twice.step == pytest.approx(0.4, abs=1e-9)


def test_an_equality_determined_by_a_bound_holds():
    limits = limited(np.array([0.0, -1.0]), np.array([1.0, 1.0]), np.array([[1.0, 0.0]]), np.array([1.0]))
    step = solved(np.eye(2), np.array([5.0, -3.0]), np.array([1.0, 0.0]), limits).step
    np.testing.assert_allclose(step, [0.0, 1.0], atol=1e-9)


@few_or_many(st.integers(1, 20), st.integers(0, 2**32 - 1), few=40, many=200)
def test_bounds_that_hold_the_step_are_reached_bit_for_bit(size, seed):
    random = np.random.default_rng(seed)
    matrix, gradient = convex(size, random)
    at, limits = some_limits(size, random, min(size - 1, 2))
    solution = solved(matrix, gradient, at, limits)
    end, active = solution.apply_to(at, limits), solution.active[:size]
    assert np.array_equal(end[active > 0], limits.upper[active > 0])
    assert np.array_equal(end[active < 0], limits.lower[active < 0])
    assert np.all((end >= limits.lower) & (end <= limits.upper))
    np.testing.assert_allclose(end, at + solution.step, atol=1e-9)


def test_values_of_very_different_size_keep_their_bounds():
    size = np.array([1e-9, 1.0, 1e9])
    matrix, gradient = np.diag(1 / size**2), -10 / size
    limits = LinearLimits(-size, size)
    np.testing.assert_allclose(solved(matrix, gradient, np.zeros(3), limits).step, size, rtol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_dual_meets_the_optimality_conditions(seed):
    random = np.random.default_rng([seed, 4])
    equalities, size = int(random.integers(0, 4)), int(random.integers(4, 30))
    columns = random.standard_normal((size + 2, size))
    matrix, excess = columns.T @ columns, random.standard_normal(size)
    m = nonnegative_dual(matrix, excess, equalities)
    slope = matrix @ m - excess
    scale = np.abs(excess).max()
    np.testing.assert_allclose(slope[:equalities], 0, atol=1e-8 * scale)
    assert np.all(m[equalities:] >= 0)
    assert np.all(slope[equalities:] >= -1e-8 * scale)
    assert abs(m[equalities:] @ slope[equalities:]) <= 1e-8 * scale


@pytest.mark.parametrize("seed", range(10))
def test_the_dual_of_dependent_rows_still_gives_the_step(seed):
    random = np.random.default_rng([seed, 5])
    columns = random.standard_normal((6, 4)) @ random.standard_normal((4, 9))
    columns = np.hstack([columns, columns[:, :3]])
    excess = columns.T @ random.standard_normal(6)
    m = nonnegative_dual(columns.T @ columns, excess, 0)
    slope = columns.T @ (columns @ m) - excess
    assert np.all(m >= 0)
    assert np.all(slope >= -1e-6)


def test_a_row_without_coefficients_is_ignored():
    limits = limited(np.full(2, -1.0), np.full(2, 1.0), np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([1e-17, 0.5]))
    step = solved(np.eye(2), np.array([-9.0, 1.0]), np.zeros(2), limits).step
    np.testing.assert_allclose(step, [1.0, -0.5], atol=1e-9)


def test_a_row_without_coefficients_does_not_hide_the_violation_of_others():
    matrix = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.9], [0.0, 0.9, 1.0]])
    m = nonnegative_dual(matrix, np.array([1e-17, 1.0, 0.5]), 1)
    np.testing.assert_allclose(m, [0.0, 1.0, 0.0], atol=1e-12)


def limited_map(count, random):
    """Limits of the slopes of a map along both axes, those around a cell depend on each other; the plane 0 keeps them.

    Many touch it: there is no more room on that side.
    """
    grid = np.arange(count * count).reshape(count, count)
    pairs = np.concatenate([np.stack(pair, -1).reshape(-1, 2) for pair in neighbours(grid)])
    below, above = random.choice([0.0, 0.3, np.inf], (2, len(pairs)))
    rows = LinearRows(pairs, np.tile([-1.0, 1.0], (len(pairs), 1)), -below, np.where(below == 0, above + 0.1, above))
    return LinearLimits(np.full(grid.size, -2.0), np.full(grid.size, 2.0), rows)


def neighbours(grid):
    return (grid[:-1], grid[1:]), (grid[:, :-1], grid[:, 1:])


@few_or_many(st.integers(2, 7), st.integers(0, 2**32 - 1), st.booleans(), few=30, many=200)
def test_limits_that_depend_on_each_other_end_at_the_optimum(count, seed, guessed):
    random = np.random.default_rng(seed)
    limits = limited_map(count, random)
    size = count * count
    matrix, gradient = convex(size, random)
    guess = random.integers(-1, 2, size + limits.rows.count) if guessed else None
    assert_optimal(matrix, gradient, limits, solved(matrix, gradient, np.zeros(size), limits, guess))


@pytest.mark.parametrize("seed", mostly_slow(range(20), 6))
def test_a_guess_of_very_many_dependent_limits_ends_at_the_optimum(seed):
    random = np.random.default_rng([seed, 8])
    limits = limited_map(8, random)
    matrix, gradient = convex(64, random, 1.1)
    guess = random.integers(-1, 2, 64 + limits.rows.count)
    assert_optimal(matrix, gradient, limits, solved(matrix, gradient, np.zeros(64), limits, guess))


def assert_optimal(matrix, gradient, limits, solution):
    """The step from 0 keeps the limits, and those that are active hold against the slope."""
    size = len(gradient)
    assert np.all(limits.violations(solution.step, np.full(size, np.abs(solution.step).max())) <= 1e-9)
    assert np.all(np.abs(solution.step) <= 2 + 1e-9)
    rows = np.vstack([np.eye(size), limits.rows.matrix(np.arange(limits.rows.count), size)])
    slope = matrix @ solution.step + gradient
    assert scipy.optimize.nnls((solution.active[:, None] * rows).T, -slope)[1] <= 1e-6 * np.linalg.norm(gradient)


def test_a_program_without_rows_has_no_multipliers():
    assert nonnegative_dual(np.zeros((0, 0)), np.zeros(0), 0).size == 0


def test_the_violation_is_relative_to_the_size_of_the_terms():
    limits = limited(*np.outer([-np.inf, np.inf], np.ones(2)), np.array([[1.0, 1.0]]), np.array([2e6]))
    assert limits.violation(np.array([1e6, 1e6])) == 0.0
    assert limits.violation(np.array([1e6, 1e6 + 4.0])) == pytest.approx(1e-6, rel=1e-3)


def test_no_feasible_direction_descends_from_the_solution():
    random = np.random.default_rng(11)
    matrix, gradient = convex(200, random, 1e8)
    at, limits = some_limits(200, random, 4)
    solution = solved(matrix, gradient, at, limits)
    slope = matrix @ solution.step + gradient
    active = solution.active[:200]
    free = active == 0
    rows, _ = equalities(limits, 200)
    multipliers = np.linalg.lstsq(rows[:, free].T, -slope[free], rcond=None)[0]
    rest = slope + rows.T @ multipliers
    scale = np.abs(gradient).max()
    np.testing.assert_allclose(rest[free], 0, atol=1e-6 * scale)
    assert np.all(rest[active == 1] <= 1e-6 * scale)
    assert np.all(rest[active == -1] >= -1e-6 * scale)


def test_the_solver_does_not_change_the_factor():
    matrix, gradient = convex(5, np.random.default_rng(2))
    lower = np.asarray(scipy.linalg.cholesky(matrix, lower=True))
    factor = Factor.of(lower)
    panels = factor.panels.copy()
    free = -scipy.linalg.solve_triangular(
        lower.T, scipy.linalg.solve_triangular(lower, gradient, lower=True), lower=False
    )
    QuadraticProgram(LinearLimits(np.full(5, -0.01), np.full(5, 0.01))).solve(factor, free, np.zeros(5))
    assert np.array_equal(factor.panels, panels)


@few_or_many(st.integers(2, 5), st.lists(st.integers(0, 2**32 - 1), min_size=2, max_size=5), few=25, many=200)
def test_a_program_does_not_depend_on_those_of_earlier_steps(count, seeds):
    limits = limited_map(count, np.random.default_rng(count))
    program, size = QuadraticProgram(limits), count * count
    for seed in seeds:
        random = np.random.default_rng(seed)
        matrix, gradient = convex(size, random)
        factor, free = (
            Factor.of(np.asarray(scipy.linalg.cholesky(matrix, lower=True))),
            -np.linalg.solve(matrix, gradient),
        )
        guess = random.integers(-1, 2, size + limits.rows.count) if seed % 2 else None
        again, first = (
            program.solve(factor, free, np.zeros(size), guess),
            solved(matrix, gradient, np.zeros(size), limits, guess),
        )
        assert np.array_equal(again.step, first.step)
        assert np.array_equal(again.active, first.active)


def test_the_push_is_the_rise_of_the_cost_by_the_limits():
    random = np.random.default_rng(5)
    limits = limited_map(6, random)
    matrix, gradient = convex(36, random)
    solution = solved(matrix, gradient, np.zeros(36), limits)
    assert solution.active.any()
    step = solution.step
    assert solution.push == pytest.approx(-step @ (matrix @ step + gradient), rel=1e-9, abs=1e-12)
