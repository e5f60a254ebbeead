"""Reader of MLG files, versions 1 and 2: the binary logs of TunerStudio, MegaLogViewer and rusEFI.

The layout is that published by EFI Analytics ("MLG Binary LogFormat") and found in files of TunerStudio. All numbers
are big-endian. The header holds `MLVLG` and a zero byte, version, Unix time, offset of the information, offset of the
data, length of a record and number of fields; then come the fields (55 bytes each in version 1, 89 in version 2), the
names of bits, the information, and the records.
"""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from kennfeld.arrays import Bool, Float, Int
from kennfeld.errors import Finding, InputError
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.header import Header
from kennfeld.measurement.table import MAX_MARKS, Column, Selection, Table, describe_marks, unique_names
from kennfeld.measurement.time_column import time_in_seconds
from kennfeld.measurement.unit_text import time_unit

_HEADS = {1: struct.Struct(">6shIHIHH"), 2: struct.Struct(">6shIIIHH")}
_SIZES = {1: 55, 2: 89}
_NUMBER = struct.Struct(">B34s10sBffb")
_BITS = struct.Struct(">B34s10sBBIB3x")
_TYPES = {0: "u1", 1: "i1", 2: ">u2", 3: ">i2", 4: ">u4", 5: ">i4", 6: ">i8", 7: ">f4"}
# the published numbers are 10 to 12; TunerStudio writes them as if they were hexadecimal
_BIT_TYPES = {10: "u1", 11: ">u2", 12: ">u4", 16: "u1", 17: ">u2", 18: ">u4"}
_CATEGORY = slice(55, 89)
_MAX_INFORMATION = 4_000_000  # bytes

_MARKER = 54  # bytes of a marker: type, counter, stamp, 50 bytes of text
_TICK = 1e-5  # s, of the time stamp of a record
_STAMPS = 1 << 16
_MAX_VALUES = 500_000_000  # of all requested channels, 4 GB
_TUNE = re.compile(r"NEW_INFO_PROVIDER,\w*TUNE|<msq\b")
_SWITCHES = range(4, 9)  # styles shown as a pair of words: on/off, yes/no, high/low, active/inactive, true/false


