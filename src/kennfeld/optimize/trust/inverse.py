"""The inverse of an information matrix, as an array or by a sparse factor."""

from functools import cached_property
from typing import Protocol

import numpy as np

from kennfeld.base.arrays import Float, Int, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.selected_inverse import SparseFactor
from kennfeld.optimize.trust.matrices import Matrix, part, rescale


class Inverse(Protocol):
    """The inverse of H, or its pseudo-inverse if H has undetermined directions."""

    @property
    def array(self) -> Float:
        """All of it, Float[values, values]."""

    @property
    def diagonal(self) -> Float:
        """Its diagonal, Float[values]."""

    def times(self, rows: Float) -> Float:
        """Return rows @ H^-1, for a vector, Float[values], or rows, Float[rows, values]."""

    def trace(self, matrix: Matrix) -> float:
        """Return the trace of H^-1 M, with M [values, values]; M is 0 along what H leaves undetermined."""

    def sandwich(self, matrix: Matrix) -> Float:
        """Return the diagonal of H^-1 M H^-1, Float[values]; M is 0 along what H leaves undetermined."""


@dataclass(frozen=True)
class DenseInverse:
    """The inverse itself."""

    array: Float

    @property
    def diagonal(self) -> Float:
        return self.array.diagonal()

    def times(self, rows: Float) -> Float:
        return np.asarray(rows @ self.array)

    def trace(self, matrix: Matrix) -> float:
        products = self.array * matrix if isinstance(matrix, np.ndarray) else matrix.multiply(self.array)
        return float(np.sum(products))

    def sandwich(self, matrix: Matrix) -> Float:
        return np.asarray(np.einsum("ij,ij->i", self.array @ matrix, self.array))


class SparseInverse:
    """The inverse of a sparse matrix H, from a factor of it.

    If H has undetermined directions N (orthonormal in units of `scale`), as many values are fixed, so that the inverse
    G over the other values exists; then H^+ = P G P with the projection P = 1 - N N'. M is 0 along N.

    Args:
        matrix: H.
        pattern: the non-zeros of H and of the matrices in `trace` and `sandwich`.
        scale: units of the values, the root of the diagonal of H.
        null: N, shape (values, dimension).
        fixed: numbers of the fixed values, as many as N has columns.
    """

    def __init__(self, matrix: Sparse, pattern: Sparse, scale: Float, null: Float, fixed: Int) -> None:
        self.scale, self.null = scale, null
        free = np.ones(scale.size, dtype=bool)
        free[fixed] = False
        self.free = np.flatnonzero(free)
        self.factor = SparseFactor(self._own(matrix), part(pattern, self.free))

    @cached_property
    def array(self) -> Float:
        return self.times(np.eye(self.scale.size))

    @cached_property
    def diagonal(self) -> Float:
        return self._diagonal_of(self.factor.diagonal, self._reach) / self.scale**2

    def times(self, rows: Float) -> Float:
        columns = self._project(np.atleast_2d(rows).T / self.scale[:, None])
        result: Float = self._project(self._solve(columns)).T / self.scale
        return result.reshape(rows.shape)

    def trace(self, matrix: Matrix) -> float:
        # the projection drops out: trace(P G P M) = trace(G M), as M N = 0
        return self.factor.trace(self._own(matrix))

    def sandwich(self, matrix: Matrix) -> Float:
        own = self._own(matrix)
        reach = np.zeros_like(self.null)
        # H^+ M H^+ = P (G M G) P, so that A = G M G and A N = G M (G N)
        reach[self.free] = self.factor.solve(own @ self._reach[self.free])
        return self._diagonal_of(self.factor.sandwich(own), reach) / self.scale**2

    @cached_property
    def _reach(self) -> Float:
        """G N."""
        return self._solve(self.null)

    def _solve(self, columns: Float) -> Float:
        """Return G times columns, in units of the scale."""
        result = np.zeros_like(columns)
        result[self.free] = self.factor.solve(columns[self.free])
        return result

    def _project(self, columns: Float) -> Float:
        return columns - self.null @ (self.null.T @ columns)

    def _diagonal_of(self, own: Float, reach: Float) -> Float:
        """Return the diagonal of P A P, from that of A over the values that are free, and A N."""
        result = np.zeros(self.scale.size)
        result[self.free] = own
        # (P A P)_ii = A_ii - 2 (A N)_i N_i' + N_i (N'A N) N_i', with the rows N_i of N
        result += np.einsum("ij,ij->i", self.null @ (self.null.T @ reach) - 2 * reach, self.null)
        return result

    def _own(self, matrix: Sparse) -> Sparse:
        """Return the part of a matrix over the values that are free, in units of the scale."""
        return rescale(part(matrix, self.free), 1 / self.scale[self.free])
