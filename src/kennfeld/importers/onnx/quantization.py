"""Numbers of few bits: quantisation with a scale and a zero point."""

import numpy as np

from kennfeld.importers.onnx.elementwise import round_half_even
from kennfeld.importers.onnx.network import Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
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
    # limit(round(x / scale) + zero point)
    number = round_half_even(c, c.apply("div", x, _along(op, scale, x)))
    if zero is not None:
        number = c.apply("add", number, _along(op, zero, x))
    low, high = _RANGES[kind]
    result = c.apply("max", c.apply("min", number, float(high)), float(low))
    return NodeTensor(result.nodes, "int") if isinstance(result, NodeTensor) else result.astype(np.int64)


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
