"""Symmetric matrices in blocks against arrays."""

import numpy as np
import pytest

from kennfeld.native.block_matrix import BlockMatrix, BlockStorage
from kennfeld.native.cholesky import Cholesky
from kennfeld.native.symmetric import add_entries, as_array, as_sparse, count_nonzero, part, zero, zeros_like

SIZES = (1, 7, 8, 9, 50)


def random_pair(size: int, share: float = 0.1) -> tuple[np.ndarray, BlockMatrix]:
    """The same positive definite matrix as an array and in blocks."""
    rng = np.random.default_rng(size)
    lower = np.tril(rng.normal(size=(size, size)) * (rng.random((size, size)) < share), -1)
    whole = lower + lower.T
    whole += np.diag(np.abs(whole).sum(axis=1) + 1)
    matrix = BlockMatrix(BlockStorage(size), np.arange(size))
    rows, columns = np.nonzero(whole)
    matrix.add_entries(rows, columns, 0.25 * whole[rows, columns])
    again = rng.permutation(np.repeat(np.arange(rows.size), 3))
    matrix.add_entries(rows[again], columns[again], 0.25 * whole[rows, columns][again])
    return whole, matrix


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("size", SIZES)
def test_a_block_matrix_is_the_array(size, full):
    whole, matrix = random_pair(size)
    if full:
        matrix.storage.fill()
    vector = np.random.default_rng(1).normal(size=size)
    np.testing.assert_allclose(as_array(matrix), whole, rtol=1e-14)
    np.testing.assert_allclose(as_sparse(matrix).toarray(), whole, rtol=1e-14)
    np.testing.assert_allclose(matrix.diagonal(), whole.diagonal(), rtol=1e-14)
    np.testing.assert_allclose(matrix @ vector, whole @ vector, rtol=1e-12, atol=1e-13)
    assert count_nonzero(matrix) >= np.count_nonzero(whole)


@pytest.mark.parametrize("size", SIZES[2:])
def test_a_part_shares_the_storage(size):
    whole, matrix = random_pair(size)
    which = np.array([6, 2, 4, 5])
    some = part(matrix, which)
    np.testing.assert_allclose(as_array(some), whole[np.ix_(which, which)], rtol=1e-14)
    np.testing.assert_allclose(some @ np.ones(4), whole[np.ix_(which, which)] @ np.ones(4), rtol=1e-12)
    add_entries(some, np.array([0]), np.array([0]), np.array([10.0]))
    assert matrix.diagonal()[6] == pytest.approx(whole[6, 6] + 10)
    assert part(matrix, np.arange(size)) is matrix


@pytest.mark.parametrize("full", [False, True])
def test_rows_and_columns_are_set_to_zero(full):
    whole, matrix = random_pair(50)
    if full:
        matrix.storage.fill()
    which = np.zeros(50, dtype=bool)
    which[[0, 9, 49]] = True
    for each in (whole, matrix):
        zero(each, which)
    np.testing.assert_allclose(as_array(matrix), whole, rtol=1e-14)
    assert not as_array(zeros_like(matrix)).any()


@pytest.mark.parametrize("full", [(False, False), (True, True), (True, False), (False, True)])
def test_the_sum_of_two_has_the_blocks_of_both(full):
    first, second = random_pair(50)[1], BlockMatrix(BlockStorage(50), np.arange(50))
    second.add_entries(np.array([49, 3]), np.array([0, 40]), np.array([2.0, 5.0]))
    wanted = as_array(first) + as_array(second)
    for matrix, fill in zip((first, second), full, strict=True):
        if fill:
            matrix.storage.fill()
    first.storage.add(second.storage)
    np.testing.assert_allclose(as_array(first), wanted, rtol=1e-14)


def test_entries_above_the_diagonal_are_those_below():
    matrix = BlockMatrix(BlockStorage(20), np.arange(20))
    matrix.add_entries(np.array([3, 15]), np.array([15, 3]), np.array([7.0, 7.0]))
    assert as_array(matrix)[3, 15] == as_array(matrix)[15, 3] == 7.0


@pytest.mark.parametrize("size", SIZES)
def test_a_factor_of_blocks_is_that_of_the_array(size):
    whole, matrix = random_pair(size)
    diagonal, right = np.linspace(0, 1, size), np.arange(1.0, size + 1)
    factor = Cholesky(size).factor(matrix, diagonal)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(whole + np.diag(diagonal), right), rtol=1e-10)


def test_the_envelope_grows_with_later_entries():
    _, matrix = random_pair(50, share=0.02)
    cholesky, right = Cholesky(50), np.ones(50)
    cholesky.factor(matrix, np.zeros(50))
    for row, column in ((49, 0), (30, 2)):
        add_entries(matrix, np.array([row]), np.array([column]), np.array([0.5]))
        solved = cholesky.factor(matrix, np.zeros(50)).solve(right)
        np.testing.assert_allclose(solved, np.linalg.solve(as_array(matrix), right), rtol=1e-10)


def test_a_factor_of_a_part_leaves_the_others_out():
    whole, matrix = random_pair(50)
    which = np.arange(3, 41)
    solved = Cholesky(which.size).factor(part(matrix, which), np.zeros(which.size)).solve(np.ones(which.size))
    np.testing.assert_allclose(solved, np.linalg.solve(whole[np.ix_(which, which)], np.ones(which.size)), rtol=1e-10)


def test_a_matrix_that_is_not_positive_definite_has_no_factor():
    _, matrix = random_pair(20)
    add_entries(matrix, np.array([4]), np.array([4]), np.array([-1e3]))
    assert Cholesky(20).factor(matrix, np.zeros(20)) is None
