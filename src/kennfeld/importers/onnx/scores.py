"""Scores of classifiers: their transformation to probabilities, the class with the largest, and its label."""

from collections.abc import Sequence

import numpy as np

from kennfeld.importers.onnx.elementwise import sigmoid
from kennfeld.importers.onnx.network import ML, Operator
from kennfeld.importers.onnx.reductions import softmax_along
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.selection import index_of_extreme
from kennfeld.importers.onnx.shapes import first, join
from kennfeld.importers.onnx.tensors import NodeTensor, Tensor, UnsupportedOperatorError, rearrange, shape_of


def rows_of(c: Context, arguments: Arguments) -> Tensor:
    """Take the first argument as rows of features, [rows, features]."""
    return NodeTensor(np.atleast_2d(c.nodes(first(arguments))))


def transformed(c: Context, scores: Tensor, kind: str) -> Tensor:
    """Apply the `post_transform` of an operator to scores, [rows, classes]."""
    match kind:
        case "NONE":
            return scores
        case "LOGISTIC":
            return sigmoid(c, scores)
        case "SOFTMAX":
            return softmax_along(c, scores, [len(shape_of(scores)) - 1])
        case _:
            raise UnsupportedOperatorError(f"post_transform {kind} is not supported")


def labels_of(op: Operator) -> list[int]:
    """Read the labels of the classes; texts are numbered from 0."""
    names = ("classlabels_int64s", "classlabels_ints", "classlabels_strings")
    labels = next((op.get(name) for name in names if op.get(name)), None)
    if labels is None:
        raise UnsupportedOperatorError("it does not name its classes")
    return [label if isinstance(label, int) else number for number, label in enumerate(labels)]


def labelled(c: Context, scores: Tensor, labels: Sequence[int]) -> list[Tensor]:
    """Compute the outputs of a classifier: labels, [rows], and scores, [rows, classes]."""
    # label = labels[index] as a chain of selections, because the index depends on the inputs
    index = rearrange(lambda array: array[:, 0], index_of_extreme(c, scores, 1))
    result: Tensor = np.full(shape_of(index), float(labels[0]))
    for place, label in enumerate(labels[1 : shape_of(scores)[1]], start=1):
        result = c.where(c.truth("eq", index, float(place)), float(label), result)
    return [NodeTensor(c.nodes(result), "int"), scores]


def mirrored(c: Context, scores: Tensor, *, complement: bool) -> Tensor:
    """Join the scores of two classes, [rows, 2], from that of the second, [rows, 1].

    The first is its complement to 1, or its negative.
    """
    first = c.apply("sub", 1.0, scores) if complement else c.apply("neg", scores)
    return join(c, [first, scores], 1)


@operator("ZipMap", domain=ML)
def zip_map(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Return the scores without the labels."""
    return first(arguments)
