"""Functions that find, sort and compare elements.

Functions that make one number of many along a dimension: sums, means, extremes.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.functions.numeric_registry import (
    MANY,
    NUMERIC_FUNCTIONS,
    NumericArguments,
    NumericFunction,
    function,
)
from kennfeld.matlab.operators import binary, cast_to_class, result_class
from kennfeld.matlab.values import (
    EMPTY,
    Array,
    MatlabCell,
    MatlabFunctionHandle,
    MatlabStruct,
    MatlabValueError,
    OpaqueValue,
    Value,
    characters,
    class_name,
    elements_of,
    logical,
    numbers,
    object_array,
    scalar,
    text,
    trimmed,
)

__all__ = ["matches_case"]

_Along = Callable[[Float, int], Array]
_WORDS = frozenset({"all", "double", "native", "default", "includenan", "includemissing", "omitnan"})

_SIMPLE: dict[str, tuple[_Along, float | bool | None, bool]] = {
    "sum": (lambda values, axis: values.sum(axis=axis, keepdims=True), 0.0, True),
    "prod": (lambda values, axis: values.prod(axis=axis, keepdims=True), 1.0, True),
    "mean": (lambda values, axis: values.mean(axis=axis, keepdims=True), float("nan"), False),
    "median": (lambda values, axis: np.median(values, axis=axis, keepdims=True), float("nan"), False),
    "any": (lambda values, axis: (values != 0).any(axis=axis, keepdims=True), False, False),
    "all": (lambda values, axis: (values != 0).all(axis=axis, keepdims=True), True, False),
    "cumsum": (lambda values, axis: values.cumsum(axis=axis), None, True),
    "cumprod": (lambda values, axis: values.cumprod(axis=axis), None, True),
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


@function("find", 1, 3)
def _find(given: NumericArguments) -> "Value | tuple[Value, ...]":
    values = given.numbers(0)
    found = np.flatnonzero(values.ravel(order="F"))
    if len(given) > 1:
        count = given.whole(1)
        if count < 1:
            raise MatlabValueError(f"{count} is no number of elements")
        from_end = len(given) > 2 and given.text(2) == "last"
        found = found[max(found.size - count, 0) :] if from_end else found[:count]
    is_row = values.ndim == 2 and values.shape[0] == 1 and values.shape[1] != 1
    shape = (1, -1) if is_row else (-1, 1)
    if values.shape == (0, 0) or (values.size == 1 and not found.size):
        shape = (0, 0)
    if given.outputs < 2:
        return (found + 1.0).reshape(shape)
    rows, columns = np.unravel_index(found, (values.shape[0], values.size // max(values.shape[0], 1)), order="F")
    taken = values.ravel(order="F")[found]
    return (rows + 1.0).reshape(shape), (columns + 1.0).reshape(shape), taken.reshape(shape)


@function("sort", 1, 3)
def _sort(given: NumericArguments) -> "Value | tuple[Value, ...]":
    is_down = given.is_text(len(given) - 1) and len(given) > 1 and given.text(len(given) - 1).casefold() == "descend"
    if isinstance(given[0], MatlabCell):
        words = [text(one) for one in given[0].values.ravel(order="F")]
        ranks = sorted(range(len(words)), key=lambda at: words[at], reverse=is_down)
        sorted_ = object_array([characters(words[at]) for at in ranks], given[0].values.shape)
        return MatlabCell(sorted_), np.array(ranks, dtype=np.float64).reshape(given[0].values.shape, order="F") + 1
    array = given.array(0)
    values = array if array.dtype.kind == "U" else numbers(array)
    axis = given.dimension(1, array) if len(given) > 1 and not given.is_text(1) else given.dimension(9, array)
    order: Array = np.argsort(-values if is_down and values.dtype.kind != "U" else values, axis=axis, kind="stable")
    if is_down and values.dtype.kind == "f":
        order = _missing_first(values, order, axis)
    if is_down and values.dtype.kind == "U":
        order = np.flip(order, axis)
    return np.take_along_axis(array, order, axis), order.astype(np.float64) + 1


def _missing_first(values: Array, order: Array, axis: int) -> Array:
    """NaN counts as larger than any number."""
    missing = np.isnan(np.take_along_axis(values, order, axis))
    return np.take_along_axis(order, np.argsort(~missing, axis=axis, kind="stable"), axis)


@function("unique", 1, 3)
def _unique(given: NumericArguments) -> "Value | tuple[Value, ...]":
    is_stable = any(word == "stable" for word in given.words(1))
    if isinstance(given[0], MatlabCell):
        words = [text(one) for one in given[0].values.ravel(order="F")]
        kept = list(dict.fromkeys(words)) if is_stable else sorted(set(words))
        return MatlabCell(object_array([characters(word) for word in kept], (len(kept), 1)))
    array = given.array(0)
    if any(word == "rows" for word in given.words(1)):
        return np.unique(array, axis=0)
    flat = array.ravel(order="F")
    found, first, back = np.unique(flat, return_index=True, return_inverse=True, equal_nan=False)
    if is_stable:
        order = np.argsort(first, kind="stable")
        found, first = found[order], first[order]
        back = np.argsort(order, kind="stable")[back]
    shape = (1, -1) if array.ndim == 2 and array.shape[0] == 1 and array.size else (-1, 1)
    return found.reshape(shape), (first + 1.0).reshape(-1, 1), (back + 1.0).reshape(-1, 1)


def _words(value: Value) -> set[str]:
    if isinstance(value, MatlabCell):
        return {text(one) for one in value.values.ravel()}
    return {text(value)}


@function("ismember", 2)
def _ismember(given: NumericArguments) -> "Value | tuple[Value, ...]":
    if isinstance(given[1], MatlabCell):
        known = _words(given[1])
        if isinstance(given[0], MatlabCell):
            parts = given[0].values
            return np.array([text(one) in known for one in parts.ravel()], dtype=bool).reshape(parts.shape)
        return logical(text(given[0]) in known)
    array, among = given.array(0), given.array(1).ravel(order="F")
    if array.dtype.kind != "U" or among.dtype.kind != "U":
        array, among = numbers(array), numbers(among.reshape(1, -1)).ravel()
    values, first = np.unique(among, return_index=True)
    at = np.searchsorted(values, array)
    inside = np.isin(array, among)
    place = first[np.minimum(at, max(values.size - 1, 0))] + 1.0 if values.size else np.zeros(array.shape)
    return inside, np.where(inside, place, 0.0)


def _set_operation(given: NumericArguments, name: str) -> Value:
    if isinstance(given[0], MatlabCell) or isinstance(given[1], MatlabCell):
        one, other = _words(given[0]), _words(given[1])
        kept = sorted(one | other if name == "union" else one & other if name == "intersect" else one - other)
        return MatlabCell(object_array([characters(word) for word in kept], (1, len(kept))))
    one_, other_ = given.array(0), given.array(1)
    operations: dict[str, Callable[..., Array]] = {
        "union": np.union1d,
        "intersect": np.intersect1d,
        "setdiff": np.setdiff1d,
    }
    found = operations[name](one_.ravel(order="F"), other_.ravel(order="F"))
    is_column = one_.shape[1] == 1 and one_.shape[0] > 1 and (name == "setdiff" or other_.shape[1] == 1)
    return found.reshape((-1, 1) if is_column else (1, -1))


@function("union", 2)
def _union(given: NumericArguments) -> Value:
    return _set_operation(given, "union")


@function("intersect", 2)
def _intersect(given: NumericArguments) -> Value:
    return _set_operation(given, "intersect")


@function("setdiff", 2)
def _setdiff(given: NumericArguments) -> Value:
    return _set_operation(given, "setdiff")


@function("issorted", 1)
def _issorted(given: NumericArguments) -> Value:
    values = given.numbers(0).ravel(order="F")
    return logical(bool((np.diff(values) >= 0).all()))


@function("isequal", 2, MANY)
def _isequal(given: NumericArguments) -> Value:
    return logical(all(is_equal(given[0], other) for other in given.values[1:]))


def is_equal(one: Value, other: Value) -> bool:
    """Whether two values have the same size and elements; NaN equals nothing."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if one.dtype.kind == "O" or other.dtype.kind == "O":
            return _as_texts(one) == _as_texts(other) is not None
        return one.shape == other.shape and bool((numbers(one) == numbers(other)).all())
    if class_name(one) != class_name(other) or isinstance(one, MatlabFunctionHandle | OpaqueValue):
        return False
    if isinstance(one, MatlabCell) and isinstance(other, MatlabCell):
        pairs = zip(one.values.ravel(), other.values.ravel(), strict=False)
        return one.values.shape == other.values.shape and all(is_equal(a, b) for a, b in pairs)
    if isinstance(one, MatlabStruct) and isinstance(other, MatlabStruct):
        if one.elements.shape != other.elements.shape or set(one.names) != set(other.names):
            return False
        both = zip(one.elements.ravel(), other.elements.ravel(), strict=True)
        return all(is_equal(a[name], b[name]) for a, b in both for name in one.names)
    return False


