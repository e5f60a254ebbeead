"""Reader of MLG files, versions 1 and 2: the binary logs of TunerStudio, MegaLogViewer and rusEFI.

The layout is that published by EFI Analytics ("MLG Binary LogFormat") and found in files of TunerStudio. All numbers
are big-endian. The header holds `MLVLG` and a zero byte, version, Unix time, offset of the information, offset of the
data, length of a record and number of fields; then come the fields (55 bytes each in version 1, 89 in version 2), the
names of bits, the information, and the records.
"""

import re
import struct
from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.claimed_values import check_claimed
from kennfeld.measurement.header import Header, unique_names
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import MAX_MARKS, Column, Selection, Table, describe_marks
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
_MAX_FINDINGS = 20
_MAX_INFORMATION = 4_000_000  # bytes

_MARKER = 54  # bytes of a marker: type, counter, stamp, 50 bytes of text
_TICK = 1e-5  # s, of the time stamp of a record
_STAMPS = 1 << 16
_MAX_VALUES = 500_000_000  # of all requested channels, 4 GB
_TUNE = re.compile(r"NEW_INFO_PROVIDER,\w*TUNE|<msq\b")
_COPY_AGAIN = "Copy it again from its source."
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


def read_head(location: Location, content: memoryview) -> Head:
    """Return the head of a file with this content; raise `InputError` with all that is wrong in it."""
    version = int.from_bytes(bytes(content[6:8]), "big")
    if version not in _HEADS:
        remedy = "Log or export it again in version 1 or 2."
        raise InputError.of(location, f"the MLG file is of version {version}, which is not supported", remedy)
    first, size = _HEADS[version].size, _SIZES[version]
    _check_length(location, content, first)
    _, _, created, info, begin, length, count = _HEADS[version].unpack_from(content)
    end = first + count * size
    _check_length(location, content, max(end, begin))
    if not count or begin < end:
        message = f"the MLG file is damaged: its head names {count} fields up to byte {end}, data from byte {begin}"
        raise InputError.of(location, message, _COPY_AGAIN)
    findings = Findings()
    fields = []
    for number in range(1, count + 1):
        at = content[first + (number - 1) * size :]
        field = _field(location.within(f"field {number}"), number, at[:size], content[end:begin], end, findings)
        if field is not None:
            fields.append(field)
    if findings.has_errors:
        raise InputError(list(findings)[:_MAX_FINDINGS])
    total = sum(np.dtype(field.type).itemsize for field in fields)
    if total != length:
        message = f"the MLG file is damaged: its records are of {length} bytes, their fields of {total}"
        raise InputError.of(location, message, _COPY_AGAIN)
    text = bytes(content[info : min(begin, info + _MAX_INFORMATION)]) if end <= info <= begin else b""
    return Head(version, created, tuple(fields), begin, plain_text(text))


def _check_length(location: Location, content: memoryview, needed: int) -> None:
    if len(content) < needed:
        message = f"the MLG file is damaged or cut off: it has {len(content)} bytes, its head alone needs {needed}"
        raise InputError.of(location, message, _COPY_AGAIN)


def _field(
    location: Location, number: int, field: memoryview, names: memoryview, begin: int, findings: Findings
) -> LogField | None:
    """Return a field; None, with an error, if it is damaged. `names` of bits lie between the fields and the data."""
    kind = field[0]
    category = plain_text(bytes(field[_CATEGORY]))
    if kind in _BIT_TYPES:
        _, name, unit, style, _, index, count = _BITS.unpack_from(field)
        width = 8 * np.dtype(_BIT_TYPES[kind]).itemsize
        # the index counts from the beginning of the file, or from that of the names
        bits = _bit_names(names[index - begin if index >= begin else index :], min(count, width))
        return LogField(plain_text(name), plain_text(unit), _BIT_TYPES[kind], style=style, category=category, bits=bits)
    if kind not in _TYPES:
        findings.error(location, f"unknown type {kind}", "Copy the file again from its source.")
        return None
    _, name, unit, style, scale, transform, digits = _NUMBER.unpack_from(field)
    if not (np.isfinite(scale) and np.isfinite(transform)):
        message = f"its scale {scale:g} and transform {transform:g} must be finite"
        findings.error(location, message, "Copy the file again from its source.")
        return None
    label = plain_text(name) or f"field {number}"
    numbers = _decimal(scale), _decimal(transform)
    return LogField(label, plain_text(unit), _TYPES[kind], *numbers, digits, style, category)


