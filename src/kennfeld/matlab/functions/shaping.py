"""Functions that tell or change the size and order of arrays."""

import math

import numpy as np

from kennfeld.matlab.arithmetic import transposed
from kennfeld.matlab.functions.making import shape_from
from kennfeld.matlab.functions.registry import MANY, Arguments, function
from kennfeld.matlab.joining import joined_along
from kennfeld.matlab.values import Array, NoValueError, Value, like, logical, numbers, row, scalar


@function("size", 1, 2)
def _size(given: Arguments) -> "Value | tuple[Value, ...]":
    shape = given.data(0).shape
    if len(given) > 1:
        if any(at < 1 or at != math.floor(at) for at in given.numbers(1).ravel(order="F")):
            raise NoValueError("a dimension has to be a whole number from 1")
        wanted = [int(at) for at in given.numbers(1).ravel(order="F")]
        return row([shape[at - 1] if at <= len(shape) else 1 for at in wanted])
    if given.outputs < 2:
        return row(shape)
    padded = (*shape, *(1 for _ in range(given.outputs - len(shape))))
    last = math.prod(padded[given.outputs - 1 :])
    return tuple(scalar(size) for size in (*padded[: given.outputs - 1], last))


@function("numel", 1)
def _numel(given: Arguments) -> Value:
    return scalar(given.data(0).size)


@function("length", 1)
def _length(given: Arguments) -> Value:
    return scalar(max(given.data(0).shape) if given.data(0).size else 0)


@function("ndims", 1)
def _ndims(given: Arguments) -> Value:
    return scalar(given.data(0).ndim)


@function("height", 1)
def _height(given: Arguments) -> Value:
    return scalar(given.data(0).shape[0])


@function("width", 1)
def _width(given: Arguments) -> Value:
    return scalar(given.data(0).shape[1])


@function("isempty", 1)
def _isempty(given: Arguments) -> Value:
    return logical(not given.data(0).size)


@function("isscalar", 1)
def _isscalar(given: Arguments) -> Value:
    return logical(given.data(0).size == 1)


@function("isvector", 1)
def _isvector(given: Arguments) -> Value:
    data = given.data(0)
    return logical(data.ndim == 2 and 1 in data.shape)


@function("isrow", 1)
def _isrow(given: Arguments) -> Value:
    return logical(given.data(0).ndim == 2 and given.data(0).shape[0] == 1)


@function("iscolumn", 1)
def _iscolumn(given: Arguments) -> Value:
    return logical(given.data(0).ndim == 2 and given.data(0).shape[1] == 1)


@function("ismatrix", 1)
def _ismatrix(given: Arguments) -> Value:
    return logical(given.data(0).ndim == 2)


@function("reshape", 2, MANY)
def _reshape(given: Arguments) -> Value:
    data, sizes = given.data(0), list(given.values[1:])
    empty = [at for at, size in enumerate(sizes) if not numbers(size).size]
    if len(empty) == 1 and len(sizes) > 1:
        known = math.prod(float(numbers(size).flat[0]) for size in sizes if numbers(size).size)
        sizes[empty[0]] = scalar(data.size / known if known else 0)
    shape = shape_from(sizes)
    if len(sizes) == 1 and numbers(sizes[0]).size == 1:
        raise NoValueError("a size needs two numbers")
    if math.prod(shape) != data.size:
        raise NoValueError(f"{data.size} elements do not fill {' x '.join(map(str, shape))}")
    given.budget.make(data.size)
    return like(given[0], data.reshape(shape, order="F"))


@function("horzcat", 0, MANY)
def _horzcat(given: Arguments) -> Value:
    return joined_along(given.values, 1, given.budget)


@function("vertcat", 0, MANY)
def _vertcat(given: Arguments) -> Value:
    return joined_along(given.values, 0, given.budget)


@function("cat", 1, MANY)
def _cat(given: Arguments) -> Value:
    axis = given.whole(0)
    if not 1 <= axis <= 32:
        raise NoValueError(f"{axis} is no dimension")
    return joined_along(given.values[1:], axis - 1, given.budget)


@function("fliplr", 1)
def _fliplr(given: Arguments) -> Value:
    return like(given[0], np.flip(given.data(0), 1))


