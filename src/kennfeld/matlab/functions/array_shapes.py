"""Functions that tell or change the size and order of arrays.

Functions that make arrays: zeros, ranges, grids.
"""

import math
from collections.abc import Sequence

import numpy as np

from kennfeld.matlab.functions.numeric_registry import (
    MANY,
    NUMERIC_FUNCTIONS,
    NumericArguments,
    NumericFunction,
    function,
)
from kennfeld.matlab.operators import cast_to_class, colon_range, joined_along, transposed
from kennfeld.matlab.values import (
    EMPTY,
    INTEGERS,
    Array,
    MatlabCell,
    MatlabValueError,
    Value,
    array_value,
    class_name,
    logical,
    numbers,
    object_array,
    row,
    scalar,
    text,
    with_class_of,
)

__all__ = []

_CLASSES = (*INTEGERS, "double", "single", "logical")


def requested_shape(values: Sequence[Value]) -> tuple[int, ...]:
    """The size that arguments ask for: none for 1 x 1, one number for a square, a vector, or a number for each."""
    if not values:
        return (1, 1)
    if any(isinstance(value, np.ndarray) and value.dtype.kind == "U" for value in values):
        raise MatlabValueError("a size has to be a number, not a text")
    given = [numbers(value).ravel(order="F") for value in values]
    if len(given) > 1 and any(one.size != 1 for one in given):
        raise MatlabValueError("each size has to be one number")
    sizes = [float(size) for one in given for size in one]
    if len(sizes) == 1 and len(given) == 1:
        sizes *= 2
    if any(math.isnan(size) or (size != math.floor(size) and math.isfinite(size)) for size in sizes):
        raise MatlabValueError("a size has to be a whole number")
    if not 2 <= len(sizes) <= 32:
        raise MatlabValueError("an array has 2 to 32 dimensions")
    shape = [int(min(max(size, 0), 2**53)) for size in sizes]
    while len(shape) > 2 and shape[-1] == 1:
        shape.pop()
    return tuple(shape)


def _filled(fill: float) -> NumericFunction:
    def run(given: NumericArguments) -> Value:
        values, name = _with_class(given)
        shape = requested_shape(values)
        given.budget.make(math.prod(shape))
        made = np.full(shape, fill)
        return made != 0 if name == "logical" else cast_to_class(made, name)

    return NumericFunction(run, 0, MANY)


def _with_class(given: NumericArguments) -> tuple[list[Value], str]:
    """The sizes that a call asks for, and the class behind them."""
    values, name = list(given.values), "double"
    for at in range(len(values) - 1, -1, -1):
        if given.is_text(at):
            word = text(values[at])
            if word not in (*_CLASSES, "like"):
                raise MatlabValueError(f"{word} is no class of numbers")
            name = class_name(array_value(values[at + 1])) if word == "like" and at + 1 < len(values) else word
            del values[at:]
    return values, "double" if name == "like" else name


for _names, _fill in (("zeros", 0.0), ("ones", 1.0), ("nan NaN", math.nan), ("inf Inf", math.inf)):
    for _name in _names.split():
        NUMERIC_FUNCTIONS[_name] = _filled(_fill)


@function("pi", 0)
def _pi(given: NumericArguments) -> Value:
    return scalar(math.pi)


def _constant(value: bool) -> NumericFunction:
    def run(given: NumericArguments) -> Value:
        shape = requested_shape(_with_class(given)[0])
        given.budget.make(math.prod(shape))
        return np.full(shape, value)

    return NumericFunction(run, 0, MANY)


NUMERIC_FUNCTIONS["true"], NUMERIC_FUNCTIONS["false"] = _constant(True), _constant(False)


@function("cell", 0, MANY)
def _cell(given: NumericArguments) -> Value:
    shape = requested_shape(given.values) if len(given) else (0, 0)
    given.budget.make(10 * math.prod(shape))
    return MatlabCell(object_array([EMPTY] * math.prod(shape), shape))


@function("eye", 0, 4)
def _eye(given: NumericArguments) -> Value:
    values, name = _with_class(given)
    shape = requested_shape(values)
    if len(shape) > 2:
        raise MatlabValueError("a matrix has two sizes")
    given.budget.make(math.prod(shape))
    made = np.eye(shape[0], shape[1])
    return made != 0 if name == "logical" else cast_to_class(made, name)


@function("linspace", 2, 3)
def _linspace(given: NumericArguments) -> Value:
    count = max(given.whole(2, 100), 1)
    given.budget.make(count)
    begin, end = given.number(0), given.number(1)
    return row(np.linspace(begin, end, count)) if count > 1 else row([end])


@function("logspace", 2, 3)
def _logspace(given: NumericArguments) -> Value:
    count = max(given.whole(2, 50), 1)
    given.budget.make(count)
    begin, end = given.number(0), given.number(1)
    with np.errstate(all="ignore"):
        return row(10.0 ** (np.linspace(begin, end, count) if count > 1 else np.array([end])))


