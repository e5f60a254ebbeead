"""Reader of LVM files, the text measurements of LabVIEW.

A header of settings is followed by segments. Each has a header with units, the time of the first sample and the time
between samples of each channel, a line of names, and rows. There is one time column for all channels, one for each, or
none. Source: National Instruments, "Specification for the LabVIEW Measurement File (.lvm)".
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import Finding, InputError
from kennfeld.measurement.cells import Decimal, parse_number
from kennfeld.measurement.encoding import detect_encoding
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.table import Column, ColumnBuilder, Selection, Table, limit_findings, unique_names
from kennfeld.measurement.text import iterate_lines

_START = 1 << 16  # bytes
_END = "***end_of_header***"
_TIME, _COMMENT = "X_Value", "comment"

_Lines = Sequence[tuple[int, str]]  # number, line


@dataclass
class _Segment:
    """A head, names and rows; `settings` has an entry for each channel."""

    settings: dict[str, list[str]] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    line: int = 0  # of the names
    rows: list[tuple[int, list[str]]] = field(default_factory=list)  # number, cells

    def text(self, key: str, channel: int) -> str:
        """Return a setting of a channel; empty if the header has none."""
        found = [cell.strip() for cell in self.settings.get(key, [])]
        values = [cell for cell in found if cell] if self.names.count(_TIME) > 1 else found
        return values[channel] if channel < len(values) else ""


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the table of the file with all its time columns; a segment whose time falls starts a new piece."""
    with source.open() as stream:
        start = stream.read(_START)
    lines = list(iterate_lines(source, detect_encoding(start, len(start) < _START)))
    settings: dict[str, list[str]] = {}
    at = _head(lines, 0, settings, "\t,")
    separator = "," if _setting(settings, "separator").casefold() == "comma" else "\t"
    segments = _segments(lines, at, separator)
    if not segments:
        remedy = "The file seems to be cut off: export it again."
        raise InputError.of(source.name, "the LabVIEW file has no rows of numbers", remedy)
    findings = _odd(source.name, segments)
    columns = _columns(segments, _decimal(settings, segments, separator), _setting(settings, "x_columns"))
    rows = np.array([line for segment in segments for line, _ in segment.rows], dtype=np.int64)
    clock = columns[0] if columns and columns[0].name == _TIME else None
    names = tuple(column.name for column in columns)
    texts = [(key, _setting(settings, key)) for key in ("date", "operator")]
    details = tuple((key, text) for key, text in texts if text)
    wanted = tuple(c for c in columns if c.name == _TIME or selection.includes(c.name))
    return [Table(source.name, wanted, rows, "line", names, tuple(findings), details, clock, restarts=True)]


def _setting(settings: dict[str, list[str]], key: str) -> str:
    return next((value.strip() for value in settings.get(key, ())), "")


def _head(lines: _Lines, at: int, settings: dict[str, list[str]], separators: str) -> int:
    """Read the lines of a header; return the position after it."""
    for k in range(at, len(lines)):
        line = lines[k][1]
        if line.casefold().startswith(_END):
            return k + 1
        separator = next((s for s in separators if s in line), "\t")
        key, *values = line.split(separator)
        settings[key.strip().casefold()] = values
    return len(lines)


def _segments(lines: _Lines, at: int, separator: str) -> list[_Segment]:
    found = []
    while at < len(lines):
        segment = _Segment()
        while at < len(lines) and not lines[at][1].strip():
            at += 1
        if at < len(lines) and lines[at][1].startswith("LabVIEW Measurement"):
            at = _head(lines, at, {}, separator)  # of a recording that was appended
            continue
        if at < len(lines) and lines[at][1].split(separator)[0].strip().casefold() == "channels":
            at = _head(lines, at, segment.settings, separator)
        if at < len(lines):
            segment.line, names = lines[at]
            segment.names = [name.strip().strip('"') for name in names.split(separator)]
        at = _rows(lines, at + 1, segment, separator)
        if segment.rows:
            found.append(segment)
    return found


