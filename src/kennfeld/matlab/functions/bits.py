"""Bitwise functions on integers, in the class of their first argument; doubles count as uint64."""

import operator
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.matlab.functions.elementary import apply_pairwise
from kennfeld.matlab.functions.numeric_registry import NumericArguments, Run, function
from kennfeld.matlab.operators import pad_dimensions
from kennfeld.matlab.values import INTEGERS, Array, MatlabValueError, Value, class_name, text

__all__: list[str] = []


@dataclass(frozen=True)
class _Class:
    """An integer class: its number of bits, and its signedness."""

    bits: int
    signed: bool

    def wrapped(self, number: int) -> int:
        """Return a number modulo the range of the class."""
        lowest = -(1 << (self.bits - 1)) if self.signed else 0
        return (number - lowest) % (1 << self.bits) + lowest


def _class_of(call: NumericArguments, operands: int = 1) -> tuple[_Class, NumericArguments]:
    """Return the class of the operands or the named one, and the arguments without that name."""
    names = [class_name(call.array(at)) for at in range(operands)]
    integers = dict.fromkeys(item for item in names if item in INTEGERS)
    if len(integers) > 1:
        raise MatlabValueError(f"{' and '.join(integers)} cannot be combined")
    name = next(iter(integers), "uint64")
    if len(call) > 1 and call.is_text(len(call) - 1):
        stated = text(call[len(call) - 1])
        if stated not in INTEGERS:
            raise MatlabValueError(f"unknown integer class {stated}")
        name, call = (name if name in names else stated), replace(call, values=call.values[:-1])
    return _Class(int(name.removeprefix("u").removeprefix("int")), not name.startswith("u")), call


def _to_integers(call: NumericArguments, at: int, kind: _Class) -> Array:
    """Return an argument as Python integers."""
    values = call.numbers(at)
    if not (np.isfinite(values) & (values == np.floor(values))).all():
        raise MatlabValueError("arguments must be integers")
    if not kind.signed and (values < 0).any():
        raise MatlabValueError("arguments must be >= 0")
    return np.array([int(value) for value in values.ravel()], dtype=object).reshape(values.shape)


def _apply_bits(call: NumericArguments, operation: Callable[[int, int], int], kind: _Class, operands: int = 1) -> Value:
    left = _to_integers(call, 0, kind)
    right = _to_integers(call, 1, replace(kind, signed=True))
    each = np.frompyfunc(lambda a, b: float(kind.wrapped(operation(int(a), int(b)))), 2, 1)
    names = [class_name(call.array(at)) for at in range(operands)]
    name = next((name for name in names if name in INTEGERS), "double")
    return apply_pairwise(call, lambda *_: np.asarray(each(*pad_dimensions(left, right))).astype(np.float64), name)


def _bitwise(operation: Callable[[int, int], int]) -> Run:
    def run(call: NumericArguments) -> Value:
        kind, call = _class_of(call, 2)
        _to_integers(call, 1, kind)
        return _apply_bits(call, operation, kind, 2)

    return run


function("bitand", 2, 3)(_bitwise(operator.and_))
function("bitor", 2, 3)(_bitwise(operator.or_))
function("bitxor", 2, 3)(_bitwise(operator.xor))


def _place(at: int, kind: _Class) -> int:
    if not 1 <= at <= kind.bits:
        raise MatlabValueError(f"the bit number must be between 1 and {kind.bits}, got {at}")
    return at - 1


@function("bitshift", 2, 3)
def _bitshift(call: NumericArguments) -> Value:
    kind, call = _class_of(call)
    return _apply_bits(call, lambda bits, by: bits << min(by, 64) if by >= 0 else bits >> min(-by, 64), kind)


@function("bitget", 2, 3)
def _bitget(call: NumericArguments) -> Value:
    kind, call = _class_of(call)
    return _apply_bits(call, lambda bits, at: bits >> _place(at, kind) & 1, kind)


@function("bitset", 2, 4)
def _bitset(call: NumericArguments) -> Value:
    kind, call = _class_of(call)
    is_set = len(call) < 3 or bool(call.number(2))
    return _apply_bits(call, lambda bits, at: bits & ~(1 << _place(at, kind)) | is_set << _place(at, kind), kind)


@function("bitcmp", 1, 2)
def _bitcmp(call: NumericArguments) -> Value:
    kind, call = _class_of(call)
    call = replace(call, values=[call[0], call[0]])
    return _apply_bits(call, lambda bits, _: ~bits, kind)