@function("colon", 2, 3)
def _colon(given: NumericArguments) -> Value:
    return colon_range(given[0], given[1] if len(given) == 3 else None, given[len(given) - 1], given.budget)


@function("repmat", 2, MANY)
def _repmat(given: NumericArguments) -> Value:
    data, times = given.data(0), requested_shape(given.values[1:])
    given.budget.make(data.size * math.prod(times))
    most = max(data.ndim, len(times))
    deeper = data.reshape(data.shape + (1,) * (most - data.ndim))
    return with_class_of(given[0], np.tile(deeper, times + (1,) * (most - len(times))))


@function("meshgrid", 1, 2)
def _meshgrid(given: NumericArguments) -> tuple[Value, ...]:
    x = given.array(0).ravel(order="F")
    y = given.array(1).ravel(order="F") if len(given) > 1 else x
    given.budget.make(2 * x.size * y.size)
    return tuple(np.ascontiguousarray(one) for one in np.meshgrid(x, y))


@function("ndgrid", 1, 4)
def _ndgrid(given: NumericArguments) -> tuple[Value, ...]:
    axes = [given.numbers(at).ravel(order="F") for at in range(len(given))]
    axes = axes * max(given.outputs, 2) if len(axes) == 1 else axes
    given.budget.make(len(axes) * math.prod(axis.size for axis in axes))
    return tuple(np.ascontiguousarray(one) for one in np.meshgrid(*axes, indexing="ij"))


