"""The operators and functions of MATLAB expressions that the graph can say, by their names."""

import math
from collections.abc import Callable, Mapping
from typing import Final, TypeAlias

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.arrays import each, fold, towards_zero
from kennfeld.models.simulink.expressions.signals import Nodes

__all__ = ["BINARY", "INVERSE_HYPERBOLIC", "KNOWN", "ONE", "PLAIN", "TWO", "Rule", "applied", "without_rest"]

Rule: TypeAlias = Callable[..., Nodes]

BINARY: Final = {
    "+": "add", "-": "sub", ".*": "mul", "./": "div", ".^": "pow", "==": "eq", "~=": "ne", "!=": "ne", "<": "lt",
    "<=": "le", ">": "gt", ">=": "ge", "&": "and", "|": "or", "&&": "and", "||": "or",
}  # fmt: skip
PLAIN: Final = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "log10", "sqrt", "abs", "floor",
    "ceil", "round", "sign",
)  # fmt: skip
_CASTS: Final = (
    "double", "single", "boolean", "logical", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64",
)  # fmt: skip


def applied(loom: Loom, name: str, args: list[Nodes]) -> Nodes | None:
    """A function of node arrays; None for one that is not known."""
    if len(args) == 1 and (name in PLAIN or name == "not"):
        return each(loom, name, *args)
    rule = _RULES.get(len(args), {}).get(name)
    if rule is not None:
        return rule(loom, *args)
    if name in ("min", "max", "sum", "prod") and len(args) == 1 and args[0].ndim == 2 and 1 in args[0].shape:
        op = {"sum": "add", "prod": "mul"}.get(name, name)
        return np.array([[fold(loom, op, [int(n) for n in args[0].ravel(order="F")])]], dtype=np.int64)
    return args[0] if name in _CASTS and len(args) == 1 else None  # physical values are kept


def without_rest(loom: Loom, rest: Nodes, a: Nodes, b: Nodes) -> Nodes:
    """Return a remainder of a / b, which is 0 where b is no whole number, but a is one times b but for rounding.

    So do MATLAB and the generated code: `mod(0.3, 0.1)` is 0, though 0.1 is contained in 0.3 just twice.
    """
    if all(_is_whole(loom.value(int(node))) for node in b.ravel()):
        return rest
    ratio = each(loom, "abs", each(loom, "div", a, b))
    nearest = each(loom, "floor", each(loom, "add", ratio, _constant(loom, 0.5)))
    off = each(loom, "abs", each(loom, "sub", ratio, nearest))
    is_near = each(loom, "le", off, each(loom, "mul", _constant(loom, math.ulp(1.0)), ratio))
    is_broken = each(loom, "ne", b, each(loom, "floor", b))
    return each(loom, "select", each(loom, "and", is_near, is_broken), _constant(loom, 0.0), rest)


def _is_whole(value: float | None) -> bool:
    return value is not None and (not math.isfinite(value) or value == math.floor(value))


