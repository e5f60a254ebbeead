"""Dispatch of events, and the search for valid paths of transitions through junctions.

Transitions are tried in their order, with backtracking if none leads on. Paths that meet at a junction without
backtracking are merged there, so that a flow chart is built once, and a loop is unrolled pass by pass.
"""

from dataclasses import field
from typing import NamedTuple

from kennfeld.base.lazy_dataclass import dataclass
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
from kennfeld.importers.simulink.stateflow.temporal_logic import SECONDS, TEMPORAL, TICKS, temporal_unit
from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.program import tree as m

_IMPLICIT = {"en": "entry", "enter": "entry", "entry": "entry", "ex": "exit", "exit": "exit"}
_CHANGED = ("change", "chg")

_MAX_PASSES = 400  # through a junction
_MAX_DEPTH = 150  # junctions on a path with backtracking


class EventDispatch(ChartPart):
    """The events of a chart; `sent` counts those it has sent to itself."""

    def __init__(self, machine: ChartMachine) -> None:
        super().__init__(machine)
        self.sent = 0
        self._implicit = _implicit(machine.diagram)

    def match(self, events: m.Expressions, context: ActionContext, guard: Guard) -> Guard | None:
        """Return the guard where one of several events is being processed."""
        return self.logic.any_of([self._match_event(event, context, guard) for event in events])

    def _match_event(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Guard | None:
        name = tree.of.name if isinstance(tree, m.Call) and isinstance(tree.of, m.Name) else ""
        if isinstance(tree, m.Call) and name in TEMPORAL:
            return self._timed(name, tree.arguments, context, guard)
        if isinstance(tree, m.Call) and (name in _IMPLICIT or name in _CHANGED):
            return guard if context.event == self._implied(name, tree, context) else None
        # an event of the user may have the name of a tick
        if isinstance(tree, m.Name) and tree.name in TICKS and self.diagram.event(tree.name, context.scope) is None:
            return guard if self.is_waking(context.event) else None
        sent = self.machine.values.event(tree, context)
        if sent is None:
            raise UnsupportedError(f"{context.place}: unknown event")
        return guard if context.event == sent[0].key else None

    def is_waking(self, event: str) -> bool:
        """Return True if an event comes from outside of the chart."""
        return not event or any(known.key == event for known in self.diagram.inputs)

    def _timed(self, name: str, arguments: m.Expressions, context: ActionContext, guard: Guard) -> Guard | None:
        unit = temporal_unit(name, arguments) if name != "duration" else "sec"
        # ticks pass at wake-ups only, events while they are processed
        if unit in TICKS and not self.is_waking(context.event):
            return None
        event = self.diagram.event(unit, context.scope)
        if unit not in TICKS and unit not in SECONDS and (event is None or event.key != context.event):
            return None
        return self.logic.narrow(guard, self.machine.counting.evaluate(name, arguments, context, guard))

    def _implied(self, name: str, tree: m.Call, context: ActionContext) -> str:
        """Return the key of an implicit event: entry, exit, or change of a variable."""
        argument = tree.arguments[0] if len(tree.arguments) == 1 else m.Number(0.0)
        if name in _CHANGED:
            key = self.machine.values.resolve_key(argument, context)
            if key is None:
                raise UnsupportedError(f"{context.place}: {name} requires a variable of the chart")
            return f"change {key}"
        return f"{_IMPLICIT[name]} {self.machine.values.state(argument, context).id}"

    def notify_state(self, kind: str, state: StateNode, guard: Guard) -> None:
        """Broadcast the entry or exit of a state, if a label waits for it."""
        # by name, as labels name states: a broadcast costs a pass over the chart, and few labels wait for one
        if (kind, state.name) in self._implicit:
            self._broadcast(f"{kind} {state.id}", self.diagram.root, guard)

    def notify_change(self, key: str, old: Nodes, guard: Guard) -> None:
        """Broadcast the change of a variable, if a label waits for it."""
        # the same for variables, whose keys begin with the state that declares them
        if ("change", key.rpartition(".")[2]) not in self._implicit:
            return
        # an array changes element by element, and each change is an event of its own
        pairs = zip(self.variables.get(key, guard).ravel(), self.logic.simplify_all(old, guard).ravel(), strict=True)
        for new, before in pairs:
            differs = self.builder.call("ne", int(new), int(before)) if new != before else self.builder.const(0.0)
            where = self.logic.narrow(guard, differs)
            if where is not None:
                self._broadcast(f"change {key}", self.diagram.root, where)

    def send(self, event: ChartEvent, to: StateNode | None, context: ActionContext, guard: Guard) -> None:
        """Process an event at once: in the state it is sent to, else in its owner."""
        if event.written.scope == "OUTPUT_EVENT":
            self._emit(event, guard)
            return
        if event.written.scope != "LOCAL_EVENT":
            raise UnsupportedError(f"{context.place}: event {event.written.name} is an input and cannot be sent")
        # counted before it is processed, so that after(1, E) holds in its first processing
        self.machine.counting.count(event.key, guard)
        self._broadcast(event.key, to or event.owner, guard)

    def _emit(self, event: ChartEvent, guard: Guard) -> None:
        if event.written.trigger == "FUNCTION_CALL_EVENT":
            self.machine.called(event, guard)
            return
        # an edge: the output changes between 0 and 1
        key = f"output {event.key}"
        now = self.variables.scalar(key, guard)
        self.variables.put(key, self.builder.call("sub", self.builder.const(1.0), now), guard)

    def _broadcast(self, event: str, to: StateNode, guard: Guard) -> None:
        self.sent += 1
        with self.machine.nested("recursive broadcast of events"):
            where = self.logic.narrow(guard, self.machine.activity.active(to, guard))
            context = ActionContext(to, to, event, place=f"state {to.path}" if to.path else "chart")
            if where is not None and to.parent is None:
                self.machine.activity.execute_children(to, context, where)
            elif where is not None:
                self.machine.activity.execute(to, context, where)


def _implicit(diagram: ChartModel) -> frozenset[tuple[str, str]]:
    """Return kind and name of the implicit events that labels wait for."""
    events: set[tuple[str, str]] = set()
    for event in diagram.awaited:
        if not isinstance(event, m.Call) or not isinstance(event.of, m.Name) or len(event.arguments) != 1:
            continue
        kind = "change" if event.of.name in _CHANGED else _IMPLICIT.get(event.of.name, "")
        argument = event.arguments[0]
        if isinstance(argument, (m.Name, m.Field)):
            events.add((kind, argument.name))
    return frozenset(events)


class _Path(NamedTuple):
    """The part of a path passed so far: transition actions to run, and the states that contain the transitions."""

    actions: tuple[tuple[m.Statements, str], ...] = ()
    holders: frozenset[StateNode] = frozenset()


@dataclass(eq=False)
class Fired:
    """A path that ends at a state; `guard` says where it is taken."""

    target: StateNode
    path: _Path
    guard: Guard


@dataclass
class JunctionSearch:
    """Follows the transitions from one source."""

    machine: ChartMachine
    context: ActionContext
    committed: frozenset[JunctionNode]
    fired: list[Fired] = field(default_factory=list)
    _waiting: "dict[tuple[JunctionNode | StateNode, _Path], list[Guard]]" = field(default_factory=dict)
    _ended: list[Guard] = field(default_factory=list)
    _turns: dict[JunctionNode, int] = field(default_factory=dict)
    _depth: int = 0

    def run(self, transitions: list[TransitionEdge], guard: Guard) -> Guard | None:
        """Try transitions; `fired` collects those that lead to states. Return the guard where none does."""
        remaining = self._try(transitions, guard, _Path())
        while (meeting := self._next()) is not None:
            guards = self._waiting.pop(meeting)
            # paths that meet here are one from now on: the rest of the flow chart is built once
            begun = self.machine.logic.any_of(guards)
            if begun is not None and isinstance(meeting[0], JunctionNode):
                self._count_pass(meeting[0])
                self._try(meeting[0].transitions, begun, meeting[1])
        for (target, path), guards in self._waiting.items():
            taken = self.machine.logic.any_of(guards)
            if isinstance(target, StateNode) and taken is not None:
                self.fired.append(Fired(target, path, taken))
        return self.machine.logic.any_of([remaining, *self._ended])

    def _next(self) -> "tuple[JunctionNode | StateNode, _Path] | None":
        """Return a waiting junction that no other one leads to, except in loops."""
        reach = self.machine.reach
        meetings = [(meeting, meeting[0]) for meeting in self._waiting if isinstance(meeting[0], JunctionNode)]
        # a junction is left once, for all paths through it together: those that can still reach it come first
        for meeting, junction in meetings:
            others = (other for _, other in meetings if other is not junction)
            if not any(junction in reach[other] and other not in reach[junction] for other in others):
                return meeting
        return meetings[0][0] if meetings else None

    def _try(self, transitions: list[TransitionEdge], guard: Guard, path: _Path) -> Guard | None:
        """Try transitions in order; return the guard where none leads on."""
        remaining: Guard | None = guard
        for transition in transitions:
            if remaining is None:
                return None
            self.machine.work()
            matched = self._match(transition, remaining)
            if matched is None:
                continue
            after = self.machine.statements.run(transition.before, self.context.at(transition.place), matched)
            back = self._continue_from(transition, after, path) if after is not None else None
            # backtracking: the next one is tried where a path ends nowhere; its condition actions have run all the same
            remaining = self.machine.logic.exclude(remaining, matched)
            if back is not None:
                remaining = self.machine.logic.any_of([remaining, back])
        return remaining

    def _match(self, transition: TransitionEdge, guard: Guard) -> Guard | None:
        """Return the guard where a transition is valid."""
        context = self.context.at(transition.place)
        matched = self.machine.events.match(transition.events, context, guard) if transition.events else guard
        if matched is None or transition.condition is None:
            return matched
        condition = self.machine.values.scalar(transition.condition, context, matched)
        return self.machine.logic.narrow(matched, condition)

    def _continue_from(self, transition: TransitionEdge, guard: Guard, path: _Path) -> Guard | None:
        """Continue at the end of a transition; return the guard where it must be abandoned."""
        actions = (*path.actions, (transition.after, transition.place)) if transition.after else path.actions
        path = _Path(actions, path.holders | {transition.holder})
        target = transition.target
        # entering a state by its history junction is entering the state, which remembers
        if isinstance(target, JunctionNode) and target.history:
            target = target.holder
        if isinstance(target, StateNode) or target in self.committed:
            # a terminal junction ends the search without a change of states
            if isinstance(target, JunctionNode) and not target.transitions:
                self._ended.append(guard)
            else:
                self._waiting.setdefault((target, path), []).append(guard)
            return None
        self._count_pass(target)
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise self._endless_loop(_MAX_DEPTH)
        remaining = self._try(target.transitions, guard, path)
        self._depth -= 1
        return remaining

    def _count_pass(self, junction: JunctionNode) -> None:
        self.machine.work()
        self._turns[junction] = self._turns.get(junction, 0) + 1
        if self._turns[junction] > _MAX_PASSES:
            raise self._endless_loop(_MAX_PASSES)

    def _endless_loop(self, most: int) -> UnsupportedError:
        message = f"junctions form a loop of more than {most} passes, or one whose end depends on signals"
        return UnsupportedError(message, DEFAULT_REMEDY)


def committed_junctions(junctions: list[JunctionNode]) -> frozenset[JunctionNode]:
    """Return the junctions without backtracking: terminal ones, or with an unconditional transition."""
    # grows to a fixed point: an unconditional transition to a state or a sure junction makes its source sure
    sure = {junction for junction in junctions if not junction.transitions and not junction.history}
    while True:
        more = {
            junction
            for junction in junctions
            if junction not in sure
            and any(
                transition.free
                and (isinstance(transition.target, StateNode) or transition.target.history or transition.target in sure)
                for transition in junction.transitions
            )
        }
        if not more:
            return frozenset(sure)
        sure |= more
