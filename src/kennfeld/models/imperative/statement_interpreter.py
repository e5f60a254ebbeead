"""Execution of MATLAB statements over variables that hold nodes; both sides of a decision are built.

After a decision each variable is selected by its condition. `break`, `continue` and `return` are conditions as well:
the statements after them are built as the other side of a decision.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from kennfeld.matlab.values import MatlabCell
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.control_flow import LoopUnroller
from kennfeld.models.imperative.element_access import assign_part
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import AbortedPathError, ProgramError, UndecidedSizeError
from kennfeld.models.imperative.expression_evaluator import ExpressionEvaluator, assign_masked, is_masked_assignment
from kennfeld.models.imperative.node_arrays import Nodes, reduce_nodes
from kennfeld.models.imperative.path_facts import known_truth, logical_not, logical_or
from kennfeld.models.imperative.path_state import CallFrame, PathState, merge_states
from kennfeld.program import tree as m
from kennfeld.program.traversal import access_chain, assigned_name, dotted_name

GLOBAL = "global"  # the function that shared variables are kept under
_SILENT = frozenset(
    {"disp", "fprintf", "warning", "assert", "printf", "display", "tic", "toc", "figure", "plot", "drawnow", "pause"}
    | {"narginchk", "nargoutchk", "validateattributes", "keyboard", "beep", "clc", "close", "clear", "format", "hold"}
)


_MAX_SPLITS = 1000  # of statements, by the sizes of their arrays


class StatementInterpreter:
    """SymbolicInterpreter of code along one path, with its variables.

    `run` follows statements, `value` evaluates an expression, `decide` builds both sides of a decision, `call` runs a
    function. All raise `ProgramError` for code that cannot be lowered.
    """

    def __init__(self, context: EvaluationContext, names: Mapping[str, s.SymbolicValue] | None = None) -> None:
        self.context, self.builder = context, context.builder
        self.state = PathState(dict(names or {}))
        self.frame = CallFrame(functions=context.functions)
        self.expressions = ExpressionEvaluator(self)
        self.loops = LoopUnroller(self)
        # called with each `if`, the state before it, and the number of isempty queries in its condition
        self.watch: Callable[[m.If, PathState, int], None] | None = None
        self.questions = 0  # isempty queries of persistent variables that have no value yet
        self.splits = 0  # statements followed for several sizes of an array

    @property
    def names(self) -> dict[str, s.SymbolicValue]:
        """The variables."""
        return self.state.names

    # statements

    def run(self, statements: Sequence[m.Statement]) -> None:
        """Follow statements, up to a certain jump."""
        for at, statement in enumerate(statements, 1):
            self.context.step()
            try:
                self._for_each_size(statement)
            except UndecidedSizeError as error:
                error.line = error.line or statement.place.line
                raise
            except ProgramError as error:
                raise error if error.line else ProgramError(error.message, error.remedy, statement.place.line) from None
            going = self.going()
            if going is not None:
                self.decide(going, partial(self._go_on, statements[at:]))
                return

    def _for_each_size(self, statement: m.Statement) -> None:
        """Follow a statement, for each case if the size of an array that it reads depends on a condition."""
        if not self.state.varies:
            self._statement(statement)
            return
        before, frame, depth, ends = (
            self.state.copy(),
            self.frame,
            len(self.context.running),
            len(self.expressions.ends),
        )
        try:
            self._statement(statement)
        except UndecidedSizeError as error:
            self.splits += 1
            if self.splits > _MAX_SPLITS:
                raise
            # what the statement did before it met the array does not count
            self.state, self.frame = before, frame
            del self.context.running[depth:], self.expressions.ends[ends:]
            again = partial(self._for_each_size, statement)
            self.decide(error.condition, again, again)

    def going(self) -> int | None:
        """Return the condition that no jump was executed; None if certainly none was."""
        met = self.builder.const(0.0)
        for node in self.state.jumps.values():
            met = logical_or(self.builder, met, node)
        return None if known_truth(self.builder, self.state.facts, met) is False else logical_not(self.builder, met)

    def _go_on(self, rest: Sequence[m.Statement]) -> None:
        self.state.jumps.clear()
        self.run(rest)

    def _statement(self, statement: m.Statement) -> None:
        match statement:
            case m.Assign((target,), value):
                self._assign(target, value)
            case m.Assign(targets, value):
                self._assign_several(targets, value)
            case m.If(branches, otherwise):
                self._if(statement, branches, otherwise)
            case m.For(target, values, body):
                self.loops.over(target, values, body)
            case m.While(condition, body):
                self.loops.as_long_as(condition, body, statement.place.line)
            case m.Switch(subject, cases, otherwise):
                self._switch(s.force(self.value(subject)), cases, otherwise)
            case m.Jump(kind):
                self.state.jumps[kind] = self.builder.const(1.0)
            case m.Declaration(kind, names):
                self._declare(kind, names)
            case m.Evaluate(expression):
                self._evaluate(expression)
            case m.Command("error", _):
                raise AbortedPathError
            case m.Command(name, _) if name in _SILENT or name.startswith("coder."):
                return
            case _:
                raise ProgramError(f"a statement that is not supported ({type(statement).__name__.lower()})")

    def _evaluate(self, expression: m.Expression) -> None:
        """Evaluate an expression statement for its effects; output functions are ignored."""
        name = _called_name(expression)
        if name == "error":
            raise AbortedPathError
        if name in _SILENT or name.startswith("coder."):
            return
        if isinstance(expression, m.Call) and isinstance(expression.of, m.Name):
            self.expressions.call(expression.of.name, expression.arguments, 0)
        elif isinstance(expression, m.Name) and expression.name not in self.names:
            self.expressions.call(expression.name, (), 0)
        else:
            self.value(expression)

    def _declare(self, kind: str, names: Sequence[str]) -> None:
        for name in names:
            if kind != "global":
                self.frame.persistent.append(name)
                unset = s.ConditionalValue(s.EMPTY, self.builder.const(0.0))
                self.names[name] = self.state.kept.get((self.frame.name, name), unset)
            elif (GLOBAL, name) not in self.state.kept:
                raise ProgramError(f"global {name}: the block has no data store of this name", "Make it an input.")
            else:
                self.frame.shared.append(name)
                self.names[name] = self.state.kept[GLOBAL, name]

    # values

    def value(self, tree: m.Expression) -> s.SymbolicValue:
        """Evaluate an expression."""
        return self.expressions.value(tree)

    def nodes(self, tree: m.Expression, message: str = "it") -> Nodes:
        """Evaluate an expression to an array of nodes."""
        return s.as_array(self.value(tree), message)

    def read(self, name: str) -> s.SymbolicValue:
        """Return the value of a variable; raises `ProgramError` if it may have none."""
        value = self.names[name]
        if isinstance(value, s.DeferredValue):
            value = self.names[name] = s.force(value)
        if isinstance(value, s.ConditionalValue):
            if not known_truth(self.builder, self.state.facts, value.defined):
                raise ProgramError(f"{name} is not assigned in every case", f"Assign {name} before the decision.")
            value = value.value
            return self.of_one_size(value) if isinstance(value, s.VaryingArray) else value
        if isinstance(value, s.VaryingArray):
            value = self.of_one_size(value)
        if isinstance(value, s.InvalidValue):
            raise ProgramError(value.why, value.remedy)
        return self._simpler(value) if isinstance(value, np.ndarray) else value

    def _simpler(self, nodes: Nodes) -> s.SymbolicValue:
        """Return nodes without the decisions that are known on this path."""
        if not self.state.facts or nodes.size > 100:
            return nodes
        result = nodes.copy()
        for place, first in np.ndenumerate(nodes):
            node = int(first)
            while self.builder.nodes[node].op == "select":
                choice, yes, no = self.builder.nodes[node].args
                truth = known_truth(self.builder, self.state.facts, choice)
                if truth is None:
                    break
                node = yes if truth else no
            result[place] = node
        return result

    def of_one_size(self, value: s.VaryingArray) -> Nodes:
        """Return the array of the size that holds on this path; raises `UndecidedSizeError` if several may."""
        open_options = []
        for condition, nodes in value.options:
            truth = known_truth(self.builder, self.state.facts, condition)
            if truth:
                return nodes
            if truth is None:
                open_options.append((condition, nodes))
        if not open_options:
            raise AbortedPathError
        if len(open_options) > 1:
            raise UndecidedSizeError(value.why, value.remedy, open_options[0][0])
        return open_options[0][1]

    def truth(self, value: s.SymbolicValue) -> int:
        """Return the condition of a value: all elements are non-zero, and there are any."""
        if isinstance(value, s.FoundIndex):
            return self.builder.call("eq", value.item(), value.item())
        return reduce_nodes(self.builder, "and", s.as_array(s.force(value), "a condition").ravel())

    def fail_where(self, condition: int) -> None:
        """Note that the code fails where a condition holds; its further values do not count there."""
        if known_truth(self.builder, self.state.facts, condition) is not False:
            self.state.failures[condition] = None

    def within(self, names: Mapping[str, s.SymbolicValue], make: Callable[[], s.SymbolicValue]) -> s.SymbolicValue:
        """Call `make` with other variables."""
        self._keep_shared()
        outer, around = self.state, self.frame
        self.state, self.frame = outer.within(dict(names)), replace(around, shared=[])
        result = make()
        self.state, self.frame = outer.after(self.state), around
        return result

    # assignments

    def assign(self, target: m.Expression | None, value: s.SymbolicValue) -> None:
        """Assign a value to a variable or to a part of one."""
        if isinstance(target, m.Name):
            self.names[target.name] = value
        elif target is not None:
            name = assigned_name(target)
            if not name:
                raise ProgramError("the target of an assignment is not a variable")
            old = self.names.get(name)
            whole = self.read(name) if old is not None and not self._undefined(old) else None
            self.names[name] = assign_part(self.expressions, whole, access_chain(target)[1], s.force(value))

    def _assign(self, target: m.Expression | None, tree: m.Expression) -> None:
        if target is not None and is_masked_assignment(self.expressions, target, tree):
            assert isinstance(target, m.Call)
            self.names[assigned_name(target)] = assign_masked(self.expressions, target, tree)
        else:
            self.assign(target, self.value(tree))

    def _undefined(self, value: s.SymbolicValue) -> bool:
        return isinstance(value, s.ConditionalValue) and not known_truth(self.builder, self.state.facts, value.defined)

    def _assign_several(self, targets: Sequence[m.Expression | None], value: m.Expression) -> None:
        name = _called_name(value)
        arguments = value.arguments if isinstance(value, m.Call) else ()
        if not name or name in self.names:
            raise ProgramError("several results are assigned from a value that is not a function call")
        results = self.expressions.call(name, arguments, len(targets))
        if len(results) < len(targets):
            raise ProgramError(f"{name} returns {len(results)} results, but {len(targets)} are assigned")
        for target, result in zip(targets, results, strict=False):
            self.assign(target, result)

    # decisions

    def decide(self, condition: int, yes: Callable[[], None], no: Callable[[], None] = lambda: None) -> None:
        """Build both sides of a decision, or only the one that is known to be taken."""
        fixed = known_truth(self.builder, self.state.facts, condition)
        if fixed is not None:
            (yes if fixed else no)()
            return
        before = self.state
        item, other = (self._side(condition, holds, side) for holds, side in ((True, yes), (False, no)))
        if item is None and other is None:
            raise AbortedPathError
        if item is None or other is None:
            self.state = item or other or before
        else:
            self.state = merge_states(self.builder, condition, item, other, before)

    def _side(self, condition: int, holds: bool, make: Callable[[], None]) -> PathState | None:
        """Return the state after one side of a decision; None if it ends in an error."""
        before, frame, depth, ends = self.state, self.frame, len(self.context.running), len(self.expressions.ends)
        self.state = before.under(self.builder, condition, holds)
        try:
            make()
            result = self.state
        except AbortedPathError:
            result = None
            del self.context.running[depth:], self.expressions.ends[ends:]
            self.frame = frame
        self.state = before
        return result

    def _if(self, whole: m.If, branches: Sequence[m.Branch], otherwise: Sequence[m.Statement]) -> None:
        first, rest, before = branches[0], branches[1:], self.state
        if self.watch is not None:
            before = replace(before, names=dict(before.names), kept=dict(before.kept))
        asked = self.questions
        condition = self.truth(self.value(first.condition))
        asked = self.questions - asked
        no = (lambda: self._if(whole, rest, otherwise)) if rest else (lambda: self.run(otherwise))
        self.decide(condition, lambda: self.run(first.body), no)
        if self.watch is not None:
            self.watch(whole, before, asked)

    def _switch(self, subject: s.SymbolicValue, cases: Sequence[m.Branch], otherwise: Sequence[m.Statement]) -> None:
        if not cases:
            self.run(otherwise)
            return
        condition = self._matches(subject, self.value(cases[0].condition))
        rest = cases[1:]
        self.decide(condition, lambda: self.run(cases[0].body), lambda: self._switch(subject, rest, otherwise))

    def _matches(self, subject: s.SymbolicValue, case: s.SymbolicValue) -> int:
        """Return the condition that a case matches the subject of a switch."""
        if isinstance(case, MatlabCell):
            result = self.builder.const(0.0)
            for cell in case.contents:
                result = logical_or(self.builder, result, self._matches(subject, cell))
            return result
        if isinstance(subject, str) or isinstance(case, str):
            return self.builder.const(float(subject == case if isinstance(subject, type(case)) else 0.0))
        left, right = s.as_array(subject, "the subject of switch"), s.as_array(case, "a case")
        if left.size != 1 or right.size > 1:
            raise ProgramError("the subject of switch must be a scalar")
        return self.builder.call("eq", int(left.item()), int(right.item())) if right.size else self.builder.const(0.0)

    # functions

    def call(
        self, function: m.FunctionDefinition, arguments: Sequence[s.SymbolicValue], wanted: int = 1, frame: str = ""
    ) -> tuple[s.SymbolicValue, ...]:
        """Run a function with its own variables and return its results, without those that have no value."""
        name = frame or f"{function.name} {id(function)}"
        if any(function is item for item in self.context.running):
            raise ProgramError(f"{function.name} calls itself, which is not supported", "Write it as a loop.")
        if len(arguments) > len(function.parameters) and "varargin" not in function.parameters[-1:]:
            raise ProgramError(f"{function.name} takes {len(function.parameters)} arguments, got {len(arguments)}")
        self._keep_shared()
        outer, around = self.state, self.frame
        self.frame = CallFrame(name, len(arguments), wanted, [], self.context.functions_near(function))
        self.state = outer.within(_bind_arguments(function, arguments))
        results = self._followed(function, wanted)
        self.state, self.frame = outer.after(self.state), around
        for name in self.frame.shared:
            self.names[name] = self.state.kept[GLOBAL, name]
        return results

    def _followed(self, function: m.FunctionDefinition, wanted: int) -> tuple[s.SymbolicValue, ...]:
        """Run a function whose frame and variables are already set up, and return its results."""
        self.context.running.append(function)
        self.run(function.body)
        self.context.running.pop()
        for name in self.frame.persistent:
            self.state.kept[self.frame.name, name] = self.names[name]
        self._keep_shared()
        return tuple(self._results(function, wanted))

    def _keep_shared(self) -> None:
        for name in self.frame.shared:
            self.state.kept[GLOBAL, name] = self.names[name]

    def _results(self, function: m.FunctionDefinition, wanted: int) -> Iterator[s.SymbolicValue]:
        for name in function.results[: max(wanted, 1)]:
            if name not in self.names:
                yield s.InvalidValue(f"{function.name} does not assign {name}", f"Assign {name} in every case.")
            elif self._undefined(self.names[name]):
                yield s.InvalidValue(f"{function.name} does not assign {name} in every case", f"Assign {name} first.")
            else:
                value = self.names[name]
                yield value if isinstance(value, s.InvalidValue) else self.read(name)


def _bind_arguments(function: m.FunctionDefinition, arguments: Sequence[s.SymbolicValue]) -> dict[str, s.SymbolicValue]:
    names = list(function.parameters)
    if names[-1:] == ["varargin"]:
        fixed = len(names) - 1
        rest = arguments[fixed:]
        return {**dict(zip(names, arguments[:fixed], strict=False)), "varargin": MatlabCell.of(rest, (1, len(rest)))}
    return dict(zip(names, arguments, strict=False))


def _called_name(tree: m.Expression) -> str:
    """Return the name of the function that an expression calls, with its dots; empty if it is not a name."""
    return dotted_name(tree.of if isinstance(tree, m.Call) else tree)
