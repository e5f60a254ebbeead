"""Hypothesis strategies for graphs, as the builder makes them: states, delays and feedback included."""

import math
from dataclasses import replace

from hypothesis import strategies as st

from kennfeld.graph import CLOCK, OPERATIONS, Graph, GraphBuilder, Node

NAMES = ["y", "n.eng", "Ü", "two words", "rad[3].x", "50%", "pi", "t", "not", "abs", "map", "_1", "_2", "%", "#", " "]
OPS = sorted(set(OPERATIONS) - {"guard"})
UNITS = ["", "-", "1/min", "%", "°C", "Nm/(rad/s)", "#"]
numbers = st.one_of(
    st.sampled_from([0.0, 1.0, -1.0, 0.5, 2.0, 1e300, 5e-324, float("inf"), float("-inf")]),
    st.floats(allow_nan=False),
    st.integers(-100, 100).map(float),
)


def one_nan(graph: Graph) -> Graph:
    """The graph with one NaN for all, since a tuple equals another one only if it holds the very same NaN."""
    nodes = (Node("const", (), math.nan) if n.op == "const" and math.isnan(n.payload) else n for n in graph.nodes)
    return replace(graph, nodes=tuple(nodes))


@st.composite
def graphs(draw: st.DrawFn) -> Graph:
    """A graph of up to some forty nodes."""
    b = GraphBuilder()
    spare = draw(st.permutations(NAMES))
    inputs, scalars, tables, named = spare[:3], spare[3:5], spare[5:8], spare[8:]
    axes = [draw(st.integers(1, 4)) for _ in tables]
    nodes = [b.input(name) for name in inputs] + [b.lookup(name) for name in scalars]
    nodes += [b.input(name) for name in CLOCK]
    nodes += [b.const(draw(numbers)) for _ in range(draw(st.integers(0, 3)))]
    open_states = [b.state(draw(st.sampled_from([1, 1, 1, 2, 7]))) for _ in range(draw(st.integers(0, 3)))]
    nodes += open_states
    for _ in range(draw(st.integers(1, 30))):
        kind = draw(st.sampled_from(["operation"] * 6 + ["table", "prev"]))
        recent = st.sampled_from(nodes[-6:] if draw(st.booleans()) else nodes)
        if kind == "operation":
            op = draw(st.sampled_from(OPS))
            node = b.call(op, *(draw(recent) for _ in range(OPERATIONS[op].arity)))
        elif kind == "table":
            which = draw(st.integers(0, len(tables) - 1))
            node = b.lookup(tables[which], *(draw(recent) for _ in range(axes[which])))
        else:
            node = b.prev(draw(recent), draw(st.sampled_from(nodes[:5])), draw(st.integers(1, 3)))
        nodes.append(node)
    for state in open_states:
        b.close(state, draw(st.sampled_from(nodes[:5])), draw(st.sampled_from(nodes)))
    picked = draw(st.lists(st.sampled_from(nodes), min_size=1, max_size=len(named)))
    names = dict(zip(named, [nodes[-1], *picked], strict=False))
    graph = b.finish(names)
    known = [*graph.names, *graph.inputs, *graph.parameters]
    units = {name: unit for name in known if (unit := draw(st.sampled_from(UNITS)))}
    outputs = draw(st.lists(st.sampled_from(list(names)), unique=True))
    return b.finish(names, units, outputs)
