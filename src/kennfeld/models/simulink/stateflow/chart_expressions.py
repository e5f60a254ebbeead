"""Expressions of the code of a chart, evaluated under a guard.

Operands that only charts have, such as variables, elements of arrays and temporal operators, are evaluated first and
replaced by names for their nodes; the remaining expression is evaluated like that of a block parameter.

A variable index selects between all elements. Reading beyond the array, where a chart would stop, gives NaN; writing
beyond it has no effect.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.traversal import expressions_in, field_path, map_children
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.integer_types import IntegerType
from kennfeld.models.imperative.library.elementwise_functions import OF_BITS
from kennfeld.models.imperative.library.function_registry import KEEPS_INTEGERS, matlab_word
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, reduce_nodes
from kennfeld.models.imperative.symbolic_values import integers
from kennfeld.models.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.stateflow.chart_model import ChartEvent, ChartModel, StateNode
from kennfeld.models.simulink.stateflow.function_library import call_library_function, is_library_function
from kennfeld.models.simulink.stateflow.guarded_variables import ActionContext, Guard, GuardedVariables, GuardLogic
from kennfeld.models.simulink.stateflow.temporal_logic import CHANGES, TEMPORAL
from kennfeld.models.simulink.variables.mask_scope import Scope

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.chart_execution import ChartExecution


_MAX_ELEMENTS = 1_000  # of an array with a variable index

_FILLED = {"NaN": math.nan, "nan": math.nan, "Inf": math.inf, "inf": math.inf}


class ChartExpressions:
    """Evaluates the expressions of a chart."""

    def __init__(self, machine: "ChartExecution", expressions: ParameterExpressions, scope: Scope) -> None:
        self.machine = machine
        self.expressions = expressions
        self.scope = scope
        self.builder = expressions.builder
        self.logic: GuardLogic = machine.logic
        self.diagram: ChartModel = machine.diagram
        self.variables: GuardedVariables = machine.variables
        self.elements = Elements(self)

    def nodes(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes:
        """Return the nodes of an expression, Int[rows, columns]."""
        substitutes: dict[str, Nodes] = {}
        plain = self._substitute(tree, context, guard, substitutes)
        try:
            return self.logic.simplify_all(self.expressions.tree_nodes(plain, self.scope, substitutes), guard)
        except EvaluationError as error:
            raise UnsupportedError(f"{context.place}: {error}", "", error.undefined) from None
        except InputError as error:
            raise UnsupportedError(f"{context.place}: {error.findings[0]}") from None

    def scalar(self, tree: m.Expression, context: ActionContext, guard: Guard) -> int:
        """Return the node of a scalar expression; an array is true if all its elements are."""
        nodes = self.nodes(tree, context, guard)
        if nodes.size == 0:
            raise UnsupportedError(f"{context.place}: the condition is empty")
        return reduce_nodes(self.builder, "and", [int(node) for node in nodes.ravel()])

    def evaluate_arguments(
        self, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard
    ) -> list[Nodes | None]:
        """Return the values of arguments; None for text, which can only be displayed."""
        return [None if isinstance(tree, m.Text) else self.nodes(tree, context, guard) for tree in arguments]

    def key(self, name: str, context: ActionContext) -> str | None:
        """Return the key of the variable of a name; None if there is none."""
        if context.frame and (local := f"{context.frame}.{name}") in self.variables:
            return local
        data = self.diagram.datum(name, context.scope)
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
            case m.Binary(("&&" | "||") as operator, left, right) if self._may_fail(right, context):
                return self._short_circuit(operator, left, right, context, guard)
            case m.Call(of, arguments):
                key = self.resolve_key(of, context)
                if key is not None:
                    return self.elements.get(key, arguments, context, guard)
                return self._call(of.name, arguments, context, guard) if isinstance(of, m.Name) else None
        return None

    def _named(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes | None:
        key = self.resolve_key(tree, context)
        if key is not None:
            return self.variables.get(key, guard)
        if tree == m.Name("t") and self.diagram.chart.language == "C" and self.scope.find("t") is None:
            return self._array(self.machine.time)
        return None

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
        if rest is None:
            return self._array(decided)
        second = self.scalar(right, context, rest)
        return self._array(self.builder.call("and" if operator == "&&" else "or", first, second))

    def _call(
        self, name: str, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard
    ) -> Nodes | None:
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
        if name == "in" and len(arguments) == 1:
            return self._array(self.machine.activity.active(self.state(arguments[0], context), guard))
        if name == "cast" and len(arguments) == 2:
            return self.nodes(arguments[0], context, guard)
        if name == "isnan" and len(arguments) == 1:
            nodes = self.nodes(arguments[0], context, guard)
            return elementwise(self.builder, "ne", nodes, nodes)
        if name in _FILLED:
            return self._constant_array(name, arguments, context, guard)
        results = self.call_library(name, arguments, 1, context, guard)
        return results[0] if results else None

    def call_library(
        self, name: str, arguments: tuple[m.Expression, ...], wanted: int, context: ActionContext, guard: Guard
    ) -> list[Nodes]:
        """Call a MATLAB function in a chart with MATLAB as action language; empty if it is not one."""
        if self.diagram.chart.language == "C" or not is_library_function(name):
            return []
        values = [
            tree.value if isinstance(tree, m.Text) else self._typed_nodes(tree, context, guard) for tree in arguments
        ]
        try:
            return call_library_function(self.builder, name, values, wanted)
        except ProgramError as error:
            raise UnsupportedError(f"{context.place}: {error.message}", error.remedy) from None

    def _typed_nodes(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes:
        """Return the nodes of an expression, with the integer type of its variables and casts."""
        return integers(self.nodes(tree, context, guard), self._integer_type(tree, context))

    def _integer_type(self, tree: m.Expression, context: ActionContext) -> IntegerType | None:
        """Return the integer type of an expression by the declarations of the chart."""
        match tree:
            case m.Name() | m.Field():
                return self._declared_type(tree, context)
            case m.Unary("-" | "+", operand):
                return self._integer_type(operand, context)
            case m.Binary("+" | "-" | "*" | ".*" | "/" | "./" | "^" | ".^", left, right):
                return self._integer_type(left, context) or self._integer_type(right, context)
            case m.Call(of, arguments):
                declared = self._declared_type(of, context)
                name = of.name if isinstance(of, m.Name) else ""
                if declared is not None or self.resolve_key(of, context) is not None:
                    return declared
                if name == "cast" and len(arguments) == 2 and isinstance(arguments[1], m.Text):
                    return matlab_word(arguments[1].value)
                if name in KEEPS_INTEGERS or name in OF_BITS:
                    types = (self._integer_type(argument, context) for argument in arguments)
                    return next((integer_type for integer_type in types if integer_type is not None), None)
                return matlab_word(name)
        return None

    def _declared_type(self, tree: m.Expression, context: ActionContext) -> IntegerType | None:
        """Return the integer type that the chart declares for a variable."""
        key = self.resolve_key(tree, context)
        data = next((variable for variable in self.diagram.data.values() if variable.key == key), None)
        return matlab_word(data.written.type.strip()) if data is not None else None

    def _constant_array(
        self, name: str, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard
    ) -> Nodes:
        """Return an array of NaN or Inf; a type name behind the sizes is ignored."""
        sizes = m.Call(m.Name("zeros"), tuple(argument for argument in arguments if not isinstance(argument, m.Text)))
        number = self.builder.const(_FILLED[name])
        return np.full(self.nodes(sizes, context, guard).shape, number, dtype=np.int64)

    def state(self, tree: m.Expression, context: ActionContext) -> StateNode:
        """Return the state that an expression names."""
        path = field_path(tree)
        state = self.diagram.state(path, context.scope) if path is not None else None
        if state is None:
            raise UnsupportedError(f"{context.place}: in() requires the name of a unique state")
        return state

    def _change_operator(
        self, name: str, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard
    ) -> int:
        """Return the node that is 1 if a value changed between the beginnings of the last two steps."""
        tree, wanted = arguments[0], arguments[1:]
        base, indices = (tree.of, tree.arguments) if isinstance(tree, m.Call) else (tree, ())
        key = self.resolve_key(base, context)
        if key is None or len(wanted) != (name != "hasChanged"):
            raise UnsupportedError(f"{context.place}: this use of {name} is not supported")
        after, before = (self._seen(f"{when} {key}", indices, context, guard) for when in ("now", "before"))
        changed = reduce_nodes(
            self.builder, "or", [int(node) for node in elementwise(self.builder, "ne", after, before).ravel()]
        )
        if not wanted:
            return changed
        value = self.nodes(wanted[0], context, guard)
        equal = elementwise(self.builder, "eq", before if name == "hasChangedFrom" else after, value)
        return self.builder.call(
            "and", changed, reduce_nodes(self.builder, "and", [int(node) for node in equal.ravel()])
        )

    def _seen(self, key: str, indices: tuple[m.Expression, ...], context: ActionContext, guard: Guard) -> Nodes:
        return self.elements.get(key, indices, context, guard) if indices else self.variables.get(key, guard)

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

    def _sent_event(
        self, arguments: tuple[m.Expression, ...], context: ActionContext
    ) -> tuple[ChartEvent, StateNode | None]:
        """Return the event of `send(E)` or `send(E, S)`, which may belong to S."""
        to = self.state(arguments[1], context) if len(arguments) == 2 else None
        sent = self.event(arguments[0], context)
        if sent is None and to is not None:
            sent = self.event(arguments[0], replace(context, scope=to))
        if sent is None:
            raise UnsupportedError(f"{context.place}: send() requires an event of the chart")
        return (sent[0], to) if to is not None else sent


class Elements:
    """Access to the elements of array variables."""

    def __init__(self, values: "ChartExpressions") -> None:
        self.values = values
        self.builder = values.builder
        self.variables = values.variables

    def get(self, key: str, indices: tuple[m.Expression, ...], context: ActionContext, guard: Guard) -> Nodes:
        """Return elements of a variable."""
        array = self.variables.get(key, guard)
        places = self._places(array.shape, indices, context, guard)
        try:
            fixed = self._fixed(places)
            if fixed is not None:
                return _select(array, fixed)
            elements = self._elements(array, places, context)
        except IndexError:
            raise UnsupportedError(f"{context.place}: index out of range of {key}") from None
        selected = self.builder.const(math.nan)
        for where, element in elements:
            selected = self.builder.call("select", where, element, selected)
        return np.array([[selected]], dtype=np.int64)

    def set(
        self, key: str, indices: tuple[m.Expression, ...], new: Nodes, context: ActionContext, guard: Guard
    ) -> None:
        """Assign elements of a variable."""
        array = self.variables.get(key, guard)
        places = self._places(array.shape, indices, context, guard)
        changed = array.copy()
        try:
            fixed = self._fixed(places)
            if fixed is not None:
                _put(changed, fixed, new)
                return self.variables.set(key, changed, guard)
            elements = self._elements(array, places, context)
        except (IndexError, ValueError):
            raise UnsupportedError(f"{context.place}: assignment out of range of {key}") from None
        if new.size != 1:
            raise UnsupportedError(f"{context.place}: cannot assign several elements of {key} by variable indices")
        chosen = [self.builder.call("select", where, int(new.item()), element) for where, element in elements]
        return self.variables.set(key, np.array(chosen, dtype=np.int64).reshape(array.shape), guard)

    def _places(
        self, shape: tuple[int, ...], indices: tuple[m.Expression, ...], context: ActionContext, guard: Guard
    ) -> list[Nodes | None]:
        """Return the nodes of each index, None for a colon."""
        places: list[Nodes | None] = []
        if len(indices) not in (1, 2):
            raise UnsupportedError(f"{context.place}: {len(indices)} indices are not supported")
        for axis, index in enumerate(indices):
            size = math.prod(shape) if len(indices) == 1 else shape[axis]
            if isinstance(index, m.Colon):
                places.append(None)
            else:
                places.append(self._place(self._replace_end(index, size, context), context, guard))
        return places

    def _replace_end(self, index: m.Expression, size: int, context: ActionContext) -> m.Expression:
        """Replace `end` by the size, except within an index of another array."""
        if isinstance(index, m.End):
            return m.Number(float(size))
        if isinstance(index, m.Call) and self.values.resolve_key(index.of, context) is not None:
            return index
        return map_children(index, lambda part: self._replace_end(part, size, context))

    def _place(self, index: m.Expression, context: ActionContext, guard: Guard) -> Nodes:
        """Return the nodes of an index, rounded as the action language does."""
        whole = "floor" if self.values.diagram.language.name == "C" else "round"
        return elementwise(self.builder, whole, self.values.nodes(index, context, guard))

    def _fixed(self, places: Sequence[Nodes | None]) -> list[list[int] | None] | None:
        """Return constant indices from 0; None if one is variable. Raises `IndexError` for a non-finite one."""
        indices: list[list[int] | None] = []
        for place in places:
            if place is None:
                indices.append(None)
                continue
            numbers = [self.builder.value(int(node)) for node in place.ravel()]
            if None in numbers:
                return None
            if not np.all(np.isfinite(np.array(numbers, dtype=np.float64))):
                raise IndexError
            indices.append([int(number or 0) - 1 for number in numbers])
        return indices

    def _elements(
        self, array: Nodes, places: Sequence[Nodes | None], context: ActionContext
    ) -> "list[tuple[int, int]]":
        """Return each element, row by row, with the node that is 1 if selected; raises `IndexError`."""
        if array.size > _MAX_ELEMENTS or any(place is None or place.size != 1 for place in places):
            raise UnsupportedError(f"{context.place}: this kind of variable index is not supported")
        for place, size in zip(places, array.shape if len(places) == 2 else (array.size,), strict=True):
            number = self.builder.value(int(place.item())) if place is not None else None
            if number is not None and not 1 <= number <= size:
                raise IndexError
        elements = []
        for at in np.ndindex(*array.shape):
            wanted = at if len(places) == 2 else (at[0] + at[1] * array.shape[0],)
            equal = [
                self.builder.call("eq", int(place.item()), self.builder.const(float(index + 1)))
                for place, index in zip(places, wanted, strict=True)
                if place is not None
            ]
            elements.append((reduce_nodes(self.builder, "and", equal), int(array[at])))
        return elements


def _flat(indices: list[int], shape: tuple[int, ...]) -> tuple[Any, ...]:
    if min(indices, default=0) < 0:
        raise IndexError
    return np.unravel_index(np.array(indices, dtype=np.int64), shape, order="F")


def _select(array: Nodes, indices: list[list[int] | None]) -> Nodes:
    if len(indices) == 1:
        chosen = indices[0]
        if chosen is None:
            return array.reshape(-1, 1, order="F")
        try:
            elements = array[_flat(chosen, array.shape)]
        except ValueError:
            raise IndexError from None
        elements = np.asarray(elements, dtype=np.int64)
        return elements.reshape(-1, 1) if array.shape[1] == 1 and array.shape[0] != 1 else elements.reshape(1, -1)
    return np.asarray(array[_grid(indices, array.shape)])


def _put(array: Nodes, indices: list[list[int] | None], new: Nodes) -> None:
    if len(indices) == 1:
        chosen = indices[0] if indices[0] is not None else list(range(array.size))
        array[_flat(chosen, array.shape)] = new.item() if new.size == 1 else new.ravel(order="F")
    else:
        array[_grid(indices, array.shape)] = new.item() if new.size == 1 else new


def _grid(indices: list[list[int] | None], shape: tuple[int, ...]) -> Any:
    chosen = [list(range(size)) if index is None else index for index, size in zip(indices, shape, strict=True)]
    if any(place < 0 for index in chosen for place in index):
        raise IndexError
    return np.ix_(*chosen)
