"""Generic graph passes: ancestors, dependents, and rewriting node by node."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import Graph, Node, State, extract


def ancestors(
    nodes: Sequence[Node], roots: Iterable[int], active: Collection[int] | None = None, without: Collection[int] = ()
) -> list[int]:
    """Return the nodes from which the roots are computed within a step, roots included, in topological order.

    If `active` is given, the walk visits only its nodes; it does not enter nodes of `without`.
    """
    seen = set(roots)
    stack = list(seen)
    while stack:
        for a in nodes[stack.pop()].args:
            if a not in seen and a not in without and (active is None or a in active):
                seen.add(a)
                stack.append(a)
    # arguments have lower numbers than what is computed from them
    return sorted(seen)


def ancestors_in_time(graph: Graph, roots: Iterable[int]) -> set[int]:
    r"""Return the nodes from which the roots are computed, through states as well, roots included.

    >>> from kennfeld.models.formula import formula
    >>> graph = formula("y = prev(w, 0)\nw = u\nother = v").graph
    >>> nodes = [graph.nodes[at] for at in ancestors_in_time(graph, [graph.names["y"]])]
    >>> [node.payload for node in nodes if node.op == "input"]
    ['u']
    """
    reached: set[int] = set()
    ends = {*roots}
    while ends:
        added = {*ancestors(graph.nodes, ends, without=reached)}
        reached |= added
        states = [graph.states[graph.nodes[at].payload] for at in added if graph.nodes[at].op == "state"]
        ends = {at for state in states for at in (state.init, state.next)} - reached
    return reached


def rewrite(graph: Graph, resolve: Callable[[GraphBuilder, int, tuple[int, ...]], int]) -> Graph:
    """Return the graph with each node replaced by `resolve(builder, node, new arguments)`."""
    b = GraphBuilder()
    b.states.extend(graph.states)
    number: list[int] = []
    for at, node in enumerate(graph.nodes):
        number.append(resolve(b, at, tuple(number[a] for a in node.args)))
    # in the numbers of the new nodes, which `extract` reduces
    states = [State(number[s.init], number[s.next], s.latency) for s in graph.states]
    names = {name: number[at] for name, at in graph.names.items()}
    return extract(b.nodes, states, names, graph.units, graph.outputs)


def dependents(graph: Graph, source: Callable[[Node], bool], *, through_states: bool = True) -> set[int]:
    """Return the nodes that depend on a node for which `source` is true, through states as well by default."""
    live = _forward(graph.nodes, source, ())
    while through_states:
        # reads of states come before what is written to them: another pass, until no state joins
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


def with_names(graph: Graph, extra: Mapping[int, str]) -> Graph:
    """Return the graph with additional nodes named."""
    if not extra:
        return graph
    names = {**graph.names, **{name: at for at, name in extra.items()}}
    return GraphBuilder.of(graph).finish(names, graph.units, graph.outputs)


def named_lookups(graph: Graph) -> dict[str, tuple[str, ...]]:
    """Return for each parameter the named nodes in whose own expression it is looked up."""
    named = set(graph.names.values())
    users: dict[str, tuple[str, ...]] = {}
    for name, root in graph.names.items():
        reached = (graph.nodes[at].parameter for at in ancestors(graph.nodes, [root], without=named))
        for parameter in filter(None, reached):
            users[parameter] = (*users.get(parameter, ()), name)
    return users


def named_sources(graph: Graph) -> dict[str, tuple[str, ...]]:
    """Return for each named node the named nodes and inputs from which its own expression computes it.

    A state reads what its next and its first value read. A second name of a node is computed from the first name.
    """
    names: dict[int, str] = {}
    for name, at in graph.names.items():
        names.setdefault(at, name)
    return {name: (names[at],) if names[at] != name else _sources(graph, at, names) for name, at in graph.names.items()}


def _sources(graph: Graph, root: int, names: Mapping[int, str]) -> tuple[str, ...]:
    sources: dict[str, None] = {}
    seen, stack = {root}, [root]
    while stack:
        op, args, payload = graph.nodes[stack.pop()]
        for at in graph.states[payload][:2] if op == "state" else args:
            if at in names:
                sources[names[at]] = None
            elif graph.nodes[at].op == "input":
                sources[str(graph.nodes[at].payload)] = None
            elif at not in seen:
                seen.add(at)
                stack.append(at)
    return tuple(sources)


def coordinates_of(graph: Graph, parameter: str) -> Sequence[str]:
    """Return the name of each coordinate of a lookup, empty for expressions without a name.

    >>> from kennfeld.models.formula import formula
    >>> coordinates_of(formula("y = M(Speed, a + b)").graph, "M")
    ['Speed', '']
    """
    # of several names of a node, the first one counts
    names: Mapping[int, str] = {at: name for name, at in reversed(list(graph.names.items()))}
    for node in graph.nodes:
        if node.op == "lookup" and node.payload == parameter:
            return [
                str(graph.nodes[at].payload) if graph.nodes[at].op == "input" else names.get(at, "") for at in node.args
            ]
    return []
