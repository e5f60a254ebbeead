"""A running chart: the state that its parts share, and how they call each other."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Protocol

from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.stateflow.chart_model import (
    ChartEvent,
    ChartFunction,
    ChartModel,
    JunctionNode,
    StateNode,
    TransitionEdge,
)
from kennfeld.importers.simulink.stateflow.guarded_variables import ActionContext, Guard, GuardedVariables, GuardLogic
from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.program import tree as m

_MAX_WORK = 30_000
_MAX_DEPTH = 12  # nested events and calls


class ExpressionPart(Protocol):
    """Evaluates expressions."""

    def scalar(self, tree: m.Expression, context: ActionContext, guard: Guard) -> int: ...
    def state(self, tree: m.Expression, context: ActionContext) -> StateNode: ...
    def event(self, tree: m.Expression, context: ActionContext) -> tuple[ChartEvent, StateNode | None] | None: ...
    def resolve_key(self, tree: m.Expression, context: ActionContext) -> str | None: ...


class StatementPart(Protocol):
    """Runs statements, and the bodies of functions."""

    def run(self, body: m.Statements, context: ActionContext, guard: Guard | None) -> Guard | None: ...
    def function(self, body: m.Statements, context: ActionContext, guard: Guard) -> Guard | None: ...


class StatePart(Protocol):
    """Executes, enters and leaves states."""

    def active(self, state: StateNode, guard: Guard) -> int: ...
    def execute(self, state: StateNode, context: ActionContext, guard: Guard) -> None: ...
    def execute_children(self, state: StateNode, context: ActionContext, guard: Guard) -> None: ...
    def clear(self, state: StateNode, guard: Guard) -> None: ...
    def enter(self, path: list[StateNode], context: ActionContext, guard: Guard) -> None: ...
    def enter_children(self, state: StateNode, context: ActionContext, guard: Guard) -> None: ...
    def leave_children(self, state: StateNode, context: ActionContext, guard: Guard) -> Guard | None: ...


class TransitionPart(Protocol):
    """Takes transitions, and runs flow charts."""

    def run_flow_chart(self, root: StateNode, context: ActionContext, guard: Guard) -> None: ...
    def take(
        self, state: StateNode, transitions: list[TransitionEdge], context: ActionContext, guard: Guard
    ) -> Guard | None: ...


class EventPart(Protocol):
    """Sends and recognises events; `sent` counts those that the chart has sent to itself."""

    sent: int

    def match(self, events: m.Expressions, context: ActionContext, guard: Guard) -> Guard | None: ...
    def is_waking(self, event: str) -> bool: ...
    def notify_state(self, kind: str, state: StateNode, guard: Guard) -> None: ...
    def notify_change(self, key: str, old: Nodes, guard: Guard) -> None: ...
    def send(self, event: ChartEvent, to: StateNode | None, context: ActionContext, guard: Guard) -> None: ...


class TimerPart(Protocol):
    """Counts and evaluates timers."""

    def count(self, event: str, guard: Guard) -> None: ...
    def restart(self, state: StateNode, guard: Guard) -> None: ...
    def measure(self, context: ActionContext, guard: Guard) -> None: ...
    def evaluate(self, name: str, arguments: m.Expressions, context: ActionContext, guard: Guard) -> int: ...


class FunctionPart(Protocol):
    """Calls functions of the chart."""

    def call(
        self, function: ChartFunction, arguments: Sequence[Nodes | None], context: ActionContext, guard: Guard
    ) -> tuple[list[Nodes], Guard | None]: ...


class ChartMachine:
    """A running chart: the state that its parts share, and the parts.

    `time` and `dt` are nodes in s. `called` receives the output events that call functions.
    """

    # set after all parts exist: each of them calls the others by way of the machine
    values: ExpressionPart
    statements: StatementPart
    activity: StatePart
    transitions: TransitionPart
    events: EventPart
    counting: TimerPart
    functions: FunctionPart

    def __init__(
        self,
        diagram: ChartModel,
        builder: GraphBuilder,
        values: Mapping[str, Nodes],
        sized: frozenset[str],
        clock: tuple[int, int],
    ) -> None:
        self.diagram, self.builder, self.logic = diagram, builder, GuardLogic(builder)
        self.variables = GuardedVariables(self.logic, values, sized)
        self.time, self.dt = clock
        # replaced by the block of the chart, which alone knows the subsystems that are called
        self.called: Callable[[ChartEvent, Guard], None] = lambda event, guard: None
        # once for the chart: the search asks for it at each meeting of paths
        self.reach = {junction: _reachable(junction) for junction in diagram.junctions}
        self._done = self._depth = 0

    def work(self) -> None:
        """Count an action; reject charts that expand endlessly."""
        self._done += 1
        if self._done > _MAX_WORK:
            raise UnsupportedError(f"the chart expands to more than {_MAX_WORK} actions", DEFAULT_REMEDY)

    @contextmanager
    def nested(self, message: str) -> Iterator[None]:
        """Count nested calls and events; reject endless recursion."""
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise UnsupportedError(f"{message}, without end or more than {_MAX_DEPTH} levels deep", DEFAULT_REMEDY)
        yield
        self._depth -= 1


def _reachable(junction: JunctionNode) -> frozenset[JunctionNode]:
    """Return the junctions that are reachable from one."""
    seen: set[JunctionNode] = set()
    waiting = [junction]
    while waiting:
        for transition in waiting.pop().transitions:
            if isinstance(transition.target, JunctionNode) and transition.target not in seen:
                seen.add(transition.target)
                # states end a path, so that only junctions are followed
                waiting.append(transition.target)
    return frozenset(seen)


class ChartPart:
    """A part of a running chart."""

    def __init__(self, machine: ChartMachine) -> None:
        self.machine = machine
        self.diagram, self.builder = machine.diagram, machine.builder
        self.logic, self.variables = machine.logic, machine.variables
