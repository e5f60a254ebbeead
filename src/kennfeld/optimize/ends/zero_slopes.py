"""Saddle points at which a descent cannot move: values at 0 whose derivatives vanish because they multiply each other.

With `y = A(u) * B(v)` and both tables at 0, all derivatives are zero. Such values are found by evaluation, so models of
any kind are covered: a value at 0 is stuck if its derivatives are zero, remain zero however the values with derivatives
move, and are not zero once the stuck values move together. The departure sets as few parameters as possible to a level
other than 0. Of a neural network, the weights of all layers are set to different numbers: neurons with equal weights
would stay equal, and those with a constant output may lose all slopes in the first step.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.ends.equal_neurons import equal_neurons
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

MAGNITUDES = (1.0, 1e-3, 1e-6)  # of the values tried; the next one if the model fails at the one before
LEVELS = (1.0, *(10.0**sign for n in range(1, 7) for sign in (n, -n)))
BETTER = 0.99  # ratio of costs below which another level replaces the best one


@dataclass(frozen=True)
class Departure:
    """A start from which all values that affect the outputs can move."""

    values: Float  # the free values
    changed: Mapping[str, Bool]  # by parameter, the values that were changed
    levels: Mapping[str, float]  # by parameter, the value in place of 0; the mean size of the weights of a layer
    stuck: tuple[str, ...]  # all parameters with values that could not move
    layers: frozenset[str] = frozenset()  # those with the weights of a neural network

    def __str__(self) -> str:
        if self.layers.issuperset(self.stuck):
            neurons = f"neurons of {_join(self.stuck)} whose weights are 0"
            return f"The search cannot tell {neurons} from each other. It started with different weights."
        levels = [f"{name} = {self.levels[name]:g} instead of 0" for name in self.changed if name not in self.layers]
        if layers := [name for name in self.changed if name in self.layers]:
            levels.append(f"different weights of {_join(layers)} instead of 0")
        return (
            f"The search could not move from the start: all derivatives of {_join(self.stuck)} vanish at 0. "
            f"It started with {_join(levels)}."
        )


def departure(
    objective: LeastSquaresObjective, compiled: CompiledProblem, start: Float, limits: LinearLimits
) -> Departure | None:
    """Return a departure from a start that cannot move; None if it can, or if nothing within the limits helps.

    Args:
        objective: the cost of the problem.
        compiled: the problem.
        start: free values that keep the limits, Float[values].
        limits: bounds and linear limits, including locks and pins.
    """
    search = _StartSearch(objective, compiled, start, limits)
    stuck = search.stuck(start) | search.equal(start)
    return search.departure(stuck) if stuck.any() else None


class _StartSearch:
    """The search for as few parameters as possible that set the others free."""

    def __init__(
        self, objective: LeastSquaresObjective, compiled: CompiledProblem, start: Float, limits: LinearLimits
    ) -> None:
        self.objective, self.compiled, self.start, self.limits = objective, compiled, start, limits
        problem, offsets = compiled.problem, compiled.values.offsets
        self.layers = problem.model.graph.layers
        self.columns = {
            name: slice(offsets[name], offsets[name] + problem.parameters[name].size) for name in problem.free_names
        }
        self.movable = np.zeros(start.size, dtype=bool)
        for columns in self.columns.values():
            self.movable[columns] = limits.movable[columns]
        self.pattern = 1 + np.modf(np.arange(1, start.size + 1) * 0.618034)[0]  # from 1 to 2, no two alike

    def equal(self, values: Float) -> Bool:
        """Mark all weights of layers that are 0 throughout, with neurons that stay equal although they may move."""
        equal = np.zeros(values.size, dtype=bool)
        if not any(name in self.columns and not values[self.columns[name]].any() for name in self.layers):
            return equal
        if not equal_neurons(self.compiled.problem.model.graph, self.compiled.parameters(values)):
            return equal
        for name in self.layers & set(self.columns):
            equal[self.columns[name]] = not values[self.columns[name]].any()
        return equal & self.movable

    def stuck(self, values: Float) -> Bool:
        """Mark the values at 0 that affect the outputs, but that no descent from here would ever move."""
        none = np.zeros(values.size, dtype=bool)
        zero = self.movable & (values == 0)
        sloped = self.objective.sloped(values) if zero.any() else None
        if sloped is None or not (zero & ~sloped).any():
            return none
        sloped = self._eventually_sloped(values, sloped)
        stuck: Bool = zero & ~sloped
        # those without a derivative even if all of them move together are dropped; the rest may have relied on them
        while stuck.any():
            alive = self._sloped_at(values, sloped | stuck)
            if alive is None:
                return none
            if alive[stuck].all():
                break
            stuck &= alive
        return stuck

    def _eventually_sloped(self, values: Float, sloped: Bool) -> Bool:
        """Mark the values with a derivative once those that have one have moved, and so on."""
        while True:
            more = self._sloped_at(values, sloped)
            if more is None or not (more & ~sloped).any():
                return sloped
            sloped = sloped | more

    def _sloped_at(self, values: Float, moving: Bool) -> Bool | None:
        """Mark the values with a derivative after `moving` ones moved by different shares; None if the model fails."""
        for magnitude in MAGNITUDES:
            # each value by another share, so that effects do not cancel by chance
            change = self.pattern * np.where(values == 0, magnitude, 0.1 * magnitude * np.abs(values))
            up, down = self.limits.clip(values + change), self.limits.clip(values - change)
            trial = np.where(up == values, down, up)  # down if an upper bound leaves no room
            sloped = self.objective.sloped(np.where(moving & self.movable, trial, values))
            if sloped is not None:
                return sloped
        return None

    def departure(self, stuck: Bool) -> Departure | None:
        """Change as few parameters as possible, to the level of the lowest cost; None if no level helps."""
        names = [name for name, columns in self.columns.items() if stuck[columns].any()]
        kept = list(names)

        def rank(name: str) -> tuple[bool, int]:  # factors, which are small and have no unit, are changed first
            return self._parameter(name).unit not in ("", "-"), int(stuck[self.columns[name]].sum())

        # the least suitable ones are left out first, as long as the rest sets all values free
        for name in sorted((name for name in names if name not in self.layers), key=rank, reverse=True):
            fewer = [other for other in kept if other != name]
            values = self._at_level(fewer, stuck, 1.0) if fewer else None
            if values is not None and not self.stuck(values).any():
                kept = fewer
        best: tuple[float, Float] | None = None
        for level in LEVELS:
            values = self._at_level(kept, stuck, level)
            cost = np.inf if values is None else self.objective.cost(values)
            if values is None or not np.isfinite(cost) or (best is not None and cost >= BETTER * best[0]):
                continue
            if not self.stuck(values).any():
                best = cost, values
                if self.layers.issuperset(kept):
                    break  # nearly equal weights would cost less, but part slowly
        return None if best is None else self._describe(best[1], names)

    def _at_level(self, names: Sequence[str], stuck: Bool, level: float) -> Float | None:
        """Set the stuck values of some parameters to a level, or to the typical size of the other values there."""
        values = self.start.copy()
        for name in names:
            columns = self.columns[name]
            others = np.abs(values[columns][values[columns] != 0])
            # values beside others of their table get the size of these
            size = others.mean() if others.size else level
            values[columns][stuck[columns]] = size * self._shape(name)[stuck[columns]]
        away = np.where(stuck, self.limits.clip(values), values)
        # an upper bound of 0 leaves the other sign
        values = np.where((away == 0) & (values != 0), self.limits.clip(-values), away)
        return project(values, self.limits)[0]

    def _shape(self, name: str) -> Float:
        """Return the values of a parameter at level 1; those of a layer suit inputs of the size of its outputs."""
        columns, shape = self.columns[name], self._parameter(name).values.shape
        if name not in self.layers:
            return np.ones(self._parameter(name).size)
        # numbers from -1 to 1 over the root of the number of inputs
        spread: Float = (2 * self.pattern[columns] - 3) / max(shape[0] - 1, 1) ** 0.5
        return spread

    def _describe(self, values: Float, names: Sequence[str]) -> Departure | None:
        differing = values != self.start
        changed = {name: differing[columns] for name, columns in self.columns.items() if differing[columns].any()}
        levels = {name: float(values[self.columns[name]][which].mean()) for name, which in changed.items()}
        levels |= {
            name: float(np.abs(values[self.columns[name]][changed[name]]).mean()) for name in self.layers & set(changed)
        }
        shaped = {name: which.reshape(self._parameter(name).values.shape) for name, which in changed.items()}
        return Departure(values, shaped, levels, tuple(names), frozenset(self.layers))

    def _parameter(self, name: str) -> Parameter:
        return self.compiled.problem.parameters[name]


def _join(names: Sequence[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last
