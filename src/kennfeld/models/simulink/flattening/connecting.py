"""Inputs of the placed blocks: the sources at their ports, at special ports, and the data stores that they use."""

from kennfeld.models.simulink.files.bus_ports import element_of, elements
from kennfeld.models.simulink.files.ports import port_number
from kennfeld.models.simulink.files.tree import Block, Endpoint, Ports
from kennfeld.models.simulink.flattening.atoms import Atom, Source
from kennfeld.models.simulink.flattening.levels import SPECIAL, Level, around, tag_of
from kennfeld.models.simulink.flattening.placed import Placed
from kennfeld.models.simulink.flattening.wires import Wires
from kennfeld.models.simulink.variables.scopes import written_names

__all__ = ["Connecting"]

_MOST_INPUTS = 1_000_000  # of all blocks


class Connecting:
    """Connects what has been placed."""

    def __init__(self, placed: Placed) -> None:
        self.placed = placed
        self.wires = Wires(placed.gotos)
        self._ends = 0

    def connect(self) -> None:
        """Find the sources of all inputs."""
        for level in self.placed.levels:
            self._open_tags(level)
        for level in self.placed.levels:
            self._blocks(level)
            self._controls(level)
            for atom in [one for one in level.atoms.values() if one.kind == "MATLAB Function"]:
                self._share(level, atom)
        for atom, ends in self.placed.joints:
            atom.inputs = [end if isinstance(end, Source) else self.wires.source(*end) for end in ends]

    def _open_tags(self, level: Level) -> None:
        """Place the From blocks without a Goto: they are inputs of the model."""
        for block in level.system.of("From"):
            if self.wires.goto(level, tag_of(block)) is None:
                made = self.placed.atom(level, block, "From")
                made.hidden = level.element > 1 or max(level.passes, default=1) > 1

    def _blocks(self, level: Level) -> None:
        """Connect the blocks of a system."""
        for sid, atom in level.atoms.items():
            self._inputs(level, sid, atom)
            if atom.kind in ("DataStoreRead", "DataStoreWrite"):
                atom.store = _store(level, atom.block)

    def _controls(self, level: Level) -> None:
        """Connect the special ports of the conditional subsystems in a system."""
        for sid, below in level.below.items():
            control = below.control
            if control is not None and control.block is below.holder:
                control.inputs = [self._controlling(level, sid, port) for port in control.special]

    def _share(self, level: Level, atom: Atom) -> None:
        """Blocks that read and write the data stores of code for it."""
        data = atom.block.chart.data if atom.block.chart is not None and not atom.passes else ()
        atom.shared = tuple(one.name for one in data if one.scope == "DATA_STORE_MEMORY_DATA")
        written = written_names(atom.block.script) if atom.shared else frozenset()
        outputs = sum(one.scope == "OUTPUT_DATA" for one in data)
        for at, name in enumerate(atom.shared):
            atom.inputs.append(Source(self._access(level, atom, "DataStoreRead", name), 0))
            if name in written:
                self._access(level, atom, "DataStoreWrite", name).inputs.append(Source(atom, outputs + at))

    def _access(self, level: Level, atom: Atom, kind: str, name: str) -> Atom:
        block = Block(kind, name, "", f"{atom.block.path}/{name}", {"DataStoreName": name}, ports=Ports())
        made = Atom(kind, block, f"{atom.path}/{name}", level.scope, level.control, places=atom.places, made=True)
        made.store = _store(level, block)
        self.placed.atoms.append(made)
        return made

    def _controlling(self, level: Level, sid: str, port: str) -> Source | None:
        """The source at a special port; that of a variant is at the subsystem around it."""
        while level.variant:
            assert level.parent is not None
            assert level.holder is not None
            sid, level = level.holder.sid, level.parent
        return self.wires.source(level, Endpoint(sid, port))

    def _inputs(self, level: Level, sid: str, atom: Atom) -> None:
        count = max(level.fed.get(sid, 0), atom.block.ports.inputs if atom.block.ports is not None else 0)
        self._ends += count
        if self._ends > _MOST_INPUTS:
            raise OverflowError(f"its blocks have more than {_MOST_INPUTS} inputs")
        ends = [Endpoint(sid, "in", number) for number in range(1, count + 1)]
        if atom.kind == "BusElements":
            shared = elements(level.system, "Outport", port_number(atom.block))
            ends = [Endpoint(one.sid, "in") for one in shared]
            atom.ways = tuple(element_of(one) or "" for one in shared)
        atom.inputs = [self.wires.source(level, end) for end in ends]
        if atom.kind == "BusElement" and level.parent is not None and level.holder is not None:
            atom.inputs = [self.wires.source(level.parent, Endpoint(level.holder.sid, "in", port_number(atom.block)))]
            atom.ways = (element_of(atom.block) or "",)
        if atom.kind == "Chart" and atom.block.system is not None:
            atom.special = {SPECIAL[port.type]: port for port in atom.block.system.of("TriggerPort")}
            ends += [Endpoint(sid, kind) for kind in atom.special]
            atom.inputs += [self.wires.source(level, Endpoint(sid, kind)) for kind in atom.special]
        atom.taken = {i: name for i, end in enumerate(ends) if (name := self.wires.label(level, end))}
        atom.names = {number - 1: name for number, name in atom.block.signals.items()} | level.named.get(sid, {})


def _store(level: Level, block: Block) -> Atom | None:
    """The memory of a name that is nearest around a block."""
    name = _store_name(block)
    for here in around(level):
        for memory in here.system.of("DataStoreMemory"):
            if _store_name(memory) == name:
                return here.atoms.get(memory.sid)
    return None


def _store_name(block: Block) -> str:
    return (block.value("DataStoreName") or "A").strip()
