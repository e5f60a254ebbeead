"""Reader of LVM files, the text measurements of LabVIEW.

A header of settings is followed by segments. Each has a header with units, the time of the first sample and the time
between samples of each channel, a line of names, and rows. There is one time column for all channels, one for each, or
none. Source: National Instruments, "Specification for the LabVIEW Measurement File (.lvm)".
"""

from collections.abc import Iterator, Sequence
from dataclasses import field

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.encoding import detect_encoding
from kennfeld.measurement.cells import Decimal, parse_number
from kennfeld.measurement.header import unique_names
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, ColumnBuilder, Selection, Table, limit_findings
from kennfeld.measurement.text import NumberedLine, iterate_lines

_START = 1 << 16  # bytes
_END = "***end_of_header***"
_TIME, _COMMENT = "X_Value", "comment"


@dataclass
class _Segment:
    """A head, names and rows; `settings` has an entry for each channel."""

    settings: dict[str, list[str]] = field(default_factory=dict)
    names: list[str] = field(default_factory=list)
    line: int = 0  # of the names
    rows: list[tuple[int, list[str]]] = field(default_factory=list)  # number, cells

    def setting(self, key: str, channel: int) -> str:
        """Return a setting of a channel; empty if the header has none."""
        values = [cell.strip() for cell in self.settings.get(key, [])]
        # with a time for each channel, the cells of the times are empty
        if self.names.count(_TIME) > 1:
            values = [cell for cell in values if cell]
        return values[channel] if channel < len(values) else ""

    def is_time(self, channel: int) -> bool:
        """Return whether the samples of a channel are points in time."""
        return self.setting("x_dimension", channel).casefold() in ("time", "")


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the table of the file with all its time columns; a segment whose time falls starts a new piece."""
    start = source.start(_START)
    lines = list(iterate_lines(source, detect_encoding(start, len(start) < _START)))
    settings: dict[str, list[str]] = {}
    # the separator is stated in the head itself, so both are tried
    at = _read_head(lines, 0, settings, "\t,")
    stated = {key: next((value.strip() for value in values), "") for key, values in settings.items()}
    separator = "," if stated.get("separator", "").casefold() == "comma" else "\t"
    segments = _read_segments(lines, at, separator)
    if not segments:
        remedy = "The file seems to be cut off: export it again."
        raise InputError.of(source.location, "the LabVIEW file has no rows of numbers", remedy)
    columns = _build_columns(segments, _decimal(stated, segments, separator), stated.get("x_columns", ""))
    wanted = tuple(c for c in columns if c.name == _TIME or selection.includes(c.name))
    return [
        Table(
            source.location,
            wanted,
            np.array([line for segment in segments for line, _ in segment.rows], dtype=np.int64),
            names=tuple(column.name for column in columns),
            findings=tuple(_odd_lines(source.name, segments)),
            details=tuple((key, stated[key]) for key in ("date", "operator") if stated.get(key)),
            clock_index=0 if columns and columns[0].name == _TIME else None,
            restarts=True,
        )
    ]


def _read_head(lines: Sequence[NumberedLine], at: int, settings: dict[str, list[str]], separators: str) -> int:
    """Read the lines of a header; return the position after it."""
    for k in range(at, len(lines)):
        line = lines[k][1]
        if line.casefold().startswith(_END):
            return k + 1
        separator = next((s for s in separators if s in line), "\t")
        key, *values = line.split(separator)
        settings[key.strip().casefold()] = values
    return len(lines)


def _read_segments(lines: Sequence[NumberedLine], at: int, separator: str) -> list[_Segment]:
    segments = []
    while at < len(lines):
        segment = _Segment()
        while at < len(lines) and not lines[at][1].strip():
            at += 1
        if at < len(lines) and lines[at][1].startswith("LabVIEW Measurement"):
            at = _read_head(lines, at, {}, separator)  # of a recording that was appended
            continue
        if at < len(lines) and lines[at][1].split(separator)[0].strip().casefold() == "channels":
            at = _read_head(lines, at, segment.settings, separator)
        if at < len(lines):
            segment.line, names = lines[at]
            segment.names = [name.strip().strip('"') for name in names.split(separator)]
        at += 1
        while at < len(lines) and not lines[at][1].startswith(("Channels", "LabVIEW Measurement")):
            if lines[at][1].strip():
                segment.rows.append((lines[at][0], lines[at][1].split(separator)))
            at += 1
        if segment.rows:
            segments.append(segment)
    return segments


def _decimal(stated: dict[str, str], segments: Sequence[_Segment], separator: str) -> Decimal:
    """Return the decimal mark; old files do not tell it, but have one in the time between samples."""
    text = stated.get("decimal_separator", "")
    shown = "".join("".join(segment.settings.get("delta_x", [])) for segment in segments)
    return "," if separator != "," and (text == "," or (not text and "," in shown)) else "."


def _odd_lines(file: str, segments: Sequence[_Segment]) -> list[Finding]:
    """Report segments whose channels differ from the first one, and rows with more cells than names."""

    def findings() -> Iterator[Finding]:
        for segment in segments:
            if segment.names != segments[0].names:
                message = f"this segment has other channels than the segment in line {segments[0].line}"
                yield Finding(Location(file, segment.line), message, "Split the file here.")
            width = len(segment.names)
            for line, cells in segment.rows:
                if any(cell.strip() for cell in cells[width:]):
                    message = f"the row has {len(cells)} cells, there are {width} names"
                    yield Finding(Location(file, line), message, "Give the row as many cells as there are names.")

    return limit_findings(list(findings()), lambda finding: finding, Location(file), "lines that do not fit")


def _build_columns(segments: Sequence[_Segment], decimal: Decimal, times: str) -> list[Column]:
    """Return all columns in the order of the file, each time before its channels."""
    first = segments[0]
    named = [k for k, name in enumerate(first.names) if name and name.casefold() != _COMMENT]
    unique = iter(unique_names([first.names[k] for k in named if first.names[k] != _TIME]))
    without_times = times.casefold() == "no"
    columns: list[Column] = []
    channel = 0
    for k in named:
        if first.names[k] == _TIME:
            if not without_times and first.is_time(channel):
                columns.append(_build_column(segments, k, _TIME, "s", decimal))
            continue
        if without_times and first.is_time(channel) and not _shares_times(segments, channel):
            columns.append(Column(_TIME, "s", _TIME, _compute_time(segments, channel, decimal)))
        columns.append(_build_column(segments, k, next(unique), first.setting("y_unit_label", channel), decimal))
        channel += 1
    return columns


def _shares_times(segments: Sequence[_Segment], channel: int) -> bool:
    """Return whether a channel is sampled at the times of the one before."""
    keys = ("samples", "x0", "delta_x", "date", "time")
    return channel > 0 and all(s.setting(key, channel) == s.setting(key, channel - 1) for key in keys for s in segments)


def _compute_time(segments: Sequence[_Segment], channel: int, decimal: Decimal) -> Float:
    """Return the time of a channel by its first one and the one between samples."""
    parts = []
    for segment in segments:
        begin, step = (parse_number(segment.setting(key, channel), decimal) for key in ("x0", "delta_x"))
        count = parse_number(segment.setting("samples", channel), decimal)
        time = (begin or 0.0) + np.arange(len(segment.rows)) * (1.0 if step is None or np.isnan(step) else step)
        # a channel with fewer samples than rows ends before them
        if count is not None and 0 < count < time.size:
            time[int(count) :] = np.nan
        parts.append(time)
    return np.concatenate(parts)


def _build_column(segments: Sequence[_Segment], index: int, name: str, unit: str, decimal: Decimal) -> Column:
    builder = ColumnBuilder(name, unit, name)
    for segment in segments:
        builder.add([cells[index] if index < len(cells) else "" for _, cells in segment.rows], decimal)
    return builder.build()
