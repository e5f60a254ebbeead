"""Which states of a chart are active, and how they are executed, entered and left, each under a guard.

One step of a chart: its states are executed, entered and left as the semantics of charts say, each under a guard.

Transitions that are taken: which one leads on, what it leaves, the actions on its way, and what it enters.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.expressions.parameter_expressions import Expressions
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.stateflow.chart_expressions import ChartExpressions
from kennfeld.models.simulink.stateflow.chart_model import (
    ChartEvent,
    ChartModel,
    JunctionNode,
    StateAction,
    StateNode,
    TransitionEdge,
)
from kennfeld.models.simulink.stateflow.guarded_statements import ChartFunctionCalls, GuardedStatements
from kennfeld.models.simulink.stateflow.guarded_variables import ActionContext, Guard, GuardedVariables, GuardLogic
from kennfeld.models.simulink.stateflow.temporal_logic import ChartTimers, TemporalLogic
from kennfeld.models.simulink.stateflow.transition_search import (
    EventDispatch,
    Fired,
    JunctionSearch,
    committed_junctions,
)
from kennfeld.models.simulink.variables.mask_scope import Scope

__all__ = ["ChartExecution"]

_FEW = 12  # children; what many of them do is followed apart, so that one does not burden the next

_MOST_WORK = 30_000
_DEEPEST = 12  # events sent, or functions called, within each other

Called = Callable[[ChartEvent, Guard], None]


class StateExecution:
    """The states of a machine."""

    def __init__(self, machine: "ChartExecution") -> None:
        self.machine = machine
        self.logic = machine.logic
        self.builder = machine.builder
        self.variables = machine.variables

    def active(self, state: StateNode, guard: Guard) -> int:
        """The node that says whether a state is active."""
        if state.parent is None:
            return self.builder.const(1.0)
        if state.parent.parallel:
            return self.variables.one(state.active_key, guard)
        child = self.variables.one(state.parent.child_key, guard)
        return self.builder.call("eq", child, self.builder.const(float(state.number)))

    def still(self, state: StateNode) -> Callable[[Guard], Guard | None]:
        """Gives the guard where a state is still active."""
        return lambda guard: self.logic.where(guard, self.active(state, guard))

    def execute(self, state: StateNode, context: ActionContext, guard: Guard) -> None:
        """An active state: its outer transitions, else its actions, its inner transitions and its children."""
        self.machine.work()
        here = replace(context, scope=state, owner=state, alive=self.still(state), frame="")
        left = self.machine.transitions.take(state, state.outer, here, guard)
        for action in state.actions:
            if left is not None and action.kind in ("during", "on"):
                left = self._during(action, state, here, left)
        if left is not None:
            left = self.machine.transitions.take(state, state.inner, here, left)
        if left is not None:
            self.children(state, here, left)

    def _during(self, action: StateAction, state: StateNode, context: ActionContext, guard: Guard) -> Guard | None:
        context = context.at(f"its state {state.path}")
        where = self.machine.events.happens(action.event, context, guard) if action.kind == "on" else guard
        end = self.machine.statements.run(action.body, context, where)
        return guard if end is where else self.logic.either([self.logic.besides(guard, where), end])

    def children(self, state: StateNode, context: ActionContext, guard: Guard) -> None:
        """Execute the children of a state that are active."""
        if state.parallel:
            for child in state.children:
                still = self.still(state)(guard)
                where = self.logic.where(still, self.active(child, still)) if still is not None else None
                if where is not None:
                    self.execute(child, context, where)
            return
        ways = self.each_child(state, guard)
        if len(ways) <= _FEW:
            for child, where in ways:
                self.execute(child, context, where)
            return
        before = self.variables.values
        after = []
        for child, where in ways:
            self.variables.values = dict(before)
            self.execute(child, context, where)
            after.append((where, self.variables.values))
        self.variables.values = self.variables.joined(before, after)

    def each_child(self, state: StateNode, guard: Guard) -> list[tuple[StateNode, Guard]]:
        """The children of a state that may be active now, each with the guard where it is."""
        if not state.children:
            return []
        now = self.variables.one(state.child_key, guard)
        found = []
        for child in state.children:
            equal = self.builder.call("eq", now, self.builder.const(float(child.number)))
            where = self.logic.where(guard, equal)
            if where is not None:
                found.append((child, where))
        return found

    def enter(self, way: list[StateNode], context: ActionContext, guard: Guard) -> None:
        """Enter the states on the way down to one, and what is entered with them."""
        state, rest = way[0], way[1:]
        self.machine.work()
        after = self._entered(state, context, guard)
        if after is None:
            return
        if not rest:
            self.enter_children(state, context, after)
        elif state.parallel:
            for child in state.children:
                self.enter(rest if child is rest[0] else [child], context, after)
        else:
            self.enter(rest, context, after)

    def _entered(self, state: StateNode, context: ActionContext, guard: Guard) -> Guard | None:
        """Mark a state as active, and run its entry actions."""
        assert state.parent is not None
        if state.parent.parallel:
            self.variables.put(state.active_key, self.builder.const(1.0), guard)
        else:
            number = self.builder.const(float(state.number))
            self.variables.put(state.parent.child_key, number, guard)
            if state.parent.history:
                self.variables.put(state.parent.history_key, number, guard)
        self.clear(state, guard)
        self.machine.counting.restart(state, guard)
        after = self._acted(state, "entry", context, guard)
        if after is None:
            return None
        self.machine.events.tell("entry", state, after)
        return self.still(state)(after)

    def clear(self, state: StateNode, guard: Guard) -> None:
        """Note that no child of a state is active, which holds whenever it is entered."""
        names = [one.active_key for one in state.children] if state.parallel else [state.child_key]
        for name in names if state.children else ():
            self.variables.put(name, self.builder.const(0.0), guard)

    def _acted(self, state: StateNode, kind: str, context: ActionContext, guard: Guard) -> Guard | None:
        here = replace(
            context, scope=state, owner=state, alive=self.still(state), place=f"its state {state.path}", frame=""
        )
        found: Guard | None = guard
        for action in state.actions:
            if action.kind == kind:
                found = self.machine.statements.run(action.body, here, found)
        return found

    def enter_children(self, state: StateNode, context: ActionContext, guard: Guard) -> None:
        """Enter what goes with a state that has just become active: by its history, else by its default transitions."""
        if state.parallel:
            for child in state.children:
                self.enter([child], context, guard)
            return
        left: Guard | None = guard
        if state.history:
            last = self.variables.one(state.history_key, guard)
            for child in state.children:
                where = self.logic.where(guard, self.builder.call("eq", last, self.builder.const(float(child.number))))
                if where is not None:
                    self.enter([child], context, where)
            left = self.logic.where(guard, self.builder.call("eq", last, self.builder.const(0.0)))
        if left is not None and state.defaults:
            here = replace(context, scope=state, owner=state, alive=self.still(state), frame="")
            self.machine.transitions.take(state, state.defaults, here, left)

    def leave_children(self, state: StateNode, context: ActionContext, guard: Guard) -> Guard | None:
        """Leave the children of a state that are active, the last of parallel ones first."""
        if not state.parallel:
            ways = [self._leave(child, context, where) for child, where in self.each_child(state, guard)]
            return self._after(state, guard, ways)
        found: Guard | None = guard
        for child in reversed(state.children):
            if found is None:
                return None
            where = self.logic.where(found, self.active(child, found))
            if where is not None:
                self._leave(child, context, where)
        return found

    def _after(self, state: StateNode, guard: Guard, ways: list[Guard | None]) -> Guard | None:
        """The guard after the children have been left, unless an event that one of them has sent left the state too."""
        return guard if None not in ways else self.logic.where(guard, self.active(state, guard))

    def _leave(self, state: StateNode, context: ActionContext, guard: Guard) -> Guard | None:
        self.machine.work()
        assert state.parent is not None
        inner = self.leave_children(state, context, guard)
        after = self._acted(state, "exit", context, inner) if inner is not None else None
        if after is None:
            return None
        name = state.active_key if state.parent.parallel else state.parent.child_key
        self.variables.put(name, self.builder.const(0.0), after)
        self.machine.events.tell("exit", state, after)
        return self.still(state.parent)(after)


class TransitionExecution:
    """The transitions between the states of a machine."""

    def __init__(self, machine: "ChartExecution") -> None:
        self.machine = machine
        self.logic = machine.logic
        self.builder = machine.builder
        self.variables = machine.variables

    def take(
        self, state: StateNode, arrows: list[TransitionEdge], context: ActionContext, guard: Guard
    ) -> Guard | None:
        """Take the first transition that can be; the guard where none is."""
        if not arrows:
            return guard
        search = JunctionSearch(self.machine, context)
        left = search.run(arrows, guard)
        for one in search.fired:
            self._fire(one, state, context)
        return left

    def _fire(self, fired: Fired, source: StateNode, context: ActionContext) -> None:
        """Leave the states up to the one that the way is drawn in, run the transition's actions, and enter others."""
        top = _outermost(fired.way.holders)
        if top.parallel and top is not source:
            message = f"a transition from its state {source.path} to {fired.target.path} crosses parallel states"
            raise UnsupportedError(message)
        guard = self.machine.activity.leave_children(top, context, fired.guard)
        quiet = self._calm(top)
        for body, place in fired.way.actions:
            here = replace(context, owner=source, alive=quiet, place=place)
            guard = self.machine.statements.run(body, here, guard)
        if guard is not None:
            self._enter_way(top, fired.target, context, guard)

    def _calm(self, top: StateNode) -> Callable[[Guard], Guard | None]:
        """Gives the guard where a state is active without an active child, so that a transition in it may go on."""

        def calm(guard: Guard) -> Guard | None:
            found = self.logic.where(guard, self.machine.activity.active(top, guard))
            if found is None or top.parallel or not top.children:
                return found
            child = self.variables.one(top.child_key, found)
            return self.logic.where(found, self.builder.call("eq", child, self.builder.const(0.0)))

        return calm

    def _enter_way(self, top: StateNode, target: StateNode, context: ActionContext, guard: Guard) -> None:
        """Enter the states below one, down to a target and what is entered with it."""
        if target is top:
            self.machine.activity.enter_children(top, context, guard)
            return
        way = [target]
        while way[0].parent is not None and way[0].parent is not top:
            way.insert(0, way[0].parent)
        if way[0].parent is None:
            raise UnsupportedError(f"a transition into its state {target.path} is drawn where it cannot be")
        self.machine.activity.enter(way, context, guard)


