"""Functions that reduce arrays along a dimension, and that find, sort and compare elements."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.matlab import values as v
from kennfeld.matlab.functions.elementary import apply_pairwise
from kennfeld.matlab.functions.numeric_registry import MANY, NumericArguments, Run, function
from kennfeld.matlab.operators import cast_to_class, pad_dimensions, result_class

_Along = Callable[[Float, int], v.Array]
_WORDS = frozenset({"all", "double", "native", "default", "includenan", "includemissing", "omitnan"})

_SIMPLE: dict[str, tuple[_Along, float | bool | None, bool]] = {
    "sum": (lambda values, axis: values.sum(axis=axis, keepdims=True), 0.0, True),
    "prod": (lambda values, axis: values.prod(axis=axis, keepdims=True), 1.0, True),
    "mean": (lambda values, axis: _mean(values, axis), float("nan"), False),
    "rms": (lambda values, axis: np.sqrt(_mean(values * values, axis)), float("nan"), False),
    "median": (lambda values, axis: np.median(values, axis=axis, keepdims=True), float("nan"), False),
    "any": (lambda values, axis: (values != 0).any(axis=axis, keepdims=True), False, False),
    "all": (lambda values, axis: (values != 0).all(axis=axis, keepdims=True), True, False),
    "cumsum": (lambda values, axis: np.add.accumulate(values, axis=axis), None, True),
    "cumprod": (lambda values, axis: np.multiply.accumulate(values, axis=axis), None, True),
    "cummax": (lambda values, axis: np.fmax.accumulate(values, axis=axis), None, True),
    "cummin": (lambda values, axis: np.fmin.accumulate(values, axis=axis), None, True),
    "range": (lambda values, axis: np.ptp(values, axis=axis, keepdims=True), None, True),
}
_WITHOUT_NAN: dict[str, _Along] = {
    "sum": lambda values, axis: np.nansum(values, axis=axis, keepdims=True),
    "prod": lambda values, axis: np.nanprod(values, axis=axis, keepdims=True),
    "mean": lambda values, axis: np.nanmean(values, axis=axis, keepdims=True),
    "median": lambda values, axis: np.nanmedian(values, axis=axis, keepdims=True),
    "cumsum": lambda values, axis: np.nancumsum(values, axis=axis),
    "cumprod": lambda values, axis: np.nancumprod(values, axis=axis),
}


def _mean(values: Float, axis: int) -> v.Array:
    return np.asanyarray(values.sum(axis=axis, keepdims=True) / values.shape[axis])


@function("find", 1, 3)
def _find(call: NumericArguments) -> "v.Value | tuple[v.Value, ...]":
    values = call.numbers(0)
    positions = np.flatnonzero(values.ravel(order="F"))
    if len(call) > 1:
        count = call.integer(1)
        if count < 1:
            raise v.MatlabValueError(f"the number of elements must be >= 1, got {count}")
        from_end = len(call) > 2 and call.text(2) == "last"
        positions = positions[max(positions.size - count, 0) :] if from_end else positions[:count]
    is_row = values.ndim == 2 and values.shape[0] == 1 and values.shape[1] != 1
    shape = (1, -1) if is_row else (-1, 1)
    if values.shape == (0, 0) or (values.size == 1 and not positions.size):
        shape = (0, 0)
    if call.outputs < 2:
        return (positions + 1.0).reshape(shape)
    rows, columns = np.unravel_index(positions, (values.shape[0], values.size // max(values.shape[0], 1)), order="F")
    elements = values.ravel(order="F")[positions]
    return (rows + 1.0).reshape(shape), (columns + 1.0).reshape(shape), elements.reshape(shape)


@function("sort", 1, 3)
def _sort(call: NumericArguments) -> "v.Value | tuple[v.Value, ...]":
    is_down = call.is_text(len(call) - 1) and len(call) > 1 and call.text(len(call) - 1).casefold() == "descend"
    if isinstance(call[0], v.MatlabCell):
        words = [v.text(cell) for cell in call[0].values.ravel(order="F")]
        ranks = sorted(range(len(words)), key=lambda at: words[at], reverse=is_down)
        sorted_ = v.object_array([v.characters(words[at]) for at in ranks], call[0].values.shape)
        return v.MatlabCell(sorted_), np.array(ranks, dtype=np.float64).reshape(call[0].values.shape, order="F") + 1
    array = call.array(0)
    values = array if array.dtype.kind == "U" else v.numbers(array)
    axis = call.dimension(1, array) if len(call) > 1 and not call.is_text(1) else call.dimension(9, array)
    order: v.Array = np.argsort(-values if is_down and values.dtype.kind != "U" else values, axis=axis, kind="stable")
    if is_down and values.dtype.kind == "f":
        order = _missing_first(values, order, axis)
    if is_down and values.dtype.kind == "U":
        order = np.flip(order, axis)
    return np.take_along_axis(array, order, axis), order.astype(np.float64) + 1


def _missing_first(values: v.Array, order: v.Array, axis: int) -> v.Array:
    """Move NaN to the front of a descending order, since MATLAB sorts it as the largest number."""
    missing = np.isnan(np.take_along_axis(values, order, axis))
    return np.take_along_axis(order, np.argsort(~missing, axis=axis, kind="stable"), axis)


@function("unique", 1, 3)
def _unique(call: NumericArguments) -> "v.Value | tuple[v.Value, ...]":
    is_stable = any(word == "stable" for word in call.words(1))
    if isinstance(call[0], v.MatlabCell):
        words = [v.text(cell) for cell in call[0].values.ravel(order="F")]
        unique = list(dict.fromkeys(words)) if is_stable else sorted(set(words))
        return v.MatlabCell(v.object_array([v.characters(word) for word in unique], (len(unique), 1)))
    array = call.array(0)
    if any(word == "rows" for word in call.words(1)):
        return np.unique(array, axis=0)
    flat = array.ravel(order="F")
    elements, first, back = np.unique(flat, return_index=True, return_inverse=True, equal_nan=False)
    if is_stable:
        order = np.argsort(first, kind="stable")
        elements, first = elements[order], first[order]
        back = np.argsort(order, kind="stable")[back]
    shape = (1, -1) if array.ndim == 2 and array.shape[0] == 1 and array.size else (-1, 1)
    return elements.reshape(shape), (first + 1.0).reshape(-1, 1), (back + 1.0).reshape(-1, 1)


def _words(value: v.Value) -> set[str]:
    if isinstance(value, v.MatlabCell):
        return {v.text(cell) for cell in value.values.ravel()}
    return {v.text(value)}


@function("ismember", 2)
def _ismember(call: NumericArguments) -> "v.Value | tuple[v.Value, ...]":
    if isinstance(call[1], v.MatlabCell):
        known = _words(call[1])
        if isinstance(call[0], v.MatlabCell):
            parts = call[0].values
            return np.array([v.text(cell) in known for cell in parts.ravel()], dtype=bool).reshape(parts.shape)
        return v.logical(v.text(call[0]) in known)
    array, among = call.array(0), call.array(1).ravel(order="F")
    if array.dtype.kind != "U" or among.dtype.kind != "U":
        array, among = v.numbers(array), v.numbers(among.reshape(1, -1)).ravel()
    values, first = np.unique(among, return_index=True)
    at = np.searchsorted(values, array)
    inside = np.isin(array, among)
    place = first[np.minimum(at, max(values.size - 1, 0))] + 1.0 if values.size else np.zeros(array.shape)
    return inside, np.where(inside, place, 0.0)


def _set_operation(call: NumericArguments, name: str) -> v.Value:
    if isinstance(call[0], v.MatlabCell) or isinstance(call[1], v.MatlabCell):
        left, right = _words(call[0]), _words(call[1])
        words = sorted(left | right if name == "union" else left & right if name == "intersect" else left - right)
        return v.MatlabCell(v.object_array([v.characters(word) for word in words], (1, len(words))))
    first, second = call.array(0), call.array(1)
    operations: dict[str, Callable[..., v.Array]] = {
        "union": np.union1d,
        "intersect": np.intersect1d,
        "setdiff": np.setdiff1d,
    }
    result = operations[name](first.ravel(order="F"), second.ravel(order="F"))
    is_column = first.shape[1] == 1 and first.shape[0] > 1 and (name == "setdiff" or second.shape[1] == 1)
    return result.reshape((-1, 1) if is_column else (1, -1))


for _name in ("union", "intersect", "setdiff"):
    function(_name, 2)(partial(_set_operation, name=_name))


@function("issorted", 1)
def _issorted(call: NumericArguments) -> v.Value:
    values = call.numbers(0).ravel(order="F")
    return v.logical(bool((np.diff(values) >= 0).all()))


def is_equal(left: v.Value, right: v.Value) -> bool:
    """Return True if two values have equal size and elements; NaN equals nothing."""
    if isinstance(left, np.ndarray) and isinstance(right, np.ndarray):
        if left.dtype.kind == "O" or right.dtype.kind == "O":
            return _as_texts(left) == _as_texts(right) is not None
        return left.shape == right.shape and bool((v.numbers(left) == v.numbers(right)).all())
    if v.class_name(left) != v.class_name(right) or isinstance(left, v.MatlabFunctionHandle | v.OpaqueValue):
        return False
    if isinstance(left, v.MatlabCell) and isinstance(right, v.MatlabCell):
        pairs = zip(left.values.ravel(), right.values.ravel(), strict=False)
        return left.values.shape == right.values.shape and all(is_equal(a, b) for a, b in pairs)
    if isinstance(left, v.MatlabStruct) and isinstance(right, v.MatlabStruct):
        if left.elements.shape != right.elements.shape or set(left.names) != set(right.names):
            return False
        both = zip(left.elements.ravel(), right.elements.ravel(), strict=True)
        return all(is_equal(a[name], b[name]) for a, b in both for name in left.names)
    return False


def _as_texts(array: v.Array) -> list[str] | None:
    if array.dtype.kind == "U":
        return ["".join(array.ravel(order="F").tolist())]
    return [str(string) for string in array.ravel(order="F")] if array.dtype.kind == "O" else None


@function("histc", 2)
def _histc(call: NumericArguments) -> v.Value:
    values, edges = call.numbers(0).ravel(), call.numbers(1)
    flat = edges.ravel(order="F")
    if flat.size > 1 and (np.diff(flat) < 0).any():
        raise v.MatlabValueError("the edges must increase")
    counts = np.histogram(values, flat)[0].astype(np.float64) if flat.size > 1 else np.zeros(0)
    last = float((values == flat[-1]).sum()) if flat.size else 0.0
    if counts.size:
        counts[-1] -= last
    return np.append(counts, last).reshape(edges.shape)


def matches_case(subject: v.Value, case: v.Value) -> bool:
    """Return True if a `case` matches the subject of `switch`: equal number or text, or one of the cells."""
    if isinstance(case, v.MatlabCell):
        return any(matches_case(subject, cell) for cell in case.values.ravel(order="F"))
    if not isinstance(subject, np.ndarray) or not isinstance(case, np.ndarray):
        return False
    if subject.dtype.kind in "UO" or case.dtype.kind in "UO":
        return _as_texts(subject) == _as_texts(case) is not None
    return bool(case.size) and bool(subject.size) and bool((v.numbers(subject) == v.numbers(case)).all())


def _reduction(operation: _Along, of_nothing: float | bool | None, keeps: bool, without_nan: _Along | None) -> Run:
    """Return a function of an array and a dimension.

    `of_nothing` is its value for an empty array, `without_nan` computes it without NaN; `keeps` the integer class.
    """

    def run(call: NumericArguments) -> v.Value:
        call, words = _options(call)
        values = call.numbers(0)
        if len(call) > 2:
            raise v.MatlabValueError(f"one dimension is expected, got {len(call) - 1}")
        reduce = without_nan if "omitnan" in words else operation
        if reduce is None:
            raise v.MatlabValueError("omitnan is not supported")
        if values.shape == (0, 0) and of_nothing is not None and len(call) == 1:
            return v.logical(of_nothing) if isinstance(of_nothing, bool) else v.scalar(of_nothing)
        values = values.reshape(-1, 1, order="F") if "all" in words else values
        axis = call.dimension(1, values)
        (values,) = pad_dimensions(values, least=axis + 1)
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # the mean of nothing is not a number
            result = v.trim_dimensions(reduce(values, axis))
        if result.dtype == np.bool_:
            return result
        return cast_to_class(result, result_class(call.array(0)) if keeps else "double")

    return run


def _options(call: NumericArguments) -> tuple[NumericArguments, set[str]]:
    """Separate the arguments from the option words among them."""
    words = {call.text(at).casefold() for at in range(1, len(call)) if call.is_text(at)}
    unknown = words - _WORDS
    if unknown:
        raise v.MatlabValueError(f"{min(unknown)} is not supported")
    values = [value for at, value in enumerate(call.values) if not at or not call.is_text(at)]
    if "all" in words and any(v.elements_of(value).size for value in values[1:]):
        raise v.MatlabValueError("all cannot be combined with a dimension")
    return replace(call, values=values), words


for _name, (_operation, _of_nothing, _keeps) in _SIMPLE.items():
    function(_name, 1, 4)(_reduction(_operation, _of_nothing, _keeps, _WITHOUT_NAN.get(_name)))


def _deviation(root: bool) -> Run:
    def run(call: NumericArguments) -> v.Value:
        values = call.numbers(0)
        weight = call.number(1, 0.0) if len(call) > 1 and call.data(1).size else 0.0
        if weight not in (0.0, 1.0):
            raise v.MatlabValueError(f"the weight must be 0 or 1, got {weight:g}")
        values = values.reshape(1, 0) if values.shape == (0, 0) and len(call) < 3 else values
        axis = call.dimension(2, values)
        (values,) = pad_dimensions(values, least=axis + 1)
        if not values.shape[axis]:
            return v.trim_dimensions(np.full((*values.shape[:axis], 1, *values.shape[axis + 1 :]), np.nan))
        deviations = values - _mean(values, axis)
        divisor = values.shape[axis] if weight else max(values.shape[axis] - 1, 1)
        result = v.trim_dimensions((deviations * deviations).sum(axis=axis, keepdims=True) / divisor)
        return np.sqrt(result) if root else result

    return run


function("std", 1, 3)(_deviation(root=True))
function("var", 1, 3)(_deviation(root=False))


def _extreme(name: str, along: _Along) -> Run:
    def run(call: NumericArguments) -> "v.Value | tuple[v.Value, ...]":
        if len(call) == 2 or (len(call) == 3 and call.data(1).size):
            return apply_pairwise(call, np.fmin if name == "min" else np.fmax)
        values = call.numbers(0)
        call, words = _options(call)
        if words & {"includenan", "includemissing"}:
            raise v.MatlabValueError("includenan is not supported")
        values = values.reshape(-1, 1, order="F") if "all" in words else values
        axis = call.dimension(2, values)
        if not values.size:
            return (_extreme_of_nothing(values, axis),) * 2
        if axis >= values.ndim:
            return call.array(0), np.ones(values.shape)
        extremes, places = along(values, axis), None
        if call.outputs > 1:
            extremes, places = _with_position(name, values, extremes, axis)
        result = cast_to_class(v.trim_dimensions(extremes), result_class(call.array(0)))
        return result if places is None else (result, v.trim_dimensions(places))

    return run


def _with_position(name: str, values: Float, extremes: v.Array, axis: int) -> tuple[v.Array, v.Array]:
    """Return the extremes and their first positions, from 1."""
    if isinstance(values, v.Elements):
        return values.first_extremes(name, axis)
    numbers = np.where(np.isnan(values), np.inf if name == "min" else -np.inf, values)
    places = np.argmin(numbers, axis=axis) if name == "min" else np.argmax(numbers, axis=axis)
    return extremes, np.expand_dims(places, axis).astype(np.float64) + 1


def _extreme_of_nothing(values: Float, axis: int) -> Float:
    """Return the extreme of an empty array: of length 1 along `axis` unless that is empty."""
    if axis >= values.ndim or not values.shape[axis]:
        return values
    return np.take(values, [0], axis=axis)


function("min", 1, 3)(_extreme("min", lambda v, a: np.fmin.reduce(v, axis=a, keepdims=True)))
function("max", 1, 3)(_extreme("max", lambda v, a: np.fmax.reduce(v, axis=a, keepdims=True)))


@function("bounds", 1)
def _bounds(call: NumericArguments) -> tuple[v.Value, ...]:
    values = call.numbers(0)
    axis = call.dimension(1, values)
    if not values.size:
        return (_extreme_of_nothing(values, axis),) * 2
    return np.fmin.reduce(values, axis=axis, keepdims=True), np.fmax.reduce(values, axis=axis, keepdims=True)


@function("diff", 1, 3)
def _diff(call: NumericArguments) -> v.Value:
    values = call.numbers(0)
    times = call.integer(1, 1) if len(call) > 1 and call.data(1).size else 1
    if not 1 <= times <= 1000:
        raise v.MatlabValueError("the order of diff must be between 1 and 1000")
    for _ in range(times):
        axis = call.dimension(2, values)
        if values.size == 1 and len(call) < 3:
            return v.EMPTY
        (values,) = pad_dimensions(values, least=axis + 1)
        values = v.trim_dimensions(np.diff(values, axis=axis))
    return cast_to_class(values, result_class(call.array(0)))


@function("dot", 2)
def _dot(call: NumericArguments) -> v.Value:
    left, right = call.numbers(0), call.numbers(1)
    if left.size != right.size:
        raise v.MatlabValueError("the arguments must have the same size")
    if v.is_vector(left) and v.is_vector(right):
        result: v.Array = np.matmul(left.reshape(1, -1), right.reshape(-1, 1))
        return result
    if left.shape != right.shape:
        raise v.MatlabValueError("the arguments must have the same size")
    products = (left * right).reshape(1, 0) if left.shape == (0, 0) else left * right
    total: v.Array = products.sum(axis=call.dimension(9, products), keepdims=True)
    return total


@function("cross", 2)
def _cross(call: NumericArguments) -> v.Value:
    left, right = call.numbers(0), call.numbers(1)
    if left.size != 3 or right.size != 3:
        raise v.MatlabValueError("cross requires vectors of three numbers")
    x, y = left.ravel(), right.ravel()
    return (x[[1, 2, 0]] * y[[2, 0, 1]] - x[[2, 0, 1]] * y[[1, 2, 0]]).reshape(left.shape)


@function("norm", 1, 2)
def _norm(call: NumericArguments) -> v.Value:
    values = call.numbers(0)
    if not values.size:
        return v.scalar(0.0)
    is_vector = v.is_vector(values)
    kinds = {"inf": np.inf, "fro": 2 if is_vector else "fro"}
    order = kinds[call.text(1).casefold()] if call.is_text(1) else call.number(1, 2.0)
    return v.scalar(float(np.linalg.norm(values.ravel() if is_vector else values, order)))  # type: ignore[arg-type]


@function("trapz", 1, 2)
def _trapz(call: NumericArguments) -> v.Value:
    values = call.numbers(len(call) - 1)
    if len(call) == 1:
        values = values.reshape(1, 0) if values.shape == (0, 0) else values
        axis = call.dimension(9, values)
        return v.trim_dimensions(_middles(values, axis).sum(axis=axis, keepdims=True))
    x, y = call.numbers(0).reshape(1, -1, order="F"), values.reshape(1, -1, order="F")
    if x.size != y.size or 1 not in values.shape:
        raise v.MatlabValueError("the arguments must be vectors of the same size")
    result: v.Array = (np.diff(x) * _middles(y, 1)).sum(axis=1, keepdims=True)
    return result


def _middles(values: Float, axis: int) -> v.Array:
    """Return the means of neighbours along a dimension."""
    places = np.arange(values.shape[axis])
    return 0.5 * (np.take(values, places[1:], axis=axis) + np.take(values, places[:-1], axis=axis))


@function("cumtrapz", 1, 2)
def _cumtrapz(call: NumericArguments) -> v.Value:
    y = call.numbers(len(call) - 1)
    flat = y.ravel(order="F")
    x = call.numbers(0).ravel(order="F") if len(call) == 2 else np.arange(float(flat.size))
    if 1 not in y.shape or x.size != flat.size:
        raise v.MatlabValueError("cumtrapz requires vectors of equal length")
    return np.concatenate(([0.0], np.cumsum(np.diff(x) * (flat[1:] + flat[:-1]) / 2)))[: flat.size].reshape(y.shape)


def _to_scalar(reduce: Callable[..., Any]) -> Callable[[NumericArguments], v.Value]:
    return lambda call: v.scalar(float(reduce(call.numbers(0))))


_TO_SCALAR: dict[str, Callable[..., Any]] = {
    "det": np.linalg.det,
    "rank": np.linalg.matrix_rank,
}
for _name, _reduce in _TO_SCALAR.items():
    function(_name, 1)(_to_scalar(_reduce))


@function("nnz", 1)
def _nnz(call: NumericArguments) -> v.Value:
    is_nonzero = call.numbers(0).reshape(-1, 1) != 0
    result: v.Array = is_nonzero.sum(axis=0, keepdims=True).astype(np.float64)
    return result


@function("trace", 1)
def _trace(call: NumericArguments) -> v.Value:
    diagonal = v.numbers(call.matrix(0)).diagonal().reshape(-1, 1)
    result: v.Array = diagonal.sum(axis=0, keepdims=True)
    return result


@function("pinv", 1)
def _pinv(call: NumericArguments) -> v.Value:
    values = v.numbers(call.matrix(0))
    if not np.isfinite(values).all():
        raise v.MatlabValueError("pinv requires finite numbers")
    return np.linalg.pinv(values)


function("isequal", 2, MANY)(lambda call: v.logical(all(is_equal(call[0], other) for other in call.values[1:])))
function("inv", 1)(lambda call: np.linalg.inv(v.numbers(call.matrix(0))))
