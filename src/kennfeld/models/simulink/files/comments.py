"""Blocks that are commented out, or through.

What is commented out is as if it were not drawn: whatever it feeds reads 0. What is commented through passes its inputs
on to the outputs of the same numbers.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from kennfeld.models.simulink.files.tree import Block, Endpoint, Line, System

__all__ = ["in_use"]


def in_use(system: System) -> System:
    """A level without its commented blocks, its lines led past them."""
    commented = {block.sid: _how(block) for block in system.blocks if _how(block) in ("on", "through")}
    if not commented:
        return system
    return System(
        tuple(block for block in system.blocks if block.sid not in commented), tuple(_lines(system, commented))
    )


def _how(block: Block) -> str:
    return (block.parameters.get("Commented") or "off").strip()


def _lines(system: System, commented: Mapping[str, str]) -> Iterator[Line]:
    sources = {end: line.source for line in system.lines for end in line.destinations}
    for line in system.lines:
        ends = tuple(end for end in line.destinations if end.block not in commented)
        source = _past(line.source, sources, commented)
        if ends and source is not None:
            yield replace(line, source=source, destinations=ends)


def _past(
    source: Endpoint | None, sources: Mapping[Endpoint, Endpoint | None], commented: Mapping[str, str]
) -> Endpoint | None:
    """Where a signal begins, once the blocks that are commented through are wires."""
    seen: set[Endpoint] = set()
    while source is not None and source.block in commented:
        if commented[source.block] == "on" or source.port != "out" or source in seen:
            return None
        seen.add(source)
        source = sources.get(Endpoint(source.block, "in", source.number))
    return source
