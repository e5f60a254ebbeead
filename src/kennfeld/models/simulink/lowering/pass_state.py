"""The channels that a model takes: one for each port from outside, one for each signal that is used of an open bus.

Shapes and sample times in feedback: what an earlier pass found, and what is asked for in this one.

The order in which blocks are built: each behind what it needs; what closes memories when all else is there.

Where blocks wait for each other, the loop is noted, and a signal that stands in for one of them breaks it.
"""

from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from kennfeld.graph import CLOCK
from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.simulink.flattening.flat_model import FlatBlock
from kennfeld.models.simulink.reader.block_ports import port_label
from kennfeld.models.simulink.signals import CONTINUOUS, ExternalBus, Signal

__all__ = ["DimensionInference", "InferredAttributes", "Key", "ModelInputs", "PendingCompletions", "Shape"]

Key: TypeAlias = tuple[FlatBlock, int]  # a block and the number of its memory
Shape: TypeAlias = tuple[int, ...]

_WIDEST_WISH = 1000


@dataclass
class InferredAttributes:
    """What an earlier pass found: the shapes of memories, the sample times of their blocks, names of two things.

    `wished` are shapes that no input gave but a matrix behind the memory asks for.
    """

    shapes: dict[Key, Shape] = field(default_factory=dict)
    periods: dict[FlatBlock, float] = field(default_factory=dict)
    taken: frozenset[str] = frozenset()
    wished: dict[Key, Shape] = field(default_factory=dict)
    changed: bool = False

    def shape(self, key: Key, found: Shape) -> None:
        """Note the shape of a memory for the next pass."""
        if self.shapes.get(key) != found:
            self.shapes[key] = found
            self.changed = True

    def period(self, atom: FlatBlock, found: float) -> None:
        """Note the sample time of a block for the next pass."""
        if self.periods.get(atom, CONTINUOUS) != found:
            self.periods[atom] = found
            self.changed = True


class DimensionInference:
    """The shapes of memories and inputs in one pass; `wishes` are those that blocks ask of scalars before them."""

    def __init__(self, guesses: InferredAttributes) -> None:
        self.guesses = guesses
        self.wishes: dict[Key, Shape] = {}
        self._scalars: dict[FlatBlock, Key] = {}

    def of(self, key: Key, init: Signal) -> Shape:
        """The shape of a memory: as an earlier pass found it, else that of its initial value."""
        if init.size == 1 and key not in self.guesses.shapes:
            self._scalars.setdefault(key[0], key)
        return self.guesses.shapes.get(key, init.shape)

    def open(self, atom: FlatBlock) -> Shape:
        """The shape of an input that states none: a scalar, or what is asked of it."""
        self._scalars.setdefault(atom, (atom, 0))
        return self.guesses.shapes.get((atom, 0), (1,))

    def wish(self, atom: FlatBlock, shape: Shape) -> None:
        """Note the shape that a block asks of the memory or input before it, in case that no input gives it one."""
        if atom in self._scalars and int(np.prod(shape)) <= _WIDEST_WISH:
            self.wishes.setdefault(self._scalars[atom], shape)

    def widened(self, key: Key) -> str:
        """What is wrong with a memory whose input is a scalar; empty where nothing behind it asks for a vector."""
        wished = self.guesses.wished.get(key)
        return "" if wished is None else f"its input is a scalar where a vector of {wished} is asked of it"


class ModelInputs(dict[str, FlatBlock | None]):
    """The channels by name, each with the port that takes it; None of those that no port names."""

    def __init__(self, builder: GraphBuilder, guesses: InferredAttributes) -> None:
        super().__init__()
        self.builder = builder
        self.guesses = guesses

    def name(self, atom: FlatBlock) -> str:
        """The name of the channel that a port takes."""
        name = port_label(atom.block) if atom.kind == "Inport" else (atom.block.value("GotoTag") or "A").strip()
        if name in self.guesses.taken or name in CLOCK:
            name = f"{name}_in"
        self[name] = atom
        return name

    def opened(self, atom: FlatBlock) -> ExternalBus:
        """The bus that a port takes; each of its signals that is used becomes an input."""
        return ExternalBus(name=self.name(atom), node=self._member)

    def _member(self, name: str) -> int:
        self.setdefault(name, None)
        return self.builder.input(name)


class PendingCompletions:
    """What is left to be done for blocks when all blocks in their way are built."""

    def __init__(self) -> None:
        self._open: deque[tuple[FlatBlock, Callable[[], None]]] = deque()

    def add(self, atom: FlatBlock, complete: Callable[[], None] = lambda: None) -> None:
        """Have a block and all that it needs built, and then something done for it."""
        self._open.append((atom, complete))

    def __len__(self) -> int:
        return len(self._open)

    def leave(self, atoms: Collection[FlatBlock], since: int) -> None:
        """Do nothing for some blocks of what was added behind the first ones; what they need is built all the same."""
        for at in range(since, len(self._open)):
            if self._open[at][0] in atoms:
                self._open[at] = (self._open[at][0], lambda: None)

    def next(self) -> tuple[FlatBlock, Callable[[], None]] | None:
        """What was added first of all that is left; None of nothing."""
        return self._open.popleft() if self._open else None
