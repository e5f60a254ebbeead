"""State of one pass: inferred attributes of earlier passes, model inputs and pending completions."""

from collections import deque
from collections.abc import Callable, Collection
from dataclasses import field
from typing import TypeAlias

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph import CLOCK
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.reader.block_ports import port_label
from kennfeld.importers.simulink.signals import CONTINUOUS, ExternalBus, Signal

Key: TypeAlias = tuple[FlatBlock, int]  # a block and the number of its state
Shape: TypeAlias = tuple[int, ...]

_MAX_SUGGESTED_SIZE = 1000


@dataclass
class InferredAttributes:
    """Attributes found in an earlier pass: shapes of states and sample times of their blocks.

    `wished` are shapes that no input determined but a matrix downstream requires.
    """

    shapes: dict[Key, Shape] = field(default_factory=dict)
    periods: dict[FlatBlock, float] = field(default_factory=dict)
    taken: frozenset[str] = frozenset()
    wished: dict[Key, Shape] = field(default_factory=dict)
    changed: bool = False

    def shape(self, key: Key, shape: Shape) -> None:
        """Record the shape of a state for the next pass."""
        if self.shapes.get(key) != shape:
            self.shapes[key] = shape
            self.changed = True

    def period(self, flat: FlatBlock, value: float) -> None:
        """Record the sample time of a block for the next pass."""
        if self.periods.get(flat, CONTINUOUS) != value:
            self.periods[flat] = value
            self.changed = True


class DimensionInference:
    """Shapes of states and inputs in one pass; `wishes` are shapes that blocks suggest to scalar inputs."""

    def __init__(self, guesses: InferredAttributes) -> None:
        self.guesses = guesses
        self.wishes: dict[Key, Shape] = {}
        self._scalars: dict[FlatBlock, Key] = {}

    def state_shape(self, key: Key, init: Signal) -> Shape:
        """Infer the shape of a state: from an earlier pass, else of its initial value."""
        if init.size == 1 and key not in self.guesses.shapes:
            # a scalar that nothing determines may be widened by a block that reads it
            self._scalars.setdefault(key[0], key)
        return self.guesses.shapes.get(key, init.shape)

    def input_shape(self, flat: FlatBlock) -> Shape:
        """Infer the shape of an input that does not specify one: a scalar or the suggested shape."""
        self._scalars.setdefault(flat, (flat, 0))
        return self.guesses.shapes.get((flat, 0), (1,))

    def wish(self, flat: FlatBlock, shape: Shape) -> None:
        """Record the shape that a block suggests to a state or input."""
        # of several suggestions, the first one counts
        if flat in self._scalars and int(np.prod(shape)) <= _MAX_SUGGESTED_SIZE:
            self.wishes.setdefault(self._scalars[flat], shape)


class ModelInputs(dict[str, FlatBlock | None]):
    """Channels of the model by name, each with its port, None if no port has that name."""

    def __init__(self, builder: GraphBuilder, guesses: InferredAttributes) -> None:
        super().__init__()
        self.builder = builder
        self.guesses = guesses

    def name(self, flat: FlatBlock) -> str:
        """Name the channel of a port."""
        own = port_label(flat.block) if flat.type == "Inport" else (flat.block.value("GotoTag") or "A").strip()
        return self.channel(flat, own)

    def channel(self, flat: FlatBlock, name: str) -> str:
        """Register a channel of a block under a name, or under one beside it if that is taken."""
        # the names of the clock are channels of their own, those of parameters are taken
        if name in self.guesses.taken or name in CLOCK:
            name = f"{name}_in"
        self[name] = flat
        return name

    def open_bus(self, flat: FlatBlock) -> ExternalBus:
        """Return the bus of a port; each used signal becomes an input."""
        return ExternalBus(name=self.name(flat), node=self._member)

    def _member(self, name: str) -> int:
        self.setdefault(name, None)
        return self.builder.input(name)


class PendingCompletions:
    """Completions to run once everything a block depends on is lowered."""

    def __init__(self) -> None:
        self._open: deque[tuple[FlatBlock, Callable[[], None]]] = deque()

    def add(self, flat: FlatBlock, complete: Callable[[], None] = lambda: None) -> None:
        """Schedule a block for lowering and an optional completion after it."""
        self._open.append((flat, complete))

    def __len__(self) -> int:
        return len(self._open)

    def drop(self, blocks: Collection[FlatBlock], since: int) -> None:
        """Drop the completions of some blocks added since a mark; their dependencies are lowered all the same."""
        for at in range(since, len(self._open)):
            if self._open[at][0] in blocks:
                self._open[at] = (self._open[at][0], lambda: None)

    def next(self) -> tuple[FlatBlock, Callable[[], None]] | None:
        """Return the oldest pending entry, None if there is none."""
        return self._open.popleft() if self._open else None
