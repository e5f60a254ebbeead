"""The operators of MATLAB on arrays: implicit expansion, saturating integers, products and quotients of matrices.

Values side by side and below each other: `[a b; c d]`.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.errors import Budget
from kennfeld.matlab.values import (
    EMPTY,
    INTEGERS,
    Array,
    MatlabCell,
    MatlabStruct,
    MatlabValueError,
    Value,
    array_value,
    class_name,
    elements_of,
    numbers,
    object_array,
    row,
    trimmed,
)

__all__ = [
    "binary",
    "cast_to_class",
    "cells",
    "colon_range",
    "concatenate_rows",
    "is_true",
    "joined_along",
    "result_class",
    "transposed",
    "unary",
]

_COMPARED: dict[str, Callable[[Array, Array], Array]] = {
    "==": np.equal,
    "~=": np.not_equal,
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
}
_LOGIC: dict[str, Callable[[Array, Array], Array]] = {"&": np.logical_and, "|": np.logical_or}
_ELEMENTS: dict[str, Callable[[Array, Array], Array]] = {
    "+": np.add,
    "-": np.subtract,
    ".*": np.multiply,
    "./": np.divide,
    ".\\": lambda left, right: np.divide(right, left),
    ".^": lambda left, right: _power(left, right),
}


def binary(operator: str, left: Value, right: Value, budget: Budget) -> Array:
    """The value of `left operator right`; `NoValueError` where there is none."""
    one, other = array_value(left), array_value(right)
    if one.dtype.kind == "O" or other.dtype.kind == "O":
        return _on_strings(operator, one, other)
    name = "double" if operator in _COMPARED or operator in _LOGIC else result_class(one, other)
    with np.errstate(all="ignore"):
        found = _by_operator(operator, numbers(one), numbers(other), budget)
    return found if found.dtype == np.bool_ else cast_to_class(found, name)


def _by_operator(operator: str, one: Float, other: Float, budget: Budget) -> Array:
    if operator in ("*", "/", "\\", "^"):
        simple = one.size == 1 if operator == "\\" else other.size == 1
        if operator in ("*", "^"):
            simple = (one.size == 1 and other.size == 1) if operator == "^" else simple or one.size == 1
        if not simple:
            return _matrices(operator, one, other, budget)
        operator = "." + operator
    if operator in _LOGIC:
        if np.isnan(one).any() or np.isnan(other).any():
            raise MatlabValueError("NaN is neither true nor false")
        return _expanded(_LOGIC[operator], one != 0, other != 0, budget)
    return _expanded((_COMPARED | _ELEMENTS)[operator], one, other, budget)


def _expanded(operation: Callable[[Array, Array], Array], one: Array, other: Array, budget: Budget) -> Array:
    most = max(one.ndim, other.ndim)
    one, other = (array.reshape(array.shape + (1,) * (most - array.ndim)) for array in (one, other))
    try:
        budget.make(math.prod(np.broadcast_shapes(one.shape, other.shape)))
    except ValueError:
        sizes = (" x ".join(map(str, array.shape)) for array in (one, other))
        raise MatlabValueError("the sizes {} and {} do not fit".format(*sizes)) from None
    return operation(one, other)


def _power(left: Float, right: Float) -> Float:
    if np.any((left < 0) & (right != np.floor(right)) & np.isfinite(right)):
        raise MatlabValueError("a root of a negative number is complex")
    return np.power(left, right)


def _matrices(operator: str, one: Float, other: Float, budget: Budget) -> Float:
    if one.ndim > 2 or other.ndim > 2:
        raise MatlabValueError(f"{operator} is for matrices of two dimensions; write .{operator} for their elements")
    if operator == "*":
        _fit(one.shape[1] == other.shape[0], operator, one, other)
        budget.make(one.shape[0] * other.shape[1] + one.size * other.shape[1] / 100)
        return np.asarray(one @ other)
    if operator == "/":
        _fit(one.shape[1] == other.shape[1], operator, one, other)
        return _solved(other.T, one.T, budget).T
    if operator == "\\":
        _fit(one.shape[0] == other.shape[0], operator, one, other)
        return _solved(one, other, budget)
    if one.shape[0] != one.shape[1] or other.size != 1 or other.flat[0] != np.floor(other.flat[0]):
        raise MatlabValueError(
            "^ is for numbers, and for square matrices with a whole exponent; write .^ for their elements"
        )
    exponent = float(other.flat[0])
    if abs(exponent) > 1000:
        raise MatlabValueError(f"the exponent {exponent:g} of a matrix is too large")
    budget.make(one.shape[0] ** 3 / 10)
    return _checked(lambda: np.linalg.matrix_power(one, int(exponent)))


def _fit(fits: bool, operator: str, one: Array, other: Array) -> None:
    if not fits:
        sizes = f"{' x '.join(map(str, one.shape))} and {' x '.join(map(str, other.shape))}"
        remedy = f"; write .{operator} for their elements" if one.shape == other.shape else ""
        raise MatlabValueError(f"matrices of {sizes} do not fit {operator}{remedy}")


def _solved(one: Float, other: Float, budget: Budget) -> Float:
    budget.make(max(one.shape) * one.size / 10)
    if one.shape[0] == one.shape[1]:
        return _checked(lambda: np.linalg.solve(one, other))
    if not (np.isfinite(one).all() and np.isfinite(other).all()):
        return np.full((one.shape[1], other.shape[1]), np.nan)
    return _checked(lambda: np.linalg.lstsq(one, other, rcond=None)[0])


def _checked(solve: Callable[[], Any]) -> Float:
    try:
        return np.asarray(solve(), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise MatlabValueError(f"the matrix cannot be solved ({str(error).lower()})") from None


def _on_strings(operator: str, one: Array, other: Array) -> Array:
    """Strings joined by +, or compared."""
    words = [_words(array) for array in (one, other)]
    if operator == "+":
        made = np.frompyfunc(lambda a, b: a + b, 2, 1)(*words)
        return np.asarray(made, dtype=object)
    if operator in ("==", "~="):
        return np.asarray(_COMPARED[operator](*words), dtype=np.bool_)
    raise MatlabValueError(f"{operator} is not for strings")


def _words(array: Array) -> Array:
    if array.dtype.kind == "O":
        return array
    made = np.empty((1, 1), dtype=object)
    if array.dtype.kind == "U":
        made[0, 0] = "".join(array.ravel(order="F").tolist())
    else:
        made[0, 0] = f"{float(array.flat[0]):.5g}" if array.size == 1 else ""
    return made


def result_class(*operands: Value) -> str:
    """The class of what is made of operands: an integer wins, then single precision."""
    names = {class_name(array_value(operand)) for operand in operands}
    whole = [name for name in names if name in INTEGERS]
    if len(whole) > 1:
        raise MatlabValueError(f"{whole[0]} and {whole[1]} cannot be combined")
    return whole[0] if whole else "single" if "single" in names else "double"


def cast_to_class(values: Float, name: str) -> Array:
    """Numbers in a class; integers are rounded, and stay within their range."""
    if name == "double":
        return values
    if name == "single":
        return values.astype(np.float32)
    limits = np.iinfo(name)
    rounded = np.where(np.isnan(values), 0.0, np.trunc(values + np.copysign(0.5, values)))
    inside = np.clip(rounded, float(limits.min), float(limits.max))
    high = inside >= float(limits.max)
    return np.where(high, np.array(limits.max, dtype=name), np.where(high, 0.0, inside).astype(name))


def unary(operator: str, operand: Value) -> Array:
    """`-x`, `+x` or `~x`."""
    array = array_value(operand)
    if operator == "~":
        values = numbers(array)
        if np.isnan(values).any():
            raise MatlabValueError("NaN is neither true nor false")
        return np.asarray(values == 0)
    values = numbers(array)
    return cast_to_class(-values if operator == "-" else values, result_class(array))


def transposed(array: Array) -> Array:
    """Rows and columns exchanged."""
    if array.ndim > 2:
        raise MatlabValueError("an array of more than two dimensions cannot be transposed")
    return array.T


def is_true(value: Value) -> bool:
    """Whether a condition holds: it is not empty and has no zero."""
    values = numbers(value)
    if np.isnan(values).any():
        raise MatlabValueError("NaN is neither true nor false")
    return bool(values.size) and bool((values != 0).all())


def colon_range(first: Value, step: Value | None, last: Value, budget: Budget) -> Array:
    """`first:step:last`; the last element is never beyond `last`."""
    begin, end = _bound(first), _bound(last)
    width = 1.0 if step is None else _bound(step)
    parts = [first, last] if step is None else [first, step, last]
    name = result_class(*(array_value(part) for part in parts))
    if any(math.isnan(number) for number in (begin, width, end)):
        return cast_to_class(row([math.nan]), name)
    if width == 0 or not (end - begin) * width >= 0:
        return cast_to_class(np.zeros((1, 0)), name)
    if not math.isfinite(begin) or not math.isfinite((end - begin) / width):
        raise MatlabValueError("a range without end")
    ratio = (end - begin) / width
    count = math.floor(ratio + 3e-16 * max(abs(ratio), abs(begin / width), 1.0)) + 1
    budget.make(count)
    made = begin + width * np.arange(count, dtype=np.float64)
    made[-1] = min(made[-1], end) if width > 0 else max(made[-1], end)
    return cast_to_class(row(made), name)


def _bound(value: Value) -> float:
    values = numbers(value)
    if not values.size:
        raise MatlabValueError("a range needs a number at each end, one of them is empty")
    return float(values.flat[0])


def concatenate_rows(rows: Sequence[Sequence[Value]], budget: Budget) -> Value:
    """The matrix of some rows."""
    return joined_along([joined_along(row, 1, budget) for row in rows], 0, budget)


def joined_along(values: Sequence[Value], axis: int, budget: Budget) -> Value:
    """Values along a dimension, in the class that their classes make together."""
    if len(values) == 1:
        return values[0]
    if not values:
        return EMPTY
    if any(isinstance(value, MatlabCell) for value in values):
        parts = [value.values if isinstance(value, MatlabCell) else object_array([value], (1, 1)) for value in values]
        full = [part for value, part in zip(values, parts, strict=True) if not _is_nothing(value)]
        return MatlabCell(_concatenated(full, axis, budget)) if full else MatlabCell(parts[0])
    if any(isinstance(value, MatlabStruct) for value in values) and not _are_numbers(values):
        return _structs([value for value in values if not _is_nothing(value)], axis, budget)
    return _arrays([array_value(value) for value in values], axis, budget)


def cells(rows: Sequence[Sequence[Value]], budget: Budget) -> MatlabCell:
    """The cell array of some rows."""
    made = [object_array(list(row), (1, len(row))) for row in rows]
    return MatlabCell(_concatenated(made, 0, budget)) if made else MatlabCell(np.empty((0, 0), dtype=object))


def _are_numbers(values: Sequence[Value]) -> bool:
    """Whether objects with a value stand beside plain numbers."""
    return any(isinstance(value, np.ndarray) and value.size for value in values)


def _is_nothing(value: Value) -> bool:
    return elements_of(value).shape == (0, 0)


def _arrays(arrays: Sequence[Array], axis: int, budget: Budget) -> Array:
    kinds = {array.dtype.kind for array in arrays}
    if "O" in kinds:
        return _concatenated([_as_strings(array) for array in arrays], axis, budget)
    if kinds == {"b"} or kinds == {"U"}:
        return _concatenated(arrays, axis, budget)
    if "U" in kinds:
        return _concatenated([_as_characters(array) for array in arrays], axis, budget)
    whole = next((class_name(array) for array in arrays if array.dtype.kind in "iu"), "")
    name = whole or result_class(*arrays)
    made = _concatenated([numbers(array) for array in arrays], axis, budget)
    return cast_to_class(made, name)


def _as_strings(array: Array) -> Array:
    if array.dtype.kind == "O":
        return array
    if array.dtype.kind == "U":
        return object_array(["".join(array.ravel(order="F").tolist())], (1, 1))
    return object_array([f"{one:.5g}" for one in array.ravel(order="F").tolist()], array.shape)


def _as_characters(array: Array) -> Array:
    if array.dtype.kind == "U":
        return array
    codes = numbers(array)
    if not ((codes >= 0) & (codes < 0x110000)).all():
        raise MatlabValueError("a number that is no character stands beside a text")
    return np.array([chr(int(code)) for code in codes.ravel(order="F")], dtype="U1").reshape(codes.shape, order="F")


def _concatenated(arrays: Sequence[Array], axis: int, budget: Budget) -> Array:
    kept = [array for array in arrays if array.size] or [max(arrays, key=lambda array: array.shape)]
    budget.make(sum(array.size for array in kept))
    most = max(axis + 1, *(array.ndim for array in kept))
    padded = [array.reshape(array.shape + (1,) * (most - array.ndim)) for array in kept]
    try:
        return trimmed(np.concatenate(padded, axis=axis))
    except ValueError:
        sizes = ", ".join(" x ".join(map(str, array.shape)) for array in kept[:4])
        where = "below each other" if axis == 0 else "side by side"
        raise MatlabValueError(f"arrays of size {sizes} cannot stand {where}") from None


def _structs(values: Sequence[Value], axis: int, budget: Budget) -> Value:
    if not all(isinstance(value, MatlabStruct) for value in values):
        raise MatlabValueError("a struct stands beside something else")
    given = [value for value in values if isinstance(value, MatlabStruct)]
    names = given[0].names
    if any(set(one.names) != set(names) or one.kind != given[0].kind for one in given):
        raise MatlabValueError("structs beside each other have different fields")
    return MatlabStruct(_concatenated([one.elements for one in given], axis, budget), names, given[0].kind)