def _outermost(holders: frozenset[StateNode]) -> StateNode:
    return min(holders, key=lambda state: len(list(state.around)))


class ChartExecution:
    """Follows one step of a chart.

    `variables` hold what the step begins with and, in the end, what it leaves. `time` and `dt` are nodes in s.
    `called` is told of output events that call functions.
    """

    def __init__(
        self,
        diagram: ChartModel,
        timers: ChartTimers,
        expressions: Expressions,
        scope: Scope,
        values: Mapping[str, Nodes],
        sized: frozenset[str],
        clock: tuple[int, int],
        called: Called,
    ) -> None:
        self.diagram = diagram
        self.timers = timers
        self.logic = GuardLogic(expressions.builder)
        self.builder = expressions.builder
        self.variables = GuardedVariables(self.logic, values, sized)
        self.values = ChartExpressions(self, expressions, scope)
        self.statements = GuardedStatements(self, self.values)
        self.time, self.dt = clock
        self.called = called
        self.activity = StateExecution(self)
        self.transitions = TransitionExecution(self)
        self.events = EventDispatch(self)
        self.counting = TemporalLogic(self)
        self.functions = ChartFunctionCalls(self)
        self._done = 0
        self._depth = 0
        knots = list(diagram.knots)
        self.sure = committed_junctions(knots)
        self.reach = {knot: _reached(knot) for knot in knots}

    def work(self) -> None:
        """Count a piece of work; what would never end is refused."""
        self._done += 1
        if self._done > _MOST_WORK:
            raise UnsupportedError(f"its chart unfolds to more than {_MOST_WORK} actions", DEFAULT_REMEDY)

    @contextmanager
    def deeper(self, message: str) -> Iterator[None]:
        """What is followed within something else; refused where that has no end."""
        self._depth += 1
        if self._depth > _DEEPEST:
            raise UnsupportedError(f"it {message} without an end, or more than {_DEEPEST} deep", DEFAULT_REMEDY)
        yield
        self._depth -= 1

    def wake(self, guard: Guard, event: str = "") -> None:
        """One execution of the chart."""
        root = self.diagram.root
        context = ActionContext(root, root, event, place="the chart")
        self.counting.count(event, guard)
        active = self.variables.one("active", guard)
        first = self.logic.where(guard, active, holds=False)
        later = self.logic.where(guard, active)
        self.variables.put("active", self.builder.const(1.0), guard)
        self._watch(first, guard)
        if not root.children:
            self.flow(root, context, guard)
            return
        if first is not None:
            self.activity.clear(root, first)
            self.activity.enter_children(root, context, first)
        if later is not None:
            self.counting.measure(context, later)
            self.activity.children(root, context, later)

    def _watch(self, first: Guard | None, guard: Guard) -> None:
        """Note what the variables hold whose changes are asked for; in the first step nothing has changed."""
        for key in self.timers.watched:
            value = self.variables.get(key, guard)
            self.variables.set(f"before {key}", self.variables.get(f"now {key}", guard), guard)
            self.variables.set(f"now {key}", value, guard)
            if first is not None:
                self.variables.set(f"before {key}", value, first)

    def begin(self, guard: Guard) -> None:
        """Enter the chart before the first step."""
        root = self.diagram.root
        context = ActionContext(root, root, place="the chart")
        self.variables.put("active", self.builder.const(1.0), guard)
        if root.children:
            self.activity.clear(root, guard)
            self.activity.enter_children(root, context, guard)
        else:
            self.flow(root, context, guard)

    def flow(self, root: StateNode, context: ActionContext, guard: Guard) -> None:
        """The flow chart of a chart without states, or of a function."""
        search = JunctionSearch(self, context)
        search.run(root.defaults, guard)
        if search.fired:
            raise UnsupportedError(f"{context.place} leads from a flow chart into a state")

    def check_writable(self, key: str, context: ActionContext) -> None:
        """Refuse an assignment to what a chart may only read."""
        data = next((one for one in self.diagram.data.values() if one.key == key), None)
        if data is not None and data.written.scope in ("INPUT_DATA", "CONSTANT_DATA"):
            raise UnsupportedError(f"{context.place}: it assigns to {key}, which it may only read")


def _reached(knot: JunctionNode) -> frozenset[JunctionNode]:
    """The junctions that transitions from one lead to."""
    seen: set[JunctionNode] = set()
    waiting = [knot]
    while waiting:
        for arrow in waiting.pop().arrows:
            if isinstance(arrow.target, JunctionNode) and arrow.target not in seen:
                seen.add(arrow.target)
                waiting.append(arrow.target)
    return frozenset(seen)
