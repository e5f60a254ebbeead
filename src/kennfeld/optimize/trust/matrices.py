"""Symmetric matrices over values, whole or, where they are large and mostly zeros, as sparse arrays."""

import numpy as np

from kennfeld.arrays import Bool, Float, Int, Sparse

__all__ = ["Matrix", "compressed", "part", "scaled", "whole"]

Matrix = Float | Sparse
LARGE, FEW = 1000, 0.1  # rows from which a matrix may be kept sparse, and share of non-zeros up to which it is


def compressed(matrix: Float, *others: Float) -> bool:
    """Return whether matrices of these non-zeros are worth keeping sparse."""
    filled = sum(np.count_nonzero(each) for each in (matrix, *others))
    return bool(len(matrix) > LARGE and filled <= FEW * matrix.size)


def whole(matrix: Matrix) -> Float:
    """Return the matrix as an array."""
    found: Float = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
    return found


def part(matrix: Matrix, which: Int | Bool) -> Matrix:
    """Return some rows and the same columns of a matrix."""
    numbers = np.flatnonzero(which) if which.dtype == bool else which
    if numbers.size == matrix.shape[0] and np.array_equal(numbers, np.arange(numbers.size)):
        return matrix
    return matrix[np.ix_(numbers, numbers)] if isinstance(matrix, np.ndarray) else matrix[numbers][:, numbers]


def scaled(matrix: Matrix, units: Float) -> Matrix:
    """Return diag(units) M diag(units)."""
    if isinstance(matrix, np.ndarray):
        found = matrix * units
        found *= units[:, None]
        return found
    from scipy.sparse import csr_array, diags_array

    return csr_array(diags_array(units) @ matrix @ diags_array(units))
