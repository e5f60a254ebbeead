"""Operators that move, repeat or select elements, and those that compute shapes."""

from collections.abc import Sequence

import numpy as np

from kennfeld.importers.onnx.network import Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.tensors import (
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
    """Read whole numbers that newer versions take as an argument and older ones as an attribute; None without."""
    if len(arguments) > place and arguments[place] is not None:
        return [int(number) for number in constant(arguments[place], name).ravel()]
    value = op.get(name)
    return [value] if isinstance(value, int) else value


@operator("Identity", "Dropout")
def identity(c: Context, op: Operator, arguments: Arguments) -> Tensor | Sequence[Tensor]:
    x = first(arguments)
    if len(arguments) > 2 and arguments[2] is not None and constant(arguments[2], "training_mode").any():
        raise UnsupportedOperatorError("it is in training mode; export the network for inference")
    # the second output of Dropout is its mask
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
        # 0 keeps the dimension of the input
        sizes = [shape_of(x)[i] if size == 0 else size for i, size in enumerate(sizes)]
    return rearrange(lambda array: array.reshape(sizes), x)


@operator("Flatten")
def flatten(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    sizes = shape_of(x)
    axis = op.get("axis", 1)
    rows = int(np.prod(sizes[: axis + len(sizes) if axis < 0 else axis]))
    # numpy cannot infer -1 from an array without elements
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
        # constants take the type of the tensors that they are joined to
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
    # backwards, -1 is before the first element, where a slice of Python would count from the end
    end = min(max(end, -1), size - 1)
    return slice(min(max(start, 0), size - 1), None if end < 0 else end, step)


@operator("Split")
def split(c: Context, op: Operator, arguments: Arguments) -> Sequence[Tensor]:
    x, axis, count = first(arguments), op.get("axis", 0), len(op.outputs)
    whole = shape_of(x)[axis]
    sizes = integers(op, arguments, 1, "split")
    if sizes is None:
        # equal parts, of which the last one may be shorter
        size = -(-whole // count)
        sizes = [min(size, whole - size * i) for i in range(count)]
    ends = np.cumsum(sizes)
    parts = [np.arange(end - size, end) for end, size in zip(ends, sizes, strict=True)]
    return [rearrange(lambda array, part=part: np.take(array, part, axis), x) for part in parts]  # type: ignore[misc]


@operator("Pad")
def pad(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Append elements at the ends of dimensions; negative numbers remove them."""
    x, mode = first(arguments), op.get("mode", "constant")
    sizes = integers(op, arguments, 1, "pads") or []
    value = arguments[2] if len(arguments) > 2 and arguments[2] is not None else np.asarray(op.get("value", 0.0))
    count = len(shape_of(x))
    axes = [axis % count for axis in integers(op, arguments, 3, "axes") or range(len(sizes) // 2)]
    if mode not in ("constant", "reflect", "edge", "wrap"):
        raise UnsupportedOperatorError(f"mode {mode} is not supported")
    ends = [(0, 0)] * count
    for place, axis in enumerate(axes):
        # the file lists all begins, then all ends
        ends[axis] = sizes[place], sizes[place + len(axes)]
    check_size([size + sum(each) for size, each in zip(shape_of(x), ends, strict=True)])
    # first what negative numbers remove, then what positive ones append
    kept = [slice(max(-begin, 0), size - max(-end, 0)) for size, (begin, end) in zip(shape_of(x), ends, strict=True)]
    added = [(max(begin, 0), max(end, 0)) for begin, end in ends]
    nodes = c.nodes(x)[tuple(kept)]
    if mode == "constant":
        return NodeTensor(np.pad(nodes, added, constant_values=int(c.nodes(value).ravel()[0])), kind_of(x))
    return NodeTensor(np.pad(nodes, added, mode=mode), kind_of(x))


@operator("Range")
def number_range(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    start, limit, delta = (constant(argument, "start, limit or delta").ravel()[0] for argument in arguments)
    check_size([max(int(np.ceil((float(limit) - float(start)) / float(delta))), 0)])
    return np.arange(start, limit, delta)


@operator("EyeLike")
def identity_matrix(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    rows, columns = shape_of(first(arguments))
    identity: Tensor = np.eye(rows, columns, k=op.get("k", 0))
    return identity


@operator("DepthToSpace", "SpaceToDepth")
def move_blocks(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Move channels into blocks of rows and columns, or back."""
    x, block = first(arguments), op.get("blocksize", 1)
    batch, channels, rows, columns = shape_of(x)
    by_channel = op.get("mode", "DCR") == "CRD"
    if op.kind == "SpaceToDepth":
        split = (batch, channels, rows // block, block, columns // block, block)
        joined = (batch, channels * block**2, rows // block, columns // block)
        # CRD numbers the new channels by (channel, row, column) of the block, DCR by (row, column, channel)
        order = (0, 1, 3, 5, 2, 4) if by_channel else (0, 3, 5, 1, 2, 4)
        return rearrange(lambda array: array.reshape(split).transpose(order).reshape(joined), x)
    inner = channels // block**2
    joined = (batch, inner, rows * block, columns * block)
    if by_channel:
        split, order = (batch, inner, block, block, rows, columns), (0, 1, 4, 2, 5, 3)
    else:
        split, order = (batch, block, block, inner, rows, columns), (0, 3, 4, 1, 5, 2)
    return rearrange(lambda array: array.reshape(split).transpose(order).reshape(joined), x)
