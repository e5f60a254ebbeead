"""How to search for the values that fit best.

One step of a sequence, and the problem that it solves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Literal, TypeVar

import numpy as np

from kennfeld.arrays import ArrayLike
from kennfeld.errors import ArgumentError
from kennfeld.numeric import number
from kennfeld.optimize.problem import Factor, Smoothness
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings
from kennfeld.parameters import Parameter

__all__ = ["MOST_STARTS", "Options", "Step", "matching"]

Reduction = int | Sequence[int]
Value = TypeVar("Value")

MOST_STARTS = 10_000  # each keeps its values until the end


@dataclass(frozen=True)
class Step:
    """One step of a sequence: what it says replaces what problem and options say, None keeps that.

    Names of parameters may be patterns; where several match, the last one counts.

    Args:
        name: what the trace calls it; its number by default.
        free: patterns of the parameters to fit in this step; the others stand still.
        lock: by parameter, whether it is locked, or a mask of its shape.
        smoothness: a factor for all tables, or by parameter a factor, or one an axis; "auto" in place of a factor has
            it chosen in this step, on its grid.
        grid_reduction: keep every nth breakpoint of the free tables, for all axes or by parameter and axis. The
            breakpoints left out are interpolated at the end of the step.
        criteria: which criteria count, by node or by number from 1; or their weights.
        max_iterations: of one descent.
        tolerance: relative change of the cost at which a descent ends.
        continuation: `auto` or `off`.

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
        if isinstance(self.free, str):
            raise ArgumentError(f"free={self.free!r} of a step must be a list of patterns: free=[{self.free!r}]")
        if self.max_iterations is not None and self.max_iterations < 1:
            raise ArgumentError(f"max_iterations={self.max_iterations} of a step must be a whole number from 1 on")
        if self.tolerance is not None:
            object.__setattr__(self, "tolerance", number(self.tolerance, "tolerance", "a step", above=0))
        if self.continuation not in (None, "auto", "off"):
            raise ArgumentError(f"continuation={self.continuation!r} of a step must be auto or off")
        smooth = self.smoothness
        for one in smooth.values() if isinstance(smooth, Mapping) else (smooth,):
            if one is not None and not all(_is_factor(factor) for factor in _each(one)):
                raise ArgumentError(
                    f'smoothness={one!r} of a step must be a number from 0 on, or one an axis, or "auto" in their place'
                )
        given = self.grid_reduction
        for one in given.values() if isinstance(given, Mapping) else (given,):
            if any(isinstance(n, bool) or not isinstance(n, int) or n < 1 for n in _listed(one)):
                raise ArgumentError(
                    f"grid_reduction={one!r} of a step must be a whole number from 1 on, or one an axis"
                )

    @property
    def reduces(self) -> bool:
        """Whether it makes any grid coarser."""
        given = self.grid_reduction
        every = given.values() if isinstance(given, Mapping) else (given,)
        return any(n > 1 for one in every for n in _listed(one))

    def reduction(self, parameter: Parameter) -> tuple[int, ...]:
        """The reduction of each axis of a parameter."""
        given = self.grid_reduction
        one = matching(given, parameter.name, 1) if isinstance(given, Mapping) else given
        return tuple(one) if isinstance(one, Sequence) else (one,) * len(parameter.axes)


def _listed(given: Reduction) -> tuple[int, ...]:
    return tuple(given) if isinstance(given, Sequence) else (given,)


def _each(given: Factor | Sequence[Factor]) -> Sequence[object]:
    return given if isinstance(given, Sequence) and not isinstance(given, str) else (given,)


def _is_factor(given: object) -> bool:
    if isinstance(given, str | bool):
        return given == "auto"
    return isinstance(given, int | float | np.number) and bool(0 <= given < np.inf)


def matching(by_pattern: Mapping[str, Value], name: str, default: Value) -> Value:
    """What the last pattern that matches a name stands for."""
    found = [value for pattern, value in by_pattern.items() if name == pattern or fnmatchcase(name, pattern)]
    return found[-1] if found else default


@dataclass(frozen=True)
class Options:
    """How to search. `continuation` is `auto` (where lookups can be smoothed) or `off`.

    `method` `global` searches without gradients, for few values and a cost that jumps; all values need bounds.
    `max_evaluations` is its budget, 500 (values + 4) where it is 0, and `seed` that of its random numbers.
    The first of several `starts` is the given one; `seed` and `spread` say where the others lie (see `drawn_start`),
    and `workers` in how many processes they run, by default one a core. `steps` make a sequence that every start goes
    through. `save_every` asks for every nth accepted parameter set to be kept, where somebody keeps them.
    """

    max_iterations: int = 200
    tolerance: float = 1e-8
    continuation: Literal["auto", "off"] = "auto"
    method: Literal["gauss-newton", "global"] = "gauss-newton"
    max_evaluations: int = 0
    starts: int = 1
    seed: int = 0
    spread: float = 0.5
    workers: int | None = None
    steps: tuple[Step, ...] = ()
    save_every: int = 0

    def __post_init__(self) -> None:
        if self.method not in ("gauss-newton", "global"):
            raise ArgumentError(f"method={self.method!r} must be gauss-newton or global")
        whole = (
            ("max_iterations", 0),
            ("starts", 1),
            ("seed", 0),
            ("workers", 1),
            ("save_every", 0),
            ("max_evaluations", 0),
        )
        for name, least in whole:
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | np.integer) and value >= least):
                raise ArgumentError(f"{name}={value!r} must be a whole number from {least} on")
        if self.starts > MOST_STARTS:
            raise ArgumentError(f"starts={self.starts!r} must be <= {MOST_STARTS}")
        for name in ("spread", "tolerance"):
            object.__setattr__(self, name, number(getattr(self, name), name, "the options", above=0))
        object.__setattr__(self, "steps", tuple(self.steps))

    @property
    def settings(self) -> SolverSettings:
        """The settings of one descent."""
        return SolverSettings(self.max_iterations, self.tolerance)