def _decimal(value: float) -> float:
    """Return the shortest number with these four bytes: 0.1 for 0.10000000149."""
    return float(str(np.float32(value)))


def _bit_names(region: memoryview, count: int) -> tuple[str, ...]:
    """Return the names of the bits, lowest first; empty ones where there are none."""
    names = bytes(region).split(b"\0", count)[:count]
    return tuple(plain_text(name) for name in names) + ("",) * (count - len(names))


def plain_text(text: bytes) -> str:
    """Return the text up to the first zero byte, in UTF-8 or the Windows encoding."""
    text = text.partition(b"\0")[0]
    try:
        return text.decode("utf-8").strip()
    except UnicodeDecodeError:
        return text.decode("cp1252", errors="replace").strip()


@dataclass(frozen=True)
class _LogSignal:
    """A channel: a field, or one bit of it."""

    field: LogField
    index: int  # of the field in the record
    bit: int | None = None

    @property
    def label(self) -> str:
        """The name in the file."""
        if self.bit is None:
            return self.field.name
        return self.field.bits[self.bit] or f"{self.field.name or f'field {self.index + 1}'} bit {self.bit}"


@dataclass(frozen=True)
class _LogBlocks:
    """The raw records and the markers between them."""

    records: NDArray[np.void]  # of the type of the head
    marks: tuple[tuple[int, str], ...]  # the record that follows, text
    mark_count: int
    rest: int  # bytes of a block that is cut off


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the one table of an MLG file.

    The field `Time` is the time if there is one: the stamps of the records, in 10 us, restart every 0.66 s and
    lose each longer pause. Records with a wrong checksum are left out, so is a last one that is cut off; the details
    of the table say so.
    """
    content = np.memmap(source.path, np.uint8, mode="r")
    head = read_head(source.location, memoryview(content))  # type: ignore[arg-type]
    signals = _signals(head)
    names = unique_names([signal.label for signal in signals])
    header = Header(0, 0, tuple(names), tuple(signal.field.unit for signal in signals))
    blocks = _read_blocks(source.location, content, head)
    if not blocks.records.size:
        raise InputError.of(source.location, "holds no records", "Is it the right file?")
    wanted = selection.wants(header)
    check_claimed(source, len(wanted) * blocks.records.size)
    if len(wanted) * blocks.records.size > _MAX_VALUES:
        message = f"{len(wanted)} channels of this file hold more than {_MAX_VALUES} values"
        raise InputError.of(source.location, message, "Name the channels to read.")
    columns = [_column(names[i], signals[i], blocks) for i in wanted]
    return [_table(source.location, head, header, columns, blocks)]


def _signals(head: Head) -> list[_LogSignal]:
    """Return every field of numbers; of a field of bits each bit, and the whole if it has a name."""
    signals = []
    for index, field in enumerate(head.fields):
        if field.name:
            signals.append(_LogSignal(field, index))
        signals += [_LogSignal(field, index, bit) for bit in range(len(field.bits))]
    return signals


def _read_blocks(location: Location, content: NDArray[np.uint8], head: Head) -> _LogBlocks:
    """Return the records, in runs between markers."""
    length = head.record.itemsize
    runs: list[NDArray[np.uint8]] = []
    marks: list[tuple[int, str]] = []
    at, count, mark_count = head.begin, 0, 0
    while at < content.size:
        kind = int(content[at])
        if kind == 0 and at + length <= content.size:
            run = _count_records(content, at, length)
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
            block = f"after {count} records, at byte {at}, there is a block of unknown type {kind}"
            raise InputError.of(location, f"the MLG file is damaged: {block}", _COPY_AGAIN)
    # a run is a view of the file; most files have only one
    whole = runs[0] if len(runs) == 1 else np.concatenate([content[:0], *runs])
    return _LogBlocks(whole.view(head.record), tuple(marks), mark_count, content.size - at)


def _count_records(content: NDArray[np.uint8], at: int, length: int) -> int:
    """Return the number of consecutive records from this byte, looking ahead in growing steps."""
    most = (content.size - at) // length
    count, step = 0, 64
    while count < most:
        types = content[at + count * length : at + min(count + step, most) * length : length]
        other = np.flatnonzero(types)
        if other.size:
            return count + int(other[0])
        count, step = count + types.size, 4 * step
    return most


def _column(name: str, signal: _LogSignal, blocks: _LogBlocks) -> Column:
    field = signal.field
    raw = blocks.records[str(signal.index)]
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
    digits = count_noun(field.digits, "digit") if field.digits > 0 else ""
    description = ", ".join(filter(None, (field.category, digits)))
    return Column(name, field.unit, name, values, held=held, description=description)


def _table(location: Location, head: Head, header: Header, columns: list[Column], blocks: _LogBlocks) -> Table:
    # a field in a unit of time that never changes is not the clock
    times = (k for k, c in enumerate(columns) if time_unit(c.name, c.unit) is not None and _varies(c.values))
    clock_index = next(times, None)
    stamped = clock_index is None
    names = header.names
    if clock_index is None:
        columns, clock_index = [_stamps(blocks), *columns], 0
        names = (columns[0].name, *names)
    time = time_in_seconds(columns[clock_index])
    moments = ((float(time[min(at, time.size - 1)]), text) for at, text in blocks.marks)
    marks = [(moment if np.isfinite(moment) else None, text) for moment, text in moments]
    intact = _intact(blocks.records)
    return Table(
        location,
        tuple(columns if intact.all() else (column.select(intact) for column in columns)),
        np.flatnonzero(intact) + 1,
        "record",
        names,
        details=(*_details(head), *describe_marks(marks, blocks.mark_count), *_losses(blocks, intact, stamped)),
        clock_index=clock_index,
        restarts=True,
    )


def _varies(values: Float) -> bool:
    known = values[np.isfinite(values)]
    return bool(known.size and np.any(known != known[0]))


def _stamps(blocks: _LogBlocks) -> Column:
    """Return the time by the stamps of the records, which count 10 us and restart after 65 536."""
    stamps: Int = blocks.records["stamp"].astype(np.int64)
    steps: Int = np.diff(stamps) % _STAMPS
    time: Float = np.concatenate([[0.0], np.cumsum(steps) * _TICK])
    return Column("time", "s", "time", time)


def _intact(records: NDArray[np.void]) -> Bool:
    """Return the records whose checksum is right; all if hardly any is, since some loggers write none."""
    # modulo 256, over all bytes between the stamp and the checksum itself
    contents = records.view(np.uint8).reshape(records.size, -1)
    good: Bool = contents[:, 4:-1].sum(axis=1, dtype=np.uint8) == records["sum"]
    return good if 2 * np.count_nonzero(good) > good.size else np.ones(good.size, dtype=bool)


def _details(head: Head) -> Iterator[tuple[str, str]]:
    yield "version", str(head.version)
    if head.created:
        yield "recorded", f"{datetime.fromtimestamp(head.created, UTC):%Y-%m-%d %H:%M} UTC"
    first = next((line.strip('" ') for line in head.information.splitlines() if line.strip('" ')), "")
    if first and not _TUNE.search(first):
        yield "by", " ".join(first.split())[:80]
    if _TUNE.search(head.information):
        yield "tune", "a whole TunerStudio tune (.msq) is inside"


def _losses(blocks: _LogBlocks, intact: Bool, stamped: bool) -> Iterator[tuple[str, str]]:
    """Yield the details on missing or doubtful records."""
    bad = int(np.count_nonzero(~intact))
    if stamped:
        yield "time", "from the stamps of the records, without pauses longer than 0.65 s"
    if bad:
        yield "left out", f"{count_noun(bad, 'record')} with a wrong checksum"
    if blocks.rest:
        yield "cut off", f"the last record lacks its end ({blocks.rest} bytes are there)"
