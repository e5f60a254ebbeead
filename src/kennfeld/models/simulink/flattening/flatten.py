"""Subsystems dissolved: a flat list of blocks, each knowing where its inputs come from.

Inports, outports, Goto and From blocks and plain subsystems are but wires. A conditional subsystem leaves two things
behind: a block `Control` that says when it runs, and a block `Held` for each of its outputs.

A chart or MATLAB Function by itself: a system of that block between ports of its own.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.simulink.flattening.active_blocks import (
    active_choice,
    choice_labels,
    describe_choice,
    is_variant,
    member,
    system_with_choice,
    without_commented_blocks,
)
from kennfeld.models.simulink.flattening.connections import ConnectionResolver
from kennfeld.models.simulink.flattening.flat_model import FlatModel
from kennfeld.models.simulink.flattening.hierarchy import SPECIAL, FlatteningState, SystemInstance, goto_tag
from kennfeld.models.simulink.flattening.iterated_subsystems import IterationUnroller, iterator_block, plan_iterations
from kennfeld.models.simulink.reader.block_ports import element_of, elements, port_number
from kennfeld.models.simulink.reader.library_links import is_of_simulink
from kennfeld.models.simulink.reader.model_tree import Endpoint, ModelBlock, SignalLine, System, join_path, split_path
from kennfeld.models.simulink.variables.mask_scope import Scope

__all__ = ["flatten", "standalone_system"]

_NESTED = ("SubSystem", "ModelReference")


def flatten(
    system: System,
    scope: Scope,
    cuts: Mapping[str, str],
    opaque: frozenset[str] = frozenset(),
    models: Mapping[str, Scope] | None = None,
    known: Mapping[str, bool] = MappingProxyType({}),
    counts: Mapping[str, int] | None = None,
) -> FlatModel:
    """The blocks of a system and of all below it.

    `cuts` are the paths of blocks whose outputs are given from outside; `opaque` are the types of masks that are
    blocks of their own and not looked into. `models` are the names that referenced models see, by the models' names.
    `known` are all types of blocks, with whether a mask may be called so. A link to Simulink's own library of a type
    that is not among them goes by the name that the block has there; one to another library is no block of Simulink.
    `counts` are the passes that subsystems were found to need, by path.
    """
    placed = FlatteningState()
    system = without_commented_blocks(system)
    root = _Flattener(placed, cuts, opaque, models or {}, known, counts or {}).level(
        SystemInstance(system, (), scope, None)
    )
    ConnectionResolver(placed).connect()
    ports = {kind: sorted(system.of(kind), key=port_number) for kind in ("Inport", "Outport")}
    inports, outports = ([root.atoms[b.sid] for b in ports[kind]] for kind in ("Inport", "Outport"))
    return FlatModel(placed.atoms, inports, outports, placed.chosen, placed.built)


class _Flattener:
    """Places the blocks of systems: those that stay, and the systems below them."""

    def __init__(
        self,
        placed: FlatteningState,
        cuts: Mapping[str, str],
        opaque: frozenset[str],
        models: Mapping[str, Scope],
        known: Mapping[str, bool],
        counts: Mapping[str, int],
    ) -> None:
        self.placed = placed
        self.cuts = cuts
        self.opaque = opaque
        self.models = models
        self.known = known
        self.counts = counts
        self.repetition = IterationUnroller(placed, self._place)

    def level(
        self, made: SystemInstance, parent: SystemInstance | None = None, holder: ModelBlock | None = None
    ) -> SystemInstance:
        """Place the blocks of a level within another one."""
        made.within(parent, holder)
        self.placed.levels.append(made)
        for block in made.system.blocks:
            self._place(made, block)
        return made

    def _place(self, level: SystemInstance, block: ModelBlock) -> None:
        path = join_path(*level.path, block.name)
        if path in self.cuts:
            self.placed.atom(level, block, "Bound")
        elif is_variant(block):
            self._variant(level, block)
        elif level.parent is not None and element_of(block) is not None:
            self._element(level, block)
        elif block.type in _NESTED and block.system is not None and not (why := self._closed(block)):
            self._enter(level, block, block.system)
        elif block.type == "Goto":
            self.placed.gotos.setdefault(goto_tag(block), []).append((level, block))
        elif block.type == "Inport" and level.parent is not None:
            self._inport(level, block)
        elif block.type in ("From", "GotoTagVisibility", "InportShadow") or block.type in SPECIAL:
            pass
        elif block.type == "Outport" and level.parent is not None:
            if level.control is not None and level.control.block is level.holder and level.repeated is None:
                self.placed.atom(level, block, "Held")
        else:
            closed = block.type in _NESTED and block.system is not None
            self.placed.atom(level, block, _kind(block, self.known), why if closed else "")

    def _variant(self, level: SystemInstance, block: ModelBlock) -> None:
        """A block of variants: only the active one is left of it."""
        labels = choice_labels(block)
        scope = level.scope.within(block)
        try:
            at = active_choice(block, labels, scope)
            if block.type == "SubSystem":
                choice = member(block, at) if at is not None else None
                self._enter(level, block, system_with_choice(block, choice))
                level.below[block.sid].variant = True
        except EvaluationError as error:
            self.placed.atom(level, block, block.type, f"a block of variants, and {error}").undefined = error.undefined
            return
        if block.type != "SubSystem":
            self._passed(level, block, at)
        self.placed.chosen.append(f"{join_path(*level.path, block.name)}: {describe_choice(labels, at, scope)}")

    def _passed(self, level: SystemInstance, block: ModelBlock, at: int | None) -> None:
        """A variant source or sink that passes on one signal; what reads another one is told."""
        number = 1 if at is None else at + 1
        ends = (1, number) if block.type == "VariantSource" else (number, 1)
        if at is not None:
            level.passing[Endpoint(block.sid, "out", ends[0])] = Endpoint(block.sid, "in", ends[1])
        self.placed.atom(level, block, "Inactive")

    def _element(self, level: SystemInstance, block: ModelBlock) -> None:
        """A port that several blocks share: one block for each element that goes in, one for the bus that goes out."""
        why = ""
        if level.repeated is not None:
            why = "a bus element of a subsystem that runs several times in a step"
        elif level.control is not None and level.control.block is level.holder:
            why = "an output of a conditional subsystem that is made of bus elements"
        if block.type == "Inport":
            self.placed.atom(level, block, "BusElement", why if level.repeated is not None else "")
        elif block is elements(level.system, "Outport", port_number(block))[0]:
            self.placed.atom(level, block, "BusElements", why)

    def _closed(self, block: ModelBlock) -> str:
        """Why a subsystem is not looked into; empty where it is."""
        assert block.system is not None
        chart = block.value("SFBlockType") or "NONE"
        if chart != "NONE" or block.chart is not None:
            return f"a {chart if chart != 'NONE' else 'Chart'}"
        if block.mask is not None and block.mask.type in self.opaque:
            return block.mask.type
        return ""

    def _enter(self, level: SystemInstance, block: ModelBlock, system: System) -> None:
        system = without_commented_blocks(system)
        path = (*level.path, block.name)
        scope = level.scope.inside(block, self.models)
        iterator = iterator_block(system)
        try:
            plan = plan_iterations(iterator, block, path, scope, self.counts) if iterator is not None else None
        except EvaluationError as error:
            why = f"a subsystem that runs several times in a step, and {error}"
            self.placed.atom(level, block, block.type, why).undefined = error.undefined
            return
        special = {SPECIAL[b.type]: b for b in system.of(*SPECIAL)}
        control = level.control
        if special:
            control = self.placed.atom(level, block, "Control")
            control.special = special
        made = SystemInstance(system, path, scope, control)
        if plan is None:
            level.below[block.sid] = self.level(made, level, block)
        else:
            made.within(level, block)
            level.below[block.sid] = made
            self.repetition.place(level, made, plan)

    def _inport(self, level: SystemInstance, block: ModelBlock) -> None:
        """An inport within a subsystem is but a wire, unless each element gets a part of the signal."""
        plan = level.repeated
        number = port_number(block)
        on = plan.block.listed("InputPartition") if plan is not None else ()
        if plan is None or not plan.each or (number <= len(on) and on[number - 1] == "off"):
            return
        assert level.parent is not None
        assert level.holder is not None
        found = self.placed.atom(level, block, "Part")
        found.special = {"each": plan.block}
        self.placed.joints.append((found, [(level.parent, Endpoint(level.holder.sid, "in", number))]))


def _kind(block: ModelBlock, known: Mapping[str, bool]) -> str:
    if block.chart is not None and block.chart.kind == "Chart":
        return "Chart"
    if block.script and (block.value("SFBlockType") or "") == "MATLAB Function":
        return "MATLAB Function"
    if block.type == "Reference" and block.reference is not None:
        link = block.reference
        last = (split_path(link.source) or ("",))[-1]
        if is_of_simulink(link.source):
            return last if link.type not in known and last in known else f"{link.type or link.source}"
        return link.type if link.type and known.get(link.type, True) else link.source
    if block.type == "SubSystem" and block.mask is not None and block.mask.type:
        return block.mask.type
    return block.type


def standalone_system(block: ModelBlock, inside: System) -> System:
    """The system of a block whose content is no system of blocks, with ports as those that stand in it.

    Each event from outside is an input of its own.
    """
    made: list[tuple[ModelBlock, SignalLine | None]] = [
        *_ports(block, inside, "Inport"),
        *_ports(block, inside, "Outport"),
    ]
    if any(True for _ in inside.of("TriggerPort")):
        made += _events(block, len([port for port, _ in made if port.type == "Inport"]))
    return System((block, *(port for port, _ in made)), tuple(line for _, line in made if line is not None))


def _ports(block: ModelBlock, inside: System, kind: str) -> Iterator[tuple[ModelBlock, SignalLine]]:
    for port in inside.of(kind):
        number = port_number(port)
        made = _port(kind, port.name.removesuffix("()"), number)
        if kind == "Inport":
            yield made, SignalLine(Endpoint(made.sid, "out"), (Endpoint(block.sid, "in", number),))
        else:
            yield made, SignalLine(Endpoint(block.sid, "out", number), (Endpoint(made.sid, "in"),))


def _port(kind: str, name: str, number: int) -> ModelBlock:
    return ModelBlock(kind, name, f"{kind} {number}", name, {"Port": str(number)})


def _events(block: ModelBlock, before: int) -> Iterator[tuple[ModelBlock, SignalLine | None]]:
    """An input for each event, joined to the vector that triggers the chart."""
    events = [one.name for one in block.chart.events if one.scope == "INPUT_EVENT"] if block.chart is not None else []
    joint = ModelBlock("Mux", "events", "Mux", "events", {"Inputs": str(len(events))})
    yield joint, SignalLine(Endpoint(joint.sid, "out"), (Endpoint(block.sid, "trigger"),))
    for at, name in enumerate(events, 1):
        made = _port("Inport", name, before + at)
        yield made, SignalLine(Endpoint(made.sid, "out"), (Endpoint(joint.sid, "in", at),))
