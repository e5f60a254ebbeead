"""Subsystems that run several times in a step: how often, and with what they begin.

Their blocks are built once for each pass. A memory of one pass is read in the next; only the last one lasts until the
step behind. The elements of a For Each subsystem have memories of their own.

Systems on the way down: what is in each one, its lines by their ends, and the systems around it.

What has been placed so far: the blocks that stay, the systems they are in, and what waits to be connected.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

from kennfeld.models.simulink.flattening.flat_model import FlatBlock, SignalSource
from kennfeld.models.simulink.reader.block_ports import port_number
from kennfeld.models.simulink.reader.model_tree import Endpoint, ModelBlock, System, join_path
from kennfeld.models.simulink.variables.mask_scope import Scope

__all__ = ["SPECIAL", "FlatteningState", "IterationPlan", "SystemInstance", "enclosing_systems", "goto_tag"]

SPECIAL = {"EnablePort": "enable", "TriggerPort": "trigger", "ActionPort": "ifaction", "ResetPort": "reset"}

_MOST = 100_000  # blocks, all instances of libraries counted


@dataclass(frozen=True)
class IterationPlan:
    """The passes of a subsystem: the block that counts them, how many, whether memories begin anew in each step."""

    block: ModelBlock
    count: int
    reset: bool = False

    @property
    def each(self) -> bool:
        """Whether the passes are elements side by side, not one after the other."""
        return self.block.type == "ForEach"

    @property
    def decides(self) -> bool:
        """Whether each pass decides on the next one."""
        return self.block.type == "WhileIterator"

    @property
    def asks_first(self) -> bool:
        """Whether even the first pass needs a condition."""
        return self.decides and (self.block.value("WhileBlockType") or "while") == "while"


class SystemInstance:
    """One system on the way: what is in it, and what is around it."""

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
        self.atoms: dict[str, FlatBlock] = {}
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
                        self.fed[end.block] = max(end.number, self.fed.get(end.block, 0))
            if line.source is not None and line.name:
                self.labels.setdefault(line.source, line.name)
                if line.source.port == "out":
                    self.named.setdefault(line.source.block, {})[line.source.number - 1] = line.name

    def within(self, parent: "SystemInstance | None", holder: ModelBlock | None) -> None:
        """Put it into another level, as the content of one of its blocks."""
        self.parent, self.holder = parent, holder
        if parent is not None and holder is not None:
            self.places = (*parent.places, (holder.sid, block_priority(holder)))
            self.passes, self.element = parent.passes, parent.element

    def port(self, kind: str, number: int) -> ModelBlock | None:
        """The Inport or Outport block of a number."""
        return next((b for b in self.system.of(kind) if port_number(b) == number), None)


def enclosing_systems(level: SystemInstance) -> Iterator[SystemInstance]:
    """A system and those around it, from the inside."""
    here: SystemInstance | None = level
    while here is not None:
        yield here
        here = here.parent


def goto_tag(block: ModelBlock) -> str:
    """The tag of a Goto or From, or of the mark of its visibility."""
    return (block.value("GotoTag") or "A").strip()


def block_priority(block: ModelBlock) -> int | None:
    """The priority that a block is given; None where it has none."""
    written = (block.parameters.get("Priority") or "").strip()
    return int(written) if re.fullmatch(r"-?\d{1,9}", written) else None


Joint: TypeAlias = tuple[
    FlatBlock, list[tuple[SystemInstance, Endpoint] | SignalSource]
]  # a block, and where its inputs come from


class FlatteningState:
    """The blocks and systems that are placed.

    `joints` are blocks whose inputs do not come from their own ports, `gotos` the Goto blocks by their tags. `chosen`
    says which variants are active, `built` are the passes of subsystems by their paths.
    """

    def __init__(self) -> None:
        self.atoms: list[FlatBlock] = []
        self.levels: list[SystemInstance] = []
        self.joints: list[Joint] = []
        self.gotos: dict[str, list[tuple[SystemInstance, ModelBlock]]] = {}
        self.chosen: list[str] = []
        self.built: dict[str, int] = {}

    def atom(self, level: SystemInstance, block: ModelBlock, kind: str, why: str = "") -> FlatBlock:
        """Place what a block of a level leaves behind; `why` says why it cannot be built."""
        made = FlatBlock(kind, block, join_path(*level.path, block.name), level.scope, level.control, why=why)
        made.passes, made.element = level.passes, level.element
        self.atoms.append(made)
        if kind != "Control":
            level.atoms[block.sid] = made
        if len(self.atoms) > _MOST:
            raise OverflowError(f"it has more than {_MOST} blocks, all instances of libraries and all passes counted")
        made.places = (*level.places, (block.sid, block_priority(block)))
        return made
