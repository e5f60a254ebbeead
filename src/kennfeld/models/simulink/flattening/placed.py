"""What has been placed so far: the blocks that stay, the systems they are in, and what waits to be connected."""

from typing import TypeAlias

from kennfeld.models.simulink.files.tree import Block, Endpoint, joined
from kennfeld.models.simulink.flattening.atoms import Atom, Source
from kennfeld.models.simulink.flattening.levels import Level, priority_of

__all__ = ["Joint", "Placed"]

Joint: TypeAlias = tuple[Atom, list[tuple[Level, Endpoint] | Source]]  # a block, and where its inputs come from

_MOST = 100_000  # blocks, all instances of libraries counted


class Placed:
    """The blocks and systems that are placed.

    `joints` are blocks whose inputs do not come from their own ports, `gotos` the Goto blocks by their tags. `chosen`
    says which variants are active, `built` are the passes of subsystems by their paths.
    """

    def __init__(self) -> None:
        self.atoms: list[Atom] = []
        self.levels: list[Level] = []
        self.joints: list[Joint] = []
        self.gotos: dict[str, list[tuple[Level, Block]]] = {}
        self.chosen: list[str] = []
        self.built: dict[str, int] = {}

    def atom(self, level: Level, block: Block, kind: str, why: str = "") -> Atom:
        """Place what a block of a level leaves behind; `why` says why it cannot be built."""
        made = Atom(kind, block, joined(*level.path, block.name), level.scope, level.control, why=why)
        made.passes, made.element = level.passes, level.element
        self.atoms.append(made)
        if kind != "Control":
            level.atoms[block.sid] = made
        if len(self.atoms) > _MOST:
            raise OverflowError(f"it has more than {_MOST} blocks, all instances of libraries and all passes counted")
        made.places = (*level.places, (block.sid, priority_of(block)))
        return made
