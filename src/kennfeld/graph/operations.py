"""Elementwise operations: evaluation, and partial derivatives as graph expressions.

Truth is 1.0 and 0.0; every value but zero is true. Ties of `min` and `max` take the first argument, the slope of `abs`
at 0 is 0, and step functions (`floor`, comparisons, ...) have slope 0.
"""

import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass


class Writer(Protocol):
    """The part of a graph builder that derivative rules need."""

    def call(self, op: str, *args: int) -> int:
        """Return the node of an elementwise operation."""

    def const(self, value: float) -> int:
        """Return the node of a constant."""


Partial = Callable[[Writer, tuple[int, ...], int], int]
Edge = Callable[[Writer, tuple[int, ...]], int]
Branches = Callable[[Writer, tuple[int, ...]], tuple[int | None, ...]]


@dataclass(frozen=True)
class Operation:
    """An elementwise operation.

    `evaluate` works on floats and arrays. `partials[i](writer, args, y)` writes dy/d(args[i]); None stands for zero.
    `branches` is set for operations that return one of their arguments: `branches(writer, args)` writes for each
    argument the condition under which it is the result. `edge(writer, args)` writes the condition under which the first
    argument is at an end of its range with a slope that is infinite on one side and missing on the other.
    """

    arity: int
    evaluate: Callable[..., Any]
    partials: tuple[Partial | None, ...]
    branches: Branches | None = None
    edge: Edge | None = None


def _quiet(function: Callable[..., Any]) -> Callable[..., Any]:
    def evaluate(*args: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*(np.asarray(a, dtype=np.float64) for a in args))

    return evaluate


def _round(x: Any) -> Any:
    """Round to the nearest integer; halves away from zero."""
    whole = np.trunc(x)
    return np.where(np.abs(x - whole) >= 0.5, whole + np.copysign(1.0, x), whole)


def _erf(x: Any) -> Any:
    return np.reshape([math.erf(number) for number in np.ravel(x)], np.shape(x))


def _erfc(x: Any) -> Any:
    return np.reshape([math.erfc(number) for number in np.ravel(x)], np.shape(x))


def _mod(a: Any, b: Any) -> Any:
    """Compute the remainder with the sign of the divisor; the dividend if the divisor is zero."""
    return np.where(b == 0, a, a - np.floor(a / b) * b)


def _truth(function: Callable[..., Any]) -> Callable[..., Any]:
    return _quiet(lambda *args: function(*args).astype(np.float64))


def _steps(arity: int, evaluate: Callable[..., Any]) -> Operation:
    return Operation(arity, evaluate, (None,) * arity)


def _unary(
    evaluate: Callable[..., Any], slope: Callable[[Writer, int, int], int], edge: Edge | None = None
) -> Operation:
    return Operation(1, _quiet(evaluate), (lambda w, args, y: slope(w, args[0], y),), edge=edge)


def _binary(
    evaluate: Callable[..., Any],
    first: Callable[..., int],
    second: Callable[..., int],
    branches: Branches | None = None,
    edge: Edge | None = None,
) -> Operation:
    """Return an operation of two arguments, whose slopes are written by `slope(writer, a, b, y)`."""
    partials = (lambda w, args, y: first(w, *args, y), lambda w, args, y: second(w, *args, y))
    return Operation(2, _quiet(evaluate), partials, branches, edge)


def _one(w: Writer, *_: Any) -> int:
    return w.const(1.0)


def _one_over(w: Writer, x: int) -> int:
    return w.call("div", w.const(1.0), x)


def _one_minus_square(w: Writer, x: int) -> int:
    return w.call("sub", w.const(1.0), w.call("mul", x, x))


def _one_plus_square(w: Writer, x: int) -> int:
    return w.call("add", w.const(1.0), w.call("mul", x, x))


def _over_squares(w: Writer, x: int, a: int, b: int) -> int:
    return w.call("div", x, w.call("add", w.call("mul", a, a), w.call("mul", b, b)))


def _power_base(w: Writer, base: int, exponent: int, _: int) -> int:
    # with the exponent 0 the slope is 0, also at 0 to the power of -1
    return w.call("guard", exponent, w.call("pow", base, w.call("sub", exponent, w.const(1.0))))


def _erf_slope(w: Writer, x: int, y: int) -> int:
    grown = w.call("exp", w.call("neg", w.call("mul", x, x)))
    return w.call("mul", w.const(2 / math.sqrt(math.pi)), grown)


def _at_zero(w: Writer, args: tuple[int, ...]) -> int:
    return w.call("eq", args[0], w.const(0.0))


