"""Where the signal at an input is made, and what it is called on its way: through ports, tags, variants and buses."""

import re
from collections.abc import Iterator, Mapping, Sequence

from kennfeld.models.simulink.files.ports import port_number
from kennfeld.models.simulink.files.tree import Block, Endpoint
from kennfeld.models.simulink.flattening.atoms import STATE, Source
from kennfeld.models.simulink.flattening.levels import Level, around, tag_of

__all__ = ["Wires", "member_names"]

_WIDE = ("global", "scoped")  # visible in other systems than their own


class Wires:
    """Follows lines back to the blocks that they come from. `gotos` are the Goto blocks by their tags."""

    def __init__(self, gotos: Mapping[str, Sequence[tuple[Level, Block]]]) -> None:
        self._local: dict[tuple[Level, str], tuple[Level, Block]] = {}
        self._wide: dict[str, list[tuple[Level, Block]]] = {}
        for tag, ends in gotos.items():
            for level, goto in ends:
                self._local.setdefault((level, tag), (level, goto))
                if (goto.value("TagVisibility") or "local") in _WIDE:
                    self._wide.setdefault(tag, []).append((level, goto))

    def label(self, level: Level, end: Endpoint) -> str:
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

    def source(self, level: Level, end: Endpoint) -> Source | None:
        """The block output that feeds an input port, through subsystems and tags."""
        last = self._begin(level, end)
        if last is None:
            return None
        here, source = last
        if (picked := self._picked(here, source)) is not None:
            return self.source(*picked)
        if (atom := here.atoms.get(source.block)) is not None:
            port = {"out": source.number - 1, "state": STATE}.get(source.port)
            return None if port is None else Source(atom, port)
        below = here.below.get(source.block)
        if below is not None:
            outport = below.port("Outport", source.number)
            held = below.atoms.get(outport.sid) if outport is not None else None
            return Source(held, 0) if held is not None else None
        return None

    def _picked(self, level: Level, source: Endpoint) -> tuple[Level, Endpoint] | None:
        """The input of a bus creator whose signal a bus selector picks; None where there is more between them.

        So a bus may hold a signal that is computed from another one of the same bus.
        """
        atom = level.atoms.get(source.block)
        if atom is None or atom.kind != "BusSelector" or (atom.block.value("OutputAsBus") or "off") == "on":
            return None
        ways = (atom.block.value("OutputSignals") or "").split(",")
        if not source.number <= len(ways):
            return None
        found: tuple[Level, Endpoint] | None = (level, Endpoint(source.block, "in"))
        for name in ways[source.number - 1].strip().split("."):
            found = self._member(*found, name) if found is not None else None
        return found

    def _member(self, level: Level, end: Endpoint, name: str) -> tuple[Level, Endpoint] | None:
        """The input of the bus creator that feeds an end, by the name of its signal."""
        last = self._begin(level, end)
        atom = last[0].atoms.get(last[1].block) if last is not None else None
        if last is None or atom is None or atom.kind != "BusCreator":
            return None
        here, sid = last[0], atom.block.sid
        ends = [Endpoint(sid, "in", number) for number in range(1, here.fed.get(sid, 0) + 1)]
        names = member_names([self.label(here, one) for one in ends], atom.block.value("Inputs") or "")
        return (here, ends[names.index(name)]) if name in names else None

    def _begin(self, level: Level, end: Endpoint) -> tuple[Level, Endpoint] | None:
        """Where the signal at an end is made."""
        way = list(self._way(level, end))
        return way[-1] if way else None

    def _way(self, level: Level, end: Endpoint) -> Iterator[tuple[Level, Endpoint]]:
        """The ends of lines that a signal passes, from where it is used back to where it is made."""
        here: Level | None = level
        at: Endpoint | None = end
        seen: set[tuple[int, Endpoint]] = set()
        while here is not None and at is not None and (id(here), at) not in seen:
            seen.add((id(here), at))
            source = _original(here, here.sources.get(at))
            if source is None:
                return
            yield here, source
            here, at = self._behind(here, source)

    def _behind(self, level: Level, source: Endpoint) -> tuple[Level | None, Endpoint | None]:
        """The input port that a block output merely passes on; None where the block computes something."""
        if source in level.passing:
            return level, level.passing[source]
        if source.block in level.atoms:
            return None, None
        block = level.system.by_sid[source.block]
        if block.type == "Inport" and level.holder is not None and level.parent is not None:
            return level.parent, Endpoint(level.holder.sid, "in", port_number(block))
        if block.type == "From":
            goto = self.goto(level, tag_of(block))
            return (goto[0], Endpoint(goto[1].sid, "in")) if goto is not None else (None, None)
        below = level.below.get(source.block)
        outport = below.port("Outport", source.number) if below is not None else None
        if below is None or outport is None or outport.sid in below.atoms:
            return None, None
        return below, Endpoint(outport.sid, "in")

    def goto(self, level: Level, tag: str) -> tuple[Level, Block] | None:
        """The Goto of a tag: local ones in the same system, scoped ones below their mark, global ones anywhere."""
        if (level, tag) in self._local:
            return self._local[level, tag]
        for where, goto in self._wide.get(tag, ()):
            if goto.value("TagVisibility") == "global" or self._scoped(level, where, tag):
                return where, goto
        return None

    def _scoped(self, level: Level, where: Level, tag: str) -> bool:
        """Whether a mark of the tag's visibility stands in a system around both the From and the Goto."""
        shared = set(around(where))
        return any(
            tag_of(mark) == tag
            for here in around(level)
            if here in shared
            for mark in here.system.of("GotoTagVisibility")
        )


def _original(level: Level, source: Endpoint | None) -> Endpoint | None:
    """The end of the inport itself, where a line begins at another mark of the same inport."""
    block = level.system.by_sid.get(source.block) if source is not None else None
    if source is None or block is None or block.type != "InportShadow":
        return source
    inport = level.port("Inport", port_number(block))
    return Endpoint(inport.sid, source.port, source.number) if inport is not None else None


def member_names(labels: Sequence[str], stated: str) -> list[str]:
    """The names of a bus creator's signals: those of its lines, else as stated, else numbered.

    >>> member_names(["n", "", "n", ""], "'a','b'")
    ['n', 'b', 'n3', 'signal4']
    """
    listed = re.findall(r"'([^']*)'", stated)
    names: list[str] = []
    for at, label in enumerate(labels):
        name = label or (listed[at] if at < len(listed) else "") or f"signal{at + 1}"
        names.append(f"{name}{at + 1}" if name in names else name)
    return names