def _remainder(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    """What is left of a after whole steps of b towards 0; not a number where b is 0."""
    return _with_infinite(loom, without_rest(loom, _plain_remainder(loom, a, b), a, b), a, b)


def _remainder_in_c(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    """The same as C's `fmod`, which takes numbers as they are."""
    return _with_infinite(loom, _plain_remainder(loom, a, b), a, b)


def _plain_remainder(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    whole = towards_zero(loom, each(loom, "div", a, b))
    return each(loom, "sub", a, each(loom, "mul", whole, b))


def _with_infinite(loom: Loom, made: Nodes, a: Nodes, b: Nodes) -> Nodes:
    """A remainder that is a where b is infinite."""
    return made if _is_finite(loom, b) else each(loom, "select", _within_infinity(loom, a, b), a, made)


def _modulus(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    """What is left of a after whole steps of b downwards; a where b is 0, or infinite and of the sign of a."""
    made = without_rest(loom, each(loom, "mod", a, b), a, b)
    if _is_finite(loom, b):
        return made
    zero = _constant(loom, 0.0)
    other_side = each(loom, "lt", each(loom, "mul", each(loom, "sign", a), each(loom, "sign", b)), zero)
    beyond = each(loom, "select", other_side, b, a)
    return each(loom, "select", _within_infinity(loom, a, b), beyond, made)


def _is_finite(loom: Loom, array: Nodes) -> bool:
    """Whether all elements are known to be finite."""
    values = [loom.value(int(node)) for node in array.ravel()]
    return all(value is not None and math.isfinite(value) for value in values)


def _within_infinity(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    """Whether a is finite and b is not."""
    infinity = _constant(loom, math.inf)
    is_beyond = each(loom, "eq", each(loom, "abs", b), infinity)
    return each(loom, "and", is_beyond, each(loom, "lt", each(loom, "abs", a), infinity))


def _hypotenuse(loom: Loom, a: Nodes, b: Nodes) -> Nodes:
    return each(loom, "sqrt", each(loom, "add", each(loom, "mul", a, a), each(loom, "mul", b, b)))


def _constant(loom: Loom, value: float) -> Nodes:
    """A constant that expands against arrays of any number of dimensions."""
    return np.array(loom.const(value), dtype=np.int64)


def _asinh(loom: Loom, x: Nodes) -> Nodes:
    """Odd, so that large negative numbers do not cancel out; the slope at 0 is 1."""
    negative = each(loom, "lt", x, _constant(loom, 0.0))
    size = each(loom, "select", negative, each(loom, "neg", x), x)
    root = each(loom, "sqrt", each(loom, "add", each(loom, "mul", x, x), _constant(loom, 1.0)))
    made = each(loom, "log", each(loom, "add", size, root))
    return each(loom, "select", negative, each(loom, "neg", made), made)


def _acosh(loom: Loom, x: Nodes) -> Nodes:
    root = each(loom, "sqrt", each(loom, "sub", each(loom, "mul", x, x), _constant(loom, 1.0)))
    return each(loom, "log", each(loom, "add", x, root))


def _atanh(loom: Loom, x: Nodes) -> Nodes:
    ratio = each(loom, "div", each(loom, "add", _constant(loom, 1.0), x), each(loom, "sub", _constant(loom, 1.0), x))
    return each(loom, "mul", _constant(loom, 0.5), each(loom, "log", ratio))


def _operation(op: str) -> Rule:
    return lambda loom, *args: each(loom, op, *args)


ONE: Final[Mapping[str, Rule]] = {"fix": towards_zero, "uminus": _operation("neg")}
TWO: Final[Mapping[str, Rule]] = {
    "atan2": _operation("atan2"),
    "mod": _modulus,
    "power": _operation("pow"),
    "plus": _operation("add"),
    "minus": _operation("sub"),
    "times": _operation("mul"),
    "rdivide": _operation("div"),
    "hypot": _hypotenuse,
    "rem": _remainder,
}
INVERSE_HYPERBOLIC: Final[Mapping[str, Rule]] = {"asinh": _asinh, "acosh": _acosh, "atanh": _atanh}
_ONE_ELSEWHERE: Final[Mapping[str, Rule]] = {
    "ln": _operation("log"),
    "sgn": _operation("sign"),
    "fabs": _operation("abs"),
    "square": lambda loom, x: each(loom, "mul", x, x),
    "reciprocal": lambda loom, x: each(loom, "div", _constant(loom, 1.0), x),
}
_TWO_ELSEWHERE: Final[Mapping[str, Rule]] = {
    "pow": _operation("pow"),
    "fmod": _remainder_in_c,
    "min": _operation("min"),
    "max": _operation("max"),
}
_RULES: Final[Mapping[int, Mapping[str, Rule]]] = {1: {**ONE, **_ONE_ELSEWHERE}, 2: {**TWO, **_TWO_ELSEWHERE}}

KNOWN: Final = frozenset({*PLAIN, "not", *_RULES[1], *_RULES[2], *_CASTS, "sum", "prod"})
