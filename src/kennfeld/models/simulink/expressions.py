"""MATLAB expressions over graph nodes, so that derivatives with respect to named variables stay exact.

What the graph cannot say (ranges, functions of whole arrays) is evaluated as numbers instead; the variables in it are
then fixed, and `Expressions.frozen` tells which.
"""

import math
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any, Final, TypeAlias

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.declared import Declared
from kennfeld.models.simulink.scopes import Array, Coded, Masked, Scope, Value, Variable
from kennfeld.models.simulink.signals import Nodes

__all__ = [
    "BINARY",
    "Expressions",
    "NoValueError",
    "each",
    "fold",
    "matrix_product",
    "part_of",
    "towards_zero",
    "way_of",
]

Held: TypeAlias = "Nodes | str | Mapping[str, Value] | tuple[Value, ...]"


class NoValueError(Exception):
    """An expression has no value here; the text says why. `undefined` is the variable that nothing gives a value."""

    def __init__(self, why: str, undefined: str = "") -> None:
        super().__init__(why)
        self.undefined = undefined


class _BeyondGraphError(Exception):
    """An expression that only numbers can tell."""


BINARY: Final = {
    "+": "add", "-": "sub", ".*": "mul", "./": "div", ".^": "pow", "==": "eq", "~=": "ne", "!=": "ne", "<": "lt",
    "<=": "le", ">": "gt", ">=": "ge", "&": "and", "|": "or", "&&": "and", "||": "or",
}  # fmt: skip
_PLAIN: Final = [
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "sinh",
    "cosh",
    "tanh",
    "exp",
    "log",
    "log10",
    "sqrt",
    "abs",
    "floor",
    "ceil",
    "round",
    "sign",
    "atan2",
    "mod",
]
_CONSTANTS: Final = {
    "pi": math.pi, "inf": math.inf, "Inf": math.inf, "nan": math.nan, "NaN": math.nan, "eps": 2.0**-52, "true": 1.0,
    "false": 0.0, "realmax": float(np.finfo(np.float64).max), "realmin": float(np.finfo(np.float64).tiny),
}  # fmt: skip
_SHAPES: Final = {"zeros": 0.0, "ones": 1.0, "reshape": 0.0, "linspace": 0.0}
_ASKING: Final = ("get_param", "eval", "str2num", "str2double")
_LONGEST: Final = 200_000  # elements of an array that an expression makes
_LARGEST: Final = 1_000_000  # elements of an array that stands in a variable, or of one of signals
_MOST_PRODUCTS: Final = 2_000_000  # of a product of two matrices
_CASTS: Final = [
    "double",
    "single",
    "boolean",
    "logical",
    "int8",
    "int16",
    "int32",
    "int64",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
]  # physical values are kept


def each(loom: Loom, op: str, *args: Nodes) -> Nodes:
    """An operation element by element, arrays expanded against each other."""
    spread = np.broadcast_arrays(*args)
    _bounded(spread[0].size)
    made = [loom.call(op, *(int(a) for a in parts)) for parts in zip(*(a.ravel() for a in spread), strict=True)]
    return np.array(made, dtype=np.int64).reshape(spread[0].shape)


def _bounded(size: int) -> None:
    if size > _LARGEST:
        raise NoValueError(f"it makes an array of {size} elements, and {_LARGEST} is the most")


