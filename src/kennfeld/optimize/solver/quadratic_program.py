"""The convex quadratic program of one step: min 1/2 d'Hd + g'd within bounds and linear rows.

H is factored once. If the free step violates limits, the violated ones, or those active before, enter a small dual
problem with the matrix A H^-1 A', computed from the same factor (see `native.gram`). This is repeated until no limit is
violated; it ends because limits are only added. Limits are rows a'd <= b; a bound is a row with a single entry.
"""

from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.native.cholesky import Factor
from kennfeld.native.gram import Gram
from kennfeld.optimize.solver.dual_active_set import nonnegative_dual, solve_active
from kennfeld.optimize.solver.linear_constraints import LinearLimits

FEASIBLE = 1e-12  # violation of a limit relative to its scale that counts as rounding
REFINEMENTS = 3  # corrections of the multipliers by the remaining violation of their step


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
        held = self.active[: at.size]
        bound = np.where(held > 0, limits.upper, limits.lower)
        return np.where(held != 0, bound, limits.clip(at + self.step))


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
    violated = np.where(equal, 0, room.passed(free_step))
    if not equal.any() and not violated.any():
        return QpSolution(free_step, violated)
    dual = _DualProblem(factor, free_step, limits, room, np.flatnonzero(equal))
    dual.add(violated if guess is None else np.where(equal, 0, guess))
    for _ in range(2 * equal.size + 1):
        step = dual.step()
        violated = dual.new(np.where(equal, 0, room.passed(step)))
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

    def taken(self, step: Float) -> Float:
        """Return the change of all values and rows over a step."""
        return np.concatenate([step, self.rows.times(step)])

    def passed(self, step: Float) -> Int:
        """Return the limits that a step violates by more than rounding: +1 upper, -1 lower, else 0."""
        taken = self.taken(step)
        passed: Int = np.where(taken > self.upper, 1, np.where(taken < self.lower, -1, 0))
        if passed.any():
            over, under = self.rounding(step)
            passed[(taken <= self.upper + over) & (taken >= self.lower - under)] = 0
        return passed

    def rounding(self, step: Float) -> tuple[Float, Float]:
        """Return the rounding error at the upper and the lower sides after a step."""
        moved = np.concatenate([np.abs(step), self.rows.size(step)])
        upper, lower = (FEASIBLE * (scale + moved) for scale in self.scales)
        return upper, lower


class _DualProblem:
    """The limits under consideration, equalities first, as rows A of the dual program.

    It is min 1/2 m'Sm - e'm with m >= 0, where S = A H^-1 A' and e is the violation of each limit by the free step; the
    step is the free one minus H^-1 A'm. Lower sides enter with the opposite sign.
    """

    def __init__(self, factor: Factor, free_step: Float, limits: LinearLimits, room: _StepBounds, equal: Int) -> None:
        self.factor, self.free_step, self.limits, self.room, self.equal = factor, free_step, limits, room, equal
        self.taken = room.taken(free_step)
        self.gram = Gram(factor)
        self.columns = np.zeros((0, max(limits.rows.columns.shape[1], 1)), dtype=np.int64)
        self.coefficients = np.zeros(self.columns.shape)
        self.excess = np.zeros(0)
        self.which = np.zeros(0, dtype=np.int64)
        self.signs = np.zeros(0, dtype=np.int64)
        self.pressing = np.zeros(0, dtype=bool)

    def new(self, signs: Int) -> Int:
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
        self.excess = np.concatenate([self.excess, signs * (self.taken[which] - side)])
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
        """Return the step for the limits considered."""
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
        step: Float = self.free_step - self._pulled(multipliers)
        for _ in range(REFINEMENTS):
            missed, rounding = self._missed(step), self._rounding(step)
            holding |= missed > rounding
            missed = np.where(holding, missed, 0.0)
            if np.all(np.abs(missed) <= rounding) or not np.all(np.isfinite(missed)):
                break
            step = step - self._pulled(solve_active(self.gram.products, holding, missed))
        return step

    def _pulled(self, multipliers: Float) -> Float:
        """Return H^-1 A'm."""
        pulls = self.coefficients * multipliers[:, None]
        pull = np.asarray(np.bincount(self.columns.ravel(), pulls.ravel(), self.free_step.size), dtype=np.float64)
        return self.factor.solve(pull)

    def _missed(self, step: Float) -> Float:
        """Return the violation of each limit considered; < 0 if the step stays clear of it."""
        taken = self.room.taken(step)[self.which]
        missed: Float = self.signs * (taken - self._side(self.room.upper, self.room.lower))
        return missed

    def _rounding(self, step: Float) -> Float:
        return self._side(*self.room.rounding(step))

    def _side(self, upper: Float, lower: Float) -> Float:
        """Select for each limit considered the entry of its upper or lower side."""
        side: Float = np.where(self.signs > 0, upper[self.which], lower[self.which])
        return side

    def active(self) -> Int:
        """Return `QpSolution.active`."""
        signs = np.zeros(self.taken.size, dtype=np.int64)
        pressing = self.pressing.copy()
        pressing[: self.equal.size] = False
        signs[self.which[pressing]] = self.signs[pressing]
        return signs
