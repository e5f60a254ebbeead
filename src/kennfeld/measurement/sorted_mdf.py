"""Reader of sorted MDF 4 files whose records hold plain numbers, as most loggers write them.

The library that reads every MDF file takes longer to load than hundreds of such files take to read, and it cannot be
used by several threads. `SortedFile` has those of its attributes that `mdf` uses. Whatever is unusual or damaged raises
`UnusualLayoutError`; the library then reads the file, or explains the damage. The layouts are those of ASAM MDF 4.2.
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.mdf_conversions import KINDS_4, ConversionKind, MdfConversion, UnsupportedConversionError
from kennfeld.measurement.mdf_start_time import HeaderTime

_HEAD = struct.Struct("<4s4xQQ")  # kind, length and number of links of a block
_FIRST = 64  # where the header block begins
_MOST_BYTES = 1 << 20  # of a block without samples
_MOST_BLOCKS = 100_000  # of one chain
_PACKED_HEAD = _HEAD.size + 24  # bytes of a block before compressed data
_AT_ONCE = 1 << 22  # bytes of records
_PACKING = 1100  # maximum compression ratio of deflate
_MASTERS = (2, 3)  # types of channels that hold time
_PLAIN = (0, 2)  # types of channels whose samples lie in the records
_INVALID = 3  # flags: all samples are invalid, or the record says which
_FOREIGN_GROUP = 0b11111  # flags: samples of varying length, bus events, samples in other groups
_NUMBERS = {0: "<u", 1: ">u", 2: "<i", 3: ">i", 4: "<f", 5: ">f"}
_SIZES = (8, 16, 32, 64)  # bits
_MOST_NESTED = 4  # conversions within tables of others
_WITH_TEXTS = (ConversionKind.TEXTS, ConversionKind.TEXT_RANGES)


class UnusualLayoutError(Exception):
    """The file has a part that this reader does not know, or that is damaged."""


@contextmanager
def _distrusted() -> Iterator[None]:
    """Convert the errors that damaged blocks cause."""
    try:
        yield
    except (struct.error, zlib.error, IndexError, ValueError, OverflowError, MemoryError) as error:
        raise UnusualLayoutError(str(error)) from None


class _FileBlock(NamedTuple):
    links: Sequence[int]
    data: bytes


@dataclass(frozen=True)
class _Origin:
    name: str
    path: str


@dataclass(frozen=True)
class _Channel:
    name: str
    unit: str
    comment: str
    source: _Origin | None
    conversion: MdfConversion | None
    channel_type: int
    sync_type: int
    flags: int
    layout: tuple[int, int, int, int]  # data type, bit offset, byte offset, number of bits

    @property
    def dtype(self) -> str:
        """The type of the numbers in the record."""
        kind, shift, _, bits = self.layout
        plain = self.channel_type in _PLAIN and not self.flags & _INVALID
        if not plain or kind not in _NUMBERS or shift or bits not in _SIZES or (kind > 3 and bits == 8):
            raise UnusualLayoutError("channel")
        return f"{_NUMBERS[kind]}{bits // 8}"


class _GroupBlock(NamedTuple):
    acq_name: str
    comment: str
    cycles_nr: int  # samples
    record: int  # bytes


@dataclass(frozen=True)
class _Group:
    channel_group: _GroupBlock
    channels: tuple[_Channel, ...]
    data: int  # where the records are
    channel_dependencies: tuple[()] = ()


class _Signal(NamedTuple):
    samples: NDArray[Any]
    timestamps: NDArray[Any]
    unit: str
    invalidation_bits: None = None


class SortedFile:
    """A sorted MDF 4 file, open for reading; see the module for its attributes.

    Raises:
        UnusualLayoutError: the library has to read the file.
    """

    version = "4"

    def __init__(self, path: Path) -> None:
        self._size, self._file = path.stat().st_size, path.open("rb")
        self._texts: dict[int, str] = {}
        self._chained: set[int] = set()  # groups and channels; each has one place
        self._conversions: dict[int, MdfConversion] = {}
        try:
            with _distrusted():
                self._check_identification()
                header = self._block(_FIRST, b"##HD")
                self.start_time = HeaderTime(*struct.unpack_from("<QhhB", header.data)).start_time
                self.groups = [self._group(block) for block in self._chain(header.links[0], b"##DG")]
        except BaseException:
            self._file.close()
            raise
        self.masters_db = {
            number: at
            for number, group in enumerate(self.groups)
            for at, channel in enumerate(group.channels)
            if channel.channel_type in _MASTERS
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def select(self, places: Sequence[tuple[None, int, int]], **_: Any) -> list[_Signal]:
        """Return the raw samples of channels of one group, given by group and index, with its stamps in s."""
        number = places[0][1]
        group, master = self.groups[number], self.masters_db.get(number)
        indices = [index for _, _, index in places]
        needed = list(dict.fromkeys([*indices, *(() if master is None else (master,))]))
        samples = dict(zip(needed, self._samples(group, needed), strict=True))
        stamps = np.arange(group.channel_group.cycles_nr) if master is None else self._stamps(number, samples[master])
        return [_Signal(samples[index], stamps, _unit(group.channels[index])) for index in indices]

    def get_master(self, number: int) -> NDArray[Any]:
        """Return the time stamps of a group, [samples]: in s, or numbers of samples without a master channel."""
        master = self.masters_db.get(number)
        group = self.groups[number]
        if master is None:
            return np.arange(group.channel_group.cycles_nr)
        return self._stamps(number, self._samples(group, [master])[0])

    def _stamps(self, number: int, raw: NDArray[Any]) -> NDArray[Any]:
        """Return the time stamps of a group from their raw values."""
        conversion = self.groups[number].channels[self.masters_db[number]].conversion
        try:
            return raw if conversion is None else conversion.convert(raw)
        except UnsupportedConversionError:
            raise UnusualLayoutError("conversion of time") from None

    def _samples(self, group: _Group, indices: Sequence[int]) -> list[NDArray[Any]]:
        """Return the raw values of channels."""
        channels = [group.channels[index] for index in indices]
        count, record = group.channel_group.cycles_nr, group.channel_group.record
        if any(channel.layout[2] + channel.layout[3] // 8 > record for channel in channels):
            raise UnusualLayoutError("channel beyond its record")
        fields = {
            "names": [str(index) for index in indices],
            "formats": [channel.dtype for channel in channels],
            "offsets": [channel.layout[2] for channel in channels],
            "itemsize": record,
        }
        kind: np.dtype[Any] = np.dtype(fields)  # type: ignore[call-overload]
        # filled part by part, so that the records are never in memory as a whole
        columns = [np.empty(count, kind[str(index)].newbyteorder("=")) for index in indices]
        end = 0
        with _distrusted():
            for records in self._records(group):
                table = np.frombuffer(records, kind)
                for index, column in zip(indices, columns, strict=True):
                    column[end : end + table.size] = table[str(index)]
                end += table.size
        if end != count:
            raise UnusualLayoutError(f"{end} samples of {count}")
        return columns

    def _records(self, group: _Group) -> Iterator[bytes]:
        """Yield whole records of a group."""
        record, rest = group.channel_group.record, b""
        for part in self._parts(group.data, record) if group.data else ():
            # a record may begin in one block of data and end in the next
            whole = rest + part if rest else part
            length = len(whole) // record * record
            rest = whole[length:]
            yield whole[:length] if rest else whole
        if rest:
            raise UnusualLayoutError("a part of a record")

    def _parts(self, at: int, record: int) -> Iterator[bytes]:
        """Yield the bytes of a data block, or of a list of data blocks."""
        kind, length, _ = self._head(at)
        if kind == b"##DT":
            end = at + length
            if end > self._size:
                raise UnusualLayoutError("cut off")
            step = max(_AT_ONCE // record, 1) * record
            for first in range(at + _HEAD.size, end, step):
                self._file.seek(first)
                yield self._file.read(min(step, end - first))
        elif kind == b"##DZ":
            yield self._unpacked(at, length)
        elif kind == b"##HL":
            yield from self._parts(self._block(at, b"##HL").links[0], record)
        elif kind == b"##DL":
            for block in self._chain(at, b"##DL"):
                for link in block.links[1:]:
                    if self._head(link)[0] not in (b"##DT", b"##DZ"):
                        raise UnusualLayoutError("list in a list")
                    yield from self._parts(link, record)
        else:
            raise UnusualLayoutError(f"data block {kind!r}")

    def _unpacked(self, at: int, length: int) -> bytes:
        """Return the content of a compressed data block."""
        self._file.seek(at + _HEAD.size)
        original, method, columns, size, packed = struct.unpack("<2sBxIQQ", self._file.read(24))
        if original != b"DT" or method not in (0, 1) or size > _PACKING * max(packed, 1):
            raise UnusualLayoutError("compressed block")
        if _PACKED_HEAD + packed > length or at + length > self._size:
            raise UnusualLayoutError("compressed block that is cut off")
        content = zlib.decompress(self._file.read(packed), bufsize=max(size, 1))
        if len(content) != size:
            raise UnusualLayoutError(f"{len(content)} bytes of {size}")
        if method == 0:
            return content
        rows = size // max(columns, 1)  # the bytes of each column follow each other, then an incomplete row
        table = np.frombuffer(content, np.uint8, rows * columns).reshape(columns, rows)
        return table.T.tobytes() + content[rows * columns :]

    def _check_identification(self) -> None:
        start = self._file.read(_FIRST)
        # bytes 60 to 63 are the flags of what was not finalized
        finalized = start[:8] == b"MDF     " and start[60:64] == bytes(4)
        if len(start) < _FIRST or not finalized or not start[8:9] == b"4":
            raise UnusualLayoutError("version")

    def _head(self, at: int) -> tuple[bytes, int, int]:
        self._file.seek(at)
        kind, length, links = _HEAD.unpack(self._file.read(_HEAD.size))
        return kind, length, links

    def _block(self, at: int, wanted: bytes) -> _FileBlock:
        """Return links and data of a block."""
        kind, length, count = self._head(at)
        if kind != wanted or not _HEAD.size + 8 * count <= length <= _MOST_BYTES:
            raise UnusualLayoutError(f"block {kind!r}")
        content = self._file.read(length - _HEAD.size)
        return _FileBlock(struct.unpack_from(f"<{count}Q", content), content[8 * count :])

    def _chain(self, at: int, kind: bytes) -> Iterator[_FileBlock]:
        """Yield the blocks of a chain; the first link of each leads to the next."""
        # a list may be read again and again, so only a cycle in it is an error
        chained = set[int]() if kind == b"##DL" else self._chained
        for _ in range(_MOST_BLOCKS):
            if not at:
                return
            if at in chained:
                raise UnusualLayoutError("a block has two places")
            chained.add(at)
            block = self._block(at, kind)
            yield block
            at = block.links[0]
        raise UnusualLayoutError("endless chain")

    def _group(self, block: _FileBlock) -> _Group:
        """Return the group of a data group."""
        _, first, data, _ = block.links[:4]
        # records with an identifier are those of several groups
        if block.data[0]:
            raise UnusualLayoutError("unsorted")
        following, channel, name, _, _, comment = (group := self._block(first, b"##CG")).links[:6]
        count, flags, size, invalid = struct.unpack_from("<8xQH6xII", group.data)
        if following or flags & _FOREIGN_GROUP or len(group.links) != 6:
            raise UnusualLayoutError("group")
        if not 0 < size + invalid <= _AT_ONCE or count * (size + invalid) > _PACKING * self._size:
            raise UnusualLayoutError("size of the group")
        channels = tuple(self._channel(block) for block in self._chain(channel, b"##CN"))
        return _Group(_GroupBlock(self._text(name), self._text(comment), count, size + invalid), channels, data)

    def _channel(self, block: _FileBlock) -> _Channel:
        _, composition, name, source, conversion, _, unit, comment = block.links[:8]
        if composition:
            raise UnusualLayoutError("structure or array")
        kind, sync, *layout, flags = struct.unpack_from("<4B3I", block.data)
        return _Channel(
            name=self._text(name),
            unit=self._text(unit),
            comment=self._text(comment),
            source=self._origin(source),
            conversion=self._conversion(conversion),
            channel_type=kind,
            sync_type=sync,
            flags=flags,
            layout=(layout[0], layout[1], layout[2], layout[3]),
        )

    def _origin(self, at: int) -> _Origin | None:
        if not at:
            return None
        links = self._block(at, b"##SI").links
        return _Origin(self._text(links[0]), self._text(links[1]))

    def _conversion(self, at: int, depth: int = 0) -> MdfConversion | None:
        if not at:
            return None
        if at not in self._conversions:
            self._conversions[at] = self._read_conversion(at, depth)
        return self._conversions[at]

    def _read_conversion(self, at: int, depth: int) -> MdfConversion:
        block = self._block(at, b"##CC")
        number, count = struct.unpack_from("<B5xH", block.data)
        if number not in KINDS_4 or depth > _MOST_NESTED:
            raise UnusualLayoutError("conversion")
        kind = KINDS_4[number]
        # behind 8 bytes of fields and the physical range, two doubles; the masks of bits are integers
        values = () if kind is ConversionKind.BITS else struct.unpack_from(f"<{count}d", block.data, 24)
        references: tuple[str | MdfConversion | None, ...] = ()
        if kind in _WITH_TEXTS:
            # behind name, unit, comment and inverse
            references = tuple(self._reference(link, depth) for link in block.links[4:])
        elif kind is ConversionKind.FORMULA:
            references = (self._text(block.links[4]),)
        return MdfConversion(kind, values, references, self._text(block.links[1]))

    def _reference(self, at: int, depth: int) -> str | MdfConversion | None:
        """Return a text or a conversion that a table of texts refers to."""
        if at and self._head(at)[0] == b"##CC":
            return self._conversion(at, depth + 1)
        return self._text(at) or None

    def _text(self, at: int) -> str:
        """Return the text of a block; several blocks refer to one."""
        if at not in self._texts:
            self._texts[at] = self._read_text(at) if at else ""
        return self._texts[at]

    def _read_text(self, at: int) -> str:
        kind, length, count = self._head(at)
        if kind not in (b"##TX", b"##MD") or count or not _HEAD.size <= length <= _MOST_BYTES:
            raise UnusualLayoutError("text")
        return self._file.read(length - _HEAD.size).split(b"\0", 1)[0].strip(b" \r\t\n").decode()


def _unit(channel: _Channel) -> str:
    return (channel.conversion.unit if channel.conversion else "") or channel.unit