class Expressions:
    """Turns the expressions of block parameters into arrays of graph nodes."""

    def __init__(self, loom: Loom, declared: Declared) -> None:
        self.loom = loom
        self.declared = declared
        self.frozen: dict[str, str] = {}
        self._codes: dict[tuple[str, int], dict[str, Value]] = {}
        self._known: dict[tuple[str, int, bool], Held] = {}

    def array(self, text: str, scope: Scope, live: bool = True, names: Mapping[str, Nodes] | None = None) -> Nodes:
        """The nodes of an expression, Int[rows, columns]; with `live`, named variables are looked up.

        `names` are names that stand for nodes of their own, such as the u of a function block.
        Raises `NoValueError`.
        """
        return _nodes(self.held(text, scope, live, names), text)

    def numbers(self, text: str, scope: Scope) -> Array:
        """The numbers of an expression, Float[rows, columns]; raises `NoValueError`."""
        return self.values(self.array(text, scope, live=False), text)

    def computed(self, tree: m.Expression, scope: Scope, names: Mapping[str, Nodes]) -> Nodes:
        """The nodes of an expression over names that stand for nodes; raises `NoValueError`."""
        try:
            return _Walk(self, scope, True, names).nodes(tree)
        except _BeyondGraphError as beyond:
            raise NoValueError(str(beyond)) from None

    def tree_numbers(self, tree: m.Expression, scope: Scope) -> Array:
        """The numbers of an expression that is a tree already; raises `NoValueError`."""
        try:
            return self.values(_Walk(self, scope, False, {}).nodes(tree))
        except _BeyondGraphError as beyond:
            raise NoValueError(str(beyond)) from None

    def values(self, nodes: Nodes, text: str = "it") -> Array:
        """The numbers of constant nodes; raises `NoValueError` where one is no constant."""
        found = [self.loom.value(int(node)) for node in nodes.ravel()]
        if None in found:
            raise NoValueError(f"{text.strip()[:80]} is no constant")
        return np.array(found, dtype=np.float64).reshape(nodes.shape)

    def held(self, text: str, scope: Scope, live: bool, names: Mapping[str, Nodes] | None = None) -> Held:
        """The value of an expression, whatever it is; raises `NoValueError`."""
        key = (text, id(scope), live)
        if names is not None or key not in self._known:
            value = self._evaluated(text, scope, live, names)
            if names is not None:
                return value
            self._known[key] = value
        return self._known[key]

    def _evaluated(self, text: str, scope: Scope, live: bool, names: Mapping[str, Nodes] | None) -> Held:
        if not text.strip():
            raise NoValueError("it is empty")
        try:
            tree = parse_expression(text)
            try:
                return _Walk(self, scope, live, names or {}).value(tree)
            except _BeyondGraphError as beyond:
                return self._fixed(text, tree, scope, live, names, str(beyond))
        except InputError as error:
            raise NoValueError(str(error.findings[0])) from None
        except RecursionError:
            raise NoValueError(f"{text.strip()[:60]} refers to itself or is nested too deeply") from None

    def _fixed(
        self, text: str, tree: m.Expression, scope: Scope, live: bool, names: Mapping[str, Nodes] | None, why: str
    ) -> Held:
        """The value as numbers, by the evaluator of MATLAB expressions."""
        from kennfeld.models.simulink.numbers import Unknown, evaluated

        if names:
            raise NoValueError(why)
        given = evaluated(tree, lambda name: self._variable_value(name, scope))
        if isinstance(given, Unknown):
            raise NoValueError(given.why, given.undefined)
        if live and any(isinstance(scope.find(name), (Variable, Masked)) for name in given.names):
            self.frozen[text.strip()] = why
        return self.constant(given.value)

    def _variable_value(self, name: str, scope: Scope) -> Value | None:
        found = scope.find(name)
        if found is None:
            return None
        if isinstance(found, Variable):
            return _shown(found, scope) if name == "gcb" else found.value
        if isinstance(found, Coded):
            return self._coded(found)
        if not found.evaluated:
            return found.text
        held = self.held(found.text, found.outside, False)
        return self.values(held) if isinstance(held, np.ndarray) else held

    def fixed(self, value: Value) -> Nodes:
        """A value as constants of the graph, Int[rows, columns]; raises `NoValueError` where it is no array."""
        return _nodes(self.constant(value), "it")

    def constant(self, value: Value) -> Held:
        """A value as constants of the graph."""
        if not isinstance(value, np.ndarray):
            return value
        _bounded(value.size)
        made = [self.loom.const(float(number)) for number in value.ravel()]
        return np.atleast_2d(np.array(made, dtype=np.int64).reshape(value.shape))

    def name(self, name: str, scope: Scope, live: bool) -> Held:
        """What a name stands for; raises `NoValueError` where it stands for nothing."""
        found = scope.find(name)
        if isinstance(found, Masked):
            return self._masked(found, live)
        if isinstance(found, Coded):
            return self.constant(self._coded(found))
        if isinstance(found, Variable):
            return self.constant(_shown(found, scope)) if name == "gcb" else self.variable(name, found, live)
        if name in _CONSTANTS:
            return np.array([[self.loom.const(_CONSTANTS[name])]], dtype=np.int64)
        raise NoValueError(f"{name} is defined nowhere", name)

    def _coded(self, found: Coded) -> Value:
        """The value that a mask's code gives a name; the variables in it are fixed."""
        if (found.code, id(found.outside)) not in self._codes:
            from kennfeld.models.simulink.numbers import made_by

            self._codes[found.code, id(found.outside)] = made_by(
                found.code, lambda name: self._known_number(name, found.outside)
            )
            self.frozen[found.code.strip()[:200]] = "a mask's code computes it"
        value = self._codes[found.code, id(found.outside)].get(found.name)
        if value is None:
            raise NoValueError(f"the mask's code gives {found.name} no value")
        return value

    def _known_number(self, name: str, scope: Scope) -> Value | None:
        try:
            return self._variable_value(name, scope)
        except NoValueError:
            return None

    def _masked(self, found: Masked, live: bool) -> Held:
        if not found.evaluated:
            return found.text
        if live and found.field in self.declared.promoted:
            numbers = self.numbers(found.text, found.outside)
            return self.declared.array(self.loom, found.field, Variable(numbers, source="a mask"))
        return self.held(found.text, found.outside, live)

    def variable(self, name: str, found: Variable, live: bool) -> Held:
        """A variable, looked up or as constants; parts of a struct are told from each other by their names."""
        if isinstance(found.value, np.ndarray) and live and not found.fixed:
            return self.declared.array(self.loom, name, found)
        return self.constant(found.value)


