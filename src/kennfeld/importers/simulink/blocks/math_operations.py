"""Math Operations library: gain, sum, product, elementary functions, polynomial and Fcn."""

import functools
import re

import numpy as np

from kennfeld.base.formatting import size_text
from kennfeld.importers.simulink.blocks.matrix_operations import inverse_of
from kennfeld.importers.simulink.lowering import ARITHMETIC, BlockContext, Outputs, UnsupportedError, block, evaluating
from kennfeld.importers.simulink.reader.dialog_words import contains_word
from kennfeld.importers.simulink.signals import (
    Signal,
    SignalOrBus,
    apply,
    as_vector,
    broadcast,
    period_of,
    select,
    width_notes,
)
from kennfeld.models.imperative.graph_operators import INVERSE_HYPERBOLIC, plain_remainder, without_rest
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, matrix_product, reduce_nodes

_TURNS = {"radian": None, "degree": 360.0, "revolution": 1.0}
_FUNCTIONS = (
    "exp", "log", "log10", "sqrt", "10^u", "square", "magnitude^2", "conj", "reciprocal", "pow", "hypot", "mod", "rem",
    "transpose", "hermitian", "rSqrt", "1/sqrt",
)  # fmt: skip
_TRIGONOMETRIC = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "atan2", "sincos", *INVERSE_HYPERBOLIC,
)  # fmt: skip
_INDEX = re.compile(r"\bu\s*\[\s*([^\]]*)\]")


@block("Gain", output=ARITHMETIC, Gain="1", Multiplication="Element-wise(K.*u)", SampleTime="-1")
def gain(block: BlockContext) -> SignalOrBus:
    """Multiply the input by K, element by element or as matrices."""
    u = block.input()
    if block.begins_with("Multiplication", "Element-wise"):
        return block.parameter("Gain") * u
    from_left = contains_word(block.field_text("Multiplication"), "u*K")
    k = block.matrix("Gain")
    # a scalar of unknown width takes that of the matrix in the next pass
    if u.size == 1 < k.shape[1] and not from_left:
        block.suggest_dimensions((k.shape[1],))
    column = u.matrix
    left, right = (column, k) if from_left else (k, column)
    if from_left and u.nodes.ndim == 1:
        # a vector from the left is a row if the matrix has as many rows, else a column
        left = u.nodes.reshape(1, -1) if k.shape[0] == u.size else column
    nodes = _product(block, left, right, width_notes(u))
    return block.signal(nodes.ravel() if u.nodes.ndim == 1 and 1 in nodes.shape else nodes, u.period)


def _product(block: BlockContext, left: Nodes, right: Nodes, note: str) -> Nodes:
    if left.size == 1 or right.size == 1:
        return elementwise(block.builder, "mul", left, right)
    if left.shape[1] != right.shape[0]:
        sizes = f"{size_text(left.shape)} and {size_text(right.shape)}"
        raise UnsupportedError(f"matrices of size {sizes} cannot be multiplied{note}")
    return matrix_product(block.builder, left, right)


def _signs(block: BlockContext, plus: str, minus: str) -> str:
    """Return the sign of each input, from the list or the number of inputs in the field."""
    # a bar is a gap between the ports in the drawing
    written = block.field_text("Inputs").replace("|", "").replace(" ", "")
    if written and set(written) <= {plus, minus}:
        return written
    return plus * block.integer_field("Inputs", 1, 1000)


@block("Sum", output=ARITHMETIC, Inputs="++", SampleTime="-1", CollapseMode="All dimensions", CollapseDim="1")
def sum_of(block: BlockContext) -> SignalOrBus:
    """Add and subtract the inputs, or sum the elements of a single input."""
    signs = _signs(block, "+", "-")
    if len(signs) == 1:
        total = _reduce_elements(block, "add")
        return total if signs == "+" else -total
    result = block.input(0) if signs[0] == "+" else -block.input(0)
    for at, sign in enumerate(signs[1:], 1):
        result = apply("add" if sign == "+" else "sub", result, block.input(at))
    return result


