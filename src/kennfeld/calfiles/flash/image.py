"""The memory described by a file of records; gaps take no memory."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass

_MAX_LINE_LENGTH = 600  # characters of a line


@dataclass(frozen=True, slots=True)
class Segment:
    """Consecutive memory."""

    address: int
    content: bytes

    @property
    def end(self) -> int:
        """The address after the last byte."""
        return self.address + len(self.content)


@dataclass(frozen=True, slots=True)
class Record(Segment):
    """Consecutive bytes of one line: where they belong and where their digits are in the file."""

    at: int  # of the first digit in the file
    checksum_at: int
    line: int


@dataclass(frozen=True, eq=False)
class Image:
    """The memory in a file of records, Intel HEX or S-records.

    `raw` is the file as it lies on the disk; of records that overlap the last one counts.
    """

    name: str
    kind: str
    raw: bytes
    records: Sequence[Record]  # in the order of the file

    @cached_property
    def segments(self) -> tuple[Segment, ...]:
        """All memory as segments without gaps, by ascending address."""
        spans: list[tuple[int, int]] = []  # first address and end of each segment
        for record in self._sorted:
            # records that touch or overlap are one segment
            if spans and record.address <= spans[-1][1]:
                spans[-1] = (spans[-1][0], max(spans[-1][1], record.end))
            else:
                spans.append((record.address, record.end))
        starts = [start for start, _ in spans]
        contents = [bytearray(end - start) for start, end in spans]
        for record in self.records:  # in the order of the file, since the last one counts
            at = bisect_right(starts, record.address) - 1
            contents[at][record.address - starts[at] : record.end - starts[at]] = record.content
        return tuple(Segment(start, bytes(content)) for start, content in zip(starts, contents, strict=True))

    @cached_property
    def _sorted(self) -> list[Record]:
        return sorted(self.records, key=lambda record: record.address)

    @cached_property
    def _starts(self) -> list[int]:
        return [segment.address for segment in self.segments]

    @cached_property
    def size(self) -> int:
        """The number of bytes."""
        return sum(len(segment.content) for segment in self.segments)

    def holds(self, address: int, size: int) -> bool:
        """Check whether all bytes of a range are present."""
        return self._segment(address, size) is not None

    def read(self, address: int, size: int) -> bytes | None:
        """Return the bytes of a range, None if one of them is missing."""
        segment = self._segment(address, size)
        if segment is None:
            return None
        start = address - segment.address
        return segment.content[start : start + size]

    def _segment(self, address: int, size: int) -> Segment | None:
        """Return the segment that contains a whole range."""
        at = bisect_right(self._starts, address) - 1
        return self.segments[at] if at >= 0 and size >= 0 and address + size <= self.segments[at].end else None

    def changed(self, changes: Mapping[int, bytes]) -> bytes:
        """Return the file with other bytes at some addresses; checksums of the records follow.

        Raises `ArgumentError` if the image has no such address.
        """
        text = bytearray(self.raw)
        starts = [record.address for record in self._sorted]
        longest = max((len(record.content) for record in self.records), default=0)
        checksums: dict[int, int] = {}
        for address, content in changes.items():
            if not self.holds(address, len(content)):
                raise ArgumentError(f"{len(content)} bytes at 0x{address:X} are not in {self.name}")
            for record in self._touched(starts, longest, address, len(content)):
                increase = _overwrite(text, record, address, content)
                checksums[record.checksum_at] = checksums.get(record.checksum_at, 0) + increase
        # the sum of bytes and checksum is constant modulo 256, so one falls as the others rise
        for at, increase in checksums.items():
            before = bytes.fromhex(text[at : at + 2].decode())
            if increase % 256:
                _put_digits(text, at, before, bytes([(before[0] - increase) % 256]))
        return bytes(text)

    def _touched(self, starts: list[int], longest: int, address: int, size: int) -> Iterator[Record]:
        # a record that begins earlier is too short to reach this address
        at = bisect_right(starts, address - longest)
        while at < len(starts) and starts[at] < address + size:
            if self._sorted[at].end > address:
                yield self._sorted[at]
            at += 1


def _overwrite(text: bytearray, record: Record, address: int, content: bytes) -> int:
    """Write bytes into the digits of a record; return the increase of the sum of its bytes."""
    first, last = max(address, record.address), min(address + len(content), record.end)
    begin, end = (record.at + 2 * (at - record.address) for at in (first, last))
    now = content[first - address : last - address]
    before = bytes.fromhex(text[begin:end].decode())
    if now == before:
        return 0
    _put_digits(text, begin, before, now)
    return sum(now) - sum(before)


def _put_digits(text: bytearray, at: int, before: bytes, now: bytes) -> None:
    """Write hexadecimal digits in the case that their line uses; unchanged bytes keep their spelling."""
    small = _uses_small_letters(text, at)
    digits = text[at : at + 2 * len(before)]
    if digits == (digits.lower() if small else digits.upper()):
        text[at : at + len(digits)] = (now.hex() if small else now.hex().upper()).encode()
        return
    for i in range(len(now)):
        if now[i] != before[i]:
            place = at + 2 * i
            text[place : place + 2] = (f"{now[i]:02x}" if small else f"{now[i]:02X}").encode()


def _uses_small_letters(text: bytearray, at: int) -> bool:
    first, last = max(0, at - _MAX_LINE_LENGTH), at + _MAX_LINE_LENGTH
    start = max(first, text.rfind(b"\n", first, at) + 1, text.rfind(b"\r", first, at) + 1)
    end = min((place for mark in (b"\n", b"\r") if (place := text.find(mark, at, last)) >= 0), default=last)
    line = bytes(text[start:end])
    return line != line.upper()
