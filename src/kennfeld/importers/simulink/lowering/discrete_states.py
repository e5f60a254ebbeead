"""Discrete states and data stores.

A state lasts from one step to the next or, in an iterated subsystem, from one iteration to the next within a step. A
data store has a content at the start of the step and one after each of its writers.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.formatting import size_text
from kennfeld.importers.simulink.flattening.flat_model import DataStoreOrder, FlatBlock, SignalSource
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.lowering.pass_state import Key, Shape
from kennfeld.importers.simulink.lowering.scheduling import ExecutionConditions
from kennfeld.importers.simulink.lowering.single_precision import FloatTypes
from kennfeld.importers.simulink.lowering.state_ports import StatePorts
from kennfeld.importers.simulink.signals import (
    CONSTANT,
    CONTINUOUS,
    Signal,
    SignalOrBus,
    SignalRule,
    fit_to_shape,
    period_of,
)
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Nodes, elementwise


class DiscreteStates:
    """Discrete states of blocks; `arriving` returns the known signals at the inputs of a block."""

    def __init__(
        self,
        gates: ExecutionConditions,
        ports: StatePorts,
        floats: FloatTypes,
        arriving: Callable[[FlatBlock], Sequence[SignalOrBus]],
    ) -> None:
        self.builder = gates.builder
        self.floats = floats
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

    def create(
        self, flat: FlatBlock, number: int, init: Signal, then: SignalRule, latency: int, sampled: bool
    ) -> Signal:
        """Return a state that is read now and written at the end of the step, if `sampled` at the block's hits only."""
        # all iterations of a block share the shape of their state
        key = (flat.first, number)
        init = self.floats.begun(flat, key, init)
        shape = self.shapes.state_shape(key, init)
        try:
            first = fit_to_shape(init.nodes, shape)
        except EvaluationError:
            first = init.nodes
        nodes, kind = self._read((flat, number), first, latency), init.type
        read = self.floats.read(Signal(nodes, self.timing.period(flat), builder=self.builder, type=kind))
        seen = self.reset_with_subsystem(flat, read, first)
        # called at the end of the step, or when the next iteration reads it
        self._writes[flat, number] = lambda: self._next_value(flat, key, seen, then, sampled)
        return seen

    def delay_unconditionally(self, flat: FlatBlock, number: int, init: Signal, x: Callable[[], Signal]) -> Signal:
        """Return the signal of the previous step, even if an enclosing subsystem does not run."""
        key = (flat, number)
        read = self._read(key, init.nodes, 1)
        self._writes[key] = lambda: fit_to_shape(self.timing.hold_in_minor_steps(x()).nodes, read.shape)
        return Signal(read, builder=self.builder)

    def reset_with_subsystem(self, flat: FlatBlock, read: Signal, first: Nodes) -> Signal:
        """Return a state that is reset when the enclosing subsystem is."""
        begins = self.gates.reset_condition(flat)
        if begins is None:
            return read
        runs = np.array([begins], dtype=np.int64)
        return replace(read, nodes=elementwise(self.builder, "select", runs, first, read.nodes))

    def is_sound(self, flat: FlatBlock) -> bool:
        """Return True if no input of a block is a placeholder."""
        return all(wired.sound for wired in self._arriving(flat))

    def check_widened(self, flat: FlatBlock, key: Key) -> None:
        """Report a state that is a vector because of its readers although its input is a scalar."""
        if (wished := self.guesses.wished.get(key)) is not None:
            message = f"its input must have the size {size_text(wished.shape)}, as {wished.path} requires, got a scalar"
            self.failures.note(flat, message)

    def _read(self, key: Key, first: Nodes, latency: int) -> Nodes:
        """Return the state read by a block: of the previous step, or of the previous iteration."""
        flat, number = key
        # x[pass] reads what pass - 1 wrote; the first pass reads what the last one wrote in the step before
        if flat.previous_pass is not None:
            nodes = self._read_after((flat.previous_pass, number))
            return fit_to_shape(nodes, first.shape)
        if flat.resets_each_step:
            return first
        states = self.ports.states(key, first, latency)
        self.agenda.add(flat.last, lambda: self._close((flat.last, number), states, first))
        return np.array(states, dtype=np.int64).reshape(first.shape)

    def _read_after(self, key: Key) -> Nodes:
        if key not in self._written:
            if key not in self._writes:
                raise UnsupportedError("its previous iteration is not supported")
            self._written[key] = self._writes[key]()
        return self._written[key]

    def _close(self, key: Key, states: Sequence[int], first: Nodes) -> None:
        """Close a state with the value after the last iteration."""
        new = self._read_after(key) if key in self._writes else first
        for state, init, node in zip(states, first.ravel(), new.ravel(), strict=True):
            self.builder.close(state, int(init), int(node))

    def _next_value(self, flat: FlatBlock, key: Key, seen: Signal, then: SignalRule, sampled: bool) -> Nodes:
        """Return the next value of a state as its block computes it."""
        new = seen
        with self.failures.note_errors(flat):
            if self.is_sound(flat):
                with self.floats.rounding(flat):
                    new = then(seen)
                new = self.timing.hold_in_minor_steps(self.floats.written(flat, key, new, seen))
        # the sample time that the block inherits is known only now, for the next pass
        inherited = period_of(self._arriving(flat))
        self.guesses.period(flat, CONTINUOUS if inherited == CONSTANT else inherited)
        new = self._fit(flat, key, new, seen)
        # x' = runs and hit ? new : x
        gates = self.gates
        written = gates.write_condition(flat, self.timing.period(flat)) if sampled else gates.run_condition(flat)
        if written is None:
            return new.nodes
        return elementwise(self.builder, "select", np.array([written], dtype=np.int64), new.nodes, seen.nodes)

    def _fit(self, flat: FlatBlock, key: Key, new: Signal, seen: Signal) -> Signal:
        """Return the next value in the shape of the state; another shape is used in the next pass."""
        if new.shape == seen.shape:
            return new
        if new.size == 1:
            self.check_widened(flat, key)
            return replace(new, nodes=fit_to_shape(new.nodes, seen.shape))
        self.request_shape(flat, key, new.shape, seen.shape)
        return seen

    def request_shape(self, flat: FlatBlock, key: Key, wanted: Shape, there: Shape) -> None:
        """Request another shape in the next pass; report a mismatch with the initial value if it was refused."""
        if self.guesses.shapes.get(key) == wanted:
            sizes = [size_text(shape) for shape in (there, wanted)]
            self.failures.note(flat, f"its initial value has size {sizes[0]}, but its input has size {sizes[1]}")
        self.guesses.shape(key, wanted)


