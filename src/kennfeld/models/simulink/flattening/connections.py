"""Inputs of the placed blocks: the sources at their ports, at special ports, and the data stores that they use.

Where the signal at an input is made, and what it is called on its way: through ports, tags, variants and buses.
"""

import re
from collections.abc import Iterator, Mapping, Sequence

from kennfeld.models.simulink.flattening.flat_model import STATE_PORT, FlatBlock, SignalSource
from kennfeld.models.simulink.flattening.hierarchy import (
    SPECIAL,
    FlatteningState,
    SystemInstance,
    enclosing_systems,
    goto_tag,
)
from kennfeld.models.simulink.reader.block_ports import element_of, elements, port_number
from kennfeld.models.simulink.reader.model_tree import Endpoint, ModelBlock, Ports
from kennfeld.models.simulink.variables.mask_scope import names_assigned_by_functions

__all__ = ["ConnectionResolver", "bus_member_names"]

_WIDE = ("global", "scoped")  # visible in other systems than their own

_MOST_INPUTS = 1_000_000  # of all blocks


class SignalTracer:
    """Follows lines back to the blocks that they come from. `gotos` are the Goto blocks by their tags."""

    def __init__(self, gotos: Mapping[str, Sequence[tuple[SystemInstance, ModelBlock]]]) -> None:
        self._local: dict[tuple[SystemInstance, str], tuple[SystemInstance, ModelBlock]] = {}
        self._wide: dict[str, list[tuple[SystemInstance, ModelBlock]]] = {}
        for tag, ends in gotos.items():
            for level, goto in ends:
                self._local.setdefault((level, tag), (level, goto))
                if (goto.value("TagVisibility") or "local") in _WIDE:
                    self._wide.setdefault(tag, []).append((level, goto))

    def label(self, level: SystemInstance, end: Endpoint) -> str:
        """The name of the line into a port, or of the line that it comes from through ports and tags."""
        for here, source in self._way(level, end):
            name = here.labels.get(source, "")
            block = here.system.by_sid.get(source.block)
            if name and not name.startswith("<"):
                return name
            if name.startswith("<") and name.endswith(">"):
                return name[1:-1]
            if block is not None and source.number in block.signals:
                return block.signals[source.number]
        return ""

    def source(self, level: SystemInstance, end: Endpoint) -> SignalSource | None:
        """The block output that feeds an input port, through subsystems and tags."""
        last = self._begin(level, end)
        if last is None:
            return None
        here, source = last
        if (picked := self._picked(here, source)) is not None:
            return self.source(*picked)
        if (atom := here.atoms.get(source.block)) is not None:
            port = {"out": source.number - 1, "state": STATE_PORT}.get(source.port)
            return None if port is None else SignalSource(atom, port)
        below = here.below.get(source.block)
        if below is not None:
            outport = below.port("Outport", source.number)
            held = below.atoms.get(outport.sid) if outport is not None else None
            return SignalSource(held, 0) if held is not None else None
        return None

    def _picked(self, level: SystemInstance, source: Endpoint) -> tuple[SystemInstance, Endpoint] | None:
        """The input of a bus creator whose signal a bus selector picks; None where there is more between them.

        So a bus may hold a signal that is computed from another one of the same bus.
        """
        atom = level.atoms.get(source.block)
        if atom is None or atom.kind != "BusSelector" or (atom.block.value("OutputAsBus") or "off") == "on":
            return None
        ways = (atom.block.value("OutputSignals") or "").split(",")
        if not source.number <= len(ways):
            return None
        found: tuple[SystemInstance, Endpoint] | None = (level, Endpoint(source.block, "in"))
        for name in ways[source.number - 1].strip().split("."):
            found = self._member(*found, name) if found is not None else None
        return found

    def _member(self, level: SystemInstance, end: Endpoint, name: str) -> tuple[SystemInstance, Endpoint] | None:
        """The input of the bus creator that feeds an end, by the name of its signal."""
        last = self._begin(level, end)
        atom = last[0].atoms.get(last[1].block) if last is not None else None
        if last is None or atom is None or atom.kind != "BusCreator":
            return None
        here, sid = last[0], atom.block.sid
        ends = [Endpoint(sid, "in", number) for number in range(1, here.fed.get(sid, 0) + 1)]
        names = bus_member_names([self.label(here, one) for one in ends], atom.block.value("Inputs") or "")
        return (here, ends[names.index(name)]) if name in names else None

    def _begin(self, level: SystemInstance, end: Endpoint) -> tuple[SystemInstance, Endpoint] | None:
        """Where the signal at an end is made."""
        way = list(self._way(level, end))
        return way[-1] if way else None

    def _way(self, level: SystemInstance, end: Endpoint) -> Iterator[tuple[SystemInstance, Endpoint]]:
        """The ends of lines that a signal passes, from where it is used back to where it is made."""
        here: SystemInstance | None = level
        at: Endpoint | None = end
        seen: set[tuple[int, Endpoint]] = set()
        while here is not None and at is not None and (id(here), at) not in seen:
            seen.add((id(here), at))
            source = _original(here, here.sources.get(at))
            if source is None:
                return
            yield here, source
            here, at = self._behind(here, source)

    def _behind(self, level: SystemInstance, source: Endpoint) -> tuple[SystemInstance | None, Endpoint | None]:
        """The input port that a block output merely passes on; None where the block computes something."""
        if source in level.passing:
            return level, level.passing[source]
        if source.block in level.atoms:
            return None, None
        block = level.system.by_sid[source.block]
        if block.type == "Inport" and level.holder is not None and level.parent is not None:
            return level.parent, Endpoint(level.holder.sid, "in", port_number(block))
        if block.type == "From":
            goto = self.goto(level, goto_tag(block))
            return (goto[0], Endpoint(goto[1].sid, "in")) if goto is not None else (None, None)
        below = level.below.get(source.block)
        outport = below.port("Outport", source.number) if below is not None else None
        if below is None or outport is None or outport.sid in below.atoms:
            return None, None
        return below, Endpoint(outport.sid, "in")

    def goto(self, level: SystemInstance, tag: str) -> tuple[SystemInstance, ModelBlock] | None:
        """The Goto of a tag: local ones in the same system, scoped ones below their mark, global ones anywhere."""
        if (level, tag) in self._local:
            return self._local[level, tag]
        for where, goto in self._wide.get(tag, ()):
            if goto.value("TagVisibility") == "global" or self._scoped(level, where, tag):
                return where, goto
        return None

    def _scoped(self, level: SystemInstance, where: SystemInstance, tag: str) -> bool:
        """Whether a mark of the tag's visibility stands in a system around both the From and the Goto."""
        shared = set(enclosing_systems(where))
        return any(
            goto_tag(mark) == tag
            for here in enclosing_systems(level)
            if here in shared
            for mark in here.system.of("GotoTagVisibility")
        )