def _as_texts(array: Array) -> list[str] | None:
    if array.dtype.kind == "U":
        return ["".join(array.ravel(order="F").tolist())]
    return [str(one) for one in array.ravel(order="F")] if array.dtype.kind == "O" else None


@function("histc", 2)
def _histc(given: NumericArguments) -> Value:
    values, edges = given.numbers(0).ravel(), given.numbers(1)
    flat = edges.ravel(order="F")
    if flat.size > 1 and (np.diff(flat) < 0).any():
        raise MatlabValueError("the edges have to increase")
    counts = np.histogram(values, flat)[0].astype(np.float64) if flat.size > 1 else np.zeros(0)
    last = float((values == flat[-1]).sum()) if flat.size else 0.0
    if counts.size:
        counts[-1] -= last
    return np.append(counts, last).reshape(edges.shape)


def matches_case(subject: Value, case: Value) -> bool:
    """Whether a `case` is the one of a `switch`: the same number or text, or one of the cells."""
    if isinstance(case, MatlabCell):
        return any(matches_case(subject, one) for one in case.values.ravel(order="F"))
    if not isinstance(subject, np.ndarray) or not isinstance(case, np.ndarray):
        return False
    if subject.dtype.kind in "UO" or case.dtype.kind in "UO":
        return _as_texts(subject) == _as_texts(case) is not None
    return bool(case.size) and bool(subject.size) and bool((numbers(subject) == numbers(case)).all())


