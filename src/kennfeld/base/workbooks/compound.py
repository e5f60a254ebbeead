"""Finds the workbook stream in a compound file, the container of .xls, and checks its sector chains.

The library that reads .xls follows these chains without a limit: a circular one takes all memory.

Layout: Microsoft, [MS-CFB]: a header, then sectors; a table (FAT) has the next sector of each, and short streams are
stored in short sectors within the stream of the root entry.
"""

import struct
from collections.abc import Iterator

MAGIC = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"

_HEADER = 512
_COUNTS = struct.Struct("<IIIIIIIII")  # at byte 40
_END = 0xFFFFFFFE
_ENTRY = 128  # bytes of an entry of the directory
_SHORT_SECTOR = 64
_SHORT_STREAM_LIMIT = 4096  # bytes; shorter streams lie in short sectors
_STREAMS = ("workbook", "book")


class _CompoundFile:
    """The sectors of a compound file, with their tables."""

    def __init__(self, content: bytes) -> None:
        if len(content) < _HEADER:
            raise ValueError("the file is cut off")
        self.content = content
        (shift,) = struct.unpack_from("<H", content, 30)
        if shift not in (9, 12):
            raise ValueError(f"its sectors have 2^{shift} bytes")
        self.size = 1 << shift
        self.sectors = max(-(-len(content) // self.size) - 1, 0)
        directories, tables, directory, _, _, short_table, short_tables, further, further_count = _COUNTS.unpack_from(
            content, 40
        )
        claimed = max(directories, tables, short_tables, further_count)
        if claimed > self.sectors:
            raise ValueError(f"it claims {claimed} sectors of one kind, but has {self.sectors} in all")
        self.table = _numbers(b"".join(map(self._sector, self._table_sectors(further))))
        self.entries = self._chain(directory)
        self.short_table = _numbers(self._chain(short_table))
        # the first entry is the root, whose stream holds the short sectors
        self.root = self._chain(self._extent(0)[0])

    def stream(self, index: int) -> bytes:
        """Return the content of an entry of the directory."""
        start, length = self._extent(index)
        if length >= _SHORT_STREAM_LIMIT:
            return self._chain(start)[:length]
        chain = _follow_chain(start, self.short_table, len(self.root) // _SHORT_SECTOR + 1)
        return b"".join(self.root[_SHORT_SECTOR * k : _SHORT_SECTOR * (k + 1)] for k in chain)[:length]

    def names(self) -> list[str]:
        """Return the names of all entries, folded."""
        raw = [self.entries[at : at + 64] for at in range(0, len(self.entries), _ENTRY)]
        return [name.decode("utf-16-le", "replace").partition("\0")[0].casefold() for name in raw]

    def _extent(self, index: int) -> tuple[int, int]:
        """Return the first sector of a directory entry, and its size in bytes."""
        entry = self.entries[_ENTRY * index : _ENTRY * (index + 1)].ljust(_ENTRY, b"\0")
        start = int.from_bytes(entry[116:120], "little")
        # files of version 3 may leave rubbish in the upper half
        length = int.from_bytes(entry[120 : 124 if self.size == 512 else 128], "little")
        if length > len(self.content):
            raise ValueError(f"one of its streams claims {length} bytes, more than the file has")
        return start, length

    def _table_sectors(self, further: int) -> list[int]:
        """Return the sectors of the FAT: the first 109 are in the header, others in a chain."""
        sectors = list(struct.unpack_from("<109I", self.content, 76))
        steps = 0
        while further < self.sectors:
            # the last entry of such a sector leads to the next one
            *more, further = _numbers(self._sector(further))
            sectors += more
            steps += 1
            if steps > self.sectors:
                raise ValueError("a chain of sectors is circular")
        sectors = [sector for sector in sectors if sector < _END]
        if len(sectors) > self.sectors:
            raise ValueError(f"it claims {len(sectors)} sectors of tables, but has {self.sectors} in all")
        return sectors

    def _chain(self, start: int) -> bytes:
        """Return the content of a chain of sectors."""
        return b"".join(map(self._sector, _follow_chain(start, self.table, self.sectors)))

    def _sector(self, index: int) -> bytes:
        # the header takes the room of one sector
        begin = (index + 1) * self.size
        return self.content[begin : begin + self.size]


def _numbers(raw: bytes) -> tuple[int, ...]:
    return struct.unpack(f"<{len(raw) // 4}I", raw[: len(raw) // 4 * 4])


def workbook_stream(content: bytes) -> bytes:
    """Return the records of the workbook in a compound file; empty if it has none, as an encrypted one.

    Raises `ValueError` if a chain leads back into itself or a size is more than the file holds. A chain that leaves the
    file ends there: what that damages is for the reader of the records to tell.
    """
    file = _CompoundFile(content)
    names = file.names()
    return next((file.stream(names.index(name)) for name in _STREAMS if name in names), b"")


def _follow_chain(start: int, table: tuple[int, ...], most: int) -> Iterator[int]:
    """Return the sectors of a chain."""
    sector, steps = start, 0
    while sector < len(table):
        yield sector
        sector, steps = table[sector], steps + 1
        if steps > most:
            raise ValueError("a chain of sectors is circular")
