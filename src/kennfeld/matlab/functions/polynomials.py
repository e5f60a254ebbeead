"""Polynomials, filters and interpolation in tables."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.matlab.functions.numeric_registry import MANY, NumericArguments, function
from kennfeld.matlab.values import MatlabValueError, Value, row

__all__: list[str] = []

_METHODS = {"linear", "nearest", "previous", "next", "spline", "pchip", "cubic", "makima"}


@function("polyfit", 3)
def _polyfit(call: NumericArguments) -> Value:
    x, y, degree = call.numbers(0).ravel(order="F"), call.numbers(1).ravel(order="F"), call.integer(2)
    if x.size != y.size or not 0 <= degree < 100:
        raise MatlabValueError("polyfit requires x and y of equal length and a degree from 0 to 99")
    call.budget.allocate(x.size * (degree + 1) * 10)
    return row(np.linalg.lstsq(np.vander(x, degree + 1), y, rcond=None)[0])


@function("polyval", 2)
def _polyval(call: NumericArguments) -> Value:
    coefficients, x = call.numbers(0).ravel(order="F"), call.numbers(1)
    result = np.zeros(x.shape)
    for at in range(coefficients.size):
        call.budget.allocate(result.size)
        result = result * x + coefficients[at : at + 1]
    return result


@function("polyder", 1)
def _polyder(call: NumericArguments) -> Value:
    coefficients = np.polyder(call.numbers(0).ravel(order="F"))
    return row(coefficients if coefficients.size else [0.0])


@function("conv", 2)
def _conv(call: NumericArguments) -> Value:
    left, right = call.numbers(0), call.numbers(1)
    if not left.size or not right.size:
        raise MatlabValueError("conv requires two vectors")
    call.budget.allocate(left.size * right.size / 10 + left.size + right.size)
    if any(values.ndim > 2 or 1 not in values.shape for values in (left, right)):
        raise MatlabValueError("conv requires two vectors")
    product = np.convolve(left.ravel(), right.ravel())
    longer = left if left.size > right.size else right
    return product.reshape(-1, 1) if longer.shape[0] > 1 else row(product)


@function("roots", 1)
def _roots(call: NumericArguments) -> Value:
    coefficients = call.numbers(0).ravel()
    call.budget.allocate(coefficients.size**3 / 10)
    roots = np.roots(coefficients)
    if np.iscomplexobj(roots) and (np.abs(roots.imag) > 0).any():
        raise MatlabValueError("some of the roots are complex")
    return np.asarray(roots.real, dtype=np.float64).reshape(-1, 1)


def _sort_points(points: Float, values: Float) -> tuple[Float, Float]:
    order = np.argsort(points, kind="stable")
    points, values = points[order], values[order]
    if points.size < 2 or not (np.diff(points) > 0).all() or not np.isfinite(points).all():
        raise MatlabValueError("the points must be at least two distinct finite numbers")
    return points, values


@function("interp1", 2, 5)
def _interp1(call: NumericArguments) -> Value:
    count = next((at for at in range(len(call)) if call.is_text(at)), min(len(call), 3))
    if count == 2:
        table = call.numbers(0)
        points, at = np.arange(1.0, table.size + 1), call.numbers(1)
    else:
        points, table, at = call.numbers(0).ravel(order="F"), call.numbers(1), call.numbers(2)
    method = call.text(count).casefold() if call.is_text(count) else "linear"
    method, beyond = (method.removeprefix("*"), call.values[count + 1 :] if call.is_text(count) else call.values[3:])
    if method not in _METHODS:
        raise MatlabValueError(f"unknown interpolation method {method}")
    is_matrix = 1 not in table.shape
    columns = table.T if is_matrix else [table.ravel(order="F")]
    call.budget.allocate(at.size * len(columns))
    results = [
        _interpolate(points, column, at, method, _outside_value(call, len(beyond), method)) for column in columns
    ]
    if is_matrix:
        return np.stack([result.ravel(order="F") for result in results], axis=1)
    return results[0]


def _outside_value(call: NumericArguments, count: int, method: str) -> float | None:
    """Return the value outside of the points; None to extrapolate."""
    if not count:
        return None if method in ("spline", "pchip", "cubic", "makima") else math.nan
    last = len(call) - 1
    if call.is_text(last):
        if call.text(last) != "extrap":
            raise MatlabValueError(f"unknown extrapolation method {call.text(last)}")
        return None
    return call.number(last)


def _interpolate(points: Float, values: Float, at: Float, method: str, beyond: float | None) -> Float:
    if points.size != values.size:
        raise MatlabValueError(f"{points.size} points, but {values.size} values")
    points, values = _sort_points(points, values)
    result = _make_curve(points, values, method)(at)
    if beyond is not None:
        result = np.where((at < points[0]) | (at > points[-1]), beyond, result)
    return np.where(np.isnan(at), np.nan, result)


def _make_curve(points: Float, values: Float, method: str) -> Callable[[Float], Any]:
    if method not in ("spline", "pchip", "cubic", "makima"):
        return lambda at: _interpolate_cells(points, values, at, method)
    from scipy.interpolate import Akima1DInterpolator, CubicSpline, PchipInterpolator

    curve: Callable[[Float], Any]
    if method == "makima":
        curve = Akima1DInterpolator(points, values, method="makima", extrapolate=True)
    else:
        curve = CubicSpline(points, values) if method == "spline" else PchipInterpolator(points, values)
    return curve


def _interpolate_cells(points: Float, values: Float, at: Float, method: str) -> Float:
    cell = np.clip(np.searchsorted(points, at, side="right") - 1, 0, points.size - 2)
    low, high = points[cell], points[cell + 1]
    if method == "linear":
        share = (at - low) / (high - low)
        # exact at both ends of a cell, even if the value at the other end is not finite
        inner = values[cell] + share * (values[cell + 1] - values[cell])
        return np.where(at == low, values[cell], np.where(at == high, values[cell + 1], inner))
    if method == "nearest":
        return np.where(at - low < high - at, values[cell], values[cell + 1])
    if method == "previous":
        return np.where(at >= high, values[cell + 1], values[cell])
    return np.where(at <= low, values[cell], values[cell + 1])


@function("interp2", 3, 7)
def _interp2(call: NumericArguments) -> Value:
    count = next((at for at in range(len(call)) if call.is_text(at)), min(len(call), 5))
    if count == 3:
        table, x_at, y_at = call.numbers(0), call.numbers(1), call.numbers(2)
        x, y = np.arange(1.0, table.shape[1] + 1), np.arange(1.0, table.shape[0] + 1)
    elif count >= 5:
        x, y = _axis(call.numbers(0), 1), _axis(call.numbers(1), 0)
        table, x_at, y_at = (call.numbers(at) for at in (2, 3, 4))
    else:
        raise MatlabValueError("interp2 requires x, y, a table and two query points")
    method = call.text(count).casefold().removeprefix("*") if call.is_text(count) else "linear"
    if method not in ("linear", "nearest"):
        raise MatlabValueError(f"interp2 does not support the method {method}")
    if table.shape != (y.size, x.size):
        raise MatlabValueError(f"the table must have {y.size} rows and {x.size} columns")
    if x_at.shape != y_at.shape and 1 in x_at.shape and 1 in y_at.shape and x_at.shape[0] == 1 and y_at.shape[1] == 1:
        x_at, y_at = np.broadcast_arrays(x_at, y_at)
    beyond = call.number(len(call) - 1) if len(call) > count + 1 and not call.is_text(len(call) - 1) else math.nan
    call.budget.allocate(4 * x_at.size)
    return _interpolate_table(_sort_points(x, x)[0], _sort_points(y, y)[0], table, x_at, y_at, method, beyond)


def _axis(points: Float, along: int) -> Float:
    """Return the breakpoints of an axis given as a vector or as a grid."""
    if 1 in points.shape:
        return points.ravel(order="F")
    return points[0, :] if along else points[:, 0]


def _interpolate_table(x: Float, y: Float, table: Float, x_at: Float, y_at: Float, method: str, beyond: float) -> Float:
    i = np.clip(np.searchsorted(x, x_at, side="right") - 1, 0, x.size - 2)
    j = np.clip(np.searchsorted(y, y_at, side="right") - 1, 0, y.size - 2)
    u, v = (x_at - x[i]) / (x[i + 1] - x[i]), (y_at - y[j]) / (y[j + 1] - y[j])
    if method == "nearest":
        u, v = np.floor(u + 0.5), np.floor(v + 0.5)
    low = table[j, i] * (1 - u) + table[j, i + 1] * u
    high = table[j + 1, i] * (1 - u) + table[j + 1, i + 1] * u
    outside = (x_at < x[0]) | (x_at > x[-1]) | (y_at < y[0]) | (y_at > y[-1])
    return np.where(outside, beyond, low * (1 - v) + high * v)


@function("filter", 3, MANY)
def _filter(call: NumericArguments) -> Value:
    from scipy.signal import lfilter

    numerator, denominator, x = call.numbers(0).ravel(), call.numbers(1).ravel(), call.numbers(2)
    if not denominator.size or denominator[0] == 0:
        raise MatlabValueError("the first coefficient of the denominator must not be 0")
    call.budget.allocate(x.size * (numerator.size + denominator.size))
    return np.asarray(lfilter(numerator, denominator, x.ravel(order="F"))).reshape(x.shape, order="F")


function("polyint", 1, 2)(lambda call: row(np.polyint(call.numbers(0).ravel(order="F"), k=call.number(1, 0.0))))
