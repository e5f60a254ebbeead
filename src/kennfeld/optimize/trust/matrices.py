"""Symmetric matrices over values, as arrays or, if they are large and mostly zero, as sparse arrays."""

import numpy as np

from kennfeld.arrays import Bool, Float, Int, Sparse

Matrix = Float | Sparse
LARGE, FEW = 1000, 0.1  # rows above which a matrix may be sparse, and share of non-zeros up to which it is


def should_be_sparse(matrix: Float, *others: Float) -> bool:
    """Return True if matrices with these non-zeros should be sparse."""
    filled = sum(np.count_nonzero(each) for each in (matrix, *others))
    return bool(len(matrix) > LARGE and filled <= FEW * matrix.size)


def whole(matrix: Matrix) -> Float:
    """Return the matrix as an array."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def part(matrix: Matrix, which: Int | Bool) -> Matrix:
    """Return some rows and the same columns of a matrix."""
    numbers = np.flatnonzero(which) if which.dtype == bool else which
    if numbers.size == matrix.shape[0] and np.array_equal(numbers, np.arange(numbers.size)):
        return matrix
    return matrix[np.ix_(numbers, numbers)] if isinstance(matrix, np.ndarray) else matrix[numbers][:, numbers]


def rescale(matrix: Matrix, units: Float) -> Matrix:
    """Return diag(units) M diag(units)."""
    if isinstance(matrix, np.ndarray):
        result = matrix * units
        result *= units[:, None]
        return result
    from scipy.sparse import csr_array, diags_array

    return csr_array(diags_array(units) @ matrix @ diags_array(units))
