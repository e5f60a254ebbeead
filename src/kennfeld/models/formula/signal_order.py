"""The order of statements by signal flow: what a node needs stands above it, wherever feedback permits."""

from collections.abc import Iterable, Mapping

from kennfeld.graph import Graph
from kennfeld.models.formula.lowering import topological_order


def signal_order(graph: Graph) -> list[str]:
    r"""Return the names of a graph in the order of signal flow, from inputs to outputs.

    >>> from kennfeld.models.formula import formula
    >>> signal_order(formula("torque = 2 * air\nair = flow / n\noutput torque").graph)
    ['air', 'torque']
    """
    uses = named_uses(graph)
    roots = dict.fromkeys((*graph.outputs, *graph.names))
    return topological_order({name: uses[name] for name in roots})[0]


def section_order(names: Iterable[str], sections: Mapping[str, str], uses: Mapping[str, Iterable[str]]) -> list[str]:
    """Return names grouped by their sections, both in the order of signal flow; `names` are in this order already."""
    ordered = list(names)
    # the sections that end in outputs are the last names, and lead to all others
    needs: dict[str, dict[str, None]] = {sections[name]: {} for name in reversed(ordered)}
    for name in ordered:
        needs[sections[name]].update(dict.fromkeys(sections[used] for used in uses[name] if used in sections))
    place = {section: at for at, section in enumerate(topological_order(needs)[0])}
    return sorted(ordered, key=lambda name: place[sections[name]])


def named_uses(graph: Graph) -> dict[str, list[str]]:
    """Return the names that each name uses directly, also through memory."""
    first: dict[int, str] = {}
    for name, at in graph.names.items():
        # an input or a constant is used itself, not by its second name
        if graph.nodes[at].args or graph.nodes[at].op == "state":
            first.setdefault(at, name)
    # a second name of a node refers to the first one
    return {
        name: _first_named(graph, at, first) if first.get(at, name) == name else [first[at]]
        for name, at in graph.names.items()
    }


def _first_named(graph: Graph, root: int, first: Mapping[int, str]) -> list[str]:
    names: dict[str, None] = {}
    seen: set[int] = set()
    stack = list(reversed(_parts(graph, root)))
    while stack:
        at = stack.pop()
        if at in first:
            names[first[at]] = None
        elif at not in seen:
            seen.add(at)
            stack += reversed(_parts(graph, at))
    return list(names)


def _parts(graph: Graph, at: int) -> tuple[int, ...]:
    op, args, payload = graph.nodes[at]
    return args if op != "state" else (graph.states[payload].next, graph.states[payload].init)
