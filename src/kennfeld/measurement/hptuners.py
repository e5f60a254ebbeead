"""Reader of the CSV logs of HP Tuners' VCM Scanner.

Sections have names in brackets: [Channel Information] holds a row of numbers, one of names (which may contain commas
without quotes) and one of units, [Channel Data] the rows. A cell is empty if its channel was not sampled at that time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kennfeld.arrays import Bool
from kennfeld.errors import Finding, InputError
from kennfeld.measurement.cells import Decimal
from kennfeld.measurement.csv_dialect import split_line
from kennfeld.measurement.encoding import detect_encoding
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.header import Header
from kennfeld.measurement.table import Column, ColumnBuilder, Selection, Table, limit_findings, unique_names
from kennfeld.measurement.table_conversion import TableDescription, describe_table
from kennfeld.measurement.text import iterate_lines
from kennfeld.measurement.unit_text import plain_unit

_BLOCK = 4096  # rows
_HEAD = 1 << 16  # bytes


@dataclass
class _Log:
    """The sections of a log as they are read."""

    channels: list[tuple[int, str]] = field(default_factory=list)  # line number, line
    created: str = ""
    rows: list[tuple[int, str]] = field(default_factory=list)


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for the channels that were sampled together."""
    return _rasters(_whole(source, selection), selection)


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return one description of all rows; what a channel was not sampled at counts as missing there."""
    table = _whole(source, Selection())
    if table.findings:
        raise InputError(table.findings)
    return [describe_table(table)]


def _whole(source: MeasurementFile, selection: Selection) -> Table:
    """Return all rows, NaN if a channel was not sampled."""
    with source.open() as stream:
        start = stream.read(_HEAD)
    log = _sections(source, detect_encoding(start, len(start) < _HEAD))
    separator, header = _header(source.name, log.channels)
    wanted = [0, *(i for i in selection.wants(header) if i)]
    builders = [ColumnBuilder(header.names[i], header.units[i], header.names[i]) for i in wanted]
    decimal: Decimal = "." if separator == "," else ","
    odd: list[tuple[int, int]] = []
    for block in _blocks(log.rows):
        cells = [_fitted(line, split_line(text, separator), len(header.names), odd) for line, text in block]
        columns = list(zip(*cells, strict=True))
        for i, builder in zip(wanted, builders, strict=True):
            builder.add(columns[i], decimal)
    columns_ = tuple(builder.built() for builder in builders)
    return Table(
        source.name,
        columns_,
        np.array([line for line, _ in log.rows], dtype=np.int64),
        names=header.names,
        findings=tuple(_odd_rows(source.name, odd, len(header.names))),
        details=(("recorded", log.created),) if log.created else (),
        clock=columns_[0],
    )


def _sections(source: MeasurementFile, encoding: str) -> _Log:
    log, section = _Log(), ""
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
    for there, message in ((log.channels, "[Channel Information]"), (log.rows, "[Channel Data]")):
        if not there:
            remedy = "The file seems to be cut off: export it again."
            raise InputError.of(source.name, f"the HP Tuners log has no rows below {message}", remedy)
    return log


def _header(place: str, lines: Sequence[tuple[int, str]]) -> tuple[str, Header]:
    """Return separator and header from the lines of numbers, names and units."""
    if len(lines) < 2:
        raise InputError.of(f"{place} line {lines[0][0]}", "no row of names follows", "Export the log again.")
    separator = max(",;\t", key=lines[0][1].count)
    count = len(split_line(lines[0][1], separator))
    names = _joined(split_line(lines[1][1], separator), count)
    if len(names) > count:
        message = f"there are {len(names)} names for {count} channels: a name contains a comma"
        raise InputError.of(f"{place} line {lines[1][0]}", message, "Put that name into quotes.")
    units = split_line(lines[2][1], separator) if len(lines) > 2 else []
    named = unique_names([name.strip() for name in names] + [""] * (count - len(names)))
    named[0] = named[0] or "Offset"
    given = tuple(plain_unit(unit) for unit in (units + [""] * count)[:count])
    return separator, Header(0, 0, tuple(named), given)


def _joined(cells: list[str], count: int) -> list[str]:
    """Return the names, those with commas within brackets put together again where there are too many.

    >>> _joined(["Offset", "AEM (0", "1)", "Load"], 3)
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


def _blocks(rows: list[tuple[int, str]]) -> Iterator[list[tuple[int, str]]]:
    for begin in range(0, len(rows), _BLOCK):
        yield rows[begin : begin + _BLOCK]


def _fitted(line: int, cells: list[str], width: int, odd: list[tuple[int, int]]) -> list[str]:
    if len(cells) > width and any(cell.strip() for cell in cells[width:]):
        odd.append((line, len(cells)))
    return (cells + [""] * (width - len(cells)))[:width]


def _odd_rows(place: str, odd: Sequence[tuple[int, int]], width: int) -> list[Finding]:
    remedy = "Give the row as many cells as there are channels."
    findings = [
        Finding(f"{place} line {line}", f"the row has {cells} cells, the log {width} channels", remedy)
        for line, cells in odd[:200]
    ]
    return limit_findings(findings, place, "rows with too many cells", max(len(odd) - 200, 0))


def _rasters(table: Table, selection: Selection) -> list[Table]:
    """Return a table for the channels with the same pattern of samples; gaps before all have begun are none of it."""
    clock, *columns = table.columns
    known = {c.name: ~np.isnan(c.values) for c in columns}
    if clock.text_count or np.isnan(clock.values).any():
        return [table]  # whose rows the findings name
    sampled = [c for c in columns if not c.text_count and known[c.name].any()]
    begin = max((int(known[c.name].argmax()) for c in sampled), default=0)
    groups: dict[bytes, list[Column]] = {}
    for column in sampled:
        groups.setdefault(known[column.name][begin:].tobytes(), []).append(column)
    result = [_part(table, clock, own, np.any([known[c.name] for c in own], axis=0)) for own in groups.values()]
    # text is looked at where it is asked for, or stands among numbers
    texts = [c for c in columns if c.text_count and _matters(c, selection)]
    if texts or not result:
        result.append(_part(table, clock, texts, np.ones(table.rows.size, dtype=bool)))
    never = tuple(
        replace(c, values=c.values[: result[0].rows.size]) for c in columns if not (c.text_count or known[c.name].any())
    )
    result[0] = replace(result[0], columns=(*result[0].columns, *never))
    return [replace(part, findings=table.findings if k == 0 else ()) for k, part in enumerate(result)]


def _matters(column: Column, selection: Selection) -> bool:
    return not column.is_text if selection.channels is None else column.name in selection.channels


def _part(table: Table, clock: Column, columns: Sequence[Column], rows: Bool) -> Table:
    if rows.all():
        return replace(table, columns=(clock, *columns), names=table.names)
    cut = [replace(c, values=c.values[rows]) for c in (clock, *columns)]
    return replace(table, columns=tuple(cut), rows=table.rows[rows], clock=cut[0])
