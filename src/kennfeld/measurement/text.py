"""Reader of delimited text: CSV and related files, and the MSL logs of TunerStudio and MegaTune.

Large files are read by `bulk_csv` if all rows have the same number of cells. `read_exactly` reads all others line by
line, since it knows the line of each cell. Whatever a text file leaves ambiguous is reported: its encoding, and points
that may separate thousands.

An MSL log has quoted lines of information, tab-separated lines of names and units, rows, and markers among the rows.
After a restart of the ECU time may start again, and the lines of names and units may be repeated.
"""

import codecs
import io
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from itertools import islice

import numpy as np

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.encoding import GUESSED_ENCODINGS, detect_encoding
from kennfeld.files.recordings import MSL
from kennfeld.measurement.cells import Decimal, parse_number
from kennfeld.measurement.clock_numbers import decode_clock
from kennfeld.measurement.csv_dialect import Dialect, find_dialect, is_comment, split_line
from kennfeld.measurement.header import header_remarks
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import (
    BLOCK,
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

BULK = 4_000_000  # bytes of one or several files; below it compiling the parser costs more than it saves
_LEAST_BULK = 1 << 17  # bytes of a file

_START = 1 << 16  # bytes that settle the encoding and characters that settle the decimal mark in most files
_MOST = 64_000_000  # characters that are searched for grouped numbers
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}\.\d{3}")  # 1.100, which may be 1100
_POINTED = re.compile(r"[+-]?(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?")
_LEAST_DATE = 1e7  # numbers below it are clock times
_MARKS = {".": "point", ",": "comma"}
_LEAST_GROUPED = 1000  # plain numbers from here on would have a separator, too
_HEAD_LINES = 200
_HEAD_TEXT = 4_000_000  # characters, beyond which fewer lines tell enough of a table of very many columns
_LEAST_LINES = 20
_LINE = 16_000_000  # characters; no line of a measurement is longer
_MAX_CELL_LINES = 20  # lines of a quoted cell

