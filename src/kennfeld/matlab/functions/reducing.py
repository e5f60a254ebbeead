"""Functions that make one number of many along a dimension: sums, means, extremes."""

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.arithmetic import as_class, binary, result_class
from kennfeld.matlab.functions.registry import REGISTERED, Arguments, Function, function
from kennfeld.matlab.values import EMPTY, Array, NoValueError, Value, data_of, logical, numbers, scalar, trimmed

__all__: list[str] = []

_Along = Callable[[Float, int], Array]
_WORDS = frozenset({"all", "double", "native", "default", "includenan", "includemissing", "omitnan"})


def _reduced(operation: _Along, of_nothing: float | bool | None, keeps: bool, without_nan: _Along | None) -> Function:
    """A function of an array and a dimension; `keeps` the class of integers.

    `of_nothing` is what it gives for no elements, `without_nan` computes it with NaN left out.
    """

    def run(given: Arguments) -> Value:
        given, words = _options(given)
        values = given.numbers(0)
        chosen = without_nan if "omitnan" in words else operation
        if chosen is None:
            raise NoValueError("omitnan is not supported here")
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
        return as_class(found, result_class(given.array(0)) if keeps else "double")

    return Function(run, 1, 4)


def _options(given: Arguments) -> tuple[Arguments, set[str]]:
    """The arguments without the words among them, and these."""
    words = {given.text(at).casefold() for at in range(1, len(given)) if given.is_text(at)}
    unknown = words - _WORDS
    if unknown:
        raise NoValueError(f"{min(unknown)} is not supported")
    kept = [value for at, value in enumerate(given.values) if not at or not given.is_text(at)]
    if "all" in words and any(data_of(value).size for value in kept[1:]):
        raise NoValueError("all stands beside a dimension")
    return replace(given, values=kept), words


def _with_axis(values: Float, axis: int) -> Float:
    """An array that has a dimension, which may be one long."""
    return values.reshape(values.shape + (1,) * (axis + 1 - values.ndim)) if axis >= values.ndim else values


def _trapezium(values: Float, axis: int) -> Float:
    return np.expand_dims(np.trapezoid(values, axis=axis), axis)


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
for _name, (_operation, _of_nothing, _keeps) in _SIMPLE.items():
    REGISTERED[_name] = _reduced(_operation, _of_nothing, _keeps, _WITHOUT_NAN.get(_name))


def _deviation(root: bool) -> Function:
    def run(given: Arguments) -> Value:
        values = given.numbers(0)
        weight = given.number(1, 0.0) if len(given) > 1 and given.data(1).size else 0.0
        if weight not in (0.0, 1.0):
            raise NoValueError(f"the weight {weight:g} is neither 0 nor 1")
        values = values.reshape(1, 0) if values.shape == (0, 0) and len(given) < 3 else values
        axis = given.dimension(2, values)
        values = _with_axis(values, axis)
        if not values.shape[axis]:
            return trimmed(np.full((*values.shape[:axis], 1, *values.shape[axis + 1 :]), np.nan))
        found = trimmed(np.var(values, axis=axis, ddof=int(weight == 0 and values.shape[axis] > 1), keepdims=True))
        return np.asarray(np.sqrt(found) if root else found)

    return Function(run, 1, 3)


REGISTERED["std"], REGISTERED["var"] = _deviation(True), _deviation(False)


def _extreme(name: str, along: _Along, arg: Callable[[Float, int], Array]) -> Function:
    def run(given: Arguments) -> "Value | tuple[Value, ...]":
        if len(given) == 2 or (len(given) == 3 and given.data(1).size):
            return _of_two(given, np.fmin if name == "min" else np.fmax)
        values = given.numbers(0)
        given, words = _options(given)
        if words & {"includenan", "includemissing"}:
            raise NoValueError("NaN is always passed over here")
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
        return as_class(trimmed(found), result_class(given.array(0))), trimmed(places)

    return Function(run, 1, 3)


def _extreme_of_nothing(values: Float, axis: int) -> Float:
    """The extreme of an empty array: one long where the others are none, else as empty as it was."""
    if axis >= values.ndim or not values.shape[axis]:
        return values
    return np.take(values, [0], axis=axis)


def _of_two(given: Arguments, operation: Callable[[Float, Float], Float]) -> Value:
    one, other = given.array(0), given.array(1)
    shape = binary("+", np.zeros(one.shape), np.zeros(other.shape), given.budget).shape
    parts = (numbers(array).reshape(array.shape + (1,) * (len(shape) - array.ndim)) for array in (one, other))
    return as_class(np.asarray(operation(*parts)), result_class(one, other))


