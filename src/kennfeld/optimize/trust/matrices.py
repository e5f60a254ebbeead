"""Symmetric matrices over values, as arrays or, if they are large and mostly zero, as sparse arrays."""

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, Sparse
from kennfeld.native.symmetric import SymmetricMatrix, count_nonzero

Matrix = Float | Sparse
LARGE, FEW = 1000, 0.1  # rows above which a matrix may be sparse, and share of non-zeros up to which it is


def should_be_sparse(matrix: SymmetricMatrix, *others: SymmetricMatrix) -> bool:
    """Return True if matrices with these non-zeros should be sparse."""
    filled = sum(count_nonzero(each) for each in (matrix, *others))
    return len(matrix) > LARGE and filled <= FEW * len(matrix) ** 2


def whole(matrix: Matrix) -> Float:
    """Return the matrix as an array, Float[size, size]."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def part(matrix: Matrix, which: Int | Bool) -> Matrix:
    """Select some rows and the same columns of a matrix, by numbers or a mask; the matrix itself if these are all."""
    numbers = np.flatnonzero(which) if which.dtype == bool else which
    if numbers.size == matrix.shape[0] and np.array_equal(numbers, np.arange(numbers.size)):
        return matrix
    return matrix[np.ix_(numbers, numbers)] if isinstance(matrix, np.ndarray) else matrix[numbers][:, numbers]


def rescale(matrix: Matrix, units: Float) -> Matrix:
    """Rescale M, [size, size], to diag(units) M diag(units), with units Float[size]."""
    if isinstance(matrix, np.ndarray):
        result = matrix * units
        result *= units[:, None]
        return result
    from scipy.sparse import csr_array, diags_array

    return csr_array(diags_array(units) @ matrix @ diags_array(units))


def coupling(matrix: Matrix, groups: Int, count: int) -> Float:
    """Measure how strongly groups of values act on the same data: sums of the entries in units of the diagonal.

    Args:
        matrix: curvature, its diagonal > 0 where a value has data.
        groups: number of the group of each value, Int[values]; -1 for none.
        count: number of groups.

    Returns:
        Float[count, count].
    """
    # values without data, with a diagonal of 0, act on nothing
    units = np.sqrt(np.maximum(matrix.diagonal(), 0.0))
    used = np.flatnonzero((groups >= 0) & (units > 0))
    sizes = abs(rescale(part(matrix, used), 1 / units[used]))
    members = np.zeros((used.size, count))
    members[np.arange(used.size), groups[used]] = 1.0
    return np.asarray(members.T @ (sizes @ members))
