"""What data stores hold: at the beginning of the step, and after some of their writers have run.

What blocks remember from one step to the next, or from one pass of a subsystem to the next within a step.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes, elementwise
from kennfeld.models.simulink.flattening.flat_model import STATE_PORT, DataStoreOrder, FlatBlock, SignalSource
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.pass_state import Key, Shape
from kennfeld.models.simulink.lowering.scheduling import ExecutionConditions
from kennfeld.models.simulink.lowering.state_ports import StatePorts
from kennfeld.models.simulink.signals import (
    CONSTANT,
    CONTINUOUS,
    Signal,
    SignalOrBus,
    fastest_sample_time,
    fit_to_shape,
)

__all__ = ["DataStores", "DiscreteStates"]


class DiscreteStates:
    """The memories of blocks; `arriving` gives the signals at the inputs of a block as far as they are built."""

    def __init__(
        self, gates: ExecutionConditions, ports: StatePorts, arriving: Callable[[FlatBlock], Sequence[SignalOrBus]]
    ) -> None:
        self.builder = gates.builder
        self.gates = gates
        self.timing = gates.timing
        self.failures = ports.failures
        self.ports = ports
        self.shapes = ports.shapes
        self.guesses = ports.shapes.guesses
        self.agenda = ports.agenda
        self._arriving = arriving
        self._writes: dict[Key, Callable[[], Nodes]] = {}
        self._written: dict[Key, Nodes] = {}

    def remember(
        self, site: BlockContext, number: int, init: Signal, then: Callable[[Signal], Signal], latency: int
    ) -> Signal:
        """A memory of a block that is read now and written at the end of the step."""
        atom, key = site.atom, (site.atom.first, number)
        shape = self.shapes.of(key, init)
        try:
            first = fit_to_shape(init.nodes, shape)
        except EvaluationError:
            first = init.nodes
        period = site.period()
        read = Signal(self._read((atom, number), first, latency), period if period else CONTINUOUS)
        seen = self.restarted(atom, read, first)
        self._writes[atom, number] = lambda: self._new(site, key, seen, then)
        return replace(seen, period=period or CONTINUOUS)

    def always_later(self, site: BlockContext, init: Signal, x: Callable[[], Signal]) -> Signal:
        """A signal of the step before, made later, whether or not the subsystem around the block runs."""
        site.before += 1
        key, first = (site.atom, STATE_PORT - site.before), init.nodes
        read = self._read(key, first, 1)
        self._writes[key] = lambda: fit_to_shape(self.timing.at_major(x()).nodes, read.shape)
        return Signal(read, CONTINUOUS)

    def restarted(self, atom: FlatBlock, read: Signal, first: Nodes) -> Signal:
        """A memory that begins anew when the subsystem around it is enabled again."""
        begins = self.gates.restart(atom)
        if begins is None:
            return read
        runs = np.array([begins], dtype=np.int64)
        return replace(read, nodes=elementwise(self.builder, "select", runs, first, read.nodes))

    def is_sound(self, site: BlockContext) -> bool:
        """Whether all signals at the inputs of a block could be built."""
        return all(wired.sound for wired in self._arriving(site.atom))

    def check_widened(self, site: BlockContext, key: Key) -> None:
        """Tell of a memory that is a vector for the sake of what is behind it, though its input is a scalar."""
        message = self.shapes.widened(key)
        if message:
            self.failures.note(site.atom, message)

    # several passes within a step

    def _read(self, key: Key, first: Nodes, latency: int) -> Nodes:
        """What a memory holds when its block is built: what the step before has left, or the pass before."""
        atom, number = key
        if atom.earlier is not None:
            found = self._after((atom.earlier, number))
            return fit_to_shape(found, first.shape)
        if atom.begins:
            return first
        states = self.ports.states(key, first, latency)
        self.agenda.add(atom.last, lambda: self._close((atom.last, number), states, first))
        return np.array(states, dtype=np.int64).reshape(first.shape)

    def _after(self, key: Key) -> Nodes:
        """What a memory holds after its block has run."""
        if key not in self._written:
            if key not in self._writes:
                raise UnsupportedError("its pass before could not be built")
            self._written[key] = self._writes[key]()
        return self._written[key]

    def _close(self, key: Key, states: Sequence[int], first: Nodes) -> None:
        """Close a memory with what the last pass leaves in it."""
        new = self._after(key) if key in self._writes else first
        for state, init, node in zip(states, first.ravel(), new.ravel(), strict=True):
            self.builder.close(state, int(init), int(node))

    # what a block leaves

    def _new(self, site: BlockContext, key: Key, seen: Signal, then: Callable[[Signal], Signal]) -> Nodes:
        """What a block leaves in its memory, which it has seen as it was."""
        new = seen
        try:
            if self.is_sound(site):
                new = self.timing.at_major(then(seen))
        except UnsupportedError as unsupported:
            self.failures.note(site.atom, *unsupported.parts)
        self.guesses.period(site.atom, self._inherited(site))
        new = self._fitted(site, key, new, seen)
        written = self.gates.written(site.atom, site.period())
        if written is None:
            return new.nodes
        return elementwise(self.builder, "select", np.array([written], dtype=np.int64), new.nodes, seen.nodes)

    def _fitted(self, site: BlockContext, key: Key, new: Signal, seen: Signal) -> Signal:
        """What a block leaves, in the shape of its memory; the next pass takes another shape that it has."""
        if new.shape == seen.shape:
            return new
        if new.size == 1:
            self.check_widened(site, key)
            return replace(new, nodes=fit_to_shape(new.nodes, seen.shape))
        self.ask(site, key, new.shape, seen.shape)
        return seen

    def ask(self, site: BlockContext, key: Key, wanted: Shape, there: Shape) -> None:
        """Give a memory another shape in the next pass; tell of one that did not take it, as what it starts with."""
        if self.guesses.shapes.get(key) == wanted:
            sizes = ["x".join(map(str, shape)) for shape in (there, wanted)]
            self.failures.note(site.atom, f"what it starts with has the size {sizes[0]}, and its input {sizes[1]}")
        self.guesses.shape(key, wanted)

    def _inherited(self, site: BlockContext) -> float:
        """The sample time of a block's inputs."""
        found = fastest_sample_time([wired.period for wired in self._arriving(site.atom)])
        return CONTINUOUS if found == CONSTANT else found


