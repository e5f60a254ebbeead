"""Logarithms of sums of exponentials, written so that no exponential overflows on the way.

`log(1 + exp(z))` is about z for a large z, but `exp(z)` is infinite from z = 710 on. A search from a steep start visits
such values. The results are those of the original expressions wherever these are finite.
"""

import math
from functools import partial, reduce

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import Node

LOGARITHMS = {"log": 1.0, "log10": 1 / math.log(10)}
FAR = 20.0  # |z| from which log(cosh(z)) is |z| - log(2) to the last digit


def rebuild(b: GraphBuilder, node: Node, args: tuple[int, ...]) -> int:
    """Return a node like another one with these arguments, in a stable form if it is a logarithm that has one.

    These are the logarithms of `exp(a) + exp(b) + ...`, positive constants among them, and of `cosh(a)`.

    >>> b = GraphBuilder()
    >>> grown = b.call("add", b.const(1.0), b.call("exp", b.input("z")))
    >>> b.nodes[rebuild(b, Node("log", (grown,)), (grown,))].op
    'select'
    """
    stable = _logarithm(b, args[0]) if node.op in LOGARITHMS else None
    return b.rebuild(node, args) if stable is None else b.call("mul", stable, b.const(LOGARITHMS[node.op]))


def _logarithm(b: GraphBuilder, at: int) -> int | None:
    """Return the natural logarithm of a node in a stable form, if it has one."""
    if b.nodes[at].op == "cosh":
        return _log_cosh(b, at)
    exponents = _exponents(b, at)
    return None if exponents is None else reduce(partial(_log_sum, b), exponents)


def _exponents(b: GraphBuilder, at: int) -> list[int] | None:
    """Return the exponents of a sum of exponentials; None if a term is neither one nor a positive constant."""
    op, args, payload = b.nodes[at]
    if op == "exp":
        return [args[0]]
    if op == "const" and payload > 0:
        # c = exp(log(c))
        return [b.const(math.log(payload))]
    parts = [_exponents(b, a) for a in args] if op == "add" else [None]
    return None if None in parts else [exponent for part in parts for exponent in part or ()]


def _log_sum(b: GraphBuilder, x: int, y: int) -> int:
    """Return log(exp(x) + exp(y)) as the larger of both plus log(1 + exp(-|x - y|))."""

    def beyond(larger: int, smaller: int) -> int:
        grown = b.call("exp", b.call("sub", smaller, larger))
        return b.call("add", larger, b.call("log", b.call("add", b.const(1.0), grown)))

    return b.call("select", b.call("gt", x, y), beyond(x, y), beyond(y, x))


def _log_cosh(b: GraphBuilder, at: int) -> int:
    size = b.call("abs", b.nodes[at].args[0])
    far = b.call("sub", size, b.const(math.log(2)))
    # log(cosh(z)) = |z| - log(2) + log(1 + e^(-2 |z|)), of which the last term is below 5e-18 there
    return b.call("select", b.call("gt", size, b.const(FAR)), far, b.call("log", at))
