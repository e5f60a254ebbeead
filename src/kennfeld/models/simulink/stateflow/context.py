"""Where code of a chart runs, which decides what its names and events mean."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from kennfeld.models.simulink.stateflow.diagram import State
from kennfeld.models.simulink.stateflow.guards import Guard

__all__ = ["Context"]


@dataclass(frozen=True)
class Context:
    """Where code runs: names are sought from `scope`, timers are those of `owner`, `event` is what is processed.

    `event` is the key of an event, empty where the chart merely wakes up. `frame` is that of a function that runs.
    `alive` gives the guard where the code goes on after an event that it has sent.
    """

    scope: State
    owner: State
    event: str = ""
    frame: str = ""
    alive: Callable[[Guard], Guard | None] = lambda guard: guard
    place: str = ""

    def at(self, place: str) -> "Context":
        """The same for code of another place."""
        return replace(self, place=place)
