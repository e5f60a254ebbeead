"""Functions that make one number of many along a dimension: sums, means, extremes."""

from collections.abc import Callable

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.arithmetic import as_class, binary, result_class
from kennfeld.matlab.functions.registry import REGISTERED, Arguments, Function, function
from kennfeld.matlab.values import EMPTY, Array, NoValueError, Value, logical, numbers, scalar

__all__: list[str] = []

_Along = Callable[[Float, int], Array]


def _reduced(operation: _Along, of_nothing: float | bool | None, keeps: bool = False) -> Function:
    """A function of an array and a dimension; `keeps` the class of integers."""

    def run(given: Arguments) -> Value:
        values = given.numbers(0)
        is_all = given.is_text(1) and given.text(1) == "all"
        if values.shape == (0, 0) and of_nothing is not None:
            return logical(of_nothing) if isinstance(of_nothing, bool) else scalar(of_nothing)
        values = values.reshape(-1, 1, order="F") if is_all else values
        axis = 0 if is_all or given.is_text(1) else given.dimension(1, values)
        if axis >= values.ndim:
            values, axis = values[..., np.newaxis], values.ndim
        with np.errstate(all="ignore"):
            found = operation(values, axis)
        if found.dtype == np.bool_:
            return found
        return as_class(found, result_class(given.array(0)) if keeps else "double")

    return Function(run, 1, 3)


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
for _name, (_operation, _of_nothing, _keeps) in _SIMPLE.items():
    REGISTERED[_name] = _reduced(_operation, _of_nothing, _keeps)


def _deviation(root: bool) -> Function:
    def run(given: Arguments) -> Value:
        values = given.numbers(0)
        weight = given.number(1, 0.0) if len(given) > 1 and given.data(1).size else 0.0
        axis = given.dimension(2, values)
        found = np.var(values, axis=axis, ddof=int(weight == 0 and values.shape[axis] > 1), keepdims=True)
        return np.asarray(np.sqrt(found) if root else found)

    return Function(run, 1, 3)


REGISTERED["std"], REGISTERED["var"] = _deviation(True), _deviation(False)


def _extreme(name: str, along: _Along, arg: Callable[[Float, int], Array]) -> Function:
    def run(given: Arguments) -> "Value | tuple[Value, ...]":
        if len(given) == 2 or (len(given) == 3 and given.data(1).size):
            return _of_two(given, np.fmin if name == "min" else np.fmax)
        values = given.numbers(0)
        if not values.size:
            return EMPTY, EMPTY
        if given.is_text(2):
            values = values.reshape(-1, 1, order="F")
            axis = 0
        else:
            axis = given.dimension(2, values)
        if axis >= values.ndim:
            return given.array(0), np.ones(values.shape)
        found = along(values, axis)
        fill = np.inf if name == "min" else -np.inf
        at = arg(np.where(np.isnan(values), fill, values), axis)
        return as_class(found, result_class(given.array(0))), np.expand_dims(at, axis).astype(np.float64) + 1

    return Function(run, 1, 3)


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
    axis = given.dimension(2, values)
    if values.size < 2 or not 0 <= times <= 1000:
        return EMPTY
    return as_class(np.diff(values, times, axis), result_class(given.array(0)))


@function("nnz", 1)
def _nnz(given: Arguments) -> Value:
    return scalar(float(np.count_nonzero(given.numbers(0))))


@function("dot", 2)
def _dot(given: Arguments) -> Value:
    one, other = given.numbers(0), given.numbers(1)
    if one.size != other.size:
        raise NoValueError("both have to have the same size")
    if 1 in one.shape or 1 in other.shape:
        return scalar(float(one.ravel(order="F") @ other.ravel(order="F")))
    return np.asarray((one * other).sum(axis=0, keepdims=True))


@function("cross", 2)
def _cross(given: Arguments) -> Value:
    one, other = given.numbers(0), given.numbers(1)
    if one.size != 3 or other.size != 3:
        raise NoValueError("cross is for vectors of three numbers")
    return np.cross(one.ravel(), other.ravel()).reshape(one.shape)


@function("norm", 1, 2)
def _norm(given: Arguments) -> Value:
    values = given.numbers(0)
    kinds = {"inf": np.inf, "fro": 2 if 1 in values.shape else "fro"}
    order = kinds[given.text(1).casefold()] if given.is_text(1) else given.number(1, 2.0)
    return scalar(float(np.linalg.norm(values.ravel() if 1 in values.shape else values, order)))  # type: ignore[arg-type]


@function("trapz", 1, 2)
def _trapz(given: Arguments) -> Value:
    if len(given) == 1:
        values = given.numbers(0)
        return _trapezium(values, given.dimension(9, values))
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
    return np.linalg.inv(given.numbers(0))


@function("pinv", 1)
def _pinv(given: Arguments) -> Value:
    return np.linalg.pinv(given.numbers(0))