def _shown(found: Variable, scope: Scope) -> Value:
    """What a block says of itself: what the dialogs of the masks around it show."""
    if not (found.fixed and isinstance(found.value, Mapping)):
        return found.value
    return {**found.value, **scope.shown()}


class _Walk:
    def __init__(self, of: Expressions, scope: Scope, live: bool, names: Mapping[str, Nodes]) -> None:
        self.of, self.scope, self.live, self.names = of, scope, live, names
        self.loom = of.loom

    def value(self, tree: m.Expression) -> Held:
        match tree:
            case m.Number(value, ""):
                return np.array([[self.loom.const(value)]], dtype=np.int64)
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
        raise _BeyondGraphError(f"{type(tree).__name__} is none of what a graph can say")

    def nodes(self, tree: m.Expression) -> Nodes:
        return _nodes(self.value(tree), "it")

    def _unary(self, operator: str, operand: Nodes) -> Nodes:
        if operator == "+":
            return operand
        return each(self.loom, "neg" if operator == "-" else "not", operand)

    def _binary(self, operator: str, left: Nodes, right: Nodes) -> Nodes:
        single = left.size == 1 or right.size == 1
        if operator == "*" and not single:
            return self._product(left, right)
        if (operator == "/" and right.size != 1) or (operator == "^" and max(left.size, right.size) > 1):
            raise _BeyondGraphError("it divides by a matrix or raises one to a power")
        operator = {"*": ".*", "/": "./", "^": ".^"}.get(operator, operator)
        if operator not in BINARY:
            raise _BeyondGraphError(f"the operator {operator} is for numbers")
        try:
            return each(self.loom, BINARY[operator], left, right)
        except ValueError:
            raise NoValueError(f"arrays of {left.shape} and {right.shape} do not fit each other") from None

    def _product(self, left: Nodes, right: Nodes) -> Nodes:
        if left.shape[1] != right.shape[0]:
            raise NoValueError(f"a matrix of {left.shape} cannot be multiplied with one of {right.shape}")
        return matrix_product(self.loom, left, right)

    def _matrix(self, rows: tuple[tuple[m.Expression, ...], ...]) -> Nodes:
        made = [[self.nodes(element) for element in row] for row in rows]
        try:
            lines = [np.concatenate(full, axis=1) for row in made if (full := [part for part in row if part.size])]
            return np.concatenate(lines, axis=0) if lines else np.zeros((0, 0), dtype=np.int64)
        except ValueError:
            raise NoValueError("the rows of a matrix have different lengths") from None

    def _range(self, tree: m.Range) -> Nodes:
        """Evenly spaced numbers; rounding does not take the last one away."""
        first, step, last = (self._number(part) for part in (tree.first, tree.step or m.Number(1.0), tree.last))
        steps = (last - first) / step if step else -1.0
        if not abs(steps) < _LONGEST:
            raise NoValueError(f"a range of {steps:g} steps is too long")
        count = math.floor(steps * (1 + 1e-12) + 1e-10) + 1
        numbers = first + step * np.arange(max(count, 0))
        return np.array([[self.loom.const(float(n)) for n in numbers]], dtype=np.int64).reshape(1, -1)

    def _number(self, tree: m.Expression) -> float:
        """One number that is fixed."""
        found = self.of.values(_Walk(self.of, self.scope, False, self.names).nodes(tree))
        if found.size != 1:
            raise NoValueError(f"{found.size} numbers stand where one is expected")
        return float(found.item())

    def _field(self, tree: m.Field) -> Held:
        """A part of a struct: a variable of its own, called by the way to it."""
        way = way_of(tree)
        if way is None:
            raise _BeyondGraphError("it takes a part of a computed struct")
        found: Any = self.scope.find(way[0])
        if isinstance(found, Masked):
            return self._masked_field(found, way[1:])
        if (part := self.scope.part(way)) is not None:
            return self.of.variable(".".join(way), part, self.live)
        if isinstance(found, Coded):
            raise _BeyondGraphError("a mask's code makes the struct")
        if found is None:
            raise NoValueError(f"{way[0]} is defined nowhere", ".".join(way))
        if found.fixed and way[1] not in found.value:
            raise NoValueError(f"{way[0]} has no member {way[1]}, but {', '.join(list(found.value)[:8])}")
        value = part_of(found.value, way)
        return self.of.variable(".".join(way), _like(found, value), self.live)

    def _masked_field(self, found: Masked, way: list[str]) -> Held:
        inner = parse_expression(found.text)
        names = way_of(inner)
        if names is None:
            raise _BeyondGraphError("it takes a part of a mask's struct")
        tree: m.Expression = inner
        for name in way:
            tree = m.Field(tree, name)
        return _Walk(self.of, found.outside, self.live, {}).value(tree)

    def _asked(self, name: str, arguments: tuple[m.Expression, ...]) -> Held:
        """A text that the model says of itself, or what a text means."""
        if name != "get_param":
            text = self.value(arguments[0]) if len(arguments) == 1 else None
            if not isinstance(text, str):
                raise NoValueError(f"{name} is only followed for one text")
            return self.of.held(text, self.scope, self.live)
        holder, key = map(self.value, arguments) if len(arguments) == 2 else ({}, "")
        said = holder.get(key) if isinstance(holder, Mapping) and isinstance(key, str) else None
        if not isinstance(said, str):
            raise NoValueError(f"get_param asks for {str(key)[:40] or 'nothing'}, which only Simulink can tell")
        return said

    def _call(self, tree: m.Call) -> Held:
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
            return np.array([[self.loom.const(float(size))]], dtype=np.int64)
        if name in _SHAPES:
            return self._shaped(name, tree.arguments)
        if name not in _KNOWN:
            for argument in tree.arguments:  # a variable without a value is told by its name
                self.value(argument)
            raise _BeyondGraphError(f"the function {name} is for numbers")
        args = [self.nodes(argument) for argument in tree.arguments]
        made = _function(self.loom, name, args)
        if made is None:
            raise _BeyondGraphError(f"the function {name} is for numbers")
        return made

    def _shaped(self, name: str, arguments: tuple[m.Expression, ...]) -> Nodes:
        """A function that makes or shapes an array of fixed size."""
        own = 1 if name == "reshape" else 0
        sizes = [n for part in arguments[own:] if part != m.Matrix(((),)) for n in self._sizes(part)]
        if name == "linspace":
            first, last, count = (*map(self._number, arguments), 100.0)[:3]
            if not 1 <= count <= _LONGEST:
                raise NoValueError(f"linspace of {count:g} numbers")
            return np.array([[self.loom.const(float(n)) for n in np.linspace(first, last, int(count))]], dtype=np.int64)
        if name == "reshape":
            array = self.nodes(arguments[0])
            shape = [-1 if part == m.Matrix(()) else _whole(self._number(part), "a size") for part in arguments[1:]]
            shape = sizes if len(arguments) == 2 else shape
            if min(shape, default=-2) < -1 or array.size > _LONGEST:
                raise NoValueError(f"reshape to {shape}")
            try:
                return array.reshape(shape, order="F")
            except ValueError:
                raise NoValueError(f"{array.size} elements do not fit the shape {shape}") from None
        shape = sizes * 2 if len(sizes) == 1 else sizes or [1, 1]
        if min(shape) < 0 or math.prod(shape) > _LONGEST:
            raise NoValueError(f"{name} of the size {shape}")
        return np.full(shape, self.loom.const(_SHAPES[name]), dtype=np.int64)

    def _sizes(self, tree: m.Expression) -> list[int]:
        found = self.of.values(_Walk(self.of, self.scope, False, self.names).nodes(tree))
        return [_whole(float(n), "a size") for n in found.ravel()]

    def _is_array(self, name: str) -> bool:
        return name in self.names or self.scope.find(name) is not None

    def _is_enumeration(self, name: str) -> bool:
        """Whether a name is that of an enumeration, which makes a member of a number."""
        found = self.scope.find(name) if name not in self.names else None
        return isinstance(found, Variable) and found.fixed and isinstance(found.value, Mapping)

    def _index(self, array: Nodes, tree: m.Call) -> Nodes:
        fixed = _Walk(self.of, self.scope, False, self.names)
        places = [self.of.values(fixed.nodes(argument)) for argument in tree.arguments]
        if any(place.size != 1 for place in places):
            raise _BeyondGraphError("it takes several elements of an array")
        if not places:
            return array
        at = [_whole(place.item(), "an index") - 1 for place in places]
        try:
            if min(at) < 0:
                raise IndexError
            element = array.ravel(order="F")[at[0]] if len(at) == 1 else array[tuple(at)]
        except IndexError:
            raise NoValueError(f"the element {[a + 1 for a in at]} is outside of an array of {array.shape}") from None
        return np.array([[element]], dtype=np.int64)


