"""Numbers of few bits: quantisation with a scale and a zero point, and products of such numbers."""

from collections.abc import Sequence

import numpy as np

from kennfeld.importers.onnx.elementwise import round_half_even
from kennfeld.importers.onnx.layers import product_of_integers
from kennfeld.importers.onnx.network import Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.shapes import first
from kennfeld.importers.onnx.tensors import (
    NodeTensor,
    Tensor,
    UnsupportedOperatorError,
    constant,
    rearrange,
    shape_of,
)

_RANGES = {"uint8": (0, 255), "int8": (-128, 127), "uint16": (0, 65535), "int16": (-32768, 32767)}


@operator("DequantizeLinear")
def dequantized(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, scale, zero = (*arguments, None)[:3]
    assert x is not None
    assert scale is not None
    if zero is not None:
        x = c.apply("sub", x, _along(op, zero, x))
    return c.apply("mul", x, _along(op, scale, x))


@operator("QuantizeLinear")
def quantized(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, scale, zero = (*arguments, None)[:3]
    assert x is not None
    assert scale is not None
    kind = "uint8" if zero is None else constant(zero, "y_zero_point").dtype.name
    if kind not in _RANGES or op.get("output_dtype", 0):
        raise UnsupportedOperatorError(f"quantisation to {kind} is not supported")
    number = _quotient(c, x, _along(op, scale, x))
    return _limited(c, number, None if zero is None else _along(op, zero, x), kind)


def _quotient(c: Context, x: Tensor, scale: Tensor) -> Tensor:
    """Divide in single precision, which decides whether a number between two integers is a half."""
    return c.apply("single", c.apply("div", c.apply("single", x), c.apply("single", scale)))


def _limited(c: Context, number: Tensor, zero: Tensor | None, kind: str) -> Tensor:
    """Return limit(round(number) + zero point) as integers of a kind."""
    number = round_half_even(c, number)
    if zero is not None:
        number = c.apply("add", number, zero)
    low, high = _RANGES[kind]
    result = c.apply("max", c.apply("min", number, float(high)), float(low))
    return NodeTensor(result.nodes, "int") if isinstance(result, NodeTensor) else result.astype(np.int64)


@operator("DynamicQuantizeLinear")
def dynamically_quantized(c: Context, op: Operator, arguments: Arguments) -> Sequence[Tensor]:
    """Quantise to the range of the tensor itself, which contains 0; return it with its scale and zero point."""
    x = first(arguments)
    low, high = (c.apply(kind, c.apply.reduce(kind, _flat(x), [0]), 0.0) for kind in ("min", "max"))
    low, high = (rearrange(lambda array: array.reshape(()), end) for end in (low, high))
    span = c.apply("sub", high, low)
    # a tensor of zeros has any scale
    scale = c.where(c.truth("eq", span, 0.0), 1.0, c.apply("div", span, 255.0))
    zero = _limited(c, c.apply("neg", _quotient(c, low, scale)), None, "uint8")
    return [_limited(c, _quotient(c, x, scale), zero, "uint8"), scale, zero]


def _flat(x: Tensor) -> Tensor:
    return rearrange(lambda array: array.ravel(), x)


@operator("MatMulInteger")
def integer_product(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    a, b, zero_a, zero_b = (*arguments, None, None)[:4]
    assert a is not None
    assert b is not None
    return product_of_integers(c, _centered(c, a, zero_a, -2), _centered(c, b, zero_b, -1))


@operator("QLinearMatMul")
def quantized_product(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    a, scale_a, zero_a, b, scale_b, zero_b, scale, zero = arguments
    assert a is not None
    assert scale_a is not None
    assert b is not None
    assert scale_b is not None
    assert scale is not None
    kind = constant(zero, "y_zero_point").dtype.name
    if kind not in _RANGES:
        raise UnsupportedOperatorError(f"quantisation to {kind} is not supported")
    product = product_of_integers(c, _centered(c, a, zero_a, -2), _centered(c, b, zero_b, -1))
    # in single precision, as the quotients above
    factor = c.apply("single", c.apply("mul", _spread(scale_a, a, -2), _spread(scale_b, b, -1)))
    factor = _quotient(c, factor, _scalar(scale))
    number = c.apply("single", c.apply("mul", c.apply("single", product), factor))
    return _limited(c, number, None if zero is None else _scalar(zero), kind)


def _centered(c: Context, x: Tensor, zero: Tensor | None, axis: int) -> Tensor:
    """Return integers less their zero point, which may depend on the inputs, or differ along an axis."""
    if zero is None:
        return x
    result = c.apply("sub", x, _spread(zero, x, axis))
    return NodeTensor(result.nodes, "int") if isinstance(result, NodeTensor) else result.astype(np.int64)


def _spread(tensor: Tensor, x: Tensor, axis: int) -> Tensor:
    """Align a scale or zero point with the rows (-2) or columns (-1) of a matrix."""
    if len(shape_of(tensor)) > 1:
        raise UnsupportedOperatorError("scales of several dimensions are not supported")
    if int(np.prod(shape_of(tensor))) == 1:
        return _scalar(tensor)
    return rearrange(lambda array: array[:, None] if axis == -2 and len(shape_of(x)) > 1 else array, tensor)


def _scalar(tensor: Tensor) -> Tensor:
    return rearrange(lambda array: array.reshape(()), tensor)


def _along(op: Operator, tensor: Tensor, x: Tensor) -> Tensor:
    """Align a scale or zero point with the axis that it belongs to."""
    if op.get("block_size", 0) or len(shape_of(tensor)) > 1:
        raise UnsupportedOperatorError("quantisation in blocks is not supported")
    # one scale for all elements; otherwise one along `axis`
    if not shape_of(tensor) or shape_of(tensor) == (1,):
        return rearrange(lambda array: array.reshape(()), tensor)
    count = len(shape_of(x))
    sizes = [-1 if axis == op.get("axis", 1) % count else 1 for axis in range(count)]
    return rearrange(lambda array: array.reshape(sizes), tensor)
