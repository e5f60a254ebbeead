"""Functions of the bits of whole numbers, in the class of their first argument; doubles count as uint64."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from kennfeld.matlab.functions.elementary import paired
from kennfeld.matlab.functions.numeric_registry import NUMERIC_FUNCTIONS, NumericArguments, NumericFunction, function
from kennfeld.matlab.values import INTEGERS, Array, MatlabValueError, Value, class_name, text

__all__: list[str] = []


@dataclass(frozen=True)
class _Class:
    """An integer class: how many bits, and whether one of them is a sign."""

    bits: int
    signed: bool

    def wrapped(self, number: int) -> int:
        """The number that the lowest bits of another one are."""
        least = -(1 << (self.bits - 1)) if self.signed else 0
        return (number - least) % (1 << self.bits) + least


def _class_of(given: NumericArguments, operands: int = 1) -> tuple[_Class, NumericArguments]:
    """The class whose bits are meant, of an operand or as named, and the arguments without that name."""
    names = [class_name(given.array(at)) for at in range(operands)]
    whole = dict.fromkeys(one for one in names if one in INTEGERS)
    if len(whole) > 1:
        raise MatlabValueError(f"{' and '.join(whole)} cannot be combined")
    name = next(iter(whole), "uint64")
    if len(given) > 1 and given.is_text(len(given) - 1):
        stated = text(given[len(given) - 1])
        if stated not in INTEGERS:
            raise MatlabValueError(f"{stated} is no class of integers")
        name, given = (name if name in names else stated), replace(given, values=given.values[:-1])
    return _Class(int(name.removeprefix("u").removeprefix("int")), not name.startswith("u")), given


def _whole(given: NumericArguments, at: int, kind: _Class) -> Array:
    """An argument as whole numbers of Python."""
    values = given.numbers(at)
    if not (np.isfinite(values) & (values == np.floor(values))).all():
        raise MatlabValueError("whole numbers are needed")
    if not kind.signed and (values < 0).any():
        raise MatlabValueError("bits are those of numbers from 0")
    return np.array([int(one) for one in values.ravel()], dtype=object).reshape(values.shape)


def _applied(given: NumericArguments, operation: Callable[[int, int], int], kind: _Class, operands: int = 1) -> Value:
    one = _whole(given, 0, kind)
    other = _whole(given, 1, replace(kind, signed=True))
    each = np.frompyfunc(lambda a, b: float(kind.wrapped(operation(int(a), int(b)))), 2, 1)
    name = next(
        (class_name(given.array(at)) for at in range(operands) if class_name(given.array(at)) in INTEGERS), "double"
    )
    return paired(given, lambda *_: np.asarray(each(*_deeper(one, other))).astype(np.float64), name)


def _deeper(*arrays: Array) -> list[Array]:
    """Arrays with the same number of dimensions; those that are missing are one long."""
    most = max(array.ndim for array in arrays)
    return [array.reshape(array.shape + (1,) * (most - array.ndim)) for array in arrays]


def _bitwise(operation: Callable[[int, int], int]) -> NumericFunction:
    def run(given: NumericArguments) -> Value:
        kind, given = _class_of(given, 2)
        _whole(given, 1, kind)
        return _applied(given, operation, kind, 2)

    return NumericFunction(run, 2, 3)


NUMERIC_FUNCTIONS["bitand"] = _bitwise(lambda one, other: one & other)
NUMERIC_FUNCTIONS["bitor"] = _bitwise(lambda one, other: one | other)
NUMERIC_FUNCTIONS["bitxor"] = _bitwise(lambda one, other: one ^ other)


def _place(at: int, kind: _Class) -> int:
    if not 1 <= at <= kind.bits:
        raise MatlabValueError(f"the bit {at} is not within 1 to {kind.bits}")
    return at - 1


@function("bitshift", 2, 3)
def _bitshift(given: NumericArguments) -> Value:
    kind, given = _class_of(given)
    return _applied(given, lambda one, by: one << min(by, 64) if by >= 0 else one >> min(-by, 64), kind)


@function("bitget", 2, 3)
def _bitget(given: NumericArguments) -> Value:
    kind, given = _class_of(given)
    return _applied(given, lambda one, at: one >> _place(at, kind) & 1, kind)


@function("bitset", 2, 4)
def _bitset(given: NumericArguments) -> Value:
    kind, given = _class_of(given)
    is_set = len(given) < 3 or bool(given.number(2))
    return _applied(given, lambda one, at: _with_bit(one, _place(at, kind), is_set), kind)


def _with_bit(number: int, at: int, is_set: bool) -> int:
    return number | 1 << at if is_set else number & ~(1 << at)


@function("bitcmp", 1, 2)
def _bitcmp(given: NumericArguments) -> Value:
    kind, given = _class_of(given)
    given = replace(given, values=[given[0], given[0]])
    return _applied(given, lambda one, _: ~one, kind)
