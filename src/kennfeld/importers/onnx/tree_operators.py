"""The operators of tree ensembles: their lists of nodes and leaves."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from kennfeld.importers.onnx.network import ML, Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.scores import labelled, labels_of, mirrored, transformed
from kennfeld.importers.onnx.shapes import first
from kennfeld.importers.onnx.tensors import Tensor, UnsupportedOperatorError
from kennfeld.importers.onnx.trees import (
    AGGREGATES,
    COMPARISONS,
    MAX_TARGETS,
    MEMBER,
    Key,
    TreeNode,
    Trees,
    Weights,
    roots_of,
    write_trees,
)

_COLUMNS = ("treeids", "nodeids", "featureids", "modes", "values", "truenodeids", "falsenodeids")
_MODES = (*COMPARISONS, MEMBER)  # by number
_TRANSFORMS = ("NONE", "SOFTMAX", "LOGISTIC", "SOFTMAX_ZERO", "PROBIT")


@operator("TreeEnsembleRegressor", domain=ML)
def tree_regressor(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    count = op.get("n_targets", 1)
    trees = _trees(op, "target", count)
    aggregate = op.get("aggregate_function", "SUM")
    scores = write_trees(c, trees, _rows(c, arguments), _known(aggregate), _bases(op, count))
    return transformed(c, scores, op.get("post_transform", "NONE"))


@operator("TreeEnsembleClassifier", domain=ML)
def tree_classifier(c: Context, op: Operator, arguments: Arguments) -> list[Tensor]:
    """Compute scores; with weights of one class only, the score of the other of two follows from it."""
    labels, transform = labels_of(op), op.get("post_transform", "NONE")
    trees = _trees(op, "class", len(labels))
    weights = [weight for leaf in trees.leaves.values() for weight in leaf.values()]
    classes = {target for leaf in trees.leaves.values() for target in leaf}
    if len(labels) != 2 or len(classes) != 1:
        scores = write_trees(c, trees, _rows(c, arguments), "SUM", _bases(op, len(labels)))
        return labelled(c, transformed(c, scores, transform), labels)
    (single,) = classes
    leaves = {key: {0: leaf.get(single, 0.0)} for key, leaf in trees.leaves.items()}
    bases = _bases(op, len(np.ravel(_column(op, "base_values"))) or 1)[-1:]
    score = write_trees(c, trees._replace(leaves=leaves), _rows(c, arguments), "SUM", bases)
    # weights that are not negative are probabilities, others margins of which the sign decides
    complement = transform == "LOGISTIC" or min(weights) >= 0
    return labelled(c, mirrored(c, transformed(c, score, transform), complement=complement), labels)


@operator("TreeEnsemble", domain=ML)
def tree_ensemble(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    count = op.get("n_targets", 1)
    aggregate, transform = AGGREGATES[op.get("aggregate_function", 1)], _TRANSFORMS[op.get("post_transform", 0)]
    scores = write_trees(c, _numbered_trees(op, count), _rows(c, arguments), aggregate, [0.0] * count)
    return transformed(c, scores, transform)


def _rows(c: Context, arguments: Arguments) -> Sequence[Sequence[int]]:
    rows: Sequence[Sequence[int]] = np.atleast_2d(c.nodes(first(arguments))).tolist()
    return rows


def _known(aggregate: str) -> str:
    if aggregate not in AGGREGATES:
        raise UnsupportedOperatorError(f"aggregate_function {aggregate} is not supported")
    return aggregate


def _column(op: Operator, name: str) -> Sequence[Any]:
    """Return a list, which may be in double precision as a tensor."""
    column = op.get(name)
    column = op.get(f"{name}_as_tensor", []) if column is None or not len(column) else column
    return column if isinstance(column, list) else np.ravel(column).tolist()


def _bases(op: Operator, count: int) -> Sequence[float]:
    bases = _column(op, "base_values")
    if len(bases) not in (0, 1, count) or not 1 <= count <= MAX_TARGETS:
        raise UnsupportedOperatorError(f"it has {len(bases)} base_values for {count} targets")
    return [float(base) for base in np.broadcast_to(bases or [0.0], count)]


def _trees(op: Operator, prefix: str, count: int) -> Trees:
    columns = [_column(op, f"nodes_{name}") for name in _COLUMNS]
    size = len(columns[0])
    missing = _column(op, "nodes_missing_value_tracks_true") or [0] * size
    if any(len(column) != size for column in (*columns, missing)):
        raise UnsupportedOperatorError("its lists of nodes have different lengths")
    nodes: dict[Key, TreeNode] = {}
    leaves: dict[Key, Weights] = {}
    for (tree, node, feature, mode, value, yes, no), track in zip(zip(*columns, strict=True), missing, strict=True):
        # its weights are in the lists of targets
        if mode == "LEAF":
            leaves[tree, node] = {}
        elif mode in COMPARISONS:
            nodes[tree, node] = TreeNode(feature, mode, float(value), ((tree, yes), (tree, no)), bool(track))
        else:
            raise UnsupportedOperatorError(f"mode {mode} is not supported")
    leaves |= _weights(op, prefix, count, leaves)
    return Trees(roots_of(nodes, leaves), nodes, leaves)


def _weights(op: Operator, prefix: str, count: int, leaves: Mapping[Key, Weights]) -> Mapping[Key, Weights]:
    """Return the weights of each leaf by target; those of inner nodes have no effect."""
    columns = [_column(op, f"{prefix}_{name}") for name in ("treeids", "nodeids", "ids", "weights")]
    if len({len(column) for column in columns}) > 1:
        raise UnsupportedOperatorError("its lists of targets have different lengths")
    result: dict[Key, dict[int, float]] = {}
    for tree, node, target, weight in zip(*columns, strict=True):
        if not 0 <= target < count:
            raise UnsupportedOperatorError(f"target {target} does not exist")
        if (tree, node) in leaves:
            # a leaf may name a target several times, whose weights add up
            weights = result.setdefault((tree, node), {})
            weights[target] = weights.get(target, 0.0) + float(weight)
    return result


def _numbered_trees(op: Operator, count: int) -> Trees:
    """Return the trees of operator set 5, whose branches are numbers of nodes or of leaves."""
    modes = [_MODES[int(mode)] for mode in _column(op, "nodes_modes")]
    splits, features = _column(op, "nodes_splits"), _column(op, "nodes_featureids")
    missing = _column(op, "nodes_missing_value_tracks_true") or [0] * len(modes)
    # [true side, false side] of (0, number of a node) or (1, number of a leaf)
    branches = [
        [(int(bool(leaf)), int(number)) for number, leaf in zip(*columns, strict=True)]
        for columns in (
            (_column(op, f"nodes_{side}nodeids"), _column(op, f"nodes_{side}leafs")) for side in ("true", "false")
        )
    ]
    members = _members(op)
    nodes = {
        (0, number): TreeNode(feature, mode, float(split), pair, bool(track), next(members) if mode == MEMBER else ())
        for number, (feature, mode, split, pair, track) in enumerate(
            zip(features, modes, splits, zip(*branches, strict=True), missing, strict=True)
        )
    }
    targets, weights = _column(op, "leaf_targetids"), _column(op, "leaf_weights")
    if any(not 0 <= target < count for target in targets) or not 1 <= count <= MAX_TARGETS:
        raise UnsupportedOperatorError(f"a leaf has a target that is not one of {count}")
    pairs = enumerate(zip(targets, weights, strict=True))
    leaves = {(1, number): {target: float(weight)} for number, (target, weight) in pairs}
    roots = _column(op, "tree_roots")
    # a tree that is one leaf has a root with two equal branches to it
    single = [(1, branches[0][root][1]) if branches[0][root] == branches[1][root] else (0, root) for root in roots]
    return Trees(single, nodes, leaves)


def _members(op: Operator) -> Any:
    """Yield the values of each set; NaN ends one."""
    values: list[float] = []
    for value in _column(op, "membership_values"):
        if np.isnan(value):
            yield tuple(values)
            values = []
        else:
            values.append(float(value))
