"""State ports: the states of integrators as the step begins, which may be read before the integrators are built."""

from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.models.simulink.expressions.signals import CONSTANT, CONTINUOUS, Nodes, Signal
from kennfeld.models.simulink.flattening.atoms import STATE, Atom, Source
from kennfeld.models.simulink.weaving.failures import stand_in
from kennfeld.models.simulink.weaving.guesses import Key, Shapes
from kennfeld.models.simulink.weaving.integration import Integrated
from kennfeld.models.simulink.weaving.site import Site
from kennfeld.models.simulink.weaving.starts import at_start
from kennfeld.models.simulink.weaving.timing import Timing
from kennfeld.models.simulink.weaving.visiting import Agenda

__all__ = ["StatePorts", "is_ahead"]


def is_ahead(source: Source, site: Callable[[Atom], Site]) -> bool:
    """Whether a source is the state port of a block whose state is known as the step begins."""
    if source.port != STATE or source.atom.kind not in ("Integrator", "DiscreteIntegrator"):
        return False
    return source.atom.kind == "Integrator" or "Forward" in site(source.atom).text("IntegratorMethod")


class StatePorts:
    """The states that state ports may show, and those that they do."""

    def __init__(self, timing: Timing, shapes: Shapes, agenda: Agenda) -> None:
        self.timing = timing
        self.loom = timing.loom
        self.failures = timing.failures
        self.shapes = shapes
        self.agenda = agenda
        self._states: dict[Atom, Nodes] = {}
        self._shown: dict[Atom, Signal] = {}

    def signal(self, atom: Atom) -> Signal:
        """The state of a block as the step begins; the block itself, which a reset may change, is built later."""
        if atom.passes:
            self.failures.note(atom, "its state port is read in a subsystem that runs several times in a step")
            return stand_in(self.loom)
        if atom not in self._shown:
            if atom not in self._states:
                shape = self.shapes.guesses.shapes.get((atom, STATE), (1,))
                self._states[atom] = np.array([self.loom.state() for _ in range(int(np.prod(shape)))]).reshape(shape)
            rate = self.timing.own(atom)
            port = Signal(self._states[atom], rate.period)
            slow = atom.kind == "DiscreteIntegrator" and rate.period not in (CONTINUOUS, CONSTANT)
            self._shown[atom] = self.timing.held(atom, port, rate) if slow else port
            self.agenda.add(atom)
        return self._shown[atom]

    def states(self, key: Key, first: Nodes, latency: int = 1) -> list[int]:
        """New memories; those of a state port where it has been read before."""
        atom, number = key
        if number == STATE and atom in self._states:
            if self._states[atom].size == first.size:
                return [int(node) for node in self._states[atom].ravel()]
            self.shapes.guesses.shape(key, first.shape)
        states = [self.loom.state(latency) for _ in range(first.size)]
        if number == STATE:
            self._states.setdefault(atom, np.array(states, dtype=np.int64).reshape(first.shape))
        return states

    def settled(self, integrated: Sequence[Integrated]) -> list[Integrated]:
        """Free the first values behind state ports of the states themselves; continuous states with theirs."""
        reads = [self.loom.node("state", (), which) for which in range(len(self.loom.states))]
        inits = {read: s.init for read, s in zip(reads, self.loom.states, strict=True) if s.init >= 0}
        found = self._starts(inits | {one.state: one.init for one in integrated})
        for which, read in enumerate(reads):
            if read in found and self.loom.states[which].init >= 0:
                self.loom.states[which] = self.loom.states[which]._replace(init=found[read])
        return [one._replace(init=found.get(one.state, one.init)) for one in integrated]

    def _starts(self, inits: dict[int, int]) -> dict[int, int]:
        """The first values of the states that ports show."""
        found: dict[int, int] = {}
        for atom in self._shown:
            for state in map(int, self._states[atom].ravel()):
                made = at_start(self.loom, state, inits) if state in inits else self.loom.const(0.0)
                if made is None:
                    self.failures.note(atom, "its initial value depends on its own state")
                elif state in inits:
                    found[state] = made
        return found
