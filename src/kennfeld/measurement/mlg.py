"""Reads MLG files, the binary logs of TunerStudio, MegaLogViewer and rusEFI, versions 1 and 2."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from kennfeld.arrays import Bool, Float, Int
from kennfeld.errors import InputError
from kennfeld.measurement.columns import Column, Selection, Table
from kennfeld.measurement.header import Header
from kennfeld.measurement.marks import KEPT, marks_detail
from kennfeld.measurement.mlg_head import Field, Head, plain_text, read_head
from kennfeld.measurement.naming import distinct
from kennfeld.measurement.sniff import Source
from kennfeld.measurement.timing import seconds
from kennfeld.measurement.units import time_unit

__all__ = ["read_tables"]

_MARKER = 54  # bytes of a marker: type, counter, stamp, 50 bytes of text
_TICK = 1e-5  # s, of the time stamp of a record
_STAMPS = 1 << 16
_MOST = 500_000_000  # values of all channels asked for, 4 GB
_TUNE = re.compile(r"NEW_INFO_PROVIDER,\w*TUNE|<msq\b")
_SWITCHES = range(4, 9)  # styles shown as a pair of words: on/off, yes/no, high/low, active/inactive, true/false


@dataclass(frozen=True)
class _Signal:
    """A channel: a field, or one bit of it."""

    field: Field
    place: int  # of the field in the record
    bit: int | None = None

    @property
    def label(self) -> str:
        """What the file calls it."""
        if self.bit is None:
            return self.field.name
        return self.field.bits[self.bit] or f"{self.field.name or f'field {self.place + 1}'} bit {self.bit}"


@dataclass(frozen=True)
class _Blocks:
    """The records as they lie in the file, and what stands between them."""

    records: NDArray[np.void]  # of the type of the head
    marks: tuple[tuple[int, str], ...]  # the record that follows, text
    mark_count: int
    rest: int  # bytes of a block that is cut off


def read_tables(source: Source, selection: Selection) -> list[Table]:
    """The one table of an MLG file.

    The field `Time` is the time where there is one: the stamps of the records, in 10 us, start anew every 0.66 s and
    lose each longer pause. Records with a wrong checksum are left out, so is a last one that is cut off; the details
    of the table say so.
    """
    content = np.memmap(source.path, np.uint8, mode="r")
    head = read_head(source.name, memoryview(content))  # type: ignore[arg-type]
    signals = _signals(head)
    names = distinct([signal.label for signal in signals])
    header = Header(0, 0, tuple(names), tuple(signal.field.unit for signal in signals))
    blocks = _blocks(source.name, content, head)
    wanted = selection.wants(header)
    _check_size(source.name, blocks, len(wanted))
    columns = [_column(names[i], signals[i], blocks) for i in wanted]
    return [_table(source.name, head, header, columns, blocks)]


def _check_size(place: str, blocks: _Blocks, channels: int) -> None:
    if not blocks.records.size:
        raise InputError.of(place, "holds no records", "Is it the right file?")
    if channels * blocks.records.size > _MOST:
        what = f"{channels} channels of this file are more than {_MOST} values"
        raise InputError.of(place, what, "Name the channels to read.")


def _signals(head: Head) -> list[_Signal]:
    """Every field of numbers; of a field of bits each bit, and the whole where it has a name."""
    found = []
    for place, field in enumerate(head.fields):
        if field.name:
            found.append(_Signal(field, place))
        found += [_Signal(field, place, bit) for bit in range(len(field.bits))]
    return found


def _blocks(place: str, content: NDArray[np.uint8], head: Head) -> _Blocks:
    """The records, in runs between markers."""
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
            if len(marks) < KEPT:
                marks.append((count, plain_text(content[at + 4 : at + _MARKER].tobytes())))
            at += _MARKER
        elif kind in (0, 1):
            break
        else:
            what = (
                f"the MLG file is damaged: after {count} records, at byte {at}, stands a block of unknown type {kind}"
            )
            raise InputError.of(place, what, "Copy it anew from its source.")
    whole = runs[0] if len(runs) == 1 else np.concatenate(runs) if runs else content[:0]
    return _Blocks(whole.view(head.record), tuple(marks), mark_count, content.size - at)


def _run(content: NDArray[np.uint8], at: int, length: int) -> int:
    """How many records follow each other from this byte on; looks ahead in growing steps."""
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


def _said(field: Field) -> str:
    digits = f"{field.digits} digit{'s' * (field.digits > 1)}" if field.digits > 0 else ""
    return ", ".join(part for part in (field.category, digits) if part)


def _table(place: str, head: Head, header: Header, columns: Sequence[Column], blocks: _Blocks) -> Table:
    named = next((c for c in columns if time_unit(c.name, c.unit) is not None and _varies(c.values)), None)
    clock = named or _stamps(blocks)
    time = seconds(clock)
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
        details=(*_details(head), *marks_detail(marks, blocks.mark_count), *_losses(blocks, good, named is None)),
        restarts=True,
        clock=kept[0 if named is None else next(i for i, c in enumerate(columns) if c is named)],
    )


def _varies(values: Float) -> bool:
    known = values[np.isfinite(values)]
    return bool(known.size and np.any(known != known[0]))


def _stamps(blocks: _Blocks) -> Column:
    """The time by the stamps of the records, which count 10 us and start anew after 65 536."""
    stamps: Int = blocks.records["stamp"].astype(np.int64)
    steps: Int = np.diff(stamps) % _STAMPS
    time: Float = np.concatenate([[0.0], np.cumsum(steps) * _TICK])
    return Column("time", "s", "time", time)


def _intact(records: NDArray[np.void]) -> Bool:
    """Which records fit their checksum; all, where hardly any does and the logger seems to write none."""
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
    """What is missing from the table or may be wrong in it."""
    found = []
    bad = int(np.count_nonzero(~good))
    if stamped:
        found.append(("time", "from the stamps of the records, without pauses longer than 0.65 s"))
    if bad:
        found.append(("left out", f"{bad} record{'s' * (bad > 1)} with a wrong checksum"))
    if blocks.rest:
        found.append(("cut off", f"the last record lacks its end ({blocks.rest} bytes are there)"))
    return tuple(found)
