"""Ensembles of decision trees, written as nested selections: piecewise constant, so that their derivative is 0."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from kennfeld.importers.onnx.registry import Context
from kennfeld.importers.onnx.tensors import MAX_NODES, NodeTensor, Tensor, UnsupportedOperatorError

COMPARISONS = {
    "BRANCH_LEQ": "le", "BRANCH_LT": "lt", "BRANCH_GTE": "ge", "BRANCH_GT": "gt", "BRANCH_EQ": "eq", "BRANCH_NEQ": "ne",
}  # fmt: skip
MEMBER = "BRANCH_MEMBER"
AGGREGATES = ("AVERAGE", "SUM", "MIN", "MAX")
MAX_TARGETS = 1000
_FOLDS = {"SUM": "add", "AVERAGE": "add", "MIN": "min", "MAX": "max"}
_REMARK = (
    "a tree ensemble is piecewise constant: its derivative is 0, so nothing before it can be calibrated through it"
)

Key = tuple[int, int]  # tree, node
Weights = Mapping[int, float]  # by target


class TreeNode(NamedTuple):
    """An inner node: `mode` compares a feature with `value`, or `members`; `missing` if NaN takes the true branch."""

    feature: int
    mode: str
    value: float
    branches: tuple[Key, Key]
    missing: bool = False
    members: tuple[float, ...] = ()


class Trees(NamedTuple):
    """The trees of an ensemble: roots, inner nodes, and the weights of the leaves."""

    roots: Sequence[Key]
    nodes: Mapping[Key, TreeNode]
    leaves: Mapping[Key, Weights]


def roots_of(nodes: Mapping[Key, TreeNode], leaves: Mapping[Key, Weights]) -> list[Key]:
    """Find the node of each tree that is not a branch of another.

    Raises:
        UnsupportedOperatorError: a tree has none, or several.
    """
    inner = {branch for node in nodes.values() for branch in node.branches}
    keys = [*nodes, *(key for key in leaves if key not in nodes)]
    roots = [key for key in keys if key not in inner]
    if len(roots) != len({tree for tree, _ in keys}):
        raise UnsupportedOperatorError("its nodes do not form trees with one root each")
    return sorted(roots)


def write_trees(
    c: Context, trees: Trees, rows: Sequence[Sequence[int]], aggregate: str, bases: Sequence[float]
) -> Tensor:
    """Aggregate the weights of the leaves that rows of features reach, [rows, targets].

    Args:
        c: context.
        trees: the trees.
        rows: nodes of the features, [rows, features].
        aggregate: one of `AGGREGATES`.
        bases: added to each target, [targets].
    """
    c.remark(_REMARK)
    order = [list(_order(c, trees, root)) for root in trees.roots]
    sums = [
        [_total(c, trees, order, row, target, aggregate, base) for target, base in enumerate(bases)] for row in rows
    ]
    return NodeTensor(np.array(sums, dtype=np.int64).reshape(len(rows), len(bases)))


def _total(
    c: Context,
    trees: Trees,
    order: Sequence[Sequence[Key]],
    row: Sequence[int],
    target: int,
    aggregate: str,
    base: float,
) -> int:
    b = c.builder
    results = [_tree(c, trees, keys, row, target) for keys in order]
    total = results[0] if results else b.const(0.0)
    for result in results[1:]:
        total = b.call(_FOLDS[aggregate], total, result)
    if aggregate == "AVERAGE":
        total = b.call("div", total, b.const(float(max(len(results), 1))))
    return b.call("add", total, b.const(base))


def _order(c: Context, trees: Trees, root: Key) -> Sequence[Key]:
    """Return the nodes of a tree, each after its branches."""
    order: list[Key] = []
    # a stack, because trees may be deeper than Python recurses
    seen, stack = {root}, [root]
    while stack:
        key = stack.pop()
        order.append(key)
        if key in trees.leaves:
            continue
        node = trees.nodes.get(key)
        if node is None or len(order) > MAX_NODES:
            raise UnsupportedOperatorError("it has a branch to a missing node, or too many nodes")
        # a node that two branches lead to would be written twice, or endlessly in a circle
        if seen.intersection(node.branches) or node.branches[0] == node.branches[1]:
            raise UnsupportedOperatorError("its nodes do not form trees")
        seen.update(node.branches)
        stack.extend(node.branches)
    return order[::-1]


def _tree(c: Context, trees: Trees, order: Sequence[Key], row: Sequence[int], target: int) -> int:
    results: dict[Key, int] = {}
    for key in order:
        if key in trees.leaves:
            results[key] = c.builder.const(trees.leaves[key].get(target, 0.0))
        else:
            node = trees.nodes[key]
            results[key] = c.builder.call("select", _condition(c, node, row), *(results[b] for b in node.branches))
    if len(c.builder.nodes) > MAX_NODES:
        raise UnsupportedOperatorError(f"the trees require more than {MAX_NODES} operations per step")
    # the root, which comes after all of its branches
    return results[order[-1]]


def _condition(c: Context, node: TreeNode, row: Sequence[int]) -> int:
    if not 0 <= node.feature < len(row):
        raise UnsupportedOperatorError(f"feature {node.feature} does not exist")
    b, x = c.builder, int(row[node.feature])
    if node.mode == MEMBER:
        conditions = [b.call("eq", x, b.const(member)) for member in node.members] or [b.const(0.0)]
        # NaN equals no member, so that it would take the false branch
        conditions += [b.call("ne", x, x)] if node.missing else []
        result = conditions[0]
        for condition in conditions[1:]:
            result = b.call("or", result, condition)
        return result
    condition = b.call(COMPARISONS[node.mode], x, b.const(node.value))
    return b.call("or", condition, b.call("ne", x, x)) if node.missing else condition
