"""Linear models."""

import numpy as np

from kennfeld.importers.onnx.layers import affine
from kennfeld.importers.onnx.network import ML, Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.scores import labelled, labels_of, mirrored, rows_of, transformed
from kennfeld.importers.onnx.tensors import Tensor


@operator("LinearRegressor", domain=ML)
def linear_regressor(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    return transformed(c, _linear(c, op, rows_of(c, arguments), op.get("targets", 1)), op.get("post_transform", "NONE"))


@operator("LinearClassifier", domain=ML)
def linear_classifier(c: Context, op: Operator, arguments: Arguments) -> list[Tensor]:
    labels = labels_of(op)
    count = len(np.ravel(op.get("intercepts", []))) or len(labels)
    scores, transform = _linear(c, op, rows_of(c, arguments), count), op.get("post_transform", "NONE")
    # one row of coefficients for two classes: the score of the second one
    if count == 1:
        scores, transform = mirrored(c, transformed(c, scores, transform), complement=transform == "LOGISTIC"), "NONE"
    return labelled(c, transformed(c, scores, transform), labels)


def _linear(c: Context, op: Operator, rows: Tensor, targets: int) -> Tensor:
    # the file has a row per target, [targets, features]; the layer a column
    matrix = np.asarray(op.get("coefficients")).reshape(targets, -1).T
    offsets = np.broadcast_to(np.asarray(op.get("intercepts", [0.0]), dtype=np.float64), targets)
    return affine(c, rows, matrix, offsets)
