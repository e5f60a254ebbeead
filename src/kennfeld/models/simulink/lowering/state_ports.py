"""First values that depend on themselves in appearance only.

What resets an integrator may be made from its own state, with another value in the first step: the state port leads
through a block `IC` to the port of the initial value. In the first step that block gives its constant, so that the
initial value is known once the memories in its way are replaced by what they start with.

Continuous states, advanced by a fixed-step Runge-Kutta method within one step of the graph.

The minor steps evaluate the derivatives again, at states and times in between; what only changes at major steps (the
op `major` marks it) and all inputs keep their values. Coefficients: Euler; Heun; Bogacki and Shampine, Appl. Math.
Lett. 2 (1989) 321; the classic method of fourth order; Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, its
solution of fifth order without error control.

State ports: the states of integrators as the step begins, which may be read before the integrators are built.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.operations import OPERATIONS
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.flattening.flat_model import STATE_PORT, FlatBlock, SignalSource
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import placeholder_signal
from kennfeld.models.simulink.lowering.pass_state import DimensionInference, Key, PendingCompletions
from kennfeld.models.simulink.lowering.scheduling import SampleTimes
from kennfeld.models.simulink.signals import CONSTANT, CONTINUOUS, Signal

__all__ = ["ContinuousState", "StatePorts", "is_known_at_step_start"]

_MOST_ROUNDS = 100  # memories that start from one another


def resolve_initial_value(builder: GraphBuilder, state: int, inits: Mapping[int, int]) -> int | None:
    """The node of a state's first value, free of the state itself; None where it does depend on itself.

    `inits` are the nodes of first values as they are written, by the nodes of states.
    """
    made = inits[state]
    for _ in range(_MOST_ROUNDS):
        behind = _behind(builder, made)
        if state not in behind:
            return made
        known = {at: inits[at] for at in behind if at in inits and at != state}
        if not known:
            return None
        made = _with(builder, made, behind, known)
    return None


def _behind(builder: GraphBuilder, root: int) -> set[int]:
    """The nodes that a node is computed from within the step, and itself."""
    seen, stack = {root}, [root]
    while stack:
        args = [a for a in builder.nodes[stack.pop()].args if a not in seen]
        seen.update(args)
        stack += args
    return seen


def _with(builder: GraphBuilder, root: int, behind: set[int], known: Mapping[int, int]) -> int:
    """A node with some states replaced."""
    made = dict(known)
    for at in sorted(behind - known.keys()):
        op, args, payload = builder.nodes[at]
        changed = tuple(made[a] for a in args)
        if op == "major" and builder.value(changed[0]) is not None:
            made[at] = changed[0]
        else:
            made[at] = builder.call(op, *changed) if op in OPERATIONS else builder.node(op, changed, payload)
    return made[root]


class ContinuousState(NamedTuple):
    """A continuous state: its memory, its first value, how the blocks see it, its slope, limits, and when it runs."""

    state: int
    init: int
    seen: int
    slope: int
    limits: tuple[int | None, int | None] = (None, None)
    active: int | None = None


def is_known_at_step_start(source: SignalSource, site: Callable[[FlatBlock], BlockContext]) -> bool:
    """Whether a source is the state port of a block whose state is known as the step begins."""
    if source.port != STATE_PORT or source.atom.kind not in ("Integrator", "DiscreteIntegrator"):
        return False
    return source.atom.kind == "Integrator" or "Forward" in site(source.atom).text("IntegratorMethod")


class StatePorts:
    """The states that state ports may show, and those that they do."""

    def __init__(self, timing: SampleTimes, shapes: DimensionInference, agenda: PendingCompletions) -> None:
        self.timing = timing
        self.builder = timing.builder
        self.failures = timing.failures
        self.shapes = shapes
        self.agenda = agenda
        self._states: dict[FlatBlock, Nodes] = {}
        self._shown: dict[FlatBlock, Signal] = {}

    def signal(self, atom: FlatBlock) -> Signal:
        """The state of a block as the step begins; the block itself, which a reset may change, is built later."""
        if atom.passes:
            self.failures.note(atom, "its state port is read in a subsystem that runs several times in a step")
            return placeholder_signal(self.builder)
        if atom not in self._shown:
            if atom not in self._states:
                shape = self.shapes.guesses.shapes.get((atom, STATE_PORT), (1,))
                self._states[atom] = np.array([self.builder.state() for _ in range(int(np.prod(shape)))]).reshape(shape)
            rate = self.timing.own(atom)
            port = Signal(self._states[atom], rate.period)
            slow = atom.kind == "DiscreteIntegrator" and rate.period not in (CONTINUOUS, CONSTANT)
            self._shown[atom] = self.timing.held(atom, port, rate) if slow else port
            self.agenda.add(atom)
        return self._shown[atom]

    def states(self, key: Key, first: Nodes, latency: int = 1) -> list[int]:
        """New memories; those of a state port where it has been read before."""
        atom, number = key
        if number == STATE_PORT and atom in self._states:
            if self._states[atom].size == first.size:
                return [int(node) for node in self._states[atom].ravel()]
            self.shapes.guesses.shape(key, first.shape)
        states = [self.builder.state(latency) for _ in range(first.size)]
        if number == STATE_PORT:
            self._states.setdefault(atom, np.array(states, dtype=np.int64).reshape(first.shape))
        return states

    def settled(self, integrated: Sequence[ContinuousState]) -> list[ContinuousState]:
        """Free the first values behind state ports of the states themselves; continuous states with theirs."""
        reads = [self.builder.node("state", (), which) for which in range(len(self.builder.states))]
        inits = {read: s.init for read, s in zip(reads, self.builder.states, strict=True) if s.init >= 0}
        found = self._starts(inits | {one.state: one.init for one in integrated})
        for which, read in enumerate(reads):
            if read in found and self.builder.states[which].init >= 0:
                self.builder.states[which] = self.builder.states[which]._replace(init=found[read])
        return [one._replace(init=found.get(one.state, one.init)) for one in integrated]

    def _starts(self, inits: dict[int, int]) -> dict[int, int]:
        """The first values of the states that ports show."""
        found: dict[int, int] = {}
        for atom in self._shown:
            for state in map(int, self._states[atom].ravel()):
                made = resolve_initial_value(self.builder, state, inits) if state in inits else self.builder.const(0.0)
                if made is None:
                    self.failures.note(atom, "its initial value depends on its own state")
                elif state in inits:
                    found[state] = made
        return found
