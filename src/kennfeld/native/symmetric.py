"""Symmetric matrices over values: as arrays or, if they are large and mostly zero, as blocks."""

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, Sparse
from kennfeld.native.block_matrix import BlockMatrix, BlockStorage

SymmetricMatrix = Float | BlockMatrix


def part(matrix: SymmetricMatrix, which: Int) -> SymmetricMatrix:
    """Return some rows and the same columns; a copy if the matrix is an array."""
    if which.size == len(matrix) and np.array_equal(which, np.arange(which.size)):
        return matrix
    return matrix[np.ix_(which, which)] if isinstance(matrix, np.ndarray) else matrix.part(which)


def as_array(matrix: SymmetricMatrix) -> Float:
    """Return the matrix as an array, a copy."""
    return matrix.copy() if isinstance(matrix, np.ndarray) else matrix.toarray()


def as_sparse(matrix: SymmetricMatrix) -> Sparse:
    """Return the matrix as a sparse array, a copy."""
    from scipy.sparse import csr_array

    if isinstance(matrix, np.ndarray):
        return csr_array(matrix)
    rows, columns, values = matrix.nonzeros()
    off = rows != columns
    both = (np.append(rows, columns[off]), np.append(columns, rows[off]))
    return csr_array((np.append(values, values[off]), both), shape=(len(matrix), len(matrix)))


def scaled(matrix: Float | Sparse, scale: Float) -> SymmetricMatrix:
    """Return a matrix with its rows and columns multiplied by a scale; a sparse array becomes blocks."""
    if isinstance(matrix, np.ndarray):
        return matrix * scale[:, None] * scale
    entries = matrix.tocoo()
    storage = BlockStorage(scale.size)
    storage.add_entries(entries.row, entries.col, entries.data * scale[entries.row] * scale[entries.col])
    return BlockMatrix(storage, np.arange(scale.size))


def zeros_like(matrix: SymmetricMatrix) -> SymmetricMatrix:
    """Return a matrix of zeros of the same size and kind."""
    if isinstance(matrix, np.ndarray):
        return np.zeros(matrix.shape)
    return BlockMatrix(BlockStorage(len(matrix)), np.arange(len(matrix)))


def count_nonzero(matrix: SymmetricMatrix) -> int:
    """Return the number of non-zeros; of blocks, those on one side of the diagonal count twice."""
    if isinstance(matrix, np.ndarray):
        return int(np.count_nonzero(matrix))
    return 2 * int(np.count_nonzero(matrix.storage.blocks[: matrix.storage.count]))


def zero(matrix: SymmetricMatrix, which: Bool) -> None:
    """Set some rows and the same columns to zero, in place."""
    if isinstance(matrix, np.ndarray):
        matrix[which, :] = 0.0
        matrix[:, which] = 0.0
    else:
        matrix.zero(which)


def add_entries(matrix: SymmetricMatrix, rows: Int, columns: Int, entries: Float) -> None:
    """Add entries on both sides of the diagonal, in place; any may be repeated."""
    if isinstance(matrix, np.ndarray):
        np.add.at(matrix, (rows, columns), entries)
    else:
        matrix.add_entries(rows, columns, entries)
