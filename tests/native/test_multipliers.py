"""Multipliers of dual programs against SciPy, and equations with dependent rows."""

import numpy as np
import pytest
import scipy
from hypothesis import strategies as st

from kennfeld.native.multipliers import exchange_blocks, solve_active
from tests.draws import few_or_many


@few_or_many(st.integers(1, 30), st.integers(0, 2**32 - 1), few=20, many=100)
def test_active_equations_are_solved_and_the_others_are_zero(count, seed):
    random = np.random.default_rng(seed)
    root = random.standard_normal((count + 5, count))
    matrix, right = root.T @ root, random.standard_normal(count)
    active = random.integers(0, 2, count)
    m = solve_active(matrix, active, right)
    which = np.flatnonzero(active)
    np.testing.assert_allclose(m[which], np.linalg.solve(matrix[np.ix_(which, which)], right[which]), rtol=1e-6)
    assert not m[active == 0].any()


def test_dependent_rows_have_multipliers_that_solve_their_equations():
    root = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    matrix = root.T @ root
    m = solve_active(matrix, np.ones(3, dtype=np.int64), matrix @ [1.0, 1.0, 2.0])
    np.testing.assert_allclose(matrix @ m, matrix @ [1.0, 1.0, 2.0], atol=1e-9)


def test_a_matrix_that_is_not_finite_gives_no_numbers():
    assert np.isnan(solve_active(np.full((2, 2), np.nan), np.ones(2, dtype=np.int64), np.ones(2))).all()


@pytest.mark.parametrize("seed", range(10))
def test_block_pivoting_solves_nonnegative_least_squares(seed):
    random = np.random.default_rng(seed)
    root, target = random.standard_normal((60, 25)), random.standard_normal(60)
    guess = random.integers(0, 2, 25)
    m = exchange_blocks(root.T @ root, root.T @ target, 0, guess)
    np.testing.assert_allclose(m, scipy.optimize.nnls(root, target)[0], atol=1e-8)
    assert m.min() >= 0
