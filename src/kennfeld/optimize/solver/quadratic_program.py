"""The convex quadratic program of one step: min 1/2 d'Hd + g'd within bounds and linear rows.

H is factored once. If the free step violates limits, the violated ones, or those active before, enter a small dual
problem with the matrix S = A H^-1 A', computed from the same factor (see `native.gram`). This is repeated until none is
violated; it ends because limits are only added. Limits are rows a'd <= b; a bound is a row with a single entry.

The dual problem of the multipliers is min 1/2 m'Sm - e'm, with m >= 0 except for equalities. S is singular if limits
depend on each other, such as the four slopes around a flat cell of a map.
"""

from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.native.cholesky import Factor
from kennfeld.native.gram import Gram
from kennfeld.optimize.solver.linear_constraints import LinearLimits

FEASIBLE = 1e-12  # violation of a limit relative to its scale that counts as rounding
REFINEMENTS = 3  # corrections of the multipliers by the remaining violation of their step
RIDGE = 1e-12  # share of each row's product with itself that is added to it, so that dependent rows have a factor
NEGATIVE = 1e-10  # a multiplier below 0 by this share of the largest is wrong
PASSED = 1e-14  # a slope below 0 by this share of what it is summed from is wrong
PATIENCE = 6  # exchanges of whole blocks without a decrease of the number of wrong multipliers


@dataclass(frozen=True)
class QpSolution:
    """The step and its active limits: +1 at an upper, -1 at a lower side, else 0; bounds first, then rows.

    Equalities, which always hold, are not marked.
    """

    step: Float
    active: Int

    def apply_to(self, at: Float, limits: LinearLimits) -> Float:
        """Return the values after the step from `at`: within all bounds, and exactly at the active ones.

        A value next to its bound by rounding would be free in the next step, and see another derivative there if it is
        a breakpoint at the end of the data.
        """
        active = self.active[: at.size]
        bound = np.where(active > 0, limits.upper, limits.lower)
        return np.where(active != 0, bound, limits.clip(at + self.step))


def solve(factor: Factor, free_step: Float, at: Float, limits: LinearLimits, guess: Int | None = None) -> QpSolution:
    """Minimise the quadratic program at the point `at`.

    Args:
        factor: of H.
        free_step: -H^-1 g, Float[values].
        at: the values, Float[values].
        limits: bounds and rows.
        guess: limits likely to be active, Int[values + rows].
    """
    room = _StepBounds(at, limits)
    equal = np.concatenate([np.zeros(at.size, dtype=bool), limits.rows.equal])
    violated = np.where(equal, 0, room.violated(free_step))
    if not equal.any() and not violated.any():
        return QpSolution(free_step, violated)
    dual = _DualProblem(factor, free_step, limits, room, np.flatnonzero(equal))
    dual.add(violated if guess is None else np.where(equal, 0, guess))
    # d = d_free - H^-1 A'm with the multipliers m of the limits A considered so far; A gains the rows that d violates
    for _ in range(2 * equal.size + 1):
        step = dual.step()
        violated = dual.without_known(np.where(equal, 0, room.violated(step)))
        if not violated.any():
            break
        dual.add(violated)
    return QpSolution(step, dual.active())


class _StepBounds:
    """Bounds of a step from a point: the sides of all bounds, then of all rows."""

    def __init__(self, at: Float, limits: LinearLimits) -> None:
        self.rows = limits.rows
        here = np.concatenate([at, self.rows.times(at)])
        self.upper = np.concatenate([limits.upper, self.rows.upper]) - here
        self.lower = np.concatenate([limits.lower, self.rows.lower]) - here
        summed = np.concatenate([np.abs(at), self.rows.size(at)])
        self.scales = tuple(
            np.where(np.isfinite(side), np.abs(side), 0.0) + summed + 1e-300 for side in (self.upper, self.lower)
        )

    def changes(self, step: Float) -> Float:
        """Return the change of all values and rows over a step."""
        return np.concatenate([step, self.rows.times(step)])

    def violated(self, step: Float) -> Int:
        """Return the limits that a step violates by more than rounding: +1 upper, -1 lower, else 0."""
        changes = self.changes(step)
        violated: Int = np.where(changes > self.upper, 1, np.where(changes < self.lower, -1, 0))
        if violated.any():
            over, under = self.rounding(step)
            violated[(changes <= self.upper + over) & (changes >= self.lower - under)] = 0
        return violated

    def rounding(self, step: Float) -> tuple[Float, Float]:
        """Return the rounding error at the upper and the lower sides after a step."""
        sizes = np.concatenate([np.abs(step), self.rows.size(step)])
        upper, lower = (FEASIBLE * (scale + sizes) for scale in self.scales)
        return upper, lower


