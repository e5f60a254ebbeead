"""Reader of delimited text: CSV and related files, and the MSL logs of TunerStudio and MegaTune.

There are three ways to read: `bulk_csv` for large files, `read_clean` for files that hold nothing but plain numbers, as
many in each row, and `read_exactly`, line by line, for everything else: it knows the line of each cell. Whatever a text
file leaves ambiguous is reported: its encoding, and points that may separate thousands.

An MSL log has quoted lines of information, tab-separated lines of names and units, rows, and markers among the rows.
After a restart of the ECU time may start again, and the lines of names and units may be repeated.
"""

import codecs
import io
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from kennfeld.errors import Finding, InputError
from kennfeld.measurement.cells import Decimal, parse_number
from kennfeld.measurement.csv_dialect import Dialect, find_dialect, is_comment, split_line
from kennfeld.measurement.encoding import GUESSED_ENCODINGS, detect_encoding
from kennfeld.measurement.file_kind import FileKind, MeasurementFile
from kennfeld.measurement.table import (
    MAX_MARKS,
    Column,
    ColumnBuilder,
    Selection,
    Table,
    describe_marks,
    is_mark,
    limit_findings,
)
from kennfeld.measurement.time_column import find_time, time_in_seconds

_MOST_CLEAN = 64_000_000  # bytes, unpacked; larger files are read row by row
_NUMBERS = b"0123456789+-.eE"

_START = 1 << 16  # characters that settle it in most files
_MOST = 64_000_000  # characters that are looked at
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}\.\d{3}")  # 1.100, which may be 1100
_POINTED = re.compile(r"[+-]?(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?")
_LEAST_GROUPED = 1000  # plain numbers from here on would have a separator, too

BULK = 8_000_000  # bytes; below it the import of pandas costs more than it saves
_HEAD_LINES = 200
_HEAD_TEXT = 4_000_000  # characters, beyond which fewer lines tell enough of a table of very many columns
_LEAST_LINES = 20
_LINE = 16_000_000  # characters; no line of a measurement is longer
_BLOCK = 4096  # rows


def read_clean(source: MeasurementFile, dialect: Dialect, selection: Selection) -> Table | None:
    """Return the table of a text file, or None if the exact reader has to look at it."""
    header = dialect.header
    width = len(header.names)
    if dialect.decimal != "." or dialect.separator == " " or header.width != width:
        return None
    with source.open() as stream:
        text = stream.read(_MOST_CLEAN + 1)
    text = text.replace(b"\r\n", b"\n")
    lines = text.split(b"\n", header.data)
    if len(text) > _MOST_CLEAN or b"\r" in text or len(lines) <= header.data:
        return None
    cells, separator = lines[-1].rstrip(b"\n"), dialect.separator.encode()
    count = cells.count(b"\n") + 1
    row = separator * (width - 1) + b"\n"
    if cells.translate(None, _NUMBERS) != (row * count)[:-1]:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy's word for what is no number
        try:
            values = np.fromstring(cells.replace(b"\n", b",").replace(separator, b",").decode("ascii"), sep=",")
        except (DeprecationWarning, ValueError):
            return None
    if values.size != count * width:
        return None
    table = values.reshape(count, width)
    result = tuple(
        Column(header.names[i], header.units[i], header.names[i], np.ascontiguousarray(table[:, i]))
        for i in selection.wants(header)
    )
    rows = np.arange(count) + header.data + 1
    return Table(source.name, result, rows, names=header.names, details=dialect.details)


def with_doubts(source: MeasurementFile, dialect: Dialect, table: Table) -> Table:
    """Return the table of a text file with a remark for each thing that the file leaves open."""
    remarks = [*_encoding(source, dialect), *_thousands(source, dialect, table)]
    return replace(table, remarks=(*table.remarks, *remarks)) if remarks else table


def _encoding(source: MeasurementFile, dialect: Dialect) -> Iterator[Finding]:
    if dialect.encoding in GUESSED_ENCODINGS:
        message = (
            f"is not UTF-8 and was read as {GUESSED_ENCODINGS[dialect.encoding]}, which most of its characters suggest"
        )
        yield Finding(source.name, message, "Save it as UTF-8 if names or units are wrong.", severity="remark")


@dataclass
class _Grouped:
    """The numbers of a column that may be grouped by thousands: the first one, its line, and how many there are."""

    text: str
    line: int
    count: int = 0


