"""The graph of one time step: immutable, hash-consed nodes in topological order.

A graph computes outputs and next states from inputs, parameters and states. Memory has one form, `State`:
a value that is read `latency` steps after it was written. `prev` is latency 1, a delay of n steps latency n.

On uneven time, a sample k lies between two steps of different length. Which one an update takes follows from the sample
whose value it computes:

- the value at k, from inputs at k and states at k - 1, takes `STEP`, t[k] - t[k-1]: implicit Euler (PT1), rates;
- the value at k + 1, from inputs and states at k, takes `NEXT_STEP`, t[k+1] - t[k]: explicit methods, which are forward
  Euler and all solvers of continuous states.

On even time both are the same number.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field
from typing import Any, NamedTuple

from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass

STEP = "dt"
NEXT_STEP = "dt_next"
TIME = "t"
STEPS = (STEP, NEXT_STEP)
CLOCK = (*STEPS, TIME)


class Node(NamedTuple):
    """One operation on earlier nodes.

    Elementwise operations are those of `OPERATIONS`. The others:

    | op | args | payload |
    |---|---|---|
    | const | | its value, a float |
    | input | | channel name; `dt`, `dt_next`, `t` are the steps before and after, and the time in the piece, in s |
    | state | | index into `Graph.states` |
    | lookup | coordinates, none for a scalar | parameter name |
    | external | as the function has them | `ExternalOutput`; an output of a function outside of the graph |
    | external_slope | as external | (`ExternalOutput`, axis); the slope of external along its argument `axis` |
    | dense | as the layer has inputs | `DenseOutput`; an output of a dense layer |
    | dense_slope | as dense | (`DenseOutput`, axis); the slope of dense along its argument `axis` |
    | dense_pull | inputs of a layer, an adjoint an output | (`DenseLayer`, axis); the adjoint of its input `axis` |

    Until a solver has been applied (`integration.py`), there are two more:

    | op | args | payload |
    |---|---|---|
    | advance | value at the start of the step, derivative, lower and upper limit | |
    | hold | x, constant within the step of the solver | |

    Preparation for a set of parameters (`lookup_lowering.py`) replaces lookups by:

    | op | args | payload |
    |---|---|---|
    | position | x | `AxisRef`; the index of the cell that holds x plus the fraction within it |
    | density | x | `AxisRef`; the slope of position, 1/width of the cell, 0 if clipped |
    | interpolate | a position an axis, or x itself if the axis is smoothed | `TableRef` |
    | slope | as interpolate | (`TableRef`, axis); the slope of interpolate along its argument `axis` |
    | expansion | coordinates | `ExpansionRef`; the value of a parameter of kind rbf |
    | expansion_slope | as expansion | (`ExpansionRef`, axis); the slope of expansion along its argument `axis` |
    """

    op: str
    args: tuple[int, ...] = ()
    payload: Any = None

    @property
    def parameter(self) -> str | None:
        """The parameter that the node looks up, or whose values are the weights of its layer; None for others."""
        if self.op == "lookup":
            return str(self.payload)
        return str(self.payload.name) if self.op == "dense" else None


class State(NamedTuple):
    """A state: starts with node `init` at the first sample, then holds the value of node `next` `latency` steps ago."""

    init: int
    next: int
    latency: int = 1


@dataclass(frozen=True)
class Graph:
    """The graph of one time step of a model.

    Node numbers are canonical: graphs built from equal definitions are equal.

    Attributes:
        nodes: all operations; each refers to earlier ones by number.
        names: the nodes visible to the user, in their order, with their numbers.
        states: the memory of the model.
        units: units of names and inputs.
        outputs: the names declared as outputs; without a declaration, the names that no other node uses.

    >>> from kennfeld import formula
    >>> graph = formula("y[Nm] = PT1(Gain(u), 2.0)").graph
    >>> graph.inputs, dict(graph.parameters), graph.is_timed
    (('u',), {'Gain': 1}, True)
    """

    nodes: tuple[Node, ...]
    names: Mapping[str, int]
    states: tuple[State, ...] = ()
    units: Mapping[str, str] = field(default_factory=lambda: FrozenDict({}))
    outputs: tuple[str, ...] = ()

    @property
    def inputs(self) -> tuple[str, ...]:
        """The input channels, in the order of their first use."""
        return tuple(dict.fromkeys(n.payload for n in self.nodes if n.op == "input" and n.payload not in CLOCK))

    @property
    def clocks(self) -> set[str]:
        """Names of the clock inputs, time and steps, that the graph reads."""
        return {n.payload for n in self.nodes if n.op == "input" and n.payload in CLOCK}

    @property
    def is_timed(self) -> bool:
        """True if the step matters: the graph has memory, or reads the time or the step."""
        return bool(self.states or self.clocks)

    @property
    def parameters(self) -> Mapping[str, int]:
        """The parameters that the graph uses, with their numbers of axes; the weights of a layer have two."""
        names = {at: node.parameter for at, node in enumerate(self.nodes)}
        sizes = {at: 2 if node.op == "dense" else len(node.args) for at, node in enumerate(self.nodes)}
        return {name: sizes[at] for at, name in names.items() if name is not None}

    @property
    def layers(self) -> set[str]:
        """The parameters with the weights of dense layers."""
        return {node.payload.name for node in self.nodes if node.op == "dense"}


def extract(
    nodes: Sequence[Node],
    states: Sequence[State],
    names: Mapping[str, int],
    units: Mapping[str, str],
    outputs: Sequence[str],
) -> Graph:
    """Return the part of a graph that the names need, numbered depth first in the order of the names."""
    order = _Order(nodes)
    for root in names.values():
        order.visit(root)
    for which in order.states:  # grows while it is walked: a state may need further states
        order.visit(states[which].init)
        order.visit(states[which].next)
    number = order.number
    renamed = {name: number[at] for name, at in names.items()}
    memories = tuple(State(number[states[w].init], number[states[w].next], states[w].latency) for w in order.states)
    return Graph(
        tuple(order.kept),
        FrozenDict(renamed),
        memories,
        FrozenDict(dict(units)),
        tuple(outputs) or _sinks(order.kept, memories, renamed),
    )


class _Order:
    """Nodes in the order in which a walk first completes them, and the states on the way."""

    def __init__(self, nodes: Sequence[Node]) -> None:
        self.nodes = nodes
        self.number: dict[int, int] = {}
        self.kept: list[Node] = []
        self.states: list[int] = []
        self._places: dict[int, int] = {}  # of states in the list

    def visit(self, root: int) -> None:
        """Number a node and all its ancestors within the step."""
        stack = [root]
        while stack:
            at = stack[-1]
            # reversed, so that the first argument is numbered first
            missing = [] if at in self.number else [a for a in reversed(self.nodes[at].args) if a not in self.number]
            if missing:
                stack.extend(missing)
                continue
            stack.pop()
            if at not in self.number:
                self._keep(at)

    def _keep(self, at: int) -> None:
        op, args, payload = self.nodes[at]
        if op == "state":
            # states are numbered in the order in which they are first read
            if payload not in self._places:
                self._places[payload] = len(self.states)
                self.states.append(payload)
            payload = self._places[payload]
        self.number[at] = len(self.kept)
        self.kept.append(Node(op, tuple(self.number[a] for a in args), payload))


def _sinks(nodes: Sequence[Node], states: Sequence[State], names: Mapping[str, int]) -> tuple[str, ...]:
    """Return the names that no other name uses; feedback through a state onto itself does not count."""
    named = set(names.values())
    needs = {at: _named_before(nodes, states, at, named) for at in named}
    users: dict[int, set[int]] = {at: set() for at in named}
    for user, used in needs.items():
        for at in used - {user}:
            users[at].add(user)
    # names that use each other round a loop are one: such use does not make them inner nodes
    loop = _loops(needs, users)
    return tuple(name for name, at in names.items() if all(loop[user] == loop[at] for user in users[at]))


def _named_before(nodes: Sequence[Node], states: Sequence[State], root: int, named: Collection[int]) -> set[int]:
    """Return the named nodes on which a node depends, without those behind them."""
    result: set[int] = set()
    seen: set[int] = set()
    stack = [root]
    while stack:
        op, args, payload = nodes[stack.pop()]
        behind = (states[payload].init, states[payload].next) if op == "state" else args
        for at in behind:
            if at in named:
                result.add(at)
            elif at not in seen:
                seen.add(at)
                stack.append(at)
    return result


def _loops(needs: Mapping[int, set[int]], users: Mapping[int, set[int]]) -> dict[int, int]:
    """Return a representative of the strongly connected component of each name, by Kosaraju's algorithm.

    `scipy.sparse.csgraph` does the same, but its import takes longer than a whole small calibration.
    """
    loop: dict[int, int] = {}
    # the second walk goes against the edges of the first one; what it reaches is one component
    for root in reversed(_in_postorder(needs)):
        stack = [root]
        while stack:
            at = stack.pop()
            if at not in loop:
                loop[at] = root
                stack.extend(users[at])
    return loop


def _in_postorder(needs: Mapping[int, set[int]]) -> list[int]:
    """Return the names in the postorder of a depth-first walk along `needs`."""
    ordered: list[int] = []
    seen: set[int] = set()
    for root in needs:
        stack = [] if root in seen else [(root, iter(needs[root]))]
        seen.add(root)
        while stack:
            at, behind = stack[-1]
            following = next((used for used in behind if used not in seen), None)
            if following is None:
                ordered.append(at)
                stack.pop()
            else:
                seen.add(following)
                stack.append((following, iter(needs[following])))
    return ordered
