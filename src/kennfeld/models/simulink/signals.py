"""Signals during lowering: arrays of graph nodes, or buses of named signals."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes

CONSTANT = math.inf
CONTINUOUS = 0.0


@dataclass(frozen=True, eq=False)
class Signal:
    """Graph nodes in the shape of the signal: (n,) for a vector, (rows, columns) for a matrix, (1,) for a scalar.

    `period` is the sample time in s: 0 if it may change at any time, infinite if it is constant. `sound` is False for
    placeholders of unsupported signals.
    """

    nodes: Nodes
    period: float = CONTINUOUS
    sound: bool = True

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array of nodes."""
        return self.nodes.shape

    @property
    def size(self) -> int:
        """Number of elements."""
        return self.nodes.size

    @property
    def flat(self) -> list[int]:
        """Nodes, column by column."""
        return [int(node) for node in self.nodes.ravel(order="F")]

    @property
    def elements(self) -> "list[Signal]":
        """Scalar signals, column by column."""
        return [scalar(node, self.period) for node in self.flat]


def scalar(node: int, period: float = CONTINUOUS) -> Signal:
    """Return a signal of one node."""
    return Signal(np.array([node], dtype=np.int64), period)


@dataclass(frozen=True, eq=False)
class Bus:
    """Named signals in bus order."""

    members: Mapping[str, "SignalOrBus"] = field(default_factory=dict)

    @property
    def sound(self) -> bool:
        """True if all its signals are supported."""
        return all(member.sound for member in self.members.values())

    @property
    def period(self) -> float:
        """Shortest sample time of its signals."""
        return fastest_sample_time(member.period for member in self.members.values())

    def member(self, name: str) -> "SignalOrBus | None":
        """Return the signal or bus of a name, None if there is none."""
        return self.members.get(name)

    def assigned(self, name: str, new: "SignalOrBus") -> "Bus":
        """Return the bus with one signal replaced."""
        return replace(self, members={**self.members, name: new})


@dataclass(frozen=True, eq=False)
class ExternalBus(Bus):
    """A bus input of the model whose signals are known only by use: each selected one is an input of its own.

    `name` is its path, "engine.speed"; `node` returns the node of an input. `members` are signals that were replaced.
    Used as a signal, it is a scalar input.
    """

    name: str = ""
    node: Callable[[str], int] = lambda name: -1

    @property
    def period(self) -> float:
        """Inputs may change at any time."""
        return CONTINUOUS

    @property
    def signal(self) -> Signal:
        """The scalar input that it is if no signal is selected."""
        return Signal(np.array([self.node(self.name)], dtype=np.int64))

    def member(self, name: str) -> "SignalOrBus":
        """Return the signal of a name, which may itself be a bus."""
        return self.members.get(name) or ExternalBus(name=f"{self.name}.{name}", node=self.node)


SignalOrBus: TypeAlias = Signal | Bus


def leaf_signals(wired: SignalOrBus, name: str = "") -> Iterator[tuple[str, Signal]]:
    """Yield the signals of a bus with their paths `a.b`; a single signal has the given name."""
    if isinstance(wired, ExternalBus):
        wired = wired.signal
    if isinstance(wired, Signal):
        yield name, wired
        return
    for key, member in wired.members.items():
        yield from leaf_signals(member, f"{name}.{key}" if name else key)


def fastest_sample_time(periods: "Iterator[float] | list[float]") -> float:
    """Return the sample time of a result computed from signals with these sample times.

    >>> fastest_sample_time([0.1, float("inf"), 0.5]), fastest_sample_time([])
    (0.1, inf)
    """
    return min(periods, default=CONSTANT)


def common_shape(*shapes: tuple[int, ...]) -> tuple[int, ...] | None:
    """Return the shape of an elementwise result, or None: scalars broadcast, a vector matches a one-row or -column
    matrix.

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
    """Return an array of one row or column as a vector, others unchanged."""
    return nodes.ravel() if nodes.ndim == 2 and 1 in nodes.shape else nodes


def fit_to_shape(nodes: Nodes, shape: tuple[int, ...]) -> Nodes:
    """Return nodes broadcast or reshaped to a shape; raise `EvaluationError` if they do not match it."""
    if nodes.shape == shape:
        return nodes
    if nodes.size not in (1, math.prod(shape)):
        raise EvaluationError(f"its value has {nodes.size} elements, but its signal has size {size_text(shape)}")
    return np.full(shape, nodes.ravel()[0], dtype=np.int64) if nodes.size == 1 else nodes.reshape(shape)


def size_text(shape: Iterable[int]) -> str:
    """Return the sizes along the dimensions as text.

    >>> size_text((2, 3))
    '2 x 3'
    """
    return " x ".join(map(str, shape))
