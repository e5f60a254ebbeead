"""Terms that may be missing: a correction at a node of a function, and the function with it."""

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from kennfeld.analysis.missing.recordings import RECORDING
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Map, Parameter, Scalar
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.graph.node import State, extract
from kennfeld.models import Model
from kennfeld.models.formula.functions import FUNCTIONS

Kind = Literal["add", "multiply", "lag", "delay", "offset"]
KINDS: tuple[Kind, ...] = ("add", "multiply", "lag", "delay", "offset")
OF_CHANNELS: tuple[Kind, ...] = ("add", "multiply")
Form = Literal["add", "multiply", "map", "lag", "delay", "offset"]  # of terms that take part in a search
FORMS: tuple[Form, ...] = ("add", "multiply", "map", "lag", "delay", "offset")
# makes the corrected node of a node; may add names of further nodes
Correction = Callable[[GraphBuilder, int, dict[str, int]], int]
_PREFIX = {"add": "Add", "multiply": "Scale", "lag": "Lag", "offset": "Offset"}


@dataclass(frozen=True)
class MissingTerm:
    """A correction at a node.

    | kind | the node becomes |
    |---|---|
    | add | node + curve(channel), or node + map(channel, second) |
    | multiply | node * curve(channel), or node * map(channel, second) |
    | lag | PT1(node, T), with a time constant T that is fitted |
    | delay | delay(node, steps) |
    | offset | node + an offset of each recording |

    Attributes:
        node: name of the node.
        kind: the form of the correction.
        channel: the input of the curve, the first one of a map.
        breakpoints: those of this input; of an offset the numbers of the recordings, and one for all others.
        seconds: time constant of a lag, from which its fit starts.
        steps: steps of a delay.
        second: the second input of a map; "" for all other terms.
        second_breakpoints: those of this input.
    """

    node: str
    kind: Kind
    channel: str = ""
    breakpoints: tuple[float, ...] = ()
    seconds: float = 0.0
    steps: int = 0
    second: str = ""
    second_breakpoints: tuple[float, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """The inputs of the curve or map."""
        return tuple(name for name in (self.channel, self.second) if name)

    def label(self, taken: Collection[str] = ()) -> str:
        """Return a name for the new parameter that no other has.

        >>> MissingTerm("dragTorque", "multiply", "Throttle").label()
        'ScaleDragTorqueThrottle'
        """
        words = re.findall(r"\w+", " ".join((self.node, *self.channels)))
        stem = _PREFIX[self.kind] + "".join(word[:1].upper() + word[1:] for word in words)
        return unused_name(stem, taken)

    def parameter(self, name: str) -> Parameter | None:
        """Return the new parameter without effect; a lag starts at its time constant, a delay has none."""
        if self.kind in OF_CHANNELS:
            neutral, x = 1.0 if self.kind == "multiply" else 0.0, Axis(self.breakpoints, self.channel)
            if not self.second:
                return Curve(name, x, np.full(len(x), neutral))
            y = Axis(self.second_breakpoints, self.second)
            return Map(name, x, y, np.full((len(x), len(y)), neutral))
        if self.kind == "offset":
            return Curve(name, Axis(self.breakpoints, RECORDING), np.zeros(len(self.breakpoints)))
        return Scalar(name, self.seconds, unit="s", lower=0.0) if self.kind == "lag" else None

    def time_constant(self, taken: Collection[str]) -> str:
        """Return a name for the node of the time constant, to which the next term may be added."""
        return unused_name(f"T_{self.node}", taken, "_")


def unused_name(stem: str, taken: Collection[str], separator: str = "") -> str:
    """Return a name that is not taken: the stem, or with the first number from 2 on that makes it one."""
    names = (stem, *(f"{stem}{separator}{number}" for number in range(2, len(taken) + 3)))
    return next(name for name in names if name not in taken)


def extended_model(model: Model, term: MissingTerm, parameter: str) -> Model:
    """Return a model with a term; all that reads the node reads the corrected one.

    Args:
        model: the model.
        term: the term.
        parameter: name of its parameter.

    Raises:
        ArgumentError: the model has no such node.
    """
    graph = model.graph
    if term.node not in graph.names:
        raise ArgumentError(f"the function has no node {term.node}")
    changed = with_corrections(graph, {graph.names[term.node]: _correction(graph, term, parameter)})
    return replace(model, graph=changed, equations=None)


def _correction(graph: Graph, term: MissingTerm, parameter: str) -> Correction:
    def correct(b: GraphBuilder, node: int, names: dict[str, int]) -> int:
        if term.kind in (*OF_CHANNELS, "offset"):
            table = b.lookup(parameter, *(b.input(name) for name in term.channels or (RECORDING,)))
            return b.call("mul" if term.kind == "multiply" else "add", node, table)
        if term.kind == "delay":
            return b.prev(node, node, term.steps)
        T = b.lookup(parameter)
        names[term.time_constant({*graph.names, *graph.inputs, *graph.parameters})] = T
        return int(FUNCTIONS["PT1"].rule(b, node, T, node))

    return correct


def remembers_itself(graph: Graph, state: int) -> bool:
    """Return if the node whose value a state holds is computed from that state itself, as by a PT1.

    A loop through another named node reads the node by its name.
    """
    named = set(graph.names.values())
    open_nodes, seen = [graph.states[state].next], set[int]()
    while open_nodes:
        op, args, payload = graph.nodes[open_nodes.pop()]
        if op == "state" and payload == state:
            return True
        open_nodes += [at for at in args if at not in seen and at not in named]
        seen.update(args)
    return False


def with_corrections(graph: Graph, corrections: Mapping[int, Correction]) -> Graph:
    """Return a graph in which all that reads some nodes reads what the corrections make of them.

    The memory that a node has of itself, as a PT1 has, keeps the uncorrected node: formula text adds the term to the
    call, whose memory does not see it.

    Args:
        graph: the graph.
        corrections: by the number of the node.
    """
    b = GraphBuilder()
    # states keep their numbers; those of the corrections follow
    b.states.extend(graph.states)
    number: list[int] = []
    uncorrected: list[int] = []
    names: dict[str, int] = {}
    for at, (op, args, payload) in enumerate(graph.nodes):
        own = b.node(op, tuple(number[a] for a in args), payload)
        uncorrected.append(own)
        number.append(corrections[at](b, own, names) if at in corrections else own)
    loops = {k for k, s in enumerate(graph.states) if s.next in corrections and remembers_itself(graph, k)}
    b.states[: len(graph.states)] = [
        State(number[s.init], (uncorrected if k in loops else number)[s.next], s.latency)
        for k, s in enumerate(graph.states)
    ]
    b.settle()
    named = {name: number[at] for name, at in graph.names.items()} | names
    return extract(b.nodes, b.states, named, graph.units, graph.outputs)


def describe(term: MissingTerm, seconds: float | None = None) -> str:
    """Return what a term does to its node, in words."""
    if term.kind == "lag":
        return f"Delay {term.node} by a PT1 of about {term.seconds if seconds is None else seconds:.3g} s"
    if term.kind == "offset":
        return f"Add an offset of each recording to {term.node}"
    if term.kind == "delay":
        return f"Delay {term.node} by {term.steps} step{'s' * (term.steps != 1)}"
    verb, preposition = ("Add", "to") if term.kind == "add" else ("Scale", "by")
    table = f"a map of {term.channel} and {term.second}" if term.second else f"a curve of {term.channel}"
    first, second = (table, term.node) if term.kind == "add" else (term.node, table)
    return f"{verb} {first} {preposition} {second}"
