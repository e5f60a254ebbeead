"""Which states of a chart are active, and how they are executed, entered and left, each under a guard."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.diagram import Action, State
from kennfeld.models.simulink.stateflow.guards import Guard

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.execution import Machine

__all__ = ["Activity"]

_FEW = 12  # children; what many of them do is followed apart, so that one does not burden the next


class Activity:
    """The states of a machine."""

    def __init__(self, machine: "Machine") -> None:
        self.machine = machine
        self.logic = machine.logic
        self.loom = machine.loom
        self.variables = machine.variables

    def active(self, state: State, guard: Guard) -> int:
        """The node that says whether a state is active."""
        if state.parent is None:
            return self.loom.const(1.0)
        if state.parent.parallel:
            return self.variables.one(state.active_key, guard)
        child = self.variables.one(state.parent.child_key, guard)
        return self.loom.call("eq", child, self.loom.const(float(state.number)))

    def still(self, state: State) -> Callable[[Guard], Guard | None]:
        """Gives the guard where a state is still active."""
        return lambda guard: self.logic.where(guard, self.active(state, guard))

    def execute(self, state: State, context: Context, guard: Guard) -> None:
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

    def _during(self, action: Action, state: State, context: Context, guard: Guard) -> Guard | None:
        context = context.at(f"its state {state.path}")
        where = self.machine.events.happens(action.event, context, guard) if action.kind == "on" else guard
        end = self.machine.statements.run(action.body, context, where)
        return guard if end is where else self.logic.either([self.logic.besides(guard, where), end])

    def children(self, state: State, context: Context, guard: Guard) -> None:
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

    def each_child(self, state: State, guard: Guard) -> list[tuple[State, Guard]]:
        """The children of a state that may be active now, each with the guard where it is."""
        if not state.children:
            return []
        now = self.variables.one(state.child_key, guard)
        found = []
        for child in state.children:
            equal = self.loom.call("eq", now, self.loom.const(float(child.number)))
            where = self.logic.where(guard, equal)
            if where is not None:
                found.append((child, where))
        return found

    def enter(self, way: list[State], context: Context, guard: Guard) -> None:
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

    def _entered(self, state: State, context: Context, guard: Guard) -> Guard | None:
        """Mark a state as active, and run its entry actions."""
        assert state.parent is not None
        if state.parent.parallel:
            self.variables.put(state.active_key, self.loom.const(1.0), guard)
        else:
            number = self.loom.const(float(state.number))
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

    def clear(self, state: State, guard: Guard) -> None:
        """Note that no child of a state is active, which holds whenever it is entered."""
        names = [one.active_key for one in state.children] if state.parallel else [state.child_key]
        for name in names if state.children else ():
            self.variables.put(name, self.loom.const(0.0), guard)

    def _acted(self, state: State, kind: str, context: Context, guard: Guard) -> Guard | None:
        here = replace(
            context, scope=state, owner=state, alive=self.still(state), place=f"its state {state.path}", frame=""
        )
        found: Guard | None = guard
        for action in state.actions:
            if action.kind == kind:
                found = self.machine.statements.run(action.body, here, found)
        return found

    def enter_children(self, state: State, context: Context, guard: Guard) -> None:
        """Enter what goes with a state that has just become active: by its history, else by its default transitions."""
        if state.parallel:
            for child in state.children:
                self.enter([child], context, guard)
            return
        left: Guard | None = guard
        if state.history:
            last = self.variables.one(state.history_key, guard)
            for child in state.children:
                where = self.logic.where(guard, self.loom.call("eq", last, self.loom.const(float(child.number))))
                if where is not None:
                    self.enter([child], context, where)
            left = self.logic.where(guard, self.loom.call("eq", last, self.loom.const(0.0)))
        if left is not None and state.defaults:
            here = replace(context, scope=state, owner=state, alive=self.still(state), frame="")
            self.machine.transitions.take(state, state.defaults, here, left)

    def leave_children(self, state: State, context: Context, guard: Guard) -> Guard | None:
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

    def _after(self, state: State, guard: Guard, ways: list[Guard | None]) -> Guard | None:
        """The guard after the children have been left, unless an event that one of them has sent left the state too."""
        return guard if None not in ways else self.logic.where(guard, self.active(state, guard))

    def _leave(self, state: State, context: Context, guard: Guard) -> Guard | None:
        self.machine.work()
        assert state.parent is not None
        inner = self.leave_children(state, context, guard)
        after = self._acted(state, "exit", context, inner) if inner is not None else None
        if after is None:
            return None
        name = state.active_key if state.parent.parallel else state.parent.child_key
        self.variables.put(name, self.loom.const(0.0), after)
        self.machine.events.tell("exit", state, after)
        return self.still(state.parent)(after)
