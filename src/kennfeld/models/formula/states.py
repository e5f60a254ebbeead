"""Graphs in the form that formula text can say: no two memories that always hold the same."""

from collections.abc import Sequence

from kennfeld.graph import Builder, Graph, State

__all__ = ["merged"]


def merged(graph: Graph) -> Graph:
    """The same graph with memories of equal initial and next nodes made one.

    >>> b = Builder()
    >>> u, zero = b.input("u"), b.const(0.0)
    >>> twins = [b.state(), b.state()]
    >>> for twin in twins:
    ...     b.close(twin, zero, u)
    >>> len(merged(b.finish({"y": b.call("add", *twins)})).states)
    1
    """
    while len(set(graph.states)) < len(graph.states):  # merging may make further memories equal
        first: dict[State, int] = {}
        kept = [first.setdefault(state, index) for index, state in enumerate(graph.states)]
        graph = _with_states(graph, kept)
    return graph


def _with_states(graph: Graph, kept: Sequence[int]) -> Graph:
    """The graph that reads memory `kept[i]` where it read memory i."""
    builder = Builder()
    reads = {which: builder.state(graph.states[which].latency) for which in dict.fromkeys(kept)}
    number: list[int] = []
    for op, args, payload in graph.nodes:
        copied = reads[kept[payload]] if op == "state" else builder.node(op, tuple(number[a] for a in args), payload)
        number.append(copied)
    for which, read in reads.items():
        builder.close(read, number[graph.states[which].init], number[graph.states[which].next])
    names = {name: number[at] for name, at in graph.names.items()}
    return builder.finish(names, graph.units, graph.outputs)
