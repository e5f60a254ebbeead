"""Operators over axes: sums, means, extremes, norms and softmax."""

from collections.abc import Sequence

import numpy as np

from kennfeld.importers.onnx.elementwise import truncated
from kennfeld.importers.onnx.network import Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.shapes import first, integers
from kennfeld.importers.onnx.tensors import Tensor, UnsupportedOperatorError, kind_of, rearrange, shape_of

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
    reduced = reduce_along(c, op.kind.removeprefix("Reduce"), x, places)
    return reduced if op.get("keepdims", 1) else rearrange(lambda array: np.squeeze(array, tuple(places)), reduced)


def reduce_along(c: Context, kind: str, x: Tensor, axes: Sequence[int]) -> Tensor:
    apply = c.apply
    match kind:
        case "Mean":
            count = float(np.prod([shape_of(x)[axis] for axis in axes]))
            mean = apply("div", apply.reduce("add", x, axes), count)
            return mean if kind_of(x) == "float" else truncated(c, mean)
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
            # log(sum(e^(x - m))) + m, which cannot overflow
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
    # before version 13, all dimensions from the axis on are one
    axes = [axis] if newer else list(range(axis, dimensions))
    if op.kind == "Softmax":
        return softmax_along(c, x, axes)
    shifted = c.apply("sub", x, reduce_along(c, "Max", x, axes))
    return c.apply("sub", shifted, c.apply("log", reduce_along(c, "Sum", c.apply("exp", shifted), axes)))


def softmax_along(c: Context, x: Tensor, axes: Sequence[int]) -> Tensor:
    """Compute the exponentials of elements, divided by their sum along axes."""
    # the factor e^-max cancels out; without it, the exponentials could overflow
    grown = c.apply("exp", c.apply("sub", x, reduce_along(c, "Max", x, axes)))
    return c.apply("div", grown, reduce_along(c, "Sum", grown, axes))
