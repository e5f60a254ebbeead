"""Parts of arrays by their indices: read, assigned with growth, removed. Indices count from 1, columns come first."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.arrays import Int
from kennfeld.matlab.errors import Budget
from kennfeld.matlab.values import Array, MatlabValueError, Value, array_value, numbers

__all__ = ["ALL", "Index", "assign_elements", "index_array", "without"]


class _All:
    """Everything along a dimension."""


ALL = _All()
Index = Value | _All


def index_array(array: Array, indices: Sequence[Index], budget: Budget) -> Array:
    """`array(indices)`, always a copy."""
    if not indices:
        return array
    if len(indices) == 1:
        return _linear(array, indices[0], budget)
    shape = _folded(array.shape, len(indices))
    chosen = [_positions(index, size) for index, size in zip(indices, shape, strict=True)]
    budget.make(math.prod(map(len, chosen)))
    for at, (positions, size) in enumerate(zip(chosen, shape, strict=True)):
        _within(positions, size, f"index {at + 1}")
    return _trimmed(array.reshape(shape, order="F")[np.ix_(*chosen)])


def _linear(array: Array, index: Index, budget: Budget) -> Array:
    positions = _positions(index, array.size)
    budget.make(positions.size)
    _within(positions, array.size, "the index")
    values = array.ravel(order="F")[positions]
    return values.reshape(_shape_of(array, index, positions.size), order="F")


def _shape_of(array: Array, index: Index, count: int) -> tuple[int, ...]:
    """The size of what one index reads: that of the index, unless both are vectors."""
    if isinstance(index, _All):
        return (count, 1)
    given = array_value(index)
    is_mask = given.dtype == np.bool_
    if array.ndim == 2 and array.shape[0] == 1 and array.shape[1] != 1 and _is_vector(given):
        return (1, count)
    if array.ndim == 2 and array.shape[1] == 1 and array.shape[0] != 1 and _is_vector(given):
        return (count, 1)
    if is_mask:
        return (1, count) if given.ndim == 2 and given.shape[0] == 1 else (count, 1)
    return given.shape


def _is_vector(array: Array) -> bool:
    return array.ndim == 2 and 1 in array.shape


def _folded(shape: tuple[int, ...], count: int) -> tuple[int, ...]:
    """A size as so many dimensions; the last index runs over all that are left."""
    if count >= len(shape):
        return shape + (1,) * (count - len(shape))
    return (*shape[: count - 1], math.prod(shape[count - 1 :]))


def _trimmed(array: Array) -> Array:
    """Without trailing dimensions of one element."""
    shape = array.shape
    while len(shape) > 2 and shape[-1] == 1:
        shape = shape[:-1]
    return array.reshape(shape, order="F")


def _positions(index: Index, size: int) -> Int:
    """The positions, from 0, that an index names."""
    if isinstance(index, _All):
        return np.arange(size)
    given = array_value(index)
    if given.dtype.kind == "U" and given.size == 1 and given.flat[0] == ":":
        return np.arange(size)
    if given.dtype == np.bool_:
        return np.flatnonzero(given.ravel(order="F"))
    values = numbers(given).ravel(order="F")
    wrong = values[~((values >= 1) & (values == np.floor(values)) & (values < 2**53))]
    if wrong.size:
        raise MatlabValueError(f"{wrong[0]:g} is no index; indices are whole numbers from 1")
    return values.astype(np.int64) - 1


def _within(positions: Int, size: int, message: str) -> None:
    if positions.size and positions.max() >= size:
        raise MatlabValueError(f"{message} is {positions.max() + 1}, of {size}")


def assign_elements(
    array: Array, indices: Sequence[Index], values: Array, fill: Any, budget: Budget, owned: bool
) -> Array:
    """The array after `array(indices) = values`, grown with `fill` where it has to be.

    Only an array that is `owned` may be changed in place.
    """
    if len(indices) == 1:
        return _replaced_linear(array, indices[0], values, fill, budget, owned)
    shape = array.shape if array.ndim <= len(indices) else _folded(array.shape, len(indices))
    shape = _folded(shape, len(indices))
    sizes = _sizes_for_all(indices, shape, values)
    chosen = [_positions(index, size) for index, size in zip(indices, sizes, strict=True)]
    needed = tuple(
        max(size, int(positions.max()) + 1 if positions.size else 0)
        for size, positions in zip(shape, chosen, strict=True)
    )
    if needed != shape and len(indices) < array.ndim:
        raise MatlabValueError("an array of more dimensions than indices cannot grow")
    grown = _grown(array.reshape(shape, order="F"), needed, fill, budget, owned)
    count = tuple(map(len, chosen))
    target = grown.reshape(needed, order="F")
    target[np.ix_(*chosen)] = values.reshape(-1)[:1] if values.size == 1 else _arranged(values, count)
    return _trimmed(target.reshape(array.shape, order="F") if needed == shape else target)


def _sizes_for_all(indices: Sequence[Index], shape: tuple[int, ...], values: Array) -> list[int]:
    """The length of each dimension; a colon along one that is still empty takes it from the values."""
    waiting = [size for size in values.shape if size != 1] if values.size != 1 else []
    found = []
    for index, size in zip(indices, shape, strict=True):
        if isinstance(index, _All):
            found.append(size if size else (waiting.pop(0) if waiting else 1))
        else:
            count = _positions(index, size).size
            if waiting and waiting[0] == count:
                waiting.pop(0)
            found.append(size)
    return found


def _arranged(values: Array, count: tuple[int, ...]) -> Array:
    """Values in the size in which they are assigned; dimensions of one element do not count."""
    if [size for size in values.shape if size != 1] != [size for size in count if size != 1]:
        sizes = (" x ".join(map(str, shape)) for shape in (values.shape, count))
        raise MatlabValueError("values of size {} do not fit in a part of size {}".format(*sizes))
    return values.reshape(count, order="F")


def _grown(array: Array, shape: tuple[int, ...], fill: Any, budget: Budget, owned: bool) -> Array:
    if shape == array.shape and owned:
        return array
    budget.make(math.prod(shape) - array.size + array.size / (20 if owned else 1))
    made = np.empty(shape, dtype=array.dtype, order="F")
    if shape != array.shape:
        made[...] = _boxed(fill, array)
    made[tuple(slice(size) for size in array.shape)] = array
    return made


def _boxed(fill: Any, array: Array) -> Array:
    """A fill as an array of one element, whatever it is."""
    box = np.empty(1, dtype=array.dtype)
    box[0] = fill
    return box


def _replaced_linear(array: Array, index: Index, values: Array, fill: Any, budget: Budget, owned: bool) -> Array:
    positions = _positions(index, array.size)
    last = int(positions.max()) + 1 if positions.size else 0
    if values.size not in (1, positions.size):
        raise MatlabValueError(f"{values.size} values do not fit in {positions.size} places")
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
    grown = _grown(array, shape, fill, budget, owned)
    taken = values.reshape(-1)[:1] if values.size == 1 else values.ravel(order="F")
    grown[np.unravel_index(positions, shape, order="F")] = taken
    return grown


def without(array: Array, indices: Sequence[Index]) -> Array:
    """The array after `array(indices) = []`."""
    if len(indices) == 1:
        positions = _positions(indices[0], array.size)
        _within(positions, array.size, "the index")
        if array.ndim == 2 and array.shape[1] == 1 and array.shape[0] != 1:
            return np.delete(array, positions, axis=0)
        if isinstance(indices[0], _All):
            return array[:0, :0]
        return np.delete(array.ravel(order="F"), positions).reshape(1, -1)
    shape = _folded(array.shape, len(indices))
    chosen = [_positions(index, size) for index, size in zip(indices, shape, strict=True)]
    partial = [at for at, positions in enumerate(chosen) if len(set(positions.tolist())) < shape[at]]
    if len(partial) > 1:
        raise MatlabValueError("only whole rows or columns can be removed")
    at = partial[0] if partial else next(k for k, index in enumerate(indices) if not isinstance(index, _All))
    _within(chosen[at], shape[at], f"index {at + 1}")
    return np.delete(array.reshape(shape, order="F"), chosen[at], axis=at)
