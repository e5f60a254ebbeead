"""Matrix products: dense layers with bias and activation if the matrix is constant, else written out."""

from typing import NamedTuple

import numpy as np

from kennfeld.arrays import Float
from kennfeld.models.imperative.node_arrays import Nodes, matrix_product
from kennfeld.models.onnx_network.network import ML, Array, Operator
from kennfeld.models.onnx_network.registry import Arguments, Context, operator
from kennfeld.models.onnx_network.shapes import first
from kennfeld.models.onnx_network.tensors import NodeTensor, Tensor, UnsupportedOperatorError, check_size, shape_of

_FUSED = {"Relu": "relu", "LeakyRelu": "leaky_relu", "Elu": "elu", "Tanh": "tanh", "Sigmoid": "sigmoid"}
_ALPHA = {"LeakyRelu": 0.01, "Elu": 1.0}


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
    if isinstance(a, NodeTensor) and not isinstance(b, NodeTensor) and b.ndim <= 2:
        matrix = b.astype(np.float64).reshape(b.shape[0], -1)
        shape = (*a.nodes.shape[:-1], *b.shape[1:])
        return _fuse(c, op, _Affine(a.nodes.reshape(-1, b.shape[0]), matrix, shape), np.zeros(matrix.shape[1]))
    return _product(c, a, b)


def _product(c: Context, a: Tensor, b: Tensor) -> Tensor:
    """Return the product of two tensors of at most two dimensions."""
    if len(shape_of(a)) > 2 or len(shape_of(b)) > 2:
        raise UnsupportedOperatorError(
            "products of tensors with more than two dimensions need a constant matrix on the right"
        )
    left, right = c.nodes(a), c.nodes(b)
    shape = (*left.shape[:-1], *right.shape[1:])
    left, right = np.atleast_2d(left), right.reshape(right.shape[0], -1)
    if left.shape[1] != right.shape[0]:
        raise UnsupportedOperatorError(
            f"it multiplies {left.shape[0]}x{left.shape[1]} by {right.shape[0]}x{right.shape[1]}"
        )
    if isinstance(b, NodeTensor) and not isinstance(a, NodeTensor):
        weights = np.vstack([np.atleast_2d(a.astype(np.float64)).T, np.zeros(left.shape[0])])
        return NodeTensor(c.dense(right.T, weights).T.reshape(shape))
    check_size([4, *left.shape, right.shape[1]])
    return NodeTensor(matrix_product(c.builder, left, right).reshape(shape))


@operator("Gemm")
def gemm(c: Context, op: Operator, arguments: Arguments) -> Tensor | None:
    a, b, bias = (*arguments, None)[:3]
    assert a is not None
    assert b is not None
    a, b = (_transposed(x) if op.get(key, 0) else x for x, key in ((a, "transA"), (b, "transB")))
    alpha, beta = op.get("alpha", 1.0), op.get("beta", 1.0)
    if isinstance(a, NodeTensor) and not isinstance(b, NodeTensor) and not isinstance(bias, NodeTensor):
        offsets = np.zeros(b.shape[1]) if bias is None else beta * bias.astype(np.float64)
        affine = _Affine(a.nodes, alpha * b.astype(np.float64), (a.nodes.shape[0], b.shape[1]))
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


@operator("LinearRegressor", domain=ML)
def linear_regressor(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, targets = first(arguments), op.get("targets", 1)
    if op.get("post_transform", "NONE") != "NONE":
        raise UnsupportedOperatorError(f"post_transform {op.get('post_transform')} is not supported")
    matrix = np.asarray(op.get("coefficients")).reshape(targets, -1).T
    offsets = np.broadcast_to(np.asarray(op.get("intercepts", [0.0])), targets)
    rows = np.atleast_2d(c.nodes(x))
    return _layer(c, _Affine(rows, matrix, (len(rows), targets)), offsets)


def _fuse(c: Context, op: Operator, affine: _Affine, offsets: Float) -> Tensor | None:
    """Set the result of a layer, with the addition of a constant and the activation that follow it."""
    output = op.outputs[0]
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
    (other,) = [name for name in adding.inputs if name != output] or [output]
    bias = c.tensors.get(other)
    if bias is None or isinstance(bias, NodeTensor) or bias.ndim > 1 or bias.size != count:
        return None
    numbers: Array = bias.astype(np.float64).ravel()
    return numbers


def _layer(c: Context, affine: _Affine, offsets: Float, name: str = "identity", alpha: float = 0.0) -> Tensor:
    rows, matrix, shape = affine
    if rows.ndim != 2 or rows.shape[1] != matrix.shape[0]:
        raise UnsupportedOperatorError(f"the rows of its input do not fit its {matrix.shape[0]} rows of weights")
    weights = np.vstack([matrix, offsets])
    if not matrix.size or not np.isfinite(weights).all():
        raise UnsupportedOperatorError("its weights are empty or not finite")
    return NodeTensor(c.dense(rows, weights, name, alpha).reshape(shape))
