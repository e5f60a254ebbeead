"""Events whose time depends on parameters: jumps that derivatives do not see.

A relay, a counter or a rounded number changes in steps. Where parameters decide when, the cost has steps as well, and
its derivatives are exact and useless. Not each condition is such an event: `if(x > 0, x, 0)` has a kink and no jump.
What tells them apart is measured: inputs, states and lookups are given random values, the place is found at which a
condition changes, and outputs and next states are compared on its two sides.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.graph.node import Graph
from kennfeld.graph.operations import OPERATIONS
from kennfeld.graph.traversal import dependent

__all__ = ["Event", "events"]

POINTS = 256  # random points, between neighbours of which a condition may change
HALVINGS = 22  # of the way between two points, after which its ends are compared; and again after as many more
SHRUNK = 0.1  # of the first difference; what is continuous has become far smaller at the second
JUMP = 1e-9  # of an end's size; what is smaller is rounding
TRIED = 8  # changes looked at for each condition
MOST = 64  # conditions looked at in a graph that has more
_WORDS = {
    "floor": "floor",
    "ceil": "ceil",
    "round": "round",
    "sign": "sign",
    "mod": "mod",
    "lt": "<",
    "le": "<=",
    "gt": ">",
    "ge": ">=",
    "eq": "==",
    "ne": "!=",
}


@dataclass(frozen=True)
class Event:
    """A node that jumps, as the text writes it (`floor`, `>=`), the parameters that decide when, and its named node."""

    node: int
    word: str
    name: str
    parameters: tuple[str, ...]


def events(graph: Graph, free: Collection[str], outputs: Collection[str] = ()) -> tuple[Event, ...]:
    """The events whose time depends on the parameters `free`, and which the outputs feel, in the order of the graph.

    Without `outputs`, names of nodes, those of the graph are meant. Where there are very many conditions, some of them
    are looked at.

    >>> from kennfeld.models.formula import formula
    >>> graph = formula("y = max(Gain(u), 0) + round(Gain(u))").graph
    >>> [(event.name, event.word, event.parameters) for event in events(graph, ["Gain"])]
    [('y', 'round', ('Gain',))]
    """
    moving = dependent(graph, lambda node: node.op == "lookup" and node.payload in free)
    ends, needed = _needed(graph, [graph.names[name] for name in outputs or graph.outputs])
    candidates = [at for at in sorted(needed & moving) if graph.nodes[at].op in _WORDS]
    if not candidates:
        return ()
    jumping = _Step(graph, ends).jumping(candidates[:: -(-len(candidates) // MOST)])
    reach = {name: _reached(graph, name) for name in free} if jumping else {}
    return tuple(
        Event(at, _WORDS[graph.nodes[at].op], _user(graph, at), tuple(name for name in reach if at in reach[name]))
        for at in jumping
    )


class _Step:
    """One time step on random points; inputs, states and lookups are its leaves."""

    def __init__(self, graph: Graph, ends: Sequence[int]) -> None:
        self.graph, self.ends = graph, ends
        self.cone = _cone(graph, ends)
        self.leaves = [at for at in self.cone if graph.nodes[at].op in ("input", "state", "lookup")]
        self.random = np.random.default_rng(0)
        self.points = self._points()

    def _points(self) -> Float:
        """Values of the leaves, shape (leaves, points): of all sizes, and often near a constant of the graph."""
        shape = (len(self.leaves), POINTS)
        sizes = 10.0 ** self.random.uniform(-3, 4, shape)
        numbers = [n.payload for n in self.graph.nodes if n.op == "const" and np.isfinite(n.payload)]
        near = self.random.choice(np.array([0.0, 1.0, *numbers]), shape)
        signed = sizes * np.where(self.random.uniform(size=shape) < 0.75, 1.0, -1.0)
        scattered = near + self.random.normal(size=shape) * 0.3 * np.maximum(np.abs(near), 0.1)
        kind = self.random.integers(0, 3, shape)
        points: Float = np.choose(kind, [signed, scattered, near])
        return points

    def jumping(self, candidates: Sequence[int]) -> list[int]:
        """Those of the candidates at whose changes an end jumps; and those that were never seen to change."""
        cone = _cone(self.graph, candidates)
        far = self._evaluate(self.points, cone)
        levels = [self._level(at, far) for at in candidates]
        origins = [_changes(level) for level in levels]
        parts = [slice(a, b) for a, b in pairwise(np.cumsum([0, *(origin.size for origin in origins)]).tolist())]
        first = np.concatenate([level[origin] for level, origin in zip(levels, origins, strict=True)])
        origin = np.concatenate(origins)
        low, high = self.points[:, origin], self.points[:, (origin + 1) % POINTS]
        gaps = []
        for _ in range(2):
            for _ in range(HALVINGS):
                middle = 0.5 * low + 0.5 * high
                values = self._evaluate(middle, cone)
                level = np.concatenate([self._level(at, values)[p] for at, p in zip(candidates, parts, strict=True)])
                low, high = np.where(level == first, middle, low), np.where(level == first, high, middle)
            gaps.append(self._gaps(low, high))
        apart = (gaps[1] > SHRUNK * gaps[0]) & (gaps[1] > JUMP * self._sizes(origin))
        jumps = np.logical_or.reduce(apart, axis=0)
        return [at for at, part in zip(candidates, parts, strict=True) if part.start == part.stop or jumps[part].any()]

    def _level(self, at: int, values: Mapping[int, Float]) -> Float:
        """The value of a node that jumps; of `mod`, which also moves in between, the number of its jumps."""
        op, args, _ = self.graph.nodes[at]
        if op != "mod":
            return values[at]
        with np.errstate(all="ignore"):
            whole: Float = np.floor(values[args[0]] / values[args[1]])
        return whole

    def _gaps(self, low: Float, high: Float) -> Float:
        """Differences of the ends, shape (ends, changes); 0 where one is not finite, which says nothing."""
        before, after = (self._evaluate(points, self.cone) for points in (low, high))
        with np.errstate(all="ignore"):
            gaps = np.array([np.abs(after[end] - before[end]) for end in self.ends])
        finite: Float = np.nan_to_num(gaps, nan=0.0, posinf=0.0)
        return finite

    def _sizes(self, origin: Int) -> Float:
        """What size the ends have where the changes were looked for, and usually; shape (ends, changes)."""
        far = self._evaluate(self.points, self.cone)
        with np.errstate(all="ignore"):
            way = np.nan_to_num(np.abs([far[end] for end in self.ends]), nan=0.0, posinf=0.0)
        sizes: Float = way[:, origin] + way[:, (origin + 1) % POINTS] + np.median(way, axis=1, keepdims=True)
        return sizes

    def _evaluate(self, points: Float, cone: Sequence[int]) -> dict[int, Float]:
        """The nodes of a cone; a lookup is its random value plus something smooth of its coordinates."""
        row = {at: points[i] for i, at in enumerate(self.leaves)}
        values: dict[int, Float] = {}
        with np.errstate(all="ignore"):
            for at in cone:
                op, args, payload = self.graph.nodes[at]
                if op == "const":
                    values[at] = np.full(points.shape[1], payload)
                elif at in row:
                    values[at] = sum((np.tanh(values[a]) for a in args), row[at])
                else:
                    values[at] = np.asarray(OPERATIONS[op].evaluate(*(values[a] for a in args)), dtype=np.float64)
        return values


def _changes(level: Float) -> Int:
    """Points between which and the next one a condition changes."""
    following = np.roll(level, -1)
    with np.errstate(invalid="ignore"):
        apart = np.isfinite(level) & np.isfinite(following) & (level != following)
    return np.flatnonzero(apart)[:TRIED]


def _cone(graph: Graph, roots: Sequence[int]) -> list[int]:
    """The nodes that the roots are computed from within the step, themselves included, in order."""
    seen = set(roots)
    stack = list(roots)
    while stack:
        for a in graph.nodes[stack.pop()].args:
            if a not in seen:
                seen.add(a)
                stack.append(a)
    return sorted(seen)


def _reached(graph: Graph, parameter: str) -> set[int]:
    return dependent(graph, lambda node: node.op == "lookup" and node.payload == parameter)


def _needed(graph: Graph, outputs: Sequence[int]) -> tuple[list[int], set[int]]:
    """What a step hands on, outputs and first and next values of the states they need; and all nodes behind that."""
    ends = set(outputs)
    while True:
        cone = set(_cone(graph, sorted(ends)))
        states = [graph.states[node.payload] for node in (graph.nodes[at] for at in cone) if node.op == "state"]
        grown = ends | {end for state in states for end in (state.init, state.next)}
        if grown == ends:
            return sorted(ends), cone
        ends = grown


def _user(graph: Graph, at: int) -> str:
    """The first named node that is computed from a node, through memory where nothing else is; empty if none is."""
    names: dict[int, str] = {node: name for name, node in reversed(list(graph.names.items()))}
    seen, front = {at}, [at]
    while front:
        named = [names[node] for node in sorted(front) if node in names]
        if named:
            return named[0]
        front = [user for user in _users(graph, front) if user not in seen]
        seen.update(front)
    return ""


def _users(graph: Graph, nodes: Collection[int]) -> list[int]:
    """The nodes that use one of these directly, and the reads of the states that hold them."""
    used = set(nodes)
    holding = {i for i, s in enumerate(graph.states) if s.next in used or s.init in used}
    return [
        at
        for at, node in enumerate(graph.nodes)
        if not used.isdisjoint(node.args) or (node.op == "state" and node.payload in holding)
    ]
