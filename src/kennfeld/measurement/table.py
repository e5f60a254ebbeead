"""Tables as the readers return them: named columns of numbers, with the location of each sample in the file.

All readers share the treatment of duplicate names, of text among numbers, of infinite values (no sensor measures them,
so they become NaN), and of the markers that a driver or the logger set while recording.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.errors import Finding
from kennfeld.formatting import join_names
from kennfeld.measurement.cells import Decimal, is_dated, is_stamp, parse_numbers, parse_stamps, quote_cell
from kennfeld.measurement.header import Header
from kennfeld.measurement.unit_text import may_be_time

MAX_MARKS = 12  # markers that a description quotes
_MAX_QUOTED = 50  # cells per column that messages may quote
_MAX_FINDINGS = 20  # findings of one kind per file
_MARK = re.compile(r'\s*"?MARK\s+\d+\b')


def unique_names(names: Sequence[str]) -> list[str]:
    """Return unique names: the second `Speed` becomes `Speed (2)`; empty ones stay empty.

    >>> unique_names(["Speed", "Torque", "Speed", "", ""])
    ['Speed', 'Torque', 'Speed (2)', '', '']
    """
    taken = set(names)
    seen: set[str] = set()
    last: dict[str, int] = {}
    unique = []
    for name in names:
        free, k = name, last.get(name, 1)
        while name and (free in seen or (free != name and free in taken)):
            k += 1
            free = f"{name} ({k})"
        last[name] = k
        seen.add(free)
        unique.append(free)
    return unique


@dataclass(frozen=True)
class Selection:
    """The requested channels, None for all, and the `units` that the caller states for columns."""

    channels: tuple[str, ...] | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    def wants(self, header: Header) -> list[int]:
        """Return the columns to read: the requested channels and whatever may be time."""
        named = [i for i, name in enumerate(header.names) if name]
        if self.channels is None:
            return named
        requested = set(self.channels)
        units = [self.units.get(name, unit) for name, unit in zip(header.names, header.units, strict=True)]
        return [i for i in named if header.names[i] in requested or may_be_time(header.names[i], units[i])]

    def includes(self, name: str) -> bool:
        """Return whether this channel belongs in the dataset."""
        return self.channels is None or name in self.channels


@dataclass(frozen=True, eq=False)
class Column:
    """One column: its numbers, NaN if a cell is empty, and the text cells it holds (sample, cell)."""

    name: str
    unit: str
    place: str  # as messages name it: `Torque`, or `C (Torque)` in a spreadsheet
    values: Float  # Float[samples]
    texts: tuple[tuple[int, object], ...] = ()
    text_count: int = 0
    dated: bool = False
    held: bool = False  # a value is valid until the next sample, so that nothing is interpolated
    description: str = ""

    def kept(self, rows: Bool) -> "Column":
        """Return the column with these samples alone."""
        place = np.cumsum(rows) - 1
        texts = tuple((int(place[sample]), cell) for sample, cell in self.texts if rows[sample])
        count = self.text_count - (len(self.texts) - len(texts))
        return replace(self, values=self.values[rows], texts=texts, text_count=count)

    @property
    def is_text(self) -> bool:
        """True if the column holds more text than numbers, so that it is not a channel."""
        return self.text_count > 0 and self.text_count >= int(np.count_nonzero(~np.isnan(self.values)))


@dataclass(frozen=True)
class Table:
    """Columns of one file or sheet; `rows` holds the line (or row) number of each sample, counted from 1."""

    place: str
    columns: tuple[Column, ...]
    rows: Int  # Int[samples]
    row_word: str = "line"
    names: tuple[str, ...] = ()  # of all columns, those not read included
    findings: tuple[Finding, ...] = ()
    details: tuple[tuple[str, str], ...] = field(default=())
    clock: Column | None = None  # the time column if the format itself defines it
    remarks: tuple[Finding, ...] = ()  # warnings and remarks, which leave the table usable
    restarts: bool = False  # time that falls begins a new piece, as in a log that continues after a restart

    def with_units(self, units: Mapping[str, str]) -> "Table":
        """Return the table with the units that the caller states for columns; dates stay what they are."""

        def stated(column: Column) -> Column:
            unit = units.get(column.name)
            return column if unit is None or column.dated else replace(column, unit=unit)

        clock = None if self.clock is None else stated(self.clock)
        columns = tuple(clock if c is self.clock and clock is not None else stated(c) for c in self.columns)
        return replace(self, columns=columns, clock=clock)

    def at(self, sample: int, *columns: Column) -> str:
        """Return the location of a cell: `bench.csv line 17, column Torque`."""
        place = f"{self.place} {self.row_word} {self.rows[sample]}"
        if not columns:
            return place
        word = "column" if len(columns) == 1 else "columns"
        return f"{place}, {word} {join_names([column.place for column in columns], 3)}"


class ColumnBuilder:
    """Collects a column block by block."""

    def __init__(self, name: str, unit: str, place: str) -> None:
        self.name, self.unit, self.place = name, unit, place
        self._blocks: list[Float] = []
        self._texts: list[tuple[int, object]] = []
        self._text_count = 0
        self._samples = 0
        self._dated = False
        self._origin: int | None = None  # the day that stamps in text count from

    def add(self, cells: Sequence[object], decimal: Decimal = ".") -> None:
        """Take the next cells."""
        values, texts = parse_numbers(cells, decimal)
        if texts and (self._dated or not self._blocks) and is_stamp(cells[texts[0]]):
            parsed = parse_stamps(cells, self._origin)
            if parsed is not None:
                (values, self._origin), texts, self._dated = parsed, [], True
        self._blocks.append(values)
        self._texts += [(self._samples + i, cells[i]) for i in texts[: _MAX_QUOTED - len(self._texts)]]
        self._text_count += len(texts)
        self._samples += len(cells)
        # text files cannot hold dates, and a look at each of their cells would cost a third of the reading
        self._dated = self._dated or (not _is_text(cells) and any(map(is_dated, cells)))

    def built(self) -> Column:
        """Return the column of all cells taken."""
        values = np.concatenate(self._blocks) if self._blocks else np.empty(0)
        if self._dated and self._origin is None:
            values = _past_midnight(values)
        values.setflags(write=False)
        return Column(self.name, self.unit, self.place, values, tuple(self._texts), self._text_count, self._dated)


def _past_midnight(values: Float) -> Float:
    """Return times of day that continue across midnight."""
    days = np.cumsum(np.diff(values, prepend=values[:1]) < -43_200.0)
    return values + 86_400.0 * days


def _is_text(cells: Sequence[object]) -> bool:
    return bool(cells) and isinstance(cells[0], str) and isinstance(cells[-1], str)


def text_findings(table: Table, columns: Iterable[Column]) -> list[Finding]:
    """Return one finding for each row that holds text in columns of numbers."""
    by_row: dict[int, list[tuple[Column, object]]] = {}
    total = 0
    for column in columns:
        total += column.text_count
        for sample, cell in column.texts:
            by_row.setdefault(sample, []).append((column, cell))
    findings = [_text_finding(table, sample, cells) for sample, cells in sorted(by_row.items())]
    unseen = total - sum(len(cells) for cells in by_row.values())
    return limit_findings(findings, table.place, "rows that hold text among numbers", unseen)


def _text_finding(table: Table, sample: int, cells: list[tuple[Column, object]]) -> Finding:
    place = table.at(sample, *(column for column, _ in cells))
    if len(cells) == 1:
        return Finding(place, f"must be a number, got {quote_cell(cells[0][1])}", _number_remedy(str(cells[0][1])))
    quoted = join_names([quote_cell(cell) for _, cell in cells], 3)
    remedy = f"Remove the {table.row_word} if it is a second header or unit row, or correct it."
    return Finding(place, f"must be numbers, got {quoted}", remedy)


def _number_remedy(cell: str) -> str:
    digits = cell.strip().replace(".", "").replace(",", "").lstrip("+-")
    if digits.isdigit():
        return "Write it without a thousands separator and with the same decimal mark as the rest of the file."
    return "Correct it, or leave the cell empty if there is no value."


def limit_findings(findings: list[Finding], place: str, message: str, unseen: int = 0) -> list[Finding]:
    """Return the first twenty findings, and one with the number of the others."""
    more = max(len(findings) - _MAX_FINDINGS, 0) + unseen
    if not more:
        return findings
    return [*findings[:_MAX_FINDINGS], Finding(place, f"{more} more {message}")]


def without_infinite(table: Table) -> Table:
    """Return the table with NaN in place of infinite values, and a warning for each column that has some.

    >>> table = without_infinite(Table("a.csv", (Column("v", "", "v", np.array([1.0, np.inf])),), np.arange(1, 3)))
    >>> print(table.columns[0].values, *table.remarks)
    [ 1. nan] a.csv line 2, column v: 1 of 2 values is infinite and treated as missing
    """
    finite = {id(column): _finite(column) for column in table.columns}
    changed = [column for column in table.columns if finite[id(column)] is not column]
    if not changed:
        return table
    clock = None if table.clock is None else finite.get(id(table.clock), table.clock)
    columns = tuple(finite[id(column)] for column in table.columns)
    remarks = tuple(_warning(table, column) for column in changed)
    return replace(table, columns=columns, clock=clock, remarks=(*table.remarks, *remarks))


def _finite(column: Column) -> Column:
    infinite = np.isinf(column.values)
    return replace(column, values=np.where(infinite, np.nan, column.values)) if infinite.any() else column


def _warning(table: Table, column: Column) -> Finding:
    at = np.flatnonzero(np.isinf(column.values))
    message = (
        f"{at.size} of {column.values.size} values {'is' if at.size == 1 else 'are'} infinite and treated as missing"
    )
    return Finding(table.at(int(at[0]), column), message, severity="warning")


def is_mark(line: str, separator: str) -> bool:
    r"""Return whether a line of a text log is a marker, as TunerStudio writes them among the rows.

    >>> is_mark("MARK 003 - Manual - Sun Aug 16", "\t"), is_mark("MARK 003\t1\t2", "\t")
    (True, False)
    """
    return _MARK.match(line) is not None and (separator == " " or separator not in line)


def describe_marks(marks: Sequence[tuple[float | None, str]], count: int) -> tuple[tuple[str, str], ...]:
    """Return the markers for `kennfeld info`: the first ones, with their time in s if it is known.

    >>> describe_marks([(0.5, "MARK 000 - Manual"), (None, "MARK 001")], 3)
    (('markers', '3 (MARK 000 - Manual at 0.5 s; MARK 001; ...)'),)
    """
    if not count:
        return ()
    texts = [text if time is None else f"{text} at {time:.6g} s" for time, text in marks[:MAX_MARKS]]
    more = ["..."] if count > len(texts) else []
    return (("markers", f"{count} ({'; '.join(texts + more)})"),)
