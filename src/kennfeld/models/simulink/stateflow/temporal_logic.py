"""Temporal logic: the memories of timers as a chart wakes up and enters states, and what `after` and its like say.

What a chart counts: the memories behind `after`, `before`, `at`, `every`, `temporalCount`, `elapsed`, `duration`.

Each state counts for itself, from when it was entered; time is what has passed since then.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.stateflow.chart_model import (
    ChartEvent,
    ChartModel,
    JunctionNode,
    StateNode,
    TransitionEdge,
)
from kennfeld.models.simulink.stateflow.guarded_variables import ActionContext, Guard
from kennfeld.models.simulink.stateflow.label_parser import calls_in

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.chart_execution import ChartExecution

__all__ = ["CHANGES", "SECONDS", "TEMPORAL", "TICKS", "ChartTimers", "TemporalLogic", "temporal_unit"]

TEMPORAL = frozenset({"after", "before", "at", "every", "temporalCount", "elapsed", "et", "duration", "count"})
CHANGES = frozenset({"hasChanged", "hasChangedFrom", "hasChangedTo"})
TICKS = frozenset({"tick", "wakeup"})
SECONDS = {"sec": 1.0, "msec": 1e-3, "usec": 1e-6}

_NEAR = 1e-6  # of a step, as far as times may be rounded


class Timer(NamedTuple):
    """A memory of a state: how often an event came, when the state was entered, or since when a condition holds."""

    kind: str  # "ticks", "events", "entered", "true"
    state: StateNode
    event: ChartEvent | None = None
    condition: m.Expression | None = None

    @property
    def key(self) -> str:
        """The name of the memory."""
        more = self.event.key if self.event is not None else repr(self.condition) if self.condition is not None else ""
        return f"{self.kind} {self.state.id} {more}".rstrip()


def temporal_unit(name: str, arguments: tuple[m.Expression, ...]) -> str:
    """What a temporal operator counts: the name of an event, or of a unit of time."""
    if name in ("elapsed", "et") and not arguments:
        return "sec"
    wanted = 1 if name in ("temporalCount", "elapsed", "et") else 2
    if len(arguments) != wanted or not isinstance(arguments[-1], m.Name):
        raise UnsupportedError(f"{name} is used in a way that is not supported")
    return arguments[-1].name


class ChartTimers:
    """All timers of a chart, and the data whose changes it asks for."""

    def __init__(self, diagram: ChartModel) -> None:
        self.diagram = diagram
        self.all: dict[str, Timer] = {}
        self.watched: dict[str, None] = {}
        for state in diagram.states.values():
            for tree in _trees(state):
                self._note(tree, state)

    def of(self, state: StateNode) -> Iterator[Timer]:
        """The timers of a state."""
        return (timer for timer in self.all.values() if timer.state is state)

    def timer(self, name: str, arguments: tuple[m.Expression, ...], state: StateNode) -> Timer:
        """The timer that a temporal operator of a state reads."""
        if name == "count":
            raise UnsupportedError("it uses count, which is not supported")
        if name == "duration":
            if len(arguments) not in (1, 2):
                raise UnsupportedError("duration is used in a way that is not supported")
            return Timer("true", state, condition=arguments[0])
        unit = temporal_unit(name, arguments)
        if unit in TICKS:
            return Timer("ticks", state)
        if unit in SECONDS:
            return Timer("entered", state)
        event = self.diagram.event(unit, state)
        if event is None:
            raise UnsupportedError(f"{name} counts {unit}, which is no event of the chart")
        return Timer("events", state, event)

    def _note(self, tree: object, state: StateNode) -> None:
        for name, arguments in calls_in(tree):
            if name in TEMPORAL and self.diagram.function(name, state) is None:
                timer = self.timer(name, arguments, state)
                self.all[timer.key] = timer
            elif name in CHANGES and arguments:
                self._watch(arguments[0], state)

    def _watch(self, tree: m.Expression, state: StateNode) -> None:
        base = tree.of if isinstance(tree, m.Call) else tree
        data = self.diagram.datum(base.name, state) if isinstance(base, m.Name) else None
        if data is None or data.written.scope not in ("INPUT_DATA", "OUTPUT_DATA", "LOCAL_DATA"):
            raise UnsupportedError("it asks for the change of what is no input, output or local variable of the chart")
        self.watched[data.key] = None


def _trees(state: StateNode) -> Iterator[object]:
    """All code that runs for a state: its actions, and the transitions that begin at it."""
    yield tuple((action.event, action.body) for action in state.actions)
    waiting = [*state.outer, *state.inner, *state.defaults]
    seen: set[JunctionNode] = set()
    while waiting:
        arrow: TransitionEdge = waiting.pop()
        yield (arrow.events, arrow.condition, arrow.before, arrow.after)
        if isinstance(arrow.target, JunctionNode) and arrow.target not in seen:
            seen.add(arrow.target)
            waiting += arrow.target.arrows


class TemporalLogic:
    """The timers of a machine."""

    def __init__(self, machine: "ChartExecution") -> None:
        self.machine = machine
        self.timers = machine.timers
        self.logic = machine.logic
        self.builder = machine.builder
        self.variables = machine.variables

    def count(self, event: str, guard: Guard) -> None:
        """Count an event, or that the chart wakes up."""
        for key, timer in self.timers.all.items():
            waking = timer.kind == "ticks" and self.machine.events.is_waking(event)
            if waking or (timer.kind == "events" and timer.event is not None and timer.event.key == event):
                more = self.builder.call("add", self.variables.one(key, guard), self.builder.const(1.0))
                self.variables.put(key, more, guard)

    def restart(self, state: StateNode, guard: Guard) -> None:
        """Begin to count anew as a state is entered."""
        for timer in self.timers.of(state):
            self.variables.put(
                timer.key, self.machine.time if timer.kind == "entered" else self.builder.const(0.0), guard
            )

    def measure(self, context: ActionContext, guard: Guard) -> None:
        """Note since when the conditions of `duration` hold."""
        for key, timer in self.timers.all.items():
            if timer.kind != "true" or timer.condition is None:
                continue
            where = self.logic.where(guard, self.machine.activity.active(timer.state, guard))
            if where is None:
                continue
            here = replace(context, scope=timer.state, owner=timer.state, place=f"its state {timer.state.path}")
            holds = self.machine.values.one(timer.condition, here, where)
            held = self.variables.one(key, where)
            begun = self.builder.call("and", holds, self.builder.call("not", held))
            since = self.variables.one(f"since {key}", where)
            self.variables.put(f"since {key}", self.builder.call("select", begun, self.machine.time, since), where)
            self.variables.put(key, self.builder.call("ne", holds, self.builder.const(0.0)), where)

    def temporal(self, name: str, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard) -> int:
        """The value of a temporal operator: a truth of `after` and its like, a number of `temporalCount`."""
        timer = self.timers.timer(name, arguments, context.owner)
        if timer.key not in self.variables:
            raise UnsupportedError(f"{context.place}: {name} stands where no state counts")
        count = self.variables.one(timer.key, guard)
        if timer.kind == "true":
            passed = self.builder.call("sub", self.machine.time, self.variables.one(f"since {timer.key}", guard))
            scale = self._scale(arguments[1]) if len(arguments) == 2 else 1.0
            return self.builder.call("select", count, self._over(passed, scale), self.builder.const(0.0))
        near = self.builder.const(0.0)
        if timer.kind == "entered":
            scale = SECONDS[temporal_unit(name, arguments)]
            count = self._over(self.builder.call("sub", self.machine.time, count), scale)
            near = self._over(self.builder.call("mul", self.builder.const(_NEAR), self.machine.dt), scale)
        if name in ("temporalCount", "elapsed", "et"):
            return count
        wanted = self.machine.values.one(arguments[0], context, guard)
        return self._compared(name, count, wanted, near)

    def _scale(self, unit: m.Expression) -> float:
        if not isinstance(unit, m.Name) or unit.name not in SECONDS:
            raise UnsupportedError("duration is counted in what is no unit of time")
        return SECONDS[unit.name]

    def _over(self, seconds: int, scale: float) -> int:
        return self.builder.call("div", seconds, self.builder.const(scale))

    def _compared(self, name: str, count: int, wanted: int, near: int) -> int:
        """What has passed against what is asked for, rounding left aside."""
        call = self.builder.call
        reached = call("ge", call("add", count, near), wanted)
        if name == "after":
            return reached
        if name == "before":
            return call("not", reached)
        if self.builder.value(near) != 0.0:
            raise UnsupportedError(f"it uses {name} with a time, which is not supported", "Count ticks.")
        if name == "at":
            return call("eq", count, wanted)
        turns = call("sub", count, call("mul", wanted, call("floor", call("div", count, wanted))))
        return call("and", call("gt", count, self.builder.const(0.0)), call("eq", turns, self.builder.const(0.0)))
