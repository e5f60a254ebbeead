"""Functions that create arrays, and return or change their size and order."""

import math
from collections.abc import Sequence

import numpy as np

from kennfeld.base.formatting import size_text
from kennfeld.matlab import values as v
from kennfeld.matlab.functions.numeric_registry import MANY, NumericArguments, Run, function
from kennfeld.matlab.operators import cast_to_class, colon_range, concatenate_along, pad_dimensions, transpose

_CLASSES = (*v.INTEGERS, "double", "single", "logical")


def parse_shape(values: Sequence[v.Value]) -> tuple[int, ...]:
    """Return the shape that size arguments request: none for 1 x 1, one number for a square, a vector, or one each."""
    if not values:
        return (1, 1)
    if any(isinstance(value, np.ndarray) and value.dtype.kind == "U" for value in values):
        raise v.MatlabValueError("a size must be a number, got text")
    vectors = [v.numbers(value).ravel(order="F") for value in values]
    if len(vectors) > 1 and any(vector.size != 1 for vector in vectors):
        raise v.MatlabValueError("each size must be one number")
    sizes = [float(size) for vector in vectors for size in vector]
    if len(sizes) == 1 and len(vectors) == 1:
        sizes *= 2
    if any(math.isnan(size) or (size != math.floor(size) and math.isfinite(size)) for size in sizes):
        raise v.MatlabValueError("a size must be an integer")
    if not 2 <= len(sizes) <= 32:
        raise v.MatlabValueError("an array must have 2 to 32 dimensions")
    shape = [int(min(max(size, 0), 2**53)) for size in sizes]
    while len(shape) > 2 and shape[-1] == 1:
        shape.pop()
    return tuple(shape)


def _filled(fill: float, is_logical: bool = False) -> Run:
    def run(call: NumericArguments) -> v.Value:
        values, name = _with_class(call)
        shape = parse_shape(values)
        call.budget.allocate(math.prod(shape))
        return cast_to_class(np.full(shape, fill), "logical" if is_logical else name)

    return run


for _names, _fill in (("zeros", 0.0), ("ones", 1.0), ("nan NaN", math.nan), ("inf Inf", math.inf)):
    function(_names, 0, MANY)(_filled(_fill))
function("true", 0, MANY)(_filled(1.0, is_logical=True))
function("false", 0, MANY)(_filled(0.0, is_logical=True))


def _with_class(call: NumericArguments) -> tuple[list[v.Value], str]:
    """Return the size arguments of a call, and the class behind them."""
    values, name = list(call.values), "double"
    for at in range(len(values) - 1, -1, -1):
        if call.is_text(at):
            word = v.text(values[at])
            if word not in (*_CLASSES, "like"):
                raise v.MatlabValueError(f"unknown numeric class {word}")
            name = v.class_name(v.array_value(values[at + 1])) if word == "like" and at + 1 < len(values) else word
            del values[at:]
    return values, "double" if name == "like" else name


@function("cell", 0, MANY)
def _cell(call: NumericArguments) -> v.Value:
    shape = parse_shape(call.values) if len(call) else (0, 0)
    call.budget.allocate(10 * math.prod(shape))
    return v.MatlabCell(v.object_array([v.EMPTY] * math.prod(shape), shape))


@function("eye", 0, 4)
def _eye(call: NumericArguments) -> v.Value:
    values, name = _with_class(call)
    shape = parse_shape(values)
    if len(shape) > 2:
        raise v.MatlabValueError("a matrix requires two sizes")
    call.budget.allocate(math.prod(shape))
    return cast_to_class(np.eye(shape[0], shape[1]), name)


@function("linspace", 2, 3)
def _linspace(call: NumericArguments) -> v.Value:
    count = max(call.integer(2, 100), 1)
    call.budget.allocate(count)
    begin, end = call.number(0), call.number(1)
    return v.row(np.linspace(begin, end, count)) if count > 1 else v.row([end])


@function("logspace", 2, 3)
def _logspace(call: NumericArguments) -> v.Value:
    count = max(call.integer(2, 50), 1)
    call.budget.allocate(count)
    begin, end = call.number(0), call.number(1)
    with np.errstate(all="ignore"):
        return v.row(10.0 ** (np.linspace(begin, end, count) if count > 1 else np.array([end])))


@function("repmat", 2, MANY)
def _repmat(call: NumericArguments) -> v.Value:
    data, times = call.data(0), parse_shape(call.values[1:])
    call.budget.allocate(data.size * math.prod(times))
    (deeper,) = pad_dimensions(data, least=len(times))
    return v.with_class_of(call[0], np.tile(deeper, times + (1,) * (deeper.ndim - len(times))))