NumberedLine = tuple[int, str]  # number of the line from 1 on, and its text


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the single table of a text file."""
    dialect = detect_dialect(source)
    if source.format is MSL:
        table = _read_msl(source, dialect, selection)
    else:
        table = _read_bulk(source, dialect, selection) or read_exactly(source, dialect, selection)
    decoded = tuple(map(decode_clock, table.columns))
    table = replace(table, columns=decoded, findings=(*table.findings, *_clock_findings(table, decoded)))
    table = replace(table, staggered=dialect.header.staggered)
    ambiguities = (
        *header_remarks(source.location, dialect.header),
        *_encoding_remark(table, dialect),
        *_thousands_warnings(source, dialect, table),
    )
    return [replace(table, findings=(*table.findings, *ambiguities))]


def list_columns(source: MeasurementFile) -> list[str]:
    """Return the names of the columns; raise `InputError` if the file holds no table."""
    return [name for name in detect_dialect(source).header.names if name]


def detect_dialect(source: MeasurementFile) -> Dialect:
    """Return the dialect of a file; raise `InputError` if it holds no table."""
    start = source.start(_START)
    whole = len(start) < _START
    if not start:
        raise InputError.of(source.location, "the file is empty (0 bytes)", "Export the measurement again.")
    encoding = detect_encoding(start, whole)
    if whole and not start.startswith((codecs.BOM_UTF16_BE, codecs.BOM_UTF16_LE)):
        # with the line ends that a file opened as text has
        lines = io.StringIO(start.decode(encoding, "replace"), newline=None).read().split("\n")[:_HEAD_LINES]
    else:
        lines = list(_head_lines(source, encoding))
    return find_dialect(source.location, tuple(lines), encoding)


def _head_lines(source: MeasurementFile, encoding: str) -> Iterator[str]:
    size = 0
    for number, line in islice(iterate_lines(source, encoding), _HEAD_LINES):
        if number > _LEAST_LINES and size > _HEAD_TEXT:
            return
        size += len(line)
        yield line


def iterate_lines(source: MeasurementFile, encoding: str) -> Iterator[NumberedLine]:
    """Yield line number, counted from 1, and line, without its end."""
    with io.TextIOWrapper(source.open(), encoding, errors="replace", newline=None) as stream:
        count = 0
        while line := stream.readline(_LINE):
            count += 1
            if len(line) >= _LINE:
                location = Location(source.name, count)
                raise InputError.of(location, "the line is too long", "Check that it is a text file.")
            yield count, line.removesuffix("\n")


def _read_msl(source: MeasurementFile, dialect: Dialect, selection: Selection) -> Table:
    """Return the table of a TunerStudio log; each restart of its time begins a new piece."""
    above = [line for _, line in islice(iterate_lines(source, dialect.encoding), dialect.header.data)]
    table = read_exactly(source, replace(dialect, repeated=frozenset(filter(str.strip, above))), selection)
    heads = [text for line in above[: dialect.header.row] if (text := line.strip('" '))]
    author = [("by", " ".join(heads[0].split())[:80])] if heads else []
    return replace(table, details=(*author, *table.details), restarts=True)


class _ExactReader:
    """Bytes that this process has read line by line."""

    seen = 0


def _read_bulk(source: MeasurementFile, dialect: Dialect, selection: Selection) -> Table | None:
    # several small files are worth the compilation together
    if source.size < _LEAST_BULK or source.size + _ExactReader.seen <= BULK:
        _ExactReader.seen += source.size
        return None
    from kennfeld.measurement.bulk_csv import read_bulk

    return read_bulk(source, dialect, selection)


def read_exactly(source: MeasurementFile, dialect: Dialect, selection: Selection) -> Table:
    """Return the table, read line by line."""
    table = _read_rows(source, dialect, selection)
    other = _other_numbers(table, dialect)
    if other is None:
        return table
    # the first lines held whole numbers alone, so the decimal mark shows further down
    again = _read_rows(source, other, selection)
    return min(table, again, key=lambda attempt: sum(column.text_count for column in attempt.columns))


def _other_numbers(table: Table, dialect: Dialect) -> Dialect | None:
    """Return the dialect with another form of numbers if the first lines leave it open and it makes one of a text."""
    # between commas, a number can only differ by quoted separators of thousands
    if dialect.separator == ",":
        other = replace(dialect, grouped=True)
    elif dialect.decimal_seen:
        return None
    else:
        mark: Decimal = "," if dialect.decimal == "." else "."
        other = replace(dialect, decimal=mark, decimal_seen=True)
    cells = [cell for column in table.columns for _, cell in column.texts]
    return other if any(parse_number(cell, other.numbers) is not None for cell in cells) else None


def _read_rows(source: MeasurementFile, dialect: Dialect, selection: Selection) -> Table:
    header = dialect.header
    builders = {i: ColumnBuilder.of(header, i) for i in selection.wants(header)}
    rows = RowCollector(header.width, len(header.names), builders, dialect.numbers)
    for line, cells in _split_rows(source, dialect, rows):
        rows.add(line, cells)
    table = rows.table(source.location)
    table = replace(table, names=header.names, findings=tuple(row_findings(source.name, rows)), details=dialect.details)
    return replace(table, details=(*dialect.details, *_marks(table, rows)))


@dataclass
class RowCollector:
    """The rows of a table as they are read."""

    width: int  # cells that a row must have
    limit: int  # cells beyond which a row must be empty
    builders: dict[int, ColumnBuilder]
    decimal: Decimal
    lines: "array[int]" = field(default_factory=lambda: array("q"))
    odd: list[tuple[int, int]] = field(default_factory=list)  # line, cells
    marks: list[NumberedLine] = field(default_factory=list)
    mark_count: int = 0
    _block: list[list[str]] = field(default_factory=list)

    def add(self, line: int, cells: list[str]) -> None:
        """Take a row; one of an unusual length is noted."""
        # nearly all rows end here
        if len(cells) != self.limit:
            if len(cells) < self.width or any(cell.strip() for cell in cells[self.limit :]):
                self.odd.append((line, len(cells)))
            cells = (cells + [""] * (self.limit - len(cells)))[: self.limit]
        self.lines.append(line)
        self._block.append(cells)
        if len(self._block) >= BLOCK:
            self._flush()

    def mark(self, line: int, text: str) -> None:
        """Take a marker between the rows."""
        self.mark_count += 1
        if len(self.marks) < MAX_MARKS:
            self.marks.append((line, text.strip(' "')))

    def table(self, location: Location) -> Table:
        """Return the table of all rows taken."""
        self._flush()
        columns = tuple(builder.build() for builder in self.builders.values())
        return Table(location, columns, np.array(self.lines, dtype=np.int64))

    def _flush(self) -> None:
        columns = list(zip(*self._block, strict=True))
        for i, builder in self.builders.items() if columns else ():
            builder.add(columns[i], self.decimal)
        self._block = []


def _split_rows(source: MeasurementFile, dialect: Dialect, rows: RowCollector) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each row of data; pass markers to `rows`."""
    separator = dialect.separator
    blank = separator + " \t"
    begun, first = "", 0  # a quoted cell may run over a few lines
    for number, line in iterate_lines(source, dialect.encoding):
        if is_mark(line, separator):
            rows.mark(number, line)
            continue
        if number <= dialect.header.data:
            continue
        if first:
            line = f"{begun} {line}"
        if line.count('"') % 2 and number - (first or number) < _MAX_CELL_LINES:
            begun, first = line, first or number
            continue
        if line.strip(blank) and not is_comment(line) and line not in dialect.repeated:
            yield first or number, split_line(line, separator)
        first = 0
    if first:
        yield first, split_line(begun, separator)


