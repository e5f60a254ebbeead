"""The channels that a model takes: one for each port from outside, one for each signal that is used of an open bus."""

from kennfeld.graph import CLOCK
from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.signals import OpenBus
from kennfeld.models.simulink.files.bus_ports import port_label
from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.weaving.guesses import Guesses

__all__ = ["Inputs"]


class Inputs(dict[str, Atom | None]):
    """The channels by name, each with the port that takes it; None of those that no port names."""

    def __init__(self, loom: Loom, guesses: Guesses) -> None:
        super().__init__()
        self.loom = loom
        self.guesses = guesses

    def name(self, atom: Atom) -> str:
        """The name of the channel that a port takes."""
        name = port_label(atom.block) if atom.kind == "Inport" else (atom.block.value("GotoTag") or "A").strip()
        if name in self.guesses.taken or name in CLOCK:
            name = f"{name}_in"
        self[name] = atom
        return name

    def opened(self, atom: Atom) -> OpenBus:
        """The bus that a port takes; each of its signals that is used becomes an input."""
        return OpenBus(name=self.name(atom), node=self._member)

    def _member(self, name: str) -> int:
        self.setdefault(name, None)
        return self.loom.input(name)
