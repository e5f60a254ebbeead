"""Ensembles of regression trees: piecewise constant, so that their derivative is 0."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kennfeld.models.onnx_network.network import ML, Operator
from kennfeld.models.onnx_network.registry import Arguments, Context, operator
from kennfeld.models.onnx_network.shapes import first
from kennfeld.models.onnx_network.tensors import MAX_NODES, NodeTensor, Tensor, UnsupportedOperatorError

_COMPARISONS = {
    "BRANCH_LEQ": "le", "BRANCH_LT": "lt", "BRANCH_GTE": "ge", "BRANCH_GT": "gt", "BRANCH_EQ": "eq", "BRANCH_NEQ": "ne",
}  # fmt: skip
_FOLDS = {"SUM": "add", "AVERAGE": "add", "MIN": "min", "MAX": "max"}
_NODES = ("nodes_treeids", "nodes_nodeids", "nodes_featureids", "nodes_modes", "nodes_values")
_BRANCHES = ("nodes_truenodeids", "nodes_falsenodeids")
_TARGETS = ("target_treeids", "target_nodeids", "target_ids", "target_weights")
_REMARK = (
    "a tree ensemble is piecewise constant: its derivative is 0, so nothing before it can be calibrated through it"
)

Key = tuple[int, int]  # tree, node


class _TreeNode(NamedTuple):
    """A node of a tree; `missing` is True if NaN takes the true branch."""

    feature: int
    mode: str
    value: float
    branches: tuple[Key, Key]
    missing: bool


@operator("TreeEnsembleRegressor", domain=ML)
def tree_ensemble(c: Context, op: Operator, arguments: Arguments) -> Tensor:
    x, count = first(arguments), op.get("n_targets", 1)
    if op.get("post_transform", "NONE") != "NONE":
        raise UnsupportedOperatorError(f"post_transform {op.get('post_transform')} is not supported")
    aggregate = op.get("aggregate_function", "SUM")
    if aggregate not in _FOLDS or not 1 <= count <= 1000:
        raise UnsupportedOperatorError(f"aggregate_function {aggregate} with {count} targets is not supported")
    nodes, leaves = _nodes(op), _leaves(op, count)
    c.remark(_REMARK)
    ensemble = _Ensemble(c, nodes, leaves)
    bases = op.get("base_values", [])
    rows = [
        [ensemble.value(row, target, aggregate, float(bases[target]) if len(bases) else 0.0) for target in range(count)]
        for row in np.atleast_2d(c.nodes(x))
    ]
    return NodeTensor(np.array(rows, dtype=np.int64))


def _nodes(op: Operator) -> Mapping[Key, _TreeNode]:
    columns = [op.get(name, []) for name in (*_NODES, *_BRANCHES)]
    size = len(columns[0])
    missing = op.get("nodes_missing_value_tracks_true") or [0] * size
    if any(len(column) != size for column in (*columns, missing)):
        raise UnsupportedOperatorError("its lists of nodes have different lengths")
    nodes = {}
    for (tree, node, feature, mode, value, yes, no), track in zip(zip(*columns, strict=True), missing, strict=True):
        if mode != "LEAF" and mode not in _COMPARISONS:
            raise UnsupportedOperatorError(f"mode {mode} is not supported")
        nodes[tree, node] = _TreeNode(feature, mode, float(value), ((tree, yes), (tree, no)), bool(track))
    return nodes


def _leaves(op: Operator, count: int) -> Mapping[Key, Mapping[int, float]]:
    """Return the weights of each leaf by target."""
    columns = [op.get(name, []) for name in _TARGETS]
    if len({len(column) for column in columns}) > 1:
        raise UnsupportedOperatorError("its lists of targets have different lengths")
    leaves: dict[Key, dict[int, float]] = {}
    for tree, node, target, weight in zip(*columns, strict=True):
        if not 0 <= target < count:
            raise UnsupportedOperatorError(f"target {target} does not exist")
        weights = leaves.setdefault((tree, node), {})
        weights[target] = weights.get(target, 0.0) + float(weight)
    return leaves


class _Ensemble:
    """The trees of an ensemble, written as nested selections."""

    def __init__(self, c: Context, nodes: Mapping[Key, _TreeNode], leaves: Mapping[Key, Mapping[int, float]]) -> None:
        self._builder, self._nodes, self._leaves = c.builder, nodes, leaves
        inner = {branch for node in nodes.values() if node.mode != "LEAF" for branch in node.branches}
        self._roots = [key for key in nodes if key not in inner]
        trees = [tree for tree, _ in nodes]
        if len(self._roots) != len(set(trees)):
            raise UnsupportedOperatorError("its nodes do not form trees with one root each")

    def value(self, row: Sequence[Any], target: int, aggregate: str, base: float) -> int:
        """Return the node of a target at the features of a row."""
        b = self._builder
        results = [self._tree(root, row, target) for root in self._roots]
        total = results[0] if results else b.const(0.0)
        for result in results[1:]:
            total = b.call(_FOLDS[aggregate], total, result)
        if aggregate == "AVERAGE":
            total = b.call("div", total, b.const(float(max(len(results), 1))))
        return b.call("add", total, b.const(base))

    def _tree(self, root: Key, row: Sequence[Any], target: int) -> int:
        done: dict[Key, int] = {}
        stack, entered = [root], set[Key]()
        while stack:
            key = stack[-1]
            node = self._nodes.get(key)
            if node is None or len(self._builder.nodes) > MAX_NODES:
                raise UnsupportedOperatorError("it has a branch to a missing node, or too many nodes")
            if node.mode == "LEAF":
                done[key] = self._builder.const(self._leaves.get(key, {}).get(target, 0.0))
            pending = [] if key in done else [branch for branch in node.branches if branch not in done]
            if pending and key in entered:
                raise UnsupportedOperatorError("its nodes do not form trees")
            if pending:
                entered.add(key)
                stack.extend(pending)
                continue
            if key not in done:
                done[key] = self._branch(node, row, *(done[branch] for branch in node.branches))
            stack.pop()
        return done[root]

    def _branch(self, node: _TreeNode, row: Sequence[Any], yes: int, no: int) -> int:
        if not 0 <= node.feature < len(row):
            raise UnsupportedOperatorError(f"feature {node.feature} does not exist")
        b, x = self._builder, int(row[node.feature])
        condition = b.call(_COMPARISONS[node.mode], x, b.const(node.value))
        if node.missing:
            condition = b.call("or", condition, b.call("ne", x, x))
        return b.call("select", condition, yes, no)
