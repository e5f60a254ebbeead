"""Statements and functions of the code of a chart, run under a guard.

Both sides of a decision are built, loops are unrolled, and each function call has its own variables.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.stateflow.chart_expressions import ChartExpressions
from kennfeld.importers.simulink.stateflow.chart_machine import ChartMachine, ChartPart
from kennfeld.importers.simulink.stateflow.chart_model import ChartFunction
from kennfeld.importers.simulink.stateflow.guarded_variables import ActionContext, Guard
from kennfeld.matlab.parser import parse_script
from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.program import tree as m

_Jumps: TypeAlias = dict[str, list[Guard | None]]  # the guards of `break` and `continue` in a loop
Condition: TypeAlias = Callable[[ActionContext, Guard], int]  # returns the node of a condition under a guard

_OUTPUT_FUNCTIONS = frozenset({"disp", "display", "printf", "fprintf", "sprintf", "warning", "error", "assert"})


class GuardedStatements(ChartPart):
    """Runs the statements of a chart."""

    def __init__(self, machine: ChartMachine, values: ChartExpressions) -> None:
        super().__init__(machine)
        self.values = values
        self._loops: list[_Jumps] = []
        self._returns: list[list[Guard | None]] = []

    def run(self, body: m.Statements, context: ActionContext, guard: Guard | None) -> Guard | None:
        """Run statements; return the guard at their end, None if they never reach it."""
        for statement in body:
            if guard is None:
                return None
            self.machine.work()
            sent = self.machine.events.sent
            guard = self._statement(statement, context, guard)
            # early return: an event may have left the state whose action this is, which then ends
            if guard is not None and self.machine.events.sent != sent:
                guard = context.alive(guard)
        return guard

    def function(self, body: m.Statements, context: ActionContext, guard: Guard) -> Guard | None:
        """Run the body of a function; return the guard after it."""
        self._returns.append([])
        # a break in a function ends none of the loops around its call
        loops, self._loops = self._loops, []
        end = self.run(body, context, guard)
        self._loops = loops
        return self.logic.any_of([end, *self._returns.pop()])

    def _statement(self, statement: m.Statement, context: ActionContext, guard: Guard) -> Guard | None:
        match statement:
            case m.Assign(targets, value):
                return self._assign(targets, value, context, guard)
            case m.Evaluate(expression):
                return self._evaluate(expression, context, guard)
            case m.Command(name, ()):
                return self._evaluate(m.Name(name), context, guard)
            case m.If(branches, otherwise):
                conditions = [(partial(self.values.scalar, branch.condition), branch.body) for branch in branches]
                return self._decide(conditions, otherwise, context, guard)
            case m.Switch(subject, cases, otherwise):
                chosen = self.values.nodes(subject, context, guard)
                conditions = [(partial(self._matches, chosen, case.condition), case.body) for case in cases]
                return self._decide(conditions, otherwise, context, guard)
            case m.For(m.Name(name), values, body):
                return self._for(name, values, body, context, guard)
            case m.While(condition, body):
                return self._while(condition, body, context, guard)
            case m.Jump(kind):
                self._jump(kind, context, guard)
                return None
        kind = type(statement).__name__.lower()
        raise UnsupportedError(f"{context.place}: unsupported statement ({kind})")

    # assignments and calls

    def _assign(
        self, targets: tuple[m.Expression | None, ...], value: m.Expression, context: ActionContext, guard: Guard
    ) -> Guard | None:
        if len(targets) == 1:
            self._store(targets[0], self.values.nodes(value, context, guard), context, guard)
            return guard
        name = value.of.name if isinstance(value, m.Call) and isinstance(value.of, m.Name) else ""
        if not isinstance(value, m.Call):
            raise UnsupportedError(f"{context.place}: several results require a function call")
        results, after = self._results(name, value.arguments, len(targets), context, guard)
        if len(results) < len(targets):
            raise UnsupportedError(f"{context.place}: {name} returns fewer than {len(targets)} results")
        for target, result in zip(targets, results, strict=False):
            self._store(target, result, context, guard)
        return after

    def _results(
        self, name: str, arguments: m.Expressions, wanted: int, context: ActionContext, guard: Guard
    ) -> tuple[list[Nodes], Guard | None]:
        """Return the results of a function of the chart or of MATLAB, and the guard after the call."""
        function = self.diagram.function(name, context.scope)
        if function is not None:
            values = self.values.evaluate_arguments(arguments, context, guard)
            return self.machine.functions.call(function, values, context, guard)
        results = self.values.call_library(name, arguments, wanted, context, guard)
        if not results:
            raise UnsupportedError(f"{context.place}: unknown function {name} with several results")
        return results, guard

    def _store(self, target: m.Expression | None, new: Nodes, context: ActionContext, guard: Guard) -> None:
        if target is None:
            return
        base, indices = (target.of, target.arguments) if isinstance(target, m.Call) else (target, None)
        key = self.values.resolve_key(base, context)
        # in a function, the first assignment to a name makes a variable of this call
        if key is None and context.frame and isinstance(base, m.Name) and indices is None:
            key = f"{context.frame}.{base.name}"
        if key is None:
            raise UnsupportedError(f"{context.place}: assignment to an unknown variable")
        data = next((variable for variable in self.diagram.data.values() if variable.key == key), None)
        if data is not None and data.written.scope in ("INPUT_DATA", "CONSTANT_DATA"):
            raise UnsupportedError(f"{context.place}: {key} is read-only")
        old = self.variables.values.get(key)
        if indices is not None:
            new = self.values.with_elements(key, indices, new, context, guard)
        self.variables.set(key, new, guard)
        if old is not None:
            self.machine.events.notify_change(key, old, guard)

    def _evaluate(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Guard | None:
        sent = self.values.event(tree, context)
        if sent is not None:
            self.machine.events.send(sent[0], sent[1], context, guard)
            return guard
        name = tree.of.name if isinstance(tree, m.Call) and isinstance(tree.of, m.Name) else ""
        function = self.diagram.function(name, context.scope)
        if function is not None and isinstance(tree, m.Call):
            values = self.values.evaluate_arguments(tree.arguments, context, guard)
            return self.machine.functions.call(function, values, context, guard)[1]
        if name in _OUTPUT_FUNCTIONS:
            return guard
        message = name or (tree.name if isinstance(tree, m.Name) else "an expression")
        raise UnsupportedError(f"{context.place}: {message} is not an event or a function of the chart")

    # decisions

    def _matches(self, subject: Nodes, case: m.Expression, context: ActionContext, guard: Guard) -> int:
        """Return the node that is 1 if a case, or one of several in braces, matches."""
        options = case.rows if isinstance(case, m.CellArray) else ((case,),)
        matches = self.builder.const(0.0)
        for option in (option for row in options for option in row):
            value = self.values.nodes(option, context, guard)
            if subject.size != 1 or value.size != 1:
                raise UnsupportedError(f"{context.place}: switch requires scalars")
            equal = self.builder.call("eq", int(subject.item()), int(value.item()))
            matches = self.builder.call("or", matches, equal)
        return matches

    def _decide(
        self,
        paths: Sequence[tuple[Condition, m.Statements]],
        otherwise: m.Statements,
        context: ActionContext,
        guard: Guard,
    ) -> Guard | None:
        """Run the statements of the first condition that holds, else the others."""
        ends: list[tuple[Guard | None, Guard | None]] = []
        remaining: Guard | None = guard
        for condition, body in paths:
            if remaining is None:
                break
            holds = condition(context, remaining)
            begun = self.logic.narrow(remaining, holds)
            ends.append((begun, self.run(body, context, begun)))
            remaining = self.logic.narrow(remaining, holds, holds=False)
        ends.append((remaining, self.run(otherwise, context, remaining)))
        if all(begun is end for begun, end in ends):  # no side was left early
            return guard
        return self.logic.any_of([end for _, end in ends])

    # loops

    def _for(
        self, name: str, values: m.Expression, body: m.Statements, context: ActionContext, guard: Guard
    ) -> Guard | None:
        remaining: Guard | None = guard
        jumps: _Jumps = {"break": [], "continue": []}
        self._loops.append(jumps)
        # a loop in MATLAB runs over the columns of its values
        for column in self.values.nodes(values, context, guard).T:
            if remaining is None:
                break
            self._store(m.Name(name), np.asarray(column).reshape(-1, 1), context, remaining)
            remaining = self._turn(body, context, remaining, jumps)
        self._loops.pop()
        return self.logic.any_of([remaining, *jumps["break"]])

    def _while(self, condition: m.Expression, body: m.Statements, context: ActionContext, guard: Guard) -> Guard | None:
        remaining: Guard | None = guard
        over: list[Guard | None] = []
        jumps: _Jumps = {"break": [], "continue": []}
        self._loops.append(jumps)
        # unrolled until the condition is known to fail; `work` stops loops whose end depends on signals
        while remaining is not None:
            self.machine.work()
            holds = self.values.scalar(condition, context, remaining)
            over.append(self.logic.narrow(remaining, holds, holds=False))
            remaining = self._turn(body, context, self.logic.narrow(remaining, holds), jumps)
        self._loops.pop()
        return self.logic.any_of([*over, *jumps["break"]])

    def _turn(self, body: m.Statements, context: ActionContext, guard: Guard | None, jumps: _Jumps) -> Guard | None:
        end = self.run(body, context, guard)
        continued, jumps["continue"] = jumps["continue"], []
        return self.logic.any_of([end, *continued])

    def _jump(self, kind: str, context: ActionContext, guard: Guard) -> None:
        if kind == "return" and self._returns:
            self._returns[-1].append(guard)
        elif self._loops and kind in self._loops[-1]:
            self._loops[-1][kind].append(guard)
        else:
            raise UnsupportedError(f"{context.place}: {kind} outside of a loop or function")


class ChartFunctionCalls(ChartPart):
    """Calls of the functions of a chart, drawn as flow charts or written as code."""

    def __init__(self, machine: ChartMachine) -> None:
        super().__init__(machine)
        self._frames = 0

    def call(
        self, function: ChartFunction, arguments: Sequence[Nodes | None], context: ActionContext, guard: Guard
    ) -> tuple[list[Nodes], Guard | None]:
        """Call a function of the chart; return its results, and the guard after it."""
        if function.refused:
            raise UnsupportedError(f"{function.name} is {function.refused}, which is not supported", DEFAULT_REMEDY)
        if len(arguments) > len(function.parameters):
            raise UnsupportedError(f"{context.place}: too many arguments of {function.name} ({len(arguments)})")
        with self.machine.nested(f"recursive call of {function.name}"):
            frame, after = self._run(function, arguments, context, guard)
        results = [f"{frame}.{name}" for name in function.results]
        missing = [name for name in results if name not in self.variables]
        # without a guard after it, no path returns from the call, and nothing reads the results
        if missing and after is not None:
            raise UnsupportedError(f"function {function.name} does not assign its output {missing[0].split('.')[-1]}")
        return [self.variables.values[name] for name in results], after

    def _run(
        self, function: ChartFunction, arguments: Sequence[Nodes | None], context: ActionContext, guard: Guard
    ) -> tuple[str, Guard | None]:
        """Run a function; return the frame of its variables, and the guard after it."""
        self._frames += 1
        frame = f"{function.name}#{self._frames}"
        here = ActionContext(function.state, context.owner, context.event, frame, place=f"function {function.name}")
        self._bind(function, frame, arguments)
        if function.script:
            return frame, self._run_code(function, here, guard)
        self.machine.transitions.run_flow_chart(function.state, here, guard)
        return frame, guard

    def _bind(self, function: ChartFunction, frame: str, arguments: Sequence[Nodes | None]) -> None:
        for name, nodes in zip(function.parameters, arguments, strict=False):
            if nodes is not None:
                self.variables.values[f"{frame}.{name}"] = nodes
        if function.script:
            return
        for data in self.diagram.data.values():
            is_local = self.diagram.holder(data.written.parent) is function.state
            if is_local and data.written.scope in ("FUNCTION_OUTPUT_DATA", "TEMPORARY_DATA"):
                self.variables.values[f"{frame}.{data.written.name}"] = self.variables.values[data.key]

    def _run_code(self, function: ChartFunction, context: ActionContext, guard: Guard) -> Guard | None:
        try:
            script = parse_script(function.script, function.name)
        except InputError as error:
            raise UnsupportedError(f"function {function.name}: {error.findings[0].message}") from None
        definition = next((candidate for candidate in script.functions if candidate.name == function.name), None)
        if definition is None:
            raise UnsupportedError(f"the code of function {function.name} defines no function of this name")
        # the code may name its arguments and results otherwise than the signature on the chart
        self._copy_variables(context.frame, function.parameters, definition.parameters)
        after = self.machine.statements.function(definition.body, context, guard)
        self._copy_variables(context.frame, definition.results, function.results)
        return after

    def _copy_variables(self, frame: str, names: Sequence[str], copies: Sequence[str]) -> None:
        for name, copy in zip(names, copies, strict=False):
            if (value := self.variables.values.get(f"{frame}.{name}")) is not None:
                self.variables.values[f"{frame}.{copy}"] = value