@function("flipud", 1)
def _flipud(given: Arguments) -> Value:
    return like(given[0], np.flip(given.data(0), 0))


@function("flip", 1, 2)
def _flip(given: Arguments) -> Value:
    data = given.data(0)
    axis = given.dimension(1, data)
    return like(given[0], np.flip(data, axis) if axis < data.ndim else data)


@function("rot90", 1, 2)
def _rot90(given: Arguments) -> Value:
    return like(given[0], np.rot90(given.data(0), given.whole(1, 1) % 4))


@function("transpose ctranspose", 1)
def _transpose(given: Arguments) -> Value:
    return like(given[0], transposed(given.data(0)))


@function("permute", 2)
def _permute(given: Arguments) -> Value:
    data, order = given.data(0), [int(at) - 1 for at in given.numbers(1).ravel(order="F")]
    if sorted(order) != list(range(len(order))) or len(order) < data.ndim or len(order) > 32:
        raise NoValueError("the order has to name each dimension once")
    return like(given[0], data.reshape(data.shape + (1,) * (len(order) - data.ndim)).transpose(order))


@function("squeeze", 1)
def _squeeze(given: Arguments) -> Value:
    data = given.data(0)
    kept = [size for size in data.shape if size != 1] if data.ndim > 2 else list(data.shape)
    return like(given[0], data.reshape([*kept, 1, 1][: max(len(kept), 2)], order="F"))


@function("circshift", 2, 3)
def _circshift(given: Arguments) -> Value:
    data, shift = given.data(0), [int(by) for by in given.numbers(1).ravel(order="F")]
    axes = [given.dimension(2, data)] if len(shift) == 1 else list(range(len(shift)))
    return like(given[0], np.roll(data, shift, axes))


def _matrix(given: Arguments, at: int = 0) -> Array:
    """An argument of two dimensions."""
    data = given.array(at)
    if data.ndim > 2:
        raise NoValueError(f"a matrix is needed, not an array of {data.ndim} dimensions")
    return data


@function("diag", 1, 2)
def _diag(given: Arguments) -> Value:
    data, offset = _matrix(given), given.whole(1, 0)
    if data.shape == (0, 0):
        return data
    if 1 in data.shape:
        side = data.size + abs(offset)
        given.budget.make(side * side)
        return np.diag(data.ravel(order="F"), offset)
    return np.diag(data, offset).reshape(-1, 1)


@function("tril", 1, 2)
def _tril(given: Arguments) -> Value:
    return np.tril(_matrix(given), given.whole(1, 0))


@function("triu", 1, 2)
def _triu(given: Arguments) -> Value:
    return np.triu(_matrix(given), given.whole(1, 0))


@function("kron", 2)
def _kron(given: Arguments) -> Value:
    given.budget.make(given.data(0).size * given.data(1).size)
    return np.kron(numbers(_matrix(given, 0)), numbers(_matrix(given, 1)))


@function("sub2ind", 2, MANY)
def _sub2ind(given: Arguments) -> Value:
    shape = [int(size) for size in given.numbers(0).ravel(order="F")]
    step, found = 1.0, np.ones(given.data(1).shape)
    for at, size in enumerate(shape[: len(given) - 1]):
        place = given.numbers(at + 1)
        if ((place < 1) | (place > size)).any():
            raise NoValueError(f"an index of dimension {at + 1} is not within 1 to {size}")
        found = found + (place - 1) * step
        step *= size
    return found


@function("ind2sub", 2)
def _ind2sub(given: Arguments) -> tuple[Value, ...]:
    shape = [int(size) for size in given.numbers(0).ravel(order="F")]
    count = max(given.outputs, 1)
    shape = [*shape[: count - 1], math.prod(shape[count - 1 :])] if count <= len(shape) else shape
    left = given.numbers(1) - 1
    if ((left < 0) | (left >= math.prod(shape))).any():
        raise NoValueError(f"an index is not within 1 to {math.prod(shape)}")
    found = []
    for size in shape:
        found.append(left % size + 1)
        left = np.floor(left / size)
    return (*found, *(np.ones_like(left) for _ in range(count - len(found))))
