"""Reader of the CSV logs of Haltech's NSP and ESP software.

Lines `Channel : RPM`, `ID : 384`, `Type : EngineSpeed` and `DisplayMaxMin : 20000,0` describe each column. Rows begin
with the time of day. Cells are integers; their scale follows from the type and is not stated in the file, so only types
whose scale is established are converted. Pressures are absolute.
"""

import re
from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.encoding import detect_encoding
from kennfeld.measurement.header import Header, unique_names
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, ColumnBuilder, Selection, Table
from kennfeld.measurement.text import RowCollector, iterate_lines, row_findings

_HEAD = 1 << 16  # bytes
_ROW = re.compile(r"\s*\d{1,2}:\d\d:\d\d(?:\.\d+)?\s*(?:,|$)")
_NO_READING = 2.0**31 - 1000  # integers from here on stand for the reason why there is no value
# type: divisor of its integers, and the unit
_SCALES = {
    "Raw": (1.0, ""),
    "Gear": (1.0, ""),
    "EngineSpeed": (1.0, "rpm"),
    "Percentage": (10.0, "%"),
    "Pressure": (10.0, "kPa"),
    "AbsPressure": (10.0, "kPa"),
    "Temperature": (10.0, "K"),
    "Angle": (10.0, "deg"),
    "BatteryVoltage": (1000.0, "V"),
    "Time_us": (1.0, "us"),
    "Time_ms": (1.0, "ms"),
    "Time_ms_as_s": (1.0, "ms"),
    "Ratio": (1000.0, ""),
    "AFR": (1000.0, "lambda"),
    "Speed": (10.0, "km/h"),
    "AngularVelocity": (10.0, "deg/s"),
}


@dataclass
class _Preamble:
    """The channels as the lines above the rows describe them, and facts about the log."""

    names: list[str] = field(default_factory=list)
    types: list[str] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)

    def take(self, line: str) -> None:
        key, separator, value = (part.strip() for part in line.partition(":"))
        if not separator:
            return
        if key == "Channel":
            self.names.append(value)
            self.types.append("")
        elif key == "Type" and self.types:
            self.types[-1] = value
        elif not self.names or key.startswith("Log"):
            self.facts[key] = value


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the single table of a log."""
    start = source.start(_HEAD)
    preamble, header, collector = _Preamble(), None, None
    for number, line in iterate_lines(source, detect_encoding(start, len(start) < _HEAD)):
        if collector is None and _ROW.match(line):
            header = _header(source, preamble)
            builders = {i: ColumnBuilder.of(header, i) for i in (0, *(k for k in selection.wants(header) if k))}
            collector = RowCollector(header.width, len(header.names), builders, ".")
        if collector is None:
            preamble.take(line)
        elif line.strip(" ,"):
            collector.add(number, line.rstrip().split(","))
    if header is None or collector is None:
        message = "the Haltech log has no rows below its channels"
        raise InputError.of(source.location, message, "The file seems to be cut off: copy or export it again.")
    table = collector.table(source.location)
    types = dict(zip(header.names[1:], preamble.types, strict=True))
    columns = (table.columns[0], *(_scale(column, types[column.name]) for column in table.columns[1:]))
    findings = [*_unknown_scales(source, types, table.columns[1:]), *row_findings(source.name, collector)]
    details = tuple((key.casefold(), preamble.facts[key]) for key in ("Software", "Log") if preamble.facts.get(key))
    table = replace(table, columns=columns, names=header.names, findings=tuple(findings), details=details)
    return [replace(table, clock_index=0)]


def _header(source: MeasurementFile, preamble: _Preamble) -> Header:
    if not preamble.names:
        raise InputError.of(source.location, "the Haltech log describes no channels", "Export the log again.")
    units = [_SCALES.get(kind, (1.0, ""))[1] for kind in preamble.types]
    return Header(0, 0, tuple(unique_names(["Time", *preamble.names])), ("", *units))


def _scale(column: Column, kind: str) -> Column:
    """Return a channel in its unit, without the values that stand for none."""
    divisor, _ = _SCALES.get(kind, (1.0, ""))
    values = np.where(np.abs(column.values) >= _NO_READING, np.nan, column.values / divisor)
    return replace(column, values=values)


def _unknown_scales(source: MeasurementFile, types: dict[str, str], columns: Sequence[Column]) -> list[Finding]:
    """Warn about channels that are left as the integers of the file."""
    names = [c.name for c in columns if types[c.name] not in _SCALES]
    if not names:
        return []
    kinds = join_names(sorted({types[name] or "none" for name in names}), 6)
    message = f"{join_names(names, 4)}: the scale of type {kinds} is not known; the integers of the file are read"
    remedy = "Scale them with a calculated channel of the project."
    return [Finding(source.location, message, remedy, severity="warning")]
