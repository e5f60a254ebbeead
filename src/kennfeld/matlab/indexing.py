"""Indexing of arrays: reading, assignment with growth, deletion. Indices count from 1, in column-major order."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.base.arrays import Int
from kennfeld.base.formatting import size_text
from kennfeld.matlab.errors import Budget
from kennfeld.matlab.values import Array, MatlabValueError, Value, array_value, is_vector, numbers, trim_dimensions


class _All:
    """Everything along a dimension."""


ALL = _All()
Index = Value | _All


def index_array(array: Array, indices: Sequence[Index], budget: Budget) -> Array:
    """Return `array(indices)`, always a copy."""
    if not indices:
        return array
    if len(indices) == 1:
        positions = _positions(indices[0], array.size)
        budget.allocate(positions.size)
        _check_range(positions, array.size, "the index")
        values = array.ravel(order="F")[positions]
        return values.reshape(linear_shape(array, indices[0], positions.size), order="F")
    shape = fold_shape(array.shape, len(indices))
    chosen = [_positions(index, size) for index, size in zip(indices, shape, strict=True)]
    budget.allocate(math.prod(map(len, chosen)))
    for at, (positions, size) in enumerate(zip(chosen, shape, strict=True)):
        _check_range(positions, size, f"index {at + 1}")
    return trim_dimensions(array.reshape(shape, order="F")[np.ix_(*chosen)])


def linear_shape(array: Array, index: Index, count: int) -> tuple[int, ...]:
    """Return the shape of a linear index result: that of the index, unless both are vectors."""
    if isinstance(index, _All):
        return (count, 1)
    indices = array_value(index)
    is_mask = indices.dtype == np.bool_
    if array.ndim == 2 and array.shape[0] == 1 and array.shape[1] != 1 and is_vector(indices):
        return (1, count)
    if array.ndim == 2 and array.shape[1] == 1 and array.shape[0] != 1 and is_vector(indices):
        return (count, 1)
    if is_mask:
        return (1, count) if indices.ndim == 2 and indices.shape[0] == 1 else (count, 1)
    return indices.shape


def fold_shape(shape: tuple[int, ...], count: int) -> tuple[int, ...]:
    """Return a shape as `count` dimensions; the last one combines the remaining ones."""
    if count >= len(shape):
        return shape + (1,) * (count - len(shape))
    return (*shape[: count - 1], math.prod(shape[count - 1 :]))


def _positions(index: Index, size: int) -> Int:
    """Return the positions, from 0, that an index selects."""
    if isinstance(index, _All):
        return np.arange(size)
    indices = array_value(index)
    if indices.dtype.kind == "U" and indices.size == 1 and indices.flat[0] == ":":
        return np.arange(size)
    if indices.dtype == np.bool_:
        return np.flatnonzero(indices.ravel(order="F"))
    values = numbers(indices).ravel(order="F")
    wrong = values[~((values >= 1) & (values == np.floor(values)) & (values < 2**53))]
    if wrong.size:
        raise MatlabValueError(f"indices must be integers >= 1, got {wrong[0]:g}")
    return values.astype(np.int64) - 1


def _check_range(positions: Int, size: int, message: str) -> None:
    if positions.size and positions.max() >= size:
        raise MatlabValueError(f"{message} is {positions.max() + 1}, but the size is {size}")


def assign_elements(
    array: Array, indices: Sequence[Index], values: Array, fill: Any, budget: Budget, owned: bool = False
) -> Array:
    """Return the array after `array(indices) = values`, grown with `fill` if required.

    Only an array that is `owned` may be changed in place.
    """
    if not indices:
        raise MatlabValueError("an index is missing")
    if len(indices) == 1:
        return _assign_linear(array, indices[0], values, fill, budget, owned)
    shape = array.shape if array.ndim <= len(indices) else fold_shape(array.shape, len(indices))
    shape = fold_shape(shape, len(indices))
    sizes = _sizes_for_all(indices, shape, values)
    chosen = [_positions(index, size) for index, size in zip(indices, sizes, strict=True)]
    needed = tuple(
        max(size, int(positions.max()) + 1 if positions.size else 0)
        for size, positions in zip(shape, chosen, strict=True)
    )
    if needed != shape and len(indices) < array.ndim:
        raise MatlabValueError("an array of more dimensions than indices cannot grow")
    grown = _grow(array.reshape(shape, order="F"), needed, fill, budget, owned)
    count = tuple(map(len, chosen))
    target = grown.reshape(needed, order="F")
    target[np.ix_(*chosen)] = values.reshape(-1)[:1] if values.size == 1 else _arrange(values, count)
    return trim_dimensions(target.reshape(array.shape, order="F") if needed == shape else target)


def _sizes_for_all(indices: Sequence[Index], shape: tuple[int, ...], values: Array) -> list[int]:
    """Return the length of each dimension; a colon along an empty one takes it from the values."""
    waiting = [size for size in values.shape if size != 1] if values.size != 1 else []
    sizes = []
    for index, size in zip(indices, shape, strict=True):
        if isinstance(index, _All):
            sizes.append(size if size else (waiting.pop(0) if waiting else 1))
        else:
            count = _positions(index, size).size
            if waiting and waiting[0] == count:
                waiting.pop(0)
            sizes.append(size)
    return sizes


def _arrange(values: Array, count: tuple[int, ...]) -> Array:
    """Reshape values for an assignment; dimensions of length 1 do not count."""
    if [size for size in values.shape if size != 1] != [size for size in count if size != 1]:
        sizes = map(size_text, (values.shape, count))
        raise MatlabValueError("values of size {} cannot be assigned to a part of size {}".format(*sizes))
    return values.reshape(count, order="F")


def _grow(array: Array, shape: tuple[int, ...], fill: Any, budget: Budget, owned: bool) -> Array:
    if shape == array.shape and owned:
        return array
    budget.allocate(math.prod(shape) - array.size + array.size / (20 if owned else 1))
    grown = np.empty(shape, dtype=array.dtype, order="F")
    if shape != array.shape:
        grown[...] = _box(fill, array)
    grown[tuple(slice(size) for size in array.shape)] = array
    return grown


def _box(fill: Any, array: Array) -> Array:
    """Return a fill value as an array of one element."""
    box = np.empty(1, dtype=array.dtype)
    box[0] = fill
    return box


def _assign_linear(array: Array, index: Index, values: Array, fill: Any, budget: Budget, owned: bool) -> Array:
    positions = _positions(index, array.size)
    last = int(positions.max()) + 1 if positions.size else 0
    if values.size not in (1, positions.size):
        raise MatlabValueError(f"{values.size} values cannot be assigned to {positions.size} elements")
    shape = array.shape
    if last > array.size:
        if not array.size:
            shape = (1, last)
        elif array.ndim == 2 and 1 in array.shape:
            shape = (last, 1) if array.shape[1] == 1 and array.shape[0] != 1 else (1, last)
        else:
            raise MatlabValueError("a matrix cannot grow by a single index")
    if not array.size and shape != array.shape:
        array = array.reshape(1, 0)
    grown = _grow(array, shape, fill, budget, owned)
    elements = values.reshape(-1)[:1] if values.size == 1 else values.ravel(order="F")
    grown[np.unravel_index(positions, shape, order="F")] = elements
    return grown


def delete_elements(array: Array, indices: Sequence[Index]) -> Array:
    """Return the array after `array(indices) = []`."""
    if len(indices) == 1:
        positions = _positions(indices[0], array.size)
        _check_range(positions, array.size, "the index")
        if array.ndim == 2 and array.shape[1] == 1 and array.shape[0] != 1:
            return np.delete(array, positions, axis=0)
        if isinstance(indices[0], _All):
            return array[:0, :0]
        return np.delete(array.ravel(order="F"), positions).reshape(1, -1)
    shape = fold_shape(array.shape, len(indices))
    chosen = [_positions(index, size) for index, size in zip(indices, shape, strict=True)]
    partial = [at for at, positions in enumerate(chosen) if len(set(positions.tolist())) < shape[at]]
    if len(partial) > 1:
        raise MatlabValueError("only whole rows or columns can be removed")
    at = partial[0] if partial else next((k for k, index in enumerate(indices) if not isinstance(index, _All)), 0)
    _check_range(chosen[at], shape[at], f"index {at + 1}")
    return np.delete(array.reshape(shape, order="F"), chosen[at], axis=at)
