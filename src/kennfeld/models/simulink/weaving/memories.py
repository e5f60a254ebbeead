"""What blocks remember from one step to the next, or from one pass of a subsystem to the next within a step."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.signals import CONSTANT, CONTINUOUS, Nodes, Signal, Wired, fastest
from kennfeld.models.simulink.flattening.atoms import STATE, Atom
from kennfeld.models.simulink.weaving.gates import Gates
from kennfeld.models.simulink.weaving.guesses import Key, Shape
from kennfeld.models.simulink.weaving.site import Site, resized
from kennfeld.models.simulink.weaving.state_ports import StatePorts
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["Memories"]


class Memories:
    """The memories of blocks; `arriving` gives the signals at the inputs of a block as far as they are built."""

    def __init__(self, gates: Gates, ports: StatePorts, arriving: Callable[[Atom], Sequence[Wired]]) -> None:
        self.loom = gates.loom
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

    def remember(self, site: Site, number: int, init: Signal, then: Callable[[Signal], Signal], latency: int) -> Signal:
        """A memory of a block that is read now and written at the end of the step."""
        atom, key = site.atom, (site.atom.first, number)
        shape = self.shapes.of(key, init)
        try:
            first = resized(init.nodes, shape)
        except NoValueError:
            first = init.nodes
        period = site.period()
        read = Signal(self._read((atom, number), first, latency), period if period else CONTINUOUS)
        seen = self.restarted(atom, read, first)
        self._writes[atom, number] = lambda: self._new(site, key, seen, then)
        return replace(seen, period=period or CONTINUOUS)

    def always_later(self, site: Site, init: Signal, x: Callable[[], Signal]) -> Signal:
        """A signal of the step before, made later, whether or not the subsystem around the block runs."""
        site.before += 1
        key, first = (site.atom, STATE - site.before), init.nodes
        read = self._read(key, first, 1)
        self._writes[key] = lambda: resized(self.timing.at_major(x()).nodes, read.shape)
        return Signal(read, CONTINUOUS)

    def restarted(self, atom: Atom, read: Signal, first: Nodes) -> Signal:
        """A memory that begins anew when the subsystem around it is enabled again."""
        begins = self.gates.restart(atom)
        if begins is None:
            return read
        runs = np.array([begins], dtype=np.int64)
        return replace(read, nodes=each(self.loom, "select", runs, first, read.nodes))

    def is_sound(self, site: Site) -> bool:
        """Whether all signals at the inputs of a block could be built."""
        return all(wired.sound for wired in self._arriving(site.atom))

    def check_widened(self, site: Site, key: Key) -> None:
        """Tell of a memory that is a vector for the sake of what is behind it, though its input is a scalar."""
        what = self.shapes.widened(key)
        if what:
            self.failures.note(site.atom, what)

    # several passes within a step

    def _read(self, key: Key, first: Nodes, latency: int) -> Nodes:
        """What a memory holds when its block is built: what the step before has left, or the pass before."""
        atom, number = key
        if atom.earlier is not None:
            found = self._after((atom.earlier, number))
            return resized(found, first.shape)
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
            self.loom.close(state, int(init), int(node))

    # what a block leaves

    def _new(self, site: Site, key: Key, seen: Signal, then: Callable[[Signal], Signal]) -> Nodes:
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
        return each(self.loom, "select", np.array([written], dtype=np.int64), new.nodes, seen.nodes)

    def _fitted(self, site: Site, key: Key, new: Signal, seen: Signal) -> Signal:
        """What a block leaves, in the shape of its memory; the next pass takes another shape that it has."""
        if new.shape == seen.shape:
            return new
        if new.size == 1:
            self.check_widened(site, key)
            return replace(new, nodes=resized(new.nodes, seen.shape))
        self.ask(site, key, new.shape, seen.shape)
        return seen

    def ask(self, site: Site, key: Key, wanted: Shape, there: Shape) -> None:
        """Give a memory another shape in the next pass; tell of one that did not take it, as what it starts with."""
        if self.guesses.shapes.get(key) == wanted:
            sizes = ["x".join(map(str, shape)) for shape in (there, wanted)]
            self.failures.note(site.atom, f"what it starts with has the size {sizes[0]}, and its input {sizes[1]}")
        self.guesses.shape(key, wanted)

    def _inherited(self, site: Site) -> float:
        """The sample time of a block's inputs."""
        found = fastest([wired.period for wired in self._arriving(site.atom)])
        return CONTINUOUS if found == CONSTANT else found
