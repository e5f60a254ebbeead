"""Parameters that act as factors, divisors or arguments of roots and logarithms, and so must not start at 0."""

from collections.abc import Iterator

from kennfeld.graph.node import Graph
from kennfeld.graph.traversal import dependents

POSITIVE = ("log", "log10", "sqrt")
# a part at 0 may make the whole 0
TRANSPARENT = ("add", "sub", "neg", "mul", "div", "min", "max", "abs", "select", "single")


def factors(graph: Graph) -> set[str]:
    """Return the parameters that multiply a parameter-dependent value, divide, or are under a root or logarithm.

    The coordinates of a lookup are ignored; only the use of its values counts.

    >>> from kennfeld.models.formula import formula
    >>> sorted(factors(formula("y = A(u) * B(v) - D(u) * u").graph))
    ['A', 'B']
    """
    adjustable = dependents(graph, lambda node: node.parameter is not None)
    result: set[str] = set()
    pending = list(dict.fromkeys(_non_zero_nodes(graph, adjustable)))
    seen = set(pending)
    while pending:
        op, args, payload = graph.nodes[pending.pop()]
        if op == "lookup":
            result.add(str(payload))
        elif op in TRANSPARENT:
            # the condition of a selection does not make its value 0
            more = {*(args[1:] if op == "select" else args)} - seen
            seen |= more
            pending += more
    return result


def _non_zero_nodes(graph: Graph, adjustable: set[int]) -> Iterator[int]:
    for op, args, _ in graph.nodes:
        if op in ("mul", "div") and adjustable.issuperset(args):
            yield from args
        elif op == "div":
            yield args[1]
        elif op == "pow" or op in POSITIVE:
            yield args[0]
