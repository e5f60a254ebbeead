"""The convex quadratic program of one step: min 1/2 d'Hd + g'd within bounds and linear rows.

H is factored once. If the free step violates limits, the violated ones and those active before enter a small dual
problem, solved through triangular solves with the same factor; repeated until none is violated, which ends because
limits are only added. Limits are rows a'd <= b; a bound is a row with a single entry.
"""

from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.native import Factor
from kennfeld.optimize.limits.limits import Limits

__all__ = ["Solution", "nonnegative_dual", "solve"]

FEASIBLE = 1e-12  # violation of a limit relative to its scale that counts as rounding


@dataclass(frozen=True)
class Solution:
    """The step, and what holds it: +1 at an upper, -1 at a lower side, 0 free; bounds of the values first, then rows.

    Equalities, which always hold, are not marked.
    """

    step: Float
    active: Int


def solve(factor: Factor, free_step: Float, at: Float, limits: Limits, guess: Int | None = None) -> Solution:
    """The minimiser of the quadratic program at the point `at`.

    `factor` is that of H, `free_step` is -H^-1 g. `guess` are limits likely to be active.
    """
    room = _Room(at, limits)
    equal = np.concatenate([np.zeros(at.size, dtype=bool), limits.rows.equal])
    if not equal.any() and not room.passed(free_step).any():
        return Solution(free_step, np.zeros(equal.size, dtype=np.int64))
    dual = _Dual(factor, free_step, limits, room)
    dual.add(equal.astype(np.int64))
    dual.equalities = int(equal.sum())
    if guess is not None:
        dual.add(np.where(equal, 0, guess))
    step = dual.step()
    for _ in range(2 * equal.size + 1):
        found = np.where(equal, 0, room.passed(step))
        found[dual.which[found[dual.which] == dual.signs]] = 0
        if not found.any():
            break
        dual.add(found)
        step = dual.step()
    return Solution(step, dual.active())


class _Room:
    """How far a step may go: the sides of all bounds, then of all rows, seen from a point."""

    def __init__(self, at: Float, limits: Limits) -> None:
        self.rows = limits.rows
        here = np.concatenate([at, self.rows.times(at)])
        self.upper = np.concatenate([limits.upper, self.rows.upper]) - here
        self.lower = np.concatenate([limits.lower, self.rows.lower]) - here
        summed = np.concatenate([np.zeros(at.size), self.rows.size(at)])
        self.over, self.under = (
            FEASIBLE * np.maximum(np.where(np.isfinite(side), np.abs(side), 0.0) + summed, 1e-300)
            for side in (self.upper, self.lower)
        )

    def passed(self, step: Float) -> Int:
        """The limits that a step passes by more than rounding: +1 upper, -1 lower."""
        taken = np.concatenate([step, self.rows.times(step)])
        passed: Int = np.where(taken > self.upper + self.over, 1, np.where(taken < self.lower - self.under, -1, 0))
        return passed


class _Dual:
    """The limits under consideration, equalities first, as rows of V' = (L^-1 A')'."""

    def __init__(self, factor: Factor, free_step: Float, limits: Limits, room: _Room) -> None:
        self.factor, self.free_step, self.limits, self.room = factor, free_step, limits, room
        self.taken = np.concatenate([free_step, limits.rows.times(free_step)])
        self.rows = np.zeros((0, factor.inverse.size))
        self.products = np.zeros((0, 0))  # of the rows with each other
        self.excess = np.zeros(0)
        self.equalities = 0
        self.which = np.zeros(0, dtype=np.int64)
        self.signs = np.zeros(0, dtype=np.int64)
        self.multipliers = np.zeros(0)

    def add(self, signs: Int) -> None:
        """Limits where `signs` is not 0, and finite."""
        side = np.where(signs > 0, self.room.upper, self.room.lower)
        which = np.flatnonzero((signs != 0) & np.isfinite(side))
        if not which.size:
            return
        values = self.free_step.size
        rows = np.zeros((which.size, values))
        single = which < values
        rows[np.flatnonzero(single), which[single]] = 1.0
        rows[~single] = self.limits.rows.matrix(which[~single] - values, values)
        signed = signs[which]
        new = self.factor.solve_lower(rows * signed[:, None])
        mixed = self.rows @ new.T
        self.products = np.block([[self.products, mixed], [mixed.T, new @ new.T]])
        self.rows = np.vstack([self.rows, new])
        self.excess = np.concatenate([self.excess, signed * (self.taken[which] - side[which])])
        self.which = np.concatenate([self.which, which])
        self.signs = np.concatenate([self.signs, signed])

    def step(self) -> Float:
        if not self.excess.size:
            return self.free_step
        known = self.multipliers.size
        guess = np.concatenate([self.multipliers > 0, self.excess[known:] > 0])
        self.multipliers = nonnegative_dual(self.products, self.excess, self.equalities, guess)
        step: Float = self.free_step - self.factor.solve_upper(self.multipliers @ self.rows)
        return step

    def active(self) -> Int:
        signs = np.zeros(self.taken.size, dtype=np.int64)
        pressed = self.multipliers > 0
        pressed[: self.equalities] = False
        signs[self.which[pressed]] = self.signs[pressed]
        return signs


def nonnegative_dual(matrix: Float, excess: Float, equalities: int, guess: Bool | None = None) -> Float:
    """Min 1/2 m'Sm - e'm with m >= 0 but for the first `equalities`, which are free; `guess` are likely to be above 0.

    Block principal pivoting with a single-exchange rule as backup (Judice and Pires 1994), which ends.
    """
    size = excess.size
    bounded = np.arange(size) >= equalities
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix / np.outer(scale, scale) + 1e-14 * np.eye(size)
    wanted = excess / scale
    inside = ~bounded | (wanted > 0 if guess is None else guess)
    best, patience = size + 1, 3
    for _ in range(50 + 5 * size):
        m = np.zeros(size)
        m[inside] = np.linalg.solve(scaled[np.ix_(inside, inside)], wanted[inside])
        slope = scaled @ m - wanted
        tolerance = 1e-12 * max(1.0, float(np.abs(wanted).max(initial=0.0)))
        wrong = bounded & ((inside & (m < -tolerance)) | (~inside & (slope < -tolerance)))
        count = int(wrong.sum())
        if count == 0:
            break
        if count < best:
            best, patience = count, 3
        elif patience > 0:
            patience -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        inside ^= wrong
    return np.where(bounded, np.maximum(m, 0.0), m) / scale
