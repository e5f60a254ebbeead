"""Reverse-mode derivatives of graph nodes: local partial derivatives, and adjoint sweeps as lists of products.

`partials` writes the local derivatives of a node as nodes of the same graph. `pull_back` builds an `AdjointProgram`:
the adjoint of a row starts as 1 at the row's root and is propagated to the arguments, adjoint[onto] += adjoint[of] *
factor. The factors are shared by all rows, so their number grows with the nodes, not with the rows. A product with a
zero is zero even if the other factor is not finite, so values of a branch not taken cannot reach the result.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial, reduce
from typing import NamedTuple

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import Node
from kennfeld.graph.operations import OPERATIONS
from kennfeld.graph.traversal import ancestors

SLOPES = {
    "position": "density",
    "interpolate": "slope",
    "expansion": "expansion_slope",
    "external": "external_slope",
    "dense": "dense_slope",
}

BRANCHING = ("min", "max", "select")  # the last two arguments are the branches
ALGEBRAIC = ("add", "sub", "mul", "div", "neg", "abs", "pow", "single")


class Partial(NamedTuple):
    """A local derivative: adjoint of `argument` += adjoint of the node * `factor`, or, if `switches`, if `factor`
    is true.
    """

    argument: int
    factor: int
    switches: bool


def partials(b: GraphBuilder, at: int, active: Collection[int]) -> Iterator[Partial]:
    """Yield the local derivatives of node `at` with respect to its `active` arguments; step functions yield none."""
    op, args, payload = b.nodes[at]
    if op in SLOPES:
        for axis, a in enumerate(args):
            if a in active:
                slope = b.node(SLOPES[op], args, payload if op == "position" else (payload, axis))
                yield Partial(a, slope, switches=False)
    elif args:
        rule = OPERATIONS[op]
        conditions = rule.branches(b, args) if rule.branches else (None,) * len(args)
        for a, write, condition in zip(args, rule.partials, conditions, strict=True):
            if a in active and write is not None:
                factor = write(b, args, at) if condition is None else condition
                # only the first argument has an edge of its range
                if rule.edge is not None and a == args[0]:
                    factor = _cut_off(b, rule.edge(b, args), list(_ties(b, a, active)), factor)
                yield Partial(a, factor, switches=condition is not None)


def _cut_off(b: GraphBuilder, edge: int, ties: Sequence[int], slope: int) -> int:
    """Return a slope that is 0 at an edge of the range if the argument is saturated there.

    The slope of `sqrt(max(z, 0))` at z = 0 is 0 on one side and infinite on the other: the finite one counts.
    """
    if not ties:
        return slope
    saturated = reduce(partial(b.call, "or"), ties)
    return b.call("select", b.call("and", edge, saturated), b.const(0.0), slope)


def _ties(b: GraphBuilder, at: int, active: Collection[int]) -> Iterator[int]:
    """Yield the conditions under which a quantity saturates in the expression of a node.

    They are those under which a branch of `min`, `max` or `select` equals another one that does not vary.
    """
    seen, stack = {at}, [at]
    while stack:
        op, args, _ = b.nodes[stack.pop()]
        branches = args[-2:] if op in BRANCHING else ()
        # two branches that vary meet at a kink; saturation needs one that does not
        if branches and not all(a in active for a in branches):
            yield b.call("eq", *branches)
        for a in branches or (args if op in ALGEBRAIC else ()):
            if a in active and a not in seen:
                seen.add(a)
                stack.append(a)


def layer_partials(b: GraphBuilder, outputs: Mapping[int, int], active: Collection[int]) -> Iterator[tuple[int, int]]:
    """Yield the active inputs of a dense layer, each with its adjoint.

    `outputs` are the nodes of the layer's outputs with the nodes of their adjoints; the others have none.
    """
    args, layer = next((b.nodes[at].args, b.nodes[at].payload.layer) for at in outputs)
    adjoints = {b.nodes[at].payload.number: adjoint for at, adjoint in outputs.items()}
    # one pull of the whole layer needs an adjoint of each output
    every = tuple(adjoints.get(number, b.const(0.0)) for number in range(layer.outputs))
    for axis, a in enumerate(args):
        if a in active:
            yield a, b.node("dense_pull", (*args, *every), (layer, axis))


def breakpoint_slope(b: GraphBuilder, at: int) -> int:
    """Return dp/dB(p) for a position p and the curve B of its breakpoints: minus the slope along the axis."""
    _, args, payload = b.nodes[at]
    return b.call("neg", b.node("density", args, payload))


class AdjointStep(NamedTuple):
    """One product of an adjoint sweep: adjoint[onto] += adjoint[of] * value(factor)."""

    of: int
    onto: int
    factor: int


@dataclass(frozen=True)
class AdjointProgram:
    """The derivatives of the nodes `roots`, one row each, as a list of products to be run in order.

    After the run, the adjoint of an atom or a state is the derivative of the row; for a position on a free axis it must
    still be multiplied by the value of its node in `scales`. `reach[row]` are the nodes whose derivative can be
    non-zero.
    """

    roots: tuple[int, ...]
    pulls: tuple[AdjointStep, ...]
    reach: tuple[frozenset[int], ...]
    scales: Mapping[int, int]

    def only(self, rows: Sequence[int]) -> "AdjointProgram":
        """Return the program restricted to some rows; the others must have no steps of their own."""
        return replace(self, roots=tuple(self.roots[row] for row in rows), reach=tuple(self.reach[row] for row in rows))

    def of_row(self, row: int, value: Callable[[int], float]) -> Mapping[int, float]:
        """Compute the derivatives of one row by node; `value(node)` is the value of a factor."""
        adjoint: dict[int, float] = defaultdict(float)
        adjoint[self.roots[row]] = 1.0
        for of, onto, factor in self.pulls:
            # a product with a zero is zero, even if the other factor is not finite
            if adjoint[of] != 0 and value(factor) != 0:
                adjoint[onto] += adjoint[of] * value(factor)
        slopes = {leaf: adjoint[leaf] for leaf in self.reach[row]}
        scaled = {leaf: s * value(self.scales[leaf]) for leaf, s in slopes.items() if s != 0 and leaf in self.scales}
        return slopes | scaled


def pull_back(
    b: GraphBuilder, roots: Sequence[int], active: Collection[int], is_atom: Callable[[Node], bool]
) -> AdjointProgram:
    """Return the adjoint program of these rows, down to the atoms and states of one step; adds the factors to
    the graph.
    """
    reached: dict[int, int] = defaultdict(int)  # the rows that reach a node, a bit each
    for row, root in enumerate(roots):
        reached[root] |= (root in active) << row
    pulls: list[AdjointStep] = []
    leaves: list[int] = []
    # all uses of a node come before it, so that its adjoint is complete when it is passed on
    for at in reversed(ancestors(b.nodes, [root for root in roots if root in active], active)):
        if not reached[at]:  # needed by steps alone, as a comparison
            continue
        if b.nodes[at].op == "state" or is_atom(b.nodes[at]):
            leaves.append(at)
        for argument, factor, switches in partials(b, at, active):
            # all steps are products: a condition is a factor of 1 or 0
            share = b.call("select", factor, b.const(1.0), b.const(0.0)) if switches else factor
            pulls.append(AdjointStep(at, argument, share))
            reached[argument] |= reached[at]
    reach = tuple(frozenset(leaf for leaf in leaves if reached[leaf] >> row & 1) for row in range(len(roots)))
    scales = {leaf: breakpoint_slope(b, leaf) for leaf in leaves if b.nodes[leaf].op == "position"}
    return AdjointProgram(tuple(roots), tuple(_without_copies(b, pulls, {*roots, *leaves})), reach, scales)


def _without_copies(b: GraphBuilder, pulls: Sequence[AdjointStep], kept: Collection[int]) -> Iterator[AdjointStep]:
    """Yield the steps without those that only copy an adjoint, such as a sum passing it to an otherwise unused node."""
    users = Counter(pull.onto for pull in pulls)
    unit = b.const(1.0)
    same: dict[int, int] = {}
    for of, onto, factor in pulls:
        if factor == unit and users[onto] == 1 and onto not in kept:
            # the adjoint of `onto` is that of `of`, perhaps a copy itself
            same[onto] = same.get(of, of)
        else:
            yield AdjointStep(same.get(of, of), onto, factor)