REGISTERED["min"] = _extreme("min", lambda v, a: np.fmin.reduce(v, axis=a, keepdims=True), np.argmin)
REGISTERED["max"] = _extreme("max", lambda v, a: np.fmax.reduce(v, axis=a, keepdims=True), np.argmax)


@function("diff", 1, 3)
def _diff(given: Arguments) -> Value:
    values = given.numbers(0)
    times = given.whole(1, 1) if len(given) > 1 and given.data(1).size else 1
    if not 1 <= times <= 1000:
        raise NoValueError("diff is taken 1 to 1000 times")
    for _ in range(times):
        axis = given.dimension(2, values)
        if values.size == 1 and len(given) < 3:
            return EMPTY
        values = trimmed(np.diff(_with_axis(values, axis), axis=axis))
    return as_class(values, result_class(given.array(0)))


@function("nnz", 1)
def _nnz(given: Arguments) -> Value:
    return scalar(float(np.count_nonzero(given.numbers(0))))


@function("dot", 2)
def _dot(given: Arguments) -> Value:
    one, other = given.numbers(0), given.numbers(1)
    if one.size != other.size:
        raise NoValueError("both have to have the same size")
    if _is_vector(one) and _is_vector(other):
        return scalar(float(one.ravel(order="F") @ other.ravel(order="F")))
    if one.shape != other.shape:
        raise NoValueError("both have to have the same size")
    products = (one * other).reshape(1, 0) if one.shape == (0, 0) else one * other
    return np.asarray(products.sum(axis=given.dimension(9, products), keepdims=True))


def _is_vector(values: Array) -> bool:
    return values.ndim == 2 and 1 in values.shape


@function("cross", 2)
def _cross(given: Arguments) -> Value:
    one, other = given.numbers(0), given.numbers(1)
    if one.size != 3 or other.size != 3:
        raise NoValueError("cross is for vectors of three numbers")
    return np.cross(one.ravel(), other.ravel()).reshape(one.shape)


@function("norm", 1, 2)
def _norm(given: Arguments) -> Value:
    values = given.numbers(0)
    if not values.size:
        return scalar(0.0)
    is_vector = _is_vector(values)
    kinds = {"inf": np.inf, "fro": 2 if is_vector else "fro"}
    order = kinds[given.text(1).casefold()] if given.is_text(1) else given.number(1, 2.0)
    return scalar(float(np.linalg.norm(values.ravel() if is_vector else values, order)))  # type: ignore[arg-type]


@function("trapz", 1, 2)
def _trapz(given: Arguments) -> Value:
    if len(given) == 1:
        values = given.numbers(0)
        values = values.reshape(1, 0) if values.shape == (0, 0) else values
        return trimmed(_trapezium(values, given.dimension(9, values)))
    return scalar(float(np.trapezoid(given.numbers(1).ravel(order="F"), given.numbers(0).ravel(order="F"))))


@function("cumtrapz", 1, 2)
def _cumtrapz(given: Arguments) -> Value:
    y = given.numbers(len(given) - 1)
    flat = y.ravel(order="F")
    x = given.numbers(0).ravel(order="F") if len(given) == 2 else np.arange(float(flat.size))
    if 1 not in y.shape or x.size != flat.size:
        raise NoValueError("cumtrapz is for vectors of one length")
    return np.concatenate(([0.0], np.cumsum(np.diff(x) * (flat[1:] + flat[:-1]) / 2)))[: flat.size].reshape(y.shape)


@function("det", 1)
def _det(given: Arguments) -> Value:
    return scalar(float(np.linalg.det(given.numbers(0))))


@function("trace", 1)
def _trace(given: Arguments) -> Value:
    return scalar(float(np.trace(given.numbers(0))))


@function("rank", 1)
def _rank(given: Arguments) -> Value:
    return scalar(float(np.linalg.matrix_rank(given.numbers(0))))


@function("inv", 1)
def _inv(given: Arguments) -> Value:
    return np.linalg.inv(_matrix(given))


@function("pinv", 1)
def _pinv(given: Arguments) -> Value:
    values = _matrix(given)
    if not np.isfinite(values).all():
        raise NoValueError("pinv is for finite numbers")
    return np.linalg.pinv(values)


def _matrix(given: Arguments) -> Float:
    """The argument as a matrix."""
    values = given.numbers(0)
    if values.ndim > 2:
        raise NoValueError(f"a matrix is needed, not an array of {values.ndim} dimensions")
    return values