def _reduced(
    operation: _Along, of_nothing: float | bool | None, keeps: bool, without_nan: _Along | None
) -> NumericFunction:
    """A function of an array and a dimension; `keeps` the class of integers.

    `of_nothing` is what it gives for no elements, `without_nan` computes it with NaN left out.
    """

    def run(given: NumericArguments) -> Value:
        given, words = _options(given)
        values = given.numbers(0)
        chosen = without_nan if "omitnan" in words else operation
        if chosen is None:
            raise MatlabValueError("omitnan is not supported here")
        if values.shape == (0, 0) and of_nothing is not None and len(given) == 1:
            return logical(of_nothing) if isinstance(of_nothing, bool) else scalar(of_nothing)
        values = values.reshape(-1, 1, order="F") if "all" in words else values
        axis = given.dimension(1, values)
        values = _with_axis(values, axis)
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # the mean of nothing is not a number
            found = trimmed(chosen(values, axis))
        if found.dtype == np.bool_:
            return found
        return cast_to_class(found, result_class(given.array(0)) if keeps else "double")

    return NumericFunction(run, 1, 4)


def _options(given: NumericArguments) -> tuple[NumericArguments, set[str]]:
    """The arguments without the words among them, and these."""
    words = {given.text(at).casefold() for at in range(1, len(given)) if given.is_text(at)}
    unknown = words - _WORDS
    if unknown:
        raise MatlabValueError(f"{min(unknown)} is not supported")
    kept = [value for at, value in enumerate(given.values) if not at or not given.is_text(at)]
    if "all" in words and any(elements_of(value).size for value in kept[1:]):
        raise MatlabValueError("all stands beside a dimension")
    return replace(given, values=kept), words


