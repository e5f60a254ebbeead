"""One step of a chart: states are executed, entered and exited, and transitions taken, each under a guard."""

from collections.abc import Callable, Mapping
from dataclasses import replace

from kennfeld.importers.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.stateflow.chart_expressions import ChartExpressions
from kennfeld.importers.simulink.stateflow.chart_machine import ChartMachine, ChartPart
from kennfeld.importers.simulink.stateflow.chart_model import ChartModel, StateAction, StateNode, TransitionEdge
from kennfeld.importers.simulink.stateflow.guarded_statements import ChartFunctionCalls, GuardedStatements
from kennfeld.importers.simulink.stateflow.guarded_variables import ActionContext, Guard
from kennfeld.importers.simulink.stateflow.temporal_logic import ChartTimers, TemporalLogic
from kennfeld.importers.simulink.stateflow.transition_search import (
    EventDispatch,
    Fired,
    JunctionSearch,
    committed_junctions,
)
from kennfeld.importers.simulink.variables.mask_scope import Scope
from kennfeld.models.imperative.node_arrays import Nodes

_MAX_SHARED_CHILDREN = 12  # beyond, each child is followed from a copy of the variables


class ChartExecution(ChartMachine):
    """Follows one step of a chart.

    `variables` hold the values at the beginning of the step and, after it, those at its end.
    """

    def __init__(
        self,
        diagram: ChartModel,
        timers: ChartTimers,
        expressions: ParameterExpressions,
        scope: Scope,
        values: Mapping[str, Nodes],
        sized: frozenset[str],
        clock: tuple[int, int],
    ) -> None:
        super().__init__(diagram, expressions.builder, values, sized, clock)
        self.timers = timers
        chart_expressions = ChartExpressions(self, expressions, scope)
        self.values = chart_expressions
        self.statements = GuardedStatements(self, chart_expressions)
        self.activity = StateExecution(self)
        self.transitions = TransitionExecution(self)
        self.events = EventDispatch(self)
        self.counting = TemporalLogic(self, timers)
        self.functions = ChartFunctionCalls(self)

    def wake(self, guard: Guard, event: str = "") -> None:
        """Execute the chart once."""
        root = self.diagram.root
        context = ActionContext(root, root, event, place="chart")
        # before the transitions and actions that query the counts
        self.counting.count(event, guard)
        active = self.variables.scalar("active", guard)
        first = self.logic.narrow(guard, active, holds=False)
        later = self.logic.narrow(guard, active)
        self.variables.put("active", self.builder.const(1.0), guard)
        # before actions of the step change a value
        self._watch(first, guard)
        if not root.children:
            self.transitions.run_flow_chart(root, context, guard)
            return
        if first is not None:
            self.activity.clear(root, first)
            self.activity.enter_children(root, context, first)
        if later is not None:
            self.counting.measure(context, later)
            self.activity.execute_children(root, context, later)

    def _watch(self, first: Guard | None, guard: Guard) -> None:
        """Store the values whose changes are queried; nothing has changed in the first step."""
        for key in self.timers.watched:
            value = self.variables.get(key, guard)
            self.variables.set(f"before {key}", self.variables.get(f"now {key}", guard), guard)
            self.variables.set(f"now {key}", value, guard)
            if first is not None:
                self.variables.set(f"before {key}", value, first)

    def begin(self, guard: Guard) -> None:
        """Enter the chart before the first step."""
        root = self.diagram.root
        context = ActionContext(root, root, place="chart")
        self.variables.put("active", self.builder.const(1.0), guard)
        if root.children:
            self.activity.clear(root, guard)
            self.activity.enter_children(root, context, guard)
        else:
            self.transitions.run_flow_chart(root, context, guard)


