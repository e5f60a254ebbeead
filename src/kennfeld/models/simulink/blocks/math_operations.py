"""Arithmetic: gains, sums, products, elementary functions."""

import re

import numpy as np

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.graph_operators import INVERSE_HYPERBOLIC, without_rest
from kennfeld.models.imperative.node_arrays import Nodes, matrix_product, reduce_nodes, truncate
from kennfeld.models.simulink.blocks.matrix_operations import as_matrix, inverse_of
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import Signal, SignalOrBus, as_vector, fastest_sample_time, scalar

_TURNS = {"degree": 360.0, "revolution": 1.0}

_INDEX = re.compile(r"\bu\s*\[\s*([^\]]*)\]")


@block("Gain", Gain="1", Multiplication="Element-wise(K.*u)", SampleTime="-1")
def gain(site: BlockContext) -> SignalOrBus:
    """The input times K, element by element or as matrices."""
    kind = site.text("Multiplication")
    u = site.input()
    if kind.startswith("Element-wise"):
        return site.call("mul", site.parameter("Gain"), u)
    k = site.matrix("Gain")
    if u.size == 1 < k.shape[1] and "u*K" not in kind:
        site.wish(0, (k.shape[1],))
    column = u.nodes.reshape(-1, 1) if u.nodes.ndim == 1 else u.nodes
    left, right = (column, k) if "u*K" in kind else (k, column)
    if "u*K" in kind and u.nodes.ndim == 1:
        left = u.nodes.reshape(1, -1) if k.shape[0] == u.size else column
    return _as_input(_product(site, left, right), u)


def _as_input(made: Nodes, u: Signal) -> Signal:
    return Signal(made.ravel() if u.nodes.ndim == 1 and 1 in made.shape else made, u.period)


def _product(site: BlockContext, left: Nodes, right: Nodes) -> Nodes:
    if left.size == 1 or right.size == 1:
        spread = np.broadcast_arrays(left, right)
        made = [
            site.builder.call("mul", int(a), int(b)) for a, b in zip(spread[0].ravel(), spread[1].ravel(), strict=True)
        ]
        return np.array(made, dtype=np.int64).reshape(spread[0].shape)
    if left.shape[1] != right.shape[0]:
        raise UnsupportedError(f"matrices of {left.shape} and {right.shape} cannot be multiplied")
    return matrix_product(site.builder, left, right)


def _signs(site: BlockContext, plus: str, minus: str) -> str:
    """The signs of the inputs: as listed, or as many of the first as there are."""
    written = site.text("Inputs").replace("|", "").replace(" ", "")
    if written and set(written) <= {plus, minus}:
        return written
    return plus * site.whole("Inputs", 1, 1000)


@block("Sum", Inputs="++", SampleTime="-1", CollapseMode="All dimensions", CollapseDim="1")
def sum_of(site: BlockContext) -> SignalOrBus:
    """The inputs added and subtracted; a single one has its elements added up."""
    signs = _signs(site, "+", "-")
    if len(signs) == 1:
        total = _collapsed(site, "add")
        return total if signs == "+" else site.call("neg", total)
    made = site.input(0) if signs[0] == "+" else site.call("neg", site.input(0))
    for at, sign in enumerate(signs[1:], 1):
        made = site.call("add" if sign == "+" else "sub", made, site.input(at))
    return made


def _collapsed(site: BlockContext, op: str) -> Signal:
    """The elements of the only input joined by an operation."""
    u = site.input()
    if u.nodes.ndim == 2 and site.text("CollapseMode") != "All dimensions":
        axis = site.whole("CollapseDim", 1, 2) - 1
        lines = u.nodes if axis == 1 else u.nodes.T
        made = np.array([reduce_nodes(site.builder, op, [int(n) for n in line]) for line in lines], dtype=np.int64)
        return Signal(made.reshape((1, -1) if axis == 0 else (-1, 1)), u.period)
    return scalar(reduce_nodes(site.builder, op, u.flat), u.period)


@block("Product", Inputs="2", Multiplication="Element-wise(.*)", SampleTime="-1", CollapseMode="All dimensions",
       CollapseDim="1")  # fmt: skip
