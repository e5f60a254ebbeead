"""Operators over axes: sums, means, extremes, norms, softmax and normalisation."""

from collections.abc import Sequence

import numpy as np

from kennfeld.models.onnx_network.network import ML, Operator
from kennfeld.models.onnx_network.registry import Arguments, Context, operator
from kennfeld.models.onnx_network.shapes import first, integers
from kennfeld.models.onnx_network.tensors import Tensor, UnsupportedOperatorError, constant, rearrange, shape_of

_KINDS = ("Sum", "Mean", "Max", "Min", "Prod", "L1", "L2", "SumSquare", "LogSum", "LogSumExp")
_FOLDS = {"Max": "max", "Min": "min", "Prod": "mul"}


@operator(*(f"Reduce{kind}" for kind in _KINDS))
def reduction(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, axes = first(arguments), integers(op, arguments, 1, "axes")
    dimensions = len(shape_of(x))
    if not axes:
        if op.get("noop_with_empty_axes", 0):
            raise UnsupportedOperatorError("noop_with_empty_axes is not supported")
        axes = list(range(dimensions))
    places = sorted({axis % dimensions for axis in axes}) if dimensions else []
    reduced = _reduce(c, op.kind.removeprefix("Reduce"), x, places)
    return reduced if op.get("keepdims", 1) else rearrange(lambda array: np.squeeze(array, tuple(places)), reduced)


def _reduce(c: Context, kind: str, x: Tensor, axes: Sequence[int]) -> Tensor:
    apply = c.apply
    match kind:
        case "Mean":
            count = float(np.prod([shape_of(x)[axis] for axis in axes]))
            return apply("div", apply.reduce("add", x, axes), count)
        case "Max" | "Min" | "Prod":
            return apply.reduce(_FOLDS[kind], x, axes)
        case "L1":
            return apply.reduce("add", apply("abs", x), axes)
        case "SumSquare":
            return apply.reduce("add", apply("mul", x, x), axes)
        case "L2":
            return apply("sqrt", apply.reduce("add", apply("mul", x, x), axes))
        case "LogSum":
            return apply("log", apply.reduce("add", x, axes))
        case "LogSumExp":
            largest = apply.reduce("max", x, axes)
            total = apply.reduce("add", apply("exp", apply("sub", x, largest)), axes)
            return apply("add", apply("log", total), largest)
        case _:
            return apply.reduce("add", x, axes)


@operator("Softmax", "LogSoftmax")
def softmax(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, newer = first(arguments), op.version >= 13
    dimensions = len(shape_of(x))
    axis = op.get("axis", -1 if newer else 1) % max(dimensions, 1)
    axes = [axis] if newer else list(range(axis, dimensions))
    shifted = c.apply("sub", x, _reduce(c, "Max", x, axes))
    if op.kind == "LogSoftmax":
        return c.apply("sub", shifted, c.apply("log", _reduce(c, "Sum", c.apply("exp", shifted), axes)))
    grown = c.apply("exp", shifted)
    return c.apply("div", grown, _reduce(c, "Sum", grown, axes))


@operator("BatchNormalization")
def batch_normalization(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    if op.get("training_mode", 0) or len([name for name in op.outputs if name]) > 1:
        raise UnsupportedOperatorError("it is in training mode; export the network for inference")
    names = ("scale", "B", "input_mean", "input_var")
    scale, bias, mean, variance = (constant(arguments[1 + i], name) for i, name in enumerate(names))
    factor = scale / np.sqrt(variance.astype(np.float64) + op.get("epsilon", 1e-5))
    shape = [1, -1, *[1] * (len(shape_of(x)) - 2)]
    shifted = c.apply("sub", x, mean.reshape(shape))
    return c.apply("add", c.apply("mul", shifted, factor.reshape(shape)), bias.reshape(shape))


@operator("LayerNormalization")
def layer_normalization(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, scale, bias = (*arguments, None)[:3]
    assert x is not None
    assert scale is not None
    if len([name for name in op.outputs if name]) > 1:
        raise UnsupportedOperatorError("only its first output is supported")
    dimensions = len(shape_of(x))
    axes = list(range(op.get("axis", -1) % dimensions, dimensions))
    centred = c.apply("sub", x, _reduce(c, "Mean", x, axes))
    variance = _reduce(c, "Mean", c.apply("mul", centred, centred), axes)
    deviation = c.apply("sqrt", c.apply("add", variance, op.get("epsilon", 1e-5)))
    scaled = c.apply("mul", c.apply("div", centred, deviation), scale)
    return scaled if bias is None else c.apply("add", scaled, bias)


@operator("LpNormalization")
def lp_normalization(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    axis = op.get("axis", -1) % len(shape_of(x))
    return c.apply("div", x, _reduce(c, "L1" if op.get("p", 2) == 1 else "L2", x, [axis]))


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
    missing = c.truth("ne", x, x) if np.isnan(replaced) else c.truth("eq", x, float(replaced))
    return c.where(missing, np.asarray(values, dtype=np.float64), x)


@operator("Normalizer", domain=ML)
def normalizer(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Divide by the norm along the last axis; a norm of 0 divides by 1."""
    x, norm = first(arguments), op.get("norm", "MAX")
    axes = [len(shape_of(x)) - 1]
    size = _reduce(c, {"MAX": "Max"}.get(norm, norm), x, axes)
    return c.apply("div", x, c.where(c.truth("eq", size, 0.0), 1.0, size))
