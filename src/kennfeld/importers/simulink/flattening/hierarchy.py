"""Systems during flattening: their blocks, lines and enclosing systems, iteration plans, and what has been placed."""

import re
from collections.abc import Iterator
from typing import TypeAlias

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, SignalSource
from kennfeld.importers.simulink.reader.block_ports import port_number
from kennfeld.importers.simulink.reader.model_tree import Endpoint, ModelBlock, System, join_path
from kennfeld.importers.simulink.variables.mask_scope import Scope

SPECIAL = {"EnablePort": "enable", "TriggerPort": "trigger", "ActionPort": "ifaction", "ResetPort": "reset"}

_MAX_BLOCKS = 100_000  # including all library instances


@dataclass(frozen=True)
class IterationPlan:
    """Iterations of a subsystem: its iterator block, their number, and whether states are reset in each step."""

    block: ModelBlock
    count: int
    reset: bool = False

    @property
    def each(self) -> bool:
        """True if the iterations are elements of a For Each subsystem, independent of one another."""
        return self.block.type == "ForEach"

    @property
    def decides(self) -> bool:
        """True if each iteration decides on the next one."""
        return self.block.type == "WhileIterator"

    @property
    def asks_first(self) -> bool:
        """True if even the first iteration has a condition."""
        return self.decides and self.block.is_set_to("WhileBlockType", "while", default="while")


class SystemInstance:
    """One instance of a system: its content, and the system around it."""

    def __init__(self, system: System, path: tuple[str, ...], scope: Scope, control: FlatBlock | None) -> None:
        self.system = system
        self.path = path
        self.scope = scope
        self.control = control
        self.parent: SystemInstance | None = None
        self.holder: ModelBlock | None = None
        self.variant = False
        self.passes: tuple[int, ...] = ()
        self.element = 0
        self.repeated: IterationPlan | None = None
        self.places: tuple[tuple[str, int | None], ...] = ()
        self.below: dict[str, SystemInstance] = {}
        self.flat_blocks: dict[str, FlatBlock] = {}
        self.sources: dict[Endpoint, Endpoint] = {}
        self.labels: dict[Endpoint, str] = {}
        self.passing: dict[Endpoint, Endpoint] = {}
        self.fed: dict[str, int] = {}
        self.named: dict[str, dict[int, str]] = {}
        for line in system.lines:
            for end in line.destinations:
                if line.source is not None:
                    self.sources[end] = line.source
                    self.labels[end] = line.name
                    if end.port == "in":
                        # the highest input that is connected, for blocks whose ports the file does not count
                        self.fed[end.block] = max(end.number, self.fed.get(end.block, 0))
            if line.source is not None and line.name:
                # also at the source, where `SignalTracer.label` looks for it
                self.labels.setdefault(line.source, line.name)
                if line.source.port == "out":
                    self.named.setdefault(line.source.block, {})[line.source.number - 1] = line.name

    def within(self, parent: "SystemInstance | None", holder: ModelBlock | None) -> None:
        """Insert this instance into another one as the content of one of its blocks."""
        self.parent, self.holder = parent, holder
        if parent is not None and holder is not None:
            self.places = (*parent.places, (holder.sid, block_priority(holder)))
            self.passes, self.element = parent.passes, parent.element

    def port(self, kind: str, number: int) -> ModelBlock | None:
        """Return the Inport or Outport block of a number."""
        return next((b for b in self.system.of(kind) if port_number(b) == number), None)


def enclosing_systems(level: SystemInstance) -> Iterator[SystemInstance]:
    """Yield a system and those around it, innermost first."""
    here: SystemInstance | None = level
    while here is not None:
        yield here
        here = here.parent


def model_instance(level: SystemInstance) -> SystemInstance:
    """Return the outermost system of the model that contains a system; a referenced model has its own variables."""
    here = level
    while here.parent is not None and here.parent.scope.variables is here.scope.variables:
        here = here.parent
    return here


def goto_tag(block: ModelBlock) -> str:
    """Return the tag of a Goto, From or Goto Tag Visibility block."""
    return (block.value("GotoTag") or "A").strip()


def block_priority(block: ModelBlock) -> int | None:
    """Return the priority of a block, None if it has none."""
    written = (block.parameters.get("Priority") or "").strip()
    return int(written) if re.fullmatch(r"-?\d{1,9}", written) else None


# a block, and where its inputs come from
Joint: TypeAlias = tuple[FlatBlock, list[tuple[SystemInstance, Endpoint] | SignalSource]]


class FlatteningState:
    """Blocks and systems placed so far.

    `joints` are blocks whose inputs do not come from their own ports, `gotos` the Goto blocks by tag, `variant_choices`
    sentences on active variants, `built` iteration counts by subsystem path.
    """

    def __init__(self) -> None:
        self.flat_blocks: list[FlatBlock] = []
        self.levels: list[SystemInstance] = []
        self.joints: list[Joint] = []
        self.gotos: dict[str, list[tuple[SystemInstance, ModelBlock]]] = {}
        self.variant_choices: list[str] = []
        self.built: dict[str, int] = {}

    def place(self, level: SystemInstance, block: ModelBlock, kind: str, why: str = "") -> FlatBlock:
        """Place the flat block of a block; `why` is the reason if it is unsupported."""
        path = join_path(*level.path, block.name)
        flat = FlatBlock(kind, block, path, level.scope, level.control, unsupported_reason=why)
        flat.passes, flat.element = level.passes, level.element
        self.flat_blocks.append(flat)
        # its SID is that of the subsystem, whose outputs come from `below`
        if kind != "ConditionalSubsystem":
            level.flat_blocks[block.sid] = flat
        if len(self.flat_blocks) > _MAX_BLOCKS:
            raise OverflowError(f"it has more than {_MAX_BLOCKS} blocks, counting library instances and iterations")
        flat.priority_path = (*level.places, (block.sid, block_priority(block)))
        return flat
