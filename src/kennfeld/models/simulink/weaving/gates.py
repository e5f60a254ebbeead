"""Conditional subsystems: whether a block runs in a step, and whether its memory begins anew or is written."""

from collections.abc import Callable

from kennfeld.models.simulink.expressions.signals import Signal, Wired
from kennfeld.models.simulink.flattening.atoms import Atom, Source, begins_anew
from kennfeld.models.simulink.weaving.schedule import Rate
from kennfeld.models.simulink.weaving.timing import Timing

__all__ = ["Gates"]


class Gates:
    """The conditions of blocks as nodes; `value` gives the signals of what stands for conditional subsystems."""

    def __init__(self, timing: Timing, value: Callable[[Source], Wired]) -> None:
        self.timing = timing
        self.loom = timing.loom
        self._value = value

    def active(self, atom: Atom) -> int | None:
        """The node that says whether a block runs; None where it always does."""
        if atom.control is None:
            return None
        node = self._node(atom.control, 0)
        always = node is not None and self.loom.value(node) == 1 and not atom.repeats
        return None if always else node

    def restart(self, atom: Atom) -> int | None:
        """The node that says whether the memory of a block begins anew; None where it never does."""
        if atom.control is None or not begins_anew(atom):
            return None
        if any(number > 1 for number in atom.passes[len(atom.control.passes) :]):
            return None  # only the first pass of a step does
        return self._node(atom.control, 1)

    def _node(self, control: Atom, port: int) -> int | None:
        found = self._value(Source(control, port))
        return int(found.nodes.ravel()[0]) if isinstance(found, Signal) else None

    def written(self, atom: Atom, period: float) -> int | None:
        """The node that says whether a block's memory is written; None where it always is."""
        active = self.active(atom)
        return self.both(active, self.timing.hit(self.timing.rate(atom) or Rate(period)))

    def both(self, *conditions: int | None) -> int | None:
        """The node that says whether all conditions hold; None where there are none."""
        found: int | None = None
        for condition in conditions:
            if condition is not None:
                found = condition if found is None else self.loom.call("and", found, condition)
        return found

    def every_step(self, atom: Atom) -> bool:
        """Whether a block's memory is written in every step of the model."""
        every = self.timing.hit(self.timing.own(atom)) is None
        return atom.control is None and every and not atom.repeats and not atom.begins