def _original(level: SystemInstance, source: Endpoint | None) -> Endpoint | None:
    """The end of the inport itself, where a line begins at another mark of the same inport."""
    block = level.system.by_sid.get(source.block) if source is not None else None
    if source is None or block is None or block.type != "InportShadow":
        return source
    inport = level.port("Inport", port_number(block))
    return Endpoint(inport.sid, source.port, source.number) if inport is not None else None


def bus_member_names(labels: Sequence[str], stated: str) -> list[str]:
    """The names of a bus creator's signals: those of its lines, else as stated, else numbered.

    >>> bus_member_names(["n", "", "n", ""], "'a','b'")
    ['n', 'b', 'n3', 'signal4']
    """
    listed = re.findall(r"'([^']*)'", stated)
    names: list[str] = []
    for at, label in enumerate(labels):
        name = label or (listed[at] if at < len(listed) else "") or f"signal{at + 1}"
        names.append(f"{name}{at + 1}" if name in names else name)
    return names


class ConnectionResolver:
    """Connects what has been placed."""

    def __init__(self, placed: FlatteningState) -> None:
        self.placed = placed
        self.wires = SignalTracer(placed.gotos)
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
            atom.inputs = [end if isinstance(end, SignalSource) else self.wires.source(*end) for end in ends]

    def _open_tags(self, level: SystemInstance) -> None:
        """Place the From blocks without a Goto: they are inputs of the model."""
        for block in level.system.of("From"):
            if self.wires.goto(level, goto_tag(block)) is None:
                made = self.placed.atom(level, block, "From")
                made.hidden = level.element > 1 or max(level.passes, default=1) > 1

    def _blocks(self, level: SystemInstance) -> None:
        """Connect the blocks of a system."""
        for sid, atom in level.atoms.items():
            self._inputs(level, sid, atom)
            if atom.kind in ("DataStoreRead", "DataStoreWrite"):
                atom.store = _store(level, atom.block)

    def _controls(self, level: SystemInstance) -> None:
        """Connect the special ports of the conditional subsystems in a system."""
        for sid, below in level.below.items():
            control = below.control
            if control is not None and control.block is below.holder:
                control.inputs = [self._controlling(level, sid, port) for port in control.special]

    def _share(self, level: SystemInstance, atom: FlatBlock) -> None:
        """Blocks that read and write the data stores of code for it."""
        data = atom.block.chart.data if atom.block.chart is not None and not atom.passes else ()
        atom.shared = tuple(one.name for one in data if one.scope == "DATA_STORE_MEMORY_DATA")
        written = names_assigned_by_functions(atom.block.script) if atom.shared else frozenset()
        outputs = sum(one.scope == "OUTPUT_DATA" for one in data)
        for at, name in enumerate(atom.shared):
            atom.inputs.append(SignalSource(self._access(level, atom, "DataStoreRead", name), 0))
            if name in written:
                self._access(level, atom, "DataStoreWrite", name).inputs.append(SignalSource(atom, outputs + at))

    def _access(self, level: SystemInstance, atom: FlatBlock, kind: str, name: str) -> FlatBlock:
        block = ModelBlock(kind, name, "", f"{atom.block.path}/{name}", {"DataStoreName": name}, ports=Ports())
        made = FlatBlock(kind, block, f"{atom.path}/{name}", level.scope, level.control, places=atom.places, made=True)
        made.store = _store(level, block)
        self.placed.atoms.append(made)
        return made

    def _controlling(self, level: SystemInstance, sid: str, port: str) -> SignalSource | None:
        """The source at a special port; that of a variant is at the subsystem around it."""
        while level.variant:
            assert level.parent is not None
            assert level.holder is not None
            sid, level = level.holder.sid, level.parent
        return self.wires.source(level, Endpoint(sid, port))

    def _inputs(self, level: SystemInstance, sid: str, atom: FlatBlock) -> None:
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


def _store(level: SystemInstance, block: ModelBlock) -> FlatBlock | None:
    """The memory of a name that is nearest around a block."""
    name = _store_name(block)
    for here in enclosing_systems(level):
        for memory in here.system.of("DataStoreMemory"):
            if _store_name(memory) == name:
                return here.atoms.get(memory.sid)
    return None


def _store_name(block: ModelBlock) -> str:
    return (block.value("DataStoreName") or "A").strip()
