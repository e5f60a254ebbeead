"""Functions of classes: conversions, predicates and limits."""

import math
from collections.abc import Callable

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.functions.numeric_registry import (
    MANY,
    NUMERIC_FUNCTIONS,
    NumericArguments,
    NumericFunction,
    function,
)
from kennfeld.matlab.operators import cast_to_class
from kennfeld.matlab.values import (
    INTEGERS,
    Array,
    MatlabCell,
    MatlabFunctionHandle,
    MatlabStruct,
    MatlabValueError,
    Value,
    characters,
    class_name,
    logical,
    scalar,
    text,
)

__all__: list[str] = []


def _to(name: str) -> Callable[[NumericArguments], Value]:
    def run(call: NumericArguments) -> Value:
        if call.is_text(0) and call.array(0).dtype.kind == "O" and name == "double":
            return scalar(_parse_number(call.text(0)))
        return cast_to_class(call.numbers(0), name)

    return run


def _parse_number(word: str) -> float:
    try:
        return float(word.replace(",", ""))
    except ValueError:
        return math.nan


for _name in (*INTEGERS, "double", "single"):
    NUMERIC_FUNCTIONS[_name] = NumericFunction(_to(_name), 1, 1)


@function("logical boolean", 1)
def _logical(call: NumericArguments) -> Value:
    return _to_logical(call.numbers(0))


def _to_logical(values: Float) -> Array:
    if np.isnan(values).any():
        raise MatlabValueError("NaN is neither true nor false")
    return np.asarray(values != 0)


@function("cast", 2)
def _cast(call: NumericArguments) -> Value:
    name = call.text(1)
    if name == "logical":
        return _to_logical(call.numbers(0))
    if name not in (*INTEGERS, "double", "single"):
        raise MatlabValueError(f"unknown numeric class {name}")
    return cast_to_class(call.numbers(0), name)


@function("class", 1)
def _class(call: NumericArguments) -> Value:
    return characters(class_name(call[0]))


_GROUPS = {"numeric": (*INTEGERS, "double", "single"), "float": ("double", "single"), "integer": INTEGERS}


@function("isa", 2)
def _isa(call: NumericArguments) -> Value:
    name, wanted = class_name(call[0]), call.text(1)
    return logical(name == wanted or name in _GROUPS.get(wanted, ()))


def _class_test(*names: str) -> NumericFunction:
    return NumericFunction(lambda call: logical(class_name(call[0]) in names), 1, 1)


for _name, _classes in {
    "isnumeric": _GROUPS["numeric"],
    "isfloat": _GROUPS["float"],
    "isinteger": INTEGERS,
    "islogical": ("logical",),
    "ischar": ("char",),
    "isstring": ("string",),
    "iscell": ("cell",),
    "isreal": (*_GROUPS["numeric"], "logical", "char"),
}.items():
    NUMERIC_FUNCTIONS[_name] = _class_test(*_classes)


@function("isstruct", 1)
def _isstruct(call: NumericArguments) -> Value:
    return logical(isinstance(call[0], MatlabStruct) and not call[0].kind)


@function("isobject", 1)
def _isobject(call: NumericArguments) -> Value:
    return logical(isinstance(call[0], MatlabStruct) and bool(call[0].kind))


@function("iscellstr", 1)
def _iscellstr(call: NumericArguments) -> Value:
    cell = call[0]
    return logical(isinstance(cell, MatlabCell) and all(class_name(x) == "char" for x in cell.values.ravel()))


@function("eps", 0, 1)
def _eps(call: NumericArguments) -> Value:
    if call.is_text(0):
        return scalar(float(np.finfo(np.float32 if call.text(0) == "single" else np.float64).eps))
    return np.asarray(np.spacing(np.abs(call.numbers(0)))) if len(call) else scalar(float(np.finfo(np.float64).eps))


def _limit_of(name: str) -> NumericFunction:
    def run(call: NumericArguments) -> Value:
        kind = np.float32 if len(call) and call.text(0) == "single" else np.float64
        return np.array([[getattr(np.finfo(kind), name)]], dtype=kind)

    return NumericFunction(run, 0, 1)


