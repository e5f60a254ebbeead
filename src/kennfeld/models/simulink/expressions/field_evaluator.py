"""Evaluation of one MATLAB expression tree over graph nodes."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression
from kennfeld.matlab.traversal import field_path
from kennfeld.models.imperative.evaluation_errors import EvaluationError, NotLowerableError
from kennfeld.models.imperative.graph_operators import BINARY, KNOWN, apply_function
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, matrix_product
from kennfeld.models.simulink.variables.mask_scope import (
    MaskCodeVariable,
    MaskVariable,
    ParameterValue,
    Scope,
    Variable,
    nested_field,
)

if TYPE_CHECKING:
    from kennfeld.models.simulink.expressions.parameter_expressions import ParameterExpressions

from kennfeld.models.simulink.signals import size_text

FieldValue: TypeAlias = "Nodes | str | Mapping[str, ParameterValue] | tuple[ParameterValue, ...]"

_SHAPES: Final = {"zeros": 0.0, "ones": 1.0, "reshape": 0.0, "linspace": 0.0}
_ASKING: Final = ("get_param", "eval", "str2num", "str2double")
_LONGEST: Final = 200_000  # elements of an array in an expression


class FieldEvaluator:
    """Evaluator of one expression; with `live`, variables are looked up instead of frozen."""

    def __init__(self, of: "ParameterExpressions", scope: Scope, live: bool, names: Mapping[str, Nodes]) -> None:
        self.of, self.scope, self.live, self.names = of, scope, live, names
        self.builder = of.builder

    def value(self, tree: m.Expression) -> FieldValue:
        """Return the value of an expression."""
        match tree:
            case m.Number(value, ""):
                return np.array([[self.builder.const(value)]], dtype=np.int64)
            case m.Text():
                return tree.value
            case m.Name(name):
                return self.names[name] if name in self.names else self.of.name(name, self.scope, self.live)
            case m.Field():
                return self._field(tree)
            case m.Unary(operator, operand):
                return self._unary(operator, self.nodes(operand))
            case m.Binary(operator, left, right):
                return self._binary(operator, self.nodes(left), self.nodes(right))
            case m.Transpose(operand):
                return self.nodes(operand).T
            case m.Matrix(rows):
                return self._matrix(rows)
            case m.Range():
                return self._range(tree)
            case m.Call():
                return self._call(tree)
        word = "`end`" if isinstance(tree, m.End) else f"a {type(tree).__name__}"
        raise NotLowerableError(f"it uses {word}, which is evaluated numerically")

    def nodes(self, tree: m.Expression) -> Nodes:
        """Return the nodes of an expression, Int[rows, columns]."""
        return array_of(self.value(tree), "it")

    def _unary(self, operator: str, operand: Nodes) -> Nodes:
        if operator == "+":
            return operand
        return elementwise(self.builder, "neg" if operator == "-" else "not", operand)

    def _binary(self, operator: str, left: Nodes, right: Nodes) -> Nodes:
        single = left.size == 1 or right.size == 1
        if operator == "*" and not single:
            return self._product(left, right)
        if (operator == "/" and right.size != 1) or (operator == "^" and max(left.size, right.size) > 1):
            raise NotLowerableError("it divides by a matrix or computes a matrix power")
        operator = {"*": ".*", "/": "./", "^": ".^"}.get(operator, operator)
        if operator not in BINARY:
            raise NotLowerableError(f"the operator {operator} requires numbers")
        try:
            return elementwise(self.builder, BINARY[operator], left, right)
        except ValueError:
            raise EvaluationError(
                f"arrays of size {size_text(left.shape)} and {size_text(right.shape)} do not match"
            ) from None

    def _product(self, left: Nodes, right: Nodes) -> Nodes:
        if left.shape[1] != right.shape[0]:
            raise EvaluationError(
                f"matrices of size {size_text(left.shape)} and {size_text(right.shape)} cannot be multiplied"
            )
        return matrix_product(self.builder, left, right)

    def _matrix(self, rows: tuple[tuple[m.Expression, ...], ...]) -> Nodes:
        made = [[self.nodes(element) for element in row] for row in rows]
        try:
            lines = [np.concatenate(full, axis=1) for row in made if (full := [part for part in row if part.size])]
            return np.concatenate(lines, axis=0) if lines else np.zeros((0, 0), dtype=np.int64)
        except ValueError:
            raise EvaluationError("the rows of a matrix have different lengths") from None

    def _range(self, tree: m.Range) -> Nodes:
        """Return an evenly spaced range whose end is included despite rounding."""
        first, step, last = (self._number(part) for part in (tree.first, tree.step or m.Number(1.0), tree.last))
        steps = (last - first) / step if step else -1.0
        if not abs(steps) < _LONGEST:
            raise EvaluationError(f"a range of {steps:g} steps is too long")
        count = math.floor(steps * (1 + 1e-12) + 1e-10) + 1
        numbers = first + step * np.arange(max(count, 0))
        return np.array([[self.builder.const(float(n)) for n in numbers]], dtype=np.int64).reshape(1, -1)

    def _number(self, tree: m.Expression) -> float:
        """Return the constant scalar value of an expression."""
        numbers = self.of.values(FieldEvaluator(self.of, self.scope, False, self.names).nodes(tree))
        if numbers.size != 1:
            raise EvaluationError(f"must be scalar, got {numbers.size} values")
        return float(numbers.item())

    def _field(self, tree: m.Field) -> FieldValue:
        """Return a field of a struct: a parameter named by its path."""
        path = field_path(tree)
        if path is None:
            raise NotLowerableError("it accesses a field of a computed struct")
        variable: Any = self.scope.find(path[0])
        if isinstance(variable, MaskVariable):
            return self._masked_field(variable, path[1:])
        if (part := self.scope.part(path)) is not None:
            return self.of.variable(".".join(path), part, self.live)
        if isinstance(variable, MaskCodeVariable):
            raise NotLowerableError("the struct is computed by mask code")
        if variable is None:
            raise EvaluationError(f"{path[0]} is undefined", ".".join(path))
        if variable.fixed and path[1] not in variable.value:
            raise EvaluationError(
                f"{path[0]} has no field {path[1]}; its fields are {', '.join(list(variable.value)[:8])}"
            )
        value = nested_field(variable.value, path)
        return self.of.variable(".".join(path), _like(variable, value), self.live)

    def _masked_field(self, variable: MaskVariable, path: list[str]) -> FieldValue:
        inner = parse_expression(variable.text)
        names = field_path(inner)
        if names is None:
            raise NotLowerableError("it accesses a field of a mask's struct")
        tree: m.Expression = inner
        for name in path:
            tree = m.Field(tree, name)
        return FieldEvaluator(self.of, variable.outside, self.live, {}).value(tree)

    def _query_model(self, name: str, arguments: tuple[m.Expression, ...]) -> FieldValue:
        """Return a text property of the model (get_param), or evaluate a text."""
        if name != "get_param":
            text = self.value(arguments[0]) if len(arguments) == 1 else None
            if not isinstance(text, str):
                raise EvaluationError(f"{name} is only supported with one text argument")
            return self.of.evaluate(text, self.scope, self.live)
        holder, key = map(self.value, arguments) if len(arguments) == 2 else ({}, "")
        said = holder.get(key) if isinstance(holder, Mapping) and isinstance(key, str) else None
        if not isinstance(said, str):
            raise EvaluationError(f"get_param({str(key)[:40] or 'nothing'}) requires Simulink")
        return said

    def _call(self, tree: m.Call) -> FieldValue:
        if tree.of == m.Name("bdroot"):
            return self.value(tree.of)
        if isinstance(tree.of, m.Name) and len(tree.arguments) == 1 and self._is_enumeration(tree.of.name):
            return self.nodes(tree.arguments[0])
        if not isinstance(tree.of, m.Name) or self._is_array(tree.of.name):
            return self._index(self.nodes(tree.of), tree)
        name = tree.of.name
        if name in _ASKING:
            return self._query_model(name, tree.arguments)
        if name in ("numel", "length") and len(tree.arguments) == 1:
            array = self.nodes(tree.arguments[0])
            size = array.size if name == "numel" or not array.size else max(array.shape)
            return np.array([[self.builder.const(float(size))]], dtype=np.int64)
        if name in _SHAPES:
            return self._make_array(name, tree.arguments)
        if name not in KNOWN:
            for argument in tree.arguments:  # so that an undefined variable is reported by name
                self.value(argument)
            raise NotLowerableError(f"the function {name} requires numbers", name)
        args = [self.nodes(argument) for argument in tree.arguments]
        made = apply_function(self.builder, name, args)
        if made is None:
            raise NotLowerableError(f"the function {name} is for numbers", name)
        return made

    def _make_array(self, name: str, arguments: tuple[m.Expression, ...]) -> Nodes:
        """Call a function that creates or reshapes an array of constant size."""
        own = 1 if name == "reshape" else 0
        sizes = [n for part in arguments[own:] if part != m.Matrix(((),)) for n in self._sizes(part)]
        if name == "linspace":
            first, last, count = (*map(self._number, arguments), 100.0)[:3]
            if not 1 <= count <= _LONGEST:
                raise EvaluationError(f"linspace of {count:g} numbers")
            return np.array(
                [[self.builder.const(float(n)) for n in np.linspace(first, last, int(count))]], dtype=np.int64
            )
        if name == "reshape":
            array = self.nodes(arguments[0])
            shape = [
                -1 if part == m.Matrix(()) else _to_integer(self._number(part), "a size") for part in arguments[1:]
            ]
            shape = sizes if len(arguments) == 2 else shape
            if min(shape, default=-2) < -1 or array.size > _LONGEST:
                raise EvaluationError(f"reshape to {shape}")
            try:
                return array.reshape(shape, order="F")
            except ValueError:
                raise EvaluationError(f"{array.size} elements do not fit the shape {shape}") from None
        shape = sizes * 2 if len(sizes) == 1 else sizes or [1, 1]
        if min(shape) < 0 or math.prod(shape) > _LONGEST:
            raise EvaluationError(f"{name} of the size {shape}")
        return np.full(shape, self.builder.const(_SHAPES[name]), dtype=np.int64)

    def _sizes(self, tree: m.Expression) -> list[int]:
        numbers = self.of.values(FieldEvaluator(self.of, self.scope, False, self.names).nodes(tree))
        return [_to_integer(float(n), "a size") for n in numbers.ravel()]

    def _is_array(self, name: str) -> bool:
        return name in self.names or self.scope.find(name) is not None

    def _is_enumeration(self, name: str) -> bool:
        """Return True if a name is an enumeration, which converts a number to a member."""
        variable = self.scope.find(name) if name not in self.names else None
        return isinstance(variable, Variable) and variable.fixed and isinstance(variable.value, Mapping)

    def _index(self, array: Nodes, tree: m.Call) -> Nodes:
        fixed = FieldEvaluator(self.of, self.scope, False, self.names)
        places = [self.of.values(fixed.nodes(argument)) for argument in tree.arguments]
        if any(place.size != 1 for place in places):
            raise NotLowerableError("it selects several elements of an array")
        if not places:
            return array
        at = [_to_integer(place.item(), "an index") - 1 for place in places]
        try:
            if min(at) < 0:
                raise IndexError
            element = array.ravel(order="F")[at[0]] if len(at) == 1 else array[tuple(at)]
        except IndexError:
            raise EvaluationError(
                f"index {', '.join(str(a + 1) for a in at)} is out of range for an array of size "
                f"{size_text(array.shape)}"
            ) from None
        return np.array([[element]], dtype=np.int64)


def _to_integer(number: float, message: str) -> int:
    if not math.isfinite(number) or number != round(number):
        raise EvaluationError(f"{message} must be an integer, got {number:g}")
    return int(number)


def _like(variable: Variable, value: ParameterValue) -> Variable:
    return Variable(value, source=variable.source, fixed=variable.fixed)


def array_of(value: FieldValue, text: str) -> Nodes:
    """Return a value as an array of nodes; raise `EvaluationError` if it is not one."""
    if isinstance(value, np.ndarray):
        return value
    kind = "a text" if isinstance(value, str) else "a struct" if isinstance(value, Mapping) else "a list"
    raise EvaluationError(f"{text.strip()[:60]} must be a number, got {kind}")
