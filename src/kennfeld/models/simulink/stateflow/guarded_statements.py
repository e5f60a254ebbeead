"""Functions of a chart, drawn as flow charts or written as code: each call has variables of its own.

The statements of a chart's code, each run under a guard; both sides of a decision are built, loops unrolled.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_script
from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.stateflow.chart_expressions import ChartExpressions
from kennfeld.models.simulink.stateflow.chart_model import ChartFunction
from kennfeld.models.simulink.stateflow.guarded_variables import ActionContext, Guard

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.chart_execution import ChartExecution

__all__ = ["ChartFunctionCalls", "GuardedStatements"]

Condition: TypeAlias = Callable[[ActionContext, Guard], int]  # the node of a condition, asked where a guard holds

_SHOWN = frozenset({"disp", "display", "printf", "fprintf", "sprintf", "warning", "error", "assert"})


class ChartFunctionCalls:
    """The functions of a machine's chart."""

    def __init__(self, machine: "ChartExecution") -> None:
        self.machine = machine
        self.diagram = machine.diagram
        self.variables = machine.variables
        self._frames = 0

    def call(
        self, function: ChartFunction, given: list[Nodes | None], context: ActionContext, guard: Guard
    ) -> tuple[list[Nodes], Guard | None]:
        """Run a function of the chart; what it gives, and the guard where it comes back."""
        if function.refused:
            raise UnsupportedError(f"{function.name} is {function.refused}, which is not supported", DEFAULT_REMEDY)
        if len(given) > len(function.parameters):
            raise UnsupportedError(f"{context.place}: {function.name} is given {len(given)} values")
        with self.machine.deeper(f"calls {function.name}"):
            frame, after = self._followed(function, given, context, guard)
        results = [f"{frame}.{name}" for name in function.results]
        missing = [name for name in results if name not in self.variables]
        if missing and after is not None:
            raise UnsupportedError(f"its function {function.name} gives {missing[0].split('.')[-1]} no value")
        return [self.variables.values[name] for name in results], after

    def _followed(
        self, function: ChartFunction, given: list[Nodes | None], context: ActionContext, guard: Guard
    ) -> tuple[str, Guard | None]:
        """Follow a function; the frame that its variables are in, and the guard where it comes back."""
        self._frames += 1
        frame = f"{function.name}#{self._frames}"
        here = replace(context, scope=function.state, frame=frame, place=f"its function {function.name}")
        here = replace(here, alive=lambda found: found)
        self._bind(function, frame, given)
        after = self._coded(function, here, guard) if function.script else self._drawn(function, here, guard)
        return frame, after

    def _bind(self, function: ChartFunction, frame: str, given: list[Nodes | None]) -> None:
        for name, nodes in zip(function.parameters, given, strict=False):
            if nodes is not None:
                self.variables.values[f"{frame}.{name}"] = nodes
        if function.script:
            return
        for data in self.diagram.data.values():
            mine = self.diagram.holder(data.written.parent) is function.state
            if mine and data.written.scope in ("FUNCTION_OUTPUT_DATA", "TEMPORARY_DATA"):
                start = self.variables.values[data.key]
                self.variables.values[f"{frame}.{data.written.name}"] = start

    def _drawn(self, function: ChartFunction, context: ActionContext, guard: Guard) -> Guard | None:
        self.machine.flow(function.state, context, guard)
        return guard

    def _coded(self, function: ChartFunction, context: ActionContext, guard: Guard) -> Guard | None:
        try:
            script = parse_script(function.script, function.name)
        except InputError as error:
            raise UnsupportedError(f"its function {function.name}: {error.findings[0].message}") from None
        found = next((one for one in script.functions if one.name == function.name), None)
        if found is None:
            raise UnsupportedError(f"the code of its function {function.name} defines no function of that name")
        for name, other in zip(found.parameters, function.parameters, strict=False):
            value = self.variables.values.get(f"{context.frame}.{other}")
            if value is not None:
                self.variables.values[f"{context.frame}.{name}"] = value
        after = self.machine.statements.function(found.body, context, guard)
        for name, other in zip(found.results, function.results, strict=False):
            value = self.variables.values.get(f"{context.frame}.{name}")
            if value is not None:
                self.variables.values[f"{context.frame}.{other}"] = value
        return after


@dataclass
class _Jumps:
    """Where statements have left a loop, gone to its next turn, or left the function."""

    found: dict[str, list[Guard | None]] = field(default_factory=lambda: {"break": [], "continue": []})