def _at_one(w: Writer, args: tuple[int, ...]) -> int:
    return w.call("eq", w.call("abs", args[0]), w.const(1.0))


def _either(comparison: str) -> Branches:
    def conditions(w: Writer, args: tuple[int, ...]) -> tuple[int, int]:
        first = w.call(comparison, *args)
        return first, w.call("not", first)

    return conditions


OPERATIONS: dict[str, Operation] = {
    "add": _binary(np.add, _one, _one),
    "sub": _binary(np.subtract, _one, lambda w, a, b, y: w.const(-1.0)),
    "mul": _binary(np.multiply, lambda w, a, b, y: b, lambda w, a, b, y: a),
    # the product of a slope that may be exactly 0 with one that may not be finite
    "guard": _binary(lambda a, b: np.where(a == 0, 0.0, a * b), lambda w, a, b, y: b, lambda w, a, b, y: a),
    "div": _binary(
        np.divide, lambda w, a, b, y: _one_over(w, b), lambda w, a, b, y: w.call("neg", w.call("div", y, b))
    ),
    "pow": _binary(np.power, _power_base, lambda w, a, b, y: w.call("guard", y, w.call("log", a)), edge=_at_zero),
    "mod": _binary(_mod, _one, lambda w, a, b, y: w.call("neg", w.call("floor", w.call("div", a, b)))),
    "atan2": _binary(
        np.arctan2,
        lambda w, a, b, y: _over_squares(w, b, a, b),
        lambda w, a, b, y: w.call("neg", _over_squares(w, a, a, b)),
    ),
    "min": _binary(np.minimum, _one, _one, _either("le")),
    "max": _binary(np.maximum, _one, _one, _either("ge")),
    "select": Operation(
        3,
        _quiet(lambda c, a, b: np.where(c != 0, a, b)),
        (None, _one, _one),
        lambda w, args: (None, args[0], w.call("not", args[0])),
    ),
    "neg": _unary(np.negative, lambda w, x, y: w.const(-1.0)),
    "abs": _unary(np.abs, lambda w, x, y: w.call("sign", x)),
    "sqrt": _unary(np.sqrt, lambda w, x, y: w.call("div", w.const(0.5), y), _at_zero),
    "exp": _unary(np.exp, lambda w, x, y: y),
    "log": _unary(np.log, lambda w, x, y: _one_over(w, x)),
    "log10": _unary(np.log10, lambda w, x, y: w.call("div", w.const(float(1 / np.log(10))), x)),
    "sin": _unary(np.sin, lambda w, x, y: w.call("cos", x)),
    "cos": _unary(np.cos, lambda w, x, y: w.call("neg", w.call("sin", x))),
    "tan": _unary(np.tan, lambda w, x, y: _one_plus_square(w, y)),
    "asin": _unary(np.arcsin, lambda w, x, y: _one_over(w, w.call("sqrt", _one_minus_square(w, x))), _at_one),
    "acos": _unary(
        np.arccos, lambda w, x, y: w.call("neg", _one_over(w, w.call("sqrt", _one_minus_square(w, x)))), _at_one
    ),
    "atan": _unary(np.arctan, lambda w, x, y: _one_over(w, _one_plus_square(w, x))),
    "sinh": _unary(np.sinh, lambda w, x, y: w.call("cosh", x)),
    "cosh": _unary(np.cosh, lambda w, x, y: w.call("sinh", x)),
    "tanh": _unary(np.tanh, lambda w, x, y: _one_minus_square(w, y)),
    "erf": _unary(_erf, _erf_slope),
    "erfc": _unary(_erfc, lambda w, x, y: w.call("neg", _erf_slope(w, x, y))),
    # rounds to single precision; the slope is that of what it rounds, as its steps are smaller than those of a search
    "single": _unary(lambda x: np.float32(x).astype(np.float64), lambda w, x, y: w.const(1.0)),
    "floor": _steps(1, _quiet(np.floor)),
    "ceil": _steps(1, _quiet(np.ceil)),
    "round": _steps(1, _quiet(_round)),
    "sign": _steps(1, _quiet(np.sign)),
    "lt": _steps(2, _truth(np.less)),
    "le": _steps(2, _truth(np.less_equal)),
    "gt": _steps(2, _truth(np.greater)),
    "ge": _steps(2, _truth(np.greater_equal)),
    "eq": _steps(2, _truth(np.equal)),
    "ne": _steps(2, _truth(np.not_equal)),
    "and": _steps(2, _truth(np.logical_and)),
    "or": _steps(2, _truth(np.logical_or)),
    "not": _steps(1, _truth(np.logical_not)),
}