def _thousands(source: MeasurementFile, dialect: Dialect, table: Table) -> Iterator[Finding]:
    """Return a warning for each column that holds 1.100 beside 950 in a file that shows no other decimal point."""
    if dialect.separator in (",", " ") or dialect.decimal != ".":
        return
    grouped = _grouped(source, dialect)
    indices = {name: i for i, name in reversed(list(enumerate(table.names)))}
    for column in table.columns:
        cell = grouped.get(indices.get(column.name, -1))
        if cell is None or column.dated or column.is_text:
            continue
        values = np.abs(column.values[~np.isnan(column.values)])
        if values.size == cell.count or values.max() >= _LEAST_GROUPED:
            continue
        meant = cell.text.replace(".", "")
        message = f"{cell.text} is read as {float(cell.text):g}, but may mean {meant}: other cells have no point"
        remedy = f"If it means {meant}, export the file without thousands separators; if not, ignore this."
        yield Finding(f"{table.place} line {cell.line}, column {column.place}", message, remedy, severity="warning")


def _grouped(source: MeasurementFile, dialect: Dialect) -> dict[int, _Grouped]:
    """Return the possibly grouped numbers of each column; none if a cell certainly has a decimal point."""
    found: dict[int, _Grouped] | None = {}
    for size in (_START, _MOST):
        with io.TextIOWrapper(source.open(), dialect.encoding, errors="replace", newline=None) as stream:
            text = stream.read(size)
        found = _grouped_in(text, dialect)
        if found is None or len(text) < size:
            break
    return found or {}


def _grouped_in(text: str, dialect: Dialect) -> dict[int, _Grouped] | None:
    """Return the same of a text; None if it shows a decimal point."""
    found: dict[int, _Grouped] = {}
    for line_number, line in enumerate(text.split("\n"), 1):
        if line_number <= dialect.header.data or "." not in line:
            continue
        for i, raw in enumerate(line.split(dialect.separator)):
            cell = raw.strip(' "')
            if "." not in cell or not _POINTED.fullmatch(cell):
                continue
            if not _GROUPED.fullmatch(cell):
                return None
            found.setdefault(i, _Grouped(cell, line_number)).count += 1
    return found


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the single table of a text file."""
    if source.kind is FileKind.MSL:
        return _read_msl(source, selection)
    dialect = detect_dialect(source)
    if source.size > BULK:
        from kennfeld.measurement.bulk_csv import read_bulk

        table = read_bulk(source, dialect, selection)
        if table is not None:
            return [with_doubts(source, dialect, table)]
    table = read_clean(source, dialect, selection) or read_exactly(source, dialect, selection)
    return [with_doubts(source, dialect, table)]


def detect_dialect(source: MeasurementFile) -> Dialect:
    """Return the dialect of a file; raise `InputError` if it holds no table."""
    with source.open() as stream:
        start = stream.read(1 << 16)
        whole = len(start) < 1 << 16
    if not start:
        raise InputError.of(source.name, "the file is empty (0 bytes)", "Export the measurement again.")
    encoding = detect_encoding(start, whole)
    if whole and not start.startswith((codecs.BOM_UTF16_BE, codecs.BOM_UTF16_LE)):
        lines = io.StringIO(start.decode(encoding, "replace"), newline=None).read().split("\n")[:_HEAD_LINES]
    else:
        lines = [line for _, line in _limited(iterate_lines(source, encoding), _HEAD_LINES)]
    return find_dialect(source.name, lines, encoding)


def _limited(lines: Iterator[tuple[int, str]], count: int) -> Iterator[tuple[int, str]]:
    size = 0
    for number_, line in lines:
        if number_ > count or (number_ > _LEAST_LINES and size > _HEAD_TEXT):
            return
        size += len(line)
        yield number_, line


def iterate_lines(source: MeasurementFile, encoding: str) -> Iterator[tuple[int, str]]:
    """Yield line number, counted from 1, and line, without its end."""
    with io.TextIOWrapper(source.open(), encoding, errors="replace", newline=None) as stream:
        count = 0
        while line := stream.readline(_LINE):
            count += 1
            if len(line) >= _LINE:
                raise InputError.of(
                    f"{source.name} line {count}", "the line is too long", "Check that it is a text file."
                )
            yield count, line.removesuffix("\n")


@dataclass
class _TextRows:
    """The rows of a table as they are read."""

    width: int  # cells that a row must have
    limit: int  # cells beyond which a row must be empty
    builders: dict[int, ColumnBuilder]
    decimal: Decimal
    numbers: list[int] = field(default_factory=list)
    odd: list[tuple[int, int]] = field(default_factory=list)  # line, cells
    marks: list[tuple[int, str]] = field(default_factory=list)  # line, text
    mark_count: int = 0

    def add(self, block: list[tuple[int, list[str]]]) -> None:
        if not block:
            return
        rows = [self._fitted(line, cells) for line, cells in block]
        self.numbers += [line for line, _ in block]
        columns = list(zip(*rows, strict=True))
        for i, builder in self.builders.items():
            builder.add(columns[i], self.decimal)

    def mark(self, line: int, text: str) -> None:
        self.mark_count += 1
        if len(self.marks) < MAX_MARKS:
            self.marks.append((line, text.strip(' "')))

    def _fitted(self, line: int, cells: list[str]) -> list[str]:
        if len(cells) == self.limit:
            return cells
        if len(cells) < self.width or any(cell.strip() for cell in cells[self.limit :]):
            self.odd.append((line, len(cells)))
        return (cells + [""] * (self.limit - len(cells)))[: self.limit]


def read_exactly(source: MeasurementFile, dialect: Dialect, selection: Selection) -> Table:
    """Return the table, read line by line."""
    table, flipped = _pass(source, dialect, selection)
    if flipped is None:
        return table
    # the first lines held whole numbers alone, so the decimal mark shows further down
    again, _ = _pass(source, replace(dialect, decimal=flipped, decimal_seen=True), selection)
    return again if _text_cells(again) < _text_cells(table) else table


def _text_cells(table: Table) -> int:
    return sum(column.text_count for column in table.columns)


def _pass(source: MeasurementFile, dialect: Dialect, selection: Selection) -> tuple[Table, Decimal | None]:
    header = dialect.header
    builders = {i: ColumnBuilder(header.names[i], header.units[i], header.names[i]) for i in selection.wants(header)}
    rows = _TextRows(header.width, len(header.names), builders, dialect.decimal)
    block: list[tuple[int, list[str]]] = []
    for row in _cells(source, dialect, rows):
        block.append(row)
        if len(block) >= _BLOCK:
            rows.add(block)
            block = []
    rows.add(block)
    table = Table(
        source.name,
        tuple(builder.built() for builder in builders.values()),
        np.array(rows.numbers, dtype=np.int64),
        names=header.names,
        findings=tuple(_odd_rows(source.name, rows)),
        details=dialect.details,
    )
    if rows.mark_count:
        table = replace(table, details=(*dialect.details, *_marks(table, rows)))
    return table, _other_decimal(table, dialect)


def _marks(table: Table, rows: _TextRows) -> tuple[tuple[str, str], ...]:
    clock = find_time(table)
    if clock is None:
        return describe_marks([(None, text) for _, text in rows.marks], rows.mark_count)
    time = time_in_seconds(clock)
    at = [min(int(np.searchsorted(table.rows, line)), time.size - 1) for line, _ in rows.marks]
    return describe_marks(
        [(float(time[k]), text) for k, (_, text) in zip(at, rows.marks, strict=True)], rows.mark_count
    )


def _cells(source: MeasurementFile, dialect: Dialect, rows: _TextRows) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each row of data."""
    separator, first = dialect.separator, dialect.header.data
    blank = separator + " \t"
    held, opened = "", 0  # a quoted cell may run over a few lines
    for at, line in iterate_lines(source, dialect.encoding):
        if is_mark(line, separator):
            rows.mark(at, line)
            continue
        if at <= first:
            continue
        if opened:
            held, line = "", f"{held} {line}"
        if line.count('"') % 2 and at - (opened or at) < 20:
            held, opened = line, opened or at
            continue
        if line.strip(blank) and not is_comment(line) and line not in dialect.repeated:
            yield opened or at, split_line(line, separator)
        opened = 0
    if opened:
        yield opened, split_line(held, separator)


