"""How each node passes an adjoint on to its arguments: the local derivatives, written as nodes of the same graph.

Lookups made explicit for a given set of parameters: search the axes once, then interpolate.

Axes with equal breakpoints become one, so that tables over the same axes share their searches.

A problem computed over its data: each criterion on each dataset, model beside measurement.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import Graph, Node, State, extract

__all__ = ["ancestors", "dependent", "extended", "rewrite"]


def ancestors(
    b: GraphBuilder, roots: Sequence[int], active: Collection[int] | None = None, without: Collection[int] = ()
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


def rewrite(graph: Graph, resolve: Callable[[GraphBuilder, int, tuple[int, ...]], int]) -> Graph:
    """The graph with each node replaced by `resolve(builder, node, new arguments)`."""
    b = GraphBuilder()
    b.states.extend(graph.states)
    number: list[int] = []
    for at, node in enumerate(graph.nodes):
        number.append(resolve(b, at, tuple(number[a] for a in node.args)))
    states = [State(number[s.init], number[s.next], s.latency) for s in graph.states]
    names = {name: number[at] for name, at in graph.names.items()}
    return extract(b.nodes, states, names, graph.units, graph.outputs)


def dependent(graph: Graph, source: Callable[[Node], bool], *, through_states: bool = True) -> set[int]:
    """Nodes whose value depends on a node for which `source` holds, through memory as well if asked for."""
    live = _forward(graph.nodes, source, ())
    while through_states:
        states = {i for i, s in enumerate(graph.states) if s.init in live or s.next in live}
        grown = _forward(graph.nodes, source, states)
        if grown == live:
            break
        live = grown
    return live


def _forward(nodes: Iterable[Node], source: Callable[[Node], bool], states: Collection[int]) -> set[int]:
    live: set[int] = set()
    for at, node in enumerate(nodes):
        if source(node) or (node.op == "state" and node.payload in states) or not live.isdisjoint(node.args):
            live.add(at)
    return live


def extended(graph: Graph, extra: Mapping[int, str]) -> Graph:
    """The graph with more of its nodes named."""
    if not extra:
        return graph
    names = {**graph.names, **{name: at for at, name in extra.items()}}
    return GraphBuilder.of(graph).finish(names, graph.units, graph.outputs)