@dataclass(frozen=True)
class LogField:
    """One field of a record: its value is (raw + transform) * scale; `bits` names the bits of a field of bits."""

    name: str
    unit: str
    type: str
    scale: float = 1.0
    transform: float = 0.0
    digits: int = 0
    style: int = 0
    category: str = ""
    bits: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Bytes in the record."""
        return np.dtype(self.type).itemsize


@dataclass(frozen=True)
class Head:
    """The header; `begin` is the byte of the first record, `information` a text."""

    version: int
    created: int  # Unix time in s
    fields: tuple[LogField, ...]
    begin: int
    information: str

    @property
    def record(self) -> np.dtype[np.void]:
        """A record as it lies in the file: type, counter, time stamp, fields, checksum."""
        fields = [(f"{i}", field.type) for i, field in enumerate(self.fields)]
        return np.dtype([("type", "u1"), ("counter", "u1"), ("stamp", ">u2"), *fields, ("sum", "u1")])


def read_head(place: str, content: memoryview) -> Head:
    """Return the head of a file with this content; `InputError` with all that is wrong in it."""
    version = int.from_bytes(bytes(content[6:8]), "big")
    if version not in _HEADS:
        remedy = "Log or export it again in version 1 or 2."
        raise InputError.of(place, f"the MLG file is of version {version}, which is not supported", remedy)
    if len(content) < _HEADS[version].size:
        raise _cut(place, len(content), _HEADS[version].size)
    _, _, created, info, begin, length, count = _HEADS[version].unpack_from(content)
    first, size = _HEADS[version].size, _SIZES[version]
    end = first + count * size
    if end > len(content) or begin > len(content):
        raise _cut(place, len(content), max(end, begin))
    if not count or begin < end:
        message = f"the MLG file is damaged: its head names {count} fields up to byte {end}, data from byte {begin}"
        raise InputError.of(place, message, "Copy it again from its source.")
    findings: list[Finding] = []
    fields = tuple(
        field
        for k in range(count)
        if (field := _field(place, k + 1, content, first + k * size, size, (end, begin), findings)) is not None
    )
    total = sum(field.size for field in fields)
    if not findings and total != length:
        message = f"the MLG file is damaged: its records are of {length} bytes, their fields of {total}"
        findings.append(Finding(place, message, "Copy it again from its source."))
    if findings:
        raise InputError(findings[:20])
    text = bytes(content[info : min(begin, info + _MAX_INFORMATION)]) if end <= info <= begin else b""
    return Head(version, created, fields, begin, plain_text(text))


def _cut(place: str, size: int, needed: int) -> InputError:
    message = f"the MLG file is damaged or cut off: it has {size} bytes, its head alone needs {needed}"
    return InputError.of(place, message, "Copy it again from its source.")


def _field(
    place: str, number: int, content: memoryview, at: int, size: int, names: tuple[int, int], findings: list[Finding]
) -> LogField | None:
    kind = content[at]
    category = plain_text(bytes(content[at : at + size][_CATEGORY]))
    if kind in _BIT_TYPES:
        _, name, unit, style, _, index, count = _BITS.unpack_from(content, at)
        width = 8 * np.dtype(_BIT_TYPES[kind]).itemsize
        bits = _bit_names(content, index, min(count, width), names)
        return LogField(plain_text(name), plain_text(unit), _BIT_TYPES[kind], style=style, category=category, bits=bits)
    where = f"{place} field {number}"
    if kind not in _TYPES:
        findings.append(Finding(where, f"unknown type {kind}", "Copy the file again from its source."))
        return None
    _, name, unit, style, scale, transform, digits = _NUMBER.unpack_from(content, at)
    if not (np.isfinite(scale) and np.isfinite(transform)):
        message = f"its scale {scale:g} and transform {transform:g} must be finite"
        findings.append(Finding(where, message, "Copy the file again from its source."))
        return None
    called = plain_text(name) or f"field {number}"
    numbers = _decimal(scale), _decimal(transform)
    return LogField(called, plain_text(unit), _TYPES[kind], *numbers, digits, style, category)


def _decimal(value: float) -> float:
    """Return the number that was meant: 0.1 where four bytes hold 0.10000000149."""
    return float(str(np.float32(value)))


def _bit_names(content: memoryview, index: int, count: int, region: tuple[int, int]) -> tuple[str, ...]:
    """Return the names of the bits, lowest first, between the fields and the data; empty ones where there are none."""
    begin, end = region
    at = index if index >= begin else begin + index
    names = bytes(content[at:end]).split(b"\0", count)[:count] if at < end else []
    return tuple(plain_text(name) for name in names) + ("",) * (count - len(names))


def plain_text(text: bytes) -> str:
    """Return the text up to the first zero byte, in UTF-8 or the Windows encoding."""
    text = text.partition(b"\0")[0]
    try:
        return text.decode("utf-8").strip()
    except UnicodeDecodeError:
        return text.decode("cp1252", errors="replace").strip()


@dataclass(frozen=True)
class _Signal:
    """A channel: a field, or one bit of it."""

    field: LogField
    place: int  # of the field in the record
    bit: int | None = None

    @property
    def label(self) -> str:
        """The name in the file."""
        if self.bit is None:
            return self.field.name
        return self.field.bits[self.bit] or f"{self.field.name or f'field {self.place + 1}'} bit {self.bit}"


@dataclass(frozen=True)
class _Blocks:
    """The raw records and the markers between them."""

    records: NDArray[np.void]  # of the type of the head
    marks: tuple[tuple[int, str], ...]  # the record that follows, text
    mark_count: int
    rest: int  # bytes of a block that is cut off


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the one table of an MLG file.

    The field `Time` is the time where there is one: the stamps of the records, in 10 us, restart every 0.66 s and
    lose each longer pause. Records with a wrong checksum are left out, so is a last one that is cut off; the details
    of the table say so.
    """
    content = np.memmap(source.path, np.uint8, mode="r")
    head = read_head(source.name, memoryview(content))  # type: ignore[arg-type]
    signals = _signals(head)
    names = unique_names([signal.label for signal in signals])
    header = Header(0, 0, tuple(names), tuple(signal.field.unit for signal in signals))
    blocks = _blocks(source.name, content, head)
    wanted = selection.wants(header)
    _check_size(source.name, blocks, len(wanted))
    columns = [_column(names[i], signals[i], blocks) for i in wanted]
    return [_table(source.name, head, header, columns, blocks)]


def _check_size(place: str, blocks: _Blocks, channels: int) -> None:
    if not blocks.records.size:
        raise InputError.of(place, "holds no records", "Is it the right file?")
    if channels * blocks.records.size > _MAX_VALUES:
        message = f"{channels} channels of this file hold more than {_MAX_VALUES} values"
        raise InputError.of(place, message, "Name the channels to read.")


def _signals(head: Head) -> list[_Signal]:
    """Return every field of numbers; of a field of bits each bit, and the whole where it has a name."""
    found = []
    for place, field in enumerate(head.fields):
        if field.name:
            found.append(_Signal(field, place))
        found += [_Signal(field, place, bit) for bit in range(len(field.bits))]
    return found


def _blocks(place: str, content: NDArray[np.uint8], head: Head) -> _Blocks:
    """Return the records, in runs between markers."""
    length = head.record.itemsize
    runs: list[NDArray[np.uint8]] = []
    marks: list[tuple[int, str]] = []
    at, count, mark_count = head.begin, 0, 0
    while at < content.size:
        kind = int(content[at])
        if kind == 0 and at + length <= content.size:
            run = _run(content, at, length)
            runs.append(content[at : at + run * length])
            count, at = count + run, at + run * length
        elif kind == 1 and at + _MARKER <= content.size:
            mark_count += 1
            if len(marks) < MAX_MARKS:
                marks.append((count, plain_text(content[at + 4 : at + _MARKER].tobytes())))
            at += _MARKER
        elif kind in (0, 1):
            break
        else:
            message = (
                f"the MLG file is damaged: after {count} records, at byte {at}, there is a block of unknown type {kind}"
            )
            raise InputError.of(place, message, "Copy it again from its source.")
    whole = runs[0] if len(runs) == 1 else np.concatenate(runs) if runs else content[:0]
    return _Blocks(whole.view(head.record), tuple(marks), mark_count, content.size - at)