def _whole_limit(name: str) -> NumericFunction:
    def run(call: NumericArguments) -> Value:
        of = "int32" if not len(call) else call.text(0) if call.is_text(0) else class_name(call[0])
        if of not in INTEGERS:
            raise MatlabValueError(f"unknown integer class {of}")
        return np.array([[getattr(np.iinfo(of), name)]], dtype=of)

    return NumericFunction(run, 0, 1)


NUMERIC_FUNCTIONS["realmax"], NUMERIC_FUNCTIONS["realmin"] = _limit_of("max"), _limit_of("tiny")
NUMERIC_FUNCTIONS["intmax"], NUMERIC_FUNCTIONS["intmin"] = _whole_limit("max"), _whole_limit("min")


@function("flintmax", 0)
def _flintmax(call: NumericArguments) -> Value:
    return scalar(2.0**53)


@function("exist", 1, 2)
def _exist(call: NumericArguments) -> Value:
    wanted = call.text(1) if len(call) > 1 else "var"
    return scalar(float(wanted == "var" and call.exists(call.text(0))))


@function("isvarname", 1)
def _isvarname(call: NumericArguments) -> Value:
    word = call.text(0) if call.is_text(0) else ""
    return logical(word.isidentifier() and word.isascii() and not word.startswith("_"))


@function("feval", 1, MANY)
def _feval(call: NumericArguments) -> tuple[Value, ...]:
    return tuple(call.apply(call[0], call.values[1:], max(call.outputs, 1)))


@function("func2str", 1)
def _func2str(call: NumericArguments) -> Value:
    from kennfeld.matlab.printer import format_expression

    handle = call[0]
    if not isinstance(handle, MatlabFunctionHandle):
        raise MatlabValueError(f"a {class_name(handle)} is not a function")
    return characters(
        handle.name if handle.body is None else f"@({','.join(handle.parameters)}){format_expression(handle.body)}"
    )


@function("str2func", 1)
def _str2func(call: NumericArguments) -> Value:
    word = call.text(0)
    if word.startswith("@"):
        from kennfeld.matlab.parser import parse_expression
        from kennfeld.matlab.syntax import AnonymousFunction

        tree = parse_expression(word, "str2func")
        if isinstance(tree, AnonymousFunction):
            return MatlabFunctionHandle("", tree.parameters, tree.body)
    return MatlabFunctionHandle(word)


@function("is_function_handle", 1)
def _is_function_handle(call: NumericArguments) -> Value:
    return logical(isinstance(call[0], MatlabFunctionHandle))


@function("str2double", 1)
def _str2double(call: NumericArguments) -> Value:
    if isinstance(call[0], MatlabCell):
        elements = call[0].values.ravel(order="F")
        words = [text(element) if class_name(element) in ("char", "string") else "" for element in elements]
        return np.array([_parse_number(word) for word in words]).reshape(call[0].values.shape, order="F")
    return scalar(_parse_number(call.text(0)) if call.is_text(0) else math.nan)


@function("dec2bin", 1, 2)
def _dec2bin(call: NumericArguments) -> Value:
    return characters(f"{call.integer(0):b}".zfill(min(call.integer(1, 0), 64)))


@function("dec2hex", 1, 2)
def _dec2hex(call: NumericArguments) -> Value:
    return characters(f"{call.integer(0):X}".zfill(min(call.integer(1, 0), 64)))


def _in_base(base: int) -> Callable[[NumericArguments], Value]:
    def run(call: NumericArguments) -> Value:
        word = call.text(0).replace(" ", "")[:64]
        try:
            return scalar(float(int(word, base)))
        except ValueError:
            raise MatlabValueError(f"{word} is not a number to the base {base}") from None

    return run


NUMERIC_FUNCTIONS["bin2dec"], NUMERIC_FUNCTIONS["hex2dec"] = (
    NumericFunction(_in_base(2), 1, 1),
    NumericFunction(_in_base(16), 1, 1),
)