class StateExecution(ChartPart):
    """Execution, entry and exit of the states of a chart."""

    def active(self, state: StateNode, guard: Guard) -> int:
        """Return the node that is 1 if a state is active."""
        if state.parent is None:
            return self.builder.const(1.0)
        if state.parent.parallel:
            return self.variables.scalar(state.active_key, guard)
        child = self.variables.scalar(state.parent.child_key, guard)
        return self.builder.call("eq", child, self.builder.const(float(state.number)))

    def while_active(self, state: StateNode) -> Callable[[Guard], Guard | None]:
        """Return a function that narrows a guard to where a state is still active."""
        return lambda guard: self.logic.narrow(guard, self.active(state, guard))

    def execute(self, state: StateNode, context: ActionContext, guard: Guard) -> None:
        """Execute an active state: outer transitions, else during actions, inner transitions and children."""
        self.machine.work()
        here = replace(context, scope=state, owner=state, alive=self.while_active(state), frame="")
        remaining = self.machine.transitions.take(state, state.outer, here, guard)
        for action in state.actions:
            if remaining is not None and action.kind in ("during", "on"):
                remaining = self._during(action, state, here, remaining)
        if remaining is not None:
            remaining = self.machine.transitions.take(state, state.inner, here, remaining)
        if remaining is not None:
            self.execute_children(state, here, remaining)

    def _during(self, action: StateAction, state: StateNode, context: ActionContext, guard: Guard) -> Guard | None:
        context = context.at(f"state {state.path}")
        where = self.machine.events.match(action.event, context, guard) if action.kind == "on" else guard
        end = self.machine.statements.run(action.body, context, where)
        # where the event is another one, the state goes on without the action
        return guard if end is where else self.logic.any_of([self.logic.exclude(guard, where), end])

    def execute_children(self, state: StateNode, context: ActionContext, guard: Guard) -> None:
        """Execute the active children of a state."""
        if state.parallel:
            for child in state.children:
                # an event sent by a child before may have exited the state
                still = self.while_active(state)(guard)
                where = self.logic.narrow(still, self.active(child, still)) if still is not None else None
                if where is not None:
                    self.execute(child, context, where)
            return
        paths = self.each_child(state, guard)
        if len(paths) <= _MAX_SHARED_CHILDREN:
            for child, where in paths:
                self.execute(child, context, where)
            return
        # the children exclude each other: from a copy each, none reads through the selections that its siblings add
        before = self.variables.values
        after = []
        for child, where in paths:
            self.variables.values = dict(before)
            self.execute(child, context, where)
            after.append((where, self.variables.values))
        self.variables.values = self.variables.joined(before, after)

    def each_child(self, state: StateNode, guard: Guard) -> list[tuple[StateNode, Guard]]:
        """Return the children of a state that may be active, each with its guard."""
        if not state.children:
            return []
        now = self.variables.scalar(state.child_key, guard)
        children = []
        for child in state.children:
            equal = self.builder.call("eq", now, self.builder.const(float(child.number)))
            where = self.logic.narrow(guard, equal)
            if where is not None:
                children.append((child, where))
        return children

    def enter(self, path: list[StateNode], context: ActionContext, guard: Guard) -> None:
        """Enter the states on the path down to one, and the states entered with it."""
        state, rest = path[0], path[1:]
        self.machine.work()
        after = self._mark_entered(state, context, guard)
        if after is None:
            return
        if not rest:
            self.enter_children(state, context, after)
        elif state.parallel:
            for child in state.children:
                self.enter(rest if child is rest[0] else [child], context, after)
        else:
            self.enter(rest, context, after)

    def _mark_entered(self, state: StateNode, context: ActionContext, guard: Guard) -> Guard | None:
        """Mark a state as active and run its entry actions."""
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
        after = self._run_actions(state, "entry", context, guard)
        if after is None:
            return None
        self.machine.events.notify_state("entry", state, after)
        return self.while_active(state)(after)

    def clear(self, state: StateNode, guard: Guard) -> None:
        """Mark all children of a state as inactive, as they are at entry."""
        names = [child.active_key for child in state.children] if state.parallel else [state.child_key]
        for name in names if state.children else ():
            self.variables.put(name, self.builder.const(0.0), guard)

    def _run_actions(self, state: StateNode, kind: str, context: ActionContext, guard: Guard) -> Guard | None:
        here = replace(
            context, scope=state, owner=state, alive=self.while_active(state), place=f"state {state.path}", frame=""
        )
        remaining: Guard | None = guard
        for action in state.actions:
            if action.kind == kind:
                remaining = self.machine.statements.run(action.body, here, remaining)
        return remaining

    def enter_children(self, state: StateNode, context: ActionContext, guard: Guard) -> None:
        """Enter the children of a newly active state: by its history, else by default transitions."""
        if state.parallel:
            for child in state.children:
                self.enter([child], context, guard)
            return
        remaining: Guard | None = guard
        if state.history:
            last = self.variables.scalar(state.history_key, guard)
            for child in state.children:
                where = self.logic.narrow(guard, self.builder.call("eq", last, self.builder.const(float(child.number))))
                if where is not None:
                    self.enter([child], context, where)
            # 0: none was active yet
            remaining = self.logic.narrow(guard, self.builder.call("eq", last, self.builder.const(0.0)))
        if remaining is not None and state.defaults:
            here = replace(context, scope=state, owner=state, alive=self.while_active(state), frame="")
            self.machine.transitions.take(state, state.defaults, here, remaining)

    def leave_children(self, state: StateNode, context: ActionContext, guard: Guard) -> Guard | None:
        """Exit the active children of a state, the last of parallel ones first."""
        if not state.parallel:
            paths = [self._leave(child, context, where) for child, where in self.each_child(state, guard)]
            if None not in paths:
                return guard
            # an event sent by the children may have exited the state too
            return self.logic.narrow(guard, self.active(state, guard))
        remaining: Guard | None = guard
        for child in reversed(state.children):
            if remaining is None:
                return None
            where = self.logic.narrow(remaining, self.active(child, remaining))
            if where is not None:
                self._leave(child, context, where)
        return remaining

    def _leave(self, state: StateNode, context: ActionContext, guard: Guard) -> Guard | None:
        self.machine.work()
        assert state.parent is not None
        inner = self.leave_children(state, context, guard)
        after = self._run_actions(state, "exit", context, inner) if inner is not None else None
        if after is None:
            return None
        # a state is active until its exit actions have run
        name = state.active_key if state.parent.parallel else state.parent.child_key
        self.variables.put(name, self.builder.const(0.0), after)
        self.machine.events.notify_state("exit", state, after)
        return self.while_active(state.parent)(after)


