"""Temporal logic: the memories of timers as a chart wakes up and enters states, and what `after` and its like say."""

from dataclasses import replace
from typing import TYPE_CHECKING

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.diagram import State
from kennfeld.models.simulink.stateflow.guards import Guard
from kennfeld.models.simulink.stateflow.timers import SECONDS, unit_of
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.execution import Machine

__all__ = ["Counting"]

_NEAR = 1e-6  # of a step, as far as times may be rounded


class Counting:
    """The timers of a machine."""

    def __init__(self, machine: "Machine") -> None:
        self.machine = machine
        self.timers = machine.timers
        self.logic = machine.logic
        self.loom = machine.loom
        self.variables = machine.variables

    def count(self, event: str, guard: Guard) -> None:
        """Count an event, or that the chart wakes up."""
        for key, timer in self.timers.all.items():
            waking = timer.kind == "ticks" and self.machine.events.is_waking(event)
            if waking or (timer.kind == "events" and timer.event is not None and timer.event.key == event):
                more = self.loom.call("add", self.variables.one(key, guard), self.loom.const(1.0))
                self.variables.put(key, more, guard)

    def restart(self, state: State, guard: Guard) -> None:
        """Begin to count anew as a state is entered."""
        for timer in self.timers.of(state):
            self.variables.put(timer.key, self.machine.time if timer.kind == "entered" else self.loom.const(0.0), guard)

    def measure(self, context: Context, guard: Guard) -> None:
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
            begun = self.loom.call("and", holds, self.loom.call("not", held))
            since = self.variables.one(f"since {key}", where)
            self.variables.put(f"since {key}", self.loom.call("select", begun, self.machine.time, since), where)
            self.variables.put(key, self.loom.call("ne", holds, self.loom.const(0.0)), where)

    def temporal(self, name: str, arguments: tuple[m.Expression, ...], context: Context, guard: Guard) -> int:
        """The value of a temporal operator: a truth of `after` and its like, a number of `temporalCount`."""
        timer = self.timers.timer(name, arguments, context.owner)
        if timer.key not in self.variables:
            raise UnsupportedError(f"{context.place}: {name} stands where no state counts")
        count = self.variables.one(timer.key, guard)
        if timer.kind == "true":
            passed = self.loom.call("sub", self.machine.time, self.variables.one(f"since {timer.key}", guard))
            scale = self._scale(arguments[1]) if len(arguments) == 2 else 1.0
            return self.loom.call("select", count, self._over(passed, scale), self.loom.const(0.0))
        near = self.loom.const(0.0)
        if timer.kind == "entered":
            scale = SECONDS[unit_of(name, arguments)]
            count = self._over(self.loom.call("sub", self.machine.time, count), scale)
            near = self._over(self.loom.call("mul", self.loom.const(_NEAR), self.machine.dt), scale)
        if name in ("temporalCount", "elapsed", "et"):
            return count
        wanted = self.machine.values.one(arguments[0], context, guard)
        return self._compared(name, count, wanted, near)

    def _scale(self, unit: m.Expression) -> float:
        if not isinstance(unit, m.Name) or unit.name not in SECONDS:
            raise UnsupportedError("duration is counted in what is no unit of time")
        return SECONDS[unit.name]

    def _over(self, seconds: int, scale: float) -> int:
        return self.loom.call("div", seconds, self.loom.const(scale))

    def _compared(self, name: str, count: int, wanted: int, near: int) -> int:
        """What has passed against what is asked for, rounding left aside."""
        call = self.loom.call
        reached = call("ge", call("add", count, near), wanted)
        if name == "after":
            return reached
        if name == "before":
            return call("not", reached)
        if self.loom.value(near) != 0.0:
            raise UnsupportedError(f"it uses {name} with a time, which is not supported", "Count ticks.")
        if name == "at":
            return call("eq", count, wanted)
        turns = call("sub", count, call("mul", wanted, call("floor", call("div", count, wanted))))
        return call("and", call("gt", count, self.loom.const(0.0)), call("eq", turns, self.loom.const(0.0)))