def _odd_rows(place: str, rows: _TextRows) -> Iterator[Finding]:
    last = rows.numbers[-1] if rows.numbers else 0
    findings = []
    for line, cells in rows.odd[:200]:
        message = f"the row has {cells} cell{'s' * (cells != 1)}, the header names {rows.width}"
        if line == last and cells < rows.width:
            remedy = "The file seems to be cut off here: copy or export it again, or remove this line."
        else:
            remedy = "Give the row as many cells as the header."
        findings.append(Finding(f"{place} line {line}", message, remedy))
    yield from limit_findings(findings, place, "rows with too many or too few cells", max(len(rows.odd) - 200, 0))


def _other_decimal(table: Table, dialect: Dialect) -> Decimal | None:
    if dialect.decimal_seen or dialect.separator == ",":
        return None
    other: Decimal = "," if dialect.decimal == "." else "."
    cells = [cell for column in table.columns for _, cell in column.texts]
    return other if any(parse_number(cell, other) is not None for cell in cells) else None


def _read_msl(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the table of a TunerStudio log; each restart of its time begins a new piece."""
    dialect = detect_dialect(source)
    above = []
    for _, line in zip(range(dialect.header.data), iterate_lines(source, dialect.encoding), strict=False):
        above.append(line[1])
    heads, names = above[: dialect.header.row], above[dialect.header.row :]
    repeated = frozenset(line for line in (*heads, *names) if line.strip())
    table = read_exactly(source, replace(dialect, repeated=repeated), selection)
    first = next((line.strip('" ') for line in heads if line.strip('" ')), "")
    by = (("by", " ".join(first.split())[:80]),) if first else ()
    return [with_doubts(source, dialect, replace(table, details=(*by, *table.details), restarts=True))]
