"""Flattening of a system into a list of connected blocks.

Inports, outports, Goto and From blocks and plain subsystems become connections. A conditional subsystem leaves a block
"ConditionalSubsystem", which computes when it runs, and a block "ConditionalOutput" for each output. A chart or MATLAB
Function imported alone is wrapped in a system with ports.
"""

import re
from collections.abc import Iterator, Mapping
from types import MappingProxyType

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.flattening.active_blocks import (
    active_choice,
    choice_labels,
    describe_choice,
    is_variant,
    system_with_choice,
    without_commented_blocks,
)
from kennfeld.importers.simulink.flattening.connections import ConnectionResolver
from kennfeld.importers.simulink.flattening.flat_model import FlatModel
from kennfeld.importers.simulink.flattening.hierarchy import SPECIAL, FlatteningState, SystemInstance, goto_tag
from kennfeld.importers.simulink.flattening.iterated_subsystems import (
    IterationUnroller,
    iterator_block,
    plan_iterations,
)
from kennfeld.importers.simulink.reader.block_ports import element_of, elements, port_number
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.reader.library_links import is_of_simulink
from kennfeld.importers.simulink.reader.model_tree import (
    Endpoint,
    LibraryLink,
    ModelBlock,
    SignalLine,
    System,
    join_path,
    split_path,
)
from kennfeld.importers.simulink.reader.toolbox_libraries import toolbox_of
from kennfeld.importers.simulink.variables.mask_scope import Scope
from kennfeld.models.imperative.evaluation_errors import EvaluationError

HARDWARE_INPUT = "HardwareInput"
_NESTED = ("SubSystem", "ModelReference")
_FRAMES = re.compile(r"audio|microphone|serial|receive|uart|udp|tcp|\bcan\b|spi|i2c|video|camera|image|lidar", re.I)


def flatten(
    system: System,
    scope: Scope,
    cuts: Mapping[str, str],
    opaque: frozenset[str] = frozenset(),
    models: Mapping[str, Scope] | None = None,
    known: Mapping[str, bool] = MappingProxyType({}),
    counts: Mapping[str, int] | None = None,
) -> FlatModel:
    """Flatten a system and all systems below it.

    Args:
        system: the imported system.
        scope: names that its blocks see.
        cuts: paths of blocks whose outputs are given from outside.
        opaque: mask types that are blocks of their own and not opened.
        models: names that each referenced model sees, by model name.
        known: all block types, True if a mask may have that type. A link into a Simulink library of another type takes
            the name of the linked block as its type; links into other libraries do not.
        counts: iteration counts by subsystem path from earlier attempts.
    """
    placed = FlatteningState()
    system = without_commented_blocks(system)
    flattener = _Flattener(placed, cuts, opaque, models or {}, known, counts or {})
    root = flattener.level(SystemInstance(system, (), scope, None))
    # only after all blocks are placed: a signal may come from anywhere
    ConnectionResolver(placed).connect()
    outports = [root.flat_blocks[block.sid] for block in sorted(system.of("Outport"), key=port_number)]
    return FlatModel(placed.flat_blocks, outports, (), placed.variant_choices, placed.built)


