"""Math Operations library: gain, sum, product, elementary functions, polynomial and Fcn."""

import re

import numpy as np

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.graph_operators import INVERSE_HYPERBOLIC, without_rest
from kennfeld.models.imperative.node_arrays import Nodes, matrix_product, reduce_nodes, truncate
from kennfeld.models.simulink.blocks.matrix_operations import as_matrix, inverse_of
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import Signal, SignalOrBus, as_vector, fastest_sample_time, scalar, size_text

_TURNS = {"degree": 360.0, "revolution": 1.0}

_INDEX = re.compile(r"\bu\s*\[\s*([^\]]*)\]")


@block("Gain", Gain="1", Multiplication="Element-wise(K.*u)", SampleTime="-1")
def gain(block: BlockContext) -> SignalOrBus:
    """Multiply the input by K, element by element or as matrices."""
    kind = block.field_text("Multiplication")
    u = block.input()
    if kind.startswith("Element-wise"):
        return block.apply("mul", block.parameter("Gain"), u)
    k = block.matrix("Gain")
    if u.size == 1 < k.shape[1] and "u*K" not in kind:
        block.suggest_dimensions(0, (k.shape[1],))
    column = u.nodes.reshape(-1, 1) if u.nodes.ndim == 1 else u.nodes
    left, right = (column, k) if "u*K" in kind else (k, column)
    if "u*K" in kind and u.nodes.ndim == 1:
        left = u.nodes.reshape(1, -1) if k.shape[0] == u.size else column
    return _as_input(_product(block, left, right), u)


def _as_input(nodes: Nodes, u: Signal) -> Signal:
    return Signal(nodes.ravel() if u.nodes.ndim == 1 and 1 in nodes.shape else nodes, u.period)


def _product(block: BlockContext, left: Nodes, right: Nodes) -> Nodes:
    if left.size == 1 or right.size == 1:
        spread = np.broadcast_arrays(left, right)
        nodes = [
            block.builder.call("mul", int(a), int(b)) for a, b in zip(spread[0].ravel(), spread[1].ravel(), strict=True)
        ]
        return np.array(nodes, dtype=np.int64).reshape(spread[0].shape)
    if left.shape[1] != right.shape[0]:
        raise UnsupportedError(
            f"matrices of size {size_text(left.shape)} and {size_text(right.shape)} cannot be multiplied"
        )
    return matrix_product(block.builder, left, right)


def _signs(block: BlockContext, plus: str, minus: str) -> str:
    """Return the sign of each input, from the list or the number of inputs in the field."""
    written = block.field_text("Inputs").replace("|", "").replace(" ", "")
    if written and set(written) <= {plus, minus}:
        return written
    return plus * block.integer_field("Inputs", 1, 1000)


@block("Sum", Inputs="++", SampleTime="-1", CollapseMode="All dimensions", CollapseDim="1")
def sum_of(block: BlockContext) -> SignalOrBus:
    """Add and subtract the inputs, or sum the elements of a single input."""
    signs = _signs(block, "+", "-")
    if len(signs) == 1:
        total = _reduce_elements(block, "add")
        return total if signs == "+" else block.apply("neg", total)
    result = block.input(0) if signs[0] == "+" else block.apply("neg", block.input(0))
    for at, sign in enumerate(signs[1:], 1):
        result = block.apply("add" if sign == "+" else "sub", result, block.input(at))
    return result


def _reduce_elements(block: BlockContext, op: str) -> Signal:
    """Reduce the elements of the only input, over all or one dimension."""
    u = block.input()
    if u.nodes.ndim == 2 and block.field_text("CollapseMode") != "All dimensions":
        axis = block.integer_field("CollapseDim", 1, 2) - 1
        lines = u.nodes if axis == 1 else u.nodes.T
        nodes = np.array([reduce_nodes(block.builder, op, [int(n) for n in line]) for line in lines], dtype=np.int64)
        return Signal(nodes.reshape((1, -1) if axis == 0 else (-1, 1)), u.period)
    return scalar(reduce_nodes(block.builder, op, u.flat), u.period)


@block("Product", Inputs="2", Multiplication="Element-wise(.*)", SampleTime="-1", CollapseMode="All dimensions",
       CollapseDim="1")  # fmt: skip
