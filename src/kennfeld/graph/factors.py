"""Parameters that are factors: at 0 they would switch off others, or make a function fail."""

from collections.abc import Iterator

from kennfeld.graph.node import Graph
from kennfeld.graph.traversal import dependent

__all__ = ["factors"]

POSITIVE = ("log", "log10", "sqrt")
TRANSPARENT = ("add", "sub", "neg", "mul", "div", "min", "max", "abs", "select")  # a part at 0 may make the whole 0


def factors(graph: Graph) -> set[str]:
    """The parameters that multiply something that depends on a parameter, divide, or stand below a root or logarithm.

    What a table is looked up with counts as little as the data: only how its values are used does.

    >>> from kennfeld.models.formula import formula
    >>> sorted(factors(formula("y = A(u) * B(v) - D(u) * u").graph))
    ['A', 'B']
    """
    adjustable = dependent(graph, lambda node: node.op == "lookup")
    found: set[str] = set()
    pending = list(dict.fromkeys(_decisive(graph, adjustable)))
    seen = set(pending)
    while pending:
        op, args, payload = graph.nodes[pending.pop()]
        if op == "lookup":
            found.add(str(payload))
        elif op in TRANSPARENT:
            more = {*(args[1:] if op == "select" else args)} - seen
            seen |= more
            pending += more
    return found


def _decisive(graph: Graph, adjustable: set[int]) -> Iterator[int]:
    """Nodes that should not be 0."""
    for op, args, _ in graph.nodes:
        if op in ("mul", "div") and adjustable.issuperset(args):
            yield from args
        elif op == "div":
            yield args[1]
        elif op == "pow" or op in POSITIVE:
            yield args[0]
