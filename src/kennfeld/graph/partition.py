"""Separation of the part of a graph that depends on data alone, so that it is computed once, not in each iteration."""

from collections.abc import Collection, Mapping

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.lookup_lowering import Free, is_atom
from kennfeld.graph.node import Graph, extract
from kennfeld.graph.traversal import dependents, rewrite

_COST = {
    "const": 0, "input": 1, "state": 1000, "div": 4, "select": 1, "position": 10, "interpolate": 10, "expansion": 1000,
    "external": 1000, "dense": 1000, "single": 2,
}  # fmt: skip
_CHEAP = {"add", "sub", "mul", "neg", "min", "max", "abs", "not", "and", "or", "lt", "le", "gt", "ge", "eq", "ne"}
_WORTH = 5  # a column costs a load a sample; what is cheaper is computed again


@dataclass(frozen=True)
class GraphPartition:
    """The part of a graph that depends on free parameters, and the precomputed columns it reads.

    `columns` maps the name of each new input to the node of the original graph whose values it holds; `prepared` is the
    part of the original graph that computes them.
    """

    graph: Graph
    columns: Mapping[str, int]
    prepared: Graph


def partition_graph(graph: Graph, outputs: Collection[str], free: Free) -> GraphPartition:
    """Cut a lowered graph, reduced to `outputs`, at the values that do not depend on free parameters.

    Axis searches stay in the reduced graph: consecutive samples mostly lie in the same cell, so a precomputed column
    would cost more memory traffic than it saves.

    >>> b = GraphBuilder()
    >>> slow = b.call("exp", b.input("x"))
    >>> y = b.call("mul", slow, b.node("interpolate", (), type("T", (), {"name": "K"})))
    >>> sorted(partition_graph(b.finish({"y": y}), ["y"], ["K"]).columns)
    ['#0']
    """
    live = dependents(graph, lambda node: is_atom(node, free))
    kept = live | {at for at, node in enumerate(graph.nodes) if node.op == "position"}
    # the border of the kept part: what it reads and does not compute itself
    used = _entering(graph, [graph.names[name] for name in outputs], kept)
    costs = _costs(graph)
    columns = {f"#{i}": at for i, at in enumerate(sorted(a for a in used - kept if costs[a] > _WORTH))}
    name_of = {at: name for name, at in columns.items()}

    def resolve(b: GraphBuilder, at: int, args: tuple[int, ...]) -> int:
        return b.input(name_of[at]) if at in name_of else b.rebuild(graph.nodes[at], args)

    names = {name: graph.names[name] for name in outputs}
    reduced = Graph(graph.nodes, names, graph.states, graph.units, tuple(outputs))
    prepared = extract(graph.nodes, graph.states, columns, {}, ())
    return GraphPartition(rewrite(reduced, resolve), columns, prepared)


def _entering(graph: Graph, roots: Collection[int], kept: Collection[int]) -> set[int]:
    """Return the nodes that the kept part of the graph reads, including the roots."""
    seen = set(roots)
    stack = list(seen)
    while stack:
        at = stack.pop()
        if at not in kept:
            continue
        op, args, payload = graph.nodes[at]
        needs = (graph.states[payload].init, graph.states[payload].next) if op == "state" else args
        stack.extend(a for a in needs if a not in seen)
        seen.update(needs)
    return seen


def _costs(graph: Graph) -> list[int]:
    """Estimate the operations needed to compute each node from the inputs; shared nodes count each time."""
    costs: list[int] = []
    for op, args, _ in graph.nodes:
        own = 1 if op in _CHEAP else _COST.get(op, 10)
        # limited, as nodes that are shared on many levels count exponentially often
        costs.append(min(own + sum(costs[a] for a in args), 1000))
    return costs