def _whole(number: float, what: str) -> int:
    if not math.isfinite(number) or number != round(number):
        raise NoValueError(f"{what} is {number:g}, which is no whole number")
    return int(number)


def way_of(tree: m.Expression) -> list[str] | None:
    """The names of `a.b.c`; None where it begins with something else."""
    names: list[str] = []
    while isinstance(tree, m.Field):
        names.append(tree.name)
        tree = tree.of
    return [tree.name, *reversed(names)] if isinstance(tree, m.Name) else None


def part_of(value: Value, way: list[str]) -> Value:
    """The part of a struct at the end of a way; raises `NoValueError`."""
    for at, name in enumerate(way[1:], 1):
        if not isinstance(value, Mapping) or name not in value:
            raise NoValueError(f"{'.'.join(way[:at])} has no part {name}", ".".join(way))
        value = value[name]
    return value


def _like(found: Variable, value: Value) -> Variable:
    return Variable(value, source=found.source, fixed=found.fixed)


def _nodes(held: Held, text: str) -> Nodes:
    if isinstance(held, np.ndarray):
        return held
    kind = "a text" if isinstance(held, str) else "a struct" if isinstance(held, Mapping) else "a list"
    raise NoValueError(f"{text.strip()[:60]} is {kind}, not a number")


def matrix_product(loom: Loom, left: Nodes, right: Nodes) -> Nodes:
    """The product of two matrices of nodes; raises `NoValueError` where it is too large."""
    products = left.size * right.shape[1]
    if products > _MOST_PRODUCTS:
        raise NoValueError(f"a product of matrices takes {products} products of numbers; {_MOST_PRODUCTS} is the most")
    made = np.zeros((left.shape[0], right.shape[1]), dtype=np.int64)
    for row in range(left.shape[0]):
        for column in range(right.shape[1]):
            terms = each(loom, "mul", left[row, :], right[:, column])
            made[row, column] = fold(loom, "add", [int(term) for term in terms])
    return made