def product(block: BlockContext) -> SignalOrBus:
    """Multiply and divide the inputs, or multiply the elements of a single input."""
    signs = _signs(block, "*", "/")
    if block.field_text("Multiplication").startswith("Matrix"):
        return _matrices(block, signs)
    if len(signs) == 1:
        whole = _reduce_elements(block, "mul")
        return whole if signs == "*" else block.apply("div", block.constant(1.0), whole)
    result = block.input(0) if signs[0] == "*" else block.apply("div", block.constant(1.0), block.input(0))
    for at, sign in enumerate(signs[1:], 1):
        if at == 1 and signs[:2] == "/*":  # b/a rather than (1/a) b
            result = block.apply("div", block.input(1), block.input(0))
        else:
            result = block.apply("mul" if sign == "*" else "div", result, block.input(at))
    return result


def _matrices(block: BlockContext, signs: str) -> Signal:
    """Multiply the inputs as matrices, inverting those with a slash; vectors are columns."""
    nodes: Nodes | None = None
    for at, sign in enumerate(signs):
        other = as_matrix(block.input(at))
        other = inverse_of(block, other) if sign == "/" else other
        nodes = other if nodes is None else _product(block, nodes, other)
    assert nodes is not None
    period = fastest_sample_time([signal.period for signal in block.inputs])
    flat = all(signal.nodes.ndim == 1 for signal in block.inputs) or nodes.size == 1
    return Signal(as_vector(nodes) if flat else nodes, period)


@block("DotProduct")
def dot_product(block: BlockContext) -> SignalOrBus:
    """Return the dot product of two vectors."""
    result = block.apply("mul", block.input(0), block.input(1))
    return scalar(reduce_nodes(block.builder, "add", result.flat), result.period)


@block("Bias", Bias="0")
def bias(block: BlockContext) -> SignalOrBus:
    """Return the input plus a constant."""
    return block.apply("add", block.input(), block.parameter("Bias"))


@block("Slider Gain", "SliderGain", linked=True, low="0", gain="1", high="2")
def slider_gain(block: BlockContext) -> SignalOrBus:
    """Multiply the input by the gain of a slider."""
    return block.apply("mul", block.parameter("gain"), block.input())


@block("UnaryMinus", "Unary Minus")
def unary_minus(block: BlockContext) -> SignalOrBus:
    """Return the negative of the input."""
    return block.apply("neg", block.input())


@block("Abs", SampleTime="-1")
def absolute(block: BlockContext) -> SignalOrBus:
    """Return the absolute value of the input."""
    return block.apply("abs", block.input())


@block("Signum", SampleTime="-1")
def signum(block: BlockContext) -> SignalOrBus:
    """Return the sign of the input: 1, 0 or -1."""
    return block.apply("sign", block.input())


@block("MinMax", Function="min", Inputs="1", SampleTime="-1")
def minmax(block: BlockContext) -> SignalOrBus:
    """Return the minimum or maximum of the inputs, or of the elements of a single input."""
    op = block.option("Function", "min", "max")
    if block.input_count == 1:
        u = block.input()
        return scalar(reduce_nodes(block.builder, op, u.flat), u.period)
    return block.reduce(op, block.inputs)


@block("Math", Operator="exp", SampleTime="-1")
def math(block: BlockContext) -> SignalOrBus:
    """Apply an elementary function to one or two inputs."""
    operator = block.field_text("Operator")
    u = block.input()
    one = block.constant(1.0)
    match operator:
        case "exp" | "log" | "log10" | "sqrt":
            return block.apply(operator, u)
        case "10^u":
            return block.apply("pow", block.constant(10.0), u)
        case "square" | "magnitude^2":
            return block.apply("mul", u, u)
        case "conj":
            return u
        case "reciprocal":
            return block.apply("div", one, u)
        case "pow":
            return block.apply("pow", u, block.input(1))
        case "hypot":
            v = block.input(1)
            return block.apply("sqrt", block.apply("add", block.apply("mul", u, u), block.apply("mul", v, v)))
        case "mod":
            v = block.input(1)
            return _round_remainder(block, block.apply("mod", u, v), u, v)
        case "rem":
            return _remainder(block, u, block.input(1))
        case "transpose" | "hermitian":
            return Signal(u.nodes.T if u.nodes.ndim == 2 else u.nodes.reshape(1, -1), u.period)
        case "rSqrt" | "1/sqrt":
            return block.apply("div", one, block.apply("sqrt", u))
    raise UnsupportedError(f"Operator {operator!r} is not supported")


