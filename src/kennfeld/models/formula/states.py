"""Graphs in the form that formula text can say: no two memories that always hold the same."""

from collections.abc import Callable, Sequence

from kennfeld.graph import Builder, Graph, State

__all__ = ["add", "merged"]


def add(builder: Builder, graph: Graph) -> list[int]:
    """Put a graph into a builder; returns the new number of each node."""
    return _copy(builder, graph, range(len(graph.states)))


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
        builder = Builder()
        number = _copy(builder, graph, kept)
        names = {name: number[at] for name, at in graph.names.items()}
        graph = builder.finish(names, graph.units, graph.outputs)
    return graph


def _copy(builder: Builder, graph: Graph, kept: Sequence[int]) -> list[int]:
    """Copy the nodes, memory i as memory `kept[i]`."""
    reads = {which: builder.state(graph.states[which].latency) for which in dict.fromkeys(kept)}
    number: list[int] = []
    renumber: Callable[[int], int] = number.__getitem__
    for op, args, payload in graph.nodes:
        state = reads[kept[payload]] if op == "state" else None
        number.append(builder.node(op, tuple(map(renumber, args)), payload) if state is None else state)
    for which, read in reads.items():
        state_ = graph.states[which]
        builder.close(read, number[state_.init], number[state_.next])
    return number
