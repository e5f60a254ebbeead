"""Matrix products: dense layers with bias and activation if the matrix is constant, else written out."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.importers.onnx.elementwise import sigmoid
from kennfeld.importers.onnx.network import Array, Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.shapes import first
from kennfeld.importers.onnx.tensors import (
    NodeTensor,
    Tensor,
    UnsupportedOperatorError,
    check_size,
    kind_of,
    rearrange,
    shape_of,
)
from kennfeld.models.imperative.node_arrays import Nodes, matrix_product

_FUSED = {"Relu": "relu", "LeakyRelu": "leaky_relu", "Elu": "elu", "Tanh": "tanh", "Sigmoid": "sigmoid"}
_ALPHA = {"LeakyRelu": 0.01, "Elu": 1.0}
_WRITTEN: Mapping[str, Callable[[Context, Tensor], Tensor]] = {
    "identity": lambda c, x: x,
    "tanh": lambda c, x: c.apply("tanh", x),
    "sigmoid": sigmoid,
}


class _Affine(NamedTuple):
    """The product of rows of nodes with a constant matrix; `shape` is that of the result."""

    rows: Nodes  # [rows, inputs]
    matrix: Float  # [inputs, outputs]
    shape: tuple[int, ...]


@operator("MatMul")
def matmul(c: Context, op: Operator, arguments: Arguments) -> Tensor | None:
    a, b = first(arguments), arguments[1]
    assert b is not None
    if not isinstance(a, NodeTensor) and not isinstance(b, NodeTensor):
        check_size([*a.shape[:-1], *b.shape])
        return np.asarray(np.matmul(a.astype(np.float64), b.astype(np.float64)))
    # a batch of constant matrices goes to `_product`, which writes a layer for each
    # a layer would compute in numbers with digits, and absorb the rounding that follows a product of integers
    is_float = "float" in (kind_of(a), kind_of(b))
    if isinstance(a, NodeTensor) and not isinstance(b, NodeTensor) and b.ndim <= 2 and is_float:
        matrix = b.astype(np.float64).reshape(b.shape[0], -1)
        shape = (*a.nodes.shape[:-1], *b.shape[1:])
        return _fuse(c, op, _Affine(a.nodes.reshape(-1, b.shape[0]), matrix, shape), np.zeros(matrix.shape[1]))
    return _product(c, a, b)


def product_of_integers(c: Context, a: Tensor, b: Tensor) -> Tensor:
    """Return the matrix product of two tensors of integers; no layer takes it, as its weights are no parameters."""
    if isinstance(a, NodeTensor) or isinstance(b, NodeTensor):
        return NodeTensor(c.nodes(_product(c, a, b)), "int")
    check_size([*a.shape[:-1], *b.shape])
    return np.asarray(np.matmul(a.astype(np.int64), b.astype(np.int64)))


def _product(c: Context, a: Tensor, b: Tensor) -> Tensor:
    """Return the product of two tensors, of which one is not constant, as `numpy.matmul` does."""
    left, right = shape_of(a), shape_of(b)
    if not left or not right:
        raise UnsupportedOperatorError("it multiplies a matrix by a number")
    # a vector is a row on the left and a column on the right, and its own dimension is dropped from the result
    rows = rearrange(np.atleast_2d, a)
    columns = rearrange(lambda array: array[:, None], b) if len(right) == 1 else b
    batch = np.broadcast_shapes(shape_of(rows)[:-2], shape_of(columns)[:-2])
    check_size([*batch, *shape_of(rows)[-2:], shape_of(columns)[-1]])
    rows, columns = (
        rearrange(lambda array: np.broadcast_to(array, batch + array.shape[-2:]), each) for each in (rows, columns)
    )
    sizes = shape_of(rows)[-2], shape_of(columns)[-1]
    result = np.zeros((*batch, *sizes), dtype=np.int64)
    for place in np.ndindex(*batch):
        pair = (rearrange(lambda array: array[place], each) for each in (rows, columns))  # noqa: B023
        result[place] = matrix_rows(c, *pair)
    shape = batch + sizes[: len(left) > 1] + (sizes[1:] if len(right) > 1 else ())
    return NodeTensor(result.reshape(shape))


def matrix_rows(c: Context, a: Tensor, b: Tensor) -> Nodes:
    """Multiply two matrices, [rows, inner] and [inner, columns]; a constant one is the weights of a layer."""
    (rows, inner), (height, columns) = shape_of(a), shape_of(b)
    if inner != height:
        raise UnsupportedOperatorError(f"it multiplies {rows}x{inner} by {height}x{columns}")
    if isinstance(a, NodeTensor) and isinstance(b, NodeTensor):
        return matrix_product(c.builder, a.nodes, b.nodes)
    if isinstance(b, NodeTensor):
        # A B = (B' A')': a layer multiplies rows of nodes by constant columns
        return matrix_rows(c, NodeTensor(b.nodes.T), np.asarray(a).T).T
    return c.nodes(_layer(c, _Affine(c.nodes(a), b.astype(np.float64), (rows, columns)), np.zeros(columns)))


def affine(c: Context, rows: Tensor, matrix: Tensor, offsets: Tensor, activation: str = "identity") -> Tensor:
    """Compute `activation(rows @ matrix + offsets)`, [rows, outputs], as a layer if the matrix is constant.

    Args:
        c: context.
        rows: [rows, inputs].
        matrix: [inputs, outputs].
        offsets: [outputs].
        activation: "identity", "tanh" or "sigmoid".
    """
    if isinstance(matrix, NodeTensor) or isinstance(offsets, NodeTensor):
        total = c.apply("add", NodeTensor(matrix_rows(c, rows, matrix)), offsets)
        return _WRITTEN[activation](c, total)
    weights, shape = matrix.astype(np.float64), (shape_of(rows)[0], matrix.shape[1])
    return _layer(c, _Affine(c.nodes(rows), weights, shape), offsets.astype(np.float64), activation)


@operator("Gemm")
def gemm(c: Context, op: Operator, arguments: Arguments) -> Tensor | None:
    a, b, bias = (*arguments, None)[:3]
    assert a is not None
    assert b is not None
    a, b = (_transposed(x) if op.get(key, 0) else x for x, key in ((a, "transA"), (b, "transB")))
    alpha, beta = op.get("alpha", 1.0), op.get("beta", 1.0)
    is_float = "float" in (kind_of(a), kind_of(b))
    if isinstance(a, NodeTensor) and not isinstance(b, NodeTensor) and not isinstance(bias, NodeTensor) and is_float:
        offsets = np.zeros(b.shape[1]) if bias is None else beta * bias.astype(np.float64)
        affine = _Affine(a.nodes, alpha * b.astype(np.float64), (a.nodes.shape[0], b.shape[1]))
        # a bias of one row belongs to the layer; any other shape is added afterwards
        if offsets.size in (1, b.shape[1]) and (offsets.ndim < 2 or offsets.shape[0] == 1):
            return _fuse(c, op, affine, np.broadcast_to(offsets.ravel(), b.shape[1]))
        return c.apply("add", _layer(c, affine, np.zeros(b.shape[1])), offsets)
    if not isinstance(a, NodeTensor) and not isinstance(b, NodeTensor):
        check_size([*a.shape[:-1], *b.shape])
        product: Tensor = alpha * (a.astype(np.float64) @ b.astype(np.float64))
    else:
        product = c.apply("mul", _product(c, a, b), alpha)
    return product if bias is None else c.apply("add", product, c.apply("mul", bias, beta))


def _transposed(x: Tensor) -> Tensor:
    return NodeTensor(x.nodes.T, x.kind) if isinstance(x, NodeTensor) else x.T


def _fuse(c: Context, op: Operator, affine: _Affine, offsets: Float) -> Tensor | None:
    """Set the result of a layer, with the addition of a constant and the activation that follow it."""
    output = op.outputs[0]
    # a product that others use as well must remain a tensor of its own
    adding = c.sole_consumer(output)
    bias = None if adding is None or op.kind != "MatMul" else _added(c, adding, output, affine.matrix.shape[1])
    if adding is not None and bias is not None:
        offsets, output = bias, adding.outputs[0]
        c.absorbed.add(output)
    following = c.sole_consumer(output)
    name, alpha = "identity", 0.0
    if following is not None and not following.domain and following.kind in _FUSED:
        name, alpha = _FUSED[following.kind], following.get("alpha", _ALPHA.get(following.kind, 0.0))
        output = following.outputs[0]
        c.absorbed.add(output)
    c.tensors[output] = _layer(c, affine, offsets, name, alpha)
    return None


def _added(c: Context, adding: Operator, output: str, count: int) -> Float | None:
    """Return the constant that an operator adds to each row of a product, if that is what it does."""
    if adding.kind != "Add" or adding.domain or adding.version < 7:
        return None
    # x + x adds the product to itself, which is not a constant
    (other,) = [name for name in adding.inputs if name != output] or [output]
    bias = c.tensors.get(other)
    if bias is None or isinstance(bias, NodeTensor) or bias.ndim > 1 or bias.size != count:
        return None
    numbers: Array = bias.astype(np.float64).ravel()
    return numbers


def _layer(c: Context, product: _Affine, offsets: Float, name: str = "identity", alpha: float = 0.0) -> Tensor:
    rows, matrix, shape = product
    if rows.ndim != 2 or rows.shape[1] != matrix.shape[0]:
        raise UnsupportedOperatorError(f"the rows of its input do not fit its {matrix.shape[0]} rows of weights")
    # [inputs + 1, outputs], as `Context.dense` takes them
    weights = np.vstack([matrix, offsets])
    if not matrix.size or not np.isfinite(weights).all():
        raise UnsupportedOperatorError("its weights are empty or not finite")
    return NodeTensor(c.dense(rows, weights, name, alpha).reshape(shape))
