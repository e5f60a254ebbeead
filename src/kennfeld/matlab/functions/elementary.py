"""Elementary functions of numbers, applied to each element."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.matlab.functions.numeric_registry import NumericArguments, Run, function
from kennfeld.matlab.operators import (
    apply_binary,
    apply_unary,
    cast_to_class,
    pad_dimensions,
    result_class,
    round_half_away,
)
from kennfeld.matlab.values import Array, Elements, MatlabValueError, Value, array_value, class_name

_Real = Callable[[Float], Float]


def _exact_degrees(turns: Float, name: str) -> Float:
    """Return sine or cosine of degrees, exact at zeros and extremes."""
    degrees = np.remainder(turns + (90.0 if name == "cos" else 0.0), 360.0)
    values = np.sin(np.deg2rad(degrees))
    exact = {0.0: 0.0, 30.0: 0.5, 90.0: 1.0, 150.0: 0.5, 180.0: 0.0, 210.0: -0.5, 270.0: -1.0, 330.0: -0.5}
    for at, value in exact.items():
        values = np.where(degrees == at, value, values)
    return np.asarray(values)


def _gamma(values: Float) -> Float:
    return np.vectorize(_gamma_of, otypes=[np.float64])(values) if values.size else values


def _gamma_of(value: float) -> float:
    if value == 0 or (value < 0 and value == math.floor(value)):
        return math.inf
    return math.inf if value > 171.7 else math.gamma(value)


def _factorial(values: Float) -> Float:
    if ((values < 0) | (values != np.floor(values))).any():
        raise MatlabValueError("factorial requires integers >= 0")
    return np.round(_gamma(values + 1))


_KEEPING: dict[str, _Real] = {
    "abs": np.abs,
    "sign": np.sign,
    "floor": np.floor,
    "ceil": np.ceil,
    "fix": np.trunc,
    "real": lambda values: values,
    "conj": lambda values: values,
    "imag": np.zeros_like,
}
_FLOATING: dict[str, _Real] = {
    "exp": np.exp,
    "expm1": np.expm1,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "asinh": np.arcsinh,
    "deg2rad": np.deg2rad,
    "rad2deg": np.rad2deg,
    "sind": lambda values: _exact_degrees(values, "sin"),
    "cosd": lambda values: _exact_degrees(values, "cos"),
    "tand": lambda values: _exact_degrees(values, "sin") / _exact_degrees(values, "cos"),
    "atand": lambda values: np.rad2deg(np.arctan(values)),
    "gamma": _gamma,
    "factorial": _factorial,
    "cbrt": np.cbrt,
    "nextpow2": lambda values: np.where(values == 0, 0.0, np.ceil(np.log2(np.abs(values)))),
}
_LIMITED: dict[str, tuple[_Real, Callable[[Float], Bool], str]] = {
    "sqrt": (np.sqrt, lambda values: values < 0, "the root of a negative number"),
    "log": (np.log, lambda values: values < 0, "the logarithm of a negative number"),
    "log2": (np.log2, lambda values: values < 0, "the logarithm of a negative number"),
    "log10": (np.log10, lambda values: values < 0, "the logarithm of a negative number"),
    "log1p": (np.log1p, lambda values: values < -1, "the logarithm of a negative number"),
    "asin": (np.arcsin, lambda values: np.abs(values) > 1, "asin beyond 1"),
    "acos": (np.arccos, lambda values: np.abs(values) > 1, "acos beyond 1"),
    "asind": (lambda v: np.rad2deg(np.arcsin(v)), lambda values: np.abs(values) > 1, "asind beyond 1"),
    "acosd": (lambda v: np.rad2deg(np.arccos(v)), lambda values: np.abs(values) > 1, "acosd beyond 1"),
    "acosh": (np.arccosh, lambda values: values < 1, "acosh below 1"),
    "atanh": (np.arctanh, lambda values: np.abs(values) > 1, "atanh beyond 1"),
}


def _elementwise(
    operation: _Real, floating: bool = False, forbidden: Callable[[Float], Bool] | None = None, value: str = ""
) -> Run:
    def run(call: NumericArguments) -> Value:
        values = call.numbers(0)
        if forbidden is not None and not isinstance(values, Elements) and forbidden(values).any():
            raise MatlabValueError(f"{value} is complex")
        name = class_name(call.array(0))
        with np.errstate(all="ignore"):
            results = np.asanyarray(operation(values)).astype(np.float64, copy=False)
        return cast_to_class(
            results, "single" if name == "single" else "double" if floating else result_class(call.array(0))
        )

    return run


_OPERATORS = {
    "plus": "+", "minus": "-", "times": ".*", "mtimes": "*", "rdivide": "./", "mrdivide": "/", "ldivide": ".\\",
    "mldivide": "\\", "power": ".^", "mpower": "^", "eq": "==", "ne": "~=", "lt": "<", "le": "<=", "gt": ">",
    "ge": ">=", "and": "&", "or": "|",
}  # fmt: skip


@function("round", 1, 2)
def _round(call: NumericArguments) -> Value:
    values, digits = call.numbers(0), call.integer(1, 0)
    factor = 10.0 ** min(max(digits, -300), 300)
    rounded = round_half_away(values * factor) / factor if digits else round_half_away(values)
    return cast_to_class(np.where(np.isfinite(values), rounded, values), result_class(call.array(0)))


def apply_pairwise(call: NumericArguments, operation: Callable[[Float, Float], Array], name: str = "") -> Array:
    """Apply an operation to two arguments with implicit expansion, in their common class."""
    shape = apply_binary("+", np.zeros(call.array(0).shape), np.zeros(call.array(1).shape), call.budget).shape
    left, right = pad_dimensions(call.numbers(0), call.numbers(1), least=len(shape))
    with np.errstate(all="ignore"):
        result = operation(left, right)
    if result.dtype == np.bool_:
        return result
    return cast_to_class(result, name or result_class(call.array(0), call.array(1)))


def _modulus(left: Float, right: Float) -> Float:
    remainder = np.where(right == 0, left, left - np.floor(left / right) * right)
    remainder = np.where(_is_multiple(left, right), 0.0, remainder)
    beyond = np.where(np.sign(left) * np.sign(right) < 0, right, left)
    return np.where(np.isinf(right) & np.isfinite(left), beyond, remainder)


def _remainder(left: Float, right: Float) -> Float:
    return np.where(_is_multiple(left, right), 0.0, np.where(right == 0, np.nan, np.fmod(left, right)))


def _is_multiple(left: Float, right: Float) -> Bool:
    """Return where numbers are multiples of fractional ones up to rounding; MATLAB leaves no remainder there."""
    ratio = np.abs(left / right)
    is_near = np.abs(ratio - np.floor(ratio + 0.5)) <= np.finfo(np.float64).eps * ratio
    return np.asarray(is_near & (right != np.floor(right)))


_WAYS: dict[str, _Real] = {"fix": np.trunc, "floor": np.floor, "ceil": np.ceil, "round": round_half_away}


@function("idivide", 2, 3)
def _idivide(call: NumericArguments) -> Value:
    method = call.text(2).casefold() if len(call) > 2 else "fix"
    if method not in _WAYS:
        raise MatlabValueError(f"unknown rounding method {method}")
    return apply_pairwise(call, lambda left, right: _WAYS[method](left / right))


def _integers(values: Float) -> Array:
    if not (np.isfinite(values) & (values == np.floor(values)) & (np.abs(values) < 2.0**53)).all():
        raise MatlabValueError("arguments must be integers")
    return values.astype(np.int64)


@function("primes", 1)
def _primes(call: NumericArguments) -> Value:
    limit = call.number(0)
    call.budget.allocate(max(limit, 0))
    sieve = np.ones(max(int(limit) + 1, 2), dtype=bool)
    sieve[:2] = False
    for at in range(2, int(len(sieve) ** 0.5) + 1):
        if sieve[at]:
            sieve[at * at :: at] = False
    return np.flatnonzero(sieve).astype(np.float64).reshape(1, -1)


@function("nchoosek", 2)
def _nchoosek(call: NumericArguments) -> Value:
    total, chosen = call.integer(0), call.integer(1)
    if not 0 <= chosen <= total <= 1000:
        raise MatlabValueError("nchoosek requires integers with 0 <= k <= n <= 1000")
    return array_value(np.array([[float(math.comb(total, chosen))]]))


_PAIRWISE: dict[str, Callable[[Float, Float], Array]] = {
    "xor": lambda left, right: (left != 0) != (right != 0),
    "mod": _modulus,
    "rem": _remainder,
    "atan2": np.arctan2,
    "atan2d": lambda left, right: np.rad2deg(np.arctan2(left, right)),
    "hypot": np.hypot,
    "gcd": lambda left, right: np.gcd(_integers(left), _integers(right)).astype(np.float64),
    "lcm": lambda left, right: np.lcm(_integers(left), _integers(right)).astype(np.float64),
}


def _of_operator(operator: str) -> Run:
    return lambda call: apply_binary(operator, call[0], call[1], call.budget)


for _name, _operation in _KEEPING.items():
    function(_name, 1)(_elementwise(_operation))
for _name, _operation in _FLOATING.items():
    function(_name, 1)(_elementwise(_operation, floating=True))
for _name, (_operation, _forbidden, _reason) in _LIMITED.items():
    function(_name, 1)(_elementwise(_operation, True, _forbidden, _reason))
for _name, _pair in _PAIRWISE.items():
    function(_name, 2)(partial(apply_pairwise, operation=_pair))
for _name, _operator in _OPERATORS.items():
    function(_name, 2)(_of_operator(_operator))
function("isnan", 1)(lambda call: np.isnan(call.numbers(0)))
function("isinf", 1)(lambda call: np.isinf(call.numbers(0)))
function("isfinite", 1)(lambda call: np.isfinite(call.numbers(0)))
function("not", 1)(lambda call: apply_unary("~", call[0]))
function("uminus", 1)(lambda call: apply_unary("-", call[0]))