@dataclass
class _Flattener:
    """Places the blocks of a system and of the systems below it."""

    placed: FlatteningState
    cuts: Mapping[str, str]
    opaque: frozenset[str]
    models: Mapping[str, Scope]
    known: Mapping[str, bool]
    counts: Mapping[str, int]

    def __post_init__(self) -> None:
        self.repetition = IterationUnroller(self.placed, self._place)

    def level(
        self, level: SystemInstance, parent: SystemInstance | None = None, holder: ModelBlock | None = None
    ) -> SystemInstance:
        """Place the blocks of a system within another one."""
        level.within(parent, holder)
        self.placed.levels.append(level)
        for block in level.system.blocks:
            self._place(level, block)
        return level

    def _place(self, level: SystemInstance, block: ModelBlock) -> None:
        path = join_path(*level.path, block.name)
        # a bound block is cut first, so that its content need not be supported
        if path in self.cuts:
            self.placed.place(level, block, "BoundBlock")
        elif is_variant(block):
            self._place_variant(level, block)
        elif level.parent is not None and element_of(block) is not None:
            self._place_bus_element(level, block)
        elif block.type in _NESTED and block.system is not None and not (why := self._refusal(block)):
            self._place_subsystem(level, block, block.system)
        elif block.type == "Goto":
            self.placed.gotos.setdefault(goto_tag(block), []).append((level, block))
        elif block.type == "Inport" and level.parent is not None:
            self._place_inport(level, block)
        elif block.type in ("From", "GotoTagVisibility", "InportShadow") or block.type in SPECIAL:
            pass
        elif block.type == "Outport" and level.parent is not None:
            # outputs of an iterated subsystem are placed with its iterations
            if level.control is not None and level.control.block is level.holder and level.repeated is None:
                self.placed.place(level, block, "ConditionalOutput")
        else:
            closed = block.type in _NESTED and block.system is not None
            self.placed.place(level, block, _kind(block, self.known), why if closed else "")

    def _place_variant(self, level: SystemInstance, block: ModelBlock) -> None:
        labels = choice_labels(block)
        scope = level.scope.within(block)
        try:
            at = active_choice(block, labels, scope)
            if block.type == "SubSystem":
                self._place_subsystem(level, block, system_with_choice(block, at))
                level.below[block.sid].variant = True
        except EvaluationError as error:
            self.placed.place(level, block, block.type, f"a variant block: {error}").undefined = error.undefined
            return
        if block.type != "SubSystem":  # connect the active port; readers of the others are refused
            if at is not None:
                # a source has one output, a sink one input
                ends = (1, at + 1) if block.type == "VariantSource" else (at + 1, 1)
                level.passing[Endpoint(block.sid, "out", ends[0])] = Endpoint(block.sid, "in", ends[1])
            self.placed.place(level, block, "InactiveVariant")
        path = join_path(*level.path, block.name)
        self.placed.variant_choices.append(f"{path}: {describe_choice(labels, at, scope)}")

    def _place_bus_element(self, level: SystemInstance, block: ModelBlock) -> None:
        """Place a bus element port: a block for each input element, one block for an output bus."""
        why = ""
        if level.repeated is not None:
            why = "a bus element port of an iterated subsystem"
        elif level.control is not None and level.control.block is level.holder:
            why = "an output of a conditional subsystem composed of bus element ports"
        if block.type == "Inport":
            self.placed.place(level, block, "BusElement", why if level.repeated is not None else "")
        elif block is elements(level.system, "Outport", port_number(block))[0]:
            self.placed.place(level, block, "BusElements", why)

    def _refusal(self, block: ModelBlock) -> str:
        """Return why a subsystem is not opened, "" if it is."""
        assert block.system is not None
        is_code = not block.is_set_to("SFBlockType", "NONE", default="NONE")
        if is_code or block.chart is not None:
            return f"a {block.value('SFBlockType') if is_code else 'Chart'}"
        if block.mask is not None and block.mask.type in self.opaque:
            return block.mask.type
        return ""

    def _place_subsystem(self, level: SystemInstance, block: ModelBlock, system: System) -> None:
        system = without_commented_blocks(system)
        path = (*level.path, block.name)
        scope = level.scope.inside(block, self.models)
        iterator = iterator_block(system)
        try:
            plan = plan_iterations(iterator, block, path, scope, self.counts) if iterator is not None else None
        except EvaluationError as error:
            why = f"an iterated subsystem: {error}"
            self.placed.place(level, block, block.type, why).undefined = error.undefined
            return
        special = {SPECIAL[b.type]: b for b in system.of(*SPECIAL)}
        control = level.control
        if special:
            control = self.placed.place(level, block, "ConditionalSubsystem")
            control.control_ports = special
        instance = SystemInstance(system, path, scope, control)
        if plan is None:
            level.below[block.sid] = self.level(instance, level, block)
        else:
            instance.within(level, block)
            level.below[block.sid] = instance
            self.repetition.place(level, instance, plan)

    def _place_inport(self, level: SystemInstance, block: ModelBlock) -> None:
        """Connect an inport of a subsystem; in a For Each subsystem, place the partition of its signal."""
        plan = level.repeated
        number = port_number(block)
        on = plan.block.listed("InputPartition") if plan is not None else ()
        if plan is None or not plan.each or (number <= len(on) and match_word(on[number - 1], ("off",))):
            return
        assert level.parent is not None
        assert level.holder is not None
        flat = self.placed.place(level, block, "ForEachPartition")
        flat.control_ports = {"each": plan.block}
        self.placed.joints.append((flat, [(level.parent, Endpoint(level.holder.sid, "in", number))]))


