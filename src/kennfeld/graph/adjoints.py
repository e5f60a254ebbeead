"""How each node passes an adjoint on to its arguments: the local derivatives, written as nodes of the same graph.

Slopes of many rows without a node for each: a list of products to be run once a row.

An adjoint starts as 1 at the node of a row and is pulled back to what the node was computed from, a product and a sum
at a time. The factors are the same for all rows, so there are about as many as nodes, however many rows. Zero times
anything is zero: what is not finite leaks neither from a branch not taken nor from where a row does not reach.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import Node
from kennfeld.graph.operations import OPERATIONS
from kennfeld.graph.traversal import ancestors

__all__ = ["AdjointProgram", "of_breakpoints", "partials", "pull_back"]

SLOPES = {"position": "density", "interpolate": "slope", "expansion": "expansion_slope"}


class Partial(NamedTuple):
    """The adjoint of `argument` grows by the node's: times `factor`, or, if it `switches`, where that is true."""

    argument: int
    factor: int
    switches: bool


def partials(b: GraphBuilder, at: int, active: Collection[int]) -> Iterator[Partial]:
    """What node `at` passes on to those of its arguments that are `active`; steps pass nothing on."""
    op, args, payload = b.nodes[at]
    if op in SLOPES:
        for axis, a in enumerate(args):
            if a in active:
                slope = b.node(SLOPES[op], args, payload if op == "position" else (payload, axis))
                yield Partial(a, slope, switches=False)
    elif args:
        rule = OPERATIONS[op]
        conditions = rule.branches(b, args) if rule.branches else (None,) * len(args)
        for a, partial, condition in zip(args, rule.partials, conditions, strict=True):
            if a in active and partial is not None:
                factor = partial(b, args, at) if condition is None else condition
                yield Partial(a, factor, switches=condition is not None)


def of_breakpoints(b: GraphBuilder, at: int) -> int:
    """The slope of a position p with respect to B(p), the breakpoints' curve there: minus its slope along the axis."""
    _, args, payload = b.nodes[at]
    return b.call("neg", b.node("density", args, payload))


class AdjointStep(NamedTuple):
    """The adjoint of node `onto` grows by the adjoint of node `of` times the value of node `factor`."""

    of: int
    onto: int
    factor: int


@dataclass(frozen=True)
class AdjointProgram:
    """The slopes of the nodes `roots`, a row each, as pulls to be run in their order.

    Afterwards the adjoint of an atom or a state is the row's slope, for a position on a free axis times the value of
    its node in `scales`; `reach[row]` are those that can differ from zero.
    """

    roots: tuple[int, ...]
    pulls: tuple[AdjointStep, ...]
    reach: tuple[frozenset[int], ...]
    scales: Mapping[int, int]

    def only(self, rows: Sequence[int]) -> "AdjointProgram":
        """That of some rows; the others must have no pulls of their own."""
        return replace(self, roots=tuple(self.roots[row] for row in rows), reach=tuple(self.reach[row] for row in rows))

    def of_row(self, row: int, value: Callable[[int], float]) -> Mapping[int, float]:
        """The slopes of one row where `value(node)` is the value of a factor."""
        adjoint: dict[int, float] = defaultdict(float)
        adjoint[self.roots[row]] = 1.0
        for of, onto, factor in self.pulls:
            if adjoint[of] != 0 and value(factor) != 0:
                adjoint[onto] += adjoint[of] * value(factor)
        slopes = {leaf: adjoint[leaf] for leaf in self.reach[row]}
        return {
            leaf: s * value(self.scales[leaf]) if s != 0 and leaf in self.scales else s for leaf, s in slopes.items()
        }


def pull_back(
    b: GraphBuilder, roots: Sequence[int], active: Collection[int], is_atom: Callable[[Node], bool]
) -> AdjointProgram:
    """The pull-back of these rows to the atoms and states they reach within one step; writes the factors."""
    reached: dict[int, int] = defaultdict(int)  # the rows that reach a node, a bit each
    for row, root in enumerate(roots):
        reached[root] |= (root in active) << row
    pulls: list[AdjointStep] = []
    leaves: list[int] = []
    for at in reversed(ancestors(b, [root for root in roots if root in active], active)):
        if not reached[at]:  # needed by steps alone, as a comparison
            continue
        if b.nodes[at].op == "state" or is_atom(b.nodes[at]):
            leaves.append(at)
        for argument, factor, switches in partials(b, at, active):
            pulls.append(AdjointStep(at, argument, _share(b, factor) if switches else factor))
            reached[argument] |= reached[at]
    reach = tuple(frozenset(leaf for leaf in leaves if reached[leaf] >> row & 1) for row in range(len(roots)))
    scales = {leaf: of_breakpoints(b, leaf) for leaf in leaves if b.nodes[leaf].op == "position"}
    return AdjointProgram(tuple(roots), tuple(_joined(b, pulls, {*roots, *leaves})), reach, scales)


def _share(b: GraphBuilder, condition: int) -> int:
    return b.call("select", condition, b.const(1.0), b.const(0.0))


def _joined(b: GraphBuilder, pulls: Sequence[AdjointStep], kept: Collection[int]) -> Iterator[AdjointStep]:
    """The pulls without those that only copy an adjoint, as a sum does to what nothing else uses."""
    users = Counter(pull.onto for pull in pulls)
    one = b.const(1.0)
    same: dict[int, int] = {}
    for of, onto, factor in pulls:
        if factor == one and users[onto] == 1 and onto not in kept:
            same[onto] = same.get(of, of)
        else:
            yield AdjointStep(same.get(of, of), onto, factor)
