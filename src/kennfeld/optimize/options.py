"""How to search for the values that fit best."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kennfeld.errors import ArgumentError
from kennfeld.numeric import number
from kennfeld.optimize.search.step import Step
from kennfeld.optimize.solver.gauss_newton import Settings

__all__ = ["MOST_STARTS", "Options"]

MOST_STARTS = 10_000  # each keeps its values until the end


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
    def settings(self) -> Settings:
        """The settings of one descent."""
        return Settings(self.max_iterations, self.tolerance)
