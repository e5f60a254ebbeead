"""Continuous states: how blocks see them now, and their slopes, with which the solver advances them."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.models.simulink.expressions.signals import CONTINUOUS, Nodes, Signal
from kennfeld.models.simulink.weaving.guesses import Key
from kennfeld.models.simulink.weaving.integration import Integrated, advance
from kennfeld.models.simulink.weaving.memories import Memories
from kennfeld.models.simulink.weaving.site import Site, resized
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["ContinuousStates"]


class ContinuousStates:
    """The states that are integrated over time."""

    def __init__(self, memories: Memories) -> None:
        self.loom = memories.loom
        self.memories = memories
        self.shapes = memories.shapes
        self._found: list[Integrated] = []

    def integrate(
        self,
        site: Site,
        number: int,
        init: Signal,
        slope: Callable[[Signal], Signal],
        reset: Signal | None,
        limits: tuple[Signal, Signal] | None,
    ) -> Signal:
        """A continuous state as it is now: the solver advances it at the end of the step."""
        if site.atom.passes:
            raise UnsupportedError("it is integrated over time in a subsystem that runs several times in a step")
        key = (site.atom, number)
        first = self._first(site, key, init, reset, limits)
        states = self.memories.ports.states(key, first)
        read = Signal(np.array(states, dtype=np.int64).reshape(first.shape), CONTINUOUS)
        seen = self.memories.restarted(site.atom, read, first)
        if reset is not None:
            again = site.select(self.memories.timing.at_major(reset), Signal(first), seen)
            seen = replace(seen, nodes=again.nodes)

        def complete() -> None:
            moving = self._slopes(site, key, seen, slope)
            self._note(site, states, first, seen, moving, limits)

        self.memories.agenda.add(site.atom, complete)
        return seen

    def _first(
        self, site: Site, key: Key, init: Signal, reset: Signal | None, limits: tuple[Signal, Signal] | None
    ) -> Nodes:
        """The states at first, within their limits; as many as there are resets or limits, if these are several."""
        inside = init if limits is None else site.clip(init, *limits)
        first = site.spread(inside, *(one for one in (reset, *(limits or ())) if one is not None))[0]
        shape = self.shapes.of(key, first)
        return resized(first.nodes, shape) if first.size in (1, int(np.prod(shape))) else first.nodes

    def _slopes(self, site: Site, key: Key, seen: Signal, slope: Callable[[Signal], Signal]) -> Nodes:
        """The slopes of a block's states; the next pass takes another shape that they have."""
        rates = replace(seen, nodes=np.full(seen.shape, self.loom.const(0.0), dtype=np.int64))
        try:
            if self.memories.is_sound(site):
                rates = slope(seen)
        except UnsupportedError as unsupported:
            self.memories.failures.note(site.atom, *unsupported.parts)
        if rates.size == 1 < seen.size:
            self.memories.check_widened(site, key)
        if rates.size > 1 and rates.shape != seen.shape:
            self.memories.ask(site, key, rates.shape, seen.shape)
            rates = replace(seen, nodes=np.full(seen.shape, rates.nodes.ravel()[0], dtype=np.int64))
        return resized(rates.nodes, seen.shape)

    def _note(
        self,
        site: Site,
        states: Sequence[int],
        first: Nodes,
        seen: Signal,
        moving: Nodes,
        limits: tuple[Signal, Signal] | None,
    ) -> None:
        """Note the states of a block for the solver."""
        low, high = (None, None) if limits is None else tuple(resized(x.nodes, seen.shape).ravel() for x in limits)
        active = self.memories.gates.active(site.atom)
        parts = zip(states, first.ravel(), seen.nodes.ravel(), moving.ravel(), strict=True)
        for at, (state, init, now, rate) in enumerate(parts):
            bounds = (None, None) if low is None or high is None else (int(low[at]), int(high[at]))
            self._found.append(Integrated(state, int(init), int(now), int(rate), bounds, active))

    def settle(self) -> None:
        """Free the first values behind state ports of the states themselves."""
        self._found = self.memories.ports.settled(self._found)

    def advance(self, solver: str) -> None:
        """Close the states with what a solver makes of them in one step."""
        advance(self.loom, self._found, solver)