def linked_type(link: LibraryLink, known: Mapping[str, bool]) -> str:
    """Return the block type of a link whose library is not at hand: as the mask or the block in the library is named.

    A block of a toolbox is known by its place in a library, since a block of the user may have the same name.
    """
    path = split_path(link.source) or ("",)
    if is_of_simulink(link.source):
        return path[-1] if link.type not in known and path[-1] in known else f"{link.type or link.source}"
    if link.source in known:
        return link.source
    return link.type if link.type and known.get(link.type, True) else link.source


def _reads_hardware(block: ModelBlock) -> bool:
    """Return True for a block of a hardware support package that has outputs only, such as an analog input."""
    path = (split_path(block.reference.source) if block.reference is not None else ()) or ("",)
    toolbox = toolbox_of(path[0])
    is_source = block.ports is not None and block.ports.outputs > 0 and not block.ports.inputs
    # what is received in frames or messages has a size that its link does not state
    return is_source and toolbox is not None and toolbox.hardware and _FRAMES.search(path[-1]) is None


def _kind(block: ModelBlock, known: Mapping[str, bool]) -> str:
    if block.chart is not None and block.chart.kind == "Chart":
        return "Chart"
    if block.script and block.is_set_to("SFBlockType", "MATLAB Function"):
        return "MATLAB Function"
    if block.type == "Reference" and block.reference is not None:
        return HARDWARE_INPUT if _reads_hardware(block) else linked_type(block.reference, known)
    # many blocks of libraries are masked subsystems, which only their mask names
    if block.type == "SubSystem" and block.mask is not None and block.mask.type:
        return block.mask.type
    return block.type


def standalone_system(block: ModelBlock, inside: System) -> System:
    """Build a system that contains one block without inner blocks, with a port for each signal and event."""
    inputs = list(_ports(block, inside, "Inport"))
    ports = [*inputs, *_ports(block, inside, "Outport")]
    if any(inside.of("TriggerPort")):
        ports += _events(block, len(inputs))
    return System((block, *(port for port, _ in ports)), tuple(line for _, line in ports))


def _ports(block: ModelBlock, inside: System, kind: str) -> Iterator[tuple[ModelBlock, SignalLine]]:
    for port in inside.of(kind):
        number = port_number(port)
        outer = _port(kind, port.name.removesuffix("()"), number)
        if kind == "Inport":
            yield outer, SignalLine(Endpoint(outer.sid, "out"), (Endpoint(block.sid, "in", number),))
        else:
            yield outer, SignalLine(Endpoint(block.sid, "out", number), (Endpoint(outer.sid, "in"),))


def _port(kind: str, name: str, number: int) -> ModelBlock:
    return ModelBlock(kind, name, f"{kind} {number}", name, {"Port": str(number)})


def _events(block: ModelBlock, before: int) -> Iterator[tuple[ModelBlock, SignalLine]]:
    """Yield an input for each event, and the line that joins it to the trigger vector of the chart."""
    listed = block.chart.events if block.chart is not None else ()
    events = [event.name for event in listed if event.scope == "INPUT_EVENT"]
    # a chart has one trigger port, whose elements are its events in order
    joint = ModelBlock("Mux", "events", "Mux", "events", {"Inputs": str(len(events))})
    yield joint, SignalLine(Endpoint(joint.sid, "out"), (Endpoint(block.sid, "trigger"),))
    for at, name in enumerate(events, 1):
        port = _port("Inport", name, before + at)
        yield port, SignalLine(Endpoint(port.sid, "out"), (Endpoint(joint.sid, "in", at),))
