"""The evaluation of expressions by the rules of MATLAB; nothing is executed outside of this evaluator."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from kennfeld.base.errors import Location
from kennfeld.base.formatting import nearest, size_text
from kennfeld.matlab import values as v
from kennfeld.matlab.errors import Budget, LimitError, MatlabError, failed_assignment
from kennfeld.matlab.functions import NUMERIC_FUNCTIONS, NumericArguments
from kennfeld.matlab.indexing import ALL, Index, index_array
from kennfeld.matlab.operators import (
    apply_binary,
    apply_unary,
    cast_to_class,
    colon_range,
    concatenate_rows,
    is_true,
    make_cells,
    transpose,
)
from kennfeld.matlab.parser import parse_expression
from kennfeld.matlab.simulink_objects import ENUMERATION, construct_object, is_constructor
from kennfeld.matlab.simulink_types import BUS, struct_of_bus
from kennfeld.program import tree as m
from kennfeld.program.traversal import access_chain, names_read

HostFunction = Callable[..., Any]
_SHORT = ("&&", "||")
_STRUCT_OF_BUS = f"{BUS}.createMATLABStruct"
_CLASSES = {
    f"{sign}{bits}": f"{name}{bits}" for sign, name in (("u", "uint"), ("s", "int")) for bits in (8, 16, 32, 64)
}
_FAILURES = (ValueError, IndexError, TypeError, OverflowError, ZeroDivisionError, MemoryError, KeyError)


def evaluate(
    expression: m.Expression | str,
    variables: Mapping[str, Any] | None = None,
    functions: Mapping[str, HostFunction] | None = None,
    name: str = "",
    budget: Budget | None = None,
) -> v.Value:
    """Evaluate an expression.

    Args:
        expression: Its text or its tree.
        variables: MATLAB values, or Python values: numbers, texts, arrays, lists as cells, mappings as structs.
        functions: Functions by name, which take values and return one, or a tuple of several.
        name: The name of the text in error messages.
        budget: Limits of steps, array elements and nested calls.

    Returns:
        The value of the expression.

    Raises:
        MatlabError: The expression has no value, such as for an unknown name, sizes that are not compatible or a
            complex result.

    Example:
        >>> evaluate("[0 cumsum(x)]", {"x": np.array([1.0, 2.0])}).tolist()
        [[0.0, 1.0, 3.0]]
    """
    tree = parse_expression(expression, name) if isinstance(expression, str) else expression
    values = {key: v.from_python(value) for key, value in (variables or {}).items()}
    evaluator = NumericEvaluator(values, functions or {}, budget or Budget(), name)
    try:
        return evaluator.value(tree)
    except LimitError as error:
        raise MatlabError.at(name, tree.place, str(error)) from None
    except RecursionError:
        raise MatlabError.at(name, tree.place, "functions call each other in an endless recursion") from None


class NumericEvaluator:
    """Evaluates expressions over `variables`; `undefined` maps those without a value to the reason."""

    def __init__(
        self, variables: dict[str, v.Value], functions: Mapping[str, HostFunction], budget: Budget, name: str
    ) -> None:
        self.variables = variables
        self.functions = functions
        self.budget = budget
        self.name = name
        self.undefined: dict[str, Location] = {}  # where the assignment of a variable or field failed
        self.owned: dict[str, int] = {}  # id of the array of each variable that owns it alone
        self._ends: list[tuple[v.Value, int, int]] = []

    def value(self, node: m.Expression) -> v.Value:
        """Return the value of an expression that has exactly one."""
        values = self.values(node)
        if len(values) != 1:
            message = "has no value" if not values else f"has {len(values)} values, expected one"
            raise MatlabError.at(self.name, node.place, f"this expression {message}")
        return values[0]

    def values(self, node: m.Expression, outputs: int = 1) -> list[v.Value]:
        """Return the values of an expression: several for `c{:}`, or for a call with several outputs."""
        self.budget.step()
        try:
            if isinstance(node, m.Name | m.Field | m.DynamicField | m.Call | m.CellIndex):
                return self._access(node, outputs)
            return [self._evaluate_node(node)]
        except v.MatlabValueError as error:
            raise MatlabError.at(self.name, node.place, str(error)) from None

    def is_true(self, node: m.Expression) -> bool:
        """Return the truth value of a condition."""
        try:
            return is_true(self.value(node))
        except v.MatlabValueError as error:
            raise MatlabError.at(self.name, node.place, str(error)) from None

    def _evaluate_node(self, node: m.Expression) -> v.Value:
        match node:
            case m.Number():
                return self._number(node)
            case m.Text():
                return v.strings([node.value]) if node.is_string else v.characters(node.value)
            case m.Binary():
                return self._binary(node)
            case m.Unary():
                return apply_unary(node.operator, self.value(node.operand))
            case m.Range():
                step = None if node.step is None else self.value(node.step)
                return colon_range(self.value(node.first), step, self.value(node.last), self.budget)
            case m.Matrix():
                return self._matrix(node)
            case m.CellArray():
                return make_cells([self.flat_values(row) for row in node.rows if row], self.budget)
            case m.Transpose():
                operand = self.value(node.operand)
                return v.with_class_of(operand, transpose(v.elements_of(operand)))
            case m.AnonymousFunction():
                captured = {name: self.variables[name] for name in names_read(node) if name in self.variables}
                self.owned.clear()
                return v.MatlabFunctionHandle("", node.parameters, node.body, captured)
            case m.FunctionHandle():
                return v.MatlabFunctionHandle(node.name)
            case m.End():
                return self._end_value()
            case _:
                return v.characters(":")

    @staticmethod
    def _number(node: m.Number) -> v.Value:
        if node.suffix == "i":
            raise v.MatlabValueError("complex numbers are not supported")
        return cast_to_class(v.scalar(node.value), _CLASSES[node.suffix]) if node.suffix else v.scalar(node.value)

    def _matrix(self, node: m.Matrix) -> v.Value:
        rows = node.rows
        if len({len(row) for row in rows}) == 1:
            literals = [[_literal(element) for element in row] for row in rows]
            if all(element is not None for row in literals for element in row):
                self.budget.allocate(len(rows) * len(rows[0]))
                return np.array(literals, dtype=np.float64)
        return concatenate_rows([self.flat_values(row) for row in rows], self.budget)

    def flat_values(self, nodes: Sequence[m.Expression]) -> list[v.Value]:
        """Return the values of several expressions in one list."""
        return [value for node in nodes for value in self.values(node)]

    def _binary(self, node: m.Binary) -> v.Value:
        """Evaluate an operator; long chains are evaluated from left to right without recursion."""
        chain: list[m.Binary] = []
        at: m.Expression = node
        while isinstance(at, m.Binary):
            chain.append(at)
            at = at.left
        value = self.value(at)
        for operation in reversed(chain):
            self.budget.step()
            if operation.operator in _SHORT:
                first = is_true(value)
                decided = first != (operation.operator == "&&")
                value = v.logical(first if decided else self.is_true(operation.right))
            else:
                value = apply_binary(operation.operator, value, self.value(operation.right), self.budget)
        return value

    def _end_value(self) -> v.Value:
        if not self._ends:
            raise v.MatlabValueError("end is valid in an index only")
        holder, at, count = self._ends[-1]
        shape = v.elements_of(holder).shape
        if at < count - 1:
            return v.scalar(shape[at] if at < len(shape) else 1)
        return v.scalar(math.prod(shape[at:]))

    def _access(self, node: m.Expression, outputs: int) -> list[v.Value]:
        """Evaluate a variable or a call, and the accesses behind it."""
        base, steps = access_chain(node)
        at = 0
        if self.undefined and isinstance(base, m.Name):
            self._check_fields(base, steps)
        if not isinstance(base, m.Name):
            values = [self.value(base)]
        elif base.name in self.variables:
            values = [self.variables[base.name]]
            if not steps or not isinstance(steps[0], m.Call):
                self.owned.pop(base.name, None)
        else:
            values, at = self._call_by_name(base, steps, outputs)
        for k in range(at, len(steps)):
            if len(values) != 1:
                raise v.MatlabValueError(f"expected one value, got {len(values)}")
            values = self.step(values[0], steps[k], outputs if k == len(steps) - 1 else 1)
        return values

    def _check_fields(self, base: m.Name, steps: Sequence[m.Expression]) -> None:
        """Raise `MatlabError` if a field of a struct has no value."""
        path = base.name
        for step in steps:
            if not isinstance(step, m.Field):
                return
            path = f"{path}.{step.name}"
            if path in self.undefined:
                why = failed_assignment(self.undefined[path])
                raise MatlabError.at(self.name, base.place, f"{path} is undefined: {why}")

    def step(self, value: v.Value, step: m.Expression, outputs: int = 1) -> list[v.Value]:
        """Return the part of a value that a field, an index or a brace index selects."""
        match step:
            case m.Field() | m.DynamicField():
                return _read_field(value, self.field_name(step))
            case m.CellIndex():
                indices = self.indices(step.arguments, value)
                if isinstance(value, v.MatlabCell):
                    return list(index_array(value.values, indices, self.budget).ravel(order="F"))
                if isinstance(value, np.ndarray) and value.dtype.kind == "O":
                    return list(map(v.characters, map(str, index_array(value, indices, self.budget).ravel(order="F"))))
                raise v.MatlabValueError(f"a {v.class_name(value)} cannot be indexed with braces")
            case m.Call():
                if isinstance(value, v.MatlabFunctionHandle):
                    return self.apply(value, self.flat_values(step.arguments), outputs)
                indices = self.indices(step.arguments, value)
                if isinstance(value, v.MatlabStruct) and value.kind == ENUMERATION and len(step.arguments) == 1:
                    return [v.numbers(self.value(step.arguments[0]))]
                if isinstance(value, v.OpaqueValue):
                    raise v.MatlabValueError(f"a {value.kind} can be read by MATLAB only")
                return [v.with_class_of(value, index_array(v.elements_of(value), indices, self.budget))]
        raise v.MatlabValueError("this kind of access is not supported")

    def field_name(self, step: m.Field | m.DynamicField) -> str:
        """Return the name of a field, evaluated if it is dynamic."""
        return step.name if isinstance(step, m.Field) else v.text(self.value(step.name))

    def indices(self, nodes: Sequence[m.Expression], holder: v.Value) -> list[Index]:
        """Evaluate the indices within brackets; `end` refers to the size of `holder`."""
        indices: list[Index] = []
        for at, node in enumerate(nodes):
            if isinstance(node, m.Colon):
                indices.append(ALL)
                continue
            self._ends.append((holder, at, len(nodes)))
            try:
                indices += self.values(node)
            finally:
                self._ends.pop()
        return indices

    def _call_by_name(self, base: m.Name, steps: Sequence[m.Expression], outputs: int) -> tuple[list[v.Value], int]:
        """Call the function at the base of a chain; return its values and the number of accesses it consumes."""
        if base.name in self.undefined:
            why = failed_assignment(self.undefined[base.name])
            raise MatlabError.at(self.name, base.place, f"{base.name} is undefined: {why}")
        path, at = base.name, 0
        while at < len(steps) and isinstance(field := steps[at], m.Field):
            path, at = f"{path}.{field.name}", at + 1
            behind = steps[at] if at < len(steps) else None
            # a function of a class, such as Simulink.Bus.createMATLABStruct, has its name behind that of the class
            if path == _STRUCT_OF_BUS or (is_constructor(path) and not (path == BUS and isinstance(behind, m.Field))):
                known = self.flat_values(behind.arguments) if isinstance(behind, m.Call) else []
                created = self._create_object(path, known, base.place)
                return [created], at + isinstance(behind, m.Call)
        call = steps[0] if steps and isinstance(steps[0], m.Call) else None
        arguments = self.flat_values(call.arguments) if call is not None else []
        if not self.knows(base.name):
            remedy = nearest(base.name, [*self.variables, *NUMERIC_FUNCTIONS])
            message = f"unknown function {path}" if call is not None or "." in path else f"{path} is not defined"
            raise MatlabError.at(self.name, base.place, message, remedy)
        used = 0 if call is None else 1
        return self.call(base.name, arguments, outputs if len(steps) == used else 1, base.place), used

    def _create_object(self, path: str, arguments: Sequence[v.Value], place: m.TextPosition) -> v.Value:
        """Create an object of a class, or the struct of a bus."""
        if path != _STRUCT_OF_BUS:
            return construct_object(path, arguments)
        try:
            # a third argument makes an array of structs
            if not 1 <= len(arguments) <= 2:
                raise v.MatlabValueError("the name of a bus and at most a struct of values are supported")
            return struct_of_bus(v.text(arguments[0]), self.buses(), arguments[1] if len(arguments) > 1 else None)
        except v.MatlabValueError as error:
            raise MatlabError.at(self.name, place, f"{path}: {error}") from None

    def buses(self) -> Mapping[str, v.Value]:
        """The variables among which buses are looked up by their names."""
        return self.variables

    def knows(self, name: str) -> bool:
        """Return True if a function of this name exists."""
        return name in self.functions or name in NUMERIC_FUNCTIONS

    def call(self, name: str, arguments: Sequence[v.Value], outputs: int, place: m.TextPosition) -> list[v.Value]:
        """Call a function by its name."""
        if name in self.functions:
            result = self.functions[name](*arguments)
            return [v.from_python(value) for value in result] if isinstance(result, tuple) else [v.from_python(result)]
        known = NUMERIC_FUNCTIONS.get(name)
        if known is None:
            raise MatlabError.at(self.name, place, f"unknown function {name}", nearest(name, NUMERIC_FUNCTIONS))
        if not known.least <= len(arguments) <= known.most:
            wanted = str(known.least) if known.least == known.most else f"{known.least} to {known.most}"
            wanted = wanted if known.most < 100 else f"{known.least} or more"
            raise MatlabError.at(self.name, place, f"{name} takes {wanted} arguments, got {len(arguments)}")
        call = NumericArguments(arguments, outputs, self.budget, self.apply, self.variables.__contains__)
        return self._run(name, known.run, call, place)

    def _run(
        self, name: str, run: Callable[[NumericArguments], Any], call: NumericArguments, place: m.TextPosition
    ) -> list[v.Value]:
        try:
            result = run(call)
        except v.MatlabValueError as error:
            raise MatlabError.at(self.name, place, f"{name}: {error}") from None
        except _FAILURES:
            sizes = [f"{v.class_name(value)} of {size_text(v.elements_of(value).shape)}" for value in call.values]
            message = f"{name} cannot be computed for these arguments ({', '.join(sizes) or 'none'})"
            raise MatlabError.at(self.name, place, message) from None
        results = list(result) if isinstance(result, tuple) else [result]
        if len(results) < call.outputs:
            raise MatlabError.at(self.name, place, f"{name} returns {len(results)} values, {call.outputs} requested")
        return results[: max(call.outputs, 1)]

    def apply(self, function: v.Value, arguments: Sequence[v.Value], outputs: int) -> list[v.Value]:
        """Call a function handle."""
        if isinstance(function, np.ndarray):
            function = v.MatlabFunctionHandle(v.text(function))
        if not isinstance(function, v.MatlabFunctionHandle):
            raise v.MatlabValueError(f"a {v.class_name(function)} is not a function")
        if function.body is None:
            return self.call(function.name, arguments, outputs, m.TextPosition())
        with self.nested_call():
            return self.inner(_bind_arguments(function, arguments)).values(function.body, outputs)

    def inner(self, variables: dict[str, v.Value]) -> "NumericEvaluator":
        """Return an evaluator for the body of a function."""
        return NumericEvaluator(variables, self.functions, self.budget, self.name)

    @contextmanager
    def nested_call(self) -> Iterator[None]:
        """Count calls within calls."""
        self.budget.calls -= 1
        try:
            if self.budget.calls < 0:
                raise LimitError("function calls are nested too deeply")
            yield
        finally:
            self.budget.calls += 1


def _literal(node: m.Expression) -> float | None:
    """Return the value of a signed number literal; None for any other expression."""
    if isinstance(node, m.Unary) and node.operator == "-" and isinstance(node.operand, m.Number):
        return None if node.operand.suffix else -node.operand.value
    return node.value if isinstance(node, m.Number) and not node.suffix else None


def _bind_arguments(function: v.MatlabFunctionHandle, arguments: Sequence[v.Value]) -> dict[str, v.Value]:
    parameters = function.parameters
    if parameters and parameters[-1] == "varargin":
        count = len(parameters) - 1
        rest = [arguments[count:]] if arguments[count:] else []
        arguments = [*arguments[:count], make_cells(rest, Budget())]
    if len(arguments) > len(parameters):
        raise v.MatlabValueError(f"the function takes {len(parameters)} arguments, got {len(arguments)}")
    bound = dict(zip(parameters, arguments, strict=False))
    bound.pop("~", None)
    return {**function.variables, **bound}


def _read_field(value: v.Value, name: str) -> list[v.Value]:
    if isinstance(value, v.OpaqueValue):
        raise v.MatlabValueError(f"a {value.kind} can be read by MATLAB only")
    if not isinstance(value, v.MatlabStruct):
        raise v.MatlabValueError(f"a {v.class_name(value)} has no field {name}")
    if name not in value.names:
        raise v.MatlabValueError(f"unknown field {name}. {nearest(name, value.names)}".strip())
    return [element[name] for element in value.elements.ravel(order="F")]
