"""C99 of the nodes of one step, in their order: a constant for each, in the order of operations of `native.emitter`."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.export.c_arithmetic import COMPARISONS, MAX_SHORT_POWER, CArithmetic, power_products
from kennfeld.export.c_functions import WITH_ALPHA, CFunctions, counts_points
from kennfeld.export.prepared import PreparedFunction
from kennfeld.graph.dense_layer import DenseLayer
from kennfeld.graph.lookup_lowering import AxisRef, ExpansionRef, TableRef

_TRUTHS = (*COMPARISONS, "and", "or", "not")
LEAST_EVEN = 6  # breakpoints from which on a search takes longer than a division of the axis


class StepWriter:
    """The lines of one C function that computes nodes; `p`, `s` and `u` point to parameters, states and inputs."""

    def __init__(self, function: PreparedFunction, arithmetic: CArithmetic, functions: CFunctions) -> None:
        self._function, self._arithmetic, self._functions = function, arithmetic, functions
        self._type = arithmetic.precision
        self._numbers: set[int] = set()  # conditions that have been written as numbers
        self._layers: dict[tuple[DenseLayer, tuple[int, ...]], str] = {}
        self.lines: list[str] = []

    def compute(self, order: Sequence[int]) -> None:
        """Write nodes in their order."""
        for at in order:
            self._node(at)

    def value(self, at: int) -> str:
        """Return the operand that holds the number of a node."""
        op, _, payload = self._function.nodes[at]
        if op == "const":
            return self._arithmetic.operand(payload)
        if op == "input":
            return f"u->{self._function.input_member(payload)}"
        if op in _TRUTHS and at not in self._numbers:
            a = self._arithmetic
            self._numbers.add(at)
            self._define(f"v{at}", f"b{at} ? {a.one} : {a.zero}")
        return f"v{at}"

    def truth(self, at: int) -> str:
        """Return the operand that holds whether a node is true; NaN is."""
        op, _, payload = self._function.nodes[at]
        if op == "const":
            return "true" if payload != 0 else "false"
        return f"b{at}" if op in _TRUTHS else f"({self.value(at)} != {self._arithmetic.zero})"

    def _define(self, name: str, expression: str, kind: str = "", comment: str = "") -> None:
        note = f" /* {comment} */" if comment else ""
        self.lines.append(f"    const {kind or self._type} {name} = {expression};{note}")

    def _node(self, at: int) -> None:
        op, args, payload = self._function.nodes[at]
        comment = self._function.comments.get(at, "")
        if op in ("const", "input"):
            return
        if op in _TRUTHS:
            self._define(f"b{at}", self._condition(op, args), "bool", comment)
        elif op == "position":
            self._position(at, args[0], payload)
        elif op == "dense":
            self._define(f"v{at}", f"{self._layer(payload.layer, args, at)}[{payload.number}]", comment=comment)
        else:
            self._define(f"v{at}", self._number(at), comment=comment)

    def _condition(self, op: str, args: tuple[int, ...]) -> str:
        if op == "not":
            return f"!{self.truth(args[0])}"
        if op in ("and", "or"):
            return f" {'&&' if op == 'and' else '||'} ".join(self.truth(a) for a in args)
        return f"{self.value(args[0])} {COMPARISONS[op]} {self.value(args[1])}"

    def _number(self, at: int) -> str:
        op, args, payload = self._function.nodes[at]
        match op:
            case "state":
                return self._state(payload)
            case "interpolate":
                return self._table(payload, args)
            case "expansion":
                return self._expansion(payload, args, at)
            case "select":
                return f"{self.truth(args[0])} ? {self.value(args[1])} : {self.value(args[2])}"
            case "pow" if self._is_short_power(args[1]):
                return self._power(args, at)
        return self._arithmetic.elementwise(op, tuple(self.value(a) for a in args), self._functions)

    def _state(self, which: int) -> str:
        latency = self._function.states[which].latency
        return f"s->x{which}" if latency == 1 else f"s->x{which}[s->at{which}]"

    def _is_short_power(self, exponent: int) -> bool:
        op, _, payload = self._function.nodes[exponent]
        return op == "const" and float(payload).is_integer() and abs(payload) <= MAX_SHORT_POWER

    def _power(self, args: tuple[int, ...], at: int) -> str:
        exponent = int(self._function.nodes[args[1]].payload)
        if exponent == 0:
            return self._arithmetic.one
        squares, product = power_products(self.value(args[0]), abs(exponent), f"q{at}")
        for name, expression in squares:
            self._define(name, expression)
        return product if exponent > 0 else f"{self._arithmetic.one} / ({product})"

    def _position(self, at: int, x: int, axis: AxisRef) -> None:
        value, points = self.value(x), self._points(axis)
        count = self._function.axes[axis.number].size
        if count == 1:
            # 0, but NaN for a coordinate that is not finite
            self._define(f"f{at}", f"{value} * {self._arithmetic.zero}")
            return
        self._define(f"i{at}", self._search(value, points, axis), "int32_t")
        share = self._functions("clip" if axis.extrapolation == "clip" else "linear")
        self._define(f"f{at}", f"{share}({value}, {points}, i{at})")

    def _search(self, value: str, points: str, axis: AxisRef) -> str:
        breakpoints = self._function.axes[axis.number]
        density = None if axis.key is not None else even_density(breakpoints)
        arguments = f"{value}, {points}, {breakpoints.size}"
        if density is None:
            return f"{self._functions('find')}({arguments})"
        return f"{self._functions('find_even')}({arguments}, {self._arithmetic.literal(density)})"

    def _points(self, axis: AxisRef) -> str:
        if axis.key is not None:
            return f"p->{self._function.parameter(str(axis.key)).member}"
        return f"{self._function.name}_axis{axis.number}"

    def _table(self, table: TableRef, args: Sequence[int], pointer: str = "p", slope: int | None = None) -> str:
        """Return the lookup in a table of a struct, or its slope along an axis."""
        parameter = self._function.parameter(table.name)
        stored = parameter.stored
        scale = "" if stored is None else f"{self._function.name}_scale_{parameter.member}"
        if not args and stored is not None:
            return f"{self._functions('value')}(({self._type}){pointer}->{parameter.member}, {scale})"
        if not args:
            return f"{pointer}->{parameter.member}"
        sides = "".join("s" if count == 1 else "c" for count in parameter.shape)
        arguments = [f"{pointer}->{parameter.member}"]
        for axis, (place, count) in enumerate(zip(args, parameter.shape, strict=True)):
            arguments += [f"i{place}"] if count > 1 else []
            arguments += [f"f{place}"] if axis != slope else []
            arguments += [str(count)] if counts_points(sides, axis) else []
        arguments += [scale] if scale else []
        return f"{self._functions.lookup(sides, slope, '' if stored is None else stored.kind)}({', '.join(arguments)})"

    def _array(self, name: str, args: Sequence[int]) -> str:
        values = ", ".join(self.value(a) for a in args)
        self.lines.append(f"    const {self._type} {name}[{len(args)}] = {{{values}}};")
        return name

    def _expansion(self, ref: ExpansionRef, args: tuple[int, ...], at: int) -> str:
        x = self._array(f"x{at}", args)
        values = f"p->{self._function.parameter(ref.name).member}"
        return f"{self._functions.expansion(ref.kernel)}({values}, {x}, {ref.inputs}, {ref.centres})"

    def _layer(self, layer: DenseLayer, args: tuple[int, ...], at: int) -> str:
        """Return the array with the outputs of a layer, which are computed at the first of them."""
        if (layer, args) not in self._layers:
            x, y = self._array(f"x{at}", args), f"y{at}"
            self.lines.append(f"    {self._type} {y}[{layer.outputs}];")
            values = f"p->{self._function.parameter(layer.name).member}"
            arguments = f"{values}, {layer.inputs}, {layer.outputs}, {self._alpha(layer)}{x}, {y}"
            self.lines.append(f"    {self._functions.layer(layer.activation)}({arguments});")
            self._layers[layer, args] = y
        return self._layers[layer, args]

    def _alpha(self, layer: DenseLayer) -> str:
        return f"{self._arithmetic.literal(layer.alpha)}, " if layer.activation in WITH_ALPHA else ""


def even_density(breakpoints: Float) -> float | None:
    """Return the number of breakpoints per unit if all are nearer to even places than to their neighbours', else None.

    >>> even_density(np.array([0.0, 10.0, 20.0, 31.0, 40.0, 50.0]))
    0.1
    >>> even_density(np.array([0.0, 1.0, 2.0, 4.0, 8.0, 16.0]))
    """
    cells = breakpoints.size - 1
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        density = float(cells / (breakpoints[-1] - breakpoints[0]))
        apart = np.abs((breakpoints - breakpoints[0]) * density - np.arange(cells + 1))
    return density if cells + 1 >= LEAST_EVEN and density > 0 and bool(np.all(apart < 0.5)) else None
