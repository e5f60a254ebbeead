"""Elementwise operators: arithmetic, activations, comparisons."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from kennfeld.importers.onnx.network import ML, Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.tensors import (
    NodeTensor,
    Tensor,
    UnsupportedOperatorError,
    kind_of,
    shape_of,
)
from kennfeld.models.imperative.node_arrays import truncate

Formula = Callable[[Context, Operator, Tensor], Tensor]

_UNARY = {
    **{kind: kind.lower() for kind in ("Abs", "Neg", "Sqrt", "Exp", "Log", "Sin", "Cos", "Tan", "Tanh", "Erf")},
    **{kind: kind.lower() for kind in ("Asin", "Acos", "Atan", "Sinh", "Cosh", "Floor", "Ceil", "Sign")},
}
_BINARY = {"Add": "add", "Sub": "sub", "Mul": "mul", "Pow": "pow"}
_VARIADIC = {"Min": "min", "Max": "max", "Sum": "add"}
_COMPARISONS = {
    "Less": "lt", "LessOrEqual": "le", "Greater": "gt", "GreaterOrEqual": "ge", "Equal": "eq", "And": "and", "Or": "or",
}  # fmt: skip
# alpha and gamma of Klambauer et al., Self-Normalizing Neural Networks (2017)
SELU = (1.6732632423543772848170429916717, 1.0507009873554804934193349852946)


def _arguments(arguments: Arguments) -> list[Tensor]:
    return [argument for argument in arguments if argument is not None]


def typed(result: Tensor, *sources: Tensor) -> Tensor:
    """Mark a result as an integer if all of its sources are integers."""
    if any(kind_of(source) == "float" for source in sources):
        return result
    return NodeTensor(result.nodes, "int") if isinstance(result, NodeTensor) else result.astype(np.int64)


@operator(*_UNARY)
def unary(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    (x,) = _arguments(arguments)
    return typed(c.apply(_UNARY[op.kind], x), x)


@operator(*_BINARY)
def binary(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    a, b = _arguments(arguments)
    return typed(c.apply(_BINARY[op.kind], *_aligned(op, a, b)), a, b)


def _aligned(op: Operator, a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Align the second argument at `axis`, as operators did before version 7."""
    axis = op.get("axis")
    if op.version >= 7 or not op.get("broadcast") or axis is None:
        return a, b
    padding = len(shape_of(a)) - axis - len(shape_of(b))
    if isinstance(b, NodeTensor):
        return a, NodeTensor(b.nodes.reshape(*b.nodes.shape, *[1] * padding), b.kind)
    return a, b.reshape(*b.shape, *[1] * padding)