def _reduce_elements(block: BlockContext, op: str) -> Signal:
    """Reduce the elements of the only input, over all or one dimension."""
    u = block.input()
    block.warn_of_unknown_width(u)
    if u.nodes.ndim == 2 and not block.is_set_to("CollapseMode", "All dimensions"):
        axis = block.integer_field("CollapseDim", 1, 2) - 1
        lines = u.nodes if axis == 1 else u.nodes.T
        nodes = np.array([reduce_nodes(block.builder, op, line) for line in lines], dtype=np.int64)
        return block.signal(nodes.reshape((1, -1) if axis == 0 else (-1, 1)), u.period)
    return block.signal([reduce_nodes(block.builder, op, u.flat)], u.period)


@block("Product", output=ARITHMETIC,
       Inputs="2", Multiplication="Element-wise(.*)", SampleTime="-1", CollapseMode="All dimensions",
       CollapseDim="1")  # fmt: skip
def product(block: BlockContext) -> SignalOrBus:
    """Multiply and divide the inputs, or multiply the elements of a single input."""
    signs = _signs(block, "*", "/")
    if block.begins_with("Multiplication", "Matrix"):
        return _matrices(block, signs)
    if len(signs) == 1:
        whole = _reduce_elements(block, "mul")
        return whole if signs == "*" else 1.0 / whole
    result = block.input(0) if signs[0] == "*" else 1.0 / block.input(0)
    for at, sign in enumerate(signs[1:], 1):
        if at == 1 and signs[:2] == "/*":  # b/a rather than (1/a) b
            result = block.input(1) / block.input(0)
        else:
            result = apply("mul" if sign == "*" else "div", result, block.input(at))
    return result


def _matrices(block: BlockContext, signs: str) -> Signal:
    """Multiply the inputs as matrices, inverting those with a slash; vectors are columns."""
    nodes: Nodes | None = None
    for at, sign in enumerate(signs):
        other = block.input(at).matrix
        other = inverse_of(block, other) if sign == "/" else other
        nodes = other if nodes is None else _product(block, nodes, other, width_notes(*block.inputs))
    assert nodes is not None
    flat = all(signal.nodes.ndim == 1 for signal in block.inputs) or nodes.size == 1
    return block.signal(as_vector(nodes) if flat else nodes, period_of(block.inputs))


@block("DotProduct")
def dot_product(block: BlockContext) -> SignalOrBus:
    """Compute the dot product of two vectors."""
    return block.reduce("add", (block.input(0) * block.input(1)).elements)


@block("Bias", output=ARITHMETIC, Bias="0")
def bias(block: BlockContext) -> SignalOrBus:
    """Add a constant to the input."""
    return block.input() + block.parameter("Bias")


@block("Slider Gain", "SliderGain", linked=True, low="0", gain="1", high="2")
def slider_gain(block: BlockContext) -> SignalOrBus:
    """Multiply the input by the gain of a slider."""
    return block.parameter("gain") * block.input()


@block("UnaryMinus", "Unary Minus", "Abs", "Signum", output=ARITHMETIC, SampleTime="-1")
def sign_operation(block: BlockContext) -> SignalOrBus:
    """Compute the negative, the absolute value or the sign of the input."""
    return apply({"Abs": "abs", "Signum": "sign"}.get(block.flat.type, "neg"), block.input())


@block("MinMax", output=ARITHMETIC, Function="min", Inputs="1", SampleTime="-1")
def minmax(block: BlockContext) -> SignalOrBus:
    """Compute the minimum or maximum of the inputs, or of the elements of a single input."""
    op = block.option("Function", "min", "max")
    if block.input_count > 1:
        return block.reduce(op, block.inputs)
    block.warn_of_unknown_width(block.input())
    return block.reduce(op, block.input().elements)


@block("Math", output=ARITHMETIC, Operator="exp", SampleTime="-1")
def math(block: BlockContext) -> SignalOrBus:
    """Apply an elementary function to one or two inputs."""
    operator, u = block.option("Operator", *_FUNCTIONS), block.input()
    match operator:
        case "exp" | "log" | "log10" | "sqrt":
            return apply(operator, u)
        case "10^u":
            return 10.0**u
        case "square" | "magnitude^2":
            return u * u
        case "conj":
            return u
        case "reciprocal":
            return 1.0 / u
        case "pow":
            return u ** block.input(1)
        case "hypot":
            return apply("sqrt", u * u + block.input(1) * block.input(1))
        case "mod" | "rem":
            return _remainder(block, operator, *broadcast(u, block.input(1)))
        case "transpose" | "hermitian":
            # a vector is a column, so that its transpose is a row
            return block.signal(u.nodes.T if u.nodes.ndim == 2 else u.nodes.reshape(1, -1), u.period)
        case "rSqrt" | "1/sqrt":
            return 1.0 / apply("sqrt", u)
    raise AssertionError(operator)


