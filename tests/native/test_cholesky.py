"""Factors within an envelope against those of numpy."""

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.native.cholesky import Cholesky, Factor
from kennfeld.native.envelope import Envelope
from tests.draws import few_or_many


def dense(size, random):
    root = random.standard_normal((size, size))
    return root @ root.T + 0.1 * np.eye(size)


def ties(size, groups, random):
    """A sum of squares in which each row of data ties the values of one group."""
    matrix = 0.1 * np.eye(size)
    for group in groups:
        rows = random.standard_normal((len(group) + 1, len(group)))
        matrix[np.ix_(group, group)] += rows.T @ rows
    return matrix


def maps(count, tables, random, curve=0):
    """The matrix of maps over the same axes, shuffled, and of a curve that every sample may touch."""
    grid = np.arange(count * count * tables).reshape(tables, count, count)
    last = count * count * tables + np.arange(curve)
    groups = [
        np.concatenate([grid[:, i : i + 2, j : j + 2].ravel(), last[k : k + 2]])
        for i in range(count - 1)
        for j in range(count - 1)
        for k in range(max(curve - 1, 1))
    ]
    shuffle = random.permutation(last.size + grid.size)
    matrix = ties(last.size + grid.size, groups, random)
    return matrix[np.ix_(shuffle, shuffle)]


@pytest.mark.parametrize("size", [1, 2, 7, 8, 9, 16, 50, 131])
def test_solutions_are_those_of_numpy(size):
    random = np.random.default_rng(size)
    matrix, damping = dense(size, random), random.uniform(size=size)
    right = random.standard_normal((3, size))
    solution = Cholesky(size).factor(matrix, damping).solve(right)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix + np.diag(damping), right.T).T, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("curve", [0, 9])
def test_a_matrix_of_maps_has_a_small_envelope(curve):
    random = np.random.default_rng(curve)
    matrix = maps(12, 2, random, curve)
    factor = Cholesky(len(matrix)).factor(matrix, np.zeros(len(matrix)))
    right = random.standard_normal(len(matrix))
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix, right), rtol=1e-7, atol=1e-9)
    assert factor.envelope.work < 0.25 * Envelope.full(len(matrix)).work


@few_or_many(st.integers(1, 40), st.integers(0, 2**32 - 1), st.floats(0, 0.3), few=20, many=100)
def test_any_pattern_is_solved_and_learnt(size, seed, density):
    random = np.random.default_rng(seed)
    cholesky = Cholesky(size)
    for _ in range(3):
        groups = [np.flatnonzero(random.uniform(size=size) < density) for _ in range(4)]
        matrix, right = ties(size, groups, random), random.standard_normal(size)
        factor = cholesky.factor(matrix, np.zeros(size))
        np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix, right), rtol=1e-6, atol=1e-9)


def test_the_two_halves_of_a_solution_are_those_of_the_factor():
    random = np.random.default_rng(3)
    matrix = maps(4, 2, random)
    factor = Cholesky(len(matrix)).factor(matrix, np.zeros(len(matrix)))
    right = random.standard_normal((2, len(matrix)))
    half = factor.solve_lower(right)
    np.testing.assert_allclose(half @ half.T, right @ np.linalg.solve(matrix, right.T), rtol=1e-9)
    np.testing.assert_allclose(factor.solve_upper(half), factor.solve(right), rtol=1e-12)


@pytest.mark.parametrize("spoilt", [-1.0, 0.0, np.nan, np.inf])
def test_an_indefinite_matrix_has_no_factor_and_does_no_harm(spoilt):
    random = np.random.default_rng(1)
    cholesky, matrix = Cholesky(11), dense(11, random)
    broken = matrix.copy()
    broken[5, 5] = spoilt
    assert cholesky.factor(broken, np.zeros(11)) is None
    right = random.standard_normal(11)
    np.testing.assert_allclose(cholesky.factor(matrix, np.zeros(11)).solve(right), np.linalg.solve(matrix, right))


def test_zeros_in_one_half_alone_do_no_harm():
    # sums of products, rounded, may cancel on one side of the diagonal and not on the other
    size = 10
    matrix = np.diag(np.arange(1.0, size + 1)) + np.diag(np.full(size - 1, 1e-17), 1)
    right = np.arange(1.0, size + 1)
    for given_matrix in (matrix, matrix.T):
        factor = Cholesky(size).factor(given_matrix, np.zeros(size))
        np.testing.assert_allclose(factor.solve(right), np.ones(size), rtol=1e-12)


def test_a_matrix_may_be_part_of_a_wider_one_and_stored_either_way():
    random = np.random.default_rng(2)
    wide = np.zeros((10, 16))
    wide[:, :10] = dense(10, random)
    right = random.standard_normal(10)
    expected = np.linalg.solve(wide[:, :10], right)
    for matrix in (wide[:, :10], np.asfortranarray(wide[:, :10])):
        np.testing.assert_allclose(Cholesky(10).factor(matrix, np.zeros(10)).solve(right), expected)


def test_a_triangle_is_taken_as_a_factor():
    lower = np.linalg.cholesky(dense(13, np.random.default_rng(4)))
    right = np.arange(13.0)
    np.testing.assert_allclose(Factor.of(lower).solve(right), np.linalg.solve(lower @ lower.T, right))
    assert Factor.of(np.zeros((0, 0))).solve(np.zeros(0)).shape == (0,)


@few_or_many(st.integers(1, 30), st.integers(0, 2**32 - 1), few=20, many=100)
def test_part_of_a_matrix_is_factored_as_if_cut_out(size, seed):
    random = np.random.default_rng(seed)
    matrix, ridge = dense(size, random), random.uniform(size=size)
    which = np.flatnonzero(random.uniform(size=size) < 0.6)
    right = random.standard_normal(which.size)
    cut = (matrix + np.diag(ridge))[np.ix_(which, which)]
    np.testing.assert_allclose(Factor.part(matrix, which, ridge).solve(right), np.linalg.solve(cut, right), rtol=1e-6)


def test_part_of_a_matrix_that_is_not_positive_definite_has_no_factor():
    matrix = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.0], [2.0, 0.0, 1.0]])
    assert Factor.part(matrix, np.array([0, 2]), np.zeros(3)) is None
    assert Factor.part(matrix, np.array([0, 1]), np.zeros(3)) is not None