class _DualProblem:
    """The limits under consideration, equalities first, as rows A of the dual program.

    It is min 1/2 m'Sm - e'm with m >= 0, where S = A H^-1 A' and e is the violation of each limit by the free step; the
    step is the free one minus H^-1 A'm. Lower sides enter with the opposite sign.
    """

    def __init__(self, factor: Factor, free_step: Float, limits: LinearLimits, room: _StepBounds, equal: Int) -> None:
        self.factor, self.free_step, self.limits, self.room, self.equal = factor, free_step, limits, room, equal
        self.free_changes = room.changes(free_step)
        self.gram = Gram(factor)
        # the rows A; below, for each of them: e, the number and the side of its limit, and if its multiplier is > 0
        self.columns = np.zeros((0, max(limits.rows.columns.shape[1], 1)), dtype=np.int64)
        self.coefficients = np.zeros(self.columns.shape)
        self.excess = np.zeros(0)
        self.which = np.zeros(0, dtype=np.int64)
        self.signs = np.zeros(0, dtype=np.int64)
        self.pressing = np.zeros(0, dtype=bool)

    def without_known(self, signs: Int) -> Int:
        """Return the limits that are not considered yet."""
        signs[self.which[signs[self.which] == self.signs]] = 0
        return signs

    def add(self, signs: Int) -> None:
        """Add finite limits with `signs` != 0; with the first ones, the equalities."""
        side = np.where(signs > 0, self.room.upper, self.room.lower)
        which = np.flatnonzero((signs != 0) & np.isfinite(side))
        if not self.which.size:
            which = np.concatenate([self.equal, which])
        if not which.size:
            return
        signs = np.where(signs[which] < 0, -1, 1)
        columns, coefficients = self._entries(which)
        coefficients *= signs[:, None]
        self.gram.add(columns, coefficients)
        self.columns = np.concatenate([self.columns, columns])
        self.coefficients = np.concatenate([self.coefficients, coefficients])
        side = np.where(signs > 0, self.room.upper[which], self.room.lower[which])
        self.excess = np.concatenate([self.excess, signs * (self.free_changes[which] - side)])
        self.which = np.concatenate([self.which, which])
        self.signs = np.concatenate([self.signs, signs])
        self.pressing = np.concatenate([self.pressing, np.ones(which.size, dtype=bool)])

    def _entries(self, which: Int) -> tuple[Int, Float]:
        """Return columns and coefficients of limits; a bound has a single 1."""
        values, rows = self.free_step.size, self.limits.rows
        columns = np.zeros((which.size, self.columns.shape[1]), dtype=np.int64)
        coefficients = np.zeros(columns.shape)
        bound = which < values
        columns[bound, 0], coefficients[bound, 0] = which[bound], 1.0
        if not bound.all():
            columns[~bound] = rows.columns[which[~bound] - values]
            coefficients[~bound] = rows.coefficients[which[~bound] - values]
        return columns, coefficients

    def step(self) -> Float:
        if not self.excess.size:
            return self.free_step
        multipliers = nonnegative_dual(self.gram.products, self.excess, self.equal.size, self.pressing)
        self.pressing = multipliers > 0
        return self._refined(multipliers)

    def _refined(self, multipliers: Float) -> Float:
        """Return the step of these multipliers, corrected until it is on its active limits.

        Along directions that neither data nor smoothness determine, H is nearly singular and A H^-1 A' loses the digits
        that tie one such value to the next; the violation of the step restores them.
        """
        holding = self.pressing.copy()
        holding[: self.equal.size] = np.diag(self.gram.products)[: self.equal.size] > 0
        step: Float = self.free_step - self._displacement(multipliers)
        bounds = self._side(self.room.upper, self.room.lower)
        for _ in range(REFINEMENTS):
            # v = A d - b, the violation of the limits; then d -= H^-1 A' (A H^-1 A')^-1 v over those that hold
            violation = self.signs * (self.room.changes(step)[self.which] - bounds)
            rounding = self._side(*self.room.rounding(step))
            holding |= violation > rounding
            violation = np.where(holding, violation, 0.0)
            if np.all(np.abs(violation) <= rounding) or not np.all(np.isfinite(violation)):
                break
            step = step - self._displacement(solve_active(self.gram.products, holding, violation))
        return step

    def _displacement(self, multipliers: Float) -> Float:
        """Return H^-1 A'm."""
        pulls = self.coefficients * multipliers[:, None]
        pull = np.asarray(np.bincount(self.columns.ravel(), pulls.ravel(), self.free_step.size), dtype=np.float64)
        return self.factor.solve(pull)

    def _side(self, upper: Float, lower: Float) -> Float:
        """Select for each limit considered the entry of its upper or lower side."""
        return np.where(self.signs > 0, upper[self.which], lower[self.which])

    def active(self) -> Int:
        """Return `QpSolution.active`."""
        signs = np.zeros(self.free_changes.size, dtype=np.int64)
        pressing = self.pressing.copy()
        pressing[: self.equal.size] = False
        signs[self.which[pressing]] = self.signs[pressing]
        return signs


