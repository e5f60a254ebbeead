"""The factor of a sparse matrix and entries of its inverse, against those of the dense one."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from kennfeld.native.envelope import BLOCK, Envelope
from kennfeld.native.selected_inverse import WIDTH, SparseFactor
from tests.optimize.trust.sparse_matrices import curvature, lookups


@pytest.fixture(params=[(1, 20), (9, 11), (13, 20)], ids=str)
def matrix(request):
    rows, columns = request.param
    jacobian = lookups(max(rows, 2), columns, 40 * rows * columns, shared=2)
    return curvature(jacobian) + 0.01 * np.eye(jacobian.shape[1])


def test_a_factor_solves_and_gives_entries_of_the_inverse(matrix):
    factor, inverse = SparseFactor(csr_array(matrix)), np.linalg.inv(matrix)
    right = np.random.default_rng(1).normal(size=(len(matrix), 3))
    assert factor.is_definite
    np.testing.assert_allclose(factor.solve(right), inverse @ right, rtol=1e-9, atol=1e-9)
    assert factor.solve(right[:, :0]).shape == (len(matrix), 0)
    np.testing.assert_allclose(factor.diagonal, np.diag(inverse), rtol=1e-9)


def test_the_trace_and_the_diagonal_of_products_with_the_inverse(matrix):
    inverse = np.linalg.inv(matrix)
    other = matrix * (np.random.default_rng(2).uniform(size=matrix.shape) < 0.5)
    other = other + other.T
    factor = SparseFactor(csr_array(matrix))
    assert factor.trace(csr_array(other)) == pytest.approx(np.trace(inverse @ other), rel=1e-9)
    expected = np.diag(inverse @ other @ inverse)
    np.testing.assert_allclose(factor.sandwich(csr_array(other)), expected, atol=1e-9 * np.abs(expected).max())


def test_a_pattern_makes_room_for_matrices_with_other_zeros():
    tied = np.diag([2.0, 2.0, 2.0]) + 0.5
    factor = SparseFactor(csr_array(np.diag([1.0, 2.0, 4.0])), csr_array(tied))
    assert factor.trace(csr_array(tied)) == pytest.approx(2.5 * 1.75)
    np.testing.assert_allclose(factor.sandwich(csr_array(tied)), 2.5 / np.array([1.0, 4.0, 16.0]))


@pytest.mark.parametrize("size", [1, BLOCK - 1, BLOCK, BLOCK + 1, WIDTH - 1, WIDTH, WIDTH + 1, 3 * WIDTH])
def test_any_size_fills_whole_blocks(size):
    random = np.random.default_rng(size)
    matrix = np.diag(random.uniform(1, 2, size))
    if size > 1:
        matrix += np.diag(np.full(size - 1, 0.3), 1) + np.diag(np.full(size - 1, 0.3), -1)
    factor = SparseFactor(csr_array(matrix))
    np.testing.assert_allclose(factor.diagonal, np.diag(np.linalg.inv(matrix)), rtol=1e-12)


def test_a_matrix_that_is_not_definite_has_no_factor():
    assert not SparseFactor(csr_array(np.array([[1.0, 2.0], [2.0, 1.0]]))).is_definite


def test_a_grouped_envelope_has_the_first_block_of_the_longest_row_of_each_group():
    envelope = Envelope(np.arange(6 * BLOCK), np.array([0, 1, 1, 2, 2, 5])).grouped(4)
    assert envelope.first.tolist() == [0, 0, 0, 0, 0, 0]
    far = Envelope(np.arange(10 * BLOCK), np.array([0, 1, 2, 3, 4, 5, 5, 6, 6, 7])).grouped(4)
    assert far.first.tolist() == [0, 0, 0, 0, 4, 4, 4, 4, 4, 4]