def product(site: BlockContext) -> SignalOrBus:
    """The inputs multiplied and divided; a single one has its elements multiplied."""
    signs = _signs(site, "*", "/")
    if site.text("Multiplication").startswith("Matrix"):
        return _matrices(site, signs)
    if len(signs) == 1:
        whole = _collapsed(site, "mul")
        return whole if signs == "*" else site.call("div", site.constant(1.0), whole)
    made = site.input(0) if signs[0] == "*" else site.call("div", site.constant(1.0), site.input(0))
    for at, sign in enumerate(signs[1:], 1):
        if at == 1 and signs[:2] == "/*":  # b/a rather than (1/a) b
            made = site.call("div", site.input(1), site.input(0))
        else:
            made = site.call("mul" if sign == "*" else "div", made, site.input(at))
    return made


def _matrices(site: BlockContext, signs: str) -> Signal:
    """The inputs multiplied as matrices, those with a slash inverted; vectors are columns."""
    made: Nodes | None = None
    for at, sign in enumerate(signs):
        other = as_matrix(site.input(at))
        other = inverse_of(site, other) if sign == "/" else other
        made = other if made is None else _product(site, made, other)
    assert made is not None
    period = fastest_sample_time([one.period for one in site.inputs])
    flat = all(one.nodes.ndim == 1 for one in site.inputs) or made.size == 1
    return Signal(as_vector(made) if flat else made, period)


@block("DotProduct")
def dot_product(site: BlockContext) -> SignalOrBus:
    """The sum of the products of two vectors' elements."""
    made = site.call("mul", site.input(0), site.input(1))
    return scalar(reduce_nodes(site.builder, "add", made.flat), made.period)


@block("Bias", Bias="0")
def bias(site: BlockContext) -> SignalOrBus:
    """The input plus a constant."""
    return site.call("add", site.input(), site.parameter("Bias"))


@block("Slider Gain", "SliderGain", linked=True, low="0", gain="1", high="2")
def slider_gain(site: BlockContext) -> SignalOrBus:
    """The input times where a slider stands."""
    return site.call("mul", site.parameter("gain"), site.input())


@block("UnaryMinus", "Unary Minus")
def unary_minus(site: BlockContext) -> SignalOrBus:
    """The input with the other sign."""
    return site.call("neg", site.input())


@block("Abs", SampleTime="-1")
def absolute(site: BlockContext) -> SignalOrBus:
    """The absolute value."""
    return site.call("abs", site.input())


@block("Signum", SampleTime="-1")
def signum(site: BlockContext) -> SignalOrBus:
    """The sign: 1, 0 or -1."""
    return site.call("sign", site.input())


@block("MinMax", Function="min", Inputs="1", SampleTime="-1")
def minmax(site: BlockContext) -> SignalOrBus:
    """The least or greatest of the inputs; of a single one, of its elements."""
    op = site.chosen("Function", "min", "max")
    if site.count == 1:
        u = site.input()
        return scalar(reduce_nodes(site.builder, op, u.flat), u.period)
    return site.fold(op, site.inputs)


@block("Math", Operator="exp", SampleTime="-1")
def math(site: BlockContext) -> SignalOrBus:
    """An elementary function of one or two inputs."""
    operator = site.text("Operator")
    u = site.input()
    one = site.constant(1.0)
    match operator:
        case "exp" | "log" | "log10" | "sqrt":
            return site.call(operator, u)
        case "10^u":
            return site.call("pow", site.constant(10.0), u)
        case "square" | "magnitude^2":
            return site.call("mul", u, u)
        case "conj":
            return u
        case "reciprocal":
            return site.call("div", one, u)
        case "pow":
            return site.call("pow", u, site.input(1))
        case "hypot":
            v = site.input(1)
            return site.call("sqrt", site.call("add", site.call("mul", u, u), site.call("mul", v, v)))
        case "mod":
            v = site.input(1)
            return _rounded_rest(site, site.call("mod", u, v), u, v)
        case "rem":
            return _remainder(site, u, site.input(1))
        case "transpose" | "hermitian":
            return Signal(u.nodes.T if u.nodes.ndim == 2 else u.nodes.reshape(1, -1), u.period)
        case "rSqrt" | "1/sqrt":
            return site.call("div", one, site.call("sqrt", u))
    raise UnsupportedError(f"Operator is {operator!r}, which is not supported")


def _remainder(site: BlockContext, u: Signal, v: Signal) -> Signal:
    """What is left of u after whole steps of v towards 0; u itself where v is 0."""
    ratio = site.call("div", u, v)
    whole = Signal(truncate(site.builder, ratio.nodes), ratio.period)
    rest = _rounded_rest(site, site.call("sub", u, site.call("mul", whole, v)), u, v)
    return site.select(site.call("eq", v, site.constant(0.0)), u, rest)


