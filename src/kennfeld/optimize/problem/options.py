"""Options of a search, and the steps of a sequence."""

from collections.abc import Mapping, Sequence
from dataclasses import field
from fnmatch import fnmatchcase
from typing import Any, Literal, TypeVar

import numpy as np

from kennfeld.base.arrays import ArrayLike
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import number
from kennfeld.base.task_runner import TaskRunner
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.search_settings import MAX_STARTS, SearchSettings
from kennfeld.optimize.problem.problem import Factor, Smoothness
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings

Reduction = int | Sequence[int]
Value = TypeVar("Value")


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of a sequence; its arguments override problem and options, None keeps them.

    Parameter names may be patterns; the last one that matches counts.

    Args:
        name: name in the trace; default is the number of the step.
        free: patterns of the parameters to fit in this step; the others are fixed.
        lock: by parameter, True, False or a mask of its shape.
        smoothness: a factor for all tables, or by parameter a factor, or one per axis; "auto" in place of a factor
            chooses it in this step, on its grid.
        grid_reduction: keep every nth breakpoint of the free tables, for all axes or by parameter and axis. Removed
            breakpoints are interpolated at the end of the step.
        criteria: the criteria that count, by node or by number from 1; or their weights.
        max_iterations: of one descent.
        tolerance: relative change of the cost at which a descent ends.
        continuation: `auto` or `off`.

    Raises:
        ArgumentError: a value cannot be used.

    >>> Step(grid_reduction=2, max_iterations=20).free is None
    True
    """

    name: str = ""
    free: Sequence[str] | None = None
    lock: Mapping[str, ArrayLike] = field(default_factory=dict)
    smoothness: Factor | Smoothness | None = None
    grid_reduction: Reduction | Mapping[str, Reduction] = 1
    criteria: Sequence[str | int] | Mapping[str | int, float] | None = None
    max_iterations: int | None = None
    tolerance: float | None = None
    continuation: Literal["auto", "off"] | None = None

    def __post_init__(self) -> None:
        # a text is a sequence as well: of patterns of one character
        if isinstance(self.free, str):
            raise ArgumentError(f"free={self.free!r} of a step must be a list of patterns: free=[{self.free!r}]")
        if self.max_iterations is not None and self.max_iterations < 1:
            raise ArgumentError(f"max_iterations of a step must be an integer >= 1, got {self.max_iterations}")
        if self.tolerance is not None:
            object.__setattr__(self, "tolerance", number(self.tolerance, "tolerance", "a step", above=0))
        if self.continuation not in (None, "auto", "off"):
            raise ArgumentError(f'continuation of a step must be "auto" or "off", got {self.continuation!r}')
        smoothness = self.smoothness
        for value in smoothness.values() if isinstance(smoothness, Mapping) else (smoothness,):
            if value is not None and not all(map(_is_factor, _per_axis(value))):
                message = 'smoothness of a step must be >= 0 or "auto", or one such value per axis'
                raise ArgumentError(f"{message}, got {value!r}")
        for reduction in self._reductions:
            if any(isinstance(n, bool) or not isinstance(n, int) or n < 1 for n in _per_axis(reduction)):
                message = "grid_reduction of a step must be an integer >= 1, or one per axis"
                raise ArgumentError(f"{message}, got {reduction!r}")

    @property
    def reduces(self) -> bool:
        """True if the step makes any grid coarser."""
        return any(n > 1 for reduction in self._reductions for n in _per_axis(reduction))

    def reduction(self, parameter: Parameter) -> tuple[int, ...]:
        """Return the reduction of each axis of a parameter."""
        every = self.grid_reduction
        reduction = matching(every, parameter.name, 1) if isinstance(every, Mapping) else every
        return tuple(reduction) if isinstance(reduction, Sequence) else (reduction,) * len(parameter.axes)

    @property
    def _reductions(self) -> Sequence[Reduction]:
        every = self.grid_reduction
        return [*every.values()] if isinstance(every, Mapping) else [every]


@dataclass(frozen=True, kw_only=True)
class Options(SearchSettings):
    """Options of a search.

    Args:
        max_iterations: of one descent.
        tolerance: relative change of the cost at which a descent ends; default is 1e-8, up to 3e-5 for
            large problems.
        continuation: `auto` smooths lookups first if that is possible, or `off`.
        max_seconds: time after which a search stops at its best values, with the status `stopped`, once its
            current iteration is complete.
        method: `gauss-newton`, or `global` to search without gradients, for few values and a discontinuous cost; all
            values then need bounds.
        max_evaluations: budget of the global search; 0 stands for 2000 (values + 4) up to 5 values,
            else for 500 (values + 4).
        starts: number of starts; the first one is the given start.
        seed: of the random starts and of the global search.
        spread: distance of the random starts; without bounds, in units of the largest value of the table.
        workers: processes that the starts run in; default is one per core.
        cluster: runs the starts and the folds of a cross-validation instead of these processes.
        steps: a sequence that every start goes through.
        save_every: keep every nth accepted parameter set as a checkpoint; 0 keeps none.

    Raises:
        ArgumentError: a value cannot be used.

    >>> Options(starts=3, seed=1, steps=[Step(grid_reduction=2), Step()]).steps[0].reduces
    True
    """

    workers: int | None = None
    cluster: TaskRunner | None = field(default=None, repr=False, compare=False)
    steps: Sequence[Step] = ()

    def __post_init__(self) -> None:
        if self.method not in ("gauss-newton", "global"):
            raise ArgumentError(f'method must be "gauss-newton" or "global", got {self.method!r}')
        least_by_name = {
            "max_iterations": 0,
            "starts": 1,
            "seed": 0,
            "workers": 1,
            "save_every": 0,
            "max_evaluations": 0,
        }
        for name, least in least_by_name.items():
            value = getattr(self, name)
            is_right = isinstance(value, int | np.integer) and value >= least
            if not is_right and not (value is None and name == "workers"):
                raise ArgumentError(f"{name} must be an integer >= {least}, got {value!r}")
        if self.starts > MAX_STARTS:
            raise ArgumentError(f"starts must be <= {MAX_STARTS}, got {self.starts!r}")
        for name in ("spread", "tolerance", "max_seconds"):
            if name == "spread" or getattr(self, name) is not None:
                object.__setattr__(self, name, number(getattr(self, name), name, "the options", above=0))
        steps = self.steps
        if not isinstance(steps, Sequence) or not all(isinstance(step, Step) for step in steps):
            raise ArgumentError(f"steps must be a list of Step, got {steps!r}")
        object.__setattr__(self, "steps", tuple(steps))

    @property
    def settings(self) -> SolverSettings:
        """The settings of one descent."""
        return SolverSettings(self.max_iterations, self.tolerance or SolverSettings.tolerance)


def matching(by_pattern: Mapping[str, Value], name: str, default: Value) -> Value:
    """Return the value of the last pattern that matches a name."""
    matches = [value for pattern, value in by_pattern.items() if name == pattern or fnmatchcase(name, pattern)]
    return matches[-1] if matches else default


def _per_axis(setting: Any) -> Sequence[Any]:
    return setting if isinstance(setting, Sequence) and not isinstance(setting, str) else (setting,)


def _is_factor(value: object) -> bool:
    if isinstance(value, str | bool):
        return value == "auto"
    return isinstance(value, int | float | np.number) and bool(0 <= value < np.inf)
