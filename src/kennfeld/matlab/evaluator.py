"""The value of an expression, by MATLAB's rules; nothing is executed outside of this evaluator."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from kennfeld.formatting import nearest
from kennfeld.matlab import syntax as m
from kennfeld.matlab.errors import Budget, LimitError, MatlabError
from kennfeld.matlab.functions import NUMERIC_FUNCTIONS, NumericArguments
from kennfeld.matlab.indexing import ALL, Index, index_array
from kennfeld.matlab.operators import (
    binary,
    cast_to_class,
    cells,
    colon_range,
    concatenate_rows,
    is_true,
    transposed,
    unary,
)
from kennfeld.matlab.parser import parse_expression
from kennfeld.matlab.simulink_objects import construct_object, is_constructor
from kennfeld.matlab.values import (
    MatlabCell,
    MatlabFunctionHandle,
    MatlabStruct,
    MatlabValueError,
    OpaqueValue,
    Value,
    characters,
    class_name,
    elements_of,
    from_python,
    logical,
    scalar,
    strings,
    text,
    with_class_of,
)

__all__ = ["HostFunction", "NumericEvaluator", "access_chain", "evaluate", "free_names"]

HostFunction = Callable[..., Any]
_SHORT = ("&&", "||")
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
) -> Value:
    """The value of an expression.

    `variables` are values of MATLAB or of Python (numbers, texts, arrays, lists as cells, mappings as structs);
    `functions` are called with values and return one, or a tuple of several. `name` is told where something is wrong.
    Raises `MatlabError` where there is no value: a name that is not known, sizes that do not fit, complex numbers.

    >>> evaluate("[0 cumsum(x)]", {"x": np.array([1.0, 2.0])}).tolist()
    [[0.0, 1.0, 3.0]]
    """
    tree = parse_expression(expression, name) if isinstance(expression, str) else expression
    known = {key: from_python(given) for key, given in (variables or {}).items()}
    evaluator = NumericEvaluator(known, functions or {}, budget or Budget(), name)
    try:
        return evaluator.value(tree)
    except LimitError as error:
        raise MatlabError.at(name, tree.place, str(error)) from None
    except RecursionError:
        raise MatlabError.at(name, tree.place, "functions call each other without end") from None


def free_names(expression: m.Expression) -> frozenset[str]:
    """The names that an expression takes from outside: its variables, and the functions that it calls.

    >>> sorted(free_names(parse_expression("K*interp1(x, y, u) + arrayfun(@(a) a*b, u)")))
    ['K', 'arrayfun', 'b', 'interp1', 'u', 'x', 'y']
    """
    if isinstance(expression, m.Name):
        return frozenset({expression.name})
    found = frozenset[str]().union(*(free_names(child) for child in m.children(expression)))
    return found - set(expression.parameters) if isinstance(expression, m.AnonymousFunction) else found


class NumericEvaluator:
    """Evaluates expressions over `variables`; those in `undefined` have lost their value, for the reason told."""

    def __init__(
        self, variables: dict[str, Value], functions: Mapping[str, HostFunction], budget: Budget, name: str
    ) -> None:
        self.variables = variables
        self.functions = functions
        self.budget = budget
        self.name = name
        self.undefined: dict[str, str] = {}
        self.owned: dict[str, int] = {}  # variables that nothing else shares their array with
        self._ends: list[tuple[Value, int, int]] = []

    def value(self, node: m.Expression) -> Value:
        """The one value of an expression."""
        found = self.values(node)
        if len(found) != 1:
            message = "has no value" if not found else f"has {len(found)} values where one is needed"
            raise MatlabError.at(self.name, node.place, f"this {message}")
        return found[0]

    def values(self, node: m.Expression, outputs: int = 1) -> list[Value]:
        """The values of an expression: several for `c{:}`, or where a function is asked for several."""
        self.budget.step()
        try:
            if isinstance(node, m.Name | m.Field | m.DynamicField | m.Call | m.CellIndex):
                return self._accessed(node, outputs)
            return [self._plain(node)]
        except MatlabValueError as error:
            raise MatlabError.at(self.name, node.place, str(error)) from None

    def holds(self, node: m.Expression) -> bool:
        """Whether a condition holds."""
        try:
            return is_true(self.value(node))
        except MatlabValueError as error:
            raise MatlabError.at(self.name, node.place, str(error)) from None

    def _plain(self, node: m.Expression) -> Value:
        match node:
            case m.Number():
                return self._number(node)
            case m.Text():
                return strings([node.value]) if node.is_string else characters(node.value)
            case m.Binary():
                return self._binary(node)
            case m.Unary():
                return unary(node.operator, self.value(node.operand))
            case m.Range():
                step = None if node.step is None else self.value(node.step)
                return colon_range(self.value(node.first), step, self.value(node.last), self.budget)
            case m.Matrix():
                return self._matrix(node)
            case m.CellArray():
                return cells([self._listed(row) for row in node.rows if row], self.budget)
            case m.Transpose():
                operand = self.value(node.operand)
                return with_class_of(operand, transposed(elements_of(operand)))
            case m.AnonymousFunction():
                kept = {name: self.variables[name] for name in free_names(node) if name in self.variables}
                self.owned.clear()
                return MatlabFunctionHandle("", node.parameters, node.body, kept)
            case m.FunctionHandle():
                return MatlabFunctionHandle(node.name)
            case m.End():
                return self._end()
            case _:
                return characters(":")

    @staticmethod
    def _number(node: m.Number) -> Value:
        if node.suffix == "i":
            raise MatlabValueError("complex numbers are not known here")
        return cast_to_class(scalar(node.value), _CLASSES[node.suffix]) if node.suffix else scalar(node.value)

    def _matrix(self, node: m.Matrix) -> Value:
        rows = node.rows
        if len({len(row) for row in rows}) == 1:
            plain = [[_literal(one) for one in row] for row in rows]
            if all(one is not None for row in plain for one in row):
                self.budget.make(len(rows) * len(rows[0]))
                return np.array(plain, dtype=np.float64)
        return concatenate_rows([self._listed(row) for row in rows], self.budget)

    def _listed(self, nodes: Sequence[m.Expression]) -> list[Value]:
        return [value for node in nodes for value in self.values(node)]

    def _binary(self, node: m.Binary) -> Value:
        """Long chains go from left to right without a call for each."""
        chain: list[m.Binary] = []
        at: m.Expression = node
        while isinstance(at, m.Binary):
            chain.append(at)
            at = at.left
        value = self.value(at)
        for one in reversed(chain):
            self.budget.step()
            if one.operator in _SHORT:
                is_and = one.operator == "&&"
                value = logical(
                    is_true(value) and self.holds(one.right) if is_and else is_true(value) or self.holds(one.right)
                )
            else:
                value = binary(one.operator, value, self.value(one.right), self.budget)
        return value

    def _end(self) -> Value:
        if not self._ends:
            raise MatlabValueError("end stands in no index of an array")
        holder, at, count = self._ends[-1]
        shape = elements_of(holder).shape
        if at < count - 1:
            return scalar(shape[at] if at < len(shape) else 1)
        return scalar(math.prod(shape[at:]))

    def _accessed(self, node: m.Expression, outputs: int) -> list[Value]:
        """A variable or a call, and the parts taken of it."""
        base, steps = access_chain(node)
        at = 0
        if not isinstance(base, m.Name):
            found = [self.value(base)]
        elif base.name in self.variables:
            found = [self.variables[base.name]]
            if not steps or not isinstance(steps[0], m.Call):
                self.owned.pop(base.name, None)
        else:
            found, at = self._called(base, steps, outputs)
        for k in range(at, len(steps)):
            if len(found) != 1:
                raise MatlabValueError(f"{len(found)} values stand where one is needed")
            found = self.step(found[0], steps[k], outputs if k == len(steps) - 1 else 1)
        return found

    def step(self, value: Value, step: m.Expression, outputs: int = 1) -> list[Value]:
        """A part of a value: a field, an index, cells."""
        match step:
            case m.Field() | m.DynamicField():
                return _fields(value, self.field_name(step))
            case m.CellIndex():
                indices = self.indices(step.arguments, value)
                if isinstance(value, MatlabCell):
                    return list(index_array(value.values, indices, self.budget).ravel(order="F"))
                if isinstance(value, np.ndarray) and value.dtype.kind == "O":
                    return [characters(str(one)) for one in index_array(value, indices, self.budget).ravel(order="F")]
                raise MatlabValueError(f"a {class_name(value)} has no cells")
            case m.Call():
                if isinstance(value, MatlabFunctionHandle):
                    return self.apply(value, self._arguments(step.arguments), outputs)
                indices = self.indices(step.arguments, value)
                if isinstance(value, OpaqueValue):
                    raise MatlabValueError(f"a {value.kind} is read by MATLAB alone")
                return [with_class_of(value, index_array(elements_of(value), indices, self.budget))]
        raise MatlabValueError("this is no part of a value")

    def field_name(self, step: m.Field | m.DynamicField) -> str:
        """The name of a field, which an expression may give."""
        return step.name if isinstance(step, m.Field) else text(self.value(step.name))

    def indices(self, nodes: Sequence[m.Expression], holder: Value) -> list[Index]:
        """The indices within brackets; `end` is the size of the holder there."""
        found: list[Index] = []
        for at, node in enumerate(nodes):
            if isinstance(node, m.Colon):
                found.append(ALL)
                continue
            self._ends.append((holder, at, len(nodes)))
            try:
                found += self.values(node)
            finally:
                self._ends.pop()
        return found

    def _arguments(self, nodes: Sequence[m.Expression]) -> list[Value]:
        return self._listed(nodes)

    def _called(self, base: m.Name, steps: Sequence[m.Expression], outputs: int) -> tuple[list[Value], int]:
        """What a call gives, and how many of the steps behind the name belong to it."""
        if base.name in self.undefined:
            raise MatlabError.at(self.name, base.place, f"{base.name} is undefined: {self.undefined[base.name]}")
        path, at = base.name, 0
        while at < len(steps) and isinstance(field := steps[at], m.Field):
            path, at = f"{path}.{field.name}", at + 1
            if is_constructor(path):
                behind = steps[at] if at < len(steps) else None
                given = self._arguments(behind.arguments) if isinstance(behind, m.Call) else []
                return [construct_object(path, given)], at + isinstance(behind, m.Call)
        first = steps[0] if steps else None
        arguments = self._arguments(first.arguments) if isinstance(first, m.Call) else []
        is_call = isinstance(first, m.Call)
        wanted = outputs if len(steps) == is_call else 1
        if not self.knows(base.name):
            self._unknown(base, path if not is_call else base.name, is_call)
        return self.call(base.name, arguments, wanted, base.place), int(is_call)

    def _unknown(self, base: m.Name, path: str, is_call: bool) -> None:
        remedy = nearest(base.name, [*self.variables, *NUMERIC_FUNCTIONS])
        message = f"{path} is no function that is known here" if is_call or "." in path else f"{path} is not defined"
        raise MatlabError.at(self.name, base.place, message, remedy)

    def knows(self, name: str) -> bool:
        """Whether there is such a function."""
        return name in self.functions or name in NUMERIC_FUNCTIONS

    def call(self, name: str, arguments: Sequence[Value], outputs: int, place: m.SourcePosition) -> list[Value]:
        """What a function gives, by its name."""
        if name in self.functions:
            result = self.functions[name](*arguments)
            return [from_python(one) for one in result] if isinstance(result, tuple) else [from_python(result)]
        known = NUMERIC_FUNCTIONS.get(name)
        if known is None:
            raise MatlabError.at(
                self.name, place, f"{name} is no function that is known here", nearest(name, NUMERIC_FUNCTIONS)
            )
        if not known.least <= len(arguments) <= known.most:
            wanted = str(known.least) if known.least == known.most else f"{known.least} to {known.most}"
            wanted = wanted if known.most < 100 else f"{known.least} or more"
            raise MatlabError.at(self.name, place, f"{name} takes {wanted} arguments, not {len(arguments)}")
        given = NumericArguments(arguments, outputs, self.budget, self.apply, self.variables.__contains__)
        return self._run(name, known.run, given, place)

    def _run(
        self, name: str, run: Callable[[NumericArguments], Any], given: NumericArguments, place: m.SourcePosition
    ) -> list[Value]:
        try:
            result = run(given)
        except MatlabValueError as error:
            raise MatlabError.at(self.name, place, f"{name}: {error}") from None
        except _FAILURES:
            sizes = ", ".join(
                f"{class_name(one)} of {' x '.join(map(str, elements_of(one).shape))}" for one in given.values
            )
            message = f"{name} has no value for these arguments ({sizes or 'none'})"
            raise MatlabError.at(self.name, place, message) from None
        found = list(result) if isinstance(result, tuple) else [result]
        if len(found) < given.outputs:
            raise MatlabError.at(self.name, place, f"{name} gives {len(found)} values, not {given.outputs}")
        return found[: max(given.outputs, 1)]

    def apply(self, function: Value, arguments: Sequence[Value], outputs: int) -> list[Value]:
        """What a function gives that is itself a value."""
        if isinstance(function, np.ndarray):
            function = MatlabFunctionHandle(text(function))
        if not isinstance(function, MatlabFunctionHandle):
            raise MatlabValueError(f"a {class_name(function)} is no function")
        if function.body is None:
            return self.call(function.name, arguments, outputs, m.SourcePosition())
        with self.deeper():
            inner = self.inner(_bound(function, arguments))
            return inner.values(function.body, outputs)

    def inner(self, variables: dict[str, Value]) -> "NumericEvaluator":
        """An evaluator for the body of a function."""
        return NumericEvaluator(variables, self.functions, self.budget, self.name)

    def deeper(self) -> "_Deeper":
        """Counts functions within functions."""
        return _Deeper(self.budget)


class _Deeper:
    def __init__(self, budget: Budget) -> None:
        self.budget = budget

    def __enter__(self) -> None:
        self.budget.calls -= 1
        if self.budget.calls < 0:
            self.budget.calls += 1
            raise LimitError("functions call each other too deep")

    def __exit__(self, *_: object) -> None:
        self.budget.calls += 1


def access_chain(node: m.Expression) -> tuple[m.Expression, list[m.Expression]]:
    """What stands at the beginning of a chain of parts, and the parts, from left to right."""
    steps: list[m.Expression] = []
    while isinstance(node, m.Field | m.DynamicField | m.Call | m.CellIndex):
        steps.append(node)
        node = node.of
    return node, steps[::-1]


def _literal(node: m.Expression) -> float | None:
    """The value of a number as written, with its sign."""
    if isinstance(node, m.Unary) and node.operator == "-" and isinstance(node.operand, m.Number):
        return None if node.operand.suffix else -node.operand.value
    return node.value if isinstance(node, m.Number) and not node.suffix else None


def _bound(function: MatlabFunctionHandle, arguments: Sequence[Value]) -> dict[str, Value]:
    parameters = function.parameters
    if parameters and parameters[-1] == "varargin":
        count = len(parameters) - 1
        rest = cells([list(arguments[count:])], Budget()) if arguments[count:] else cells([], Budget())
        arguments = [*arguments[:count], rest]
    if len(arguments) > len(parameters):
        raise MatlabValueError(f"the function takes {len(parameters)} arguments, not {len(arguments)}")
    given = dict(zip(parameters, arguments, strict=False))
    given.pop("~", None)
    return {**function.variables, **given}


def _fields(value: Value, name: str) -> list[Value]:
    if isinstance(value, OpaqueValue):
        raise MatlabValueError(f"a {value.kind} is read by MATLAB alone")
    if not isinstance(value, MatlabStruct):
        raise MatlabValueError(f"a {class_name(value)} has no field {name}")
    if name not in value.names:
        raise MatlabValueError(f"there is no field {name}. {nearest(name, value.names)}".strip())
    return [element[name] for element in value.elements.ravel(order="F")]