def nonnegative_dual(matrix: Float, excess: Float, equalities: int, guess: Bool | None = None) -> Float:
    """Return the multipliers m, of which the first `equalities` are unbounded; `guess` marks those likely to be > 0.

    Block principal pivoting (J. Judice, F. Pires: A block principal pivoting algorithm for large-scale strictly
    monotone linear complementarity problems, 1994) ends after a few exchanges, or not at all if many rows depend on
    each other; then rows are exchanged one at a time. A row without values, with 0 on the diagonal of S, has no
    multiplier.
    """
    dual = _ActiveSetDual(matrix, excess, equalities)
    m = dual.exchange_blocks(dual.wanted > 0 if guess is None else guess)
    if m is None:
        m = dual.exchange_rows()
    return np.where(dual.bounded, np.maximum(m, 0.0), m)


def solve_active(matrix: Float, active: Bool, right: Float) -> Float:
    """Solve S m = right for the multipliers of the `active` rows; the others are 0.

    A ridge makes dependent rows solvable; a second solve restores the digits that it costs (J. Riley: Solving
    systems of linear equations with a positive definite, symmetric, but possibly ill-conditioned matrix, 1955). NaN if
    S is not finite.
    """
    m, which = np.zeros(active.size), np.flatnonzero(active)
    ridge = RIDGE * np.diag(matrix)
    while (factor := Factor.part(matrix, which, ridge)) is None and ridge.max() <= matrix.max():
        ridge = 100 * ridge
    if factor is None:
        m[which] = np.nan
        return m
    m[which] = factor.solve(right[which])
    m[which] += factor.solve((right - matrix @ m)[which])
    return m


class _ActiveSetDual:
    """The program; violations are measured in units of the length of each row."""

    def __init__(self, matrix: Float, excess: Float, equalities: int) -> None:
        self.matrix, self.excess = matrix, excess
        self.entered = np.diag(matrix) > 1e-300
        self.bounded = self.entered & (np.arange(excess.size) >= equalities)
        self.scale = np.sqrt(np.where(self.entered, np.diag(matrix), 1.0))
        self.wanted = np.where(self.entered, excess / self.scale, 0.0)

    def exchange_blocks(self, guess: Bool) -> Float | None:
        """Exchange all wrong multipliers at once; None if that does not end."""
        inside = self.entered & (~self.bounded | guess)
        best, patience = inside.size + 1, PATIENCE
        while patience:
            # S m = e inside, m = 0 outside; wrong are m < 0 inside and slopes S m - e < 0 outside
            m = solve_active(self.matrix, inside, self.excess)
            scaled = m * self.scale
            negative = scaled < -NEGATIVE * np.abs(scaled).max(initial=0.0)
            wrong = self.bounded & np.where(inside, negative, self.slope(m) < -self.rounding(m))
            count = int(np.count_nonzero(wrong))
            if count == 0:
                return m
            best, patience = (count, PATIENCE) if count < best else (best, patience - 1)
            inside ^= wrong
        return None

    def exchange_rows(self) -> Float:
        """Add the row with the steepest slope, and remove those that reach 0 on the way, until none is left.

        The cost falls with each step, so that no active set occurs twice (C. Lawson, R. Hanson: Solving least squares
        problems, 1974, chapter 23).
        """
        inside = self.entered & ~self.bounded
        useless = np.zeros(inside.size, dtype=bool)
        m = solve_active(self.matrix, inside, self.excess)
        for _ in range(10 * inside.size):
            slope = np.where(self.bounded & ~inside & ~useless, self.slope(m), np.inf)
            entering = int(np.argmin(slope))
            if not slope[entering] < -self.rounding(m):
                break
            inside[entering] = True
            following = self._move_to_zero_slope(m, inside)
            useless[entering] = not inside[entering] and np.array_equal(following, m)
            if not useless[entering]:
                useless[:] = False
            m = following
        return m

    def _move_to_zero_slope(self, m: Float, inside: Bool) -> Float:
        """Move to the multipliers with zero slope `inside`; those that would fall below 0 on the way leave the set."""
        while True:
            target = solve_active(self.matrix, inside, self.excess)
            falling = self.bounded & inside & (target <= 0)
            if not falling.any() or not np.all(np.isfinite(target)):
                return target
            shares = np.full(m.size, np.inf)
            shares[falling] = m[falling] / np.where(m > target, m - target, 1.0)[falling]
            share = float(shares.min())
            m = m + share * (target - m)
            inside &= shares > share
            m[self.bounded & ~inside] = 0.0

    def slope(self, m: Float) -> Float:
        """Return the derivative of the cost with respect to each multiplier."""
        return np.asarray((self.matrix @ m - self.excess) / self.scale)

    def rounding(self, m: Float) -> float:
        """Return the size below which a slope counts as 0."""
        summed = np.abs(self.wanted).max(initial=0.0) + np.abs(m * self.scale).sum()
        return PASSED * float(summed)
