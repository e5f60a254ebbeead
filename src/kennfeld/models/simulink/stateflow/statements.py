"""The statements of a chart's code, each run under a guard; both sides of a decision are built, loops unrolled."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.expressions.signals import Nodes
from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.guards import Guard
from kennfeld.models.simulink.stateflow.values import Values
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.execution import Machine

__all__ = ["Statements"]

Condition: TypeAlias = Callable[[Context, Guard], int]  # the node of a condition, asked where a guard holds

_SHOWN = frozenset({"disp", "display", "printf", "fprintf", "sprintf", "warning", "error", "assert"})


@dataclass
class _Jumps:
    """Where statements have left a loop, gone to its next turn, or left the function."""

    found: dict[str, list[Guard | None]] = field(default_factory=lambda: {"break": [], "continue": []})


class Statements:
    """Runs statements for a machine."""

    def __init__(self, machine: "Machine", values: Values) -> None:
        self.machine = machine
        self.values = values
        self.logic = machine.logic
        self._loops: list[_Jumps] = []
        self._returns: list[list[Guard | None]] = []

    def run(self, body: tuple[m.Statement, ...], context: Context, guard: Guard | None) -> Guard | None:
        """Run statements; the guard where they come to their end, None where they never do."""
        for statement in body:
            if guard is None:
                return None
            self.machine.work()
            sent = self.machine.events.sent
            guard = self._statement(statement, context, guard)
            if guard is not None and self.machine.events.sent != sent:
                guard = context.alive(guard)
        return guard

    def function(self, body: tuple[m.Statement, ...], context: Context, guard: Guard) -> Guard | None:
        """Run the body of a function; the guard where it comes back."""
        self._returns.append([])
        loops, self._loops = self._loops, []
        end = self.run(body, context, guard)
        self._loops = loops
        return self.logic.either([end, *self._returns.pop()])

    def _statement(self, statement: m.Statement, context: Context, guard: Guard) -> Guard | None:
        match statement:
            case m.Assign(targets, value):
                return self._assign(targets, value, context, guard)
            case m.Evaluate(expression):
                return self._evaluate(expression, context, guard)
            case m.Command(name, ()):
                return self._evaluate(m.Name(name), context, guard)
            case m.If(branches, otherwise):
                return self._if(branches, otherwise, context, guard)
            case m.Switch(subject, cases, otherwise):
                return self._switch(subject, cases, otherwise, context, guard)
            case m.For(m.Name(name), values, body):
                return self._for(name, values, body, context, guard)
            case m.While(condition, body):
                return self._while(condition, body, context, guard)
            case m.Jump(kind):
                self._jump(kind, context, guard)
                return None
        kind = type(statement).__name__.lower()
        raise UnsupportedError(f"{context.place}: it has a statement that is not supported ({kind})")

    # assignments and calls

    def _assign(
        self, targets: tuple[m.Expression | None, ...], value: m.Expression, context: Context, guard: Guard
    ) -> Guard | None:
        if len(targets) == 1:
            self._store(targets[0], self.values.nodes(value, context, guard), context, guard)
            return guard
        name = value.of.name if isinstance(value, m.Call) and isinstance(value.of, m.Name) else ""
        if not isinstance(value, m.Call):
            raise UnsupportedError(f"{context.place}: it takes several results of what is no function")
        results, after = self._results(name, value.arguments, len(targets), context, guard)
        if len(results) < len(targets):
            raise UnsupportedError(f"{context.place}: it takes {len(targets)} results of {name}, which has fewer")
        for target, result in zip(targets, results, strict=False):
            self._store(target, result, context, guard)
        return after

    def _results(
        self, name: str, arguments: tuple[m.Expression, ...], wanted: int, context: Context, guard: Guard
    ) -> tuple[list[Nodes], Guard | None]:
        """The results of a function of the chart or of MATLAB, and the guard where what called it goes on."""
        function = self.values.diagram.function(name, context.scope)
        if function is not None:
            given = self.values.given(arguments, context, guard)
            return self.machine.functions.call(function, given, context, guard)
        results = self.values.library(name, arguments, wanted, context, guard)
        if not results:
            what = f"it takes several results of {name}, which is no function of the chart or of MATLAB that is known"
            raise UnsupportedError(f"{context.place}: {what}")
        return results, guard

    def _store(self, target: m.Expression | None, new: Nodes, context: Context, guard: Guard) -> None:
        if target is None:
            return
        base, indices = (target.of, target.arguments) if isinstance(target, m.Call) else (target, None)
        key = self.values.key_of(base, context)
        if key is None and context.frame and isinstance(base, m.Name) and indices is None:
            key = f"{context.frame}.{base.name}"
        if key is None:
            raise UnsupportedError(f"{context.place}: it assigns to what is no variable of the chart")
        self.machine.check_writable(key, context)
        old = self.values.variables.values.get(key)
        if indices is not None:
            self.values.elements.set(key, indices, new, context, guard)
        else:
            self.values.variables.set(key, new, guard)
        if old is not None:
            self.machine.events.written(key, old, guard)

    def _evaluate(self, tree: m.Expression, context: Context, guard: Guard) -> Guard | None:
        sent = self.values.event(tree, context)
        if sent is not None:
            self.machine.events.send(sent[0], sent[1], context, guard)
            return guard
        name = tree.of.name if isinstance(tree, m.Call) and isinstance(tree.of, m.Name) else ""
        function = self.values.diagram.function(name, context.scope)
        if function is not None and isinstance(tree, m.Call):
            given = self.values.given(tree.arguments, context, guard)
            return self.machine.functions.call(function, given, context, guard)[1]
        if name in _SHOWN:
            return guard
        what = name or (tree.name if isinstance(tree, m.Name) else "an expression")
        raise UnsupportedError(f"{context.place}: it runs {what}, which is no event or function of the chart")

    # decisions

    def _if(
        self,
        branches: tuple[m.Branch, ...],
        otherwise: tuple[m.Statement, ...],
        context: Context,
        guard: Guard,
    ) -> Guard | None:
        made = [(partial(self.values.one, branch.condition), branch.body) for branch in branches]
        return self._decide(made, otherwise, context, guard)

    def _switch(
        self,
        subject: m.Expression,
        cases: tuple[m.Branch, ...],
        otherwise: tuple[m.Statement, ...],
        context: Context,
        guard: Guard,
    ) -> Guard | None:
        chosen = self.values.nodes(subject, context, guard)
        made = [(partial(self._matches, chosen, case.condition), case.body) for case in cases]
        return self._decide(made, otherwise, context, guard)

    def _matches(self, subject: Nodes, case: m.Expression, context: Context, guard: Guard) -> int:
        """Whether a case, or one of several in curly brackets, is that of a switch."""
        several = case.rows if isinstance(case, m.CellArray) else ((case,),)
        found = self.values.loom.const(0.0)
        for one in (one for row in several for one in row):
            value = self.values.nodes(one, context, guard)
            if subject.size != 1 or value.size != 1:
                raise UnsupportedError(f"{context.place}: switch decides on several elements")
            equal = self.values.loom.call("eq", int(subject.item()), int(value.item()))
            found = self.values.loom.call("or", found, equal)
        return found

    def _decide(
        self,
        ways: Sequence[tuple[Condition, tuple[m.Statement, ...]]],
        otherwise: tuple[m.Statement, ...],
        context: Context,
        guard: Guard,
    ) -> Guard | None:
        """Run the first statements whose condition holds, else the others."""
        ends: list[tuple[Guard | None, Guard | None]] = []
        left: Guard | None = guard
        for condition, body in ways:
            if left is None:
                break
            holds = condition(context, left)
            begun = self.logic.where(left, holds)
            ends.append((begun, self.run(body, context, begun)))
            left = self.logic.where(left, holds, holds=False)
        ends.append((left, self.run(otherwise, context, left)))
        if all(begun is end for begun, end in ends):  # no side was left early
            return guard
        return self.logic.either([end for _, end in ends])

    # loops

    def _for(
        self, name: str, values: m.Expression, body: tuple[m.Statement, ...], context: Context, guard: Guard
    ) -> Guard | None:
        left: Guard | None = guard
        jumps = _Jumps()
        self._loops.append(jumps)
        for column in self.values.nodes(values, context, guard).T:
            if left is None:
                break
            self._store(m.Name(name), np.asarray(column).reshape(-1, 1), context, left)
            left = self._turn(body, context, left, jumps)
        self._loops.pop()
        return self.logic.either([left, *jumps.found["break"]])

    def _while(
        self, condition: m.Expression, body: tuple[m.Statement, ...], context: Context, guard: Guard
    ) -> Guard | None:
        left: Guard | None = guard
        jumps, over = _Jumps(), list[Guard | None]()
        self._loops.append(jumps)
        while left is not None:
            self.machine.work()
            holds = self.values.one(condition, context, left)
            over.append(self.logic.where(left, holds, holds=False))
            left = self._turn(body, context, self.logic.where(left, holds), jumps)
        self._loops.pop()
        return self.logic.either([*over, *jumps.found["break"]])

    def _turn(
        self, body: tuple[m.Statement, ...], context: Context, guard: Guard | None, jumps: _Jumps
    ) -> Guard | None:
        end = self.run(body, context, guard)
        gone, jumps.found["continue"] = jumps.found["continue"], []
        return self.logic.either([end, *gone])

    def _jump(self, kind: str, context: Context, guard: Guard) -> None:
        if kind == "return" and self._returns:
            self._returns[-1].append(guard)
        elif self._loops and kind in self._loops[-1].found:
            self._loops[-1].found[kind].append(guard)
        else:
            raise UnsupportedError(f"{context.place}: {kind} stands outside of what it leaves")
