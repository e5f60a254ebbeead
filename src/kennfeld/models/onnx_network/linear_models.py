"""Linear models and support vector machines."""

import numpy as np

from kennfeld.arrays import Float
from kennfeld.models.onnx_network.layers import affine
from kennfeld.models.onnx_network.network import ML, Operator
from kennfeld.models.onnx_network.reductions import reduce_along
from kennfeld.models.onnx_network.registry import Arguments, Context, operator
from kennfeld.models.onnx_network.scores import labelled, labels_of, mirrored, transformed
from kennfeld.models.onnx_network.shapes import first
from kennfeld.models.onnx_network.tensors import NodeTensor, Tensor, UnsupportedOperatorError, shape_of


@operator("LinearRegressor", domain=ML)
def linear_regressor(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    return transformed(c, _linear(c, op, _rows(c, arguments), op.get("targets", 1)), op.get("post_transform", "NONE"))


@operator("LinearClassifier", domain=ML)
def linear_classifier(c: Context, op: Operator, arguments: Arguments) -> list[Tensor]:
    labels = labels_of(op)
    count = len(np.ravel(op.get("intercepts", []))) or len(labels)
    scores, transform = _linear(c, op, _rows(c, arguments), count), op.get("post_transform", "NONE")
    if count == 1:
        scores, transform = mirrored(c, transformed(c, scores, transform), complement=transform == "LOGISTIC"), "NONE"
    return labelled(c, transformed(c, scores, transform), labels)


def _rows(c: Context, arguments: Arguments) -> Tensor:
    return NodeTensor(np.atleast_2d(c.nodes(first(arguments))))


def _linear(c: Context, op: Operator, rows: Tensor, targets: int) -> Tensor:
    matrix = np.asarray(op.get("coefficients")).reshape(targets, -1).T
    offsets = np.broadcast_to(np.asarray(op.get("intercepts", [0.0]), dtype=np.float64), targets)
    return affine(c, rows, matrix, offsets)


@operator("SVMRegressor", domain=ML)
def support_vector_regressor(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Compute the sum of kernels at the support vectors, or of the inputs if there are none."""
    rows = _rows(c, arguments)
    coefficients, offset = np.asarray(op.get("coefficients")), np.asarray(op.get("rho", [0.0]))[:1]
    if op.get("one_class", 0):
        raise UnsupportedOperatorError("one_class is not supported")
    features = rows
    count = op.get("n_supports", 0)
    if count:
        features = _kernels(c, op, rows, np.asarray(op.get("support_vectors")).reshape(count, -1))
    result = affine(c, features, coefficients[: shape_of(features)[1], None], offset)
    return transformed(c, result, op.get("post_transform", "NONE"))


def _kernels(c: Context, op: Operator, rows: Tensor, vectors: Float) -> Tensor:
    """Return the kernels of each row at each support vector, [rows, vectors]."""
    gamma, constant, degree = (*np.ravel(op.get("kernel_params", [])), 0.0, 0.0, 0.0)[:3]
    kind = op.get("kernel_type", "LINEAR")
    if kind == "RBF":
        shape = shape_of(rows)
        points = NodeTensor(c.nodes(rows).reshape(shape[0], 1, shape[1]))
        difference = c.apply("sub", points, vectors[None])
        squares = reduce_along(c, "SumSquare", difference, [2])
        flat = NodeTensor(c.nodes(squares).reshape(shape[0], len(vectors)))
        return c.apply("exp", c.apply("mul", flat, -float(gamma)))
    if kind == "LINEAR":
        return affine(c, rows, vectors.T, np.zeros(len(vectors)))
    if kind not in ("POLY", "SIGMOID"):
        raise UnsupportedOperatorError(f"kernel_type {kind} is not supported")
    offsets = np.full(len(vectors), float(constant))
    products = affine(c, rows, gamma * vectors.T, offsets, "tanh" if kind == "SIGMOID" else "identity")
    return products if kind == "SIGMOID" else c.apply("pow", products, float(degree))
