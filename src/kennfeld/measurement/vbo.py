"""Reader of VBO files, the text format of Racelogic's VBOX loggers.

Sections have names in brackets. [header] holds the full name of each column, [column names] one word for each, [channel
units] the units of the columns behind the standard ones, [data] the rows, separated by blanks. Time is the time of day,
HHMMSS.sss. Latitude and longitude are minutes of arc, west positive; they are read as degrees, east positive.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.errors import Finding, InputError
from kennfeld.files.encoding import detect_encoding
from kennfeld.measurement.cells import Decimal
from kennfeld.measurement.clock_numbers import seconds_of_clock
from kennfeld.measurement.csv_dialect import split_line
from kennfeld.measurement.header import Header, unique_names
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, ColumnBuilder, Selection, Table
from kennfeld.measurement.text import NumberedLine, RowCollector, iterate_lines, row_findings
from kennfeld.measurement.unit_text import plain_unit

_HEAD = 1 << 16  # bytes
_SECTION = re.compile(r"\s*\[([^\[\]]*)\]\s*")
_NAMES, _FULL_NAMES, _UNITS, _ROWS = "column names", "header", "channel units", "data"
# standard columns: how their names begin, and their unit if the name does not state it
_STANDARD = {
    "sats": "",
    "satellites": "",
    "time": "",
    "lat": "deg",
    "latitude": "deg",
    "long": "deg",
    "longitude": "deg",
    "velocity": "km/h",
    "heading": "deg",
    "height": "m",
    "vert-vel": "",
    "vertical velocity": "",
}
_SPEED = re.compile(r"((?:vertical )?velocity)[ _](km/?h|mph|knots|m/s|kt)", re.IGNORECASE)
_MINUTES = 60.0  # of a degree
_MOST_DEGREES = {"lat": 90.0, "long": 180.0}


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the single table of a file."""
    start = source.start(_HEAD)
    sections = _read_sections(source, detect_encoding(start, len(start) < _HEAD))
    header, findings = _header(source, sections)
    clock = next((i for i, name in enumerate(header.names) if name.casefold() == "time"), None)
    if clock is None:
        raise InputError.of(source.location, "the VBO file has no column time", "Export it again.")
    wanted = (clock, *(i for i in selection.wants(header) if i != clock))
    builders = {i: ColumnBuilder.of(header, i) for i in wanted}
    rows = sections[_ROWS]
    # a row has one decimal mark, and nothing else separates digits
    decimal: Decimal = "," if "," in rows[0][1] and "." not in rows[0][1] else "."
    collector = RowCollector(header.width, len(header.names), builders, decimal)
    for line, text in rows:
        collector.add(line, split_line(text, " "))
    table = collector.table(source.location)
    columns = [_convert(table, column, findings) for column in table.columns]
    table = replace(table, columns=tuple(columns), names=header.names, clock_index=0)
    created = sections.get("created", [])
    details = (("recorded", created[0][1]),) if created else ()
    return [replace(table, findings=(*findings, *row_findings(source.name, collector)), details=details)]


def _read_sections(source: MeasurementFile, encoding: str) -> dict[str, list[NumberedLine]]:
    """Return the lines of each section, without empty ones; raise `InputError` if names or rows are missing."""
    sections: dict[str, list[NumberedLine]] = {}
    section = ""
    for number, line in iterate_lines(source, encoding):
        match = _SECTION.fullmatch(line)
        if match:
            section = match[1].strip().casefold()
        elif line.strip():
            name = section
            if not section and line.casefold().startswith("file created on"):
                name, line = "created", line.strip()[len("file created on") :].strip()
            sections.setdefault(name, []).append((number, line))
    if not sections.get(_NAMES) and not sections.get(_FULL_NAMES):
        raise InputError.of(source.location, "the VBO file has no [column names] and no [header]", "Export it again.")
    if not sections.get(_ROWS):
        message = "the VBO file has no rows below [data]"
        raise InputError.of(source.location, message, "The file seems to be cut off: copy or export it again.")
    return sections


def _header(source: MeasurementFile, sections: Mapping[str, Sequence[NumberedLine]]) -> tuple[Header, list[Finding]]:
    """Return names and units of the columns, and remarks on sections that do not agree."""
    words = [word for _, line in sections.get(_NAMES, ()) for word in line.split()]
    full = [" ".join(line.split()) for _, line in sections.get(_FULL_NAMES, ())]
    findings: list[Finding] = []
    if words and full and len(words) != len(full):
        message = f"[header] has {len(full)} names, [column names] {len(words)}; the latter are used"
        findings.append(Finding(source.location, message, severity="remark"))
    names = full if len(full) == len(words) or not words else words
    units = _units(names)
    further = [i for i, name in enumerate(names) if _standard_name(name) is None]
    stated = [plain_unit(line.strip()) for _, line in sections.get(_UNITS, ())]
    if stated and len(stated) == len(further):
        units |= dict(zip(further, stated, strict=True))
    # the section may also have a line for each column
    elif stated and len(stated) == len(names):
        units |= {i: stated[i] for i in further}
    elif stated:
        message = f"[channel units] has {len(stated)} lines for {len(further)} channels; their units are left out"
        findings.append(Finding(source.location, message, "Check the units.", severity="warning"))
    short = [match[1] if (match := _SPEED.fullmatch(name)) else name for name in names]
    values = ["" if unit.casefold() == "null" else unit for unit in (units.get(i, "") for i in range(len(names)))]
    return Header(0, 0, tuple(unique_names(short)), tuple(values)), findings


def _standard_name(name: str) -> str | None:
    match = _SPEED.fullmatch(name)
    plain = (match[1] if match else name).casefold()
    return plain if plain in _STANDARD else None


def _units(names: Sequence[str]) -> dict[int, str]:
    """Return the units of the standard columns."""
    units = {}
    for i, name in enumerate(names):
        standard = _standard_name(name)
        if standard is not None:
            match = _SPEED.fullmatch(name)
            units[i] = match[2].replace("kmh", "km/h") if match else _STANDARD[standard]
    return units


def _convert(table: Table, column: Column, findings: list[Finding]) -> Column:
    """Return time in seconds and coordinates in degrees; other columns as they are."""
    name = column.name.casefold()
    if name == "time":
        values = seconds_of_clock(column.values)
        if values is None:
            raise InputError(_clock_errors(table, column))
        return replace(column, values=values, dated=True)
    axis = {"lat": "lat", "latitude": "lat", "long": "long", "longitude": "long"}.get(name)
    if axis is None:
        return column
    # + 0.0 makes 0.0 of the -0.0 of a longitude on the meridian
    degrees = column.values / (_MINUTES if axis == "lat" else -_MINUTES) + 0.0
    if np.any(np.abs(degrees) > _MOST_DEGREES[axis]):
        message = "the values are not minutes of arc and were not converted to degrees"
        location = table.location.within(f"column {column.place}")
        findings.append(Finding(location, message, "Check them.", severity="warning"))
        return replace(column, unit="")
    return replace(column, values=degrees)


def _clock_errors(table: Table, column: Column) -> Iterator[Finding]:
    for k, value in enumerate(column.values.tolist()):
        if seconds_of_clock(np.array([value])) is None:
            location = table.at(k, column)
            yield Finding(location, f"must be a time of day, HHMMSS.sss, got {value:.10g}", "Correct it.")
            return
