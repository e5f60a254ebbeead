"""Functions that make arrays: zeros, ranges, grids."""

import math
from collections.abc import Sequence

import numpy as np

from kennfeld.matlab.arithmetic import as_class, span
from kennfeld.matlab.functions.registry import MANY, REGISTERED, Arguments, Function, function
from kennfeld.matlab.values import (
    EMPTY,
    INTEGERS,
    Cell,
    NoValueError,
    Value,
    class_of,
    like,
    numbers,
    object_array,
    plain,
    row,
    scalar,
    text,
)

__all__ = ["shape_from"]

_CLASSES = (*INTEGERS, "double", "single", "logical")


def shape_from(values: Sequence[Value]) -> tuple[int, ...]:
    """The size that arguments ask for: none for 1 x 1, one number for a square, a vector, or a number for each."""
    if not values:
        return (1, 1)
    if any(isinstance(value, np.ndarray) and value.dtype.kind == "U" for value in values):
        raise NoValueError("a size has to be a number, not a text")
    given = [numbers(value).ravel(order="F") for value in values]
    if len(given) > 1 and any(one.size != 1 for one in given):
        raise NoValueError("each size has to be one number")
    sizes = [float(size) for one in given for size in one]
    if len(sizes) == 1 and len(given) == 1:
        sizes *= 2
    if any(math.isnan(size) or (size != math.floor(size) and math.isfinite(size)) for size in sizes):
        raise NoValueError("a size has to be a whole number")
    if not 2 <= len(sizes) <= 32:
        raise NoValueError("an array has 2 to 32 dimensions")
    shape = [int(min(max(size, 0), 2**53)) for size in sizes]
    while len(shape) > 2 and shape[-1] == 1:
        shape.pop()
    return tuple(shape)


def _filled(fill: float) -> Function:
    def run(given: Arguments) -> Value:
        values, name = _with_class(given)
        shape = shape_from(values)
        given.budget.make(math.prod(shape))
        made = np.full(shape, fill)
        return made != 0 if name == "logical" else as_class(made, name)

    return Function(run, 0, MANY)


def _with_class(given: Arguments) -> tuple[list[Value], str]:
    """The sizes that a call asks for, and the class behind them."""
    values, name = list(given.values), "double"
    for at in range(len(values) - 1, -1, -1):
        if given.is_text(at):
            word = text(values[at])
            if word not in (*_CLASSES, "like"):
                raise NoValueError(f"{word} is no class of numbers")
            name = class_of(plain(values[at + 1])) if word == "like" and at + 1 < len(values) else word
            del values[at:]
    return values, "double" if name == "like" else name


for _names, _fill in (("zeros", 0.0), ("ones", 1.0), ("nan NaN", math.nan), ("inf Inf", math.inf)):
    for _name in _names.split():
        REGISTERED[_name] = _filled(_fill)


@function("pi", 0)
def _pi(given: Arguments) -> Value:
    return scalar(math.pi)


def _constant(value: bool) -> Function:
    def run(given: Arguments) -> Value:
        shape = shape_from(_with_class(given)[0])
        given.budget.make(math.prod(shape))
        return np.full(shape, value)

    return Function(run, 0, MANY)


REGISTERED["true"], REGISTERED["false"] = _constant(True), _constant(False)


@function("cell", 0, MANY)
def _cell(given: Arguments) -> Value:
    shape = shape_from(given.values) if len(given) else (0, 0)
    given.budget.make(10 * math.prod(shape))
    return Cell(object_array([EMPTY] * math.prod(shape), shape))


@function("eye", 0, 4)
def _eye(given: Arguments) -> Value:
    values, name = _with_class(given)
    shape = shape_from(values)
    if len(shape) > 2:
        raise NoValueError("a matrix has two sizes")
    given.budget.make(math.prod(shape))
    made = np.eye(shape[0], shape[1])
    return made != 0 if name == "logical" else as_class(made, name)


@function("linspace", 2, 3)
def _linspace(given: Arguments) -> Value:
    count = max(given.whole(2, 100), 1)
    given.budget.make(count)
    begin, end = given.number(0), given.number(1)
    return row(np.linspace(begin, end, count)) if count > 1 else row([end])


@function("logspace", 2, 3)
def _logspace(given: Arguments) -> Value:
    count = max(given.whole(2, 50), 1)
    given.budget.make(count)
    begin, end = given.number(0), given.number(1)
    with np.errstate(all="ignore"):
        return row(10.0 ** (np.linspace(begin, end, count) if count > 1 else np.array([end])))


@function("colon", 2, 3)
def _colon(given: Arguments) -> Value:
    return span(given[0], given[1] if len(given) == 3 else None, given[len(given) - 1], given.budget)


@function("repmat", 2, MANY)
def _repmat(given: Arguments) -> Value:
    data, times = given.data(0), shape_from(given.values[1:])
    given.budget.make(data.size * math.prod(times))
    most = max(data.ndim, len(times))
    deeper = data.reshape(data.shape + (1,) * (most - data.ndim))
    return like(given[0], np.tile(deeper, times + (1,) * (most - len(times))))


@function("meshgrid", 1, 2)
def _meshgrid(given: Arguments) -> tuple[Value, ...]:
    x = given.array(0).ravel(order="F")
    y = given.array(1).ravel(order="F") if len(given) > 1 else x
    given.budget.make(2 * x.size * y.size)
    return tuple(np.ascontiguousarray(one) for one in np.meshgrid(x, y))


@function("ndgrid", 1, 4)
def _ndgrid(given: Arguments) -> tuple[Value, ...]:
    axes = [given.numbers(at).ravel(order="F") for at in range(len(given))]
    axes = axes * max(given.outputs, 2) if len(axes) == 1 else axes
    given.budget.make(len(axes) * math.prod(axis.size for axis in axes))
    return tuple(np.ascontiguousarray(one) for one in np.meshgrid(*axes, indexing="ij"))


@function("magic", 1)
def _magic(given: Arguments) -> Value:
    size = given.whole(0)
    if not 3 <= size <= 1000 or size % 2 == 0:
        raise NoValueError("magic is known for odd sizes from 3 on")
    given.budget.make(size * size)
    row_, column = np.meshgrid(np.arange(1, size + 1), np.arange(1, size + 1), indexing="ij")
    first = (row_ + column + (size - 3) // 2) % size
    second = (row_ + 2 * column - 2) % size
    return (size * first + second + 1).astype(np.float64)
