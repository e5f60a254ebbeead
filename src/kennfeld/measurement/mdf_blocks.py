"""Check of the block links of an MDF file: none may lead out of the file or form a cycle.

The library that reads the samples follows links without a check; a damaged one would keep it in an endless loop. The
layouts are those of ASAM MDF 3.3 and 4.2: each block states its kind, its length and its links.
"""

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from kennfeld.base.errors import InputError, Location

# which of a block's links lead on; what else a block refers to may lead back with good reason
_LINKS_4 = {
    b"##HD": (0, 1, 2, 3, 4, 5),  # data group, history, channel hierarchy, attachment, event, comment
    b"##DG": (0, 1),  # next, channel group
    b"##CG": (0, 1, 2, 3),  # next, channel, name, source
    b"##CN": (0, 1, 2, 3, 4),  # next, composition, name, source, conversion
    b"##FH": (0,),
    b"##AT": (0,),
    b"##EV": (0,),
    b"##CH": (0, 1),
}
_ALL_LINKS_4 = (b"##CC",)
_OWNED = (b"##DG", b"##CG", b"##CN", b"DG", b"CG", b"CN")  # blocks to which one link leads
_LINKS_3 = {b"HD": 1, b"DG": 2, b"CG": 2, b"CN": 1}  # how many of the first links lead on
_HEAD_4, _HEAD_3 = 24, 4
_FIRST = 64  # where the header block begins in every version
_MOST_LINKS = 200_000  # of one block; a table of texts has no more


def check_links(path: Path) -> None:
    """Follow all links once; raise `InputError` if the file is truncated, or its blocks form a cycle or are shared."""
    size = path.stat().st_size
    with path.open("rb") as file:
        identification = file.read(_FIRST)
        if size < _FIRST + _HEAD_4:
            raise InputError.of(Location(path.name), f"the MDF file is cut off after {size} bytes", "Copy it again.")
        version = identification[8:12].decode("ascii", errors="replace").strip(" \0")
        order = "<" if identification[24:26] == b"\0\0" else ">"
        _walk(_Blocks4(file, size) if version.startswith("4") else _Blocks3(file, order), Location(path.name))


class _Blocks4:
    """Blocks of version 4: kind, length, number of links, links of 8 bytes."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.file, self.size = file, size

    def kind(self, at: int) -> bytes:
        """Return the kind of the block at this byte."""
        self.file.seek(at)
        return self.file.read(4)

    def links(self, at: int) -> Sequence[int]:
        """Return the links of the block at this byte; raise `ValueError` if there is none."""
        self.file.seek(at)
        head = self.file.read(_HEAD_4)
        if len(head) < _HEAD_4:
            raise ValueError("lies behind the end of the file")
        kind, length, count = struct.unpack("<4s4xQQ", head)
        if not kind.startswith(b"##"):
            raise ValueError("is not a block")
        if kind not in _LINKS_4 and kind not in _ALL_LINKS_4:
            return ()
        if at + length > self.size or _HEAD_4 + 8 * count > length or count > _MOST_LINKS:
            raise ValueError(f"claims {length} bytes and {count} links")
        links = struct.unpack(f"<{count}Q", self.file.read(8 * count))
        wanted = range(count) if kind in _ALL_LINKS_4 else [i for i in _LINKS_4[kind] if i < count]
        return [links[i] for i in wanted if links[i]]


class _Blocks3:
    """Blocks of versions 2 and 3: kind, length, links of 4 bytes."""

    def __init__(self, file: BinaryIO, order: str) -> None:
        self.file, self.order = file, order

    def kind(self, at: int) -> bytes:
        """Return the kind of the block at this byte."""
        self.file.seek(at)
        return self.file.read(2)

    def links(self, at: int) -> Sequence[int]:
        """Return the links of the block at this byte; raise `ValueError` if there is none."""
        self.file.seek(at)
        head = self.file.read(_HEAD_3 + 8)
        if len(head) < _HEAD_3:
            raise ValueError("lies behind the end of the file")
        kind = head[:2]
        if not kind.isalpha():
            raise ValueError("is not a block")
        if kind not in _LINKS_3 or len(head) < _HEAD_3 + 8:
            return ()
        links = struct.unpack(f"{self.order}2I", head[_HEAD_3:])
        return [link for link in links[: _LINKS_3[kind]] if link]


def _walk(blocks: _Blocks4 | _Blocks3, location: Location) -> None:
    """Walk depth first; a block that is met again while it is still open closes a cycle."""

    def links(at: int) -> Iterator[int]:
        try:
            return iter(blocks.links(at))
        except ValueError as error:
            message = f"the MDF file is damaged or cut off: the block at byte {at} {error}"
            raise InputError.of(location, message, "Copy it again from its source.") from None

    done = set[int]()
    path = {_FIRST: links(_FIRST)}  # the open blocks, each with its links that were not followed yet
    while path:
        at = next(reversed(path))
        following = next(path[at], None)
        if following is None:
            del path[at]
            done.add(at)
        elif following in path:
            message = f"the MDF file is damaged: its block at byte {at} leads back to the one at byte {following}"
            raise InputError.of(location, message, "Copy it again from its source.")
        elif following not in done:
            path[following] = links(following)
        elif blocks.kind(following) in _OWNED:  # a chain of such links doubles the channels with each
            message = f"the MDF file is damaged: two links lead to its block at byte {following}"
            raise InputError.of(location, message, "Copy it again from its source.")
