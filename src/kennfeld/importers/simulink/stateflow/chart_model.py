"""The linked model of a chart: nested states, transitions at their sources, names in their scopes."""

from collections.abc import Iterable, Iterator
from dataclasses import field

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.reader.model_tree import (
    StoredChart,
    StoredData,
    StoredEvent,
    StoredState,
    StoredTransition,
)
from kennfeld.importers.simulink.stateflow.label_parser import (
    ActionLanguage,
    parse_state_label,
    parse_transition_label,
    strip_comments,
)
from kennfeld.importers.simulink.variables.enumerations import enumerated_type
from kennfeld.program import tree as m

_MAX_DEPTH = 40  # nested states


@dataclass(eq=False)
class StateAction:
    """Statements of a state; `kind` is "entry", "during", "exit" or "on", the latter with its `event`."""

    kind: str
    body: m.Statements
    event: m.Expressions = ()


@dataclass(eq=False)
class StateNode:
    """A state, or the chart itself, which has no parent; `number` counts it among its siblings, from 1.

    `outer` and `inner` are the transitions that leave it outwards and inwards, `defaults` the default transitions to
    its children.
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
    def ancestors(self) -> "Iterator[StateNode]":
        """The state and its ancestors, innermost first."""
        here: StateNode | None = self
        while here is not None:
            yield here
            here = here.parent

    @property
    def active_key(self) -> str:
        """The memory of the activity of a parallel state."""
        return f"active {self.id}"

    @property
    def child_key(self) -> str:
        """The memory of the number of the active child; 0 if there is none."""
        return f"child {self.id}"

    @property
    def history_key(self) -> str:
        """The memory of the number of the last active child."""
        return f"history {self.id}"

    @property
    def path(self) -> str:
        """The names from the outermost state; empty for the chart."""
        return ".".join(reversed([state.name for state in self.ancestors if state.parent is not None]))

    @property
    def descendants(self) -> "Iterator[StateNode]":
        """The state and all states in it."""
        yield self
        for child in self.children:
            yield from child.descendants


@dataclass(eq=False)
class JunctionNode:
    """A connective or history junction; `holder` is the state that contains it."""

    id: str
    holder: StateNode
    history: bool = False
    transitions: "list[TransitionEdge]" = field(default_factory=list)


@dataclass(eq=False)
class TransitionEdge:
    """A transition; `holder` is the state that contains it."""

    place: str
    target: StateNode | JunctionNode
    holder: StateNode
    order: int
    events: m.Expressions = ()
    condition: m.Expression | None = None
    before: m.Statements = ()
    after: m.Statements = ()

    @property
    def free(self) -> bool:
        """True if the transition is unconditional."""
        return not self.events and self.condition is None


@dataclass(eq=False)
class ChartFunction:
    """A function of the chart: its flow chart, or its MATLAB code."""

    name: str
    state: StateNode
    parameters: tuple[str, ...]
    results: tuple[str, ...]
    script: str = ""
    refused: str = ""


@dataclass(frozen=True)
class ChartVariable:
    """A variable; `key` identifies it within the chart."""

    key: str
    written: StoredData


@dataclass(frozen=True)
class ChartEvent:
    """An event; `owner` is the state that is executed when it is broadcast."""

    key: str
    written: StoredEvent
    owner: StateNode


class ChartModel:
    """The states, junctions, transitions, functions, variables and events of a chart."""

    def __init__(self, chart: StoredChart) -> None:
        self.chart = chart
        self.language = ActionLanguage(chart.language, chart.bits)
        self.root = StateNode("", chart.name, parallel=chart.decomposition == "SET_CHART")
        self.states: dict[str, StateNode] = {"": self.root}
        self.functions: dict[tuple[str, str], ChartFunction] = {}
        self.data: dict[tuple[str, str], ChartVariable] = {}
        self.events: dict[tuple[str, str], ChartEvent] = {}
        self._drawn = {state.id: state for state in chart.states}
        for drawn in chart.states:
            if drawn.type != "GROUP_STATE" and not drawn.note:
                self._state(drawn)
        for state in self.states.values():
            self._number(state)
        self._junctions = {item.id: self._junction(item.id, item.type, item.parent) for item in chart.junctions}
        self._add_transitions()
        self._names()

    # states

    def _state(self, drawn: StoredState) -> StateNode | None:
        if drawn.id in self.states:
            return self.states[drawn.id]
        parent = self.holder(drawn.parent)
        if parent is None:
            return None
        if len(list(parent.ancestors)) > _MAX_DEPTH:
            raise UnsupportedError(f"states are nested more than {_MAX_DEPTH} levels deep")
        state = StateNode(drawn.id, drawn.name, parent, drawn.decomposition == "SET_STATE", order=drawn.order)
        self.states[drawn.id] = state
        if drawn.type == "FUNC_STATE":
            self._function(drawn, state)
            return state
        label = parse_state_label(drawn.label, self.chart.language)
        state.name = label.name
        state.actions = tuple(self._actions(drawn, state))
        if drawn.special:
            raise UnsupportedError(f"state {state.path} is {drawn.special}, which is not supported")
        parent.children.append(state)
        return state

    def holder(self, number: str) -> StateNode | None:
        """Return the state with an identifier; for a box, the state that contains it."""
        if number in self.states:
            return self.states[number]
        drawn = self._drawn.get(number)
        if drawn is None:
            return None
        # a state may be stored before its parent
        return self.holder(drawn.parent) if drawn.type == "GROUP_STATE" else self._state(drawn)

    def _number(self, state: StateNode) -> None:
        if state.parallel:
            orders = [child.order for child in state.children]
            if len(set(orders)) < len(orders):
                raise UnsupportedError(
                    f"the execution order of the parallel states of {state.path or 'the chart'} is not stated"
                )
            state.children.sort(key=lambda child: child.order)
        for number, child in enumerate(state.children, 1):
            child.number = number

    def _actions(self, drawn: StoredState, state: StateNode) -> Iterator[StateAction]:
        label = parse_state_label(drawn.label, self.chart.language)
        if label.bare and self.chart.language == "C":
            message = f"state {state.path} has actions without a keyword, whose meaning depends on the release"
            raise UnsupportedError(message, "Write entry: or entry, during: before these actions.")
        for action in label.actions:
            place = f"state {state.path}"
            if action.kind == "bind":
                raise UnsupportedError(f"{place}: bind actions are not supported")
            events = self.language.events(action.event, place)
            yield StateAction(action.kind, self.language.statements(action.code, place), events)

    def _function(self, drawn: StoredState, state: StateNode) -> None:
        signature = strip_comments(drawn.label, self.chart.language).strip()
        # [y, z] = f(a, b)
        outputs, equals, right = signature.rpartition("=")
        name, _, rest = right.partition("(")
        words = [word.strip() for word in rest.partition(")")[0].split(",") if word.strip()]
        results = [word for word in outputs.strip(" \t\n[]").replace(",", " ").split() if equals]
        state.name = name.strip()
        function = ChartFunction(state.name, state, tuple(words), tuple(results), drawn.script, drawn.special)
        self.functions[state.parent.id if state.parent else "", state.name] = function

    # transitions

    def _junction(self, number: str, kind: str, parent: str) -> JunctionNode:
        holder = self.holder(parent) or self.root
        if kind == "HISTORY_JUNCTION":
            holder.history = True
        return JunctionNode(number, holder, kind == "HISTORY_JUNCTION")

    def _add_transitions(self) -> None:
        known = {drawn.id for drawn in self.chart.transitions}
        for drawn in self.chart.transitions:
            # the whole transition has the label, the order and both ends; a piece would be a second way out of its
            # source, and the edge of a subchart is no place where a chart can rest
            if drawn.whole in known:
                continue
            if drawn.whole:
                text = " ".join(drawn.label.split())[:60] or "without label"
                message = f"transition {text} is a piece of one through a subchart, which the file lacks as a whole"
                raise UnsupportedError(message, "Save the model again, or use a complete copy of the file.")
            holder = self.holder(drawn.parent)
            target = self._junctions.get(drawn.target) or self.states.get(drawn.target)
            if target is None or holder is None:
                # a default transition that leads nowhere, without a label, has no effect
                if drawn.label.strip() or drawn.source:
                    raise UnsupportedError(f"transition {drawn.label.strip()[:60]} has no destination")
                continue
            self._leaving(drawn, holder).append(self._transition(drawn, target, holder))
        for transitions in self._all_transitions():
            _sort(transitions)

    def _all_transitions(self) -> Iterable[list[TransitionEdge]]:
        for state in self.states.values():
            yield from (state.outer, state.inner, state.defaults)
        yield from (junction.transitions for junction in self._junctions.values())

    def _leaving(self, drawn: StoredTransition, holder: StateNode) -> list[TransitionEdge]:
        if drawn.source in self._junctions:
            return self._junctions[drawn.source].transitions
        source = self.states.get(drawn.source)
        if source is None or not drawn.source:
            return holder.defaults
        # a transition that leaves a state inwards is drawn within it
        return source.inner if source is holder else source.outer

    def _transition(
        self, drawn: StoredTransition, target: StateNode | JunctionNode, holder: StateNode
    ) -> TransitionEdge:
        label = parse_transition_label(drawn.label, self.chart.language)
        text = " ".join(drawn.label.split())[:60]
        place = f"transition {text}" if text else "transition without label"
        if label.fault:
            raise UnsupportedError(f"{place}: {label.fault}")
        condition = self.language.expression(label.condition, place) if label.condition else None
        before = self.language.statements(label.condition_action, place)
        after = self.language.statements(label.action, place)
        events = self.language.events(label.event, place)
        return TransitionEdge(place, target, holder, drawn.order, events, condition, before, after)

    @property
    def types(self) -> Iterator[str]:
        """The data types of the variables, enumerations by the names of their classes."""
        return (enumerated_type(variable.written.type) for variable in self.data.values())

    @property
    def junctions(self) -> Iterable[JunctionNode]:
        """All junctions."""
        return self._junctions.values()

    @property
    def awaited(self) -> Iterator[m.Expression]:
        """All events that labels wait for."""
        for transitions in self._all_transitions():
            for transition in transitions:
                yield from transition.events
        for state in self.states.values():
            for action in state.actions:
                yield from action.event

    @property
    def inputs(self) -> list[ChartEvent]:
        """The input events, in the order of the trigger elements."""
        return [event for event in self.events.values() if event.written.scope == "INPUT_EVENT"]

    # names

    def _names(self) -> None:
        for data in self.chart.data:
            holder = self.holder(data.parent)
            # variables of the chart have their plain names, those of states their paths before these
            key = f"{holder.path}.{data.name}" if holder is not None and holder.parent is not None else data.name
            self.data[holder.id if holder is not None else "", data.name] = ChartVariable(key, data)
        for event in self.chart.events:
            owner = self.holder(event.parent) or self.root
            self.events[owner.id, event.name] = ChartEvent(f"{owner.path}.{event.name}", event, owner)

    def datum(self, name: str, scope: StateNode) -> ChartVariable | None:
        """Return the variable of a name in the scope of a state."""
        return next((variable for state in scope.ancestors if (variable := self.data.get((state.id, name)))), None)

    def event(self, name: str, scope: StateNode) -> ChartEvent | None:
        """Return the event of a name in the scope of a state."""
        return next((event for state in scope.ancestors if (event := self.events.get((state.id, name)))), None)

    def function(self, name: str, scope: StateNode) -> ChartFunction | None:
        """Return the function of a name in the scope of a state, else the only one of this name."""
        near = next((function for state in scope.ancestors if (function := self.functions.get((state.id, name)))), None)
        if near is not None:
            return near
        far = [state for (_, key), state in self.functions.items() if key == name]
        return far[0] if len(far) == 1 else None

    def state(self, path: list[str], scope: StateNode) -> StateNode | None:
        """Return the state at the end of a path of names, sought from the inside outwards, then anywhere."""
        for start in scope.ancestors:
            state = _down(start, path) or (_down(start, path[1:]) if start.name == path[0] and len(path) > 1 else None)
            if state is not None:
                return state
        if len(path) == 1 and scope.name == path[0]:
            return scope
        ends = [start for start in self.root.descendants if start.path.split(".")[-len(path) :] == path]
        return ends[0] if len(ends) == 1 else None


def _down(state: StateNode, path: list[str]) -> StateNode | None:
    here: StateNode | None = state
    for name in path:
        here = next((child for child in here.children if child.name == name), None) if here is not None else None
    return here


def _sort(transitions: list[TransitionEdge]) -> None:
    """Sort by the stated execution order; old files order by the kind of label."""
    if len(transitions) > 1 and len({transition.order for transition in transitions}) < len(transitions):
        kinds = [_kind(transition) for transition in transitions]
        if len(set(kinds)) < len(kinds):
            raise UnsupportedError(
                f"the execution order of {transitions[0].place} is not stated", "Save the model with a newer release."
            )
        transitions.sort(key=_kind)
    else:
        transitions.sort(key=lambda transition: transition.order)


def _kind(transition: TransitionEdge) -> int:
    # as Stateflow orders by labels: event and condition, event, condition, neither
    return 2 * (not transition.events) + (transition.condition is None)
