"""The convex quadratic program of one step: min 1/2 d'Hd + g'd within bounds and linear rows.

H is factored once. If the free step violates limits, the violated ones, or those active before, enter a small dual
problem with the matrix S = A H^-1 A', computed from the same factor (see `native.gram`). This is repeated until none is
violated; it ends because limits are only added. Limits are rows a'd <= b; a bound is a row with a single entry.

The dual problem of the multipliers is min 1/2 m'Sm - e'm, with m >= 0 except for equalities. S is singular if limits
depend on each other, such as the four slopes around a flat cell of a map.
"""

from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.cholesky import Factor
from kennfeld.native.gram import Gram
from kennfeld.native.limit_rows import ChosenLimits
from kennfeld.native.multipliers import EMPTY, PASSED, exchange_blocks, solve_active
from kennfeld.optimize.solver.linear_constraints import LinearLimits

REFINEMENTS = 3  # corrections of the multipliers by the remaining violation of their step


@dataclass(frozen=True)
class QpSolution:
    """The step and its active limits: +1 at an upper, -1 at a lower side, else 0; bounds first, then rows.

    Equalities, which always hold, are not marked.
    """

    step: Float
    active: Int
    push: float = 0.0  # m'A d, by which the limits raise the cost of the quadratic model over the step

    def apply_to(self, at: Float, limits: LinearLimits) -> Float:
        """Return the values after the step from `at`, Float[values]: within all bounds, exactly at the active ones.

        A value next to its bound by rounding would be free in the next step, and see another derivative there if it is
        a breakpoint at the end of the data.
        """
        active = self.active[: at.size]
        values = limits.clip(at + self.step)
        if active.any():
            values = np.where(active == 0, values, np.where(active > 0, limits.upper, limits.lower))
        return values


class QuadraticProgram:
    """The programs of all steps within the same limits; their memory is used again."""

    def __init__(self, limits: LinearLimits) -> None:
        self._rows = limits.rows
        self._lower, self._upper = (
            np.concatenate(sides) for sides in ((limits.lower, limits.rows.lower), (limits.upper, limits.rows.upper))
        )
        self.unlimited = not (np.isfinite(self._lower).any() or np.isfinite(self._upper).any())
        self.gram: Gram | None = None

    @cached_property
    def chosen(self) -> ChosenLimits:
        """The limits, which a program without any does not need."""
        return ChosenLimits(self._lower, self._upper, self._rows.columns, self._rows.coefficients)

    def free(self, step: Float) -> QpSolution:
        """Return a step, Float[values], that no limit holds."""
        return QpSolution(step, np.zeros(self._lower.size, dtype=np.int64))

    def solve(self, factor: Factor, free_step: Float, at: Float, guess: Int | None = None) -> QpSolution:
        """Minimise the program at the point `at`.

        Args:
            factor: of H.
            free_step: -H^-1 g, Float[values].
            at: the values, Float[values].
            guess: limits likely to be active, Int[values + rows].
        """
        if self.unlimited:
            return self.free(free_step)
        chosen = self.chosen
        chosen.restart(at, free_step)
        violated = chosen.violated(free_step)
        if not violated and not chosen.equalities:
            return self.free(free_step)
        if self.gram is None:
            self.gram = Gram(factor)
        else:
            self.gram.restart(factor)
        dual = _DualProgram(self.gram, free_step, chosen)
        dual.add(violated if guess is None else chosen.mark(guess))
        # d = d_free - H^-1 A'm with the multipliers m of the limits A chosen so far; A gains the rows that d violates
        # each round adds a side of a limit, of which there are two
        for _ in range(2 * chosen.total + 1):
            step = dual.step()
            violated = chosen.violated(step)
            if not violated:
                break
            dual.add(violated)
        return QpSolution(step, dual.active(), chosen.product(dual.multipliers, step))


