"""Detection of discontinuities whose time depends on parameters, which derivatives do not see.

A relay, a counter or a rounded value changes in steps. If parameters decide when, the cost is discontinuous as well,
and its exact derivatives do not describe it. A condition alone is no indication: `if(x > 0, x, 0)` has a kink but no
jump. Jumps are therefore found numerically: inputs, states and lookups get random values, the point at which a
condition changes is located, and outputs and next states are compared on both sides. The difference of a jump stays the
same as the sides approach each other; it vanishes at a kink, and grows at a pole, which no value can cross.

A condition may also change because a value in it jumps. If the data alone decide that jump, as that of a flag for the
first sample, they decide when the condition changes.
"""

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.node import Graph, Node
from kennfeld.graph.operations import OPERATIONS
from kennfeld.graph.traversal import ancestors, dependents

POINTS = 256  # random points, between neighbours of which a condition may change
HALVINGS = 22  # of the way between two points, after which its ends are compared; and again after as many more
SHRUNK = 0.1  # of the first difference; what is continuous has become far smaller at the second
GROWN = 1e3  # times the first difference; beyond, the condition guards a pole: `if(x == 0, a, a / x)`
JUMP = 1e-9  # of an end's size; what is smaller is rounding
MAX_CHANGES = 8  # changes looked at for each condition
LEAVES = ("input", "state", "lookup", "external", "dense")  # nodes to which any value is given
EQUALITIES = ("eq", "ne")
MAX_CONDITIONS = 64  # conditions looked at in a graph that has more
_WORDS = {op: op for op in ("floor", "ceil", "round", "sign", "mod")}
_WORDS |= {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}


@dataclass(frozen=True)
class Event:
    """A discontinuous node: its operator in formula text (`floor`, `>=`), its parameters, and its name."""

    node: int
    word: str
    name: str
    parameters: tuple[str, ...]