def _run(content: NDArray[np.uint8], at: int, length: int) -> int:
    """Return the number of consecutive records from this byte, looking ahead in growing steps."""
    most = (content.size - at) // length
    found, step = 0, 64
    while found < most:
        some = content[at + found * length : at + min(found + step, most) * length : length]
        other = np.flatnonzero(some)
        if other.size:
            return found + int(other[0])
        found, step = found + some.size, 4 * step
    return most


def _column(name: str, signal: _Signal, blocks: _Blocks) -> Column:
    field = signal.field
    raw = blocks.records[str(signal.place)]
    if signal.bit is not None:
        values = ((raw >> signal.bit) & 1).astype(np.float64)
        return Column(name, "", name, values, held=True, description=field.category)
    with np.errstate(invalid="ignore"):  # a NaN that signals
        values = raw.astype(np.float64)
    if field.transform:
        values += field.transform
    if field.scale != 1.0:
        values *= field.scale
    values[np.isnan(values)] = np.nan
    held = field.style in _SWITCHES or bool(field.bits)
    return Column(name, field.unit, name, values, held=held, description=_said(field))


def _said(field: LogField) -> str:
    digits = f"{field.digits} digit{'s' * (field.digits > 1)}" if field.digits > 0 else ""
    return ", ".join(part for part in (field.category, digits) if part)


def _table(place: str, head: Head, header: Header, columns: Sequence[Column], blocks: _Blocks) -> Table:
    named = next((c for c in columns if time_unit(c.name, c.unit) is not None and _varies(c.values)), None)
    clock = named or _stamps(blocks)
    time = time_in_seconds(clock)
    good = _intact(blocks.records)
    at = ((float(time[min(at, time.size - 1)]), text) for at, text in blocks.marks)
    marks = [(moment if np.isfinite(moment) else None, text) for moment, text in at]
    kept = [c if good.all() else c.kept(good) for c in (columns if named else [clock, *columns])]
    return Table(
        place,
        tuple(kept),
        np.flatnonzero(good) + 1,
        "record",
        header.names if named else (clock.name, *header.names),
        details=(*_details(head), *describe_marks(marks, blocks.mark_count), *_losses(blocks, good, named is None)),
        restarts=True,
        clock=kept[0 if named is None else next(i for i, c in enumerate(columns) if c is named)],
    )


def _varies(values: Float) -> bool:
    known = values[np.isfinite(values)]
    return bool(known.size and np.any(known != known[0]))


def _stamps(blocks: _Blocks) -> Column:
    """Return the time by the stamps of the records, which count 10 us and restart after 65 536."""
    stamps: Int = blocks.records["stamp"].astype(np.int64)
    steps: Int = np.diff(stamps) % _STAMPS
    time: Float = np.concatenate([[0.0], np.cumsum(steps) * _TICK])
    return Column("time", "s", "time", time)


def _intact(records: NDArray[np.void]) -> Bool:
    """Return the records whose checksum is right; all if hardly any is, since some loggers write none."""
    contents = records.view(np.uint8).reshape(records.size, -1)
    good: Bool = contents[:, 4:-1].sum(axis=1, dtype=np.uint8) == records["sum"]
    return good if 2 * np.count_nonzero(good) > good.size else np.ones(good.size, dtype=bool)


def _details(head: Head) -> tuple[tuple[str, str], ...]:
    found = [("version", str(head.version))]
    if head.created:
        found.append(("recorded", f"{datetime.fromtimestamp(head.created, UTC):%Y-%m-%d %H:%M} UTC"))
    first = next((line.strip('" ') for line in head.information.splitlines() if line.strip('" ')), "")
    if first and not _TUNE.search(first):
        found.append(("by", " ".join(first.split())[:80]))
    if _TUNE.search(head.information):
        found.append(("tune", "a whole TunerStudio tune (.msq) is inside"))
    return tuple(found)


def _losses(blocks: _Blocks, good: Bool, stamped: bool) -> tuple[tuple[str, str], ...]:
    """Return the details on missing or doubtful records."""
    found = []
    bad = int(np.count_nonzero(~good))
    if stamped:
        found.append(("time", "from the stamps of the records, without pauses longer than 0.65 s"))
    if bad:
        found.append(("left out", f"{bad} record{'s' * (bad > 1)} with a wrong checksum"))
    if blocks.rest:
        found.append(("cut off", f"the last record lacks its end ({blocks.rest} bytes are there)"))
    return tuple(found)