class _DualProgram:
    """The chosen limits, equalities first, as rows A of the dual program.

    It is min 1/2 m'Sm - e'm with m >= 0, where S = A H^-1 A' and e is the violation of each limit by the free step; the
    step is the free one minus H^-1 A'm. Lower sides enter with the opposite sign.
    """

    def __init__(self, gram: Gram, free_step: Float, chosen: ChosenLimits) -> None:
        self.gram, self.free_step, self.chosen = gram, free_step, chosen
        self.multipliers = np.zeros(0)
        self.pressing = np.zeros(0, dtype=np.int64)  # 1 for multipliers > 0, else 0

    def add(self, marked: int) -> None:
        """Add the marked limits; with the first ones, the equalities."""
        columns, coefficients = self.chosen.choose(marked)
        if len(columns):
            self.gram.add(columns, coefficients)
            self.pressing = np.concatenate([self.pressing, np.ones(len(columns), dtype=np.int64)])

    def step(self) -> Float:
        if not self.pressing.size:
            return self.free_step
        equalities = self.chosen.equalities
        self.multipliers = nonnegative_dual(self.gram.products, self.chosen.excess, equalities, self.pressing)
        self.pressing = (self.multipliers > 0).astype(np.int64)
        return self._refined()

    def _refined(self) -> Float:
        """Return the step of these multipliers, corrected until it is on its active limits.

        Along directions that neither data nor smoothness determine, H is nearly singular and A H^-1 A' loses the digits
        that tie one such value to the next; the violation of the step restores them.
        """
        holding, equalities = self.pressing.copy(), self.chosen.equalities
        if equalities:
            # equalities hold whatever their sign, except those that no movable value enters
            holding[:equalities] = np.diag(self.gram.products)[:equalities] > 0
        step: Float = self.free_step - self.gram.displacement(self.multipliers)
        for _ in range(REFINEMENTS):
            # v = A d - b, the violation of the limits; then d -= H^-1 A' (A H^-1 A')^-1 v over those that hold
            violation, kept = self.chosen.violation(step, holding)
            if kept or not np.all(np.isfinite(violation)):
                break
            correction = solve_active(self.gram.products, holding, violation)
            step = step - self.gram.displacement(correction)
            self.multipliers = self.multipliers + correction
        return step

    def active(self) -> Int:
        """Return `QpSolution.active`."""
        pressing = self.pressing.astype(bool)
        pressing[: self.chosen.equalities] = False
        return self.chosen.active(pressing)


def nonnegative_dual(matrix: Float, excess: Float, equalities: int, guess: Int | None = None) -> Float:
    """Find the multipliers m, Float[rows]; the first `equalities` are unbounded, and `guess` marks those likely > 0.

    Block principal pivoting ends after a few exchanges, or not at all if many rows depend on each other; then rows are
    exchanged one at a time. A row without values, with 0 on the diagonal of S, has no multiplier.
    """
    if guess is None:
        guess = (excess > 0).astype(np.int64)
    m = exchange_blocks(matrix, excess, equalities, guess)
    return _ActiveSetDual(matrix, excess, equalities).exchange_rows() if m is None else m


class _ActiveSetDual:
    """The program; violations are measured in units of the length of each row."""

    def __init__(self, matrix: Float, excess: Float, equalities: int) -> None:
        self.matrix, self.excess = matrix, excess
        self.entered = np.diag(matrix) > EMPTY
        self.bounded = self.entered & (np.arange(excess.size) >= equalities)
        self.scale = np.sqrt(np.where(self.entered, np.diag(matrix), 1.0))
        self.wanted = np.where(self.entered, excess / self.scale, 0.0)

    def exchange_rows(self) -> Float:
        """Add the row with the steepest slope, and remove those that reach 0 on the way, until none is left.

        The cost falls with each step, so that no active set occurs twice (C. Lawson, R. Hanson: Solving least squares
        problems, 1974, chapter 23).
        """
        inside = self.entered & ~self.bounded
        # rows that left at once without a change: dependent on those inside, until these change
        useless = np.zeros(inside.size, dtype=bool)
        m = self._solve(inside)
        for _ in range(10 * inside.size):
            # the row that the step violates most, in units of its length
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
        return np.where(self.bounded, np.maximum(m, 0.0), m)

    def _solve(self, inside: Bool) -> Float:
        return solve_active(self.matrix, inside.astype(np.int64), self.excess)

    def _move_to_zero_slope(self, m: Float, inside: Bool) -> Float:
        """Move to the multipliers with zero slope `inside`; those that would fall below 0 on the way leave the set."""
        while True:
            target = self._solve(inside)
            falling = self.bounded & inside & (target <= 0)
            if not falling.any() or not np.all(np.isfinite(target)):
                return target
            shares = np.full(m.size, np.inf)
            # share of the way at which each multiplier reaches 0; the first one ends it
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
