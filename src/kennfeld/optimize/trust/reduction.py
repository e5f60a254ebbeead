"""What limits leave free: the values that still move on their own, and how the others follow them."""

from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.optimize.limits.limits import Limits
from kennfeld.optimize.trust.matrices import Matrix, part

__all__ = ["Reduction", "active_rows", "held"]

TOUCHING = 1e-9  # of the size of a row: how near to its side a row counts as met
REDUNDANT = 1e-10  # of a row's largest coefficient: what remains of a row that follows from others


def held(limits: Limits, values: Float, gradient: Float, rows: Float) -> Bool:
    """Values that a lock holds, or a bound that the cost presses them against while the `rows` stay as they are."""
    low, high = values <= limits.lower, values >= limits.upper
    inside = limits.movable & ~low & ~high
    multipliers = np.linalg.lstsq(rows[:, inside].T, -gradient[inside], rcond=None)[0]
    slope = gradient + multipliers @ rows
    found: Bool = (low & (slope >= 0)) | (high & (slope <= 0)) | ~limits.movable
    return found


def active_rows(limits: Limits, values: Float) -> Float:
    """Rows a of the linear limits that are met with equality, a'p = b; shape (rows, values)."""
    rows = limits.rows
    product, slack = rows.times(values), TOUCHING * rows.size(values)
    touching = rows.equal | (product <= rows.lower + slack) | (product >= rows.upper - slack)
    return rows.matrix(np.flatnonzero(touching), values.size)


@dataclass(frozen=True)
class Reduction:
    """Values p of which some are held, and others follow the `independent` ones through linear equalities.

    A change q of the independent values changes the `dependent` ones by `follow @ q`, and the held ones not at all.

    >>> reduction = Reduction.of(np.array([False, False, True]), np.array([[1.0, 2.0, 0.0]]))
    >>> reduction.independent, reduction.expand(np.array([2.0]))
    (array([0]), array([ 2., -1.,  0.]))
    """

    size: int
    independent: Int
    dependent: Int
    follow: Float  # Float[dependent, independent]

    @classmethod
    def of(cls, held: Bool, rows: Float) -> "Reduction":
        """Eliminate a value for each row, that of the largest coefficient; rows that say nothing new fall out."""
        moving = np.flatnonzero(~held)
        work = np.array(rows[:, moving], dtype=np.float64)
        typical = np.abs(work).max(axis=1, initial=0.0)
        pivots: list[int] = []
        used: list[int] = []
        for _ in range(len(work)):
            left = np.abs(work) / np.where(typical > 0, typical, 1.0)[:, None]
            left[used] = 0.0
            row, column = np.unravel_index(int(left.argmax()), left.shape) if left.size else (0, 0)
            if not left.size or left[row, column] <= REDUNDANT:
                break
            work[row] /= work[row, column]
            others = np.arange(len(work)) != row
            work[others] -= np.outer(work[others, column], work[row])
            used.append(int(row))
            pivots.append(int(column))
        rest = np.setdiff1d(np.arange(moving.size), pivots)
        return cls(held.size, moving[rest], moving[pivots], -work[used][:, rest])

    @property
    def held(self) -> Bool:
        """Values that do not change, whatever the independent ones do."""
        found = np.ones(self.size, dtype=bool)
        found[self.independent] = False
        found[self.dependent] = ~self.follow.any(axis=1)
        return found

    def expand(self, changes: Float) -> Float:
        """Changes of all values, from those of the independent ones in the last dimension."""
        full = np.zeros((*changes.shape[:-1], self.size))
        full[..., self.independent] = changes
        full[..., self.dependent] = changes @ self.follow.T
        return full

    def matrix(self, matrix: Matrix) -> Matrix:
        """Z'MZ, where Z expands changes of the independent values; M itself where all of them are."""
        found = part(matrix, self.independent)
        if not self.dependent.size:
            return found
        if isinstance(matrix, np.ndarray):
            cross = self.follow.T @ matrix[np.ix_(self.dependent, self.independent)]
            found = found + cross + cross.T
            found += self.follow.T @ matrix[np.ix_(self.dependent, self.dependent)] @ self.follow
            return found
        from scipy.sparse import csr_array

        follow = csr_array(self.follow)
        cross = follow.T @ matrix[self.dependent][:, self.independent]
        return csr_array(found + cross + cross.T + follow.T @ part(matrix, self.dependent) @ follow)

    def vector(self, vector: Float) -> Float:
        """Z'v."""
        found: Float = vector[self.independent] + self.follow.T @ vector[self.dependent]
        return found

    def rows(self, rows: Float) -> Float:
        """Rows over all values as rows over the independent ones."""
        found: Float = rows[:, self.independent]
        return found + rows[:, self.dependent] @ self.follow if self.dependent.size else found
