"""Functions of single numbers, applied to each element."""

import math
from collections.abc import Callable

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.matlab.functions.numeric_registry import NUMERIC_FUNCTIONS, NumericArguments, NumericFunction, function
from kennfeld.matlab.operators import binary, cast_to_class, result_class, unary
from kennfeld.matlab.values import Array, MatlabValueError, Value, array_value, class_name

__all__ = ["paired"]

_Real = Callable[[Float], Float]


def _fix(values: Float) -> Float:
    return np.trunc(values)


def _rounded(values: Float) -> Float:
    return np.asarray(np.trunc(values + np.copysign(0.5, values)) if values.size else values)


def _exact(turns: Float, name: str) -> Float:
    """Sine or cosine of degrees, exact at their zeros and extremes."""
    degrees = np.remainder(turns + (90.0 if name == "cos" else 0.0), 360.0)
    found = np.sin(np.deg2rad(degrees))
    known = {0.0: 0.0, 30.0: 0.5, 90.0: 1.0, 150.0: 0.5, 180.0: 0.0, 210.0: -0.5, 270.0: -1.0, 330.0: -0.5}
    for at, value in known.items():
        found = np.where(degrees == at, value, found)
    return np.asarray(found)


def _gamma(values: Float) -> Float:
    return np.vectorize(_gamma_of, otypes=[np.float64])(values) if values.size else values


def _gamma_of(value: float) -> float:
    if value == 0 or (value < 0 and value == math.floor(value)):
        return math.inf
    return math.inf if value > 171.7 else math.gamma(value)


def _factorial(values: Float) -> Float:
    if ((values < 0) | (values != np.floor(values))).any():
        raise MatlabValueError("factorial is for whole numbers from 0")
    return np.round(_gamma(values + 1))


