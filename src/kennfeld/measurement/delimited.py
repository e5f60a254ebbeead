"""Rows of separated cells below a head that the caller understands: what readers of text formats share.

Formats of other packages use it as well; see `docs/adding-a-format.md`.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

from kennfeld.base.errors import ArgumentError, Finding, InputError
from kennfeld.files.encoding import detect_encoding
from kennfeld.measurement.cells import Decimal
from kennfeld.measurement.csv_dialect import split_line
from kennfeld.measurement.header import Header, unique_names
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import ColumnBuilder, Selection, Table
from kennfeld.measurement.text import RowCollector, iterate_lines, row_findings
from kennfeld.measurement.unit_text import in_seconds, plain_unit

_HEAD = 1 << 16  # bytes that tell the encoding


def first_lines(source: MeasurementFile, count: int) -> list[str]:
    """Return the first lines of a text without their ends, `count` or as many as it has; compressed ones as well."""
    return [line for _, line in islice(iterate_lines(source, _encoding(source)), count)]


def read_delimited(
    source: MeasurementFile,
    selection: Selection,
    names: Sequence[str],
    units: Sequence[str] = (),
    *,
    skip: int,
    times: Sequence[str] = (),
    separator: str = " ",
    decimal: Decimal = ".",
) -> list[Table]:
    """Read rows of cells as the columns of a table.

    Empty cells, and words such as `NaN`, are missing values, times of day and dates are times. Rows with more or fewer
    cells than names are errors, all of which are reported with their lines, as is text among numbers.

    Args:
        source: the file.
        selection: the channels to read; others, apart from time, are skipped.
        names: the name of each column.
        units: the unit of each column; "" if it has none.
        skip: lines above the first row.
        times: the names of the time columns, each of which belongs to the channels after it; by default, they are
            found by their names as in [CSV files](formats.md#measurements). Their units are those of a time, or "".
        separator: between the cells; a blank stands for any number of blanks and tabs.
        decimal: "." or ",".

    Returns:
        The only table of the file, as `MeasurementReader.tables` returns it.

    Raises:
        InputError: there are no rows.
        ArgumentError: there are more or fewer units than names, or the names do not begin with one of the times.
    """
    units = tuple(units) or ("",) * len(names)
    if len(units) != len(names):
        raise ArgumentError(f"units={list(units)} must be as many as the {len(names)} names")
    header = Header(0, skip, tuple(unique_names(names)), units)
    clocks = _positions(header.names, times)
    builders = {i: ColumnBuilder.of(header, i) for i in sorted({*selection.wants(header), *clocks})}
    collector = RowCollector(header.width, len(names), builders, decimal)
    for number, line in iterate_lines(source, _encoding(source)):
        if number > skip and line.strip():
            collector.add(number, split_line(line, separator))
    if not len(collector.lines):
        raise InputError.of(source.location, f"there are no rows below line {skip}", "Export the recording again.")
    table = collector.table(source.location)
    findings = [*row_findings(source.name, collector), *_unit_findings(table.with_units(selection.units), times)]
    clock = 0 if times else None
    return [replace(table, names=header.names, findings=tuple(findings), clock_index=clock, clock_names=tuple(times))]


def _positions(names: Sequence[str], times: Sequence[str]) -> list[int]:
    """Return the positions of the time columns; raise `ArgumentError` if channels stand before the first one."""
    missing = [name for name in times if name not in names]
    if missing or (times and names[0] not in times):
        message = f"times={list(times)} must be names of columns, and the first column, {names[0]}, must be one of them"
        raise ArgumentError(message)
    return [names.index(name) for name in times]


def _unit_findings(table: Table, times: Sequence[str]) -> list[Finding]:
    """Report time columns with a unit that is none of a time."""
    return [
        Finding(
            table.location.within(f"column {column.place}"),
            f"{plain_unit(column.unit)!r} is not a unit of time",
            "Write s, ms, us, ns, min, h or d.",
        )
        for column in table.columns
        if column.name in times
        and not column.dated
        and plain_unit(column.unit) not in ("", "-")
        and in_seconds(column.unit) is None
    ]


def _encoding(source: MeasurementFile) -> str:
    start = source.start(_HEAD)
    return detect_encoding(start, len(start) < _HEAD)
