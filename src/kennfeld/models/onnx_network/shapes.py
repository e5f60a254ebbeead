"""Operators that move, repeat or select elements, and those that compute shapes."""

from collections.abc import Sequence

import numpy as np

from kennfeld.models.onnx_network.network import Array, Operator
from kennfeld.models.onnx_network.registry import Arguments, Context, operator
from kennfeld.models.onnx_network.tensors import (
    NodeTensor,
    Tensor,
    UnsupportedOperatorError,
    check_size,
    constant,
    kind_of,
    rearrange,
    shape_of,
)


def first(arguments: Arguments) -> Tensor:
    """Return the first argument, which must be given."""
    if not arguments or arguments[0] is None:
        raise UnsupportedOperatorError("its first argument is missing")
    return arguments[0]


def integers(op: Operator, arguments: Arguments, place: int, name: str) -> list[int] | None:
    """Return whole numbers that newer versions take as an argument and older ones as an attribute; None without."""
    if len(arguments) > place and arguments[place] is not None:
        return [int(number) for number in constant(arguments[place], name).ravel()]
    value = op.get(name)
    return [value] if isinstance(value, int) else value


@operator("Identity", "Dropout")
def identity(c: Context, op: Operator, arguments: Arguments) -> Tensor | Sequence[Tensor]:
    x = first(arguments)
    if len(arguments) > 2 and arguments[2] is not None and constant(arguments[2], "training_mode").any():
        raise UnsupportedOperatorError("it is in training mode; export the network for inference")
    return [x, np.ones(shape_of(x), dtype=bool)][: len(op.outputs)]


@operator("Constant")
def constant_value(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    names = ("value", "value_float", "value_int", "value_floats", "value_ints")
    value = next((op.get(name) for name in names if op.get(name) is not None), None)
    if value is None:
        raise UnsupportedOperatorError("it holds neither a tensor nor numbers")
    return np.asarray(value)


@operator("ConstantOfShape")
def constant_of_shape(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    shape = [int(size) for size in constant(first(arguments), "input").ravel()]
    check_size(shape)
    value = op.get("value", np.zeros(1))
    return np.full(shape, value.ravel()[0])


@operator("Shape")
def shape(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    sizes = shape_of(first(arguments))
    return np.array(sizes[op.get("start", 0) : op.get("end", len(sizes))], dtype=np.int64)


@operator("Size")
def size(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    return np.array(np.prod(shape_of(first(arguments)), dtype=np.int64))


@operator("Reshape")
def reshape(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, sizes = first(arguments), integers(op, arguments, 1, "shape") or []
    if not op.get("allowzero", 0):
        sizes = [shape_of(x)[i] if size == 0 else size for i, size in enumerate(sizes)]
    return rearrange(lambda array: array.reshape(sizes), x)


@operator("Flatten")
def flatten(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    sizes = shape_of(x)
    axis = op.get("axis", 1)
    rows = int(np.prod(sizes[: axis + len(sizes) if axis < 0 else axis]))
    return rearrange(lambda array: array.reshape(rows, -1 if array.size else 0), x)


@operator("Squeeze")
def squeeze(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    axes = integers(op, arguments, 1, "axes")
    return rearrange(lambda array: np.squeeze(array, None if axes is None else tuple(axes)), first(arguments))


@operator("Unsqueeze")
def unsqueeze(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    axes = integers(op, arguments, 1, "axes") or []
    return rearrange(lambda array: np.expand_dims(array, tuple(axes)), first(arguments))


@operator("Transpose")
def transpose(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    return rearrange(lambda array: array.transpose(op.get("perm")), first(arguments))


@operator("Expand")
def expand(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    sizes = np.broadcast_shapes(shape_of(x), tuple(integers(op, arguments, 1, "shape") or ()))
    check_size(sizes)
    return rearrange(lambda array: np.broadcast_to(array, sizes), x)


@operator("Tile")
def tile(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, repeats = first(arguments), integers(op, arguments, 1, "repeats") or []
    check_size([size * repeat for size, repeat in zip(shape_of(x), repeats, strict=True)])
    return rearrange(lambda array: np.tile(array, repeats), x)


@operator("Concat")
def concat(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    return join(c, [argument for argument in arguments if argument is not None], op.get("axis", 1))


def join(c: Context, tensors: Sequence[Tensor], axis: int) -> Tensor:
    """Join tensors along an axis."""
    check_size([sum(int(np.prod(shape_of(tensor))) for tensor in tensors)])
    if any(isinstance(tensor, NodeTensor) for tensor in tensors):
        kinds = {kind_of(tensor) for tensor in tensors if isinstance(tensor, NodeTensor)}
        nodes = np.concatenate([c.nodes(tensor) for tensor in tensors], axis)
        return NodeTensor(nodes, kinds.pop() if len(kinds) == 1 else "float")
    constants = [tensor for tensor in tensors if not isinstance(tensor, NodeTensor)]
    return np.concatenate(constants, axis)


@operator("FeatureVectorizer", domain="ai.onnx.ml")
def feature_vectorizer(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    tensors = [argument for argument in arguments if argument is not None]
    rows = [rearrange(lambda array: array.reshape(array.shape[0] if array.ndim else 1, -1), x) for x in tensors]
    return join(c, rows, 1)


@operator("Slice")
def slice_(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    starts, ends = (integers(op, arguments, place, name) or [] for place, name in ((1, "starts"), (2, "ends")))
    axes = integers(op, arguments, 3, "axes") or list(range(len(starts)))
    steps = integers(op, arguments, 4, "steps") or [1] * len(starts)
    parts = [slice(None)] * len(shape_of(x))
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        parts[axis] = _part(start, end, step, shape_of(x)[axis])
    return rearrange(lambda array: array[tuple(parts)], x)


def _part(start: int, end: int, step: int, size: int) -> slice:
    if step == 0:
        raise UnsupportedOperatorError("a step is 0")
    start, end = (at + size if at < 0 else at for at in (start, end))
    if step > 0:
        return slice(min(max(start, 0), size), min(max(end, 0), size), step)
    end = min(max(end, -1), size - 1)
    return slice(min(max(start, 0), size - 1), None if end < 0 else end, step)


@operator("Split")
def split(c: Context, op: Operator, arguments: Arguments) -> Sequence[Tensor]:
    x, axis, count = first(arguments), op.get("axis", 0), len(op.outputs)
    whole = shape_of(x)[axis]
    sizes = integers(op, arguments, 1, "split")
    if sizes is None:
        size = -(-whole // count)
        sizes = [min(size, whole - size * i) for i in range(count)]
    ends = np.cumsum(sizes)
    parts = [np.arange(end - size, end) for end, size in zip(ends, sizes, strict=True)]
    return [rearrange(lambda array, part=part: np.take(array, part, axis), x) for part in parts]  # type: ignore[misc]


@operator("Gather")
def gather(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    indices = constant(arguments[1], "indices").astype(np.int64)
    check_size([*shape_of(first(arguments)), indices.size])
    return rearrange(lambda array: np.take(array, indices, op.get("axis", 0)), first(arguments))


@operator("ArrayFeatureExtractor", domain="ai.onnx.ml")
def extract_features(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    indices = constant(arguments[1], "Y").astype(np.int64).ravel()
    check_size([*shape_of(first(arguments)), indices.size])

    def take(array: Array) -> Array:
        chosen = np.take(array, indices, -1)
        return chosen.reshape(1, -1) if array.ndim == 1 else chosen

    return rearrange(take, first(arguments))
