"""Directional derivatives of the outputs by inputs and parameters, with the states as they are: forward mode.

The tangent of a node is the sum over its arguments of partial derivative times tangent, written as further nodes of the
same graph. Its partial derivatives are those that a calibration uses (`graph.adjoints.partials`), so that conditions
switch tangents and 0 times infinity is 0. The tangent of a lookup has one more part: the lookup, at the same place, in
the direction of the values.

These nodes are further operations:

| op | args | payload |
|---|---|---|
| seed | | name of an input; the component of the direction |
| direction | as interpolate | `TableRef`; the interpolation in the direction of the values |
| cell_slope | position, x | `AxisRef`; the slope of the position by x |
| axis_direction | position | `AxisRef`; the direction of the breakpoints of a free axis, at the position |
| expansion_direction | coordinates, their tangents | `ExpansionRef` |
| dense_direction | inputs of the layer, their tangents | `DenseOutput` |
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.export.prepared import PreparedFunction
from kennfeld.graph.adjoints import partials
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import CLOCK, Node
from kennfeld.graph.traversal import ancestors

_LEAVES = ("interpolate", "expansion", "dense")


@dataclass(frozen=True, eq=False)
class TangentFunction:
    """A function whose nodes include the tangents of its outputs.

    Attributes:
        function: the function with the further nodes.
        roots: the tangents of the outputs.
        order: the nodes that they need, in the order in which they are computed.
    """

    function: PreparedFunction
    roots: tuple[int, ...]
    order: tuple[int, ...]


def with_tangents(function: PreparedFunction) -> TangentFunction:
    """Add the tangents of the outputs of a function to its nodes."""
    b = GraphBuilder()
    for node in function.nodes:
        b.node(*node)
    order = ancestors(function.nodes, function.roots)
    active = _active(function.nodes, order)
    tangents: dict[int, int] = {}
    for at in order:
        if at in active:
            tangents[at] = _tangent(b, at, tangents, active)
    zero = b.const(0.0)
    roots = tuple(tangents.get(root, zero) for root in function.roots)
    nodes = tuple(b.nodes)
    return TangentFunction(replace(function, nodes=nodes), roots, tuple(ancestors(nodes, roots)))


def _active(nodes: Sequence[Node], order: Sequence[int]) -> set[int]:
    """Return the nodes that depend on an input or a parameter within the step."""
    active: set[int] = set()
    for at in order:
        op, args, payload = nodes[at]
        given = op == "input" and payload not in CLOCK
        moved = op == "position" and payload.key is not None
        if given or moved or op in _LEAVES or not active.isdisjoint(args):
            active.add(at)
    return active


def _tangent(b: GraphBuilder, at: int, tangents: dict[int, int], active: set[int]) -> int:
    op, args, payload = b.nodes[at]
    zero = b.const(0.0)
    if op == "input":
        return b.node("seed", (), payload)
    if op in ("expansion", "dense"):
        return b.node(f"{op}_direction", (*args, *(tangents.get(a, zero) for a in args)), payload)
    if op == "position":
        move = tangents.get(args[0], zero)
        if payload.key is not None:
            # B(p) = x with the curve B of the breakpoints: dp = dp/dx (dx - dB(p))
            move = b.call("sub", move, b.node("axis_direction", (at,), payload))
        return b.call("guard", move, b.node("cell_slope", (at, args[0]), payload))
    terms = [b.node("direction", args, payload)] if op == "interpolate" else []
    for argument, factor, switches in partials(b, at, active):
        tangent = tangents[argument]
        # a selection, not a product: a tangent that is not finite must not leave the branch that is not taken
        terms.append(b.call("select", factor, tangent, zero) if switches else b.call("guard", tangent, factor))
    return reduce(lambda first, second: b.call("add", first, second), terms, zero) if terms else zero