def _rounded_rest(site: BlockContext, rest: Signal, u: Signal, v: Signal) -> Signal:
    """A remainder that is 0 where u is a multiple of v but for rounding."""
    spread = site.spread(rest, u, v)
    return Signal(without_rest(site.builder, *(signal.nodes for signal in spread)), rest.period)


@block("Sqrt", Operator="sqrt", SampleTime="-1")
def sqrt(site: BlockContext) -> SignalOrBus:
    """The square root, of the absolute value with the sign kept, or its reciprocal."""
    u = site.input()
    match site.chosen("Operator", "sqrt", "signedSqrt", "rSqrt"):
        case "sqrt":
            return site.call("sqrt", u)
        case "signedSqrt":
            zero = site.constant(0.0)
            root = site.call("sqrt", site.call("abs", u))
            return site.select(site.call("lt", u, zero), site.call("neg", root), root)
    return site.call("div", site.constant(1.0), site.call("sqrt", u))


@block("Rounding", Operator="floor")
def rounding(site: BlockContext) -> SignalOrBus:
    """A whole number near the input."""
    operator = site.chosen("Operator", "floor", "ceil", "round", "fix")
    u = site.input()
    return Signal(truncate(site.builder, u.nodes), u.period) if operator == "fix" else site.call(operator, u)


@block("Trigonometry", Operator="sin", AngleUnit="radian", SampleTime="-1")
def trigonometry(site: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """A trigonometric or hyperbolic function."""
    operator, u = site.text("Operator"), site.input()
    unit = site.chosen("AngleUnit", "radian", "degree", "revolution")
    if unit != "radian":
        return _in_unit(site, operator, _TURNS[unit], u)
    return _trigonometric(site, operator, u)


def _in_unit(site: BlockContext, operator: str, turn: float, u: Signal) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """A function of an angle that is counted in parts of a turn, or that gives one."""
    if operator in ("sin", "cos", "tan", "sincos", "cos + jsin"):
        scale = site.constant(2 * np.pi / turn)
        return _trigonometric(site, operator, site.call("mul", u, scale))
    made = _trigonometric(site, operator, u)
    if operator not in ("asin", "acos", "atan", "atan2") or not isinstance(made, Signal):
        return made
    return site.call("mul", made, site.constant(turn / (2 * np.pi)))


def _trigonometric(site: BlockContext, operator: str, u: Signal) -> SignalOrBus | tuple[SignalOrBus, ...]:
    match operator:
        case "sin" | "cos" | "tan" | "asin" | "acos" | "atan" | "sinh" | "cosh" | "tanh":
            return site.call(operator, u)
        case "atan2":
            return site.call("atan2", u, site.input(1))
        case "sincos":
            return site.call("sin", u), site.call("cos", u)
        case "asinh" | "acosh" | "atanh":
            return Signal(INVERSE_HYPERBOLIC[operator](site.builder, u.nodes), u.period)
    raise UnsupportedError(f"Operator is {operator!r}, which is not supported")


@block("Polyval", Coefs="[1,2]", SampleTime="-1")
def polynomial(site: BlockContext) -> SignalOrBus:
    """A polynomial by its coefficients, the highest power first."""
    u, coefficients = site.input(), site.parameter("Coefs")
    made: Signal | None = None
    for term in coefficients.elements:
        made = term if made is None else site.call("add", site.call("mul", made, u), term)
    if made is None:
        raise UnsupportedError("it has no coefficients")
    return made


@block("Fcn", Expr="sin(u[1])", SampleTime="-1")
def function(site: BlockContext) -> SignalOrBus:
    """An expression of the elements of its input, u or u[1], u[2], ..."""
    text = _INDEX.sub(r"u(\1)", site.text("Expr"))
    text = re.sub(r"!(?!=)", "~", text)
    u = site.input()
    try:
        made = site.compiler.expressions.array(text, site.atom.scope, names={"u": u.nodes.reshape(-1, 1)})
    except EvaluationError as error:
        raise UnsupportedError(
            f"its expression {text[:80]} cannot be built: {error}", undefined=error.undefined
        ) from None
    return Signal(made.ravel()[:1], u.period)  # u by itself is u[1]