def _remainder(block: BlockContext, u: Signal, v: Signal) -> Signal:
    """Return u - v fix(u / v); u if v is 0."""
    ratio = block.apply("div", u, v)
    whole = Signal(truncate(block.builder, ratio.nodes), ratio.period)
    rest = _round_remainder(block, block.apply("sub", u, block.apply("mul", whole, v)), u, v)
    return block.select(block.apply("eq", v, block.constant(0.0)), u, rest)


def _round_remainder(block: BlockContext, rest: Signal, u: Signal, v: Signal) -> Signal:
    """Set a remainder to 0 if u is a multiple of v up to rounding."""
    spread = block.broadcast(rest, u, v)
    return Signal(without_rest(block.builder, *(signal.nodes for signal in spread)), rest.period)


@block("Sqrt", Operator="sqrt", SampleTime="-1")
def sqrt(block: BlockContext) -> SignalOrBus:
    """Return the square root, the signed square root or the reciprocal square root."""
    u = block.input()
    match block.option("Operator", "sqrt", "signedSqrt", "rSqrt"):
        case "sqrt":
            return block.apply("sqrt", u)
        case "signedSqrt":
            zero = block.constant(0.0)
            root = block.apply("sqrt", block.apply("abs", u))
            return block.select(block.apply("lt", u, zero), block.apply("neg", root), root)
    return block.apply("div", block.constant(1.0), block.apply("sqrt", u))


@block("Rounding", Operator="floor")
def rounding(block: BlockContext) -> SignalOrBus:
    """Round the input to an integer."""
    operator = block.option("Operator", "floor", "ceil", "round", "fix")
    u = block.input()
    return Signal(truncate(block.builder, u.nodes), u.period) if operator == "fix" else block.apply(operator, u)


@block("Trigonometry", Operator="sin", AngleUnit="radian", SampleTime="-1")
def trigonometry(block: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """Apply a trigonometric or hyperbolic function."""
    operator, u = block.field_text("Operator"), block.input()
    unit = block.option("AngleUnit", "radian", "degree", "revolution")
    if unit != "radian":
        return _in_unit(block, operator, _TURNS[unit], u)
    return _trigonometric(block, operator, u)


def _in_unit(block: BlockContext, operator: str, turn: float, u: Signal) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """Apply a trigonometric function to an angle in turns or degrees, or return one."""
    if operator in ("sin", "cos", "tan", "sincos", "cos + jsin"):
        scale = block.constant(2 * np.pi / turn)
        return _trigonometric(block, operator, block.apply("mul", u, scale))
    result = _trigonometric(block, operator, u)
    if operator not in ("asin", "acos", "atan", "atan2") or not isinstance(result, Signal):
        return result
    return block.apply("mul", result, block.constant(turn / (2 * np.pi)))


def _trigonometric(block: BlockContext, operator: str, u: Signal) -> SignalOrBus | tuple[SignalOrBus, ...]:
    match operator:
        case "sin" | "cos" | "tan" | "asin" | "acos" | "atan" | "sinh" | "cosh" | "tanh":
            return block.apply(operator, u)
        case "atan2":
            return block.apply("atan2", u, block.input(1))
        case "sincos":
            return block.apply("sin", u), block.apply("cos", u)
        case "asinh" | "acosh" | "atanh":
            return Signal(INVERSE_HYPERBOLIC[operator](block.builder, u.nodes), u.period)
    raise UnsupportedError(f"Operator {operator!r} is not supported")


@block("Polyval", Coefs="[1,2]", SampleTime="-1")
def polynomial(block: BlockContext) -> SignalOrBus:
    """Evaluate a polynomial, coefficients with the highest power first."""
    u, coefficients = block.input(), block.parameter("Coefs")
    result: Signal | None = None
    for term in coefficients.elements:
        result = term if result is None else block.apply("add", block.apply("mul", result, u), term)
    if result is None:
        raise UnsupportedError("it has no coefficients")
    return result


@block("Fcn", Expr="sin(u[1])", SampleTime="-1")
def function(block: BlockContext) -> SignalOrBus:
    """Evaluate an expression of the input elements u, u[1], u[2], ..."""
    text = _INDEX.sub(r"u(\1)", block.field_text("Expr"))
    text = re.sub(r"!(?!=)", "~", text)
    u = block.input()
    try:
        nodes = block.compiler.expressions.array(text, block.flat.scope, names={"u": u.nodes.reshape(-1, 1)})
    except EvaluationError as error:
        raise UnsupportedError(
            f"its expression {text[:80]} is not supported: {error}", undefined=error.undefined
        ) from None
    return Signal(nodes.ravel()[:1], u.period)  # u alone is u[1]
