"""What data stores hold: at the beginning of the step, and after some of their writers have run."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.signals import CONTINUOUS, Nodes, Signal
from kennfeld.models.simulink.flattening.atoms import Atom, Source
from kennfeld.models.simulink.flattening.stores import Stores
from kennfeld.models.simulink.weaving.memories import Memories
from kennfeld.models.simulink.weaving.site import resized
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["Contents"]


class Contents:
    """The data stores of a model; `signal` gives what the writers of one are given."""

    def __init__(self, memories: Memories, stores: Stores, signal: Callable[[Source], Signal]) -> None:
        self.loom = memories.loom
        self.memories = memories
        self.guesses = memories.guesses
        self.stores = stores
        self._signal = signal
        self._begun: dict[Atom, Signal] = {}

    def stored(self, memory: Atom, init: Signal) -> Signal:
        """What a data store holds at the beginning of the step; its writers are built for the end of it."""
        if memory.passes:
            raise UnsupportedError("its memory is in a subsystem that runs several times in a step")
        if memory not in self._begun:
            shape = self.guesses.shapes.get((memory, 1), init.shape)
            first = resized(init.nodes, shape) if init.size == 1 else init.nodes
            states = [self.loom.state() for _ in range(first.size)]
            self._begun[memory] = Signal(np.array(states, dtype=np.int64).reshape(first.shape))
            self.memories.agenda.add(memory, lambda: self._close(memory, states, first))
        return self._begun[memory]

    def _close(self, memory: Atom, states: Sequence[int], first: Nodes) -> None:
        """Close a data store with what its last writer leaves in it."""
        begun = self._begun[memory]
        end = self.written(begun, self.stores.writers.get(memory, ()))
        if end.size != begun.size:
            self.guesses.shape((memory, 1), end.shape)
            end = begun
        for state, one, node in zip(states, first.ravel(), end.nodes.ravel(), strict=True):
            self.loom.close(state, int(one), int(node))

    def written(self, content: Signal, writers: Iterable[Atom]) -> Signal:
        """The content of a data store after some of its writers have run."""
        for writer in writers:
            given = self.memories.timing.at_major(self._signal(Source(writer, 0)))
            runs = self.memories.gates.written(writer, given.period)
            if runs is None:
                content = given
                continue
            old = resized(content.nodes, given.shape) if content.size == 1 else content.nodes
            nodes = each(self.loom, "select", np.array([runs], dtype=np.int64), given.nodes, old)
            content = Signal(nodes, CONTINUOUS)
        return content
