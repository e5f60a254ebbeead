"""Operators and functions of expressions on node arrays, by name."""

import math
from collections.abc import Callable, Mapping
from typing import Final, TypeAlias

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.exact_arithmetic import (
    acosh,
    asinh,
    atanh,
    is_finite,
    remainder,
    with_infinite,
    within_infinity,
)
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, rounded, truncate

Rule: TypeAlias = Callable[..., Nodes]  # of the builder and the arguments

BINARY: Final = {
    "+": "add", "-": "sub", ".*": "mul", "./": "div", ".^": "pow", "==": "eq", "~=": "ne", "!=": "ne", "<": "lt",
    "<=": "le", ">": "gt", ">=": "ge", "&": "and", "|": "or",
}  # fmt: skip
PLAIN: Final = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "log10", "sqrt", "abs", "floor",
    "ceil", "round", "sign",
)  # fmt: skip


def without_rest(builder: GraphBuilder, rest: Nodes, a: Nodes, b: Nodes) -> Nodes:
    """Return a remainder of a / b; 0 if b is not an integer but a is a multiple of b up to rounding.

    MATLAB and generated code agree in this: `mod(0.3, 0.1)` is 0, although the doubles give a quotient below 3.
    """
    rest = rounded(builder, rest)
    values = [builder.value(int(node)) for node in b.ravel()]
    if all(value is not None and (not math.isfinite(value) or value == math.floor(value)) for value in values):
        return rest
    apply = Elementwise(builder)
    ratio = apply("abs", apply("div", a, b))
    distance = apply("abs", apply("sub", ratio, apply("floor", apply("add", ratio, 0.5))))
    is_near = apply("le", distance, apply("mul", builder.resolution, ratio))
    is_broken = apply("ne", b, apply("floor", b))
    return apply("select", apply("and", is_near, is_broken), 0.0, rest)


def _remainder(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute a - b trunc(a / b); NaN if b is 0."""
    return with_infinite(builder, without_rest(builder, plain_remainder(builder, a, b), a, b), a, b)


def plain_remainder(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute a - b trunc(a / b) in double precision, in which that of numbers of single precision is exact."""
    apply = Elementwise(builder)
    with builder.in_double():
        return apply("sub", a, apply("mul", truncate(builder, apply("div", a, b)), b))


def _modulus(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute a - b floor(a / b); a if b is 0, or if b is infinite with the sign of a."""
    apply = Elementwise(builder)
    result = without_rest(builder, apply("mod", a, b), a, b)
    if is_finite(builder, b):
        return result
    other_side = apply("lt", apply("mul", apply("sign", a), apply("sign", b)), 0.0)
    return apply("select", within_infinity(apply, a, b), apply("select", other_side, b, a), result)


def _hypotenuse(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    apply = Elementwise(builder)
    return apply("sqrt", apply("add", apply("mul", a, a), apply("mul", b, b)))


def expm1(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute exp(x) - 1 by the hyperbolic tangent, exact near 0: 2 t / (1 - t), t = tanh(x/2)."""
    apply = Elementwise(builder)
    t = apply("tanh", apply("mul", x, 0.5))
    near = apply("div", apply("mul", 2.0, t), apply("sub", 1.0, t))
    far = apply("sub", apply("exp", x), 1.0)
    return apply("select", apply("lt", apply("abs", x), 1.0), near, far)


def operation(op: str) -> Rule:
    """Return the rule that applies an operation of the graph."""
    return lambda builder, *args: Elementwise(builder)(op, *args)


ONE: Final[Mapping[str, Rule]] = {
    **{name: operation(name) for name in PLAIN},
    "fix": truncate,
    "uminus": operation("neg"),
}
TWO: Final[Mapping[str, Rule]] = {
    "atan2": operation("atan2"),
    "mod": _modulus,
    "power": operation("pow"),
    "plus": operation("add"),
    "minus": operation("sub"),
    "times": operation("mul"),
    "rdivide": operation("div"),
    "hypot": _hypotenuse,
    "rem": _remainder,
}
INVERSE_HYPERBOLIC: Final[Mapping[str, Rule]] = {"asinh": asinh, "acosh": acosh, "atanh": atanh}
ONE_IN_C: Final[Mapping[str, Rule]] = {
    "ln": operation("log"),
    "sgn": operation("sign"),
    "fabs": operation("abs"),
    "square": lambda builder, x: Elementwise(builder)("mul", x, x),
    "reciprocal": lambda builder, x: Elementwise(builder)("div", 1.0, x),
}
TWO_IN_C: Final[Mapping[str, Rule]] = {"pow": operation("pow"), "fmod": remainder}