class TransitionExecution(ChartPart):
    """The transitions between the states of a chart."""

    def __init__(self, machine: ChartMachine) -> None:
        super().__init__(machine)
        self._committed = committed_junctions(list(machine.diagram.junctions))

    def run_flow_chart(self, root: StateNode, context: ActionContext, guard: Guard) -> None:
        """Run the flow chart of a chart without states, or of a function."""
        search = JunctionSearch(self.machine, context, self._committed)
        search.run(root.defaults, guard)
        if search.fired:
            raise UnsupportedError(f"{context.place}: a flow chart leads into a state")

    def take(
        self, state: StateNode, transitions: list[TransitionEdge], context: ActionContext, guard: Guard
    ) -> Guard | None:
        """Take the first valid transition; return the guard where none is valid."""
        if not transitions:
            return guard
        search = JunctionSearch(self.machine, context, self._committed)
        remaining = search.run(transitions, guard)
        for fired in search.fired:
            self._fire(fired, state, context)
        return remaining

    def _fire(self, fired: Fired, source: StateNode, context: ActionContext) -> None:
        """Exit the states up to the one that contains the path, run the transition actions, enter the target."""
        top = min(fired.path.holders, key=lambda state: len(list(state.ancestors)))
        if top.parallel and top is not source:
            message = f"a transition from state {source.path} to {fired.target.path} crosses parallel states"
            raise UnsupportedError(message)
        guard = self.machine.activity.leave_children(top, context, fired.guard)
        childless = self._while_childless(top)
        for body, place in fired.path.actions:
            here = replace(context, owner=source, alive=childless, place=place)
            guard = self.machine.statements.run(body, here, guard)
        if guard is not None:
            self._enter_target(top, fired.target, context, guard)

    def _while_childless(self, top: StateNode) -> Callable[[Guard], Guard | None]:
        """Return a function that narrows a guard to where a state is active without an active child."""

        def narrowed(guard: Guard) -> Guard | None:
            active = self.logic.narrow(guard, self.machine.activity.active(top, guard))
            if active is None or top.parallel or not top.children:
                return active
            child = self.variables.scalar(top.child_key, active)
            return self.logic.narrow(active, self.builder.call("eq", child, self.builder.const(0.0)))

        return narrowed

    def _enter_target(self, top: StateNode, target: StateNode, context: ActionContext, guard: Guard) -> None:
        """Enter the states below `top` down to a target, and the states entered with it."""
        # a path that ends at the state around it, such as at its history junction
        if target is top:
            self.machine.activity.enter_children(top, context, guard)
            return
        path = [target]
        while path[0].parent is not None and path[0].parent is not top:
            path.insert(0, path[0].parent)
        if path[0].parent is None:
            raise UnsupportedError(f"a transition into state {target.path} is drawn in the wrong state")
        self.machine.activity.enter(path, context, guard)