def row_findings(file: str, rows: RowCollector) -> list[Finding]:
    """Report the rows with too many or too few cells."""
    last = rows.lines[-1] if rows.lines else 0

    def report(row: tuple[int, int]) -> Finding:
        line, cells = row
        message = f"the row has {cells} cell{'s' * (cells != 1)}, the header names {rows.width}"
        if line == last and cells < rows.width:
            remedy = "The file seems to be cut off here: copy or export it again, or remove this line."
        else:
            remedy = "Give the row as many cells as the header."
        return Finding(Location(file, line), message, remedy)

    return limit_findings(rows.odd, report, Location(file), "rows with too many or too few cells")


def _marks(table: Table, rows: RowCollector) -> tuple[tuple[str, str], ...]:
    """Return the markers with the time of the row that follows each."""
    clock = find_time(table) if rows.marks else None
    if clock is None:
        return describe_marks([(None, text) for _, text in rows.marks], rows.mark_count)
    time = time_in_seconds(clock)
    following = np.minimum(np.searchsorted(table.rows, [line for line, _ in rows.marks]), time.size - 1)
    marks = [(float(time[k]), text) for k, (_, text) in zip(following, rows.marks, strict=True)]
    return describe_marks(marks, rows.mark_count)


def _clock_findings(table: Table, decoded: Sequence[Column]) -> Iterator[Finding]:
    """Report numbers that were read as clock times."""
    for before, column in zip(table.columns, decoded, strict=True):
        if before is not column:
            location = table.location.within(f"column {column.place}")
            has_dates = float(np.nanmax(before.values)) >= _LEAST_DATE
            form = "dates with times, YYYYMMDDHHMMSS" if has_dates else "clock times, HHMMSS"
            message = f"the numbers are {form}, and were read as such"
            yield Finding(location, message, "Rename the column if it is not a time.", severity="remark")


def _encoding_remark(table: Table, dialect: Dialect) -> Iterator[Finding]:
    if dialect.encoding in GUESSED_ENCODINGS:
        name = GUESSED_ENCODINGS[dialect.encoding]
        message = f"is not UTF-8 and was read as {name}, which most of its characters suggest"
        yield Finding(table.location, message, "Save it as UTF-8 if names or units are wrong.", severity="remark")


@dataclass
class _GroupedNumbers:
    """The numbers of a column that may be grouped by thousands: the first one, its line, and how many there are."""

    text: str
    line: int
    count: int = 0


def _thousands_warnings(source: MeasurementFile, dialect: Dialect, table: Table) -> Iterator[Finding]:
    """Yield a warning for each column that holds 1.100 beside 950 in a file that shows no other decimal point.

    Commas likewise; and for columns of quoted numbers such as "1,005", which are read as thousands.
    """
    if dialect.separator == " " or (dialect.separator == "," and not dialect.grouped):
        return
    grouped = _find_grouped(source, dialect)
    for column in table.columns:
        number = grouped.get(table.names.index(column.name))
        if number is None or column.dated or column.is_text:
            continue
        values = np.abs(column.values[~np.isnan(column.values)])
        # grouped: all numbers of the column are of this form; else, numbers from 1000 on without a mark are not grouped
        if dialect.grouped != (values.size == number.count) or (not dialect.grouped and values.max() >= _LEAST_GROUPED):
            continue
        mark = _mark(dialect)
        whole, fraction = number.text.replace(mark, ""), f"{float(number.text.replace(mark, '.')):g}"
        read, other = (whole, fraction) if dialect.grouped else (fraction, whole)
        reason = "no cell tells" if dialect.grouped else f"other cells have no {_MARKS[mark]}"
        message = f"{number.text} is read as {read}, but may mean {other}: {reason}"
        remedy = f"If it means {other}, export the file without thousands separators; if not, ignore this."
        location = table.location.within(f"line {number.line}, column {column.place}")
        yield Finding(location, message, remedy, severity="warning")


def _find_grouped(source: MeasurementFile, dialect: Dialect) -> dict[int, _GroupedNumbers]:
    """Return the possibly grouped numbers of each column; none if a cell certainly has a decimal point."""
    grouped: dict[int, _GroupedNumbers] = {}
    mark, searched = _mark(dialect), 0
    for number, line in iterate_lines(source, dialect.encoding):
        searched += len(line)
        if searched > _MOST:
            break
        if number <= dialect.header.data or not (mark in line or (dialect.grouped and "." in line)):
            continue
        for i, raw in enumerate(split_line(line, dialect.separator)):
            cell = raw.strip(' "')
            # a number such as 1,200.5 shows which mark is which
            if dialect.grouped and "." in cell and _POINTED.fullmatch(cell.replace(mark, "")):
                return {}
            pointed = cell.replace(mark, ".")
            if mark not in cell or not _POINTED.fullmatch(pointed):
                continue
            if not _GROUPED.fullmatch(pointed):
                return {}
            grouped.setdefault(i, _GroupedNumbers(cell, number)).count += 1
    return grouped


def _mark(dialect: Dialect) -> str:
    """Return the mark that is a decimal one or separates thousands."""
    return "," if dialect.grouped else dialect.decimal