def fold(loom: Loom, op: str, nodes: list[int]) -> int:
    """An operation from the first to the last; 0 of no nodes."""
    return reduce(lambda a, b: loom.call(op, a, b), nodes) if nodes else loom.const(0.0)


def _function(loom: Loom, name: str, args: list[Nodes]) -> Nodes | None:
    """A function of node arrays; None for one that is not known."""
    count = 2 if name in ("atan2", "mod") else 1
    if name in _PLAIN and len(args) == count:
        return each(loom, name, *args)
    if name in _MORE and len(args) == _MORE[name][0]:
        return _MORE[name][1](loom, *args)
    if name in ("min", "max") and len(args) == 2:
        return each(loom, name, *args)
    if name in ("min", "max", "sum", "prod") and len(args) == 1 and 1 in args[0].shape:
        op = {"sum": "add", "prod": "mul"}.get(name, name)
        return np.array([[fold(loom, op, [int(n) for n in args[0].ravel(order="F")])]], dtype=np.int64)
    return args[0] if name in _CASTS and len(args) == 1 else None


def _power(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    return each(loom, "pow", a, b)


def _remainder(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    """What is left of a after whole steps of b towards 0."""
    whole = towards_zero(loom, each(loom, "div", a, b))
    return each(loom, "sub", a, each(loom, "mul", whole, b))


def towards_zero(loom: Loom, x: Nodes) -> Nodes:
    """The whole part, towards 0."""
    return each(loom, "mul", each(loom, "sign", x), each(loom, "floor", each(loom, "abs", x)))


def _hypotenuse(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    return each(loom, "sqrt", each(loom, "add", each(loom, "mul", a, a), each(loom, "mul", b, b)))


_MORE: Final[Mapping[str, tuple[int, Callable[..., Nodes]]]] = {
    "power": (2, _power),
    "pow": (2, _power),
    "rem": (2, _remainder),
    "fmod": (2, _remainder),
    "hypot": (2, _hypotenuse),
    "fix": (1, towards_zero),
    "ln": (1, lambda loom, x: each(loom, "log", x)),
    "sgn": (1, lambda loom, x: each(loom, "sign", x)),
    "fabs": (1, lambda loom, x: each(loom, "abs", x)),
    "rdivide": (2, lambda loom, a, b: each(loom, "div", a, b)),
    "times": (2, lambda loom, a, b: each(loom, "mul", a, b)),
    "plus": (2, lambda loom, a, b: each(loom, "add", a, b)),
    "minus": (2, lambda loom, a, b: each(loom, "sub", a, b)),
    "uminus": (1, lambda loom, x: each(loom, "neg", x)),
    "not": (1, lambda loom, x: each(loom, "not", x)),
    "square": (1, lambda loom, x: each(loom, "mul", x, x)),
    "reciprocal": (1, lambda loom, x: each(loom, "div", np.array([[loom.const(1.0)]]), x)),
}

_KNOWN: Final = frozenset({*_PLAIN, *_MORE, *_CASTS, "min", "max", "sum", "prod"})
