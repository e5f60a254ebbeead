"""Connection of placed blocks: sources of inputs and control ports, and data stores.

A signal is traced through ports, tags, variants and buses to the block that computes it.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

from kennfeld.importers.simulink.flattening.flat_model import STATE_PORT, FlatBlock, SignalSource
from kennfeld.importers.simulink.flattening.hierarchy import (
    SPECIAL,
    FlatteningState,
    SystemInstance,
    enclosing_systems,
    goto_tag,
    model_instance,
)
from kennfeld.importers.simulink.reader.block_ports import element_of, elements, port_number
from kennfeld.importers.simulink.reader.model_tree import Endpoint, ModelBlock, Ports, join_path
from kennfeld.importers.simulink.variables.data_types import BusType
from kennfeld.importers.simulink.variables.mask_scope import (
    Scope,
    Variable,
    declared_store,
    names_assigned_by_functions,
)

_NONLOCAL_VISIBILITY = ("global", "scoped")  # Goto tags visible outside of their system

_TRIGGERED = ("dspsigops/Sample and Hold",)  # blocks without a system whose trigger is their last input
_MAX_INPUTS = 1_000_000  # of all blocks


class SignalTracer:
    """Traces lines back to the blocks they come from; `gotos` are the Goto blocks by tag."""

    def __init__(self, gotos: Mapping[str, Sequence[tuple[SystemInstance, ModelBlock]]]) -> None:
        self._local: dict[tuple[SystemInstance, str], tuple[SystemInstance, ModelBlock]] = {}
        self._wide: dict[str, list[tuple[SystemInstance, ModelBlock]]] = {}
        self._element_names: dict[FlatBlock, list[str]] = {}
        for tag, ends in gotos.items():
            for level, goto in ends:
                # of several Gotos with one tag in a system, the first one counts
                self._local.setdefault((level, tag), (level, goto))
                if goto.is_set_to("TagVisibility", *_NONLOCAL_VISIBILITY):
                    self._wide.setdefault(tag, []).append((level, goto))

    def label(self, level: SystemInstance, end: Endpoint) -> str:
        """Find the name of the line at a port, traced through ports and tags."""
        return self._label(self._trace(level, end))

    def connection(self, level: SystemInstance, end: Endpoint) -> tuple[SignalSource | None, str]:
        """Find the source of an input port and the name of its line, as `source` and `label` do."""
        passed = list(self._trace(level, end))
        return self._source(passed), self._label(passed)

    def _label(self, passed: Iterable[tuple[SystemInstance, Endpoint]]) -> str:
        for here, source in passed:
            name = here.labels.get(source, "")
            block = here.system.by_sid.get(source.block)
            # <name> is a propagated name, as a line in the diagram shows it
            if name and not name.startswith("<"):
                return name
            if name.startswith("<") and name.endswith(">"):
                return name[1:-1]
            if block is not None and source.number in block.signals:
                return block.signals[source.number]
        return ""

    def source(self, level: SystemInstance, end: Endpoint) -> SignalSource | None:
        """Find the block output that feeds an input port, traced through subsystems and tags."""
        return self._source(list(self._trace(level, end)))

    def _source(self, passed: Sequence[tuple[SystemInstance, Endpoint]]) -> SignalSource | None:
        if not passed:
            return None
        here, source = passed[-1]
        if (picked := self._selected_input(here, source)) is not None:
            return self.source(*picked)
        if (flat := here.flat_blocks.get(source.block)) is not None:
            # no other kinds of ports, such as physical ones, carry a signal
            port = {"out": source.number - 1, "state": STATE_PORT}.get(source.port)
            return None if port is None else SignalSource(flat, port)
        below = here.below.get(source.block)
        if below is not None:
            outport = below.port("Outport", source.number)
            block = below.flat_blocks.get(outport.sid) if outport is not None else None
            return SignalSource(block, 0) if block is not None else None
        return None

    def commented_source(self, level: SystemInstance, end: Endpoint) -> str:
        """Find the path of the commented-out block that fed a port, traced through subsystems and tags; or ""."""
        passed = list(self._trace(level, end))
        here, at = self._passed_on_input(*passed[-1]) if passed else (level, end)
        name = here.system.commented.get(at, "") if here is not None and at is not None else ""
        return join_path(*here.path, name) if here is not None and name else ""

    def _selected_input(self, level: SystemInstance, source: Endpoint) -> tuple[SystemInstance, Endpoint] | None:
        """Return the bus creator input that a bus selector selects, or None if other blocks lie between them.

        A bus may therefore contain a signal computed from another signal of the same bus.
        """
        flat = level.flat_blocks.get(source.block)
        if flat is None or flat.type != "BusSelector" or flat.block.is_set_to("OutputAsBus", "on"):
            return None
        paths = (flat.block.value("OutputSignals") or "").split(",")
        if not source.number <= len(paths):
            return None
        # from the selector back through nested creators, one name at a time
        creator: tuple[SystemInstance, Endpoint] | None = (level, Endpoint(source.block, "in"))
        for name in paths[source.number - 1].strip().split("."):
            creator = self._member_input(*creator, name) if creator is not None else None
        return creator

    def _member_input(self, level: SystemInstance, end: Endpoint, name: str) -> tuple[SystemInstance, Endpoint] | None:
        """Return the input of the bus creator that feeds a port, by signal name."""
        last = self._origin(level, end)
        flat = last[0].flat_blocks.get(last[1].block) if last is not None else None
        if last is None or flat is None or flat.type != "BusCreator":
            return None
        here, sid = last[0], flat.block.sid
        ends = [Endpoint(sid, "in", number) for number in range(1, here.fed.get(sid, 0) + 1)]
        names = bus_member_names([self.label(here, end) for end in ends], flat.block.value("Inputs") or "")
        # a bus object names the elements in the order of the inputs, whatever their lines are called
        listed = self._names_by_object(flat)
        names = listed if len(listed) == len(names) else names
        member = find_bus_member(names, name)
        return (here, ends[names.index(member)]) if member is not None else None

    def _names_by_object(self, flat: FlatBlock) -> list[str]:
        """Return the names of the elements by the bus object of a creator, [] without an object."""
        # each selected signal asks again, and a bus may have hundreds of elements
        if flat not in self._element_names:
            bus = flat.output_type
            self._element_names[flat] = [element.name for element in bus.elements] if isinstance(bus, BusType) else []
        return self._element_names[flat]

    def _origin(self, level: SystemInstance, end: Endpoint) -> tuple[SystemInstance, Endpoint] | None:
        """Return the end at which the signal is computed."""
        passed = list(self._trace(level, end))
        return passed[-1] if passed else None

    def _trace(self, level: SystemInstance, end: Endpoint) -> Iterator[tuple[SystemInstance, Endpoint]]:
        """Yield the line ends that a signal passes, from its use back to its origin."""
        here: SystemInstance | None = level
        at: Endpoint | None = end
        # subsystems and tags without any block in between may form a ring
        seen: set[tuple[int, Endpoint]] = set()
        while here is not None and at is not None and (id(here), at) not in seen:
            seen.add((id(here), at))
            source = _original_inport(here, here.sources.get(at))
            if source is None:
                return
            yield here, source
            here, at = self._passed_on_input(here, source)

    def _passed_on_input(
        self, level: SystemInstance, source: Endpoint
    ) -> tuple[SystemInstance | None, Endpoint | None]:
        """Return the input port that a block output passes on unchanged, or None if the block computes it."""
        if source in level.passing:
            return level, level.passing[source]
        # a placed block computes its outputs; ports, tags and plain subsystems only pass them on
        if source.block in level.flat_blocks:
            return None, None
        block = level.system.by_sid[source.block]
        if block.type == "Inport" and level.holder is not None and level.parent is not None:
            return level.parent, Endpoint(level.holder.sid, "in", port_number(block))
        if block.type == "From":
            goto = self.goto(level, goto_tag(block))
            return (goto[0], Endpoint(goto[1].sid, "in")) if goto is not None else (None, None)
        below = level.below.get(source.block)
        outport = below.port("Outport", source.number) if below is not None else None
        if below is None or outport is None or outport.sid in below.flat_blocks:
            return None, None
        return below, Endpoint(outport.sid, "in")

    def goto(self, level: SystemInstance, tag: str) -> tuple[SystemInstance, ModelBlock] | None:
        """Find the Goto of a tag: local in the same system, scoped below its visibility block, global in its model."""
        if (level, tag) in self._local:
            return self._local[level, tag]
        for where, goto in self._wide.get(tag, ()):
            is_global = goto.is_set_to("TagVisibility", "global") and model_instance(where) is model_instance(level)
            if is_global or self._is_in_scope(level, where, tag):
                return where, goto
        return None

    def _is_in_scope(self, level: SystemInstance, where: SystemInstance, tag: str) -> bool:
        """Return True if a system that encloses both From and Goto contains the visibility block of the tag."""
        shared = set(enclosing_systems(where))
        return any(
            goto_tag(mark) == tag
            for here in enclosing_systems(level)
            if here in shared
            for mark in here.system.of("GotoTagVisibility")
        )


def _original_inport(level: SystemInstance, source: Endpoint | None) -> Endpoint | None:
    """Return the inport itself if a line starts at a duplicate of it."""
    block = level.system.by_sid.get(source.block) if source is not None else None
    if source is None or block is None or block.type != "InportShadow":
        return source
    inport = level.port("Inport", port_number(block))
    return Endpoint(inport.sid, source.port, source.number) if inport is not None else None


def bus_member_names(labels: Sequence[str], stated: str) -> list[str]:
    """Name the signals of a bus creator: after their lines, else as stated, else numbered.

    >>> bus_member_names(["n", "", "n", ""], "'a','b'")
    ['n', 'b', 'n3', 'signal4']
    """
    listed = re.findall(r"'([^']*)'", stated)
    names: list[str] = []
    for at, label in enumerate(labels):
        name = label or (listed[at] if at < len(listed) else "") or f"signal{at + 1}"
        # Simulink appends the port number to a name that occurs again
        names.append(f"{name}{at + 1}" if name in names else name)
    return names


def find_bus_member(names: Sequence[str], wanted: str) -> str | None:
    """Find the member that a name in a bus selector means, None if there is none.

    If input names are duplicates, Simulink appends port numbers to them, in old files as "(signal2)".

    >>> find_bus_member(["n", "b", "n3"], "n(signal1)"), find_bus_member(["n", "b", "n3"], "b2")
    ('n', 'b')
    """
    plain = re.sub(r"\s*\(signal\s*(\d+)\)\Z", r"\1", wanted)
    if wanted in names or plain in names:
        return wanted if wanted in names else plain
    return next((name for at, name in enumerate(names, 1) if f"{name}{at}" == plain), None)


class ConnectionResolver:
    """Connects placed blocks."""

    def __init__(self, placed: FlatteningState) -> None:
        self.placed = placed
        self.wires = SignalTracer(placed.gotos)
        self._ends = 0
        self._declared: dict[tuple[tuple[str, ...], str], FlatBlock] = {}

    def connect(self) -> None:
        """Resolve the sources of all inputs."""
        for level in self.placed.levels:
            self._place_open_tags(level)
        for level in self.placed.levels:
            for sid, flat in level.flat_blocks.items():
                self._connect_inputs(level, sid, flat)
                if flat.type in ("DataStoreRead", "DataStoreWrite"):
                    flat.data_store = self._store(level, flat.block)
            self._connect_controls(level)
            for flat in [flat for flat in level.flat_blocks.values() if flat.type == "MATLAB Function"]:
                self._connect_data_stores(level, flat)
        for flat, ends in self.placed.joints:
            flat.inputs = [end if isinstance(end, SignalSource) else self.wires.source(*end) for end in ends]

    def _place_open_tags(self, level: SystemInstance) -> None:
        """Place From blocks without a Goto as model inputs."""
        for block in level.system.of("From"):
            if self.wires.goto(level, goto_tag(block)) is None:
                flat = self.placed.place(level, block, "From")
                flat.hidden = level.element > 1 or max(level.passes, default=1) > 1

    def _connect_controls(self, level: SystemInstance) -> None:
        for sid, below in level.below.items():
            control = below.control
            # a plain subsystem has the control of the conditional one around it, which is connected there
            if control is not None and control.block is below.holder:
                control.inputs = [self._control_source(level, sid, port) for port in control.control_ports]
                ends = (Endpoint(sid, port) for port in control.control_ports)
                paths = enumerate(self.wires.commented_source(level, end) for end in ends)
                control.commented = {index: path for index, path in paths if path}

    def _connect_data_stores(self, level: SystemInstance, flat: FlatBlock) -> None:
        """Place blocks that read and write data stores on behalf of code."""
        data = flat.block.chart.data if flat.block.chart is not None and not flat.passes else ()
        flat.code_stores = tuple(variable.name for variable in data if variable.scope == "DATA_STORE_MEMORY_DATA")
        written = names_assigned_by_functions(flat.block.script) if flat.code_stores else frozenset()
        outputs = sum(variable.scope == "OUTPUT_DATA" for variable in data)
        for at, name in enumerate(flat.code_stores):
            # a read is an input after the ports, a write an output after them
            flat.inputs.append(SignalSource(self._place_access(level, flat, "DataStoreRead", name), 0))
            if name in written:
                self._place_access(level, flat, "DataStoreWrite", name).inputs.append(SignalSource(flat, outputs + at))

    def _place_access(self, level: SystemInstance, flat: FlatBlock, kind: str, name: str) -> FlatBlock:
        block = ModelBlock(kind, name, "", f"{flat.block.path}/{name}", {"DataStoreName": name}, ports=Ports())
        path, order = f"{flat.path}/{name}", flat.priority_path
        access = FlatBlock(kind, block, path, level.scope, level.control, priority_path=order, synthetic=True)
        access.data_store = self._store(level, block)
        self.placed.flat_blocks.append(access)
        return access

    def _store(self, level: SystemInstance, block: ModelBlock) -> FlatBlock | None:
        """Return the memory of a data store: that of a block around, else one declared by a signal object.

        A referenced model does not see the blocks of the model around it. They are taken if nothing else declares it.
        """
        name, around = _store_name(block), list(enclosing_systems(level))
        variable = level.scope.variables.get(name)
        own = [system for system in around if _shares(system, level, name)]
        rest = [system for system in around if system not in own]
        memory = _memory_block(own, name) or self._declared_store(own[-1], name, variable)
        return memory or _memory_block(rest, name)

    def _declared_store(self, model: SystemInstance, name: str, variable: Variable | None) -> FlatBlock | None:
        """Return the memory that a signal object declares: for all models, or for one instance of its own model."""
        fields = declared_store(variable)
        if variable is None or fields is None:
            return None
        # iterations of a model share its stores, elements of a For Each subsystem do not
        place = (*model.path, str(model.element)) if variable.local else ()
        if (place, name) not in self._declared:
            path = join_path(*model.path, name) if variable.local else name
            self._declared[place, name] = self._place_declared(model, path, {"DataStoreName": name, **fields})
        return self._declared[place, name]

    def _place_declared(self, model: SystemInstance, path: str, fields: dict[str, str]) -> FlatBlock:
        """Place the memory of a data store that has no block."""
        block = ModelBlock("DataStoreMemory", fields["DataStoreName"], "", path, fields, ports=Ports())
        memory = FlatBlock("DataStoreMemory", block, path, Scope(model.scope.variables), synthetic=True)
        self.placed.flat_blocks.append(memory)
        return memory

    def _control_source(self, level: SystemInstance, sid: str, port: str) -> SignalSource | None:
        """Return the source at a control port; that of a variant is at the enclosing subsystem."""
        while level.variant:
            assert level.parent is not None
            assert level.holder is not None
            sid, level = level.holder.sid, level.parent
        return self.wires.source(level, Endpoint(sid, port))

    def _connect_inputs(self, level: SystemInstance, sid: str, flat: FlatBlock) -> None:
        # a file may state the number of ports without connecting all, or connect them without stating it
        count = max(level.fed.get(sid, 0), flat.block.ports.inputs if flat.block.ports is not None else 0)
        self._ends += count
        if self._ends > _MAX_INPUTS:
            raise OverflowError(f"its blocks have more than {_MAX_INPUTS} inputs")
        ends = [Endpoint(sid, "in", number) for number in range(1, count + 1)]
        if flat.type == "BusElements":
            # the first element of an output bus stands for all of them, so that it has their inputs
            shared = elements(level.system, "Outport", port_number(flat.block))
            ends = [Endpoint(block.sid, "in") for block in shared]
            flat.bus_paths = tuple(element_of(block) or "" for block in shared)
        connections = [self.wires.connection(level, end) for end in ends]
        flat.inputs = [source for source, _ in connections]
        flat.input_names = {index: name for index, (_, name) in enumerate(connections) if name}
        if flat.type == "BusElement" and level.parent is not None and level.holder is not None:
            flat.inputs = [self.wires.source(level.parent, Endpoint(level.holder.sid, "in", port_number(flat.block)))]
            flat.bus_paths = (element_of(flat.block) or "",)
        if flat.type in _TRIGGERED:
            ends.append(Endpoint(sid, "trigger"))
            flat.inputs.append(self.wires.source(level, ends[-1]))
        if flat.type == "Chart" and flat.block.system is not None:
            flat.control_ports = {SPECIAL[port.type]: port for port in flat.block.system.of("TriggerPort")}
            controls = [Endpoint(sid, kind) for kind in flat.control_ports]
            flat.inputs += [self.wires.source(level, end) for end in controls]
            flat.input_names |= {
                index: name for index, end in enumerate(controls, len(ends)) if (name := self.wires.label(level, end))
            }
            ends += controls
        missing = [(index, end) for index, end in enumerate(ends) if flat.inputs[index] is None]
        flat.commented = {index: path for index, end in missing if (path := self.wires.commented_source(level, end))}
        flat.output_names = {number - 1: name for number, name in flat.block.signals.items()} | level.named.get(sid, {})


def _shares(system: SystemInstance, level: SystemInstance, name: str) -> bool:
    """Return True if a system around another one has the same data stores of a name.

    It belongs to the same model, or to one with the model workspace that declares the store.
    """
    variable = level.scope.variables.get(name)
    if variable is not None and variable.local:
        return system.scope.variables.get(name) is variable
    return model_instance(system) is model_instance(level)


def _memory_block(systems: Iterable[SystemInstance], name: str) -> FlatBlock | None:
    for here in systems:
        # innermost first: a memory hides one of the same name further out
        for memory in here.system.of("DataStoreMemory"):
            if _store_name(memory) == name:
                return here.flat_blocks.get(memory.sid)
    return None


def _store_name(block: ModelBlock) -> str:
    return (block.value("DataStoreName") or "A").strip()
