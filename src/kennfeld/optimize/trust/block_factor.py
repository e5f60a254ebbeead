"""Block factorisation of a large sparse symmetric matrix, and selected entries of its inverse at the same cost.

A table couples each value to its neighbours only. In a good order of the values the factor fills little more than a
band, and the inverse within that band follows from the factor, last block first, without the rest of the inverse (K.
Takahashi, J. Fagan, M.-S. Chin: Formation of a sparse bus impedance matrix and its application to short circuit study,
1973; A. Erisman, W. Tinney: On computing certain elements of the inverse of a sparse matrix, Comm. ACM 18, 1975).
The diagonal of H^-1 M H^-1 is the derivative of that of -H^-1 along M, and is computed by differentiating both passes.

Each diagonal block S = V diag(e) V' is split into R = V |e|^-1/2 and signs, so that the signs tell the inertia of the
matrix even where it is not positive definite.
"""

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Float, Int, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import blas_threads
from kennfeld.native.envelope import first_blocks, places_of, sparse_orders

BLOCK = 32
TINY = 1e-300  # least eigenvalue of a block that is divided by


@dataclass(frozen=True)
class Layout:
    """The blocks that are stored: those of block row k from block column `first[k]` to the diagonal, row by row.

    The ordered matrix is padded to whole blocks. Value i of the matrix is row `place[i]` of it.
    """

    place: Int  # Int[size]
    first: Int  # Int[block rows]
    start: Int  # Int[block rows + 1], of the first block of each block row

    @classmethod
    def of(cls, pattern: Sparse) -> "Layout":
        """Return the blocks that a symmetric matrix with these non-zeros fills when it is factored."""
        entries = pattern.tocoo()
        layouts = [cls._ordered(order, entries.row, entries.col) for order in sparse_orders(pattern)]
        return min(layouts, key=lambda layout: layout.work)

    @classmethod
    def _ordered(cls, order: Int, rows: Int, columns: Int) -> "Layout":
        """Return the blocks in some order of the values, for non-zeros in these rows and columns."""
        place = places_of(order)
        first = first_blocks(place, rows, columns, BLOCK)
        return cls(place, first, np.concatenate([[0], np.cumsum(np.arange(1, first.size + 1) - first)]))

    @property
    def count(self) -> int:
        """Number of block rows."""
        return self.first.size

    @property
    def size(self) -> int:
        """Number of values."""
        return self.place.size

    @property
    def work(self) -> float:
        """Relative cost of a factorisation."""
        return float(np.sum(np.square(np.diff(self.start), dtype=np.float64)))

    def number(self, row: Int | int, column: Int | int) -> Int:
        """Return where a block is stored."""
        return self.start[row] + column - self.first[row]

    @cached_property
    def below(self) -> list[Int]:
        """Block rows below the diagonal that reach each block column."""
        rows = np.arange(self.count)
        return [np.flatnonzero((self.first <= column) & (rows > column)) for column in range(self.count)]

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
        blocks = self.number(rows // BLOCK, columns // BLOCK)
        return (blocks * BLOCK + rows % BLOCK) * BLOCK + columns % BLOCK, values

    def load(self, matrix: Sparse, padding: float) -> Float:
        """Return the blocks of a matrix, diagonal blocks whole; `padding` is the diagonal beyond its size."""
        blocks = np.zeros((int(self.start[-1]), BLOCK, BLOCK))
        at, values = self.entries(matrix)
        np.add.at(blocks.reshape(-1), at, values)
        for row in range(self.count):
            own = blocks[self.number(row, row)]
            own += np.tril(own, -1).T
        beyond = np.arange(self.size % BLOCK or BLOCK, BLOCK)
        blocks[-1, beyond, beyond] = padding
        return blocks

    def square(self, blocks: Float, column: int) -> Float:
        """Return the symmetric matrix over the rows below a block column; shape (rows * BLOCK, rows * BLOCK)."""
        count = self.below[column].size
        where, high, low = self.squares[column]
        whole = np.empty((count, BLOCK, count, BLOCK))
        whole[high, :, low, :] = blocks[where]
        whole[low, :, high, :] = blocks[where].transpose(0, 2, 1)
        return whole.reshape(count * BLOCK, count * BLOCK)

    def subtract(self, blocks: Float, column: int, matrix: Float) -> None:
        """Subtract a symmetric matrix over the rows below a block column, in place."""
        count = self.below[column].size
        where, high, low = self.squares[column]
        blocks[where] -= matrix.reshape(count, BLOCK, count, BLOCK)[high, :, low, :]

    def tall(self, blocks: Float, column: int) -> Float:
        """Return the blocks of a block column below the diagonal, stacked; shape (rows * BLOCK, BLOCK)."""
        rows = self.below[column]
        return blocks[self.number(rows, column)].reshape(rows.size * BLOCK, BLOCK)

    def put(self, blocks: Float, column: int, tall: Float) -> None:
        """Replace the blocks of a block column below the diagonal, in place."""
        rows = self.below[column]
        blocks[self.number(rows, column)] = tall.reshape(rows.size, BLOCK, BLOCK)


class BlockFactor:
    """The factor of a sparse symmetric matrix H.

    Args:
        matrix: H, a scipy.sparse array.
        pattern: its non-zeros, and those of all matrices in `trace` and `sandwich`.
    """

    @blas_threads(BLOCK)
    def __init__(self, matrix: Sparse, pattern: Sparse | None = None) -> None:
        self.layout = layout = Layout.of(matrix if pattern is None else pattern)
        self._left = layout.load(matrix, padding=1.0)  # P = S R below the diagonal
        self._roots = np.empty((layout.count, BLOCK, BLOCK))
        self._signs = np.empty((layout.count, BLOCK))
        for column in range(layout.count):
            # S = R^-T diag(signs) R^-1, P = S_KJ R for the rows K below, S_KL -= P_K diag(signs) P_L'
            values, vectors = np.linalg.eigh(self._left[layout.number(column, column)])
            self._signs[column] = np.where(values > 0, 1.0, -1.0)
            self._roots[column] = vectors / np.sqrt(np.maximum(np.abs(values), TINY))
            if layout.below[column].size:
                left = layout.tall(self._left, column) @ self._roots[column]
                layout.put(self._left, column, left)
                layout.subtract(self._left, column, (left * self._signs[column]) @ left.T)

    @property
    def negative(self) -> int:
        """Number of eigenvalues of H that are not positive."""
        return int(np.count_nonzero(self._signs < 0))

    def _columns(self) -> Iterator[tuple[int, Float, Float, Float]]:
        """Number, P, R and signs of each block column."""
        for column in range(self.layout.count):
            yield column, self.layout.tall(self._left, column), self._roots[column], self._signs[column]

    @blas_threads(BLOCK)
    def solve(self, right: Float) -> Float:
        """Return X of H X = B, shape (size, columns)."""
        layout, count = self.layout, right.shape[1]
        whole = np.zeros((layout.count * BLOCK, count))
        whole[layout.place] = right
        work = whole.reshape(layout.count, BLOCK, count)
        columns = list(self._columns())
        for column, left, root, signs in columns:
            own = signs[:, None] * (root.T @ work[column])
            work[column], rows = own, layout.below[column]
            work[rows] -= (left @ own).reshape(rows.size, BLOCK, count)
        for column, left, root, signs in reversed(columns):
            below = work[layout.below[column]].reshape(len(left), count)
            work[column] = root @ (work[column] - signs[:, None] * (left.T @ below))
        return whole[layout.place]

    @cached_property
    @blas_threads(BLOCK)
    def inverse(self) -> Float:
        """The blocks of H^-1 at the positions of those of the factor."""
        layout = self.layout
        inverse = np.zeros_like(self._left)
        for column, left, root, signs in reversed(list(self._columns())):
            inner = np.diag(signs)
            if len(left):
                reach = layout.square(inverse, column) @ (left * signs)
                layout.put(inverse, column, -reach @ root.T)
                inner = inner + (left * signs).T @ reach
            inverse[layout.number(column, column)] = root @ inner @ root.T
        return inverse

    @property
    def diagonal(self) -> Float:
        """The diagonal of H^-1."""
        return self._diagonal(self.inverse)

    def _diagonal(self, blocks: Float) -> Float:
        rows = np.arange(self.layout.count)
        whole = np.einsum("kii->ki", blocks[self.layout.number(rows, rows)]).ravel()
        return np.asarray(whole[self.layout.place])

    def trace(self, matrix: Sparse) -> float:
        """Return the trace of H^-1 M, for a symmetric M inside the pattern."""
        at, values = self.layout.entries(matrix)
        both = 2 * float(self.inverse.reshape(-1)[at] @ values)
        return both - float(self.diagonal @ matrix.diagonal())

    @blas_threads(BLOCK)
    def sandwich(self, matrix: Sparse) -> Float:
        """Return the diagonal of H^-1 M H^-1, for a symmetric M inside the pattern."""
        layout = self.layout
        slopes = layout.load(matrix, padding=0.0)  # of the Schur complements along M
        moves: list[Float] = []  # of G = S_KJ S_JJ^-1
        for column, left, root, signs in self._columns():
            own = slopes[layout.number(column, column)]
            gain = (left * signs) @ root.T
            half = layout.tall(slopes, column) - 0.5 * (gain @ own)
            moves.append(((half - 0.5 * (gain @ own)) @ (root * signs)) @ root.T)
            if len(left):
                product = gain @ half.T
                layout.subtract(slopes, column, product + product.T)
        moved = np.zeros_like(slopes)  # change of the inverse
        for column, left, root, signs in reversed(list(self._columns())):
            where = layout.number(column, column)
            turned = (root * signs).T
            own = -turned.T @ (root.T @ slopes[where] @ root) @ turned
            if len(left):
                gain, move = (left * signs) @ root.T, moves[column]
                beside = layout.tall(self.inverse, column)
                tall = -layout.square(moved, column) @ gain - layout.square(self.inverse, column) @ move
                layout.put(moved, column, tall)
                own = own - move.T @ beside - gain.T @ tall
            moved[where] = 0.5 * (own + own.T)
        return -self._diagonal(moved)
