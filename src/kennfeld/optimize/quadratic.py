"""The convex quadratic program of one step: min 1/2 d'Hd + g'd within bounds and under linear equalities.

H is factored once. If the free step violates limits, the violated ones and those active before enter a small dual
problem, solved through triangular solves with the same factor; repeated until none is violated, which ends because
limits are only added. Limits are rows a'd <= b; a bound is a row with a single entry.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.native import Factor

__all__ = ["Limits", "Solution", "nonnegative_dual", "solve"]

FEASIBLE = 1e-12  # violation of a row relative to its scale that counts as rounding


@dataclass(frozen=True)
class Limits:
    """Bounds on each value and equalities between values: `lower <= p <= upper`, `matrix @ p == target`."""

    lower: Float  # Float[values]
    upper: Float  # Float[values]
    matrix: Float = field(default_factory=lambda: np.zeros((0, 0)))  # Float[equalities, values]
    target: Float = field(default_factory=lambda: np.zeros(0))  # Float[equalities]

    def __post_init__(self) -> None:
        if not self.target.size:
            object.__setattr__(self, "matrix", np.zeros((0, self.lower.size)))

    @classmethod
    def none(cls, size: int) -> "Limits":
        """No limits on `size` values."""
        return cls(np.full(size, -np.inf), np.full(size, np.inf), np.zeros((0, size)), np.zeros(0))

    @property
    def movable(self) -> Bool:
        """Which values may change."""
        return self.lower < self.upper

    def clip(self, values: Float) -> Float:
        """The values put within their bounds, bit for bit."""
        clipped: Float = np.clip(values, self.lower, self.upper)
        return clipped

    def violations(self, values: Float, size: Float) -> Float:
        """How far each equality is missed, relative to its scale for values of this typical size."""
        scale = np.abs(self.matrix) @ size + np.abs(self.target) + 1e-300
        missed: Float = np.abs(self.matrix @ values - self.target) / scale
        return missed

    def violation(self, values: Float) -> float:
        """The largest of the `violations`, for values of the size they have."""
        return float(np.max(self.violations(values, np.abs(values)), initial=0.0))

    def narrowed(self, movable: Int, values: Float) -> "Limits":
        """The limits on the movable values, the others standing as they are; rows without a movable value fall out."""
        held = np.ones(values.size, dtype=bool)
        held[movable] = False
        rest = self.target - self.matrix[:, held] @ values[held]
        rows = (self.matrix[:, movable] != 0).any(axis=1)
        return Limits(self.lower[movable], self.upper[movable], self.matrix[rows][:, movable], rest[rows])


@dataclass(frozen=True)
class Solution:
    """The step, and the bounds that hold it: +1 at the upper, -1 at the lower bound, 0 free."""

    step: Float
    active: Int


def solve(factor: Factor, free_step: Float, at: Float, limits: Limits, guess: Int | None = None) -> Solution:
    """The minimiser of the quadratic program at the point `at`.

    `factor` is that of H, `free_step` is -H^-1 g. `guess` are bounds likely to be active.
    """
    room_up, room_down = limits.upper - at, at - limits.lower
    if not limits.target.size and np.all(free_step <= room_up) and np.all(-free_step <= room_down):
        return Solution(free_step, np.zeros(at.size, dtype=np.int64))
    rows = _Rows(factor, free_step)
    rows.add_equalities(limits.matrix, limits.target - limits.matrix @ at)
    if guess is not None:
        rows.add_bounds(guess, room_up, room_down)
    step = rows.step()
    for _ in range(2 * at.size + 1):
        found = np.where(step > room_up + rows.slack(room_up), 1, 0)
        found = np.where(-step > room_down + rows.slack(room_down), -1, found)
        found[rows.bounded[found[rows.bounded] == rows.signs]] = 0
        if not found.any():
            break
        rows.add_bounds(found, room_up, room_down)
        step = rows.step()
    return Solution(step, rows.active(at.size))


class _Rows:
    """The limits under consideration, equalities first, as rows of V' = (L^-1 A')'."""

    def __init__(self, factor: Factor, free_step: Float) -> None:
        self.factor = factor
        self.free_step = free_step
        self.rows = np.zeros((0, factor.inverse.size))
        self.excess = np.zeros(0)
        self.equalities = 0
        self.bounded = np.zeros(0, dtype=np.int64)
        self.signs = np.zeros(0, dtype=np.int64)
        self.multipliers = np.zeros(0)

    @staticmethod
    def slack(room: Float) -> Float:
        """How far a bound may be passed by rounding; the clip that follows removes it."""
        return FEASIBLE * np.maximum(np.where(np.isfinite(room), np.abs(room), 0.0), 1e-300)

    def add_equalities(self, matrix: Float, rest: Float) -> None:
        if rest.size:
            self._append(matrix, matrix @ self.free_step - rest)
            self.equalities = rest.size

    def add_bounds(self, signs: Int, up: Float, down: Float) -> None:
        """Bounds on the values where `signs` is not 0, and finite."""
        room = np.where(signs > 0, up, down)
        which = np.flatnonzero((signs != 0) & np.isfinite(room))
        rows = np.zeros((which.size, self.free_step.size))
        rows[np.arange(which.size), which] = signs[which]
        self.bounded = np.concatenate([self.bounded, which])
        self.signs = np.concatenate([self.signs, signs[which]])
        self._append(rows, signs[which] * self.free_step[which] - room[which])

    def _append(self, rows: Float, excess: Float) -> None:
        if rows.size:
            self.rows = np.vstack([self.rows, self.factor.solve_lower(rows)])
            self.excess = np.concatenate([self.excess, excess])

    def step(self) -> Float:
        if not self.excess.size:
            return self.free_step
        self.multipliers = nonnegative_dual(self.rows @ self.rows.T, self.excess, self.equalities)
        step: Float = self.free_step - self.factor.solve_upper(self.multipliers @ self.rows)
        return step

    def active(self, size: int) -> Int:
        signs = np.zeros(size, dtype=np.int64)
        pressed = self.multipliers[self.equalities :] > 0
        signs[self.bounded[pressed]] = self.signs[pressed]
        return signs


def nonnegative_dual(matrix: Float, excess: Float, equalities: int) -> Float:
    """Min 1/2 m'Sm - e'm with m >= 0 but for the first `equalities`, which are free.

    Block principal pivoting with a single-exchange rule as backup (Judice and Pires 1994), which ends.
    """
    size = excess.size
    bounded = np.arange(size) >= equalities
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix / np.outer(scale, scale) + 1e-14 * np.eye(size)
    wanted = excess / scale
    inside = ~bounded | (wanted > 0)
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


def pins(size: int, rows: Sequence[tuple[Int, Float, float]]) -> tuple[Float, Float]:
    """Equality rows from (columns, coefficients, right-hand side)."""
    matrix, target = np.zeros((len(rows), size)), np.zeros(len(rows))
    for row, (columns, coefficients, value) in enumerate(rows):
        np.add.at(matrix[row], columns, coefficients)
        target[row] = value
    return matrix, target
