"""Systems on the way down: what is in each one, its lines by their ends, and the systems around it."""

import re
from collections.abc import Iterator

from kennfeld.models.simulink.files.ports import port_number
from kennfeld.models.simulink.files.tree import Block, Endpoint, System
from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.flattening.iteration import Plan
from kennfeld.models.simulink.variables.scopes import Scope

__all__ = ["SPECIAL", "Level", "around", "priority_of", "tag_of"]

SPECIAL = {"EnablePort": "enable", "TriggerPort": "trigger", "ActionPort": "ifaction", "ResetPort": "reset"}


class Level:
    """One system on the way: what is in it, and what is around it."""

    def __init__(self, system: System, path: tuple[str, ...], scope: Scope, control: Atom | None) -> None:
        self.system = system
        self.path = path
        self.scope = scope
        self.control = control
        self.parent: Level | None = None
        self.holder: Block | None = None
        self.variant = False
        self.passes: tuple[int, ...] = ()
        self.element = 0
        self.repeated: Plan | None = None
        self.places: tuple[tuple[str, int | None], ...] = ()
        self.below: dict[str, Level] = {}
        self.atoms: dict[str, Atom] = {}
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

    def within(self, parent: "Level | None", holder: Block | None) -> None:
        """Put it into another level, as the content of one of its blocks."""
        self.parent, self.holder = parent, holder
        if parent is not None and holder is not None:
            self.places = (*parent.places, (holder.sid, priority_of(holder)))
            self.passes, self.element = parent.passes, parent.element

    def port(self, kind: str, number: int) -> Block | None:
        """The Inport or Outport block of a number."""
        return next((b for b in self.system.of(kind) if port_number(b) == number), None)


def around(level: Level) -> Iterator[Level]:
    """A system and those around it, from the inside."""
    here: Level | None = level
    while here is not None:
        yield here
        here = here.parent


def tag_of(block: Block) -> str:
    """The tag of a Goto or From, or of the mark of its visibility."""
    return (block.value("GotoTag") or "A").strip()


def priority_of(block: Block) -> int | None:
    """The priority that a block is given; None where it has none."""
    written = (block.parameters.get("Priority") or "").strip()
    return int(written) if re.fullmatch(r"-?\d{1,9}", written) else None
