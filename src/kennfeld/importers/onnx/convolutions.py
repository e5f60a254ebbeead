"""Operators on windows of a signal or image: convolution and pooling."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kennfeld.importers.onnx.layers import affine
from kennfeld.importers.onnx.network import Array, Operator
from kennfeld.importers.onnx.reductions import reduce_along
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.shapes import first, join
from kennfeld.importers.onnx.tensors import (
    NodeTensor,
    Tensor,
    UnsupportedOperatorError,
    check_size,
    rearrange,
    shape_of,
)
from kennfeld.models.imperative.node_arrays import Nodes


class _Windows(NamedTuple):
    """Size, distance and spacing of windows, and what is appended at begin and end of each dimension."""

    kernel: Sequence[int]
    strides: Sequence[int]
    dilations: Sequence[int]
    begins: Sequence[int]
    ends: Sequence[int]

    def places(self, sizes: Sequence[int]) -> Array:
        """Find the elements of the padded signal that each window has; [dimensions, windows..., elements...]."""
        starts = [
            # a window covers dilation * (kernel - 1) + 1 elements, all of which the padded signal must have
            np.arange(0, size + begin + end - dilation * (kernel - 1), stride)
            for size, kernel, stride, dilation, begin, end in zip(sizes, *self, strict=True)
        ]
        offsets = [dilation * np.arange(kernel) for kernel, dilation in zip(self.kernel, self.dilations, strict=True)]
        corners = np.array(np.meshgrid(*starts, indexing="ij"))
        inner = np.array(np.meshgrid(*offsets, indexing="ij")).reshape(len(sizes), -1)
        check_size([*corners.shape[1:], inner.shape[1]])
        # element = corner of the window + offset within it, for each dimension
        return np.asarray(corners[..., None] + inner.reshape(len(sizes), *[1] * (corners.ndim - 1), -1))

    def of(self, array: Array, fill: float) -> Array:
        """Cut an array [batch, channels, sizes...] into windows: [batch, channels, windows..., elements]."""
        places = self.places(array.shape[2:])
        edges = [(0, 0), (0, 0), *zip(self.begins, self.ends, strict=True)]
        padded = np.pad(array, edges, constant_values=fill)
        return np.asarray(padded[(slice(None), slice(None), *places)])


def _windows(op: Operator, sizes: Sequence[int], kernel: Sequence[int]) -> _Windows:
    count = len(sizes)
    strides, dilations = (list(op.get(name) or [1] * count) for name in ("strides", "dilations"))
    pads = list(op.get("pads") or [0] * 2 * count)
    if min([*strides, *dilations, *kernel], default=1) < 1:
        raise UnsupportedOperatorError("its windows have invalid sizes")
    extents = [dilation * (size - 1) + 1 for dilation, size in zip(dilations, kernel, strict=True)]
    mode = op.get("auto_pad", "NOTSET")
    if mode in ("SAME_UPPER", "SAME_LOWER"):
        # ceil(size / stride) windows; the last one begins at (ceil(size / stride) - 1) * stride
        missing = [
            max((-(-size // stride) - 1) * stride + extent - size, 0)
            for size, stride, extent in zip(sizes, strides, extents, strict=True)
        ]
        smaller, larger = [each // 2 for each in missing], [each - each // 2 for each in missing]
        # an odd element is appended at the end (UPPER) or at the begin (LOWER)
        pads = [*smaller, *larger] if mode == "SAME_UPPER" else [*larger, *smaller]
    elif mode == "VALID":
        pads = [0] * 2 * count
    begins, ends = pads[:count], pads[count:]
    if op.get("ceil_mode", 0):
        ends = [
            end + _rest(size + begin + end, begin + size, extent, stride)
            for size, begin, end, extent, stride in zip(sizes, begins, ends, extents, strides, strict=True)
        ]
    if min(pads, default=0) < 0:
        raise UnsupportedOperatorError("its windows have invalid sizes")
    return _Windows(kernel, strides, dilations, begins, ends)


def _rest(whole: int, limit: int, extent: int, stride: int) -> int:
    """Return how many elements the last window lacks if it begins within the signal."""
    rest = (extent - whole) % stride
    # a window that would begin in the padding at the end does not count
    start = whole + rest - extent
    return rest if start < limit else 0


@operator("Conv")
def convolution(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, kernel, bias = (*arguments, None)[:3]
    assert x is not None
    assert kernel is not None
    groups, (outputs, depth, *sizes) = op.get("group", 1), shape_of(kernel)
    batch, channels = shape_of(x)[:2]
    if groups < 1 or outputs % groups or channels != groups * depth:
        raise UnsupportedOperatorError(f"its kernel does not fit {channels} channels in {groups} groups")
    windows = _windows(op, shape_of(x)[2:], sizes)
    patches = windows.of(c.nodes(x), c.builder.const(0.0))
    places = patches.shape[2:-1]
    each = outputs // groups
    results = []
    # as a matrix product (im2col): a row per window of [depth * elements], a column per filter
    for group in range(groups):
        own = patches[:, group * depth : (group + 1) * depth]
        rows = np.moveaxis(own, 1, -2).reshape(-1, depth * patches.shape[-1])
        filters = slice(group * each, (group + 1) * each)
        matrix = rearrange(lambda array, f=filters: array[f].reshape(each, -1).T, kernel)  # type: ignore[misc]
        offsets = np.zeros(each) if bias is None else rearrange(lambda array, f=filters: array[f], bias)  # type: ignore[misc]
        layer = c.nodes(affine(c, NodeTensor(rows), matrix, offsets))
        results.append(NodeTensor(np.moveaxis(layer.reshape(batch, *places, each), -1, 1)))
    return join(c, results, 1)


@operator("MaxPool", "AveragePool")
def pooling(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    if len([name for name in op.outputs if name]) > 1:
        raise UnsupportedOperatorError("only its first output is supported")
    windows = _windows(op, shape_of(x)[2:], op.get("kernel_shape"))
    nodes = c.nodes(x)
    if op.kind == "MaxPool":
        # -inf is below every element, so that padding is never the maximum
        return _squeezed(reduce_along(c, "Max", _filled(c, windows, nodes, -np.inf), [nodes.ndim]))
    total = _squeezed(reduce_along(c, "Sum", _filled(c, windows, nodes, 0.0), [nodes.ndim]))
    return c.apply("div", total, _counts(op, windows, nodes.shape))


def _filled(c: Context, windows: _Windows, nodes: Nodes, fill: float) -> Tensor:
    return NodeTensor(windows.of(nodes, c.builder.const(fill)))


def _squeezed(tensor: Tensor) -> Tensor:
    return rearrange(lambda array: array[..., 0], tensor)


def _counts(op: Operator, windows: _Windows, shape: Sequence[int]) -> Array:
    """Return by how many elements the sum of each window is divided, [1, 1, windows...]."""
    ones = np.ones((1, 1, *shape[2:]))
    if not op.get("count_include_pad", 0):
        return np.asarray(windows.of(ones, 0.0).sum(axis=-1))
    pads = list(op.get("pads") or [0] * 2 * len(windows.kernel))
    if op.get("auto_pad", "NOTSET") != "NOTSET":
        pads = [*windows.begins, *windows.ends]
    half = len(windows.kernel)
    # padding that the file states counts; what `ceil_mode` appended beyond it does not
    stated = np.pad(ones, [(0, 0), (0, 0), *zip(pads[:half], pads[half:], strict=True)], constant_values=1.0)
    beyond = [end - pad for end, pad in zip(windows.ends, pads[half:], strict=True)]
    rest = windows._replace(begins=[0] * half, ends=beyond)
    return np.asarray(rest.of(stated, 0.0).sum(axis=-1))


@operator("GlobalMaxPool", "GlobalAveragePool")
def global_pooling(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x = first(arguments)
    kind = "Max" if op.kind == "GlobalMaxPool" else "Mean"
    return reduce_along(c, kind, x, range(2, len(shape_of(x))))
