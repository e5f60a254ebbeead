"""Operators and functions of MATLAB expressions on node arrays, by name, and ranges of fixed length."""

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab import syntax as m
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, reduce_nodes, truncate
from kennfeld.models.imperative.symbolic_values import constants

if TYPE_CHECKING:
    from kennfeld.models.imperative.expression_evaluator import ExpressionEvaluator


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


def apply_function(builder: GraphBuilder, name: str, args: list[Nodes]) -> Nodes | None:
    """Apply a function to node arrays; None for an unknown function."""
    if len(args) == 1 and (name in PLAIN or name == "not"):
        return elementwise(builder, name, *args)
    rule = _RULES.get(len(args), {}).get(name)
    if rule is not None:
        return rule(builder, *args)
    if name in ("min", "max", "sum", "prod") and len(args) == 1 and args[0].ndim == 2 and 1 in args[0].shape:
        op = {"sum": "add", "prod": "mul"}.get(name, name)
        return np.array([[reduce_nodes(builder, op, [int(n) for n in args[0].ravel(order="F")])]], dtype=np.int64)
    return args[0] if name in _CASTS and len(args) == 1 else None  # physical values are kept


def without_rest(builder: GraphBuilder, rest: Nodes, a: Nodes, b: Nodes) -> Nodes:
    """Return a remainder of a / b; 0 if b is not an integer but a is a multiple of b up to rounding.

    MATLAB and generated code agree in this: `mod(0.3, 0.1)` is 0, although the doubles give a quotient below 3.
    """
    if all(_is_whole(builder.value(int(node))) for node in b.ravel()):
        return rest
    ratio = elementwise(builder, "abs", elementwise(builder, "div", a, b))
    nearest = elementwise(builder, "floor", elementwise(builder, "add", ratio, _constant(builder, 0.5)))
    off = elementwise(builder, "abs", elementwise(builder, "sub", ratio, nearest))
    is_near = elementwise(builder, "le", off, elementwise(builder, "mul", _constant(builder, math.ulp(1.0)), ratio))
    is_broken = elementwise(builder, "ne", b, elementwise(builder, "floor", b))
    return elementwise(
        builder, "select", elementwise(builder, "and", is_near, is_broken), _constant(builder, 0.0), rest
    )


def _is_whole(value: float | None) -> bool:
    return value is not None and (not math.isfinite(value) or value == math.floor(value))


