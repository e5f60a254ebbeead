"""Polynomials and interpolation in tables."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.functions.numeric_registry import MANY, NumericArguments, function
from kennfeld.matlab.values import MatlabValueError, Value, row

__all__: list[str] = []

_METHODS = {"linear", "nearest", "previous", "next", "spline", "pchip", "cubic", "makima"}


@function("polyfit", 3)
def _polyfit(given: NumericArguments) -> Value:
    x, y, degree = given.numbers(0).ravel(order="F"), given.numbers(1).ravel(order="F"), given.whole(2)
    if x.size != y.size or not 0 <= degree < 100:
        raise MatlabValueError("polyfit needs x and y of one length, and a degree from 0 to 99")
    given.budget.make(x.size * (degree + 1) * 10)
    powers = np.vander(x, degree + 1)
    return row(np.linalg.lstsq(powers, y, rcond=None)[0])


@function("polyval", 2)
def _polyval(given: NumericArguments) -> Value:
    found = np.zeros_like(given.numbers(1))
    for coefficient in given.numbers(0).ravel(order="F"):
        given.budget.make(found.size)
        found = found * given.numbers(1) + coefficient
    return found


@function("polyder", 1)
def _polyder(given: NumericArguments) -> Value:
    found = np.polyder(given.numbers(0).ravel(order="F"))
    return row(found if found.size else [0.0])


@function("polyint", 1, 2)
def _polyint(given: NumericArguments) -> Value:
    return row(np.polyint(given.numbers(0).ravel(order="F"), k=given.number(1, 0.0)))


@function("conv", 2)
def _conv(given: NumericArguments) -> Value:
    one, other = given.numbers(0), given.numbers(1)
    if not one.size or not other.size:
        raise MatlabValueError("conv needs two vectors")
    given.budget.make(one.size * other.size / 10 + one.size + other.size)
    if any(values.ndim > 2 or 1 not in values.shape for values in (one, other)):
        raise MatlabValueError("conv needs two vectors")
    found = np.convolve(one.ravel(), other.ravel())
    longer = one if one.size > other.size else other
    return found.reshape(-1, 1) if longer.shape[0] > 1 else row(found)


@function("roots", 1)
def _roots(given: NumericArguments) -> Value:
    coefficients = given.numbers(0).ravel()
    given.budget.make(coefficients.size**3 / 10)
    found = np.roots(coefficients)
    if np.iscomplexobj(found) and (np.abs(found.imag) > 0).any():
        raise MatlabValueError("some of the roots are complex")
    return np.asarray(found.real, dtype=np.float64).reshape(-1, 1)


def _sorted(points: Float, values: Float) -> tuple[Float, Float]:
    order = np.argsort(points, kind="stable")
    points, values = points[order], values[order]
    if points.size < 2 or not (np.diff(points) > 0).all() or not np.isfinite(points).all():
        raise MatlabValueError("the points have to be two or more different numbers")
    return points, values


@function("interp1", 2, 5)
def _interp1(given: NumericArguments) -> Value:
    count = next((at for at in range(len(given)) if given.is_text(at)), min(len(given), 3))
    if count == 2:
        table = given.numbers(0)
        points, at = np.arange(1.0, table.size + 1), given.numbers(1)
    else:
        points, table, at = given.numbers(0).ravel(order="F"), given.numbers(1), given.numbers(2)
    method = given.text(count).casefold() if given.is_text(count) else "linear"
    method, beyond = method.removeprefix("*"), given.values[count + 1 :] if given.is_text(count) else given.values[3:]
    if method not in _METHODS:
        raise MatlabValueError(f"{method} is no method of interpolation")
    is_matrix = 1 not in table.shape
    columns = table.T if is_matrix else [table.ravel(order="F")]
    given.budget.make(at.size * len(columns))
    found = [_interpolated(points, column, at, method, _beyond(given, len(beyond), method)) for column in columns]
    if is_matrix:
        return np.stack([one.ravel(order="F") for one in found], axis=1)
    return found[0]


def _beyond(given: NumericArguments, count: int, method: str) -> float | None:
    """What stands for a value beyond the points; None to extrapolate."""
    if not count:
        return None if method in ("spline", "pchip", "cubic", "makima") else math.nan
    last = len(given) - 1
    if given.is_text(last):
        if given.text(last) != "extrap":
            raise MatlabValueError(f"{given.text(last)} is no rule for values beyond the points")
        return None
    return given.number(last)


def _interpolated(points: Float, values: Float, at: Float, method: str, beyond: float | None) -> Float:
    if points.size != values.size:
        raise MatlabValueError(f"{points.size} points and {values.size} values do not fit")
    points, values = _sorted(points, values)
    found = _curve(points, values, method)(at)
    if beyond is not None:
        found = np.where((at < points[0]) | (at > points[-1]), beyond, found)
    return np.where(np.isnan(at), np.nan, found)


def _curve(points: Float, values: Float, method: str) -> Callable[[Float], Any]:
    if method not in ("spline", "pchip", "cubic", "makima"):
        return lambda at: _stepwise(points, values, at, method)
    from scipy.interpolate import Akima1DInterpolator, CubicSpline, PchipInterpolator

    made: Callable[[Float], Any]
    if method == "makima":
        made = Akima1DInterpolator(points, values, method="makima", extrapolate=True)
    else:
        made = CubicSpline(points, values) if method == "spline" else PchipInterpolator(points, values)
    return made


def _stepwise(points: Float, values: Float, at: Float, method: str) -> Float:
    cell = np.clip(np.searchsorted(points, at, side="right") - 1, 0, points.size - 2)
    low, high = points[cell], points[cell + 1]
    if method == "linear":
        share = (at - low) / (high - low)
        # at the ends of a cell the values there hold exactly, whatever stands at the other end
        inner = values[cell] + share * (values[cell + 1] - values[cell])
        return np.where(at == low, values[cell], np.where(at == high, values[cell + 1], inner))
    if method == "nearest":
        return np.where(at - low < high - at, values[cell], values[cell + 1])
    if method == "previous":
        return np.where(at >= high, values[cell + 1], values[cell])
    return np.where(at <= low, values[cell], values[cell + 1])


@function("interp2", 3, 7)
def _interp2(given: NumericArguments) -> Value:
    count = next((at for at in range(len(given)) if given.is_text(at)), min(len(given), 5))
    if count == 3:
        table, x_at, y_at = given.numbers(0), given.numbers(1), given.numbers(2)
        x, y = np.arange(1.0, table.shape[1] + 1), np.arange(1.0, table.shape[0] + 1)
    elif count >= 5:
        x, y = _axis(given.numbers(0), 1), _axis(given.numbers(1), 0)
        table, x_at, y_at = (given.numbers(at) for at in (2, 3, 4))
    else:
        raise MatlabValueError("interp2 needs x, y, a table and two places")
    method = given.text(count).casefold().removeprefix("*") if given.is_text(count) else "linear"
    if method not in ("linear", "nearest"):
        raise MatlabValueError(f"the method {method} of interp2 is not known")
    if table.shape != (y.size, x.size):
        raise MatlabValueError(f"a table of {y.size} rows and {x.size} columns is needed")
    if x_at.shape != y_at.shape and 1 in x_at.shape and 1 in y_at.shape and x_at.shape[0] == 1 and y_at.shape[1] == 1:
        x_at, y_at = np.broadcast_arrays(x_at, y_at)
    beyond = given.number(len(given) - 1) if len(given) > count + 1 and not given.is_text(len(given) - 1) else math.nan
    given.budget.make(4 * x_at.size)
    return _in_table(_sorted(x, x)[0], _sorted(y, y)[0], table, x_at, y_at, method, beyond)


def _axis(points: Float, along: int) -> Float:
    """The breakpoints of an axis, given as a vector or as a grid."""
    if 1 in points.shape:
        return points.ravel(order="F")
    return points[0, :] if along else points[:, 0]


def _in_table(x: Float, y: Float, table: Float, x_at: Float, y_at: Float, method: str, beyond: float) -> Float:
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
def _filter(given: NumericArguments) -> Value:
    from scipy.signal import lfilter

    top, bottom, x = given.numbers(0).ravel(), given.numbers(1).ravel(), given.numbers(2)
    if not bottom.size or bottom[0] == 0:
        raise MatlabValueError("the first coefficient below must not be 0")
    given.budget.make(x.size * (top.size + bottom.size))
    return np.asarray(lfilter(top, bottom, x.ravel(order="F"))).reshape(x.shape, order="F")