class DataStores:
    """The data stores of a model; `signal` gives what the writers of one are given."""

    def __init__(
        self, memories: DiscreteStates, stores: DataStoreOrder, signal: Callable[[SignalSource], Signal]
    ) -> None:
        self.builder = memories.builder
        self.memories = memories
        self.guesses = memories.guesses
        self.stores = stores
        self._signal = signal
        self._begun: dict[FlatBlock, Signal] = {}

    def stored(self, memory: FlatBlock, init: Signal) -> Signal:
        """What a data store holds at the beginning of the step; its writers are built for the end of it."""
        if memory.passes:
            raise UnsupportedError("its memory is in a subsystem that runs several times in a step")
        if memory not in self._begun:
            shape = self.guesses.shapes.get((memory, 1), init.shape)
            first = fit_to_shape(init.nodes, shape) if init.size == 1 else init.nodes
            states = [self.builder.state() for _ in range(first.size)]
            self._begun[memory] = Signal(np.array(states, dtype=np.int64).reshape(first.shape))
            self.memories.agenda.add(memory, lambda: self._close(memory, states, first))
        return self._begun[memory]

    def _close(self, memory: FlatBlock, states: Sequence[int], first: Nodes) -> None:
        """Close a data store with what its last writer leaves in it."""
        begun = self._begun[memory]
        end = self.written(begun, self.stores.writers.get(memory, ()))
        if end.size != begun.size:
            self.guesses.shape((memory, 1), end.shape)
            end = begun
        for state, one, node in zip(states, first.ravel(), end.nodes.ravel(), strict=True):
            self.builder.close(state, int(one), int(node))

    def written(self, content: Signal, writers: Iterable[FlatBlock]) -> Signal:
        """The content of a data store after some of its writers have run."""
        for writer in writers:
            given = self.memories.timing.at_major(self._signal(SignalSource(writer, 0)))
            runs = self.memories.gates.written(writer, given.period)
            if runs is None:
                content = given
                continue
            old = fit_to_shape(content.nodes, given.shape) if content.size == 1 else content.nodes
            nodes = elementwise(self.builder, "select", np.array([runs], dtype=np.int64), given.nodes, old)
            content = Signal(nodes, CONTINUOUS)
        return content
