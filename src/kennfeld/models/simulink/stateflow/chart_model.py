"""A chart with its parts tied together: states in states, transitions at what they leave, names in their scopes."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.reader.model_tree import (
    StoredChart,
    StoredData,
    StoredEvent,
    StoredState,
    StoredTransition,
)
from kennfeld.models.simulink.stateflow.label_parser import (
    ActionLanguage,
    state_label,
    transition_label,
    without_comments,
)

__all__ = [
    "ChartEvent",
    "ChartFunction",
    "ChartModel",
    "ChartVariable",
    "JunctionNode",
    "StateAction",
    "StateNode",
    "TransitionEdge",
]

_DEEPEST = 40  # states within states


@dataclass(eq=False)
class StateAction:
    """Statements of a state; `kind` is "entry", "during", "exit" or "on", then with the `event`."""

    kind: str
    body: tuple[m.Statement, ...]
    event: tuple[m.Expression, ...] = ()


@dataclass(eq=False)
class StateNode:
    """A state, or the chart itself, which has no parent. `number` counts it among its siblings, from 1.

    `outer` and `inner` are the transitions that leave it outwards and inwards, `defaults` those that lead to its
    children from nowhere.
    """

    id: str
    name: str
    parent: "StateNode | None" = None
    parallel: bool = False
    children: "list[StateNode]" = field(default_factory=list)
    number: int = 0
    order: int = 0
    history: bool = False
    actions: tuple[StateAction, ...] = ()
    outer: "list[TransitionEdge]" = field(default_factory=list)
    inner: "list[TransitionEdge]" = field(default_factory=list)
    defaults: "list[TransitionEdge]" = field(default_factory=list)

    @property
    def around(self) -> "Iterator[StateNode]":
        """The state and those around it, from the inside."""
        here: StateNode | None = self
        while here is not None:
            yield here
            here = here.parent

    @property
    def active_key(self) -> str:
        """The memory of whether it is active, of a state among parallel ones."""
        return f"active {self.id}"

    @property
    def child_key(self) -> str:
        """The memory of which of its children is active, by their numbers; 0 where none is."""
        return f"child {self.id}"

    @property
    def history_key(self) -> str:
        """The memory of which of its children was active last."""
        return f"history {self.id}"

    @property
    def path(self) -> str:
        """The names from the outside; empty for the chart."""
        return ".".join(reversed([one.name for one in self.around if one.parent is not None]))

    @property
    def below(self) -> "Iterator[StateNode]":
        """The state and all states in it."""
        yield self
        for child in self.children:
            yield from child.below


@dataclass(eq=False)
class JunctionNode:
    """A connective or history junction; `holder` is the state around it."""

    id: str
    holder: StateNode
    history: bool = False
    arrows: "list[TransitionEdge]" = field(default_factory=list)


@dataclass(eq=False)
class TransitionEdge:
    """A transition; `holder` is the state that it is drawn in."""

    place: str
    target: StateNode | JunctionNode
    holder: StateNode
    order: int
    events: tuple[m.Expression, ...] = ()
    condition: m.Expression | None = None
    before: tuple[m.Statement, ...] = ()
    after: tuple[m.Statement, ...] = ()

    @property
    def free(self) -> bool:
        """Whether nothing can keep it from being taken."""
        return not self.events and self.condition is None


@dataclass(eq=False)
class ChartFunction:
    """A function of the chart: its flow chart, or its code in MATLAB."""

    name: str
    state: StateNode
    parameters: tuple[str, ...]
    results: tuple[str, ...]
    script: str = ""
    refused: str = ""


@dataclass(frozen=True)
class ChartVariable:
    """A variable; `key` tells it from all others of the chart."""

    key: str
    written: StoredData


@dataclass(frozen=True)
class ChartEvent:
    """An event; `owner` is the state that executes where it is broadcast."""

    key: str
    written: StoredEvent
    owner: StateNode


class ChartModel:
    """The parts of a chart."""

    def __init__(self, chart: StoredChart) -> None:
        self.chart = chart
        self.language = ActionLanguage(chart.language, chart.bits)
        parallel = chart.decomposition == "SET_CHART"
        self.root = StateNode("", chart.name, parallel=parallel)
        self.states: dict[str, StateNode] = {"": self.root}
        self.functions: dict[tuple[str, str], ChartFunction] = {}
        self.data: dict[tuple[str, str], ChartVariable] = {}
        self.events: dict[tuple[str, str], ChartEvent] = {}
        self._drawn = {state.id: state for state in chart.states}
        self._states()
        self._knots = {one.id: self._knot(one.id, one.type, one.parent) for one in chart.junctions}
        self._arrows()
        self._names()

    # states

    def _states(self) -> None:
        for drawn in self.chart.states:
            if drawn.type == "GROUP_STATE" or drawn.note:
                continue
            self._state(drawn)
        for state in self.states.values():
            self._number(state)

    def _state(self, drawn: StoredState) -> StateNode | None:
        if drawn.id in self.states:
            return self.states[drawn.id]
        parent = self.holder(drawn.parent)
        if parent is None:
            return None
        if len(list(parent.around)) > _DEEPEST:
            raise UnsupportedError(f"its states lie more than {_DEEPEST} deep within each other")
        made = StateNode(drawn.id, drawn.name, parent, drawn.decomposition == "SET_STATE", order=drawn.order)
        self.states[drawn.id] = made
        if drawn.type == "FUNC_STATE":
            self._function(drawn, made)
            return made
        label = state_label(drawn.label, self.chart.language)
        made.name = label.name
        made.actions = tuple(self._actions(drawn, made))
        if drawn.special:
            raise UnsupportedError(f"its state {made.path} is {drawn.special}")
        parent.children.append(made)
        return made

    def holder(self, number: str) -> StateNode | None:
        """The state of a number; of a box the state around it."""
        if number in self.states:
            return self.states[number]
        drawn = self._drawn.get(number)
        if drawn is None:
            return None
        return self.holder(drawn.parent) if drawn.type == "GROUP_STATE" else self._state(drawn)

    def _number(self, state: StateNode) -> None:
        if state.parallel:
            orders = [child.order for child in state.children]
            if len(set(orders)) < len(orders):
                raise UnsupportedError(
                    f"the file does not say in which order the parallel states of {_said(state)} run"
                )
            state.children.sort(key=lambda child: child.order)
        for number, child in enumerate(state.children, 1):
            child.number = number

    def _actions(self, drawn: StoredState, state: StateNode) -> Iterator[StateAction]:
        label = state_label(drawn.label, self.chart.language)
        if label.bare and self.chart.language == "C":
            message = f"its state {state.path} has actions without a keyword, which releases read differently"
            raise UnsupportedError(message, "Write entry: or entry, during: before them.")
        for one in label.actions:
            place = f"its state {state.path}"
            if one.kind == "bind":
                raise UnsupportedError(f"{place} binds variables or events")
            events = self.language.events(one.event, place)
            yield StateAction(one.kind, self.language.statements(one.code, place), events)

    def _function(self, drawn: StoredState, state: StateNode) -> None:
        signature = without_comments(drawn.label, self.chart.language).strip()
        left, equals, right = signature.rpartition("=")
        name, _, rest = right.partition("(")
        words = [word.strip() for word in rest.partition(")")[0].split(",") if word.strip()]
        results = [word for word in left.strip(" \t\n[]").replace(",", " ").split() if equals]
        state.name = name.strip()
        made = ChartFunction(state.name, state, tuple(words), tuple(results), drawn.script, drawn.special)
        self.functions[state.parent.id if state.parent else "", state.name] = made

    # transitions

    def _knot(self, number: str, kind: str, parent: str) -> JunctionNode:
        holder = self.holder(parent) or self.root
        if kind == "HISTORY_JUNCTION":
            holder.history = True
        return JunctionNode(number, holder, kind == "HISTORY_JUNCTION")

    def _arrows(self) -> None:
        for drawn in self.chart.transitions:
            holder = self.holder(drawn.parent)
            target = self._knots.get(drawn.target) or self.states.get(drawn.target)
            if target is None or holder is None:
                if drawn.label.strip() or drawn.source:
                    raise UnsupportedError(f"a transition of it ({drawn.label.strip()[:60]}) leads nowhere")
                continue
            self._leaving(drawn, holder).append(self._arrow(drawn, target, holder))
        for arrows in self._all_arrows():
            _sort(arrows)

    def _all_arrows(self) -> Iterable[list[TransitionEdge]]:
        for state in self.states.values():
            yield from (state.outer, state.inner, state.defaults)
        yield from (knot.arrows for knot in self._knots.values())

    def _leaving(self, drawn: StoredTransition, holder: StateNode) -> list[TransitionEdge]:
        if drawn.source in self._knots:
            return self._knots[drawn.source].arrows
        source = self.states.get(drawn.source)
        if source is None or not drawn.source:
            return holder.defaults
        return source.inner if source is holder else source.outer

    def _arrow(self, drawn: StoredTransition, target: StateNode | JunctionNode, holder: StateNode) -> TransitionEdge:
        label = transition_label(drawn.label, self.chart.language)
        said = " ".join(drawn.label.split())[:60]
        place = f"its transition {said}" if said else "a transition of it"
        if label.fault:
            raise UnsupportedError(f"{place}: {label.fault}")
        condition = self.language.expression(label.condition, place) if label.condition else None
        before = self.language.statements(label.condition_action, place)
        after = self.language.statements(label.action, place)
        events = self.language.events(label.event, place)
        return TransitionEdge(place, target, holder, drawn.order, events, condition, before, after)

    @property
    def knots(self) -> Iterable[JunctionNode]:
        """All junctions."""
        return self._knots.values()

    @property
    def awaited(self) -> Iterator[m.Expression]:
        """All events that labels wait for."""
        for arrows in self._all_arrows():
            for arrow in arrows:
                yield from arrow.events
        for state in self.states.values():
            for action in state.actions:
                yield from action.event

    @property
    def inputs(self) -> list[ChartEvent]:
        """The events that come from outside, in the order of the elements of the trigger."""
        return [one for one in self.events.values() if one.written.scope == "INPUT_EVENT"]

    # names

    def _names(self) -> None:
        for one in self.chart.data:
            holder = self.holder(one.parent)
            key = f"{holder.path}.{one.name}" if holder is not None and holder.parent is not None else one.name
            self.data[holder.id if holder is not None else "", one.name] = ChartVariable(key, one)
        for event in self.chart.events:
            owner = self.holder(event.parent) or self.root
            self.events[owner.id, event.name] = ChartEvent(f"{owner.path}.{event.name}", event, owner)

    def datum(self, name: str, scope: StateNode) -> ChartVariable | None:
        """The variable that a name means in a state."""
        return next((found for one in scope.around if (found := self.data.get((one.id, name)))), None)

    def event(self, name: str, scope: StateNode) -> ChartEvent | None:
        """The event that a name means in a state."""
        return next((found for one in scope.around if (found := self.events.get((one.id, name)))), None)

    def function(self, name: str, scope: StateNode) -> ChartFunction | None:
        """The function that a name means in a state; where none is around, the only one of the name."""
        near = next((found for one in scope.around if (found := self.functions.get((one.id, name)))), None)
        if near is not None:
            return near
        far = [one for (_, other), one in self.functions.items() if other == name]
        return far[0] if len(far) == 1 else None

    def state(self, way: list[str], scope: StateNode) -> StateNode | None:
        """The state at the end of a way of names, sought from the inside to the outside, then anywhere."""
        for one in scope.around:
            found = _down(one, way) or (_down(one, way[1:]) if one.name == way[0] and len(way) > 1 else None)
            if found is not None:
                return found
        if len(way) == 1 and scope.name == way[0]:
            return scope
        ends = [one for one in self.root.below if one.path.split(".")[-len(way) :] == way]
        return ends[0] if len(ends) == 1 else None


def _down(state: StateNode, way: list[str]) -> StateNode | None:
    here: StateNode | None = state
    for name in way:
        here = next((child for child in here.children if child.name == name), None) if here is not None else None
    return here


def _said(state: StateNode) -> str:
    return state.path or "the chart"


def _sort(arrows: list[TransitionEdge]) -> None:
    """By the order that the file states; old files order by what labels ask for."""
    if len(arrows) > 1 and len({arrow.order for arrow in arrows}) < len(arrows):
        kinds = [_kind(arrow) for arrow in arrows]
        if len(set(kinds)) < len(kinds):
            raise UnsupportedError(
                f"the file does not say when {arrows[0].place} is tried", "Save it with a newer release."
            )
        arrows.sort(key=_kind)
    else:
        arrows.sort(key=lambda arrow: arrow.order)


def _kind(arrow: TransitionEdge) -> int:
    return (0 if arrow.condition is not None else 1) if arrow.events else (2 if arrow.condition is not None else 3)
