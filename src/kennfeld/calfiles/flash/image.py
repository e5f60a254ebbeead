"""The memory described by a file of records; gaps take no memory."""

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from kennfeld.errors import ArgumentError

_MAX_LINE_LENGTH = 600  # characters of a line


@dataclass(frozen=True, slots=True)
class Record:
    """Consecutive bytes of one line: where they belong and where their digits are in the file."""

    address: int
    content: bytes
    at: int  # of the first digit in the file
    checksum_at: int
    line: int

    @property
    def end(self) -> int:
        """The address after the last byte."""
        return self.address + len(self.content)


@dataclass(frozen=True, slots=True)
class Segment:
    """Consecutive memory."""

    address: int
    content: bytes

    @property
    def end(self) -> int:
        """The address after the last byte."""
        return self.address + len(self.content)


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
        return tuple(_join_run(run) for run in _contiguous_runs(self._sorted))

    @cached_property
    def _sorted(self) -> list[tuple[Record, int]]:
        return sorted(zip(self.records, range(len(self.records)), strict=True), key=lambda one: one[0].address)

    @cached_property
    def _starts(self) -> list[int]:
        return [segment.address for segment in self.segments]

    @cached_property
    def size(self) -> int:
        """The number of bytes."""
        return sum(len(segment.content) for segment in self.segments)

    def holds(self, address: int, size: int) -> bool:
        """Check whether all bytes of a range are present."""
        segment = self._segment(address)
        return segment is not None and size >= 0 and address + size <= segment.end

    def read(self, address: int, size: int) -> bytes | None:
        """Return the bytes of a range, None if one of them is missing."""
        segment = self._segment(address)
        if segment is None or size < 0 or address + size > segment.end:
            return None
        start = address - segment.address
        return segment.content[start : start + size]

    def _segment(self, address: int) -> Segment | None:
        at = bisect_right(self._starts, address) - 1
        return self.segments[at] if at >= 0 else None

    def changed(self, changes: Mapping[int, bytes]) -> bytes:
        """Return the file with other bytes at some addresses; checksums of the records follow.

        Raises `ArgumentError` if the image has no such address.
        """
        text = bytearray(self.raw)
        starts = [record.address for record, _ in self._sorted]
        longest = max((len(record.content) for record in self.records), default=0)
        checksums: dict[int, int] = {}
        for address, content in changes.items():
            if not self.holds(address, len(content)):
                raise ArgumentError(f"{len(content)} bytes at 0x{address:X} are not in {self.name}")
            for record in self._touched(starts, longest, address, len(content)):
                moved = _overwrite(text, record, address, content)
                checksums[record.checksum_at] = checksums.get(record.checksum_at, 0) + moved
        for at, moved in checksums.items():
            before = bytes.fromhex(text[at : at + 2].decode())
            if moved % 256:
                _put_digits(text, at, before, bytes([(before[0] - moved) % 256]))
        return bytes(text)

    def _touched(self, starts: list[int], longest: int, address: int, size: int) -> Iterator[Record]:
        at = bisect_right(starts, address - longest)
        while at < len(starts) and starts[at] < address + size:
            record = self._sorted[at][0]
            if record.end > address:
                yield record
            at += 1


def _contiguous_runs(ordered: list[tuple[Record, int]]) -> Iterator[list[tuple[Record, int]]]:
    run: list[tuple[Record, int]] = []
    end = 0
    for record, at in ordered:
        if run and record.address > end:
            yield run
            run = []
        end = max(end, record.end) if run else record.end
        run.append((record, at))
    if run:
        yield run


def _join_run(run: list[tuple[Record, int]]) -> Segment:
    first = run[0][0].address
    content = bytearray(max(record.end for record, _ in run) - first)
    for record, _ in sorted(run, key=lambda one: one[1]):
        content[record.address - first : record.end - first] = record.content
    return Segment(first, bytes(content))


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
    end = min((found for mark in (b"\n", b"\r") if (found := text.find(mark, at, last)) >= 0), default=last)
    line = bytes(text[start:end])
    return line != line.upper()
