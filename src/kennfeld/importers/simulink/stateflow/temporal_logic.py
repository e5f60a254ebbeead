"""Temporal logic: the timers of a chart, and the operators that read them.

Timers store counts and times for `after`, `before`, `at`, `every`, `temporalCount`, `elapsed` and `duration`. Each
state counts from its entry.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.stateflow.chart_machine import ChartMachine, ChartPart
from kennfeld.importers.simulink.stateflow.chart_model import (
    ChartEvent,
    ChartModel,
    JunctionNode,
    StateNode,
    TransitionEdge,
)
from kennfeld.importers.simulink.stateflow.guarded_variables import ActionContext, Guard
from kennfeld.program import tree as m
from kennfeld.program.traversal import calls_in

TEMPORAL = frozenset({"after", "before", "at", "every", "temporalCount", "elapsed", "et", "duration", "count"})
CHANGES = frozenset({"hasChanged", "hasChangedFrom", "hasChangedTo"})
TICKS = frozenset({"tick", "wakeup"})
SECONDS = {"sec": 1.0, "msec": 1e-3, "usec": 1e-6}

_TIME_TOLERANCE = 1e-6  # of a step, for rounding of times


class Timer(NamedTuple):
    """A memory of a state: a count of events or ticks, its time of entry, or since when a condition holds."""

    kind: str  # "ticks", "events", "entered", "true"
    state: StateNode
    event: ChartEvent | None = None
    condition: m.Expression | None = None

    @property
    def key(self) -> str:
        """The name of the memory."""
        # equal conditions of a state share a memory, whatever line they are written in
        more = self.event.key if self.event is not None else repr(self.condition) if self.condition is not None else ""
        return f"{self.kind} {self.state.id} {more}".rstrip()


def temporal_unit(name: str, arguments: m.Expressions) -> str:
    """Return the event or the unit of time that a temporal operator counts."""
    if name in ("elapsed", "et") and not arguments:
        return "sec"
    # after(n, unit), but temporalCount(unit)
    wanted = 1 if name in ("temporalCount", "elapsed", "et") else 2
    if len(arguments) != wanted or not isinstance(arguments[-1], m.Name):
        raise UnsupportedError(f"this use of {name} is not supported")
    return arguments[-1].name


class ChartTimers:
    """All timers of a chart, and the variables whose changes it queries."""

    def __init__(self, diagram: ChartModel) -> None:
        self.diagram = diagram
        self.all: dict[str, Timer] = {}
        self.watched: dict[str, None] = {}
        for state in diagram.states.values():
            for tree in _trees(state):
                self._note(tree, state)

    def of(self, state: StateNode) -> Iterator[Timer]:
        """Return the timers of a state."""
        return (timer for timer in self.all.values() if timer.state is state)

    def timer(self, name: str, arguments: m.Expressions, state: StateNode) -> Timer:
        """Return the timer that a temporal operator in a state reads."""
        if name == "count":
            raise UnsupportedError("count is not supported")
        if name == "duration":
            if len(arguments) not in (1, 2):
                raise UnsupportedError("this use of duration is not supported")
            return Timer("true", state, condition=arguments[0])
        unit = temporal_unit(name, arguments)
        if unit in TICKS:
            return Timer("ticks", state)
        if unit in SECONDS:
            return Timer("entered", state)
        event = self.diagram.event(unit, state)
        if event is None:
            raise UnsupportedError(f"{name} counts {unit}, which is not an event of the chart")
        return Timer("events", state, event)

    def _note(self, tree: object, state: StateNode) -> None:
        for name, arguments in calls_in(tree):
            if name in TEMPORAL and self.diagram.function(name, state) is None:
                timer = self.timer(name, arguments, state)
                # before the first step: a memory must exist to be counted, and to be a state of the graph
                self.all[timer.key] = timer
            elif name in CHANGES and arguments:
                self._watch(arguments[0], state)

    def _watch(self, tree: m.Expression, state: StateNode) -> None:
        base = tree.of if isinstance(tree, m.Call) else tree
        data = self.diagram.datum(base.name, state) if isinstance(base, m.Name) else None
        if data is None or data.written.scope not in ("INPUT_DATA", "OUTPUT_DATA", "LOCAL_DATA"):
            raise UnsupportedError("change operators require an input, output or local variable of the chart")
        self.watched[data.key] = None


def _trees(state: StateNode) -> Iterator[object]:
    """Yield the code that runs for a state: its actions, and the transitions that begin at it."""
    yield tuple((action.event, action.body) for action in state.actions)
    waiting = [*state.outer, *state.inner, *state.defaults]
    seen: set[JunctionNode] = set()
    while waiting:
        transition: TransitionEdge = waiting.pop()
        yield (transition.events, transition.condition, transition.before, transition.after)
        if isinstance(transition.target, JunctionNode) and transition.target not in seen:
            seen.add(transition.target)
            waiting += transition.target.transitions


class TemporalLogic(ChartPart):
    """Counts and evaluates the timers of a chart."""

    def __init__(self, machine: ChartMachine, timers: ChartTimers) -> None:
        super().__init__(machine)
        self.timers = timers

    def count(self, event: str, guard: Guard) -> None:
        """Count an event, or a wake-up of the chart."""
        for key, timer in self.timers.all.items():
            # events that the chart sends to itself are no ticks
            waking = timer.kind == "ticks" and self.machine.events.is_waking(event)
            if waking or (timer.kind == "events" and timer.event is not None and timer.event.key == event):
                more = self.builder.call("add", self.variables.scalar(key, guard), self.builder.const(1.0))
                self.variables.put(key, more, guard)

    def restart(self, state: StateNode, guard: Guard) -> None:
        """Restart the timers of a state at its entry."""
        for timer in self.timers.of(state):
            self.variables.put(
                timer.key, self.machine.time if timer.kind == "entered" else self.builder.const(0.0), guard
            )

    def measure(self, context: ActionContext, guard: Guard) -> None:
        """Record since when the conditions of `duration` hold."""
        for key, timer in self.timers.all.items():
            if timer.kind != "true" or timer.condition is None:
                continue
            where = self.logic.narrow(guard, self.machine.activity.active(timer.state, guard))
            # a condition in a state that cannot be active here would be evaluated in vain
            if where is None:
                continue
            here = replace(context, scope=timer.state, owner=timer.state, place=f"state {timer.state.path}")
            holds = self.machine.values.scalar(timer.condition, here, where)
            # since and the truth value are kept apart: 0 s is a time, too
            was_true = self.variables.scalar(key, where)
            # since = t in the step in which the condition becomes true
            begun = self.builder.call("and", holds, self.builder.call("not", was_true))
            since = self.variables.scalar(f"since {key}", where)
            self.variables.put(f"since {key}", self.builder.call("select", begun, self.machine.time, since), where)
            self.variables.put(key, self.builder.call("ne", holds, self.builder.const(0.0)), where)

    def evaluate(self, name: str, arguments: m.Expressions, context: ActionContext, guard: Guard) -> int:
        """Return the value of a temporal operator: a truth value for `after`, a number for `temporalCount`."""
        timer = self.timers.timer(name, arguments, context.owner)
        if timer.key not in self.variables:
            raise UnsupportedError(f"{context.place}: {name} is not valid here")
        count = self.variables.scalar(timer.key, guard)
        if timer.kind == "true":
            passed = self.builder.call("sub", self.machine.time, self.variables.scalar(f"since {timer.key}", guard))
            scale = self._scale(arguments[1]) if len(arguments) == 2 else 1.0
            return self.builder.call("select", count, self._divide(passed, scale), self.builder.const(0.0))
        near = self.builder.const(0.0)
        if timer.kind == "entered":
            scale = SECONDS[temporal_unit(name, arguments)]
            count = self._divide(self.builder.call("sub", self.machine.time, count), scale)
            # rounding may leave a time just below the required one
            near = self._divide(self.builder.call("mul", self.builder.const(_TIME_TOLERANCE), self.machine.dt), scale)
        if name in ("temporalCount", "elapsed", "et"):
            return count
        wanted = self.machine.values.scalar(arguments[0], context, guard)
        return self._compare(name, count, wanted, near)

    def _scale(self, unit: m.Expression) -> float:
        if not isinstance(unit, m.Name) or unit.name not in SECONDS:
            raise UnsupportedError("duration requires a unit of time")
        return SECONDS[unit.name]

    def _divide(self, seconds: int, scale: float) -> int:
        return self.builder.call("div", seconds, self.builder.const(scale))

    def _compare(self, name: str, count: int, wanted: int, near: int) -> int:
        """Compare an elapsed count or time with the required one, with a tolerance for rounding."""
        call = self.builder.call
        reached = call("ge", call("add", count, near), wanted)
        if name == "after":
            return reached
        if name == "before":
            return call("not", reached)
        if self.builder.value(near) != 0.0:
            # a time that is hit within rounding would be hit twice, or not at all
            raise UnsupportedError(f"{name} with a time is not supported", "Use ticks.")
        if name == "at":
            return call("eq", count, wanted)
        # every: count mod wanted = count - wanted floor(count / wanted)
        turns = call("sub", count, call("mul", wanted, call("floor", call("div", count, wanted))))
        return call("and", call("gt", count, self.builder.const(0.0)), call("eq", turns, self.builder.const(0.0)))