def _with_axis(values: Float, axis: int) -> Float:
    """An array that has a dimension, which may be one long."""
    return values.reshape(values.shape + (1,) * (axis + 1 - values.ndim)) if axis >= values.ndim else values


def _trapezium(values: Float, axis: int) -> Float:
    return np.expand_dims(np.trapezoid(values, axis=axis), axis)


for _name, (_operation, _of_nothing, _keeps) in _SIMPLE.items():
    NUMERIC_FUNCTIONS[_name] = _reduced(_operation, _of_nothing, _keeps, _WITHOUT_NAN.get(_name))


def _deviation(root: bool) -> NumericFunction:
    def run(given: NumericArguments) -> Value:
        values = given.numbers(0)
        weight = given.number(1, 0.0) if len(given) > 1 and given.data(1).size else 0.0
        if weight not in (0.0, 1.0):
            raise MatlabValueError(f"the weight {weight:g} is neither 0 nor 1")
        values = values.reshape(1, 0) if values.shape == (0, 0) and len(given) < 3 else values
        axis = given.dimension(2, values)
        values = _with_axis(values, axis)
        if not values.shape[axis]:
            return trimmed(np.full((*values.shape[:axis], 1, *values.shape[axis + 1 :]), np.nan))
        found = trimmed(np.var(values, axis=axis, ddof=int(weight == 0 and values.shape[axis] > 1), keepdims=True))
        return np.asarray(np.sqrt(found) if root else found)

    return NumericFunction(run, 1, 3)


NUMERIC_FUNCTIONS["std"], NUMERIC_FUNCTIONS["var"] = _deviation(True), _deviation(False)


def _extreme(name: str, along: _Along, arg: Callable[[Float, int], Array]) -> NumericFunction:
    def run(given: NumericArguments) -> "Value | tuple[Value, ...]":
        if len(given) == 2 or (len(given) == 3 and given.data(1).size):
            return _of_two(given, np.fmin if name == "min" else np.fmax)
        values = given.numbers(0)
        given, words = _options(given)
        if words & {"includenan", "includemissing"}:
            raise MatlabValueError("NaN is always passed over here")
        values = values.reshape(-1, 1, order="F") if "all" in words else values
        axis = given.dimension(2, values)
        if not values.size:
            return (_extreme_of_nothing(values, axis),) * 2
        if axis >= values.ndim:
            return given.array(0), np.ones(values.shape)
        found = along(values, axis)
        fill = np.inf if name == "min" else -np.inf
        at = arg(np.where(np.isnan(values), fill, values), axis)
        places = np.expand_dims(at, axis).astype(np.float64) + 1
        return cast_to_class(trimmed(found), result_class(given.array(0))), trimmed(places)

    return NumericFunction(run, 1, 3)


def _extreme_of_nothing(values: Float, axis: int) -> Float:
    """The extreme of an empty array: one long where the others are none, else as empty as it was."""
    if axis >= values.ndim or not values.shape[axis]:
        return values
    return np.take(values, [0], axis=axis)


def _of_two(given: NumericArguments, operation: Callable[[Float, Float], Float]) -> Value:
    one, other = given.array(0), given.array(1)
    shape = binary("+", np.zeros(one.shape), np.zeros(other.shape), given.budget).shape
    parts = (numbers(array).reshape(array.shape + (1,) * (len(shape) - array.ndim)) for array in (one, other))
    return cast_to_class(np.asarray(operation(*parts)), result_class(one, other))


NUMERIC_FUNCTIONS["min"] = _extreme("min", lambda v, a: np.fmin.reduce(v, axis=a, keepdims=True), np.argmin)
NUMERIC_FUNCTIONS["max"] = _extreme("max", lambda v, a: np.fmax.reduce(v, axis=a, keepdims=True), np.argmax)


