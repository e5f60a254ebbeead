"""Reader of the CSV logs of HP Tuners' VCM Scanner.

Sections have names in brackets: [Channel Information] holds a row of numbers, one of names (which may contain commas
without quotes) and one of units, [Channel Data] the rows. A cell is empty if its channel was not sampled at that time.
"""

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from kennfeld.base.arrays import Bool
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.encoding import detect_encoding
from kennfeld.measurement.csv_dialect import split_line
from kennfeld.measurement.header import Header, unique_names
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, ColumnBuilder, Selection, Table, limit_findings
from kennfeld.measurement.table_conversion import TableDescription, describe_table
from kennfeld.measurement.text import NumberedLine, RowCollector, iterate_lines
from kennfeld.measurement.unit_text import plain_unit

_HEAD = 1 << 16  # bytes


@dataclass
class _LogSections:
    """The sections of a log as they are read."""

    channels: list[NumberedLine] = field(default_factory=list)
    created: str = ""
    rows: list[NumberedLine] = field(default_factory=list)


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for the channels that were sampled together."""
    return _split_rasters(_read_whole(source, selection), selection)


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return one description of all rows; what a channel was not sampled at counts as missing there."""
    table = _read_whole(source, Selection())
    if table.findings:
        raise InputError(table.findings)
    return [describe_table(table)]


def _read_whole(source: MeasurementFile, selection: Selection) -> Table:
    """Return all rows, NaN if a channel was not sampled."""
    start = source.start(_HEAD)
    log = _read_sections(source, detect_encoding(start, len(start) < _HEAD))
    separator, header = _header(source.name, log.channels)
    builders = {i: ColumnBuilder.of(header, i) for i in (0, *(i for i in selection.wants(header) if i))}
    width = len(header.names)
    rows = RowCollector(0, width, builders, "." if separator == "," else ",")
    for line, text in log.rows:
        rows.add(line, split_line(text, separator))

    def report(row: tuple[int, int]) -> Finding:
        message = f"the row has {row[1]} cells, the log {width} channels"
        return Finding(Location(source.name, row[0]), message, "Give the row as many cells as there are channels.")

    return replace(
        rows.table(source.location),
        names=header.names,
        findings=tuple(limit_findings(rows.odd, report, source.location, "rows with too many cells")),
        details=(("recorded", log.created),) if log.created else (),
        clock_index=0,
    )


def _read_sections(source: MeasurementFile, encoding: str) -> _LogSections:
    log, section = _LogSections(), ""
    for number, line in iterate_lines(source, encoding):
        bare = line.strip().rstrip(",;\t")
        if bare.startswith("[") and bare.endswith("]"):
            section = bare.casefold()
        elif not bare:
            continue
        elif section == "[channel data]":
            log.rows.append((number, line))
        elif section == "[channel information]":
            log.channels.append((number, line))
        elif bare.startswith("Creation Time:"):
            log.created = bare.partition(":")[2].strip()
    for lines, name in ((log.channels, "[Channel Information]"), (log.rows, "[Channel Data]")):
        if not lines:
            remedy = "The file seems to be cut off: export it again."
            raise InputError.of(source.location, f"the HP Tuners log has no rows below {name}", remedy)
    return log


def _header(file: str, lines: Sequence[NumberedLine]) -> tuple[str, Header]:
    """Return separator and header from the lines of numbers, names and units."""
    if len(lines) < 2:
        raise InputError.of(Location(file, lines[0][0]), "no row of names follows", "Export the log again.")
    # the row of numbers holds no texts, so its most frequent mark is the separator
    separator = max(",;\t", key=lines[0][1].count)
    count = len(split_line(lines[0][1], separator))
    names = _join_names(split_line(lines[1][1], separator), count)
    if len(names) > count:
        message = f"there are {len(names)} names for {count} channels: a name contains a comma"
        raise InputError.of(Location(file, lines[1][0]), message, "Put that name into quotes.")
    units = split_line(lines[2][1], separator) if len(lines) > 2 else []
    unique = unique_names([name.strip() for name in names] + [""] * (count - len(names)))
    unique[0] = unique[0] or "Offset"
    return separator, Header(0, 0, tuple(unique), tuple(plain_unit(unit) for unit in (units + [""] * count)[:count]))


def _join_names(cells: list[str], count: int) -> list[str]:
    """Return the names, those with commas within brackets put together again where there are too many.

    >>> _join_names(["Offset", "AEM (0", "1)", "Load"], 3)
    ['Offset', 'AEM (0,1)', 'Load']
    """
    joined: list[str] = []
    excess, depth = len(cells) - count, 0
    for cell in cells:
        if depth > 0 and excess > 0:
            joined[-1] += "," + cell
            excess -= 1
        else:
            joined.append(cell)
            depth = 0
        depth += sum(map(cell.count, "([{")) - sum(map(cell.count, ")]}"))
    return joined


def _split_rasters(table: Table, selection: Selection) -> list[Table]:
    """Return a table for the channels with the same pattern of samples; gaps before all have begun are none of it."""
    clock, *columns = table.columns
    known = {c.name: ~np.isnan(c.values) for c in columns}
    if clock.text_count or np.isnan(clock.values).any():
        return [table]  # whose rows the findings name
    sampled = [c for c in columns if not c.text_count and known[c.name].any()]
    begin = max((int(known[c.name].argmax()) for c in sampled), default=0)
    groups: dict[bytes, list[Column]] = {}
    for column in sampled:
        # the pattern of the samples, one byte a row
        groups.setdefault(known[column.name][begin:].tobytes(), []).append(column)
    parts = [_part(table, clock, own, np.any([known[c.name] for c in own], axis=0)) for own in groups.values()]
    # text is looked at where it is asked for, or stands among numbers
    texts = [c for c in columns if c.text_count]
    if selection.channels is None:
        texts = [c for c in texts if not c.is_text]
    else:
        texts = [c for c in texts if selection.includes(c.name)]
    if texts or not parts:
        parts.append(_part(table, clock, texts, np.ones(table.rows.size, dtype=bool)))
    size = parts[0].rows.size
    # as many gaps as the table has rows that takes them
    never = [replace(c, values=c.values[:size]) for c in columns if not (c.text_count or known[c.name].any())]
    parts[0] = replace(parts[0], columns=(*parts[0].columns, *never))
    return [parts[0], *(replace(part, findings=()) for part in parts[1:])]


def _part(table: Table, clock: Column, columns: Sequence[Column], rows: Bool) -> Table:
    selected = tuple(replace(c, values=c.values[rows]) for c in (clock, *columns))
    return replace(table, columns=selected, rows=table.rows[rows])
