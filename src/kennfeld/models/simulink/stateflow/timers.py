"""What a chart counts: the memories behind `after`, `before`, `at`, `every`, `temporalCount`, `elapsed`, `duration`.

Each state counts for itself, from when it was entered; time is what has passed since then.
"""

from collections.abc import Iterator
from typing import NamedTuple

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.stateflow.actions import calls_in
from kennfeld.models.simulink.stateflow.diagram import Arrow, Diagram, Event, Knot, State
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["CHANGES", "SECONDS", "TEMPORAL", "TICKS", "Timer", "Timers", "unit_of"]

TEMPORAL = frozenset({"after", "before", "at", "every", "temporalCount", "elapsed", "et", "duration", "count"})
CHANGES = frozenset({"hasChanged", "hasChangedFrom", "hasChangedTo"})
TICKS = frozenset({"tick", "wakeup"})
SECONDS = {"sec": 1.0, "msec": 1e-3, "usec": 1e-6}


class Timer(NamedTuple):
    """A memory of a state: how often an event came, when the state was entered, or since when a condition holds."""

    kind: str  # "ticks", "events", "entered", "true"
    state: State
    event: Event | None = None
    condition: m.Expression | None = None

    @property
    def key(self) -> str:
        """The name of the memory."""
        more = self.event.key if self.event is not None else repr(self.condition) if self.condition is not None else ""
        return f"{self.kind} {self.state.id} {more}".rstrip()


def unit_of(name: str, arguments: tuple[m.Expression, ...]) -> str:
    """What a temporal operator counts: the name of an event, or of a unit of time."""
    if name in ("elapsed", "et") and not arguments:
        return "sec"
    wanted = 1 if name in ("temporalCount", "elapsed", "et") else 2
    if len(arguments) != wanted or not isinstance(arguments[-1], m.Name):
        raise UnsupportedError(f"{name} is used in a way that is not supported")
    return arguments[-1].name


class Timers:
    """All timers of a chart, and the data whose changes it asks for."""

    def __init__(self, diagram: Diagram) -> None:
        self.diagram = diagram
        self.all: dict[str, Timer] = {}
        self.watched: dict[str, None] = {}
        for state in diagram.states.values():
            for tree in _trees(state):
                self._note(tree, state)

    def of(self, state: State) -> Iterator[Timer]:
        """The timers of a state."""
        return (timer for timer in self.all.values() if timer.state is state)

    def timer(self, name: str, arguments: tuple[m.Expression, ...], state: State) -> Timer:
        """The timer that a temporal operator of a state reads."""
        if name == "count":
            raise UnsupportedError("it uses count, which is not supported")
        if name == "duration":
            if len(arguments) not in (1, 2):
                raise UnsupportedError("duration is used in a way that is not supported")
            return Timer("true", state, condition=arguments[0])
        unit = unit_of(name, arguments)
        if unit in TICKS:
            return Timer("ticks", state)
        if unit in SECONDS:
            return Timer("entered", state)
        event = self.diagram.event(unit, state)
        if event is None:
            raise UnsupportedError(f"{name} counts {unit}, which is no event of the chart")
        return Timer("events", state, event)

    def _note(self, tree: object, state: State) -> None:
        for name, arguments in calls_in(tree):
            if name in TEMPORAL and self.diagram.function(name, state) is None:
                timer = self.timer(name, arguments, state)
                self.all[timer.key] = timer
            elif name in CHANGES and arguments:
                self._watch(arguments[0], state)

    def _watch(self, tree: m.Expression, state: State) -> None:
        base = tree.of if isinstance(tree, m.Call) else tree
        data = self.diagram.datum(base.name, state) if isinstance(base, m.Name) else None
        if data is None or data.written.scope not in ("INPUT_DATA", "OUTPUT_DATA", "LOCAL_DATA"):
            raise UnsupportedError("it asks for the change of what is no input, output or local variable of the chart")
        self.watched[data.key] = None


def _trees(state: State) -> Iterator[object]:
    """All code that runs for a state: its actions, and the transitions that begin at it."""
    yield tuple((action.event, action.body) for action in state.actions)
    waiting = [*state.outer, *state.inner, *state.defaults]
    seen: set[Knot] = set()
    while waiting:
        arrow: Arrow = waiting.pop()
        yield (arrow.events, arrow.condition, arrow.before, arrow.after)
        if isinstance(arrow.target, Knot) and arrow.target not in seen:
            seen.add(arrow.target)
            waiting += arrow.target.arrows
