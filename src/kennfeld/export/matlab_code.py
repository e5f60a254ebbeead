"""A function of MATLAB that computes one step, and one that returns the calibration."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import product
from math import isinf, isnan
from typing import TypeVar

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.export.c_arithmetic import MAX_SHORT_POWER, power_products
from kennfeld.export.matlab_functions import FUNCTIONS, OF_REAL_NUMBERS, MatlabFunctions
from kennfeld.export.prepared import ExportedSignal, ParameterValues, PreparedFunction
from kennfeld.graph.dense_layer import DenseLayer
from kennfeld.graph.lookup_lowering import AxisRef, ExpansionRef, TableRef

_CONDITIONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "~="}
_TRUTHS = (*_CONDITIONS, "and", "or", "not")
_KEYWORDS = ("classdef", "elseif", "end", "function", "global", "otherwise", "parfor", "persistent", "spmd")
_BINARY = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
_OWN = {"min": "lesser", "max": "greater", "mod": "remainder"}
_UNCHANGED = (
    *("floor", "ceil", "exp", "sin", "cos", "tan", "atan", "atan2", "sinh", "cosh", "tanh", "erf", "erfc", "abs"),
    *("round", "sign"),
)
# what the code calls, its local functions included
_CALLED = (
    *(*_UNCHANGED, *OF_REAL_NUMBERS, *FUNCTIONS, "first_values"),
    *("double", "single", "true", "false", "NaN", "Inf", "isempty", "nargin", "numel", "sum", "expm1"),
    *("struct", "repmat", "reshape"),
)

Named = TypeVar("Named", ExportedSignal, ParameterValues)


def write_matlab(function: PreparedFunction) -> dict[str, str]:
    """Return the texts of both files by their names."""
    function, functions = _renamed(function), MatlabFunctions()
    name, step = function.name, _MatlabWriter(function, functions)
    body = step.body()
    used = functions.text
    if function.states:
        lines = _MatlabWriter(function, functions).start()
        used = functions.text + "\n" + "\n".join(lines) + "\n"
    head = f"function [y, s] = {name}(u, s, p)"
    text = "\n".join([head, *_help(function), *body, "end"]) + "\n" + used
    return {f"{name}.m": text, f"{name}_defaults.m": _defaults(function)}


def _renamed(function: PreparedFunction) -> PreparedFunction:
    """Return the function without names that are keywords of MATLAB alone, and not named as one that it calls."""

    def allowed(signals: Sequence[Named]) -> tuple[Named, ...]:
        taken = {signal.member for signal in signals}
        return tuple(replace(each, member=_free_name(each.member, _KEYWORDS, taken)) for each in signals)

    return replace(
        function,
        # a file of the name of a function that its own code calls would call itself instead
        name=_free_name(function.name, (*_KEYWORDS, *_CALLED), set()),
        inputs=allowed(function.inputs),
        outputs=allowed(function.outputs),
        parameters=allowed(function.parameters),
    )


def _free_name(name: str, reserved: Collection[str], taken: Collection[str]) -> str:
    """Return a name that is not reserved; another one than those that are taken, if it changes."""
    if name not in reserved:
        return name
    free = f"{name}_"
    while free in reserved or free in taken:
        free += "_"
    return free


def _help(function: PreparedFunction) -> list[str]:
    name = function.name
    lines = [
        f"%{name.upper()}  {_plain(function.title)}, exported by Kennfeld",
        f"%   [y, s] = {name}(u, s, p) computes one sample. s is the memory: [] for the first sample, then what the",
        f"%   call before returned. p is the calibration, by default {name}_defaults().",
        "%",
        *(f"%   u.{_described(signal)}" for signal in function.inputs),
        *(f"%   y.{_described(signal)}" for signal in function.outputs),
        "%#codegen",
    ]
    defaults = ["if nargin < 3", f"    p = {name}_defaults();", "end"]
    memory = ["if isempty(s)", "    s = first_values(u, p);", "end"]
    nothing = ["if nargin < 2", "    s = [];", "end"]
    return [*lines, *defaults, *(memory if function.states else nothing)]


def _described(signal: ExportedSignal) -> str:
    parts = [signal.member, *([signal.name] if signal.name != signal.member else []), signal.remark]
    text = ", ".join(part for part in parts if part)
    return _plain(f"{text} [{signal.unit}]" if signal.unit else text)


def _plain(text: str) -> str:
    return " ".join(text.split())


def _number(value: float) -> str:
    if isnan(value):
        return "NaN"
    if isinf(value):
        return "-Inf" if value < 0 else "Inf"
    return repr(float(value))


def _operand(value: float) -> str:
    text = _number(value)
    return f"({text})" if text.startswith("-") else text


def _defaults(function: PreparedFunction) -> str:
    name = function.name
    title = f"%{name.upper()}_DEFAULTS  Calibration of {name}; rows of maps belong to x"
    lines = [f"function p = {name}_defaults()", title, "p = struct();"]
    for parameter in function.parameters:
        note = f" % {_plain(parameter.name)}" + (f" [{parameter.unit}]" if parameter.unit else "")
        lines.append(f"p.{parameter.member} = {_array(parameter.values)};{note}")
    return "\n".join([*lines, "end"]) + "\n"


def _array(values: Float) -> str:
    if values.ndim == 0:
        return _number(float(values))
    rows = values.reshape(1, -1) if values.ndim != 2 else values
    text = "; ".join(", ".join(map(_number, row)) for row in rows.tolist())
    if values.ndim <= 2:
        return f"[{text}]"
    # the first dimension is the fastest one in MATLAB
    column = ", ".join(map(_number, np.ravel(values, order="F").tolist()))
    return f"reshape([{column}], [{', '.join(map(str, values.shape))}])"


class _MatlabWriter:
    """Writes the statements of nodes."""

    def __init__(self, function: PreparedFunction, functions: MatlabFunctions) -> None:
        self._function, self._functions = function, functions
        self._layers: dict[tuple[DenseLayer, tuple[int, ...]], str] = {}
        self._lines: list[str] = []

    def body(self) -> list[str]:
        """Return the statements of a step, outputs and next memory included."""
        function = self._function
        for at in function.step_order:
            self._node(at)
        lines = [*self._lines]
        for signal, root in zip(function.outputs, function.roots, strict=True):
            lines.append(f"y.{signal.member} = {self._value(root)};")
        for which, state in enumerate(function.states):
            value = self._value(state.next)
            if state.latency == 1:
                lines.append(f"s.x{which} = {value};")
            else:
                lines.append(f"s.x{which} = [s.x{which}(2:end), {value}];")
        return lines

    def start(self) -> list[str]:
        """Return the function of the first values of the memory."""
        function = self._function
        for at in function.start_order:
            self._node(at)
        lines = ["function s = first_values(u, p) %#ok<INUSD>", *self._lines, "s = struct();"]
        for which, (state, at) in enumerate(zip(function.states, function.starts, strict=True)):
            value = self._value(at)
            held = value if state.latency == 1 else f"repmat({value}, 1, {state.latency})"
            lines.append(f"s.x{which} = {held};")
        return [*lines, "end"]

    def _value(self, at: int) -> str:
        op, _, payload = self._function.nodes[at]
        if op == "const":
            return _operand(payload)
        if op == "input":
            return f"u.{self._function.input_member(payload)}"
        return f"double(b{at})" if op in _TRUTHS else f"v{at}"

    def _truth(self, at: int) -> str:
        op, _, payload = self._function.nodes[at]
        if op == "const":
            return "true" if payload != 0 else "false"
        return f"b{at}" if op in _TRUTHS else f"({self._value(at)} ~= 0)"

    def _node(self, at: int) -> None:
        op, args, payload = self._function.nodes[at]
        comment = self._function.comments.get(at, "")
        note = f" % {_plain(comment)}" if comment else ""
        if op in ("const", "input"):
            return
        if op in _TRUTHS:
            self._lines.append(f"b{at} = {self._condition(op, args)};{note}")
        elif op == "position":
            self._position(at, args[0], payload)
        else:
            self._lines.append(f"v{at} = {self._expression(at)};{note}")

    def _condition(self, op: str, args: tuple[int, ...]) -> str:
        if op == "not":
            return f"~{self._truth(args[0])}"
        if op in ("and", "or"):
            return f" {'&&' if op == 'and' else '||'} ".join(self._truth(a) for a in args)
        return f"{self._value(args[0])} {_CONDITIONS[op]} {self._value(args[1])}"

    def _expression(self, at: int) -> str:
        op, args, payload = self._function.nodes[at]
        call = self._functions
        match op:
            case "state":
                return f"s.x{payload}" if self._function.states[payload].latency == 1 else f"s.x{payload}(1)"
            case "interpolate":
                return self._table(payload, args)
            case "expansion":
                return self._expansion(payload, args)
            case "dense":
                return f"{self._layer(payload.layer, args, at)}({payload.number + 1})"
            case "select":
                return f"{call('choose')}({self._truth(args[0])}, {self._value(args[1])}, {self._value(args[2])})"
            case "pow" if self._is_short_power(args[1]):
                return self._power(args, at)
        return self._elementwise(op, [self._value(a) for a in args])

    def _elementwise(self, op: str, args: Sequence[str]) -> str:
        call = self._functions
        if op in _BINARY:
            return f"{args[0]} {_BINARY[op]} {args[1]}"
        if op == "neg":
            return f"-{args[0]}"
        if op == "guard":
            return f"{call('part')}({args[0]}, {args[1]})"
        if op == "single":
            return f"double(single({args[0]}))"
        if op == "pow":
            return f"{call('real_power')}({args[0]}, {args[1]})"
        name = call(_OWN[op]) if op in _OWN else op
        name = call(f"real_{op}") if op in OF_REAL_NUMBERS else name
        assert op in _UNCHANGED or op in _OWN or op in OF_REAL_NUMBERS
        return f"{name}({', '.join(args)})"

    def _is_short_power(self, exponent: int) -> bool:
        op, _, payload = self._function.nodes[exponent]
        return op == "const" and float(payload).is_integer() and abs(payload) <= MAX_SHORT_POWER

    def _power(self, args: tuple[int, ...], at: int) -> str:
        exponent = int(self._function.nodes[args[1]].payload)
        if exponent == 0:
            return "1"
        squares, result = power_products(self._value(args[0]), abs(exponent), f"q{at}")
        self._lines += [f"{name} = {expression};" for name, expression in squares]
        return result if exponent > 0 else f"1 / ({result})"

    def _position(self, at: int, x: int, axis: AxisRef) -> None:
        value, points = self._value(x), self._function.axes[axis.number]
        if points.size == 1:
            self._lines.append(f"f{at} = {value} * 0;")
            return
        if axis.key is not None:
            name = f"p.{self._function.parameter(str(axis.key)).member}"
        else:
            name = f"axis{axis.number}"
            definition = f"{name} = {_array(points)};"
            self._lines += [] if definition in self._lines else [definition]
        self._lines.append(f"i{at} = {self._functions('cell_of')}({value}, {name});")
        share = self._functions("clip" if axis.extrapolation == "clip" else "linear")
        self._lines.append(f"f{at} = {share}({value}, {name}, i{at});")

    def _table(self, table: TableRef, args: Sequence[int]) -> str:
        parameter = self._function.parameter(table.name)
        if not args:
            return f"p.{parameter.member}"
        part = self._functions("part")
        sides = []
        for place, count in zip(args, parameter.shape, strict=True):
            # grid points with their weights
            if count == 1:
                sides.append([("1", f"(1 + f{place} * 0)")])
            else:
                sides.append([(f"i{place}", f"(1 - f{place})"), (f"i{place} + 1", f"f{place}")])
        terms = []
        for corner in product(*sides):
            weight = " * ".join(weight for _, weight in corner)
            terms.append(f"{part}({weight}, p.{parameter.member}({', '.join(at for at, _ in corner)}))")
        return " + ".join(terms)

    def _expansion(self, ref: ExpansionRef, args: Sequence[int]) -> str:
        values = f"p.{self._function.parameter(ref.name).member}"
        x = f"[{', '.join(self._value(a) for a in args)}]"
        return f"{self._functions(f'expand_{ref.kernel}')}({values}, {x}, {ref.centres})"

    def _layer(self, layer: DenseLayer, args: tuple[int, ...], at: int) -> str:
        if (layer, args) not in self._layers:
            x = f"[{', '.join(self._value(a) for a in args)}]"
            values = f"p.{self._function.parameter(layer.name).member}"
            name = self._functions(f"layer_{layer.activation}")
            self._lines.append(f"y{at} = {name}({values}, {x}, {_number(layer.alpha)});")
            self._layers[layer, args] = f"y{at}"
        return self._layers[layer, args]