class DataStores:
    """Data stores of a model; `signal` returns the input of a writer."""

    def __init__(
        self, memories: DiscreteStates, stores: DataStoreOrder, signal: Callable[[SignalSource], Signal]
    ) -> None:
        self.builder = memories.builder
        self.memories = memories
        self.guesses = memories.guesses
        self.stores = stores
        self._signal = signal
        self._begun: dict[FlatBlock, Signal] = {}

    def content(self, memory: FlatBlock, init: Signal) -> Signal:
        """Return the content of a data store at the start of the step; its writers are lowered at the end."""
        if memory.passes:
            raise UnsupportedError("it has states in an iterated subsystem, which is not supported")
        if memory not in self._begun:
            init = self.memories.floats.begun(memory, (memory, 1), init)
            shape = self.guesses.shapes.get((memory, 1), init.shape)
            # a scalar start fills a store that an earlier pass found to be wider
            first = fit_to_shape(init.nodes, shape) if init.size == 1 else init.nodes
            states = [self.builder.state() for _ in range(first.size)]
            content = Signal(np.array(states, dtype=np.int64).reshape(first.shape), type=init.type)
            self._begun[memory] = self.memories.floats.read(content)
            self.memories.agenda.add(memory, lambda: self._close(memory, states, first))
        return self._begun[memory]

    def _close(self, memory: FlatBlock, states: Sequence[int], first: Nodes) -> None:
        """Close a data store with the content after its last writer."""
        begun = self._begun[memory]
        end = self.content_after(begun, self.stores.writers.get(memory, ()))
        end = self.memories.floats.written(memory, (memory, 1), end, begun)
        # this pass keeps the old size, and the next one has the new one
        if end.size != begun.size:
            self.guesses.shape((memory, 1), end.shape)
            end = begun
        for state, init, node in zip(states, first.ravel(), end.nodes.ravel(), strict=True):
            self.builder.close(state, int(init), int(node))

    def content_after(self, content: Signal, writers: Iterable[FlatBlock]) -> Signal:
        """Return the content of a data store after some of its writers."""
        for writer in writers:
            signal = self.memories.timing.hold_in_minor_steps(self._signal(SignalSource(writer, 0)))
            runs = self.memories.gates.write_condition(writer, signal.period)
            if runs is None:
                content = signal
                continue
            old = fit_to_shape(content.nodes, signal.shape) if content.size == 1 else content.nodes
            nodes = elementwise(self.builder, "select", np.array([runs], dtype=np.int64), signal.nodes, old)
            content = Signal(nodes, CONTINUOUS, type=signal.type)
        return content