def events(graph: Graph, free: Collection[str], outputs: Collection[str] = ()) -> tuple[Event, ...]:
    """Return the discontinuities whose time depends on the parameters `free` and which affect the outputs, in graph
    order.

    `outputs` are names of nodes, by default the outputs of the graph. In a very large graph only some of the conditions
    are examined.

    >>> from kennfeld.models.formula import formula
    >>> graph = formula("y = max(Gain(u), 0) + round(Gain(u))").graph
    >>> [(event.name, event.word, event.parameters) for event in events(graph, ["Gain"])]
    [('y', 'round', ('Gain',))]
    """
    moving = dependents(graph, lambda node: node.parameter in free)
    ends, needed = _needed(graph, [graph.names[name] for name in outputs or graph.outputs])
    candidates = [
        at for at in sorted(needed & moving) if graph.nodes[at].op in _WORDS and not _tests_nan(graph.nodes[at])
    ]
    if not candidates:
        return ()
    jumping = _Step(graph, ends, moving).jumping(candidates[:: -(-len(candidates) // MAX_CONDITIONS)])
    reach = {name: dependents(graph, partial(_looks_up, name)) for name in (free if jumping else ())}
    return tuple(
        Event(at, _WORDS[graph.nodes[at].op], _user(graph, at), tuple(name for name in reach if at in reach[name]))
        for at in jumping
    )


def _tests_nan(node: Node) -> bool:
    """Return if a node is `x != x` or `x == x`, which changes for no number."""
    return node.op in EQUALITIES and node.args[0] == node.args[1]


class _Step:
    """One time step evaluated at random points; its leaves are inputs, states, lookups and called functions.

    Args:
        graph: of the step.
        ends: outputs and next states.
        moving: nodes that depend on free parameters.
    """

    def __init__(self, graph: Graph, ends: Sequence[int], moving: Collection[int]) -> None:
        self.graph, self.ends = graph, ends
        self.cone = ancestors(graph.nodes, ends)
        choices = {graph.nodes[at].args[0] for at in self.cone if graph.nodes[at].op == "select"}
        self.settled_choices = sorted(choices.difference(moving))
        self.settled_jumps = [at for at in self.cone if graph.nodes[at].op in _WORDS and at not in moving]
        self.leaves = [at for at in self.cone if graph.nodes[at].op in LEAVES]
        self.random = np.random.default_rng(0)
        self.points = self._points()

    def _points(self) -> Float:
        """Draw values of the leaves, shape (leaves, points), of all magnitudes, often close to graph constants."""
        shape = (len(self.leaves), POINTS)
        sizes = 10.0 ** self.random.uniform(-3, 4, shape)
        numbers = [n.payload for n in self.graph.nodes if n.op == "const" and np.isfinite(n.payload)]
        near = self.random.choice(np.array([0.0, 1.0, *numbers]), shape)
        signed = sizes * np.where(self.random.uniform(size=shape) < 0.75, 1.0, -1.0)
        scattered = near + self.random.normal(size=shape) * 0.3 * np.maximum(np.abs(near), 0.1)
        kind = self.random.integers(0, 3, shape)
        # any magnitude, near a constant of the graph, or exactly at it, where conditions compare
        points: Float = np.choose(kind, [signed, scattered, near])
        return points

    def jumping(self, candidates: Sequence[int]) -> list[int]:
        """Return the candidates at whose changes an end jumps, and those that never changed."""
        cone = ancestors(self.graph.nodes, candidates)
        far = self._evaluate(self.points, cone)
        levels = [self._level(at, far) for at in candidates]
        origins = [_find_changes(level) for level in levels]
        parts = [slice(a, b) for a, b in pairwise(np.cumsum([0, *(origin.size for origin in origins)]).tolist())]
        first = np.concatenate([level[origin] for level, origin in zip(levels, origins, strict=True)])
        origin = np.concatenate(origins)
        # bisection between two neighbouring points, for all changes of all conditions at once
        low, high = self.points[:, origin], self.points[:, (origin + 1) % POINTS]
        # at an equality of continuous values no point lies, so that beside it the condition itself is changed
        equal = {at: part for at, part in zip(candidates, parts, strict=True) if self.graph.nodes[at].op in EQUALITIES}
        gaps = []
        for _ in range(2):
            for _ in range(HALVINGS):
                middle = 0.5 * low + 0.5 * high
                values = self._evaluate(middle, cone)
                level = np.concatenate([self._level(at, values)[p] for at, p in zip(candidates, parts, strict=True)])
                low, high = np.where(level == first, middle, low), np.where(level == first, high, middle)
            # after 22 and 44 halvings: the gap of a jump is the same, that of a kink 2^-22 of it
            gaps.append(self._gaps(low, high, equal))
        apart = (gaps[1] > SHRUNK * gaps[0]) & (gaps[1] > JUMP * self._sizes(origin))
        # what grows as the sides approach is a pole
        apart &= gaps[1] < GROWN * gaps[0]
        apart &= ~self._data_decide(low, high)
        jumps = np.logical_or.reduce(apart, axis=0)
        # an equality jumps in general or, where two values happen to be 0 at once, at a corner that no data reach
        least = {at: 0.5 if at in equal else 0.0 for at in candidates}
        return [
            at
            for at, part in zip(candidates, parts, strict=True)
            # a condition that never changed at these points may jump elsewhere
            if part.start == part.stop or jumps[part].mean() > least[at]
        ]

    def _level(self, at: int, values: Mapping[int, Float]) -> Float:
        """Return the value of a discontinuous node; for `mod`, which varies in between, the number of its jumps.

        For an equality it is the sign of the difference of both sides.
        """
        op, args, _ = self.graph.nodes[at]
        if op in EQUALITIES:
            with np.errstate(invalid="ignore"):
                return np.asarray(np.sign(values[args[0]] - values[args[1]]))
        if op != "mod":
            return values[at]
        with np.errstate(all="ignore"):
            whole: Float = np.floor(values[args[0]] / values[args[1]])
        return whole

    def _gaps(self, low: Float, high: Float, equal: Mapping[int, slice]) -> Float:
        """Compute the differences of the ends, shape (ends, changes); 0 if one is not finite.

        For the changes of equalities, the other side is that on which they have the opposite value.
        """
        beside = high.copy()
        for part in equal.values():
            beside[:, part] = low[:, part]
        before, after = self._evaluate(low, self.cone), self._evaluate(beside, self.cone, equal)
        with np.errstate(all="ignore"):
            gaps = np.array([np.abs(after[end] - before[end]) for end in self.ends])
        finite: Float = np.nan_to_num(gaps, nan=0.0, posinf=0.0)
        return finite

    def _data_decide(self, low: Float, high: Float) -> Bool:
        """Return for each change if a condition that depends on no free parameter changes with it."""
        below, above = (self._evaluate(side, self.cone) for side in (low, high))
        changes = np.zeros(low.shape[1], dtype=bool)
        for at in self.settled_choices:  # every value but 0 is true
            changes |= (below[at] != 0) != (above[at] != 0)
        for at in self.settled_jumps:
            changes |= self._level(at, below) != self._level(at, above)
        return changes

    def _sizes(self, origin: Int) -> Float:
        """Compute the magnitudes of the ends near the changes and in general, shape (ends, changes)."""
        far = self._evaluate(self.points, self.cone)
        with np.errstate(all="ignore"):
            way = np.nan_to_num(np.abs([far[end] for end in self.ends]), nan=0.0, posinf=0.0)
        sizes: Float = way[:, origin] + way[:, (origin + 1) % POINTS] + np.median(way, axis=1, keepdims=True)
        return sizes

    def _evaluate(
        self, points: Float, cone: Sequence[int], opposite: Mapping[int, slice] = FrozenDict({})
    ) -> dict[int, Float]:
        """Evaluate these nodes; a lookup is its random value plus a smooth function of its coordinates; a call too.

        Some conditions have the `opposite` value at some points.
        """
        row = {at: points[i] for i, at in enumerate(self.leaves)}
        values: dict[int, Float] = {}
        with np.errstate(all="ignore"):
            for at in cone:
                op, args, payload = self.graph.nodes[at]
                if op == "const":
                    values[at] = np.full(points.shape[1], payload)
                elif at in row:
                    # smooth and limited: a table itself does not jump
                    values[at] = sum((np.tanh(values[a]) for a in args), row[at])
                else:
                    values[at] = np.array(OPERATIONS[op].evaluate(*(values[a] for a in args)), dtype=np.float64)
                if at in opposite:
                    values[at][opposite[at]] = 1.0 - values[at][opposite[at]]
        return values


def _find_changes(level: Float) -> Int:
    following = np.roll(level, -1)
    with np.errstate(invalid="ignore"):
        apart = np.isfinite(level) & np.isfinite(following) & (level != following)
    return np.flatnonzero(apart)[:MAX_CHANGES]


def _looks_up(parameter: str, node: Node) -> bool:
    return node.parameter == parameter


def _needed(graph: Graph, outputs: Sequence[int]) -> tuple[list[int], set[int]]:
    """Return the outputs, the first and next values of the states they need, and all ancestors of these."""
    ends = set(outputs)
    while True:
        cone = set(ancestors(graph.nodes, ends))
        states = [graph.states[node.payload] for node in (graph.nodes[at] for at in cone) if node.op == "state"]
        grown = ends | {end for state in states for end in (state.init, state.next)}
        if grown == ends:
            return sorted(ends), cone
        ends = grown


def _user(graph: Graph, at: int) -> str:
    """Return the first named node that depends on a node, through states only if no other does; "" if none does."""
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
    """Return the nodes that use one of these directly, and the reads of the states that hold them."""
    used = set(nodes)
    holding = {i for i, s in enumerate(graph.states) if s.next in used or s.init in used}
    return [
        at
        for at, node in enumerate(graph.nodes)
        if not used.isdisjoint(node.args) or (node.op == "state" and node.payload in holding)
    ]
