"""Reads CSV and its relatives: exactly, line by line, or all at once where the file is clean."""

import codecs
import io
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from kennfeld.errors import Finding, InputError
from kennfeld.measurement.cells import Decimal, number
from kennfeld.measurement.clean import read_clean
from kennfeld.measurement.columns import ColumnBuilder, Selection, Table, capped
from kennfeld.measurement.dialect import Dialect, find_dialect, is_comment, split
from kennfeld.measurement.doubts import with_doubts
from kennfeld.measurement.encoding import encoding_of
from kennfeld.measurement.marks import KEPT, is_mark, marks_detail
from kennfeld.measurement.sniff import Source
from kennfeld.measurement.timing import find_time, seconds

__all__ = ["dialect_of", "lines_of", "read_exactly", "read_tables"]

BULK = 8_000_000  # bytes; below it the import of pandas costs more than it saves
_HEAD_LINES = 200
_HEAD_TEXT = 4_000_000  # characters, beyond which fewer lines tell enough of a table of very many columns
_LEAST_LINES = 20
_LINE = 16_000_000  # characters; no line of a measurement is longer
_BLOCK = 4096  # rows


def read_tables(source: Source, selection: Selection) -> list[Table]:
    """The one table of a text file."""
    dialect = dialect_of(source)
    if source.size > BULK:
        from kennfeld.measurement.bulk import read_bulk

        table = read_bulk(source, dialect, selection)
        if table is not None:
            return [with_doubts(source, dialect, table)]
    table = read_clean(source, dialect, selection) or read_exactly(source, dialect, selection)
    return [with_doubts(source, dialect, table)]


def dialect_of(source: Source) -> Dialect:
    """How the file is written; `InputError` where it holds no table."""
    with source.open() as stream:
        start = stream.read(1 << 16)
        whole = len(start) < 1 << 16
    if not start:
        raise InputError.of(source.name, "the file is empty (0 bytes)", "Export the measurement anew.")
    encoding = encoding_of(start, whole)
    if whole and not start.startswith((codecs.BOM_UTF16_BE, codecs.BOM_UTF16_LE)):
        lines = io.StringIO(start.decode(encoding, "replace"), newline=None).read().split("\n")[:_HEAD_LINES]
    else:
        lines = [line for _, line in _limited(lines_of(source, encoding), _HEAD_LINES)]
    return find_dialect(source.name, lines, encoding)


def _limited(lines: Iterator[tuple[int, str]], count: int) -> Iterator[tuple[int, str]]:
    size = 0
    for number_, line in lines:
        if number_ > count or (number_ > _LEAST_LINES and size > _HEAD_TEXT):
            return
        size += len(line)
        yield number_, line


def lines_of(source: Source, encoding: str) -> Iterator[tuple[int, str]]:
    """Line number, counted from 1, and line, without its end."""
    with io.TextIOWrapper(source.open(), encoding, errors="replace", newline=None) as stream:
        count = 0
        while line := stream.readline(_LINE):
            count += 1
            if len(line) >= _LINE:
                raise InputError.of(f"{source.name} line {count}", "the line has no end", "Is it a text file at all?")
            yield count, line.removesuffix("\n")


@dataclass
class _Rows:
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
        if len(self.marks) < KEPT:
            self.marks.append((line, text.strip(' "')))

    def _fitted(self, line: int, cells: list[str]) -> list[str]:
        if len(cells) == self.limit:
            return cells
        if len(cells) < self.width or any(cell.strip() for cell in cells[self.limit :]):
            self.odd.append((line, len(cells)))
        return (cells + [""] * (self.limit - len(cells)))[: self.limit]


def read_exactly(source: Source, dialect: Dialect, selection: Selection) -> Table:
    """The table, read line by line."""
    table, flipped = _pass(source, dialect, selection)
    if flipped is None:
        return table
    # the first lines held whole numbers alone, so the decimal mark shows further down
    again, _ = _pass(source, replace(dialect, decimal=flipped, decimal_seen=True), selection)
    return again if _text_cells(again) < _text_cells(table) else table


def _text_cells(table: Table) -> int:
    return sum(column.text_count for column in table.columns)


def _pass(source: Source, dialect: Dialect, selection: Selection) -> tuple[Table, Decimal | None]:
    header = dialect.header
    builders = {i: ColumnBuilder(header.names[i], header.units[i], header.names[i]) for i in selection.wants(header)}
    rows = _Rows(header.width, len(header.names), builders, dialect.decimal)
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


def _marks(table: Table, rows: _Rows) -> tuple[tuple[str, str], ...]:
    clock = find_time(table)
    if clock is None:
        return marks_detail([(None, text) for _, text in rows.marks], rows.mark_count)
    time = seconds(clock)
    at = [min(int(np.searchsorted(table.rows, line)), time.size - 1) for line, _ in rows.marks]
    return marks_detail([(float(time[k]), text) for k, (_, text) in zip(at, rows.marks, strict=True)], rows.mark_count)


def _cells(source: Source, dialect: Dialect, rows: _Rows) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of each row of data."""
    separator, first = dialect.separator, dialect.header.data
    blank = separator + " \t"
    held, opened = "", 0  # a quoted cell may run over a few lines
    for at, line in lines_of(source, dialect.encoding):
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
            yield opened or at, split(line, separator)
        opened = 0
    if opened:
        yield opened, split(held, separator)


def _odd_rows(place: str, rows: _Rows) -> Iterator[Finding]:
    last = rows.numbers[-1] if rows.numbers else 0
    found = []
    for line, cells in rows.odd[:200]:
        what = f"the row has {cells} cell{'s' * (cells != 1)}, the header names {rows.width}"
        if line == last and cells < rows.width:
            mend = "The file seems to be cut off here: copy or export it anew, or remove this line."
        else:
            mend = "Give the row as many cells as the header."
        found.append(Finding(f"{place} line {line}", what, mend))
    yield from capped(found, place, "rows with too many or too few cells", max(len(rows.odd) - 200, 0))


def _other_decimal(table: Table, dialect: Dialect) -> Decimal | None:
    if dialect.decimal_seen or dialect.separator == ",":
        return None
    other: Decimal = "," if dialect.decimal == "." else "."
    cells = [cell for column in table.columns for _, cell in column.texts]
    return other if any(number(cell, other) is not None for cell in cells) else None
