"""Starts that cannot move: values at 0 whose slopes are all zero, because another value at 0 multiplies them.

With `y = A(u) * B(v)` and both tables at 0, no slope says that either matters; a descent would stay at this saddle for
ever. Such values are found by evaluation, not from the formula, so models of any kind are covered: a value at 0 is
stuck if its slopes are zero, remain so however the values with slopes move, and are not zero once the stuck values move
together. A start leaves the saddle by setting as few parameters as possible to a level other than 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.projection import project
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.parameters import Parameter

__all__ = ["departure"]

MAGNITUDES = (1.0, 1e-3, 1e-6)  # of the values tried; the next one where the model fails at the one before
LEVELS = (1.0, *(10.0**sign for n in range(1, 7) for sign in (n, -n)))
CLEARLY = 0.99  # share of the cost at level 1 that another level must come down to


@dataclass(frozen=True)
class Departure:
    """A start from which all values can move that the data reach.

    Attributes:
        values: the free values.
        changed: by parameter, the values that were changed.
        levels: by parameter, what they were set to in place of 0.
        stuck: all parameters with values that could not move.
    """

    values: Float
    changed: Mapping[str, Bool]
    levels: Mapping[str, float]
    stuck: tuple[str, ...]

    def __str__(self) -> str:
        """A remark for the result."""
        several = len(self.stuck) > 1
        slopes = f"all slopes of {_listed(self.stuck)} are zero while {'they are' if several else 'it is'} 0"
        moved = [f"{name} at {self.levels[name]:g} instead of 0" for name in self.changed]
        return f"The start could not move: {slopes}. The search started with {_listed(moved)}."


def departure(compiled: CompiledProblem, start: Float, limits: LinearLimits) -> Departure | None:
    """The way off a start that cannot move; None where it can, or where nothing within the limits helps.

    Args:
        compiled: the problem.
        start: the free values, which keep the limits.
        limits: bounds and linear limits; they, locks and pins are kept.
    """
    search = _StartSearch(compiled, start, limits)
    stuck = search.stuck(start)
    return search.departure(stuck) if stuck.any() else None


class _StartSearch:
    """The search for as few parameters as possible that set the others free."""

    def __init__(self, compiled: CompiledProblem, start: Float, limits: LinearLimits) -> None:
        self.compiled, self.start, self.limits = compiled, start, limits
        self.objective = LeastSquaresObjective(compiled)
        problem, offsets = compiled.problem, compiled.values.offsets
        self.columns = {
            name: slice(offsets[name], offsets[name] + problem.parameters[name].size) for name in problem.free_names
        }
        self.movable = np.zeros(start.size, dtype=bool)
        for columns in self.columns.values():
            self.movable[columns] = limits.movable[columns]
        self.pattern = 1 + np.modf(np.arange(1, start.size + 1) * 0.618034)[0]  # from 1 to 2, no two alike

    def stuck(self, values: Float) -> Bool:
        """The values at 0 that data reach, but that no descent from here would ever move."""
        nothing = np.zeros(values.size, dtype=bool)
        zero = self.movable & (values == 0)
        sloped = self.objective.sloped(values) if zero.any() else None
        if sloped is None or not (zero & ~sloped).any():
            return nothing
        sloped = self._sloped_in_time(values, sloped)
        stuck: Bool = zero & ~sloped
        while stuck.any():
            alive = self._sloped_at(values, sloped | stuck)
            if alive is None:
                return nothing
            if alive[stuck].all():
                break
            stuck &= alive
        return stuck

    def _sloped_in_time(self, values: Float, sloped: Bool) -> Bool:
        """The values with a slope once those that have one have moved, and so forth."""
        while True:
            more = self._sloped_at(values, sloped)
            if more is None or not (more & ~sloped).any():
                return sloped
            sloped = sloped | more

    def _sloped_at(self, values: Float, moving: Bool) -> Bool | None:
        """The values with a slope where others have moved, each by another share; None where the model fails there."""
        for magnitude in MAGNITUDES:
            size = np.where(values == 0, magnitude, 0.1 * magnitude * np.abs(values))
            moved = np.where(moving & self.movable, self._within(values + size * self.pattern, values, size), values)
            sloped = self.objective.sloped(moved)
            if sloped is not None:
                return sloped
        return None

    def _within(self, wanted: Float, values: Float, size: Float) -> Float:
        """The values moved up, or down where an upper bound leaves no room."""
        up = self.limits.clip(wanted)
        moved: Float = np.where(up == values, self.limits.clip(values - size * self.pattern), up)
        return moved

    def departure(self, stuck: Bool) -> Departure | None:
        """The start with the fewest parameters changed, at the level of the lowest cost; None where none helps."""
        names = [name for name, columns in self.columns.items() if stuck[columns].any()]
        kept = list(names)
        for name in sorted(names, key=lambda name: self._rank(name, stuck), reverse=True):
            fewer = [other for other in kept if other != name]
            if fewer and self._frees(fewer, stuck, 1.0):
                kept = fewer
        best: tuple[float, Float] | None = None
        for level in LEVELS:
            values = self._at_level(kept, stuck, level)
            cost = np.inf if values is None else self.objective.cost(values)
            if values is None or not np.isfinite(cost) or (best is not None and cost >= CLEARLY * best[0]):
                continue
            if not self.stuck(values).any():
                best = cost, values
        return None if best is None else self._told(best[1], names)

    def _rank(self, name: str, stuck: Bool) -> tuple[bool, int]:
        """Factors are rather small and without a unit: what is none of it is left at 0 first."""
        return self._parameter(name).unit not in ("", "-"), int(stuck[self.columns[name]].sum())

    def _frees(self, names: Sequence[str], stuck: Bool, level: float) -> bool:
        values = self._at_level(names, stuck, level)
        return values is not None and not self.stuck(values).any()

    def _at_level(self, names: Sequence[str], stuck: Bool, level: float) -> Float | None:
        """The start with the stuck values of some parameters at a level, or at the typical size of the others there."""
        values = self.start.copy()
        for name in names:
            columns = self.columns[name]
            others = np.abs(values[columns][values[columns] != 0])
            values[columns][stuck[columns]] = others.mean() if others.size else level
        away = np.where(stuck, self.limits.clip(values), values)
        values = np.where((away == 0) & (values != 0), self.limits.clip(-values), away)
        return project(values, self.limits)[0]

    def _told(self, values: Float, names: Sequence[str]) -> Departure | None:
        differing = values != self.start
        changed = {name: differing[columns] for name, columns in self.columns.items() if differing[columns].any()}
        levels = {name: float(values[self.columns[name]][which].mean()) for name, which in changed.items()}
        shaped = {name: which.reshape(self._parameter(name).values.shape) for name, which in changed.items()}
        return Departure(values, shaped, levels, tuple(names))

    def _parameter(self, name: str) -> Parameter:
        return self.compiled.problem.parameters[name]


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
