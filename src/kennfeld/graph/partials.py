"""How each node passes an adjoint on to its arguments: the local derivatives, written as nodes of the same graph."""

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

from kennfeld.graph.node import Builder
from kennfeld.graph.operations import OPERATIONS

__all__ = ["Partial", "cone", "of_breakpoints", "partials"]


SLOPES = {"position": "density", "interpolate": "slope", "expansion": "expansion_slope"}


class Partial(NamedTuple):
    """The adjoint of `argument` grows by the node's: times `factor`, or, if it `switches`, where that is true."""

    argument: int
    factor: int
    switches: bool


def partials(b: Builder, at: int, active: Collection[int]) -> Iterator[Partial]:
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


def of_breakpoints(b: Builder, at: int) -> int:
    """The slope of a position p with respect to B(p), the breakpoints' curve there: minus its slope along the axis."""
    _, args, payload = b.nodes[at]
    return b.call("neg", b.node("density", args, payload))


def cone(
    b: Builder, roots: Sequence[int], active: Collection[int] | None = None, without: Collection[int] = ()
) -> list[int]:
    """The nodes that the roots are computed from within a step, each after its arguments.

    The walk keeps to nodes of `active` where that is given, and ends before those of `without`.
    """
    seen = set(roots)
    stack = list(seen)
    while stack:
        for a in b.nodes[stack.pop()].args:
            if a not in seen and a not in without and (active is None or a in active):
                seen.add(a)
                stack.append(a)
    return sorted(seen)
