"""Values side by side and below each other: `[a b; c d]`."""

from collections.abc import Sequence

import numpy as np

from kennfeld.matlab.arithmetic import as_class, result_class
from kennfeld.matlab.budget import Budget
from kennfeld.matlab.values import (
    EMPTY,
    Array,
    Cell,
    NoValueError,
    Struct,
    Value,
    class_of,
    data_of,
    numbers,
    object_array,
    plain,
    trimmed,
)

__all__ = ["cells", "joined", "joined_along"]


def joined(rows: Sequence[Sequence[Value]], budget: Budget) -> Value:
    """The matrix of some rows."""
    return joined_along([joined_along(row, 1, budget) for row in rows], 0, budget)


def joined_along(values: Sequence[Value], axis: int, budget: Budget) -> Value:
    """Values along a dimension, in the class that their classes make together."""
    if len(values) == 1:
        return values[0]
    if not values:
        return EMPTY
    if any(isinstance(value, Cell) for value in values):
        parts = [value.values if isinstance(value, Cell) else object_array([value], (1, 1)) for value in values]
        full = [part for value, part in zip(values, parts, strict=True) if not _is_nothing(value)]
        return Cell(_concatenated(full, axis, budget)) if full else Cell(parts[0])
    if any(isinstance(value, Struct) for value in values) and not _are_numbers(values):
        return _structs([value for value in values if not _is_nothing(value)], axis, budget)
    return _arrays([plain(value) for value in values], axis, budget)


def cells(rows: Sequence[Sequence[Value]], budget: Budget) -> Cell:
    """The cell array of some rows."""
    made = [object_array(list(row), (1, len(row))) for row in rows]
    return Cell(_concatenated(made, 0, budget)) if made else Cell(np.empty((0, 0), dtype=object))


def _are_numbers(values: Sequence[Value]) -> bool:
    """Whether objects with a value stand beside plain numbers."""
    return any(isinstance(value, np.ndarray) and value.size for value in values)


def _is_nothing(value: Value) -> bool:
    return data_of(value).shape == (0, 0)


def _arrays(arrays: Sequence[Array], axis: int, budget: Budget) -> Array:
    kinds = {array.dtype.kind for array in arrays}
    if "O" in kinds:
        return _concatenated([_as_strings(array) for array in arrays], axis, budget)
    if kinds == {"b"} or kinds == {"U"}:
        return _concatenated(arrays, axis, budget)
    if "U" in kinds:
        return _concatenated([_as_characters(array) for array in arrays], axis, budget)
    whole = next((class_of(array) for array in arrays if array.dtype.kind in "iu"), "")
    name = whole or result_class(*arrays)
    made = _concatenated([numbers(array) for array in arrays], axis, budget)
    return as_class(made, name)


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
        raise NoValueError("a number that is no character stands beside a text")
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
        raise NoValueError(f"arrays of size {sizes} cannot stand {where}") from None


def _structs(values: Sequence[Value], axis: int, budget: Budget) -> Value:
    if not all(isinstance(value, Struct) for value in values):
        raise NoValueError("a struct stands beside something else")
    given = [value for value in values if isinstance(value, Struct)]
    names = given[0].names
    if any(set(one.names) != set(names) or one.kind != given[0].kind for one in given):
        raise NoValueError("structs beside each other have different fields")
    return Struct(_concatenated([one.elements for one in given], axis, budget), names, given[0].kind)