def _remainder(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute a - b trunc(a / b); NaN if b is 0."""
    return _with_infinite(builder, without_rest(builder, _plain_remainder(builder, a, b), a, b), a, b)


def _remainder_in_c(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute the remainder as C's `fmod`, without tolerance for rounding."""
    return _with_infinite(builder, _plain_remainder(builder, a, b), a, b)


def _plain_remainder(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    whole = truncate(builder, elementwise(builder, "div", a, b))
    return elementwise(builder, "sub", a, elementwise(builder, "mul", whole, b))


def _with_infinite(builder: GraphBuilder, made: Nodes, a: Nodes, b: Nodes) -> Nodes:
    """Return a remainder, replaced by a if b is infinite."""
    return made if _is_finite(builder, b) else elementwise(builder, "select", _within_infinity(builder, a, b), a, made)


def _modulus(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute a - b floor(a / b); a if b is 0, or if b is infinite with the sign of a."""
    result = without_rest(builder, elementwise(builder, "mod", a, b), a, b)
    if _is_finite(builder, b):
        return result
    zero = _constant(builder, 0.0)
    other_side = elementwise(
        builder,
        "lt",
        elementwise(builder, "mul", elementwise(builder, "sign", a), elementwise(builder, "sign", b)),
        zero,
    )
    beyond = elementwise(builder, "select", other_side, b, a)
    return elementwise(builder, "select", _within_infinity(builder, a, b), beyond, result)


def _is_finite(builder: GraphBuilder, array: Nodes) -> bool:
    """Return True if all elements are known to be finite."""
    values = [builder.value(int(node)) for node in array.ravel()]
    return all(value is not None and math.isfinite(value) for value in values)


def _within_infinity(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Return the condition that a is finite and b is not."""
    infinity = _constant(builder, math.inf)
    is_beyond = elementwise(builder, "eq", elementwise(builder, "abs", b), infinity)
    return elementwise(builder, "and", is_beyond, elementwise(builder, "lt", elementwise(builder, "abs", a), infinity))


def _hypotenuse(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    return elementwise(
        builder,
        "sqrt",
        elementwise(builder, "add", elementwise(builder, "mul", a, a), elementwise(builder, "mul", b, b)),
    )


def _constant(builder: GraphBuilder, value: float) -> Nodes:
    """Return a constant that broadcasts to arrays of any number of dimensions."""
    return np.array(builder.const(value), dtype=np.int64)


def _asinh(builder: GraphBuilder, x: Nodes) -> Nodes:
    """Compute asinh as an odd function, so that large negative numbers do not cancel; its slope at 0 is 1."""
    negative = elementwise(builder, "lt", x, _constant(builder, 0.0))
    size = elementwise(builder, "select", negative, elementwise(builder, "neg", x), x)
    root = elementwise(
        builder, "sqrt", elementwise(builder, "add", elementwise(builder, "mul", x, x), _constant(builder, 1.0))
    )
    result = elementwise(builder, "log", elementwise(builder, "add", size, root))
    return elementwise(builder, "select", negative, elementwise(builder, "neg", result), result)


def _acosh(builder: GraphBuilder, x: Nodes) -> Nodes:
    root = elementwise(
        builder, "sqrt", elementwise(builder, "sub", elementwise(builder, "mul", x, x), _constant(builder, 1.0))
    )
    return elementwise(builder, "log", elementwise(builder, "add", x, root))


def _atanh(builder: GraphBuilder, x: Nodes) -> Nodes:
    ratio = elementwise(
        builder,
        "div",
        elementwise(builder, "add", _constant(builder, 1.0), x),
        elementwise(builder, "sub", _constant(builder, 1.0), x),
    )
    return elementwise(builder, "mul", _constant(builder, 0.5), elementwise(builder, "log", ratio))


def _operation(op: str) -> Rule:
    return lambda builder, *args: elementwise(builder, op, *args)


ONE: Final[Mapping[str, Rule]] = {"fix": truncate, "uminus": _operation("neg")}
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
    "square": lambda builder, x: elementwise(builder, "mul", x, x),
    "reciprocal": lambda builder, x: elementwise(builder, "div", _constant(builder, 1.0), x),
}
_TWO_ELSEWHERE: Final[Mapping[str, Rule]] = {
    "pow": _operation("pow"),
    "fmod": _remainder_in_c,
    "min": _operation("min"),
    "max": _operation("max"),
}
_RULES: Final[Mapping[int, Mapping[str, Rule]]] = {1: {**ONE, **_ONE_ELSEWHERE}, 2: {**TWO, **_TWO_ELSEWHERE}}

KNOWN: Final = frozenset({*PLAIN, "not", *_RULES[1], *_RULES[2], *_CASTS, "sum", "prod"})


def range_between(calls: "ExpressionEvaluator", tree: m.Range) -> Nodes:
    """Evaluate `first:step:last`, with tolerance for rounding at the end.

    The start may depend on signals if the distance to the end does not, as in `k:k+2`.
    """
    first, last = calls.nodes(tree.first), calls.nodes(tree.last)
    step = 1.0 if tree.step is None else calls.number(tree.step, "the step of a range")
    if first.size != 1 or last.size != 1:
        raise ProgramError("the ends of a range must be scalars")
    calls.context.numbers(np.concatenate([first, last]), "the ends of a range")
    span = constant_distance(calls, int(first.item()), int(last.item()))
    if span is None:
        raise ProgramError("the length of a range depends on signals", "Loop over constants, with if inside.")
    begin, count = calls.context.constant(int(first.item())), range_length(calls, span, step)
    if begin is not None:
        return constants(calls.builder, begin + step * np.arange(count).reshape(1, -1))
    return elementwise(calls.builder, "add", first, constants(calls.builder, step * np.arange(count).reshape(1, -1)))


def range_length(calls: "ExpressionEvaluator", span: float, step: float) -> int:
    """Return the number of elements of a range over this distance; raises `ProgramError` if too large."""
    steps = span / step if step else -1.0
    if math.isnan(steps):
        raise ProgramError("the ends of a range are not numbers")
    calls.context.room(steps)
    return math.floor(steps * (1 + 1e-12) + 1e-10) + 1 if steps > -1 else 0


def constant_distance(calls: "ExpressionEvaluator", first: int, last: int) -> float | None:
    """Return b - a if it is constant: of two constants, or of the same signal plus constants; else None."""
    begin, end = calls.context.constant(first), calls.context.constant(last)
    if begin is not None and end is not None:
        return end - begin
    (base, offset), (other, more) = _offset(calls, first), _offset(calls, last)
    return more - offset if base == other else None


def _offset(calls: "ExpressionEvaluator", node: int) -> tuple[int, float]:
    total = 0.0
    for _ in range(100):
        op, args, _ = calls.builder.nodes[node]
        fixed = [calls.context.constant(arg) for arg in args] if op in ("add", "sub") else []
        if fixed and fixed[1] is not None:
            node, total = args[0], total + (fixed[1] if op == "add" else -fixed[1])
        elif fixed and fixed[0] is not None and op == "add":
            node, total = args[1], total + fixed[0]
        else:
            break
    return node, total
