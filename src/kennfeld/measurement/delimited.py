"""Rows of separated cells below a head that the caller understands: what readers of text formats share.

Formats of other packages use it as well; see `docs/adding-a-format.md`.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.files.encoding import detect_encoding
from kennfeld.measurement.cells import Decimal
from kennfeld.measurement.csv_dialect import split_line
from kennfeld.measurement.header import Header, unique_names
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import ColumnBuilder, Selection, Table
from kennfeld.measurement.text import RowCollector, iterate_lines, row_findings

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
        separator: between the cells; a blank stands for any number of blanks and tabs.
        decimal: "." or ",".

    Returns:
        The only table of the file, as `MeasurementReader.tables` returns it.

    Raises:
        InputError: there are no rows.
        ArgumentError: there are more or fewer units than names.
    """
    units = tuple(units) or ("",) * len(names)
    if len(units) != len(names):
        raise ArgumentError(f"units={list(units)} must be as many as the {len(names)} names")
    header = Header(0, skip, tuple(unique_names(names)), units)
    builders = {i: ColumnBuilder.of(header, i) for i in selection.wants(header)}
    collector = RowCollector(header.width, len(names), builders, decimal)
    for number, line in iterate_lines(source, _encoding(source)):
        if number > skip and line.strip():
            collector.add(number, split_line(line, separator))
    if not len(collector.lines):
        raise InputError.of(source.location, f"there are no rows below line {skip}", "Export the recording again.")
    table = collector.table(source.location)
    return [replace(table, names=header.names, findings=tuple(row_findings(source.name, collector)))]


def _encoding(source: MeasurementFile) -> str:
    start = source.start(_HEAD)
    return detect_encoding(start, len(start) < _HEAD)
