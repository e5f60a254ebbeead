"""Functions along a dimension of an array: sums, products, extremes, differences."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import reduce

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.code.functions.registry import Given, function
from kennfeld.models.simulink.code.values import EMPTY, Held, constants, truths
from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.signals import Nodes

_SUMS = {"sum": ("add", 0.0), "prod": ("mul", 1.0), "any": ("or", 0.0), "all": ("and", 1.0)}
_WORDS = frozenset({"all", "double", "native", "default", "includenan", "includemissing"})


def along(array: Nodes, axis: int, fold: Callable[[list[Nodes]], Nodes]) -> Nodes:
    """What a function makes of the slices along a dimension, which is one long then."""
    if axis >= array.ndim:
        return fold([np.asarray(array)])
    parts = [np.take(np.asarray(array), [at], axis=axis) for at in range(array.shape[axis])]
    made = fold(parts)
    if parts or made.size != 1:
        return made
    rest = (*array.shape[:axis], 1, *array.shape[axis + 1 :])
    return np.full(rest, made.item(), dtype=np.int64)


def along_default(given: Given, at: int, array: Nodes) -> tuple[Nodes, int]:
    """An array and the dimension along which it is taken; without one `[]` counts as a row of no elements."""
    array = array.reshape(1, 0) if len(given) <= at and array.shape == (0, 0) else array
    return array, given.dimension(at, array)


def total(loom: Loom, op: str, empty: float, parts: list[Nodes]) -> Nodes:
    """All slices taken together by an operation; `empty` of none."""
    return reduce(lambda a, b: each(loom, op, a, b), parts) if parts else constants(loom, empty)


@function(*_SUMS, least=1, most=3)
def reduced(given: Given) -> Held:
    """A sum, product, or whether any or all elements are not 0, along a dimension or of all elements."""
    (op, empty), loom, array = _SUMS[given.name], given.calls.loom, given.array(0)
    if given.name in ("any", "all"):
        array = each(loom, "ne", array, constants(loom, 0.0))
    words = {one for one in given.held[1:] if isinstance(one, str)}
    if not words <= _WORDS:
        raise given.refuse(f"{min(words - _WORDS)!r} is not supported", "Leave elements out by a loop with if.")
    if "all" in words:
        array = array.ravel(order="F").reshape(-1, 1)
    given = replace(given, held=[one for one in given.held if not isinstance(one, str)])
    if "all" in words and len(given) > 1:
        raise given.refuse("'all' stands beside a dimension")
    array, axis = along_default(given, 1, array)
    made = along(array, axis, lambda parts: total(loom, op, empty, parts))
    return truths(made) if given.name in ("any", "all") else made


@function("cumsum", "cumprod", least=1, most=2)
def running(given: Given) -> Held:
    """Sums or products up to each element."""
    loom, array = given.calls.loom, given.array(0)
    op, axis = "add" if given.name == "cumsum" else "mul", given.dimension(1, array)

    def fold(parts: list[Nodes]) -> Nodes:
        made = parts[:1]
        for part in parts[1:]:
            made.append(each(loom, op, made[-1], part))
        return np.concatenate(made, axis=axis) if made else array

    return along(array, axis, fold)


@function("mean", "rms", least=1, most=2)
def mean(given: Given) -> Held:
    """The mean, or the root of the mean of squares."""
    loom, array = given.calls.loom, given.array(0)
    if given.name == "rms":
        array = each(loom, "mul", array, array)
    array, axis = along_default(given, 1, array)
    count = constants(loom, float(array.shape[axis] if axis < array.ndim else 1))
    made = each(loom, "div", along(array, axis, lambda parts: total(loom, "add", 0.0, parts)), count)
    return each(loom, "sqrt", made) if given.name == "rms" else made


@function("var", "std", least=1, most=3)
def spread(given: Given) -> Held:
    """The variance or standard deviation, over n - 1 or, with a weight of 1, over n."""
    loom = given.calls.loom
    array, axis = along_default(given, 2, given.array(0))
    weight = given.whole(1) if len(given) > 1 and given.array(1).size > 0 else 0
    if weight not in (0, 1):
        raise given.refuse(f"the weight {weight} is neither 0 nor 1")
    count = array.shape[axis] if axis < array.ndim else 1
    if not count:
        return along(array, axis, lambda parts: constants(loom, math.nan))
    whole = along(array, axis, lambda parts: total(loom, "add", 0.0, parts))
    away = each(loom, "sub", array, each(loom, "div", whole, constants(loom, float(count))))
    squares = along(each(loom, "mul", away, away), axis, lambda parts: total(loom, "add", 0.0, parts))
    made = each(loom, "div", squares, constants(loom, float(count if weight else max(count - 1, 1))))
    return each(loom, "sqrt", made) if given.name == "std" else made


@function("diff", least=1, most=3)
def differences(given: Given) -> Held:
    """The differences of neighbours, once or several times."""
    loom, array = given.calls.loom, given.array(0)
    times = given.whole(1) if len(given) > 1 and given.array(1).size else 1
    if times < 1:
        raise given.refuse(f"the order {times} is not a whole number from 1")
    for _ in range(times):
        if array.size == 1 and len(given) < 3:
            return EMPTY
        array = each(loom, "sub", *_neighbours(array, given.dimension(2, array)))
    return array


def _neighbours(array: Nodes, axis: int) -> tuple[Nodes, Nodes]:
    """All elements along a dimension but the first, and all but the last."""
    whole = np.asarray(array).reshape(array.shape + (1,) * (axis + 1 - array.ndim))
    places = np.arange(whole.shape[axis])
    return np.take(whole, places[1:], axis=axis), np.take(whole, places[:-1], axis=axis)


@function("min", "max", least=1, most=3)
def extreme(given: Given) -> Held | tuple[Held, ...]:
    """The smaller or larger of two arrays, or the smallest or largest along a dimension, with its place."""
    loom = given.calls.loom
    if len(given) == 2 or (len(given) == 3 and given.array(1).size):
        pair = given.arrays[:2]
        given.fits(*pair)
        return each(loom, given.name, *pair)
    array = given.array(0)
    if array.size == 0:
        return _of_nothing(given, array)
    if given.wanted < 2:
        return along(array, given.dimension(2, array), lambda parts: total(loom, given.name, 0.0, parts))
    return _placed(given, array)


def _of_nothing(given: Given, array: Nodes) -> Nodes:
    """The extreme of an empty array: one long where the others are none, else as empty as it was."""
    axis = given.dimension(2, array)
    if axis >= array.ndim or array.shape[axis] == 0:
        return array
    return np.take(array, [0], axis=axis)


def _placed(given: Given, array: Nodes) -> tuple[Held, ...]:
    """The extreme and the first place where it is; what is not a number counts as such."""
    loom, places = given.calls.loom, list[Nodes]()
    worse = "ge" if given.name == "min" else "le"

    def fold(parts: list[Nodes]) -> Nodes:
        best, place = parts[0], np.full(parts[0].shape, loom.const(1.0), dtype=np.int64)
        for at, part in enumerate(parts[1:], 2):
            wins = each(loom, "and", each(loom, "not", each(loom, worse, part, best)), each(loom, "eq", best, best))
            place = each(loom, "select", wins, constants(loom, float(at)), place)
            best = each(loom, "select", wins, part, best)
        places.append(place)
        return best

    return along(array, given.dimension(2, array), fold), places[0]


@function("bounds")
def bounds(given: Given) -> tuple[Held, ...]:
    """The smallest and the largest element along the first dimension."""
    loom, array = given.calls.loom, given.array(0)
    axis = given.dimension(1, array)
    return tuple(along(array, axis, lambda parts, op=op: total(loom, op, 0.0, parts)) for op in ("min", "max"))  # type: ignore[misc]


@function("nnz")
def count(given: Given) -> Held:
    """How many elements are not 0."""
    loom = given.calls.loom
    flat = each(loom, "ne", given.array(0), constants(loom, 0.0)).reshape(-1, 1)
    return along(flat, 0, lambda parts: total(loom, "add", 0.0, parts))


@function("trapz", least=1, most=2)
def area(given: Given) -> Held:
    """The area below lines through the points of an array along its first dimension, or through those of vectors."""
    loom = given.calls.loom
    if len(given) == 2:
        x, y = given.vector(0), given.vector(1)
        if x.shape != y.shape:
            raise given.refuse("its arguments have different sizes")
        wide = each(loom, "sub", x[1:], x[:-1])
        return along(each(loom, "mul", wide, _middles(given, y, 0)), 0, lambda parts: total(loom, "add", 0.0, parts))
    y, axis = along_default(given, 1, given.array(0))
    return along(_middles(given, y, axis), axis, lambda parts: total(loom, "add", 0.0, parts))


def _middles(given: Given, array: Nodes, axis: int) -> Nodes:
    """The means of neighbours along a dimension."""
    loom = given.calls.loom
    return each(loom, "mul", constants(loom, 0.5), each(loom, "add", *_neighbours(array, axis)))
