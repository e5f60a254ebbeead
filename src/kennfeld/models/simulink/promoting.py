"""Fields of blocks that somebody names, "Torque/Gain1:Gain": whether there are such blocks and fields."""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from kennfeld.errors import Finding, nearest
from kennfeld.models.simulink.files.tree import Block, System
from kennfeld.models.simulink.flattening.atoms import Flat
from kennfeld.models.simulink.weaving.registry import KINDS

__all__ = ["misnamed"]

_SHOWN = 8
_OF_THE_DRAWING = {"Position", "ZOrder", "Ports", "SID", "Name", "FontSize", "ShowName", "BackgroundColor"}


def misnamed(path: Path, names: Collection[str], system: System, flat: Flat, prefix: str) -> list[Finding]:
    """A finding for each field that no block has; `prefix` is the path of the imported system."""
    return list(_misnamed(path, names, _blocks(system, flat, prefix))) if names else []


def _misnamed(path: Path, names: Collection[str], blocks: Mapping[str, Block]) -> Iterator[Finding]:
    for name in names:
        way, _, field = name.rpartition(":")
        block = blocks.get(way)
        if block is None:
            having = [path for path, one in blocks.items() if field in _fields(one)] or list(blocks)
            mend = nearest(way, having) or f"Blocks that have one: {', '.join(having[:_SHOWN])}."
            yield Finding(path.name, f"there is no block {way}, whose {field} is named a parameter", mend)
        elif block.chart is None and field not in (fields := _fields(block)):
            mend = nearest(field, fields) or f"Its fields are {', '.join(list(fields)[:_SHOWN])}."
            yield Finding(f"{path.name} {way}", f"{block.type} has no field {field}", mend)


def _blocks(system: System, flat: Flat, prefix: str) -> dict[str, Block]:
    """The blocks by their paths from where the import begins."""
    start = len(prefix) + 1 if prefix else 0
    found = {block.path[start:]: block for block in system.every()}
    return found | {atom.path: atom.block for atom in flat.atoms if not (atom.hidden or atom.made)}


def _fields(block: Block) -> dict[str, str]:
    """The fields of a block with what is written in them, those of its mask first."""
    masked = {one.name: one.expression for one in block.mask.parameters} if block.mask is not None else {}
    linked = dict(block.reference.parameters) if block.reference is not None else {}
    usual = dict(KINDS[block.type].defaults) if block.type in KINDS else {}
    found = {**masked, **linked, **usual, **block.defaults, **block.parameters}
    return {name: text for name, text in found.items() if name not in _OF_THE_DRAWING}
