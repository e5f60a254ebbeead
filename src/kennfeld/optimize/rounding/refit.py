"""Values that are stored in floating point make up for the rounding of the others.

Of the quadratic model d'Hd, the floating values F are eliminated: given d of the rounded values R, the best ones are

    d[F] = -H[F,F]^-1 H[F,R] d[R],    which leaves    d[R]' (H[R,R] - H[R,F] H[F,F]^-1 H[F,R]) d[R].

Rounding searches with the matrix in parentheses. Then the floating values are computed within their limits.
"""

import numpy as np

from kennfeld.base.arrays import Float, Int, Sparse
from kennfeld.domain.storage import FloatStorage, StorageRounding
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.native.cholesky import Cholesky, Factor
from kennfeld.native.symmetric import scaled
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.rounding.lattice import PULL, SLACK
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.solver.quadratic_program import QuadraticProgram

RESOLUTION = 1.2e-7  # of single precision
MOST_COUPLED = 1000  # rounded values that floating ones may couple with each other in the search


class FloatRefit:
    """The floating values of a fit, which follow the rounding of the others.

    Args:
        problem: the problem.
        layout: the places of its values.
        rounding: says which parameters are stored in floating point.
        limits: bounds, locks and rows of the free values.
        fit: the free values at the end of the search, Float[free].
        matrix: the curvature of the cost over all free values; sparse, shape (free, free).
    """

    def __init__(
        self,
        problem: Problem,
        layout: ValueLayout,
        rounding: StorageRounding,
        limits: LinearLimits,
        fit: Float,
        matrix: Sparse,
    ) -> None:
        self._limits, self._fit, self._matrix = limits, fit, matrix.tocsr()
        self._blocks: list[tuple[Int, FloatStorage]] = []
        for name in problem.free_names:
            table = problem.parameters[name]
            if name in rounding.floats and table.kind != "rbf":
                places = layout.offsets[name] + np.arange(table.size)
                self._blocks.append((places[limits.movable[places]], rounding.floats[name]))
        self._places = np.concatenate([np.zeros(0, dtype=np.int64), *(places for places, _ in self._blocks)])
        self._factor = self._factored()

    def _factored(self) -> Factor | None:
        if not self._places.size:
            return None
        own = self._matrix[self._places][:, self._places]
        diagonal = own.diagonal()
        # a pull towards the fit, as that of rounded values, but relative, as there is no step; the second part is for
        # values without data, which have no slope either
        damping = PULL * diagonal + SLACK * diagonal.max() + np.where(diagonal > 0, 0.0, 1.0)
        return Cholesky(self._places.size).factor(scaled(own, np.ones(self._places.size)), damping)

    def reduced(self) -> Sparse:
        """Return the matrix after the elimination of the floating values, shape (free, free).

        It is the given one if these couple too many values, whose rounding is then only followed.
        """
        from scipy.sparse import csr_array

        if self._factor is None:
            return self._matrix
        cross = self._matrix[self._places].tocsc()
        coupled = np.setdiff1d(np.flatnonzero(np.diff(cross.indptr)), self._places)
        if not 0 < coupled.size <= MOST_COUPLED:
            return self._matrix
        right = cross[:, coupled].toarray()
        change = right.T @ self._factor.solve(np.ascontiguousarray(right.T)).T
        rows, columns = np.repeat(coupled, coupled.size), np.tile(coupled, coupled.size)
        symmetric = (0.5 * (change + change.T)).ravel()
        return (self._matrix - csr_array((symmetric, (rows, columns)), shape=self._matrix.shape)).tocsr()

    def stored(self, values: Float) -> Float:
        """Return free values, Float[free], with the floating ones as they are stored, within their bounds."""
        values = values.copy()
        for places, storage in self._blocks:
            lower, upper = self._limits.lower[places], self._limits.upper[places]
            nearest = storage.nearest(values[places])
            # of a value at its bound, the next number inside may be the nearest that is allowed
            way = np.where(nearest < lower, 1.0, np.where(nearest > upper, -1.0, 0.0))
            inside = storage.nearest(nearest + way * RESOLUTION * np.abs(nearest))
            values[places] = np.where((inside >= lower) & (inside <= upper), inside, values[places])
        return values

    def following(self, values: Float) -> Float:
        """Return free values, Float[free], with the floating ones that suit the others best."""
        if self._factor is None:
            return values
        places = self._places
        slope = (self._matrix @ (values - self._fit))[places]
        narrow, at = self._limits.restricted_to(places, values), values[places]
        moved = values.copy()
        moved[places] = (
            QuadraticProgram(narrow).solve(self._factor, -self._factor.solve(slope), at).apply_to(at, narrow)
        )
        return self.stored(moved) if np.isfinite(moved[places]).all() else values