@function("magic", 1)
def _magic(given: NumericArguments) -> Value:
    size = given.whole(0)
    if not 3 <= size <= 1000 or size % 2 == 0:
        raise MatlabValueError("magic is known for odd sizes from 3 on")
    given.budget.make(size * size)
    row_, column = np.meshgrid(np.arange(1, size + 1), np.arange(1, size + 1), indexing="ij")
    first = (row_ + column + (size - 3) // 2) % size
    second = (row_ + 2 * column - 2) % size
    return (size * first + second + 1).astype(np.float64)


@function("size", 1, 2)
def _size(given: NumericArguments) -> "Value | tuple[Value, ...]":
    shape = given.data(0).shape
    if len(given) > 1:
        if any(at < 1 or at != math.floor(at) for at in given.numbers(1).ravel(order="F")):
            raise MatlabValueError("a dimension has to be a whole number from 1")
        wanted = [int(at) for at in given.numbers(1).ravel(order="F")]
        return row([shape[at - 1] if at <= len(shape) else 1 for at in wanted])
    if given.outputs < 2:
        return row(shape)
    padded = (*shape, *(1 for _ in range(given.outputs - len(shape))))
    last = math.prod(padded[given.outputs - 1 :])
    return tuple(scalar(size) for size in (*padded[: given.outputs - 1], last))


@function("numel", 1)
def _numel(given: NumericArguments) -> Value:
    return scalar(given.data(0).size)


@function("length", 1)
def _length(given: NumericArguments) -> Value:
    return scalar(max(given.data(0).shape) if given.data(0).size else 0)


@function("ndims", 1)
def _ndims(given: NumericArguments) -> Value:
    return scalar(given.data(0).ndim)


@function("height", 1)
def _height(given: NumericArguments) -> Value:
    return scalar(given.data(0).shape[0])


@function("width", 1)
def _width(given: NumericArguments) -> Value:
    return scalar(given.data(0).shape[1])


@function("isempty", 1)
def _isempty(given: NumericArguments) -> Value:
    return logical(not given.data(0).size)


@function("isscalar", 1)
def _isscalar(given: NumericArguments) -> Value:
    return logical(given.data(0).size == 1)


@function("isvector", 1)
def _isvector(given: NumericArguments) -> Value:
    data = given.data(0)
    return logical(data.ndim == 2 and 1 in data.shape)


@function("isrow", 1)
def _isrow(given: NumericArguments) -> Value:
    return logical(given.data(0).ndim == 2 and given.data(0).shape[0] == 1)


@function("iscolumn", 1)
def _iscolumn(given: NumericArguments) -> Value:
    return logical(given.data(0).ndim == 2 and given.data(0).shape[1] == 1)


@function("ismatrix", 1)
def _ismatrix(given: NumericArguments) -> Value:
    return logical(given.data(0).ndim == 2)


@function("reshape", 2, MANY)
def _reshape(given: NumericArguments) -> Value:
    data, sizes = given.data(0), list(given.values[1:])
    empty = [at for at, size in enumerate(sizes) if not numbers(size).size]
    if len(empty) == 1 and len(sizes) > 1:
        known = math.prod(float(numbers(size).flat[0]) for size in sizes if numbers(size).size)
        sizes[empty[0]] = scalar(data.size / known if known else 0)
    shape = requested_shape(sizes)
    if len(sizes) == 1 and numbers(sizes[0]).size == 1:
        raise MatlabValueError("a size needs two numbers")
    if math.prod(shape) != data.size:
        raise MatlabValueError(f"{data.size} elements do not fill {' x '.join(map(str, shape))}")
    given.budget.make(data.size)
    return with_class_of(given[0], data.reshape(shape, order="F"))


@function("horzcat", 0, MANY)
def _horzcat(given: NumericArguments) -> Value:
    return joined_along(given.values, 1, given.budget)


@function("vertcat", 0, MANY)
def _vertcat(given: NumericArguments) -> Value:
    return joined_along(given.values, 0, given.budget)


@function("cat", 1, MANY)
def _cat(given: NumericArguments) -> Value:
    axis = given.whole(0)
    if not 1 <= axis <= 32:
        raise MatlabValueError(f"{axis} is no dimension")
    return joined_along(given.values[1:], axis - 1, given.budget)


@function("fliplr", 1)
def _fliplr(given: NumericArguments) -> Value:
    return with_class_of(given[0], np.flip(given.data(0), 1))


@function("flipud", 1)
def _flipud(given: NumericArguments) -> Value:
    return with_class_of(given[0], np.flip(given.data(0), 0))


@function("flip", 1, 2)
def _flip(given: NumericArguments) -> Value:
    data = given.data(0)
    axis = given.dimension(1, data)
    return with_class_of(given[0], np.flip(data, axis) if axis < data.ndim else data)


@function("rot90", 1, 2)
def _rot90(given: NumericArguments) -> Value:
    return with_class_of(given[0], np.rot90(given.data(0), given.whole(1, 1) % 4))


@function("transpose ctranspose", 1)
def _transpose(given: NumericArguments) -> Value:
    return with_class_of(given[0], transposed(given.data(0)))


@function("permute", 2)
def _permute(given: NumericArguments) -> Value:
    data, order = given.data(0), [int(at) - 1 for at in given.numbers(1).ravel(order="F")]
    if sorted(order) != list(range(len(order))) or len(order) < data.ndim or len(order) > 32:
        raise MatlabValueError("the order has to name each dimension once")
    return with_class_of(given[0], data.reshape(data.shape + (1,) * (len(order) - data.ndim)).transpose(order))


@function("squeeze", 1)
def _squeeze(given: NumericArguments) -> Value:
    data = given.data(0)
    kept = [size for size in data.shape if size != 1] if data.ndim > 2 else list(data.shape)
    return with_class_of(given[0], data.reshape([*kept, 1, 1][: max(len(kept), 2)], order="F"))


@function("circshift", 2, 3)
def _circshift(given: NumericArguments) -> Value:
    data, shift = given.data(0), [int(by) for by in given.numbers(1).ravel(order="F")]
    axes = [given.dimension(2, data)] if len(shift) == 1 else list(range(len(shift)))
    return with_class_of(given[0], np.roll(data, shift, axes))


def _matrix(given: NumericArguments, at: int = 0) -> Array:
    """An argument of two dimensions."""
    data = given.array(at)
    if data.ndim > 2:
        raise MatlabValueError(f"a matrix is needed, not an array of {data.ndim} dimensions")
    return data


@function("diag", 1, 2)
def _diag(given: NumericArguments) -> Value:
    data, offset = _matrix(given), given.whole(1, 0)
    if data.shape == (0, 0):
        return data
    if 1 in data.shape:
        side = data.size + abs(offset)
        given.budget.make(side * side)
        return np.diag(data.ravel(order="F"), offset)
    return np.diag(data, offset).reshape(-1, 1)


@function("tril", 1, 2)
def _tril(given: NumericArguments) -> Value:
    return np.tril(_matrix(given), given.whole(1, 0))


@function("triu", 1, 2)
def _triu(given: NumericArguments) -> Value:
    return np.triu(_matrix(given), given.whole(1, 0))


@function("kron", 2)
def _kron(given: NumericArguments) -> Value:
    given.budget.make(given.data(0).size * given.data(1).size)
    return np.kron(numbers(_matrix(given, 0)), numbers(_matrix(given, 1)))


@function("sub2ind", 2, MANY)
def _sub2ind(given: NumericArguments) -> Value:
    shape = [int(size) for size in given.numbers(0).ravel(order="F")]
    step, found = 1.0, np.ones(given.data(1).shape)
    for at, size in enumerate(shape[: len(given) - 1]):
        place = given.numbers(at + 1)
        if ((place < 1) | (place > size)).any():
            raise MatlabValueError(f"an index of dimension {at + 1} is not within 1 to {size}")
        found = found + (place - 1) * step
        step *= size
    return found


@function("ind2sub", 2)
def _ind2sub(given: NumericArguments) -> tuple[Value, ...]:
    shape = [int(size) for size in given.numbers(0).ravel(order="F")]
    count = max(given.outputs, 1)
    shape = [*shape[: count - 1], math.prod(shape[count - 1 :])] if count <= len(shape) else shape
    left = given.numbers(1) - 1
    if ((left < 0) | (left >= math.prod(shape))).any():
        raise MatlabValueError(f"an index is not within 1 to {math.prod(shape)}")
    found = []
    for size in shape:
        found.append(left % size + 1)
        left = np.floor(left / size)
    return (*found, *(np.ones_like(left) for _ in range(count - len(found))))
