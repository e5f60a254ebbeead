"""Functions of classes: conversions, predicates and limits."""

import math
from collections.abc import Sequence

import numpy as np

from kennfeld.matlab import values as v
from kennfeld.matlab.functions.numeric_registry import MANY, NumericArguments, Run, function
from kennfeld.matlab.operators import cast_to_class, to_logical
from kennfeld.matlab.simulink_types import fixed_point_object

__all__: list[str] = []


def _to(name: str) -> Run:
    def run(call: NumericArguments) -> v.Value:
        if call.is_text(0) and call.array(0).dtype.kind == "O" and name == "double":
            return v.scalar(_parse_number(call.text(0)))
        return cast_to_class(call.numbers(0), name)

    return run


def _parse_number(word: str) -> float:
    try:
        return float(word.replace(",", ""))
    except ValueError:
        return math.nan


for _name in (*v.INTEGERS, "double", "single"):
    function(_name, 1)(_to(_name))


@function("cast", 2)
def _cast(call: NumericArguments) -> v.Value:
    name = call.text(1)
    if name == "logical":
        return to_logical(call.numbers(0))
    if name not in (*v.INTEGERS, "double", "single"):
        raise v.MatlabValueError(f"unknown numeric class {name}")
    return cast_to_class(call.numbers(0), name)


_GROUPS = {"numeric": (*v.INTEGERS, "double", "single"), "float": ("double", "single"), "integer": v.INTEGERS}


@function("isa", 2)
def _isa(call: NumericArguments) -> v.Value:
    name, wanted = v.class_name(call[0]), call.text(1)
    return v.logical(name == wanted or name in _GROUPS.get(wanted, ()))


def _class_test(names: Sequence[str]) -> Run:
    return lambda call: v.logical(v.class_name(call[0]) in names)


for _name, _classes in {
    "isnumeric": _GROUPS["numeric"],
    "isfloat": _GROUPS["float"],
    "isinteger": v.INTEGERS,
    "islogical": ("logical",),
    "ischar": ("char",),
    "isstring": ("string",),
    "iscell": ("cell",),
    "isreal": (*_GROUPS["numeric"], "logical", "char"),
}.items():
    function(_name, 1)(_class_test(_classes))


@function("iscellstr", 1)
def _iscellstr(call: NumericArguments) -> v.Value:
    cell = call[0]
    return v.logical(isinstance(cell, v.MatlabCell) and all(v.class_name(x) == "char" for x in cell.values.ravel()))


@function("eps", 0, 1)
def _eps(call: NumericArguments) -> v.Value:
    if call.is_text(0):
        return v.scalar(float(np.finfo(np.float32 if call.text(0) == "single" else np.float64).eps))
    return np.asarray(np.spacing(np.abs(call.numbers(0)))) if len(call) else v.scalar(float(np.finfo(np.float64).eps))


def _limit_of(name: str) -> Run:
    def run(call: NumericArguments) -> v.Value:
        kind = np.float32 if len(call) and call.text(0) == "single" else np.float64
        return np.array([[getattr(np.finfo(kind), name)]], dtype=kind)

    return run


def _whole_limit(name: str) -> Run:
    def run(call: NumericArguments) -> v.Value:
        of = "int32" if not len(call) else call.text(0) if call.is_text(0) else v.class_name(call[0])
        if of not in v.INTEGERS:
            raise v.MatlabValueError(f"unknown integer class {of}")
        return np.array([[getattr(np.iinfo(of), name)]], dtype=of)

    return run


function("realmax", 0, 1)(_limit_of("max"))
function("realmin", 0, 1)(_limit_of("tiny"))
function("intmax", 0, 1)(_whole_limit("max"))
function("intmin", 0, 1)(_whole_limit("min"))


@function("exist", 1, 2)
def _exist(call: NumericArguments) -> v.Value:
    wanted = call.text(1) if len(call) > 1 else "var"
    return v.scalar(float(wanted == "var" and call.exists(call.text(0))))


@function("isvarname", 1)
def _isvarname(call: NumericArguments) -> v.Value:
    word = call.text(0) if call.is_text(0) else ""
    return v.logical(word.isidentifier() and word.isascii() and not word.startswith("_"))


@function("func2str", 1)
def _func2str(call: NumericArguments) -> v.Value:
    from kennfeld.matlab.printer import format_expression

    handle = call[0]
    if not isinstance(handle, v.MatlabFunctionHandle):
        raise v.MatlabValueError(f"a {v.class_name(handle)} is not a function")
    return v.characters(
        handle.name if handle.body is None else f"@({','.join(handle.parameters)}){format_expression(handle.body)}"
    )


@function("str2func", 1)
def _str2func(call: NumericArguments) -> v.Value:
    word = call.text(0)
    if word.startswith("@"):
        from kennfeld.matlab.parser import parse_expression
        from kennfeld.program.tree import AnonymousFunction

        tree = parse_expression(word, "str2func")
        if isinstance(tree, AnonymousFunction):
            return v.MatlabFunctionHandle("", tree.parameters, tree.body)
    return v.MatlabFunctionHandle(word)


@function("str2double", 1)
def _str2double(call: NumericArguments) -> v.Value:
    if isinstance(call[0], v.MatlabCell):
        elements = call[0].values.ravel(order="F")
        words = [v.text(element) if v.class_name(element) in ("char", "string") else "" for element in elements]
        return np.array([_parse_number(word) for word in words]).reshape(call[0].values.shape, order="F")
    return v.scalar(_parse_number(call.text(0)) if call.is_text(0) else math.nan)


def _in_base(base: int) -> Run:
    def run(call: NumericArguments) -> v.Value:
        word = call.text(0).replace(" ", "")[:64]
        try:
            return v.scalar(float(int(word, base)))
        except ValueError:
            raise v.MatlabValueError(f"{word} is not a number to the base {base}") from None

    return run


function("bin2dec", 1)(_in_base(2))
function("hex2dec", 1)(_in_base(16))
function("logical boolean", 1)(lambda call: to_logical(call.numbers(0)))
function("class", 1)(lambda call: v.characters(v.class_name(call[0])))
function("isstruct", 1)(lambda call: v.logical(isinstance(call[0], v.MatlabStruct) and not call[0].kind))
function("isobject", 1)(lambda call: v.logical(isinstance(call[0], v.MatlabStruct) and bool(call[0].kind)))
function("flintmax", 0)(lambda call: v.scalar(2.0**53))
function("feval", 1, MANY)(lambda call: tuple(call.apply(call[0], call.values[1:], max(call.outputs, 1))))
function("is_function_handle", 1)(lambda call: v.logical(isinstance(call[0], v.MatlabFunctionHandle)))
function("dec2bin", 1, 2)(lambda call: v.characters(f"{call.integer(0):b}".zfill(min(call.integer(1, 0), 64))))
function("dec2hex", 1, 2)(lambda call: v.characters(f"{call.integer(0):X}".zfill(min(call.integer(1, 0), 64))))


@function("fixdt", 1, 20)
def _fixdt(call: NumericArguments) -> v.Value:
    return fixed_point_object(call.values)
