"""Events: which one is being processed, those that a chart sends, and those that entering, leaving, changing make."""

from typing import TYPE_CHECKING

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.expressions.signals import Nodes
from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.diagram import Diagram, Event, State
from kennfeld.models.simulink.stateflow.guards import Guard
from kennfeld.models.simulink.stateflow.timers import SECONDS, TEMPORAL, TICKS, unit_of
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.execution import Machine

__all__ = ["Events"]

_IMPLICIT = {"en": "entry", "enter": "entry", "entry": "entry", "ex": "exit", "exit": "exit"}
_CHANGED = ("change", "chg")


class Events:
    """The events of a machine; `sent` is how many it has sent to itself."""

    def __init__(self, machine: "Machine") -> None:
        self.machine = machine
        self.diagram = machine.diagram
        self.logic = machine.logic
        self.loom = machine.loom
        self.variables = machine.variables
        self.sent = 0
        self._implicit = _implicit(machine.diagram)

    def happens(self, events: tuple[m.Expression, ...], context: Context, guard: Guard) -> Guard | None:
        """The guard where any of several events is what is being processed."""
        return self.logic.either([self._happens(event, context, guard) for event in events])

    def _happens(self, tree: m.Expression, context: Context, guard: Guard) -> Guard | None:
        name = tree.of.name if isinstance(tree, m.Call) and isinstance(tree.of, m.Name) else ""
        if isinstance(tree, m.Call) and name in TEMPORAL:
            return self._timed(name, tree.arguments, context, guard)
        if isinstance(tree, m.Call) and (name in _IMPLICIT or name in _CHANGED):
            return guard if context.event == self._implied(name, tree, context) else None
        if isinstance(tree, m.Name) and tree.name in TICKS and self.diagram.event(tree.name, context.scope) is None:
            return guard if self.is_waking(context.event) else None
        found = self.machine.values.event(tree, context)
        if found is None:
            raise UnsupportedError(f"{context.place}: it waits for what is no event of the chart")
        return guard if context.event == found[0].key else None

    def is_waking(self, event: str) -> bool:
        """Whether what is processed comes from outside, not from the chart itself."""
        return not event or any(one.key == event for one in self.diagram.inputs)

    def _timed(self, name: str, arguments: tuple[m.Expression, ...], context: Context, guard: Guard) -> Guard | None:
        unit = unit_of(name, arguments) if name != "duration" else "sec"
        if unit in TICKS and not self.is_waking(context.event):
            return None
        event = self.diagram.event(unit, context.scope)
        if unit not in TICKS and unit not in SECONDS and (event is None or event.key != context.event):
            return None
        return self.logic.where(guard, self.machine.counting.temporal(name, arguments, context, guard))

    def _implied(self, name: str, tree: m.Call, context: Context) -> str:
        """The key of the event that a state is entered or left, or a variable is changed."""
        argument = tree.arguments[0] if len(tree.arguments) == 1 else m.Number(0.0)
        if name in _CHANGED:
            key = self.machine.values.key_of(argument, context)
            if key is None:
                raise UnsupportedError(f"{context.place}: {name} asks for what is no variable of the chart")
            return f"change {key}"
        return f"{_IMPLICIT[name]} {self.machine.values.state(argument, context).id}"

    def tell(self, kind: str, state: State, guard: Guard) -> None:
        """Process the event that a state was entered or left, where a label asks for it."""
        if (kind, state.name) in self._implicit:
            self._broadcast(f"{kind} {state.id}", self.diagram.root, guard)

    def written(self, key: str, old: Nodes, guard: Guard) -> None:
        """Process the event that a variable has changed, where a label asks for it."""
        if ("change", key.rpartition(".")[2]) not in self._implicit:
            return
        pairs = zip(self.variables.get(key, guard).ravel(), self.logic.simplified(old, guard).ravel(), strict=True)
        for new, before in pairs:
            differs = self.loom.call("ne", int(new), int(before)) if new != before else self.loom.const(0.0)
            where = self.logic.where(guard, differs)
            if where is not None:
                self._broadcast(f"change {key}", self.diagram.root, where)

    def send(self, event: Event, to: State | None, context: Context, guard: Guard) -> None:
        """Process an event at once: in the state that it is sent to, else in the one that it belongs to."""
        if event.written.scope == "OUTPUT_EVENT":
            self._emit(event, guard)
            return
        if event.written.scope != "LOCAL_EVENT":
            raise UnsupportedError(f"{context.place}: it sends {event.written.name}, which comes from outside")
        self.machine.counting.count(event.key, guard)
        self._broadcast(event.key, to or event.owner, guard)

    def _emit(self, event: Event, guard: Guard) -> None:
        if event.written.trigger == "FUNCTION_CALL_EVENT":
            self.machine.called(event, guard)
            return
        key = f"output {event.key}"
        now = self.variables.one(key, guard)
        self.variables.put(key, self.loom.call("sub", self.loom.const(1.0), now), guard)

    def _broadcast(self, event: str, to: State, guard: Guard) -> None:
        self.sent += 1
        with self.machine.deeper("sends events to itself"):
            where = self.logic.where(guard, self.machine.activity.active(to, guard))
            context = Context(to, to, event, place=f"its state {to.path}" if to.path else "the chart")
            if where is not None and to.parent is None:
                self.machine.activity.children(to, context, where)
            elif where is not None:
                self.machine.activity.execute(to, context, where)


def _implicit(diagram: Diagram) -> frozenset[tuple[str, str]]:
    """The implicit events that labels ask for: the kind of each, and the name of the state or variable."""
    found: set[tuple[str, str]] = set()
    for event in diagram.awaited:
        if not isinstance(event, m.Call) or not isinstance(event.of, m.Name) or len(event.arguments) != 1:
            continue
        kind = "change" if event.of.name in _CHANGED else _IMPLICIT.get(event.of.name, "")
        argument = event.arguments[0]
        if isinstance(argument, (m.Name, m.Field)):
            found.add((kind, argument.name))
    return frozenset(found)