@function("diff", 1, 3)
def _diff(given: NumericArguments) -> Value:
    values = given.numbers(0)
    times = given.whole(1, 1) if len(given) > 1 and given.data(1).size else 1
    if not 1 <= times <= 1000:
        raise MatlabValueError("diff is taken 1 to 1000 times")
    for _ in range(times):
        axis = given.dimension(2, values)
        if values.size == 1 and len(given) < 3:
            return EMPTY
        values = trimmed(np.diff(_with_axis(values, axis), axis=axis))
    return cast_to_class(values, result_class(given.array(0)))


@function("nnz", 1)
def _nnz(given: NumericArguments) -> Value:
    return scalar(float(np.count_nonzero(given.numbers(0))))


@function("dot", 2)
def _dot(given: NumericArguments) -> Value:
    one, other = given.numbers(0), given.numbers(1)
    if one.size != other.size:
        raise MatlabValueError("both have to have the same size")
    if _is_vector(one) and _is_vector(other):
        return scalar(float(one.ravel(order="F") @ other.ravel(order="F")))
    if one.shape != other.shape:
        raise MatlabValueError("both have to have the same size")
    products = (one * other).reshape(1, 0) if one.shape == (0, 0) else one * other
    return np.asarray(products.sum(axis=given.dimension(9, products), keepdims=True))


def _is_vector(values: Array) -> bool:
    return values.ndim == 2 and 1 in values.shape


@function("cross", 2)
def _cross(given: NumericArguments) -> Value:
    one, other = given.numbers(0), given.numbers(1)
    if one.size != 3 or other.size != 3:
        raise MatlabValueError("cross is for vectors of three numbers")
    return np.cross(one.ravel(), other.ravel()).reshape(one.shape)


@function("norm", 1, 2)
def _norm(given: NumericArguments) -> Value:
    values = given.numbers(0)
    if not values.size:
        return scalar(0.0)
    is_vector = _is_vector(values)
    kinds = {"inf": np.inf, "fro": 2 if is_vector else "fro"}
    order = kinds[given.text(1).casefold()] if given.is_text(1) else given.number(1, 2.0)
    return scalar(float(np.linalg.norm(values.ravel() if is_vector else values, order)))  # type: ignore[arg-type]


@function("trapz", 1, 2)
def _trapz(given: NumericArguments) -> Value:
    if len(given) == 1:
        values = given.numbers(0)
        values = values.reshape(1, 0) if values.shape == (0, 0) else values
        return trimmed(_trapezium(values, given.dimension(9, values)))
    return scalar(float(np.trapezoid(given.numbers(1).ravel(order="F"), given.numbers(0).ravel(order="F"))))


@function("cumtrapz", 1, 2)
def _cumtrapz(given: NumericArguments) -> Value:
    y = given.numbers(len(given) - 1)
    flat = y.ravel(order="F")
    x = given.numbers(0).ravel(order="F") if len(given) == 2 else np.arange(float(flat.size))
    if 1 not in y.shape or x.size != flat.size:
        raise MatlabValueError("cumtrapz is for vectors of one length")
    return np.concatenate(([0.0], np.cumsum(np.diff(x) * (flat[1:] + flat[:-1]) / 2)))[: flat.size].reshape(y.shape)


@function("det", 1)
def _det(given: NumericArguments) -> Value:
    return scalar(float(np.linalg.det(given.numbers(0))))


@function("trace", 1)
def _trace(given: NumericArguments) -> Value:
    return scalar(float(np.trace(given.numbers(0))))


@function("rank", 1)
def _rank(given: NumericArguments) -> Value:
    return scalar(float(np.linalg.matrix_rank(given.numbers(0))))


@function("inv", 1)
def _inv(given: NumericArguments) -> Value:
    return np.linalg.inv(_matrix(given))


@function("pinv", 1)
def _pinv(given: NumericArguments) -> Value:
    values = _matrix(given)
    if not np.isfinite(values).all():
        raise MatlabValueError("pinv is for finite numbers")
    return np.linalg.pinv(values)


def _matrix(given: NumericArguments) -> Float:
    """The argument as a matrix."""
    values = given.numbers(0)
    if values.ndim > 2:
        raise MatlabValueError(f"a matrix is needed, not an array of {values.ndim} dimensions")
    return values
