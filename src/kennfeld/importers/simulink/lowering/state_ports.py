"""State ports: states readable before their block is lowered, and initial values behind them.

The reset of an integrator may depend on its own state port through an `IC` block that leads back to its initial value.
In the first step the `IC` block outputs its constant, so the initial value can be resolved by replacing the states on
the way by their initial values.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.operations import OPERATIONS
from kennfeld.graph.traversal import ancestors
from kennfeld.importers.simulink.flattening.flat_model import STATE_PORT, FlatBlock, SignalSource
from kennfeld.importers.simulink.lowering.diagnostics import placeholder_signal
from kennfeld.importers.simulink.lowering.pass_state import DimensionInference, Key, PendingCompletions
from kennfeld.importers.simulink.lowering.registry import field_text
from kennfeld.importers.simulink.lowering.scheduling import SampleTimes
from kennfeld.importers.simulink.reader.dialog_words import contains_word
from kennfeld.importers.simulink.signals import CONSTANT, CONTINUOUS, Signal
from kennfeld.models.imperative.node_arrays import Nodes

_MAX_ROUNDS = 100  # states whose initial values depend on each other


def resolve_initial_value(builder: GraphBuilder, state: int, inits: Mapping[int, int]) -> int | None:
    """Resolve a state's initial value to a node free of the state itself, or None if it depends on it.

    `inits` are the initial value nodes of states as written, by state node.
    """
    node = inits[state]
    for _ in range(_MAX_ROUNDS):
        # each round replaces the states behind the value by their initial values, which may depend on further states
        behind = set(ancestors(builder.nodes, [node]))
        if state not in behind:
            return node
        known = {at: inits[at] for at in behind if at in inits and at != state}
        if not known:
            return None
        node = _replace_states(builder, node, behind, known)
    return None


def _replace_states(builder: GraphBuilder, root: int, behind: set[int], known: Mapping[int, int]) -> int:
    replaced = dict(known)
    # arguments have lower numbers than the nodes that use them
    for at in sorted(behind - known.keys()):
        op, args, payload = builder.nodes[at]
        changed = tuple(replaced[a] for a in args)
        # a constant need not be held
        if op == "hold" and builder.value(changed[0]) is not None:
            replaced[at] = changed[0]
        else:
            replaced[at] = builder.call(op, *changed) if op in OPERATIONS else builder.node(op, changed, payload)
    return replaced[root]


class ContinuousState(NamedTuple):
    """A continuous state: node, initial value, value seen by blocks, slope and limits."""

    state: int
    init: int
    seen: int
    slope: int
    limits: tuple[int, int]


def is_known_at_step_start(source: SignalSource) -> bool:
    """Return True if a source is a state port whose state is known at the start of the step."""
    if source.port != STATE_PORT or source.flat.type not in ("Integrator", "DiscreteIntegrator"):
        return False
    method = field_text(source.flat, "IntegratorMethod") or ""
    return source.flat.type == "Integrator" or contains_word(method, "forward")


class StatePorts:
    """States at state ports."""

    def __init__(self, timing: SampleTimes, shapes: DimensionInference, agenda: PendingCompletions) -> None:
        self.timing = timing
        self.builder = timing.builder
        self.failures = timing.failures
        self.shapes = shapes
        self.agenda = agenda
        self._states: dict[FlatBlock, Nodes] = {}
        self._shown: dict[FlatBlock, Signal] = {}

    def signal(self, flat: FlatBlock) -> Signal:
        """Return the state of a block at the start of the step; the block itself is lowered later."""
        if flat.passes:
            self.failures.note(flat, "its state port is used in an iterated subsystem, which is not supported")
            return placeholder_signal(self.builder)
        if flat not in self._shown:
            if flat not in self._states:
                shape = self.shapes.guesses.shapes.get((flat, STATE_PORT), (1,))
                self._states[flat] = np.array([self.builder.state() for _ in range(int(np.prod(shape)))]).reshape(shape)
            rate = self.timing.sample_time(flat)
            port = Signal(self._states[flat], rate.period, builder=self.builder)
            # the state is written at hits with the value for the next one, which must not show before that
            slow = flat.type == "DiscreteIntegrator" and rate.period not in (CONTINUOUS, CONSTANT)
            self._shown[flat] = self.timing.hold(flat, port, rate) if slow else port
            self.agenda.add(flat)
        return self._shown[flat]

    def states(self, key: Key, first: Nodes, latency: int = 1) -> list[int]:
        """Create state nodes, or take those created when the state port was read."""
        flat, number = key
        if number == STATE_PORT and flat in self._states:
            # the port was read before its block was lowered, as a scalar until a pass has determined its size
            if self._states[flat].size == first.size:
                return [int(node) for node in self._states[flat].ravel()]
            self.shapes.guesses.shape(key, first.shape)
        states = [self.builder.state(latency) for _ in range(first.size)]
        if number == STATE_PORT:
            self._states.setdefault(flat, np.array(states, dtype=np.int64).reshape(first.shape))
        return states

    def resolve_initial_values(self, integrated: Sequence[ContinuousState]) -> list[ContinuousState]:
        """Resolve initial values of continuous states that depend on the states themselves."""
        reads = [self.builder.node("state", (), which) for which in range(len(self.builder.states))]
        inits = {read: s.init for read, s in zip(reads, self.builder.states, strict=True) if s.init >= 0}
        starts = self._resolved_initial_values(inits | {state.state: state.init for state in integrated})
        for which, read in enumerate(reads):
            if read in starts and self.builder.states[which].init >= 0:
                self.builder.states[which] = self.builder.states[which]._replace(init=starts[read])
        return [state._replace(init=starts.get(state.state, state.init)) for state in integrated]

    def _resolved_initial_values(self, inits: dict[int, int]) -> dict[int, int]:
        starts: dict[int, int] = {}
        for flat in self._shown:
            for state in map(int, self._states[flat].ravel()):
                start = resolve_initial_value(self.builder, state, inits) if state in inits else self.builder.const(0.0)
                if start is None:
                    self.failures.note(flat, "its initial value depends on its own state")
                elif state in inits:
                    starts[state] = start
        return starts