@function("meshgrid", 1, 2)
def _meshgrid(call: NumericArguments) -> tuple[v.Value, ...]:
    x = call.array(0).ravel(order="F")
    y = call.array(1).ravel(order="F") if len(call) > 1 else x
    call.budget.allocate(2 * x.size * y.size)
    return tuple(np.ascontiguousarray(grid) for grid in np.meshgrid(x, y))


@function("ndgrid", 1, 4)
def _ndgrid(call: NumericArguments) -> tuple[v.Value, ...]:
    axes = [call.numbers(at).ravel(order="F") for at in range(len(call))]
    axes = axes * max(call.outputs, 2) if len(axes) == 1 else axes
    call.budget.allocate(len(axes) * math.prod(axis.size for axis in axes))
    return tuple(np.ascontiguousarray(grid) for grid in np.meshgrid(*axes, indexing="ij"))


@function("magic", 1)
def _magic(call: NumericArguments) -> v.Value:
    size = call.integer(0)
    if not 3 <= size <= 1000 or size % 2 == 0:
        raise v.MatlabValueError("magic supports odd sizes from 3 to 999")
    call.budget.allocate(size * size)
    row_, column = np.meshgrid(np.arange(1, size + 1), np.arange(1, size + 1), indexing="ij")
    first = (row_ + column + (size - 3) // 2) % size
    second = (row_ + 2 * column - 2) % size
    return (size * first + second + 1).astype(np.float64)


@function("size", 1, 2)
def _size(call: NumericArguments) -> "v.Value | tuple[v.Value, ...]":
    shape = call.data(0).shape
    if len(call) > 1:
        if any(at < 1 or at != math.floor(at) for at in call.numbers(1).ravel(order="F")):
            raise v.MatlabValueError("a dimension must be an integer >= 1")
        wanted = [int(at) for at in call.numbers(1).ravel(order="F")]
        return v.row([shape[at - 1] if at <= len(shape) else 1 for at in wanted])
    if call.outputs < 2:
        return v.row(shape)
    padded = (*shape, *(1 for _ in range(call.outputs - len(shape))))
    last = math.prod(padded[call.outputs - 1 :])
    return tuple(v.scalar(size) for size in (*padded[: call.outputs - 1], last))


for _name, _run in {
    "numel": lambda call: v.scalar(call.data(0).size),
    "length": lambda call: v.scalar(max(call.data(0).shape) if call.data(0).size else 0),
    "ndims": lambda call: v.scalar(call.data(0).ndim),
    "height": lambda call: v.scalar(call.data(0).shape[0]),
    "width": lambda call: v.scalar(call.data(0).shape[1]),
    "isempty": lambda call: v.logical(not call.data(0).size),
    "isscalar": lambda call: v.logical(call.data(0).size == 1),
    "isvector": lambda call: v.logical(v.is_vector(call.data(0))),
    "isrow": lambda call: v.logical(call.data(0).ndim == 2 and call.data(0).shape[0] == 1),
    "iscolumn": lambda call: v.logical(call.data(0).ndim == 2 and call.data(0).shape[1] == 1),
    "issquare": lambda call: v.logical(call.data(0).ndim == 2 and len(set(call.data(0).shape)) == 1),
    "ismatrix": lambda call: v.logical(call.data(0).ndim == 2),
    "fliplr": lambda call: v.with_class_of(call[0], np.flip(call.data(0), 1)),
    "flipud": lambda call: v.with_class_of(call[0], np.flip(call.data(0), 0)),
    "transpose": lambda call: v.with_class_of(call[0], transpose(call.data(0))),
    "ctranspose": lambda call: v.with_class_of(call[0], transpose(call.data(0))),
}.items():
    function(_name, 1)(_run)


@function("reshape", 2, MANY)
def _reshape(call: NumericArguments) -> v.Value:
    data, sizes = call.data(0), list(call.values[1:])
    empty = [at for at, size in enumerate(sizes) if not v.numbers(size).size]
    if len(empty) == 1 and len(sizes) > 1:
        known = math.prod(float(v.numbers(size).flat[0]) for size in sizes if v.numbers(size).size)
        sizes[empty[0]] = v.scalar(data.size / known if known else 0)
    shape = parse_shape(sizes)
    if len(sizes) == 1 and v.numbers(sizes[0]).size == 1:
        raise v.MatlabValueError("a size requires two numbers")
    if math.prod(shape) != data.size:
        raise v.MatlabValueError(f"{data.size} elements cannot be reshaped to {size_text(shape)}")
    call.budget.allocate(data.size)
    return v.with_class_of(call[0], data.reshape(shape, order="F"))


@function("cat", 1, MANY)
def _cat(call: NumericArguments) -> v.Value:
    axis = call.integer(0)
    if not 1 <= axis <= 32:
        raise v.MatlabValueError(f"a dimension must be between 1 and 32, got {axis}")
    return concatenate_along(call.values[1:], axis - 1, call.budget)


@function("flip", 1, 2)
def _flip(call: NumericArguments) -> v.Value:
    data = call.data(0)
    axis = call.dimension(1, data)
    return v.with_class_of(call[0], np.flip(data, axis) if axis < data.ndim else data)


@function("permute", 2)
def _permute(call: NumericArguments) -> v.Value:
    data, order = call.data(0), [int(at) - 1 for at in call.numbers(1).ravel(order="F")]
    if sorted(order) != list(range(len(order))) or len(order) < data.ndim or len(order) > 32:
        raise v.MatlabValueError("the order must list each dimension once")
    (deeper,) = pad_dimensions(data, least=len(order))
    return v.with_class_of(call[0], deeper.transpose(order))


@function("squeeze", 1)
def _squeeze(call: NumericArguments) -> v.Value:
    data = call.data(0)
    sizes = [size for size in data.shape if size != 1] if data.ndim > 2 else list(data.shape)
    return v.with_class_of(call[0], data.reshape([*sizes, 1, 1][: max(len(sizes), 2)], order="F"))


@function("circshift", 2, 3)
def _circshift(call: NumericArguments) -> v.Value:
    data, shift = call.data(0), [int(by) for by in call.numbers(1).ravel(order="F")]
    axes = [call.dimension(2, data)] if len(shift) == 1 else list(range(len(shift)))
    return v.with_class_of(call[0], np.roll(data, shift, axes))


@function("diag", 1, 2)
def _diag(call: NumericArguments) -> v.Value:
    data, offset = call.matrix(0), call.integer(1, 0)
    if data.shape == (0, 0):
        return data
    if 1 in data.shape:
        side = data.size + abs(offset)
        call.budget.allocate(side * side)
        return np.diag(data.ravel(order="F"), offset)
    return np.diag(data, offset).reshape(-1, 1)


@function("kron", 2)
def _kron(call: NumericArguments) -> v.Value:
    call.budget.allocate(call.data(0).size * call.data(1).size)
    left, right = v.numbers(call.matrix(0)), v.numbers(call.matrix(1))
    products = left[:, None, :, None] * right[None, :, None, :]
    return products.reshape(left.shape[0] * right.shape[0], left.shape[1] * right.shape[1])


@function("sub2ind", 2, MANY)
def _sub2ind(call: NumericArguments) -> v.Value:
    shape = [int(size) for size in call.numbers(0).ravel(order="F")]
    step, linear = 1.0, np.ones(call.data(1).shape)
    for at, size in enumerate(shape[: len(call) - 1]):
        index = call.numbers(at + 1)
        if ((index < 1) | (index > size)).any():
            raise v.MatlabValueError(f"an index of dimension {at + 1} must be between 1 and {size}")
        linear = linear + (index - 1) * step
        step *= size
    return linear


@function("ind2sub", 2)
def _ind2sub(call: NumericArguments) -> tuple[v.Value, ...]:
    shape = [int(size) for size in call.numbers(0).ravel(order="F")]
    count = max(call.outputs, 1)
    shape = [*shape[: count - 1], math.prod(shape[count - 1 :])] if count <= len(shape) else shape
    rest = call.numbers(1) - 1
    if ((rest < 0) | (rest >= math.prod(shape))).any():
        raise v.MatlabValueError(f"an index must be between 1 and {math.prod(shape)}")
    indices = []
    for size in shape:
        indices.append(rest % size + 1)
        rest = np.floor(rest / size)
    return (*indices, *(np.ones_like(rest) for _ in range(count - len(indices))))


function("tril", 1, 2)(lambda call: np.tril(call.matrix(0), call.integer(1, 0)))
function("triu", 1, 2)(lambda call: np.triu(call.matrix(0), call.integer(1, 0)))
function("pi", 0)(lambda call: v.scalar(math.pi))
function("colon", 2, 3)(
    lambda call: colon_range(call[0], call[1] if len(call) == 3 else None, call[len(call) - 1], call.budget)
)
function("horzcat", 0, MANY)(lambda call: concatenate_along(call.values, 1, call.budget))
function("vertcat", 0, MANY)(lambda call: concatenate_along(call.values, 0, call.budget))
function("rot90", 1, 2)(lambda call: v.with_class_of(call[0], np.rot90(call.data(0), call.integer(1, 1) % 4)))
