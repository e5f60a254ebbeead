"""Support vector machines: regression, decisions between pairs of classes, and probabilities of classes."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.importers.onnx.elementwise import sigmoid
from kennfeld.importers.onnx.layers import affine
from kennfeld.importers.onnx.network import ML, Operator
from kennfeld.importers.onnx.reductions import reduce_along
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.scores import labelled, labels_of, rows_of, transformed
from kennfeld.importers.onnx.shapes import join
from kennfeld.importers.onnx.tensors import NodeTensor, Tensor, UnsupportedOperatorError, rearrange, shape_of

_SWEEPS = 10  # at most; the iteration ended after 4 in trials with up to 20 classes
_TOLERANCE = 0.005  # of the iteration, divided by the number of classes
_SMALLEST = 1e-7  # probability of a class against another
MAX_CLASSES = 20

_Pair = tuple[int, int]


@operator("SVMRegressor", domain=ML)
def support_vector_regressor(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    """Compute the sum of kernels at the support vectors, or of the inputs if there are none."""
    rows = rows_of(c, arguments)
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
    # u'v, (gamma u'v + constant)^degree, e^(-gamma |u - v|^2) or tanh(gamma u'v + constant) of a row u and a vector v
    gamma, constant, degree = (*np.ravel(op.get("kernel_params", [])), 0.0, 0.0, 0.0)[:3]
    kind = op.get("kernel_type", "LINEAR")
    if kind == "RBF":
        shape = shape_of(rows)
        # [rows, 1, features] - [1, vectors, features]
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


@operator("SVMClassifier", domain=ML)
def support_vector_classifier(c: Context, op: Operator, arguments: Arguments) -> list[Tensor]:
    """Compute the label, and probabilities if the operator holds their coefficients, else decisions between classes.

    Decisions are those of each pair; of two classes, that for the second and that for the first.
    """
    labels, counts = labels_of(op), op.get("vectors_per_class", [])
    if not 2 <= len(labels) <= MAX_CLASSES or len(counts) != len(labels):
        raise UnsupportedOperatorError(f"it has {len(counts)} groups of support vectors for {len(labels)} classes")
    if op.get("post_transform", "NONE") != "NONE":
        raise UnsupportedOperatorError(f"post_transform {op.get('post_transform')} is not supported")
    pairs = list(combinations(range(len(labels)), 2))
    vectors = np.asarray(op.get("support_vectors")).reshape(sum(counts), -1)
    kernels = _kernels(c, op, rows_of(c, arguments), vectors)
    decisions = affine(c, kernels, _pair_weights(op, counts, pairs), np.asarray(op.get("rho"), dtype=np.float64))
    label = labelled(c, _votes(c, decisions, pairs, len(labels)), labels)[0]
    if len(op.get("prob_a", [])):
        return [label, _probabilities(c, op, decisions, pairs, len(labels))]
    return [label, join(c, [c.apply("neg", decisions), decisions], 1) if len(labels) == 2 else decisions]


def _pair_weights(op: Operator, counts: Sequence[int], pairs: Sequence[_Pair]) -> Float:
    """Return the weights of the kernels of all support vectors for each pair of classes, [vectors, pairs]."""
    # LIBSVM's [classes - 1, vectors]: a vector of class i has its weight against class j in row j - 1
    # if i < j, else in row j
    coefficients = np.asarray(op.get("coefficients")).reshape(len(counts) - 1, -1)
    ends = np.cumsum([0, *counts])
    weights = np.zeros((sum(counts), len(pairs)))
    for number, (i, j) in enumerate(pairs):
        weights[ends[i] : ends[i + 1], number] = coefficients[j - 1, ends[i] : ends[i + 1]]
        weights[ends[j] : ends[j + 1], number] = coefficients[i, ends[j] : ends[j + 1]]
    return weights


def _columns(tensor: Tensor) -> list[Tensor]:
    return [
        rearrange(lambda array, i=i: array[:, i : i + 1], tensor)  # type: ignore[misc]
        for i in range(shape_of(tensor)[1])
    ]


def _votes(c: Context, decisions: Tensor, pairs: Sequence[_Pair], classes: int) -> Tensor:
    """Return the number of pairs that each class wins, [rows, classes]."""
    wins = [c.truth("gt", decision, 0.0) for decision in _columns(decisions)]
    totals: list[Tensor] = [np.zeros((shape_of(decisions)[0], 1))] * classes
    for (i, j), win in zip(pairs, wins, strict=True):
        totals[i] = c.apply("add", totals[i], win)
        totals[j] = c.apply("add", totals[j], c.apply("sub", 1.0, win))
    return join(c, totals, 1)


def _probabilities(c: Context, op: Operator, decisions: Tensor, pairs: Sequence[_Pair], classes: int) -> Tensor:
    """Return the probabilities of classes, [rows, classes]."""
    slopes, offsets = (np.asarray(op.get(name), dtype=np.float64) for name in ("prob_a", "prob_b"))
    # 1 / (1 + e^(a d + b)) of a decision d: Platt, Probabilistic Outputs for Support Vector Machines (1999)
    exponents = c.apply("neg", c.apply("add", c.apply("mul", decisions, slopes), offsets))
    limited = c.apply("min", c.apply("max", sigmoid(c, exponents), _SMALLEST), 1 - _SMALLEST)
    against: dict[_Pair, Tensor] = {}
    for (i, j), probability in zip(pairs, _columns(limited), strict=True):
        against[i, j], against[j, i] = probability, c.apply("sub", 1.0, probability)
    return _coupled(c, against, classes)


def _coupled(c: Context, against: Mapping[_Pair, Tensor], classes: int) -> Tensor:
    """Couple the probabilities of each class against each other one.

    The method of Wu, Lin and Weng (JMLR 5 (2004) 975, algorithm 2), with the tolerance of LIBSVM, whose probabilities
    are those of an iteration that ends early.
    """
    rest = {i: [j for j in range(classes) if j != i] for i in range(classes)}
    # minimise p'Qp for sum(p) = 1, with Q_ii = sum_j r_ji^2 and Q_ij = -r_ji r_ij; at its end, all (Qp)_i equal p'Qp
    q = {(i, j): c.apply("neg", c.apply("mul", against[j, i], against[i, j])) for i in rest for j in rest[i]}
    for i in rest:
        q[i, i] = c.apply.fold("add", [c.apply("mul", against[j, i], against[j, i]) for j in rest[i]])
    p: list[Tensor] = [np.full(shape_of(q[0, 0]), 1 / classes)] * classes
    ended: Tensor = np.zeros(shape_of(q[0, 0]))
    for _ in range(_SWEEPS):
        products = [c.apply.fold("add", [c.apply("mul", q[i, j], p[j]) for j in range(classes)]) for i in rest]
        total = c.apply.fold("add", [c.apply("mul", p[i], products[i]) for i in rest])
        errors = [c.apply("abs", c.apply("sub", product, total)) for product in products]
        ended = c.truth("or", ended, c.truth("lt", c.apply.fold("max", errors), _TOLERANCE / classes))
        swept = _sweep(c, q, list(p), products, total)
        # every row of data may end at another pass: those that ended keep their probabilities
        p = [c.where(ended, before, after) for before, after in zip(p, swept, strict=True)]
    return join(c, p, 1)


def _sweep(
    c: Context, q: Mapping[_Pair, Tensor], p: list[Tensor], products: list[Tensor], total: Tensor
) -> Sequence[Tensor]:
    """Change one probability after the other, and scale all to the sum 1."""
    for i in range(len(p)):
        # p_i += d = (p'Qp - (Qp)_i) / Q_ii, then p /= 1 + d; Qp and p'Qp follow without new products
        change = c.apply("div", c.apply("sub", total, products[i]), q[i, i])
        grown = c.apply("add", change, 1.0)
        p[i] = c.apply("add", p[i], change)
        curvature = c.apply("add", c.apply("mul", change, q[i, i]), c.apply("mul", products[i], 2.0))
        total = c.apply("div", c.apply("add", total, c.apply("mul", change, curvature)), c.apply("mul", grown, grown))
        products = [
            c.apply("div", c.apply("add", product, c.apply("mul", change, q[i, j])), grown)
            for j, product in enumerate(products)
        ]
        p = [c.apply("div", each, grown) for each in p]
    return p
