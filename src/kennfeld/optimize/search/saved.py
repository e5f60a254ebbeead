"""Where a search was, so that it can go on from there."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from kennfeld.arrays import Float
from kennfeld.optimize.result import StartResult

__all__ = ["Keep", "Saved"]


@dataclass(frozen=True, eq=False)
class Saved:
    """An accepted parameter set of one start.

    `step` is the step of the sequence that it belongs to, from 1; `iteration` counts the accepted steps of the start
    over all stages and steps. `cost` is that of this step's exact model, so that sets of one step can be compared.
    `values` are those of the parameters that the search may change, on their full grids. `ended` is there once the
    start has come to its end.
    """

    start: int
    step: int
    iteration: int
    stage: str
    cost: float
    values: Mapping[str, Float] = field(repr=False)
    ended: StartResult | None = None
    name: str = ""


Keep = Callable[[Saved], None]