def _remainder(block: BlockContext, operator: str, u: Signal, v: Signal) -> Signal:
    """Compute u - v floor(u / v), or with "rem" u - v fix(u / v); u if v is 0."""
    builder, nodes = block.builder, (u.nodes, v.nodes)
    plain = elementwise(builder, "mod", *nodes) if operator == "mod" else plain_remainder(builder, *nodes)
    rest = without_rest(builder, plain, *nodes)
    if operator == "rem":
        rest = elementwise(builder, "select", elementwise(builder, "eq", v.nodes, 0.0), u.nodes, rest)
    return block.signal(rest, period_of((u, v)))


@block("Sqrt", output=ARITHMETIC, Operator="sqrt", SampleTime="-1")
def sqrt(block: BlockContext) -> SignalOrBus:
    """Compute the square root, the signed square root or the reciprocal square root."""
    u = block.input()
    match block.option("Operator", "sqrt", "signedSqrt", "rSqrt"):
        case "sqrt":
            return apply("sqrt", u)
        case "signedSqrt":
            root = apply("sqrt", abs(u))
            return select(u < 0.0, -root, root)
    return 1.0 / apply("sqrt", u)


@block("Rounding", output=ARITHMETIC, Operator="floor")
def rounding(block: BlockContext) -> SignalOrBus:
    """Round the input to an integer."""
    operator = block.option("Operator", "floor", "ceil", "round", "fix")
    return block.truncate(block.input()) if operator == "fix" else apply(operator, block.input())


@block("Trigonometry", output=ARITHMETIC, Operator="sin", AngleUnit="radian", SampleTime="-1")
def trigonometry(block: BlockContext) -> Outputs:
    """Apply a trigonometric or hyperbolic function."""
    operator, u = block.option("Operator", *_TRIGONOMETRIC), block.input()
    turn = _TURNS[block.option("AngleUnit", *_TURNS)]
    if operator in ("sin", "cos", "tan", "sincos") and turn is not None:
        u = u * (2 * np.pi / turn)
    result = _trigonometric(block, operator, u)
    if operator in ("asin", "acos", "atan", "atan2") and turn is not None and isinstance(result, Signal):
        return result * (turn / (2 * np.pi))
    return result


def _trigonometric(block: BlockContext, operator: str, u: Signal) -> Outputs:
    match operator:
        case "sin" | "cos" | "tan" | "asin" | "acos" | "atan" | "sinh" | "cosh" | "tanh":
            return apply(operator, u)
        case "atan2":
            return apply("atan2", u, block.input(1))
        case "sincos":
            return apply("sin", u), apply("cos", u)
    return block.signal(INVERSE_HYPERBOLIC[operator](block.builder, u.nodes), u.period)


@block("Polyval", Coefs="[1,2]", SampleTime="-1")
def polynomial(block: BlockContext) -> SignalOrBus:
    """Evaluate a polynomial, coefficients with the highest power first."""
    u = block.input()
    # Horner's rule
    return functools.reduce(lambda result, term: result * u + term, block.parameter("Coefs").elements)


@block("Fcn", output=ARITHMETIC, Expr="sin(u[1])", SampleTime="-1")
def function(block: BlockContext) -> SignalOrBus:
    """Evaluate an expression of the input elements u, u[1], u[2], ..."""
    # the syntax of Fcn in that of MATLAB: u[1] is u(1), ! is ~, but != stays
    text = _INDEX.sub(r"u(\1)", block.field_text("Expr"))
    text = re.sub(r"!(?!=)", "~", text)
    u = block.input()
    with evaluating(f"its expression {text[:80]} is not supported"):
        nodes = block.compiler.expressions.array(text, block.flat.scope, names={"u": u.nodes.reshape(-1, 1)})
    return block.signal(nodes.ravel()[:1], u.period)  # u alone is u[1]