_KEEPING: dict[str, _Real] = {
    "abs": np.abs,
    "sign": np.sign,
    "floor": np.floor,
    "ceil": np.ceil,
    "fix": _fix,
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
    "sind": lambda values: _exact(values, "sin"),
    "cosd": lambda values: _exact(values, "cos"),
    "tand": lambda values: _exact(values, "sin") / _exact(values, "cos"),
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
_TESTS: dict[str, Callable[[Float], Bool]] = {"isnan": np.isnan, "isinf": np.isinf, "isfinite": np.isfinite}


def _register_all() -> None:
    for name, operation in _KEEPING.items():
        NUMERIC_FUNCTIONS[name] = NumericFunction(_each(operation), 1, 1)
    for name, operation in _FLOATING.items():
        NUMERIC_FUNCTIONS[name] = NumericFunction(_each(operation, floating=True), 1, 1)
    for name, (operation, forbidden, said) in _LIMITED.items():
        NUMERIC_FUNCTIONS[name] = NumericFunction(_each(operation, True, forbidden, said), 1, 1)
    for name, test in _TESTS.items():
        NUMERIC_FUNCTIONS[name] = NumericFunction(_tested(test), 1, 1)
    for name, operator in _OPERATORS.items():
        NUMERIC_FUNCTIONS[name] = NumericFunction(_operated(operator), 2, 2)


def _each(
    operation: _Real, floating: bool = False, forbidden: Callable[[Float], Bool] | None = None, said: str = ""
) -> Callable[[NumericArguments], Value]:
    def run(given: NumericArguments) -> Value:
        values = given.numbers(0)
        if forbidden is not None and forbidden(values).any():
            raise MatlabValueError(f"{said} is complex")
        name = class_name(given.array(0))
        with np.errstate(all="ignore"):
            found = np.asarray(operation(values), dtype=np.float64)
        return cast_to_class(
            found, "single" if name == "single" else "double" if floating else result_class(given.array(0))
        )

    return run


def _tested(test: Callable[[Float], Bool]) -> Callable[[NumericArguments], Value]:
    return lambda given: test(given.numbers(0))


_OPERATORS = {
    "plus": "+",
    "minus": "-",
    "times": ".*",
    "mtimes": "*",
    "rdivide": "./",
    "mrdivide": "/",
    "ldivide": ".\\",
    "mldivide": "\\",
    "power": ".^",
    "mpower": "^",
    "eq": "==",
    "ne": "~=",
    "lt": "<",
    "le": "<=",
    "gt": ">",
    "ge": ">=",
    "and": "&",
    "or": "|",
}


def _operated(operator: str) -> Callable[[NumericArguments], Value]:
    return lambda given: binary(operator, given[0], given[1], given.budget)


@function("not", 1)
def _not(given: NumericArguments) -> Value:
    return unary("~", given[0])


@function("uminus", 1)
def _uminus(given: NumericArguments) -> Value:
    return unary("-", given[0])


@function("xor", 2)
def _xor(given: NumericArguments) -> Value:
    return paired(given, lambda one, other: (one != 0) != (other != 0))


@function("round", 1, 2)
def _round(given: NumericArguments) -> Value:
    values, digits = given.numbers(0), given.whole(1, 0)
    factor = 10.0 ** min(max(digits, -300), 300)
    found = _rounded(values * factor) / factor if digits else _rounded(values)
    return cast_to_class(np.where(np.isfinite(values), found, values), result_class(given.array(0)))


def paired(given: NumericArguments, operation: Callable[[Float, Float], Array], name: str = "") -> Array:
    """An operation on two arguments with implicit expansion, in the class that they make together."""
    shape = binary("+", np.zeros(given.array(0).shape), np.zeros(given.array(1).shape), given.budget).shape
    most = len(shape)
    one, other = (values.reshape(values.shape + (1,) * (most - values.ndim)) for values in map(given.numbers, (0, 1)))
    with np.errstate(all="ignore"):
        found = operation(one, other)
    return (
        found if found.dtype == np.bool_ else cast_to_class(found, name or result_class(given.array(0), given.array(1)))
    )


@function("mod", 2)
def _mod(given: NumericArguments) -> Value:
    return paired(given, _modulus)


def _modulus(one: Float, other: Float) -> Float:
    made = np.where(other == 0, one, one - np.floor(one / other) * other)
    made = np.where(_is_multiple(one, other), 0.0, made)
    beyond = np.where(np.sign(one) * np.sign(other) < 0, other, one)
    return np.where(np.isinf(other) & np.isfinite(one), beyond, made)


@function("rem", 2)
def _rem(given: NumericArguments) -> Value:
    return paired(given, _remainder)


def _remainder(one: Float, other: Float) -> Float:
    return np.where(_is_multiple(one, other), 0.0, np.where(other == 0, np.nan, np.fmod(one, other)))


def _is_multiple(one: Float, other: Float) -> Bool:
    """Whether numbers are multiples of others that are not whole, but for rounding; MATLAB leaves no remainder then."""
    ratio = np.abs(one / other)
    is_near = np.abs(ratio - np.floor(ratio + 0.5)) <= np.finfo(np.float64).eps * ratio
    return np.asarray(is_near & (other != np.floor(other)))


@function("atan2", 2)
def _atan2(given: NumericArguments) -> Value:
    return paired(given, np.arctan2)


@function("atan2d", 2)
def _atan2d(given: NumericArguments) -> Value:
    return paired(given, lambda one, other: np.rad2deg(np.arctan2(one, other)))


@function("hypot", 2)
def _hypot(given: NumericArguments) -> Value:
    return paired(given, np.hypot)


@function("gcd", 2)
def _gcd(given: NumericArguments) -> Value:
    return paired(given, lambda one, other: np.gcd(_integers(one), _integers(other)).astype(np.float64))


@function("lcm", 2)
def _lcm(given: NumericArguments) -> Value:
    return paired(given, lambda one, other: np.lcm(_integers(one), _integers(other)).astype(np.float64))


_WAYS: dict[str, _Real] = {"fix": np.trunc, "floor": np.floor, "ceil": np.ceil, "round": _rounded}


@function("idivide", 2, 3)
def _idivide(given: NumericArguments) -> Value:
    way = given.text(2).casefold() if len(given) > 2 else "fix"
    if way not in _WAYS:
        raise MatlabValueError(f"{way} is no way of rounding")
    return paired(given, lambda one, other: _WAYS[way](one / other))


def _integers(values: Float) -> Array:
    if not (np.isfinite(values) & (values == np.floor(values)) & (np.abs(values) < 2.0**53)).all():
        raise MatlabValueError("whole numbers are needed")
    return values.astype(np.int64)


@function("primes", 1)
def _primes(given: NumericArguments) -> Value:
    most = given.number(0)
    given.budget.make(max(most, 0))
    sieve = np.ones(max(int(most) + 1, 2), dtype=bool)
    sieve[:2] = False
    for at in range(2, int(len(sieve) ** 0.5) + 1):
        if sieve[at]:
            sieve[at * at :: at] = False
    return np.flatnonzero(sieve).astype(np.float64).reshape(1, -1)


@function("nchoosek", 2)
def _nchoosek(given: NumericArguments) -> Value:
    total, chosen = given.whole(0), given.whole(1)
    if not 0 <= chosen <= total <= 1000:
        raise MatlabValueError("nchoosek is for whole numbers up to 1000, the second no more than the first")
    return array_value(np.array([[float(math.comb(total, chosen))]]))


_register_all()
