"""Expressions of the code of a chart, evaluated under a guard.

Operands that only charts have, such as variables, elements of arrays and temporal operators, are evaluated first and
replaced by names for their nodes; the remaining expression is evaluated like a block field.

A variable index selects between all elements. Reading beyond the array, where a chart would stop, gives NaN; writing
beyond it has no effect.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.expressions.parameter_expressions import FIELD_FUNCTIONS, ParameterExpressions
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.stateflow.chart_machine import ChartMachine, ChartPart
from kennfeld.importers.simulink.stateflow.chart_model import ChartEvent, StateNode
from kennfeld.importers.simulink.stateflow.guarded_variables import ActionContext, Guard
from kennfeld.importers.simulink.stateflow.temporal_logic import CHANGES, TEMPORAL
from kennfeld.importers.simulink.variables.enumerations import unqualified_member
from kennfeld.importers.simulink.variables.mask_scope import Scope
from kennfeld.models.imperative.element_access import assign_part
from kennfeld.models.imperative.evaluation_context import LibraryFunction
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.expression_evaluator import ExpressionEvaluator
from kennfeld.models.imperative.integer_types import IntegerType
from kennfeld.models.imperative.library import C_FUNCTIONS, SYMBOLIC_FUNCTIONS
from kennfeld.models.imperative.library.function_registry import matlab_word
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, reduce_nodes
from kennfeld.models.imperative.symbolic_values import as_array, force, integers
from kennfeld.program import tree as m
from kennfeld.program.traversal import expressions_in, field_path, map_children

_BIT_OPERATORS: Final = ("bitand", "bitor", "bitxor", "bitshift", "bitsra", "bitcmp")
_LIBRARIES: Final[Mapping[str, Mapping[str, LibraryFunction]]] = {
    # charts with C have the functions of block fields and the operators on bits, not the functions of MATLAB on arrays
    "C": {**FIELD_FUNCTIONS, **{name: SYMBOLIC_FUNCTIONS[name] for name in ("cast", "isnan", *_BIT_OPERATORS)}},
    "MATLAB": {**SYMBOLIC_FUNCTIONS, **C_FUNCTIONS},
}


@contextmanager
def _reporting(context: ActionContext) -> Iterator[None]:
    """Report an expression that has no value with its place in the chart."""
    try:
        yield
    except EvaluationError as error:
        raise UnsupportedError(f"{context.place}: {error}", "", error.undefined) from None
    except ProgramError as error:
        raise UnsupportedError(f"{context.place}: {error.message}", error.remedy) from None
    except InputError as error:
        raise UnsupportedError(f"{context.place}: {error.findings[0]}") from None


class ChartExpressions(ChartPart):
    """Evaluates the expressions of a chart."""

    def __init__(self, machine: ChartMachine, expressions: ParameterExpressions, scope: Scope) -> None:
        super().__init__(machine)
        self.expressions, self.scope = expressions, scope

    def nodes(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes:
        """Return the nodes of an expression, Int[rows, columns]."""
        substitutes: dict[str, Nodes] = {}
        plain = self._substitute(tree, context, guard, substitutes)
        with _reporting(context):
            return self.logic.simplify_all(self._evaluator(substitutes).nodes(plain), guard)

    def call_library(
        self, name: str, arguments: m.Expressions, wanted: int, context: ActionContext, guard: Guard
    ) -> list[Nodes]:
        """Return up to `wanted` results of a MATLAB function; none in a chart with C as action language."""
        if self.diagram.chart.language == "C" or name not in SYMBOLIC_FUNCTIONS:
            return []
        substitutes: dict[str, Nodes] = {}
        plain = [self._substitute(tree, context, guard, substitutes) for tree in arguments]
        with _reporting(context):
            results = self._evaluator(substitutes).call(name, plain, wanted)
            return [np.asarray(as_array(force(result), f"a result of {name}"), dtype=np.int64) for result in results]

    def element(self, key: str, indices: m.Expressions, context: ActionContext, guard: Guard) -> Nodes:
        """Return elements of a variable."""
        names, plain = self._indices(key, indices, context, guard)
        with _reporting(context):
            return self._evaluator(names).nodes(m.Call(m.Name(key), plain))

    def with_elements(
        self, key: str, indices: m.Expressions, new: Nodes, context: ActionContext, guard: Guard
    ) -> Nodes:
        """Return a variable after an assignment to elements of it."""
        names, plain = self._indices(key, indices, context, guard)
        with _reporting(context):
            changed = as_array(assign_part(self._evaluator(names), names[key], [m.Call(m.Name(key), plain)], new))
        # MATLAB would extend the array; the data of a chart have a fixed size
        if changed.shape != names[key].shape:
            raise UnsupportedError(f"{context.place}: assignment out of range of {key}")
        return np.asarray(changed)

    def _indices(
        self, key: str, indices: m.Expressions, context: ActionContext, guard: Guard
    ) -> tuple[dict[str, Nodes], m.Expressions]:
        """Return the names of a variable and of the operands of its indices, which C rounds down."""
        names = {key: integers(self.variables.get(key, guard), self._declared_type(key))}
        plain = [self._substitute(index, context, guard, names) for index in indices]
        if self.diagram.language.name == "C":
            plain = [m.Call(m.Name("floor"), (index,)) for index in plain]
        return names, tuple(plain)

    def _evaluator(self, names: Mapping[str, Nodes]) -> ExpressionEvaluator:
        """Return an evaluator of expressions over names with given nodes."""
        library = _LIBRARIES[self.diagram.chart.language]

        def refuse(name: str) -> EvaluationError:
            return EvaluationError(f"the function {name} is not supported for signals")

        return self.expressions.interpreter(self.scope, True, names, library, refuse, False).expressions

    def scalar(self, tree: m.Expression, context: ActionContext, guard: Guard) -> int:
        """Return the node of a scalar expression; an array is true if all its elements are."""
        nodes = self.nodes(tree, context, guard)
        if nodes.size == 0:
            raise UnsupportedError(f"{context.place}: the condition is empty")
        return reduce_nodes(self.builder, "and", nodes.ravel())

    def evaluate_arguments(self, arguments: m.Expressions, context: ActionContext, guard: Guard) -> list[Nodes | None]:
        """Return the values of arguments; None for text, which can only be displayed."""
        return [None if isinstance(tree, m.Text) else self.nodes(tree, context, guard) for tree in arguments]

    def key(self, name: str, context: ActionContext) -> str | None:
        """Return the key of the variable of a name; None if there is none."""
        # locals of a function hide data of the chart
        if context.frame and (local := f"{context.frame}.{name}") in self.variables:
            return local
        data = self.diagram.datum(name, context.scope)
        # a parameter is no variable: block fields find it in the workspace or mask
        if data is None or data.written.scope == "PARAMETER_DATA":
            return None
        return data.key if data.key in self.variables else None

    def resolve_key(self, tree: m.Expression, context: ActionContext) -> str | None:
        """Return the key of the variable of a name or of a path through states."""
        if isinstance(tree, m.Name):
            return self.key(tree.name, context)
        path = field_path(tree) if isinstance(tree, m.Field) else None
        state = self.diagram.state(path[:-1], context.scope) if path else None
        if path is None or state is None:
            return None
        data = self.diagram.data.get((state.id, path[-1]))
        return data.key if data is not None and data.key in self.variables else None

    def _substitute(
        self, tree: m.Expression, context: ActionContext, guard: Guard, substitutes: dict[str, Nodes]
    ) -> m.Expression:
        """Replace the operands that only charts have by names for their nodes, stored in `substitutes`."""
        nodes = self._chart_nodes(tree, context, guard)
        if nodes is not None:
            name = f"#{len(substitutes)}"
            substitutes[name] = nodes
            return m.Name(name, place=tree.place)
        called = tree.of if isinstance(tree, m.Call) else None  # a function name, which is not a variable

        def replace_part(part: m.Expression) -> m.Expression:
            return part if part is called else self._substitute(part, context, guard, substitutes)

        return map_children(tree, replace_part)

    def _chart_nodes(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes | None:
        """Return the nodes of an operand that only charts have; None for any other."""
        match tree:
            case m.Name() | m.Field():
                return self._named(tree, context, guard)
            # other right sides can be evaluated in any case, as a part of the whole expression
            case m.Binary(("&&" | "||") as operator, left, right) if self._may_fail(right, context):
                return self._short_circuit(operator, left, right, context, guard)
            case m.Call(of, arguments):
                key = self.resolve_key(of, context)
                if key is not None:
                    return self.element(key, arguments, context, guard)
                return self._call(of.name, arguments, context, guard) if isinstance(of, m.Name) else None
        return None

    def _named(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes | None:
        key = self.resolve_key(tree, context)
        if key is not None:
            # with the declared type, since arithmetic of integers saturates or wraps by it
            return integers(self.variables.get(key, guard), self._declared_type(key))
        # parameters and workspace variables are left to the evaluator of fields; MATLAB requires the names of classes
        if not isinstance(tree, m.Name) or self.diagram.chart.language != "C" or self.scope.find(tree.name) is not None:
            return None
        # the time, unless something else has this name
        if tree.name == "t":
            return self._array(self.machine.time)
        member = unqualified_member(self.scope.variables, tree.name, self.diagram.types)
        return None if member is None else self._array(self.builder.const(member))

    def _may_fail(self, tree: m.Expression, context: ActionContext) -> bool:
        """Return True if an expression calls a function of the chart or reads an array element."""
        return any(
            isinstance(node, m.Call)
            and isinstance(node.of, m.Name)
            and (self.diagram.function(node.of.name, context.scope) or self.key(node.of.name, context)) is not None
            for node in expressions_in(tree)
        )

    def _short_circuit(
        self, operator: str, left: m.Expression, right: m.Expression, context: ActionContext, guard: Guard
    ) -> Nodes | None:
        """Evaluate `&&` or `||`, the right side only where the left side does not decide."""
        first = self.scalar(left, context, guard)
        rest = self.logic.narrow(guard, first, holds=operator == "&&")
        decided = self.builder.const(0.0 if operator == "&&" else 1.0)
        # a right side that runs nowhere may not even have a value
        if rest is None:
            return self._array(decided)
        second = self.scalar(right, context, rest)
        return self._array(self.builder.call("and" if operator == "&&" else "or", first, second))

    def _call(self, name: str, arguments: m.Expressions, context: ActionContext, guard: Guard) -> Nodes | None:
        function = self.diagram.function(name, context.scope)
        if function is not None:
            values = self.evaluate_arguments(arguments, context, guard)
            outputs, _ = self.machine.functions.call(function, values, context, guard)
            if not outputs:
                raise UnsupportedError(f"{context.place}: {name} returns no value")
            return self.logic.simplify_all(outputs[0], guard)
        if name in TEMPORAL:
            return self._array(self.machine.counting.evaluate(name, arguments, context, guard))
        if name in CHANGES:
            return self._array(self._change_operator(name, arguments, context, guard))
        # with other arguments it is a function of the user
        if name == "in" and len(arguments) == 1:
            return self._array(self.machine.activity.active(self.state(arguments[0], context), guard))
        return None

    def _declared_type(self, key: str) -> IntegerType | None:
        """Return the integer type that the chart declares for a variable."""
        data = next((variable for variable in self.diagram.data.values() if variable.key == key), None)
        return matlab_word(data.written.type.strip()) if data is not None else None

    def state(self, tree: m.Expression, context: ActionContext) -> StateNode:
        """Return the state that an expression names."""
        path = field_path(tree)
        state = self.diagram.state(path, context.scope) if path is not None else None
        if state is None:
            raise UnsupportedError(f"{context.place}: in() requires the name of a unique state")
        return state

    def _change_operator(self, name: str, arguments: m.Expressions, context: ActionContext, guard: Guard) -> int:
        """Return the node that is 1 if a value changed between the beginnings of the last two steps."""
        tree, wanted = arguments[0], arguments[1:]
        base, indices = (tree.of, tree.arguments) if isinstance(tree, m.Call) else (tree, ())
        key = self.resolve_key(base, context)
        if key is None or len(wanted) != (name != "hasChanged"):
            raise UnsupportedError(f"{context.place}: this use of {name} is not supported")
        after, before = (self._seen(f"{when} {key}", indices, context, guard) for when in ("now", "before"))
        changed = reduce_nodes(self.builder, "or", elementwise(self.builder, "ne", after, before).ravel())
        if not wanted:
            return changed
        value = self.nodes(wanted[0], context, guard)
        equal = elementwise(self.builder, "eq", before if name == "hasChangedFrom" else after, value)
        return self.builder.call("and", changed, reduce_nodes(self.builder, "and", equal.ravel()))

    def _seen(self, key: str, indices: m.Expressions, context: ActionContext, guard: Guard) -> Nodes:
        return self.element(key, indices, context, guard) if indices else self.variables.get(key, guard)

    def _array(self, node: int) -> Nodes:
        return np.array([[node]], dtype=np.int64)

    def event(self, tree: m.Expression, context: ActionContext) -> tuple[ChartEvent, StateNode | None] | None:
        """Return the event that an expression sends, and the state it is sent to, if named."""
        if isinstance(tree, m.Name):
            event = self.diagram.event(tree.name, context.scope)
            return (event, None) if event is not None else None
        if isinstance(tree, m.Field):
            path = field_path(tree)
            state = self.diagram.state(path[:-1], context.scope) if path else None
            event = self.diagram.event(path[-1], state) if path and state is not None else None
            return (event, state) if event is not None else None
        if isinstance(tree, m.Call) and tree.of == m.Name("send") and 1 <= len(tree.arguments) <= 2:
            return self._sent_event(tree.arguments, context)
        return None

    def _sent_event(self, arguments: m.Expressions, context: ActionContext) -> tuple[ChartEvent, StateNode | None]:
        """Return the event of `send(E)` or `send(E, S)`, which may belong to S."""
        to = self.state(arguments[1], context) if len(arguments) == 2 else None
        sent = self.event(arguments[0], context)
        if sent is None and to is not None:
            sent = self.event(arguments[0], replace(context, scope=to))
        if sent is None:
            raise UnsupportedError(f"{context.place}: send() requires an event of the chart")
        return (sent[0], to) if to is not None else sent
