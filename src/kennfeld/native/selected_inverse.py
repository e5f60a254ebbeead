"""The factor of a large sparse matrix, and selected entries of its inverse at the same cost.

A table couples each value to its neighbours only. In a good order of the values the factor fills little more than a
band, and the inverse within that band follows from the factor, last block first, without the rest of the inverse (K.
Takahashi, J. Fagan, M.-S. Chin: Formation of a sparse bus impedance matrix and its application to short circuit study,
1973; A. Erisman, W. Tinney: On computing certain elements of the inverse of a sparse matrix, Comm. ACM 18, 1975).

Let S be what elimination of the block columns before J leaves of H, P = S_JJ^-1, and G = S_RJ P for the block rows R
below J that reach it. Then the inverse Z has

    Z_RJ = -Z_RR G        Z_JJ = P + G' Z_RR G

The diagonal of H^-1 M H^-1 is the derivative of that of -H^-1 along M. With dS the slope of S along M, it follows from

    dG = (dS_RJ - G dS_JJ) P      dS_RR -= dS_RJ G' + G dS_RJ' - G dS_JJ G'
    dZ_RJ = -dZ_RR G - Z_RR dG    dZ_JJ = -P dS_JJ P - dG' Z_RJ - G' dZ_RJ
"""

from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Float, Int, Sparse
from kennfeld.base.threads import blas_threads
from kennfeld.native.block_matrix import BlockMatrix, BlockStorage
from kennfeld.native.cholesky import Factor
from kennfeld.native.envelope import BLOCK, Envelope

GROUP = 4  # block rows of the envelope that are one block here, so that its products are worth a call of BLAS
WIDTH = GROUP * BLOCK


