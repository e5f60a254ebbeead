"""The small quadratic program of the multipliers: min 1/2 m'Sm - e'm, with m >= 0 except for equalities.

S is singular if limits depend on each other, such as the four slopes around a flat cell of a map.
"""

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.native.cholesky import Factor

RIDGE = 1e-12  # share of each row's product with itself that is added to it, so that dependent rows have a factor
NEGATIVE = 1e-10  # a multiplier below 0 by this share of the largest is wrong
PASSED = 1e-14  # a slope below 0 by this share of what it is summed from is wrong
PATIENCE = 6  # exchanges of whole blocks without a decrease of the number of wrong multipliers


def nonnegative_dual(matrix: Float, excess: Float, equalities: int, guess: Bool | None = None) -> Float:
    """Return the multipliers m, of which the first `equalities` are unbounded; `guess` marks those likely to be > 0.

    Block principal pivoting (J. Judice, F. Pires: A block principal pivoting algorithm for large-scale strictly
    monotone linear complementarity problems, 1994) ends after a few exchanges, or not at all if many rows depend on
    each other; then rows are exchanged one at a time. A row without values, with 0 on the diagonal of S, has no
    multiplier.
    """
    dual = _ActiveSetDual(matrix, excess, equalities)
    m = dual.by_blocks(dual.wanted > 0 if guess is None else guess)
    if m is None:
        m = dual.one_by_one()
    return np.where(dual.bounded, np.maximum(m, 0.0), m)


def solve_active(matrix: Float, active: Bool, right: Float) -> Float:
    """Solve S m = right for the multipliers of the `active` rows; the others are 0.

    A ridge makes dependent rows solvable; a second solve restores the digits that it costs (J. Riley: Solving
    systems of linear equations with a positive definite, symmetric, but possibly ill-conditioned matrix, 1955). NaN if
    S is not finite.
    """
    m, which = np.zeros(active.size), np.flatnonzero(active)
    factor = _ridged(matrix, which)
    if factor is None:
        m[which] = np.nan
        return m
    m[which] = factor.solve(right[which])
    m[which] += factor.solve((right - matrix @ m)[which])
    return m


def _ridged(matrix: Float, which: Int) -> Factor | None:
    ridge = RIDGE * np.diag(matrix)
    while (factor := Factor.part(matrix, which, ridge)) is None and ridge.max() <= matrix.max():
        ridge = 100 * ridge
    return factor


class _ActiveSetDual:
    """The program; violations are measured in units of the length of each row."""

    def __init__(self, matrix: Float, excess: Float, equalities: int) -> None:
        self.matrix, self.excess = matrix, excess
        self.entered = np.diag(matrix) > 1e-300
        self.bounded = self.entered & (np.arange(excess.size) >= equalities)
        self.scale = np.sqrt(np.where(self.entered, np.diag(matrix), 1.0))
        self.wanted = np.where(self.entered, excess / self.scale, 0.0)

    def by_blocks(self, guess: Bool) -> Float | None:
        """Exchange all wrong multipliers at once; None if that does not end."""
        inside = self.entered & (~self.bounded | guess)
        best, patience = inside.size + 1, PATIENCE
        while patience:
            m = self.solved(inside)
            wrong = self.bounded & np.where(inside, self.negative(m), self.slope(m) < -self.rounding(m))
            count = int(np.count_nonzero(wrong))
            if count == 0:
                return m
            best, patience = (count, PATIENCE) if count < best else (best, patience - 1)
            inside ^= wrong
        return None

    def one_by_one(self) -> Float:
        """Add the row with the steepest slope, and remove those that reach 0 on the way, until none is left.

        The cost falls with each step, so that no active set occurs twice (C. Lawson, R. Hanson: Solving least squares
        problems, 1974, chapter 23).
        """
        inside = self.entered & ~self.bounded
        useless = np.zeros(inside.size, dtype=bool)
        m = self.solved(inside)
        for _ in range(10 * inside.size):
            slope = np.where(self.bounded & ~inside & ~useless, self.slope(m), np.inf)
            entering = int(np.argmin(slope))
            if not slope[entering] < -self.rounding(m):
                break
            inside[entering] = True
            moved = self._towards_zero_slope(m, inside)
            useless[entering] = not inside[entering] and np.array_equal(moved, m)
            if not useless[entering]:
                useless[:] = False
            m = moved
        return m

    def _towards_zero_slope(self, m: Float, inside: Bool) -> Float:
        """Move to the multipliers with zero slope `inside`; those that would fall below 0 on the way leave the set."""
        while True:
            target = self.solved(inside)
            falling = self.bounded & inside & (target <= 0)
            if not falling.any() or not np.all(np.isfinite(target)):
                return target
            shares = np.full(m.size, np.inf)
            shares[falling] = m[falling] / np.where(m > target, m - target, 1.0)[falling]
            share = float(shares.min())
            m = m + share * (target - m)
            inside &= shares > share
            m[self.bounded & ~inside] = 0.0

    def solved(self, inside: Bool) -> Float:
        """Return the multipliers with zero slope `inside`; the others are 0."""
        return solve_active(self.matrix, inside, self.excess)

    def slope(self, m: Float) -> Float:
        """Return the derivative of the cost with respect to each multiplier."""
        slope: Float = (self.matrix @ m - self.excess) / self.scale
        return slope

    def rounding(self, m: Float) -> float:
        """Return the size below which a slope counts as 0."""
        summed = np.abs(self.wanted).max(initial=0.0) + np.abs(m * self.scale).sum()
        return PASSED * float(summed)

    def negative(self, m: Float) -> Bool:
        """Mark the multipliers below 0 by more than rounding."""
        scaled = m * self.scale
        negative: Bool = scaled < -NEGATIVE * np.abs(scaled).max(initial=0.0)
        return negative
