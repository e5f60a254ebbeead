"""Symmetric matrices over values: as arrays or, if they are large and mostly zero, as blocks."""

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, Sparse
from kennfeld.native.block_matrix import BlockMatrix, BlockStorage

SymmetricMatrix = Float | BlockMatrix


def part(matrix: SymmetricMatrix, which: Int) -> SymmetricMatrix:
    """Select some rows and the same columns, Int[selected]; a copy if the matrix is an array."""
    # mostly no value is held, and all rows are wanted as they are
    if which.size == len(matrix) and np.array_equal(which, np.arange(which.size)):
        return matrix
    return matrix[np.ix_(which, which)] if isinstance(matrix, np.ndarray) else matrix.part(which)


def as_array(matrix: SymmetricMatrix) -> Float:
    """Copy a matrix into an array, Float[size, size]."""
    return matrix.copy() if isinstance(matrix, np.ndarray) else matrix.toarray()


def as_sparse(matrix: SymmetricMatrix) -> Sparse:
    """Copy a matrix into a sparse array of both sides of the diagonal, shape (size, size)."""
    from scipy.sparse import csr_array

    if isinstance(matrix, np.ndarray):
        return csr_array(matrix)
    rows, columns, values = matrix.nonzeros()
    # a block matrix lists one side of the diagonal
    off = rows != columns
    both = (np.append(rows, columns[off]), np.append(columns, rows[off]))
    return csr_array((np.append(values, values[off]), both), shape=(len(matrix), len(matrix)))


def scaled(matrix: Float | Sparse, scale: Float) -> SymmetricMatrix:
    """Multiply rows and columns of a matrix by a scale, Float[size]; a sparse array becomes blocks."""
    if isinstance(matrix, np.ndarray):
        return matrix * scale[:, None] * scale
    entries = matrix.tocoo()
    storage = BlockStorage(scale.size)
    storage.add_entries(entries.row, entries.col, entries.data * scale[entries.row] * scale[entries.col])
    return BlockMatrix(storage, np.arange(scale.size))


def zeros_like(matrix: SymmetricMatrix) -> SymmetricMatrix:
    """Create a matrix of zeros of the same size and kind."""
    if isinstance(matrix, np.ndarray):
        return np.zeros(matrix.shape)
    return BlockMatrix(BlockStorage(len(matrix)), np.arange(len(matrix)))


def count_nonzero(matrix: SymmetricMatrix) -> int:
    """Count the non-zeros; of blocks, each stored one counts twice, for the two sides of the diagonal."""
    if isinstance(matrix, np.ndarray):
        return int(np.count_nonzero(matrix))
    return 2 * int(np.count_nonzero(matrix.storage.blocks[: matrix.storage.count]))


def zero(matrix: SymmetricMatrix, which: Bool) -> None:
    """Set some rows and the same columns, Bool[size], to zero, in place."""
    if isinstance(matrix, np.ndarray):
        matrix[which, :] = 0.0
        matrix[:, which] = 0.0
    else:
        matrix.zero(which)


def add_entries(matrix: SymmetricMatrix, rows: Int, columns: Int, entries: Float) -> None:
    """Add entries on both sides of the diagonal, Float[entries], in place; any may be repeated."""
    if isinstance(matrix, np.ndarray):
        np.add.at(matrix, (rows, columns), entries)
    else:
        matrix.add_entries(rows, columns, entries)
