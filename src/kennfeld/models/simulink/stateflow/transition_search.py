"""Events: which one is being processed, those that a chart sends, and those that entering, leaving, changing make.

Transitions tried in their order, through junctions, with the way back where none leads on.

Ways that meet again at a junction from which one always leads on are followed once from there: so a flow chart stays
as long as it is drawn, and a loop is unrolled turn by turn.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from kennfeld.matlab import syntax as m
from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.stateflow.chart_model import (
    ChartEvent,
    ChartModel,
    JunctionNode,
    StateNode,
    TransitionEdge,
)
from kennfeld.models.simulink.stateflow.guarded_variables import ActionContext, Guard
from kennfeld.models.simulink.stateflow.temporal_logic import SECONDS, TEMPORAL, TICKS, temporal_unit

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.chart_execution import ChartExecution

__all__ = ["EventDispatch", "Fired", "JunctionSearch", "committed_junctions"]

_IMPLICIT = {"en": "entry", "enter": "entry", "entry": "entry", "ex": "exit", "exit": "exit"}
_CHANGED = ("change", "chg")

_MOST_TURNS = 400  # of a loop among junctions
_DEEPEST = 150  # junctions on one way that may have to be gone back


class EventDispatch:
    """The events of a machine; `sent` is how many it has sent to itself."""

    def __init__(self, machine: "ChartExecution") -> None:
        self.machine = machine
        self.diagram = machine.diagram
        self.logic = machine.logic
        self.builder = machine.builder
        self.variables = machine.variables
        self.sent = 0
        self._implicit = _implicit(machine.diagram)

    def happens(self, events: tuple[m.Expression, ...], context: ActionContext, guard: Guard) -> Guard | None:
        """The guard where any of several events is what is being processed."""
        return self.logic.either([self._happens(event, context, guard) for event in events])

    def _happens(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Guard | None:
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

    def _timed(
        self, name: str, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard
    ) -> Guard | None:
        unit = temporal_unit(name, arguments) if name != "duration" else "sec"
        if unit in TICKS and not self.is_waking(context.event):
            return None
        event = self.diagram.event(unit, context.scope)
        if unit not in TICKS and unit not in SECONDS and (event is None or event.key != context.event):
            return None
        return self.logic.where(guard, self.machine.counting.temporal(name, arguments, context, guard))

    def _implied(self, name: str, tree: m.Call, context: ActionContext) -> str:
        """The key of the event that a state is entered or left, or a variable is changed."""
        argument = tree.arguments[0] if len(tree.arguments) == 1 else m.Number(0.0)
        if name in _CHANGED:
            key = self.machine.values.key_of(argument, context)
            if key is None:
                raise UnsupportedError(f"{context.place}: {name} asks for what is no variable of the chart")
            return f"change {key}"
        return f"{_IMPLICIT[name]} {self.machine.values.state(argument, context).id}"

    def tell(self, kind: str, state: StateNode, guard: Guard) -> None:
        """Process the event that a state was entered or left, where a label asks for it."""
        if (kind, state.name) in self._implicit:
            self._broadcast(f"{kind} {state.id}", self.diagram.root, guard)

    def written(self, key: str, old: Nodes, guard: Guard) -> None:
        """Process the event that a variable has changed, where a label asks for it."""
        if ("change", key.rpartition(".")[2]) not in self._implicit:
            return
        pairs = zip(self.variables.get(key, guard).ravel(), self.logic.simplified(old, guard).ravel(), strict=True)
        for new, before in pairs:
            differs = self.builder.call("ne", int(new), int(before)) if new != before else self.builder.const(0.0)
            where = self.logic.where(guard, differs)
            if where is not None:
                self._broadcast(f"change {key}", self.diagram.root, where)

    def send(self, event: ChartEvent, to: StateNode | None, context: ActionContext, guard: Guard) -> None:
        """Process an event at once: in the state that it is sent to, else in the one that it belongs to."""
        if event.written.scope == "OUTPUT_EVENT":
            self._emit(event, guard)
            return
        if event.written.scope != "LOCAL_EVENT":
            raise UnsupportedError(f"{context.place}: it sends {event.written.name}, which comes from outside")
        self.machine.counting.count(event.key, guard)
        self._broadcast(event.key, to or event.owner, guard)

    def _emit(self, event: ChartEvent, guard: Guard) -> None:
        if event.written.trigger == "FUNCTION_CALL_EVENT":
            self.machine.called(event, guard)
            return
        key = f"output {event.key}"
        now = self.variables.one(key, guard)
        self.variables.put(key, self.builder.call("sub", self.builder.const(1.0), now), guard)

    def _broadcast(self, event: str, to: StateNode, guard: Guard) -> None:
        self.sent += 1
        with self.machine.deeper("sends events to itself"):
            where = self.logic.where(guard, self.machine.activity.active(to, guard))
            context = ActionContext(to, to, event, place=f"its state {to.path}" if to.path else "the chart")
            if where is not None and to.parent is None:
                self.machine.activity.children(to, context, where)
            elif where is not None:
                self.machine.activity.execute(to, context, where)


def _implicit(diagram: ChartModel) -> frozenset[tuple[str, str]]:
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


class _Way(NamedTuple):
    """What has been passed so far: the transition actions to run, the states that the transitions are drawn in."""

    actions: tuple[tuple[tuple[m.Statement, ...], str], ...] = ()
    holders: frozenset[StateNode] = frozenset()


@dataclass(eq=False)
class Fired:
    """A way that ends at a state; `guard` says where it is taken."""

    target: StateNode
    way: _Way
    guard: Guard


@dataclass
class JunctionSearch:
    """Follows the transitions from one place."""

    machine: "ChartExecution"
    context: ActionContext
    fired: list[Fired] = field(default_factory=list)
    _waiting: "dict[tuple[JunctionNode | StateNode, _Way], list[Guard]]" = field(default_factory=dict)
    _ended: list[Guard] = field(default_factory=list)
    _turns: dict[JunctionNode, int] = field(default_factory=dict)
    _depth: int = 0

    def run(self, arrows: list[TransitionEdge], guard: Guard) -> Guard | None:
        """Try transitions; `fired` has those that lead to states, what is returned is the guard where none does."""
        left = self._tried(arrows, guard, _Way())
        while (meeting := self._next()) is not None:
            guards = self._waiting.pop(meeting)
            begun = self.machine.logic.either(guards)
            if begun is not None and isinstance(meeting[0], JunctionNode):
                self._turn(meeting[0])
                self._tried(meeting[0].arrows, begun, meeting[1])
        for (target, way), guards in self._waiting.items():
            taken = self.machine.logic.either(guards)
            if isinstance(target, StateNode) and taken is not None:
                self.fired.append(Fired(target, way, taken))
        return self.machine.logic.either([left, *self._ended])

    def _next(self) -> "tuple[JunctionNode | StateNode, _Way] | None":
        """A junction where ways meet that no other such leads to, unless they lead to each other."""
        reach = self.machine.reach
        met = [(one, one[0]) for one in self._waiting if isinstance(one[0], JunctionNode)]
        for one, knot in met:
            if not any(knot in reach[other] and other not in reach[knot] for _, other in met if other is not knot):
                return one
        return met[0][0] if met else None

    def _tried(self, arrows: list[TransitionEdge], guard: Guard, way: _Way) -> Guard | None:
        """The guard where none of the transitions leads on."""
        left: Guard | None = guard
        for arrow in arrows:
            if left is None:
                return None
            self.machine.work()
            taken = self._taken(arrow, left)
            if taken is None:
                continue
            after = self.machine.statements.run(arrow.before, self.context.at(arrow.place), taken)
            back = self._reached(arrow, after, way) if after is not None else None
            left = self.machine.logic.besides(left, taken)
            if back is not None:
                left = self.machine.logic.either([left, back])
        return left

    def _taken(self, arrow: TransitionEdge, guard: Guard) -> Guard | None:
        """The guard where a transition may be followed."""
        context = self.context.at(arrow.place)
        found = self.machine.events.happens(arrow.events, context, guard) if arrow.events else guard
        if found is None or arrow.condition is None:
            return found
        condition = self.machine.values.one(arrow.condition, context, found)
        return self.machine.logic.where(found, condition)

    def _reached(self, arrow: TransitionEdge, guard: Guard, way: _Way) -> Guard | None:
        """Go on from the end of a transition; the guard where it has to be given up."""
        actions = (*way.actions, (arrow.after, arrow.place)) if arrow.after else way.actions
        way = _Way(actions, way.holders | {arrow.holder})
        target = arrow.target
        if isinstance(target, JunctionNode) and target.history:
            target = target.holder
        if isinstance(target, StateNode) or target in self.machine.sure:
            if isinstance(target, JunctionNode) and not target.arrows:
                self._ended.append(guard)
            else:
                self._waiting.setdefault((target, way), []).append(guard)
            return None
        self._turn(target)
        self._depth += 1
        if self._depth > _DEEPEST:
            raise self._endless(_DEEPEST)
        left = self._tried(target.arrows, guard, way)
        self._depth -= 1
        return left

    def _turn(self, knot: JunctionNode) -> None:
        """Count how often a junction is passed."""
        self.machine.work()
        self._turns[knot] = self._turns.get(knot, 0) + 1
        if self._turns[knot] > _MOST_TURNS:
            raise self._endless(_MOST_TURNS)

    def _endless(self, most: int) -> UnsupportedError:
        message = f"its junctions make a loop of more than {most} turns, or one whose end depends on signals"
        return UnsupportedError(message, DEFAULT_REMEDY)


def committed_junctions(knots: list[JunctionNode]) -> frozenset[JunctionNode]:
    """The junctions that are never gone back from: where nothing leaves them, or one way is always free."""
    sure = {knot for knot in knots if not knot.arrows and not knot.history}
    while True:
        more = {
            knot
            for knot in knots
            if knot not in sure
            and any(
                arrow.free and (isinstance(arrow.target, StateNode) or arrow.target.history or arrow.target in sure)
                for arrow in knot.arrows
            )
        }
        if not more:
            return frozenset(sure)
        sure |= more
