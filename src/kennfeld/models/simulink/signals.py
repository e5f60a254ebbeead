"""What a block's rule works with: the block's parameters, its inputs, memory, and the graph under construction.

What a wire carries while a model is built: an array of graph nodes, or a bus of named signals.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes

__all__ = [
    "CONSTANT",
    "CONTINUOUS",
    "Bus",
    "ExternalBus",
    "Signal",
    "SignalOrBus",
    "as_vector",
    "common_shape",
    "fastest_sample_time",
    "fit_to_shape",
    "leaf_signals",
    "scalar",
]

CONSTANT = math.inf
CONTINUOUS = 0.0


@dataclass(frozen=True, eq=False)
class Signal:
    """Graph nodes in the shape of the signal: (n,) for a vector, (rows, columns) for a matrix; a scalar is (1,).

    `period` is the sample time in s: 0 where it may change at any time, infinite where it never does. `sound` is false
    for what stands in for a signal that could not be built.
    """

    nodes: Nodes
    period: float = CONTINUOUS
    sound: bool = True

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the array of nodes."""
        return self.nodes.shape

    @property
    def size(self) -> int:
        """How many scalar signals it is made of."""
        return self.nodes.size

    @property
    def flat(self) -> list[int]:
        """The nodes, columns first."""
        return [int(node) for node in self.nodes.ravel(order="F")]

    @property
    def elements(self) -> "list[Signal]":
        """The scalar signals that it is made of, columns first."""
        return [scalar(node, self.period) for node in self.flat]


def scalar(node: int, period: float = CONTINUOUS) -> Signal:
    """A signal of one node."""
    return Signal(np.array([node], dtype=np.int64), period)


@dataclass(frozen=True, eq=False)
class Bus:
    """Named signals, in the order of the bus."""

    members: Mapping[str, "SignalOrBus"] = field(default_factory=dict)

    @property
    def sound(self) -> bool:
        """Whether all of its signals could be built."""
        return all(member.sound for member in self.members.values())

    @property
    def period(self) -> float:
        """The shortest sample time of its signals."""
        return fastest_sample_time(member.period for member in self.members.values())

    def member(self, name: str) -> "SignalOrBus | None":
        """The signal or bus of a name; None where there is none."""
        return self.members.get(name)

    def assigned(self, name: str, new: "SignalOrBus") -> "Bus":
        """The bus with one of its signals replaced."""
        return replace(self, members={**self.members, name: new})


@dataclass(frozen=True, eq=False)
class ExternalBus(Bus):
    """A bus from outside, of which only those signals are known that something picks: each is an input of its own.

    `name` is the way to it, "engine.speed"; `node` gives the node of an input. `members` are those that were replaced.
    Where it is taken as a signal, it is one.
    """

    name: str = ""
    node: Callable[[str], int] = lambda name: -1

    @property
    def period(self) -> float:
        """Inputs may change at any time."""
        return CONTINUOUS

    @property
    def signal(self) -> Signal:
        """The scalar signal that it is where nothing is picked of it."""
        return Signal(np.array([self.node(self.name)], dtype=np.int64))

    def member(self, name: str) -> "SignalOrBus":
        """The signal of a name, which may be a bus again."""
        return self.members.get(name) or ExternalBus(name=f"{self.name}.{name}", node=self.node)


SignalOrBus: TypeAlias = Signal | Bus


def leaf_signals(wired: SignalOrBus, name: str = "") -> Iterator[tuple[str, Signal]]:
    """The signals of a bus with their names along the way, `a.b`; a signal alone has the given name."""
    if isinstance(wired, ExternalBus):
        wired = wired.signal
    if isinstance(wired, Signal):
        yield name, wired
        return
    for key, member in wired.members.items():
        yield from leaf_signals(member, f"{name}.{key}" if name else key)


def fastest_sample_time(periods: "Iterator[float] | list[float]") -> float:
    """The sample time of what is computed from signals of these sample times.

    >>> fastest_sample_time([0.1, float("inf"), 0.5]), fastest_sample_time([])
    (0.1, inf)
    """
    return min(periods, default=CONSTANT)


def common_shape(*shapes: tuple[int, ...]) -> tuple[int, ...] | None:
    """The shape of an elementwise result: scalars expand, a vector fits a matrix of one row or column; else None.

    >>> common_shape((1,), (3,)), common_shape((3,), (3, 1)), common_shape((2,), (3,))
    ((3,), (3, 1), None)
    """
    wide = [shape for shape in shapes if math.prod(shape) != 1]
    if not wide:
        return max(shapes, key=len, default=(1,))
    best = max(wide, key=len)
    fits = all(s == best or (len(s) != len(best) and s == (math.prod(best),) and 1 in best) for s in wide)
    return best if fits else None


def as_vector(nodes: Nodes) -> Nodes:
    """An array of one row or column as a vector; others as they are."""
    return nodes.ravel() if nodes.ndim == 2 and 1 in nodes.shape else nodes


def fit_to_shape(nodes: Nodes, shape: tuple[int, ...]) -> Nodes:
    """Nodes in a shape that they fit: a scalar everywhere, a vector as a row or column.

    Raises `NoValueError` where they do not fit it.
    """
    if nodes.shape == shape:
        return nodes
    if nodes.size not in (1, math.prod(shape)):
        wanted = "x".join(map(str, shape))
        raise EvaluationError(f"{nodes.size} values stand where its signal has the size {wanted}")
    return np.full(shape, nodes.ravel()[0], dtype=np.int64) if nodes.size == 1 else nodes.reshape(shape)
