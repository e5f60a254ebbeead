"""Transitions that are taken: which one leads on, what it leaves, the actions on its way, and what it enters."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.diagram import Arrow, State
from kennfeld.models.simulink.stateflow.flows import Fired, Search
from kennfeld.models.simulink.stateflow.guards import Guard
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.execution import Machine

__all__ = ["Transitions"]


class Transitions:
    """The transitions between the states of a machine."""

    def __init__(self, machine: "Machine") -> None:
        self.machine = machine
        self.logic = machine.logic
        self.loom = machine.loom
        self.variables = machine.variables

    def take(self, state: State, arrows: list[Arrow], context: Context, guard: Guard) -> Guard | None:
        """Take the first transition that can be; the guard where none is."""
        if not arrows:
            return guard
        search = Search(self.machine, context)
        left = search.run(arrows, guard)
        for one in search.fired:
            self._fire(one, state, context)
        return left

    def _fire(self, fired: Fired, source: State, context: Context) -> None:
        """Leave the states up to the one that the way is drawn in, run the transition's actions, and enter others."""
        top = _outermost(fired.way.holders)
        if top.parallel and top is not source:
            what = f"a transition from its state {source.path} to {fired.target.path} crosses parallel states"
            raise UnsupportedError(what)
        guard = self.machine.activity.leave_children(top, context, fired.guard)
        quiet = self._calm(top)
        for body, place in fired.way.actions:
            here = replace(context, owner=source, alive=quiet, place=place)
            guard = self.machine.statements.run(body, here, guard)
        if guard is not None:
            self._enter_way(top, fired.target, context, guard)

    def _calm(self, top: State) -> Callable[[Guard], Guard | None]:
        """Gives the guard where a state is active without an active child, so that a transition in it may go on."""

        def calm(guard: Guard) -> Guard | None:
            found = self.logic.where(guard, self.machine.activity.active(top, guard))
            if found is None or top.parallel or not top.children:
                return found
            child = self.variables.one(top.child_key, found)
            return self.logic.where(found, self.loom.call("eq", child, self.loom.const(0.0)))

        return calm

    def _enter_way(self, top: State, target: State, context: Context, guard: Guard) -> None:
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


def _outermost(holders: frozenset[State]) -> State:
    return min(holders, key=lambda state: len(list(state.around)))
