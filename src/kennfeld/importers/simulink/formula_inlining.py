"""Blocks that formula text writes where they are used: small ones that nobody has named."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping

from kennfeld.graph import Graph
from kennfeld.importers.simulink.reader.model_tree import split_path

# the names that the library gives to blocks of arithmetic, comparison and logic
_LIBRARY_NAMES = re.compile(
    r"(Abs|Add|Bias|Compare To (Constant|Zero)|Cos|Divide|Fcn|Gain|Logical Operator|Math Function|Max|Min|MinMax"
    r"|Product|Reciprocal|Relational Operator|Sign|Sin|Sqrt|Square|Square Root|Subtract|Sum|Trigonometric Function"
    r"|Unary Minus)\d*"
)
_MOST_PARTS = 6  # operations of a block in the line of another
_MANY_PARTS = 100  # where counting ends, as shared nodes count each time
_NEVER = ("state", "advance", "hold", "select")


def written_in_place(graph: Graph, names: Iterable[str], blocks: Mapping[str, str]) -> list[str]:
    """Return the names that keep their own lines, in their order.

    A block loses its line if it has a name of the library, one other block of its subsystem uses it, and the line of
    that one stays short.
    """
    names = list(names)
    uses = _uses(graph)
    named = {graph.names[name]: name for name in reversed(names)}
    outputs = {graph.names[name] for name in graph.outputs}
    repeated = Counter(graph.names[name] for name in names)
    parts, dropped = [0] * len(graph.nodes), set[str]()
    for at, node in enumerate(graph.nodes):
        if node.args:
            # arguments have smaller numbers: what is written in place of each is known
            parts[at] = min(_MANY_PARTS, 1 + sum(parts[a] for a in set(node.args) if a not in named))
        if at in named and at not in outputs and repeated[at] == 1 and node.op not in _NEVER:
            owner = _only_user(graph, at, uses, named)
            name = named[at]
            if (
                owner
                and parts[at] <= _MOST_PARTS
                and _LIBRARY_NAMES.fullmatch(split_path(blocks[name])[-1])
                and name.startswith(blocks[name])
                and split_path(blocks[owner])[:-1] == split_path(blocks[name])[:-1]
            ):
                dropped.add(name)
                del named[at]
    return [name for name in names if name not in dropped]


def _uses(graph: Graph) -> dict[int, list[int]]:
    """Return the nodes that use each node: a state for its next and initial value."""
    users: dict[int, list[int]] = {}
    reads = {node.payload: at for at, node in enumerate(graph.nodes) if node.op == "state"}
    for at, node in enumerate(graph.nodes):
        for arg in node.args:
            users.setdefault(arg, []).append(at)
    for which, state in enumerate(graph.states):
        for at in (state.next, state.init):
            users.setdefault(at, []).append(reads[which])
    return users


def _only_user(graph: Graph, at: int, users: Mapping[int, list[int]], named: Mapping[int, str]) -> str:
    """Return the name in whose line a node would be written; "" if it is used more than once."""
    seen = {at}
    while True:
        own = users.get(at, [])
        if len(own) != 1 or own[0] in seen:
            return ""
        at = own[0]
        seen.add(at)
        if at in named:
            return named[at]