def _rows(lines: _Lines, at: int, segment: _Segment, separator: str) -> int:
    """Read rows up to the next header; return its position."""
    while at < len(lines) and not lines[at][1].startswith(("Channels", "LabVIEW Measurement")):
        if lines[at][1].strip():
            segment.rows.append((lines[at][0], lines[at][1].split(separator)))
        at += 1
    return at


def _decimal(settings: dict[str, list[str]], segments: Sequence[_Segment], separator: str) -> Decimal:
    """Return the decimal mark; old files do not tell it, but have one in the time between samples."""
    text = _setting(settings, "decimal_separator")
    shown = "".join("".join(segment.settings.get("delta_x", [])) for segment in segments)
    return "," if separator != "," and (text == "," or (not text and "," in shown)) else "."


def _odd(place: str, segments: Sequence[_Segment]) -> list[Finding]:
    """Report segments whose channels differ from the first one, and rows with more cells than names."""
    names = segments[0].names
    findings = []
    for segment in segments:
        if segment.names != names:
            message = f"this segment has other channels than the segment in line {segments[0].line}"
            findings.append(Finding(f"{place} line {segment.line}", message, "Split the file here."))
        for line, cells in segment.rows:
            if len(cells) > len(segment.names) and any(cell.strip() for cell in cells[len(segment.names) :]):
                message = f"the row has {len(cells)} cells, there are {len(segment.names)} names"
                findings.append(
                    Finding(f"{place} line {line}", message, "Give the row as many cells as there are names.")
                )
    return limit_findings(findings, place, "lines that do not fit")


def _columns(segments: Sequence[_Segment], decimal: Decimal, times: str) -> list[Column]:
    """Return all columns in the order of the file, each time before its channels."""
    first = segments[0]
    names = iter(
        unique_names([name for name in first.names if name not in (_TIME, "") and name.casefold() != _COMMENT])
    )
    result: list[Column] = []
    channel = 0
    for k, name in enumerate(first.names):
        if not name or name.casefold() == _COMMENT:
            continue
        if name == _TIME:
            if times.casefold() != "no" and _is_time(first, channel):
                result.append(_built(segments, k, _TIME, "s", decimal))
            continue
        if times.casefold() == "no" and _is_time(first, channel) and (not channel or not _alike(segments, channel)):
            result.append(Column(_TIME, "s", _TIME, _computed(segments, channel, decimal)))
        result.append(_built(segments, k, next(names), first.text("y_unit_label", channel), decimal))
        channel += 1
    return result


def _is_time(segment: _Segment, channel: int) -> bool:
    return segment.text("x_dimension", channel).casefold() in ("time", "")


def _alike(segments: Sequence[_Segment], channel: int) -> bool:
    """Return whether a channel is sampled at the times of the one before."""
    keys = ("samples", "x0", "delta_x", "date", "time")
    return all(segment.text(key, channel) == segment.text(key, channel - 1) for key in keys for segment in segments)


def _computed(segments: Sequence[_Segment], channel: int, decimal: Decimal) -> Float:
    """Return the time of a channel by its first one and the one between samples."""
    parts = []
    for segment in segments:
        begin, step = (parse_number(segment.text(key, channel), decimal) for key in ("x0", "delta_x"))
        count = parse_number(segment.text("samples", channel), decimal)
        time = (begin or 0.0) + np.arange(len(segment.rows)) * (1.0 if step is None or np.isnan(step) else step)
        if count is not None and 0 < count < time.size:
            time[int(count) :] = np.nan
        parts.append(time)
    return np.concatenate(parts)


def _built(segments: Sequence[_Segment], index: int, name: str, unit: str, decimal: Decimal) -> Column:
    builder = ColumnBuilder(name, unit, name)
    for segment in segments:
        builder.add([cells[index] if index < len(cells) else "" for _, cells in segment.rows], decimal)
    return builder.built()