class GuardedStatements:
    """Runs statements for a machine."""

    def __init__(self, machine: "ChartExecution", values: ChartExpressions) -> None:
        self.machine = machine
        self.values = values
        self.logic = machine.logic
        self._loops: list[_Jumps] = []
        self._returns: list[list[Guard | None]] = []

    def run(self, body: tuple[m.Statement, ...], context: ActionContext, guard: Guard | None) -> Guard | None:
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

    def function(self, body: tuple[m.Statement, ...], context: ActionContext, guard: Guard) -> Guard | None:
        """Run the body of a function; the guard where it comes back."""
        self._returns.append([])
        loops, self._loops = self._loops, []
        end = self.run(body, context, guard)
        self._loops = loops
        return self.logic.either([end, *self._returns.pop()])

    def _statement(self, statement: m.Statement, context: ActionContext, guard: Guard) -> Guard | None:
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
        self, targets: tuple[m.Expression | None, ...], value: m.Expression, context: ActionContext, guard: Guard
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
        self, name: str, arguments: tuple[m.Expression, ...], wanted: int, context: ActionContext, guard: Guard
    ) -> tuple[list[Nodes], Guard | None]:
        """The results of a function of the chart or of MATLAB, and the guard where what called it goes on."""
        function = self.values.diagram.function(name, context.scope)
        if function is not None:
            given = self.values.given(arguments, context, guard)
            return self.machine.functions.call(function, given, context, guard)
        results = self.values.library(name, arguments, wanted, context, guard)
        if not results:
            message = (
                f"it takes several results of {name}, which is no function of the chart or of MATLAB that is known"
            )
            raise UnsupportedError(f"{context.place}: {message}")
        return results, guard

    def _store(self, target: m.Expression | None, new: Nodes, context: ActionContext, guard: Guard) -> None:
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

    def _evaluate(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Guard | None:
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
        message = name or (tree.name if isinstance(tree, m.Name) else "an expression")
        raise UnsupportedError(f"{context.place}: it runs {message}, which is no event or function of the chart")

    # decisions

    def _if(
        self,
        branches: tuple[m.Branch, ...],
        otherwise: tuple[m.Statement, ...],
        context: ActionContext,
        guard: Guard,
    ) -> Guard | None:
        made = [(partial(self.values.one, branch.condition), branch.body) for branch in branches]
        return self._decide(made, otherwise, context, guard)

    def _switch(
        self,
        subject: m.Expression,
        cases: tuple[m.Branch, ...],
        otherwise: tuple[m.Statement, ...],
        context: ActionContext,
        guard: Guard,
    ) -> Guard | None:
        chosen = self.values.nodes(subject, context, guard)
        made = [(partial(self._matches, chosen, case.condition), case.body) for case in cases]
        return self._decide(made, otherwise, context, guard)

    def _matches(self, subject: Nodes, case: m.Expression, context: ActionContext, guard: Guard) -> int:
        """Whether a case, or one of several in curly brackets, is that of a switch."""
        several = case.rows if isinstance(case, m.CellArray) else ((case,),)
        found = self.values.builder.const(0.0)
        for one in (one for row in several for one in row):
            value = self.values.nodes(one, context, guard)
            if subject.size != 1 or value.size != 1:
                raise UnsupportedError(f"{context.place}: switch decides on several elements")
            equal = self.values.builder.call("eq", int(subject.item()), int(value.item()))
            found = self.values.builder.call("or", found, equal)
        return found

    def _decide(
        self,
        ways: Sequence[tuple[Condition, tuple[m.Statement, ...]]],
        otherwise: tuple[m.Statement, ...],
        context: ActionContext,
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
        self, name: str, values: m.Expression, body: tuple[m.Statement, ...], context: ActionContext, guard: Guard
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
        self, condition: m.Expression, body: tuple[m.Statement, ...], context: ActionContext, guard: Guard
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
        self, body: tuple[m.Statement, ...], context: ActionContext, guard: Guard | None, jumps: _Jumps
    ) -> Guard | None:
        end = self.run(body, context, guard)
        gone, jumps.found["continue"] = jumps.found["continue"], []
        return self.logic.either([end, *gone])

    def _jump(self, kind: str, context: ActionContext, guard: Guard) -> None:
        if kind == "return" and self._returns:
            self._returns[-1].append(guard)
        elif self._loops and kind in self._loops[-1].found:
            self._loops[-1].found[kind].append(guard)
        else:
            raise UnsupportedError(f"{context.place}: {kind} stands outside of what it leaves")