class BlockLayout:
    """The places of the blocks within a grouped envelope: block row by block row, from the first to the diagonal."""

    def __init__(self, envelope: Envelope) -> None:
        self.place = envelope.place
        self.first: Int = envelope.first[::GROUP] // GROUP
        self.count = self.first.size  # block rows
        lengths = np.arange(1, self.count + 1) - self.first
        self.start = np.concatenate([[0], np.cumsum(lengths)])
        rows = np.arange(self.count)
        self.below = [np.flatnonzero((self.first <= column) & (rows > column)) for column in range(self.count)]

    def number(self, row: Int | int, column: Int | int) -> Int:
        """Return where a block is stored."""
        return self.start[row] + column - self.first[row]

    @cached_property
    def diagonal(self) -> Int:
        """The numbers of the diagonal blocks."""
        return self.start[1:] - 1

    @cached_property
    def squares(self) -> list[tuple[Int, Int, Int]]:
        """For each block column the positions of the blocks among the rows below it, and their pairs of rows."""
        pairs = [(rows, *np.tril_indices(rows.size)) for rows in self.below]
        return [(self.number(rows[high], rows[low]), high, low) for rows, high, low in pairs]

    def entries(self, matrix: Sparse) -> tuple[Int, Float]:
        """Return where the lower triangle of a matrix lies in the blocks, counted by entries, and its values."""
        coordinates = matrix.tocoo()
        rows, columns = self.place[coordinates.row], self.place[coordinates.col]
        lower = rows >= columns
        rows, columns, values = rows[lower], columns[lower], np.asarray(coordinates.data[lower], dtype=np.float64)
        blocks = self.number(rows // WIDTH, columns // WIDTH)
        return (blocks * WIDTH + rows % WIDTH) * WIDTH + columns % WIDTH, values

    def load(self, matrix: Sparse) -> Float:
        """Return the blocks of a matrix, diagonal blocks whole."""
        blocks = np.zeros((int(self.start[-1]), WIDTH, WIDTH))
        at, values = self.entries(matrix)
        np.add.at(blocks.reshape(-1), at, values)
        blocks[self.diagonal] += np.tril(blocks[self.diagonal], -1).transpose(0, 2, 1)
        return blocks

    def unpack(self, factor: Factor) -> Float:
        """Return the blocks of a factor, with 1 on the diagonal beyond its size."""
        blocks = np.zeros((int(self.start[-1]), WIDTH, WIDTH))
        envelope = factor.envelope
        ends = BLOCK * (np.arange(1, envelope.blocks + 1) - envelope.first)  # columns of each panel
        begins = np.concatenate([[0], np.cumsum(BLOCK * ends)])
        for row in range(envelope.blocks):
            panel = factor.panels[begins[row] : begins[row + 1]].reshape(-1, BLOCK)  # column by column
            group = row // GROUP
            whole = np.zeros((BLOCK, self.start[group + 1] - self.start[group], WIDTH))
            whole.reshape(BLOCK, -1)[:, : ends[row]] = panel.T
            inside = slice(row % GROUP * BLOCK, (row % GROUP + 1) * BLOCK)
            blocks[self.start[group] : self.start[group + 1], inside] = whole.transpose(1, 0, 2)
        blocks[self.diagonal] = np.tril(blocks[self.diagonal])
        beyond = np.arange(BLOCK * (envelope.blocks % GROUP or GROUP), WIDTH)
        blocks[-1, beyond, beyond] = 1.0
        return blocks

    def square(self, blocks: Float, column: int) -> Float:
        """Return the symmetric matrix over the rows below a block column; shape (rows * WIDTH, rows * WIDTH)."""
        count = self.below[column].size
        where, high, low = self.squares[column]
        whole = np.empty((count, WIDTH, count, WIDTH))
        whole[high, :, low, :] = blocks[where]
        whole[low, :, high, :] = blocks[where].transpose(0, 2, 1)
        return whole.reshape(count * WIDTH, count * WIDTH)

    def subtract(self, blocks: Float, column: int, matrix: Float) -> None:
        """Subtract a symmetric matrix over the rows below a block column, in place."""
        count = self.below[column].size
        where, high, low = self.squares[column]
        blocks[where] -= matrix.reshape(count, WIDTH, count, WIDTH)[high, :, low, :]

    def tall(self, blocks: Float, column: int) -> Float:
        """Return the blocks of a block column below the diagonal, stacked; shape (rows * WIDTH, WIDTH)."""
        rows = self.below[column]
        return blocks[self.number(rows, column)].reshape(rows.size * WIDTH, WIDTH)

    def put(self, blocks: Float, column: int, tall: Float) -> None:
        """Replace the blocks of a block column below the diagonal, in place."""
        rows = self.below[column]
        blocks[self.number(rows, column)] = tall.reshape(rows.size, WIDTH, WIDTH)


class SparseFactor:
    """The factor of a sparse positive definite matrix H, and entries of H^-1.

    Args:
        matrix: H, a scipy.sparse array.
        pattern: its non-zeros, and those of all matrices in `trace` and `sandwich`.

    Attributes:
        is_definite: False if H is not positive definite; nothing else may then be asked for.
    """

    def __init__(self, matrix: Sparse, pattern: Sparse | None = None) -> None:
        size = matrix.shape[0]
        entries = (matrix if pattern is None else pattern).tocoo()
        envelope = Envelope.of_pairs(size, entries.row, entries.col).grouped(GROUP)
        self._factor = Factor.empty(envelope)
        self._factor.load_blocks(_as_blocks(matrix), np.zeros(size))
        self.is_definite = self._factor.factor()

    def solve(self, right: Float) -> Float:
        """Return X of H X = B, shape (size, columns)."""
        return self._factor.solve(right.T).T

    @cached_property
    def _layout(self) -> BlockLayout:
        return BlockLayout(self._factor.envelope)

    @cached_property
    @blas_threads(WIDTH)
    def _gains(self) -> tuple[Float, Float]:
        """G at the positions of the blocks, and P of each block column: L_RJ L_JJ^-1 and L_JJ^-T L_JJ^-1."""
        layout, lower = self._layout, self._layout.unpack(self._factor)
        roots = np.linalg.inv(lower[layout.diagonal])
        columns = np.arange(layout.start[-1]) - np.repeat(layout.start[:-1] - layout.first, np.diff(layout.start))
        return lower @ roots[columns], roots.transpose(0, 2, 1) @ roots

    @cached_property
    @blas_threads(WIDTH)
    def inverse(self) -> Float:
        """The blocks of H^-1 at the positions of those of the factor."""
        layout, (gains, pivots) = self._layout, self._gains
        inverse = np.zeros_like(gains)
        for column in reversed(range(layout.count)):
            gain = layout.tall(gains, column)
            reach = layout.square(inverse, column) @ gain
            layout.put(inverse, column, -reach)
            inverse[layout.diagonal[column]] = pivots[column] + gain.T @ reach
        return inverse

    @property
    def diagonal(self) -> Float:
        """The diagonal of H^-1."""
        return self._diagonal(self.inverse)

    def _diagonal(self, blocks: Float) -> Float:
        whole = np.einsum("kii->ki", blocks[self._layout.diagonal]).ravel()
        return np.asarray(whole[self._layout.place])

    def trace(self, matrix: Sparse) -> float:
        """Return the trace of H^-1 M, for a symmetric M inside the pattern."""
        at, values = self._layout.entries(matrix)
        both = 2 * float(self.inverse.reshape(-1)[at] @ values)
        return both - float(self.diagonal @ matrix.diagonal())

    @blas_threads(WIDTH)
    def sandwich(self, matrix: Sparse) -> Float:
        """Return the diagonal of H^-1 M H^-1, for a symmetric M inside the pattern."""
        layout, (gains, pivots) = self._layout, self._gains
        slopes = layout.load(matrix)  # dS
        moves: list[Float] = []  # dG
        for column, pivot in enumerate(pivots):
            gain, own = layout.tall(gains, column), slopes[layout.diagonal[column]]
            half = layout.tall(slopes, column) - 0.5 * (gain @ own)
            moves.append((half - 0.5 * (gain @ own)) @ pivot)
            product = gain @ half.T
            layout.subtract(slopes, column, product + product.T)
        moved = np.zeros_like(slopes)  # dZ
        for column in reversed(range(layout.count)):
            gain, move, pivot = layout.tall(gains, column), moves[column], pivots[column]
            tall = -layout.square(moved, column) @ gain - layout.square(self.inverse, column) @ move
            layout.put(moved, column, tall)
            own = pivot @ slopes[layout.diagonal[column]] @ pivot
            own += move.T @ layout.tall(self.inverse, column) + gain.T @ tall
            moved[layout.diagonal[column]] = -0.5 * (own + own.T)
        return -self._diagonal(moved)


def _as_blocks(matrix: Sparse) -> BlockMatrix:
    entries = matrix.tocoo()
    storage = BlockStorage(matrix.shape[0])
    storage.add_entries(entries.row, entries.col, np.asarray(entries.data, dtype=np.float64))
    return BlockMatrix(storage, np.arange(matrix.shape[0]))
