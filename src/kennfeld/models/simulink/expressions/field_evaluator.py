"""The tree of a MATLAB expression, walked node by node of the graph that it becomes."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression
from kennfeld.matlab.traversal import field_path
from kennfeld.models.imperative.evaluation_errors import EvaluationError, NotLowerableError
from kennfeld.models.imperative.graph_operators import BINARY, KNOWN, applied
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
    from kennfeld.models.simulink.expressions.parameter_expressions import Expressions

__all__ = ["FieldValue", "Walk", "array_of"]

FieldValue: TypeAlias = "Nodes | str | Mapping[str, ParameterValue] | tuple[ParameterValue, ...]"

_SHAPES: Final = {"zeros": 0.0, "ones": 1.0, "reshape": 0.0, "linspace": 0.0}
_ASKING: Final = ("get_param", "eval", "str2num", "str2double")
_LONGEST: Final = 200_000  # elements of an array that an expression makes


class Walk:
    """One walk over the tree of an expression; with `live`, named variables are looked up."""

    def __init__(self, of: "Expressions", scope: Scope, live: bool, names: Mapping[str, Nodes]) -> None:
        self.of, self.scope, self.live, self.names = of, scope, live, names
        self.builder = of.builder

    def value(self, tree: m.Expression) -> FieldValue:
        """The value of an expression, whatever it is."""
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
        raise NotLowerableError(f"{word} in it is evaluated as a number")

    def nodes(self, tree: m.Expression) -> Nodes:
        """The nodes of an expression, Int[rows, columns]."""
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
            raise NotLowerableError("it divides by a matrix or raises one to a power")
        operator = {"*": ".*", "/": "./", "^": ".^"}.get(operator, operator)
        if operator not in BINARY:
            raise NotLowerableError(f"the operator {operator} is for numbers")
        try:
            return elementwise(self.builder, BINARY[operator], left, right)
        except ValueError:
            raise EvaluationError(f"arrays of {left.shape} and {right.shape} do not fit each other") from None

    def _product(self, left: Nodes, right: Nodes) -> Nodes:
        if left.shape[1] != right.shape[0]:
            raise EvaluationError(f"a matrix of {left.shape} cannot be multiplied with one of {right.shape}")
        return matrix_product(self.builder, left, right)

    def _matrix(self, rows: tuple[tuple[m.Expression, ...], ...]) -> Nodes:
        made = [[self.nodes(element) for element in row] for row in rows]
        try:
            lines = [np.concatenate(full, axis=1) for row in made if (full := [part for part in row if part.size])]
            return np.concatenate(lines, axis=0) if lines else np.zeros((0, 0), dtype=np.int64)
        except ValueError:
            raise EvaluationError("the rows of a matrix have different lengths") from None

    def _range(self, tree: m.Range) -> Nodes:
        """Evenly spaced numbers; rounding does not take the last one away."""
        first, step, last = (self._number(part) for part in (tree.first, tree.step or m.Number(1.0), tree.last))
        steps = (last - first) / step if step else -1.0
        if not abs(steps) < _LONGEST:
            raise EvaluationError(f"a range of {steps:g} steps is too long")
        count = math.floor(steps * (1 + 1e-12) + 1e-10) + 1
        numbers = first + step * np.arange(max(count, 0))
        return np.array([[self.builder.const(float(n)) for n in numbers]], dtype=np.int64).reshape(1, -1)

    def _number(self, tree: m.Expression) -> float:
        """One number that is fixed."""
        found = self.of.values(Walk(self.of, self.scope, False, self.names).nodes(tree))
        if found.size != 1:
            raise EvaluationError(f"{found.size} numbers stand where one is expected")
        return float(found.item())

    def _field(self, tree: m.Field) -> FieldValue:
        """A part of a struct: a variable of its own, called by the way to it."""
        way = field_path(tree)
        if way is None:
            raise NotLowerableError("it takes a part of a computed struct")
        found: Any = self.scope.find(way[0])
        if isinstance(found, MaskVariable):
            return self._masked_field(found, way[1:])
        if (part := self.scope.part(way)) is not None:
            return self.of.variable(".".join(way), part, self.live)
        if isinstance(found, MaskCodeVariable):
            raise NotLowerableError("a mask's code makes the struct")
        if found is None:
            raise EvaluationError(f"{way[0]} is defined nowhere", ".".join(way))
        if found.fixed and way[1] not in found.value:
            raise EvaluationError(f"{way[0]} has no member {way[1]}, but {', '.join(list(found.value)[:8])}")
        value = nested_field(found.value, way)
        return self.of.variable(".".join(way), _like(found, value), self.live)

    def _masked_field(self, found: MaskVariable, way: list[str]) -> FieldValue:
        inner = parse_expression(found.text)
        names = field_path(inner)
        if names is None:
            raise NotLowerableError("it takes a part of a mask's struct")
        tree: m.Expression = inner
        for name in way:
            tree = m.Field(tree, name)
        return Walk(self.of, found.outside, self.live, {}).value(tree)

    def _asked(self, name: str, arguments: tuple[m.Expression, ...]) -> FieldValue:
        """A text that the model says of itself, or what a text means."""
        if name != "get_param":
            text = self.value(arguments[0]) if len(arguments) == 1 else None
            if not isinstance(text, str):
                raise EvaluationError(f"{name} is only followed for one text")
            return self.of.held(text, self.scope, self.live)
        holder, key = map(self.value, arguments) if len(arguments) == 2 else ({}, "")
        said = holder.get(key) if isinstance(holder, Mapping) and isinstance(key, str) else None
        if not isinstance(said, str):
            raise EvaluationError(f"get_param asks for {str(key)[:40] or 'nothing'}, which only Simulink can tell")
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
            return self._asked(name, tree.arguments)
        if name in ("numel", "length") and len(tree.arguments) == 1:
            array = self.nodes(tree.arguments[0])
            size = array.size if name == "numel" or not array.size else max(array.shape)
            return np.array([[self.builder.const(float(size))]], dtype=np.int64)
        if name in _SHAPES:
            return self._shaped(name, tree.arguments)
        if name not in KNOWN:
            for argument in tree.arguments:  # a variable without a value is told by its name
                self.value(argument)
            raise NotLowerableError(f"the function {name} is for numbers", name)
        args = [self.nodes(argument) for argument in tree.arguments]
        made = applied(self.builder, name, args)
        if made is None:
            raise NotLowerableError(f"the function {name} is for numbers", name)
        return made

    def _shaped(self, name: str, arguments: tuple[m.Expression, ...]) -> Nodes:
        """A function that makes or shapes an array of fixed size."""
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
            shape = [-1 if part == m.Matrix(()) else _whole(self._number(part), "a size") for part in arguments[1:]]
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
        found = self.of.values(Walk(self.of, self.scope, False, self.names).nodes(tree))
        return [_whole(float(n), "a size") for n in found.ravel()]

    def _is_array(self, name: str) -> bool:
        return name in self.names or self.scope.find(name) is not None

    def _is_enumeration(self, name: str) -> bool:
        """Whether a name is that of an enumeration, which makes a member of a number."""
        found = self.scope.find(name) if name not in self.names else None
        return isinstance(found, Variable) and found.fixed and isinstance(found.value, Mapping)

    def _index(self, array: Nodes, tree: m.Call) -> Nodes:
        fixed = Walk(self.of, self.scope, False, self.names)
        places = [self.of.values(fixed.nodes(argument)) for argument in tree.arguments]
        if any(place.size != 1 for place in places):
            raise NotLowerableError("it takes several elements of an array")
        if not places:
            return array
        at = [_whole(place.item(), "an index") - 1 for place in places]
        try:
            if min(at) < 0:
                raise IndexError
            element = array.ravel(order="F")[at[0]] if len(at) == 1 else array[tuple(at)]
        except IndexError:
            raise EvaluationError(
                f"the element {[a + 1 for a in at]} is outside of an array of {array.shape}"
            ) from None
        return np.array([[element]], dtype=np.int64)


def _whole(number: float, message: str) -> int:
    if not math.isfinite(number) or number != round(number):
        raise EvaluationError(f"{message} is {number:g}, which is no whole number")
    return int(number)


def _like(found: Variable, value: ParameterValue) -> Variable:
    return Variable(value, source=found.source, fixed=found.fixed)


def array_of(held: FieldValue, text: str) -> Nodes:
    """A value as an array of nodes; raises `NoValueError` where it is none."""
    if isinstance(held, np.ndarray):
        return held
    kind = "a text" if isinstance(held, str) else "a struct" if isinstance(held, Mapping) else "a list"
    raise EvaluationError(f"{text.strip()[:60]} is {kind}, not a number")
