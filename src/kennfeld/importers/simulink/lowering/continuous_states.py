"""Continuous states of blocks: initial values, derivatives and limits, which the solver of the model advances."""

import math
from dataclasses import replace

import numpy as np

from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.lowering.discrete_states import DiscreteStates
from kennfeld.importers.simulink.lowering.pass_state import Key
from kennfeld.importers.simulink.lowering.state_ports import ContinuousState
from kennfeld.importers.simulink.signals import Signal, SignalRule, broadcast, clip, fit_to_shape, select
from kennfeld.models.imperative.node_arrays import Nodes


class ContinuousStates:
    """Continuous states of all blocks."""

    def __init__(self, memories: DiscreteStates) -> None:
        self.builder = memories.builder
        self.memories = memories
        self.shapes = memories.shapes
        self._states: list[ContinuousState] = []

    def integrate(
        self,
        flat: FlatBlock,
        number: int,
        init: Signal,
        slope: SignalRule,
        reset: Signal | None,
        limits: tuple[Signal, Signal] | None,
    ) -> Signal:
        """Return a continuous state as it is now; the solver advances it at the end of the step."""
        if flat.passes:
            raise UnsupportedError("it integrates over time in an iterated subsystem, which is not supported")
        key = (flat, number)
        first = self._initial_states(key, init, reset, limits)
        # `states` are as the solver left them, `seen` as blocks see them after a reset in this step
        states = self.memories.ports.states(key, first)
        read = Signal(np.array(states, dtype=np.int64).reshape(first.shape), builder=self.builder)
        seen = self.memories.reset_with_subsystem(flat, read, first)
        if reset is not None:
            again = select(self.memories.timing.hold_in_minor_steps(reset), Signal(first), seen)
            seen = replace(seen, nodes=again.nodes)

        def complete() -> None:
            slopes = self._slopes(flat, key, seen, slope)
            bounds = [(self.builder.const(-math.inf), self.builder.const(math.inf))] * seen.size
            if limits is not None:
                low, high = (fit_to_shape(limit.nodes, seen.shape).ravel() for limit in limits)
                bounds = [(int(lower), int(upper)) for lower, upper in zip(low, high, strict=True)]
            active = self.memories.gates.run_condition(flat)
            # the solver goes on from what is seen, so that a reset takes effect
            parts = zip(states, first.ravel(), seen.nodes.ravel(), slopes.ravel(), bounds, strict=True)
            for state, init, now, rate, bound in parts:
                running = int(rate) if active is None else self._select(active, int(rate))
                self._states.append(ContinuousState(state, int(init), int(now), running, bound))

        self.memories.agenda.add(flat, complete)
        return seen

    def _initial_states(
        self, key: Key, init: Signal, reset: Signal | None, limits: tuple[Signal, Signal] | None
    ) -> Nodes:
        """Return the initial states within limits, as many as there are elements in state, reset or limits."""
        # an initial value beyond the limits begins at them
        inside = init if limits is None else clip(init, *limits)
        first = broadcast(inside, *(limit for limit in (reset, *(limits or ())) if limit is not None))[0]
        shape = self.shapes.state_shape(key, first)
        return fit_to_shape(first.nodes, shape) if first.size in (1, int(np.prod(shape))) else first.nodes

    def _slopes(self, flat: FlatBlock, key: Key, seen: Signal, slope: SignalRule) -> Nodes:
        """Return the slopes of a block's states; another shape is used in the next pass."""
        rates = replace(seen, nodes=np.full(seen.shape, self.builder.const(0.0), dtype=np.int64))
        with self.memories.failures.note_errors(flat):
            if self.memories.is_sound(flat):
                rates = slope(seen)
        if rates.size == 1 < seen.size:
            self.memories.check_widened(flat, key)
        if rates.size > 1 and rates.shape != seen.shape:
            self.memories.request_shape(flat, key, rates.shape, seen.shape)
            # any nodes of the right number: this pass is repeated
            rates = replace(seen, nodes=np.full(seen.shape, rates.nodes.ravel()[0], dtype=np.int64))
        return fit_to_shape(rates.nodes, seen.shape)

    def _select(self, active: int, rate: int) -> int:
        """Return a derivative, 0 while the subsystem around the block does not run."""
        return self.builder.call("select", active, rate, self.builder.const(0.0))

    def close(self) -> None:
        """Close the states with what a solver needs; their initial values become independent of the states."""
        self._states = self.memories.ports.resolve_initial_values(self._states)
        for state in self._states:
            advance = self.builder.node("advance", (state.seen, state.slope, *state.limits))
            self.builder.close(state.state, state.init, advance)
