"""Normalisations: by constants of a training, or by mean and variance of the elements themselves."""

from collections.abc import Sequence

import numpy as np

from kennfeld.importers.onnx.network import ML, Operator
from kennfeld.importers.onnx.reductions import reduce_along
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.shapes import first
from kennfeld.importers.onnx.tensors import Tensor, UnsupportedOperatorError, rearrange, shape_of


@operator("BatchNormalization")
def batch_normalization(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    if op.get("training_mode", 0) or len([name for name in op.outputs if name]) > 1:
        raise UnsupportedOperatorError("it is in training mode; export the network for inference")
    # one value per channel, which is dimension 1
    sizes = [1, -1, *[1] * (len(shape_of(x)) - 2)]
    scale, bias, mean, variance = (
        rearrange(lambda array: array.reshape(sizes), argument) for argument in arguments[1:5] if argument is not None
    )
    deviation = c.apply("sqrt", c.apply("add", variance, op.get("epsilon", 1e-5)))
    shifted = c.apply("sub", x, mean)
    # in this order, scale / deviation folds to one constant
    return c.apply("add", c.apply("mul", shifted, c.apply("div", scale, deviation)), bias)


@operator("LayerNormalization")
def layer_normalization(c: Context, op: Operator, arguments: Arguments) -> list[Tensor]:
    """Compute the normalised elements, their mean, and the inverse of their standard deviation."""
    x, scale, bias = (*arguments, None)[:3]
    assert x is not None
    assert scale is not None
    dimensions = len(shape_of(x))
    axes = list(range(op.get("axis", -1) % dimensions, dimensions))
    centred, mean, deviation = _centred(c, x, axes, op.get("epsilon", 1e-5))
    scaled = c.apply("mul", c.apply("div", centred, deviation), scale)
    return [scaled if bias is None else c.apply("add", scaled, bias), mean, c.apply("div", 1.0, deviation)]


@operator("LpNormalization")
def lp_normalization(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    axis = op.get("axis", -1) % len(shape_of(x))
    return c.apply("div", x, reduce_along(c, "L1" if op.get("p", 2) == 1 else "L2", x, [axis]))


@operator("RMSNormalization")
def root_mean_square_normalization(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, scale = arguments[:2]
    assert x is not None
    assert scale is not None
    dimensions = len(shape_of(x))
    axes = list(range(op.get("axis", -1) % dimensions, dimensions))
    square = reduce_along(c, "Mean", c.apply("mul", x, x), axes)
    size = c.apply("sqrt", c.apply("add", square, op.get("epsilon", 1e-5)))
    return c.apply("mul", c.apply("div", x, size), scale)


@operator("InstanceNormalization")
def instance_normalization(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, scale, bias = arguments[:3]
    assert x is not None
    assert scale is not None
    assert bias is not None
    sizes = [1, -1, *[1] * (len(shape_of(x)) - 2)]
    centred, _, deviation = _centred(c, x, list(range(2, len(shape_of(x)))), op.get("epsilon", 1e-5))
    scaled = c.apply("mul", c.apply("div", centred, deviation), rearrange(lambda array: array.reshape(sizes), scale))
    return c.apply("add", scaled, rearrange(lambda array: array.reshape(sizes), bias))


def _centred(c: Context, x: Tensor, axes: Sequence[int], epsilon: float) -> tuple[Tensor, Tensor, Tensor]:
    """Return elements without their mean along axes, the mean, and the standard deviation."""
    mean = reduce_along(c, "Mean", x, axes)
    centred = c.apply("sub", x, mean)
    variance = reduce_along(c, "Mean", c.apply("mul", centred, centred), axes)
    return centred, mean, c.apply("sqrt", c.apply("add", variance, epsilon))


@operator("Scaler", domain=ML)
def scaler(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    offset, scale = (np.asarray(op.get(name, [default])) for name, default in (("offset", 0.0), ("scale", 1.0)))
    return c.apply("mul", c.apply("sub", first(arguments), offset), scale)


@operator("Imputer", domain=ML)
def imputer(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    values = op.get("imputed_value_floats", op.get("imputed_value_int64s"))
    if values is None:
        raise UnsupportedOperatorError("it has no values")
    replaced = op.get("replaced_value_float", op.get("replaced_value_int64", 0))
    # NaN is not equal to itself
    missing = c.truth("ne", x, x) if np.isnan(replaced) else c.truth("eq", x, float(replaced))
    return c.where(missing, np.asarray(values, dtype=np.float64), x)


@operator("Normalizer", domain=ML)
def normalizer(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Divide by the norm along the last axis; a norm of 0 divides by 1."""
    x, norm = first(arguments), op.get("norm", "MAX")
    axes = [len(shape_of(x)) - 1]
    size = reduce_along(c, {"MAX": "Max"}.get(norm, norm), x, axes)
    return c.apply("div", x, c.where(c.truth("eq", size, 0.0), 1.0, size))
