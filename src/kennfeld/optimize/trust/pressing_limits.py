"""Bounds and linear rows at the end of a fit: those that determine values, and those that are merely touched.

At a minimum within the limits a'd <= 0 of the touched ones, the gradient is g = -sum m a with multipliers m >= 0. A
limit with m > 0 presses: each change that keeps the minimum also keeps a'd = 0. One that is touched with m = 0
determines nothing, even if the values ended there: along a direction that has no effect on the cost, where the search
stops is chance (J. Nocedal, S. Wright: Numerical Optimization, 2006, definition 12.5 of strict complementarity).

The multipliers are not unique if rows depend on each other, such as the four slopes around a flat cell. A row without
one in the solution at hand may have one in another. It has if its opposite is a nonnegative combination of the touched
rows, apart from those that press anyway.
"""

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.solver.quadratic_program import nonnegative_dual

TOUCHING = 1e-9  # of the size of a row: how near to its side a row counts as met
# of the length of residual and column: an eigenvalue whose square root this is counts as 0, see `information_matrix`
PRESSING = 1e-6
SHARE = 1e-7  # of the largest multiplier: what is smaller is rounding
DEPENDENT = 1e-6  # of its length: what remains of a row that is a combination of others


@dataclass(frozen=True)
class TouchedLimits:
    """The limits that the values are at; `sign` is that of the allowed changes' opposite: -1 at a lower bound.

    Values without effect on the cost count as locked or free, never as at a bound. `rows` are inequalities a, oriented
    such that changes with a'd <= 0 are allowed; `equal` are equalities.
    """

    locked: Bool  # Bool[values]
    sign: Float  # Float[values]: +1 at an upper bound, -1 at a lower one, else 0
    equal: Float  # Float[equalities, values]
    rows: Float  # Float[touched, values]

    @classmethod
    def of(cls, limits: LinearLimits, values: Float, curvature: Float) -> "TouchedLimits":
        """Find the limits that values touch, given the curvature of the cost along each value; Float[values] each."""
        movable = limits.movable
        at_bound = np.where(values >= limits.upper, 1.0, np.where(values <= limits.lower, -1.0, 0.0))
        rows = limits.rows
        met = np.flatnonzero(rows.touching(values, TOUCHING) & ~rows.equal)
        product = rows.times(values)[met]
        # the nearer side is the one that is met
        outward = np.where(product - rows.lower[met] < rows.upper[met] - product, -1.0, 1.0)
        return cls(
            ~movable,
            np.where(movable & (curvature > 0), at_bound, 0.0),
            rows.matrix(np.flatnonzero(rows.equal), values.size),
            rows.matrix(met, values.size) * outward[:, None],
        )

    @property
    def fixed(self) -> Bool:
        """Mask of the values that are locked or at a bound, Bool[values]."""
        return np.asarray(self.locked | (self.sign != 0))

    @property
    def all_rows(self) -> Float:
        """Equalities and touched rows, Float[rows, values]."""
        return np.vstack([self.equal, self.rows])

    def pressing(self, gradient: Float, curvature: Float, cost: float) -> "TouchedLimits":
        """Return the limits that press.

        Args:
            gradient: half that of the cost, at the minimum with the touched limits as equalities; shape (values,).
            curvature: of the cost along each value; shape (values,).
            cost: at the end of the fit.
        """
        units = np.sqrt(curvature)
        # Cauchy and Schwarz: no residual of this cost has a slope above the product of the lengths
        slope = np.where(np.abs(gradient) > PRESSING * np.sqrt(cost) * units, gradient, 0.0)
        tied = np.any(self.all_rows != 0, axis=0) & ~self.locked
        # a bound whose value is in no row has its multiplier in the gradient: g = -m a, which is < 0 at an upper bound
        alone = (self.sign != 0) & (self.sign * slope < 0)
        if not len(self.rows) and not (tied & (self.sign != 0)).any():
            return self._only(alone, np.zeros(0, dtype=bool))
        bounds = np.flatnonzero(tied & (self.sign != 0))
        # changes with the same effect on the cost; values without an effect get the largest of them
        scale = 1 / np.where(units > 0, units, np.min(units[units > 0], initial=np.inf) if units.any() else 1.0)
        matrix = np.vstack([self.equal, self.rows, np.diag(self.sign)[bounds]])[:, tied] * scale[tied]
        holds = _hold(matrix, (slope * scale)[tied], len(self.equal))
        count = len(self.rows)
        pressing = alone & ~tied
        pressing[bounds] = holds[count:]
        return self._only(pressing, holds[:count])

    def _only(self, bounds: Bool, rows: Bool) -> "TouchedLimits":
        return TouchedLimits(self.locked, np.where(bounds, self.sign, 0.0), self.equal, self.rows[rows])

    def count(self) -> int:
        """Return the number of bounds and rows that are touched."""
        return int(np.count_nonzero(self.sign)) + len(self.rows)


def _hold(matrix: Float, slope: Float, equalities: int) -> Bool:
    """Mark the inequalities that hold with equality for each change that keeps the minimum; see the module.

    Args:
        matrix: rows of equalities, then of inequalities a'd <= 0; shape (rows, values).
        slope: gradient of the cost; shape (values,).
        equalities: number of equalities.
    """
    length = np.linalg.norm(matrix, axis=1)
    used = length > 0
    rows = matrix / np.where(used, length, 1.0)[:, None]
    multipliers = nonnegative_dual(rows @ rows.T, -rows @ slope, equalities)
    holds = multipliers > SHARE * np.abs(multipliers).max(initial=0.0)
    holds[:equalities] = True
    # rows that follow from those that press hold anyway; the others hold if they are opposed
    rest = rows - _project(rows[holds & used], rows)
    open_rows = np.flatnonzero(used & ~holds & (np.linalg.norm(rest, axis=1) > DEPENDENT))
    holds[open_rows[_opposed(rest[open_rows])]] = True
    return np.asarray(holds[equalities:])


def _project(spanning: Float, rows: Float) -> Float:
    """Return the parts of rows in the span of others."""
    _, sizes, right = np.linalg.svd(spanning, full_matrices=False)
    basis = right[sizes > DEPENDENT * sizes[:1]]
    return np.asarray(rows @ basis.T @ basis)


def _opposed(rows: Float) -> Bool:
    """Mark the rows whose opposite is a nonnegative combination of the others, so that a'd <= 0 implies a'd = 0.

    >>> _opposed(np.array([[1.0, 0.0], [-2.0, 0.0], [0.0, 1.0]])).tolist()
    [True, True, False]
    """
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    gram = rows @ rows.T
    opposed = np.zeros(len(rows), dtype=bool)
    for i in range(len(rows)):
        # -r_i = sum of s_j r_j with s >= 0 needs a row with r_i'r_j < 0
        if opposed[i] or not (gram[i] < -DEPENDENT).any():
            continue
        # nonnegative least squares: min |r_i + sum of s_j r_j| over s >= 0
        shares = nonnegative_dual(gram, -gram[i], 0)
        if np.linalg.norm(rows[i] + shares @ rows) <= DEPENDENT * (1 + shares.sum()):
            opposed |= shares > SHARE * shares.max()
            opposed[i] = True
    return opposed
