"""Limits in compiled code against their definition in numpy."""

import numpy as np
from hypothesis import strategies as st

from kennfeld.native.limit_rows import ChosenLimits
from tests.draws import few_or_many


def some_limits(size, rows, random):
    """Sides of bounds and rows, some infinite or equal; columns and coefficients of the rows, and a full matrix."""
    columns = random.integers(0, size, (rows, 3))
    coefficients = random.choice([0.0, 1.0, -2.0], (rows, 3))
    matrix = np.vstack([np.eye(size), np.zeros((rows, size))])
    np.add.at(matrix, (size + np.arange(rows)[:, None], columns), coefficients)
    lower = np.where(random.random(size + rows) < 0.3, -np.inf, random.uniform(-2, 0, size + rows))
    upper = np.where(random.random(size + rows) < 0.3, np.inf, random.uniform(0.1, 2, size + rows))
    equal = np.arange(size + rows) >= size + rows - random.integers(0, rows + 1)
    lower[equal] = upper[equal] = 0.0
    return lower, upper, columns, coefficients, matrix, equal & (np.arange(size + rows) >= size)


def signs_of(lower, upper, changes, here, equal):
    return np.where(equal, 0, np.where(changes > upper - here, 1, np.where(changes < lower - here, -1, 0)))


@few_or_many(st.integers(1, 12), st.integers(0, 15), st.integers(0, 2**32 - 1), few=20, many=100)
def test_violated_limits_are_chosen_once_with_their_sign_and_excess(size, rows, seed):
    random = np.random.default_rng(seed)
    lower, upper, columns, coefficients, matrix, equal = some_limits(size, rows, random)
    at, step = 0.01 * random.standard_normal(size), 3 * random.standard_normal(size)
    limits = ChosenLimits(lower, upper, columns, coefficients)
    limits.restart(at, step)
    expected = signs_of(lower, upper, matrix @ step, matrix @ at, equal)
    assert limits.violated(step) == np.count_nonzero(expected)
    chosen, entries = limits.choose(np.count_nonzero(expected))
    numbers = np.concatenate([np.flatnonzero(equal), np.flatnonzero(expected)])
    signs = np.concatenate([np.ones(int(equal.sum())), expected[expected != 0]])
    assert limits.count == numbers.size
    full = np.zeros((numbers.size, size))
    np.add.at(full, (np.arange(numbers.size)[:, None], chosen), entries)
    np.testing.assert_allclose(full, signs[:, None] * matrix[numbers], atol=1e-15)
    side = np.where(signs > 0, upper[numbers], lower[numbers])
    np.testing.assert_allclose(limits.excess, signs * (matrix[numbers] @ (at + step) - side), atol=1e-12)
    assert limits.violated(step) == 0  # all of them are chosen


@few_or_many(st.integers(1, 12), st.integers(0, 15), st.integers(0, 2**32 - 1), few=20, many=100)
def test_an_active_limit_that_is_violated_counts_as_violation(size, rows, seed):
    random = np.random.default_rng(seed)
    lower, upper, columns, coefficients, matrix, equal = some_limits(size, rows, random)
    at, free = 0.01 * random.standard_normal(size), 3 * random.standard_normal(size)
    limits = ChosenLimits(lower, upper, columns, coefficients)
    limits.restart(at, free)
    limits.choose(limits.violated(free))
    signs = signs_of(lower, upper, matrix @ free, matrix @ at, equal)
    numbers = np.concatenate([np.flatnonzero(equal), np.flatnonzero(signs)])
    sign = np.concatenate([np.ones(int(equal.sum())), signs[signs != 0]])
    step, holding = random.standard_normal(size), np.zeros(numbers.size, dtype=np.int64)
    violation, kept = limits.violation(step, holding)
    side = np.where(sign > 0, upper[numbers], lower[numbers])
    expected = np.maximum(sign * (matrix[numbers] @ (at + step) - side), 0.0)
    np.testing.assert_allclose(violation, expected, atol=1e-11)
    assert kept == (not expected.any())
    assert np.array_equal(holding, (expected > 0).astype(np.int64))


def test_rounding_is_not_a_violation():
    limits = ChosenLimits(np.array([-np.inf]), np.array([1.0]), np.zeros((0, 0), dtype=np.int64), np.zeros((0, 0)))
    at = np.array([0.0])
    for step, count in ((1.0, 0), (1 + 1e-13, 0), (1 + 1e-10, 1)):
        limits.restart(at, np.array([step]))
        assert limits.violated(np.array([step])) == count