@operator("Div")
def div(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    a, b = _arguments(arguments)
    quotient = c.apply("div", *_aligned(op, a, b))
    if "float" in (kind_of(a), kind_of(b)):
        return quotient
    # integers are divided as in C: the quotient is cut towards 0
    return typed(truncated(c, quotient), a, b)


def truncated(c: Context, x: Tensor) -> Tensor:
    """Return the integers of numbers, without what follows the point."""
    return (
        NodeTensor(truncate(c.builder, x.nodes), "int") if isinstance(x, NodeTensor) else np.trunc(x).astype(np.int64)
    )


@operator("Mod")
def mod(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    a, b = _arguments(arguments)
    if op.get("fmod", 0):
        # a - b trunc(a / b), which has the sign of a; without `fmod`, the remainder has that of b
        return c.apply("sub", a, c.apply("mul", b, truncated(c, c.apply("div", a, b))))
    # `mod` of a graph returns a for b = 0
    return typed(c.where(c.truth("eq", b, 0.0), math.nan, c.apply("mod", a, b)), a, b)


@operator(*_VARIADIC, "Mean")
def variadic(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    tensors = _arguments(arguments)
    if op.kind == "Mean":
        return c.apply("div", c.apply.fold("add", tensors), float(len(tensors)))
    return typed(c.apply.fold(_VARIADIC[op.kind], tensors), *tensors)


@operator(*_COMPARISONS, "Xor")
def comparison(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    a, b = _arguments(arguments)
    if op.kind == "Xor":
        # as truth values, because any number but 0 is true
        return c.truth("ne", c.truth("ne", a, 0.0), c.truth("ne", b, 0.0))
    return c.truth(_COMPARISONS[op.kind], *_aligned(op, a, b))


@operator("Not")
def negation(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    return c.truth("not", *_arguments(arguments))


@operator("IsNaN")
def is_nan(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    (x,) = _arguments(arguments)
    # NaN alone differs from itself
    return c.truth("ne", x, x)


@operator("IsInf")
def is_infinite(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    (x,) = _arguments(arguments)
    signs = op.get("detect_positive", 1), -op.get("detect_negative", 1)
    return c.truth("or", *(c.truth("eq", x, sign * math.inf) if sign else np.zeros(()) for sign in signs))


@operator("Where")
def where(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    condition, a, b = _arguments(arguments)
    return typed(c.where(condition, a, b), a, b)


@operator("Clip")
def clip(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, lower, upper = (*arguments, None, None)[:3]
    assert x is not None
    result = x
    for limit, attribute, extreme in ((lower, "min", "max"), (upper, "max", "min")):
        # limits are attributes before version 11, arguments from there on
        value = op.get(attribute) if limit is None else limit
        if value is not None:
            result = c.apply(extreme, result, value)
    return typed(result, x)


@operator("Round")
def rounded(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    (x,) = _arguments(arguments)
    return round_half_even(c, x)


def round_half_even(c: Context, x: Tensor) -> Tensor:
    """Round to the nearest integer; halves to even ones."""
    if not isinstance(x, NodeTensor):
        return np.round(x)
    # low + (rest > 1/2, or rest = 1/2 and low odd)
    low = c.apply("floor", x)
    rest = c.apply("sub", x, low)
    odd = c.apply("mod", low, 2.0)
    up = c.truth("or", c.truth("gt", rest, 0.5), c.truth("and", c.truth("eq", rest, 0.5), odd))
    return c.apply("add", low, up)


@operator("Cast", "CastLike")
def cast(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    from onnx import TensorProto, helper

    x = arguments[0]
    assert x is not None
    if op.kind == "CastLike":
        assert arguments[1] is not None
        target = kind_of(arguments[1])[0]
    else:
        target = np.dtype(helper.tensor_dtype_to_np_dtype(op.get("to", TensorProto.FLOAT))).kind
    if target == "b":
        return c.truth("ne", x, 0.0)
    if target in "iu":
        return truncated(c, x) if kind_of(x) == "float" else typed(x, x)
    if target not in "fV":  # V: formats with fewer than 32 bits
        raise UnsupportedOperatorError("it casts to a type that is not a number")
    return NodeTensor(x.nodes) if isinstance(x, NodeTensor) else x.astype(np.float64)


def _relu(c: Context, op: Operator, x: Tensor) -> Tensor:
    return c.apply("max", x, 0.0)


def _scaled_below(c: Context, x: Tensor, slope: Tensor | float) -> Tensor:
    return c.where(c.truth("lt", x, 0.0), c.apply("mul", x, slope), x)


def _leaky_relu(c: Context, op: Operator, x: Tensor) -> Tensor:
    return _scaled_below(c, x, op.get("alpha", 0.01))


def _exponential_below(c: Context, x: Tensor, alpha: float, width: float = 1.0) -> Tensor:
    """Compute alpha (e^(x / width) - 1) below 0, else x."""
    # both branches are computed: without the minimum, e^x could overflow in the one that is not selected
    grown = c.apply("exp", c.apply("div", c.apply("min", x, 0.0), width))
    return c.where(c.truth("lt", x, 0.0), c.apply("mul", c.apply("sub", grown, 1.0), alpha), x)


def _elu(c: Context, op: Operator, x: Tensor) -> Tensor:
    return _exponential_below(c, x, op.get("alpha", 1.0))


def _celu(c: Context, op: Operator, x: Tensor) -> Tensor:
    alpha = op.get("alpha", 1.0)
    return _exponential_below(c, x, alpha, alpha)


def _selu(c: Context, op: Operator, x: Tensor) -> Tensor:
    alpha, gamma = op.get("alpha", SELU[0]), op.get("gamma", SELU[1])
    return c.apply("mul", _exponential_below(c, x, alpha), gamma)


def sigmoid(c: Context, x: Tensor) -> Tensor:
    """Compute 1 / (1 + e^-x) by tanh, which cannot overflow."""
    return c.apply("add", c.apply("mul", c.apply("tanh", c.apply("mul", x, 0.5)), 0.5), 0.5)


def softplus(c: Context, x: Tensor) -> Tensor:
    """Compute log(1 + e^x) without overflow."""
    # log(1 + e^x) below 0, x + log(1 + e^-x) above, each with an exponent that is not positive
    below = c.apply("log", c.apply("add", c.apply("exp", c.apply("min", x, 0.0)), 1.0))
    rest = c.apply("log", c.apply("add", c.apply("exp", c.apply("neg", c.apply("max", x, 0.0))), 1.0))
    return c.where(c.truth("lt", x, 0.0), below, c.apply("add", x, rest))


def _softsign(c: Context, op: Operator, x: Tensor) -> Tensor:
    return c.apply("div", x, c.apply("add", c.apply("abs", x), 1.0))


def _hard_sigmoid(c: Context, op: Operator, x: Tensor, alpha: float = 0.2) -> Tensor:
    line = c.apply("add", c.apply("mul", x, op.get("alpha", alpha)), op.get("beta", 0.5))
    return c.apply("max", c.apply("min", line, 1.0), 0.0)


def _hard_swish(c: Context, op: Operator, x: Tensor) -> Tensor:
    return c.apply("mul", x, _hard_sigmoid(c, op, x, 1 / 6))


def _thresholded_relu(c: Context, op: Operator, x: Tensor) -> Tensor:
    return c.where(c.truth("gt", x, op.get("alpha", 1.0)), x, 0.0)


def _mish(c: Context, op: Operator, x: Tensor) -> Tensor:
    return c.apply("mul", x, c.apply("tanh", softplus(c, x)))


def _swish(c: Context, op: Operator, x: Tensor) -> Tensor:
    return c.apply("mul", x, sigmoid(c, c.apply("mul", x, op.get("alpha", 1.0))))


def _gelu(c: Context, op: Operator, x: Tensor) -> Tensor:
    if op.get("approximate", "none") == "tanh":
        # x / 2 (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3))): Hendrycks and Gimpel, Gaussian Error Linear Units (2016)
        cubic = c.apply("add", x, c.apply("mul", c.apply("pow", x, 3.0), 0.044715))
        share = c.apply("tanh", c.apply("mul", cubic, math.sqrt(2 / math.pi)))
    else:
        share = c.apply("erf", c.apply("mul", x, math.sqrt(0.5)))
    return c.apply("mul", c.apply("mul", x, 0.5), c.apply("add", share, 1.0))


def _asinh(c: Context, op: Operator, x: Tensor) -> Tensor:
    """Compute the inverse of sinh by the logarithm of a number above 1, whose digits are not cancelled."""
    negative = c.truth("lt", x, 0.0)
    size = c.where(negative, c.apply("neg", x), x)
    root = c.apply("sqrt", c.apply("add", c.apply("mul", x, x), 1.0))
    grown = c.apply("log", c.apply("add", size, root))
    return c.where(negative, c.apply("neg", grown), grown)


def _acosh(c: Context, op: Operator, x: Tensor) -> Tensor:
    root = c.apply("sqrt", c.apply("sub", c.apply("mul", x, x), 1.0))
    return c.apply("log", c.apply("add", x, root))


def _atanh(c: Context, op: Operator, x: Tensor) -> Tensor:
    # log((1 + x) / (1 - x)) / 2
    share = c.apply("div", c.apply("add", x, 1.0), c.apply("sub", 1.0, x))
    return c.apply("mul", c.apply("log", share), 0.5)


def _shrink(c: Context, op: Operator, x: Tensor) -> Tensor:
    bias, limit = op.get("bias", 0.0), op.get("lambd", 0.5)
    above = c.where(c.truth("gt", x, limit), c.apply("sub", x, bias), 0.0)
    return c.where(c.truth("lt", x, -limit), c.apply("add", x, bias), above)


FORMULAS: Mapping[str, Formula] = {
    "Relu": _relu,
    "LeakyRelu": _leaky_relu,
    "Elu": _elu,
    "Celu": _celu,
    "Selu": _selu,
    "Sigmoid": lambda c, op, x: sigmoid(c, x),
    "Softplus": lambda c, op, x: softplus(c, x),
    "Softsign": _softsign,
    "HardSigmoid": _hard_sigmoid,
    "HardSwish": _hard_swish,
    "ThresholdedRelu": _thresholded_relu,
    "Mish": _mish,
    "Swish": _swish,
    "Gelu": _gelu,
    "Shrink": _shrink,
    "Asinh": _asinh,
    "Acosh": _acosh,
    "Atanh": _atanh,
    "Reciprocal": lambda c, op, x: c.apply("div", 1.0, x),
}


@operator(*FORMULAS)
def activation(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    (x,) = _arguments(arguments)
    return FORMULAS[op.kind](c, op, x)


@operator("Binarizer", domain=ML)
def binarizer(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    (x,) = _arguments(arguments)
    return c.where(c.truth("gt", x, op.get("threshold", 0.0)), 1.0, 0.0)


@operator("PRelu")
def prelu(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, slope = _arguments(arguments)
    return _scaled_below(c, x, slope)
