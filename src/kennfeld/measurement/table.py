"""Tables as the readers return them: named columns of numbers, with the location of each sample in the file.

All readers share the treatment of duplicate names, of text among numbers, of infinite values (no sensor measures them,
so they become NaN), and of the markers that a driver or the logger set while recording.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field, replace
from datetime import date, datetime, timedelta
from typing import TypeVar

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import replace_infinite
from kennfeld.measurement.cells import EPOCH, Decimal, is_dated, is_long_time, is_truth, parse_numbers, quote_cell
from kennfeld.measurement.exact_numbers import rest_of_cells
from kennfeld.measurement.header import Header
from kennfeld.measurement.stamps import StampCollector, continued, is_stamp, stated_order
from kennfeld.measurement.unit_text import may_be_time

BLOCK = 4096  # rows that text is parsed by at a time
MAX_MARKS = 12  # markers that a description quotes
_MAX_QUOTED = 50  # cells per column that messages may quote
_MAX_FINDINGS = 20  # findings of one kind per file
_MARK = re.compile(r'\s*"?MARK\s+\d+\b')
_T = TypeVar("_T")  # Python 3.11


@dataclass(frozen=True)
class Selection:
    """The requested channels, None for all, and the `units` that the caller states for columns."""

    channels: tuple[str, ...] | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    def wants(self, header: Header) -> list[int]:
        """Return the columns to read: the requested channels and whatever may be time."""
        columns = enumerate(zip(header.names, header.units, strict=True))
        return [
            i
            for i, (name, unit) in columns
            if name and (self.includes(name) or may_be_time(name, self.units.get(name, unit)))
        ]

    def includes(self, name: str) -> bool:
        """Return whether this channel belongs in the dataset."""
        return self.channels is None or name in self.channels

    def requests(self, name: str) -> bool:
        """Return whether the caller names this channel, rather than all of them."""
        return self.channels is not None and name in self.channels


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
    origin: datetime | None = None  # the instant that dates count from, if it is known; as `Dataset.start_time`
    held: bool = False  # a value is valid until the next sample, so that nothing is interpolated
    description: str = ""
    words: tuple[int, str] = (0, "")  # how many words such as OFF among numbers are missing values, and the first
    doubt: str = ""  # what its text leaves open, such as the order of day and month
    origin_doubt: str = ""  # what its text leaves open of `origin` alone
    rest: Float | None = None  # Float[samples]: what `values` lack of the numbers of a clock in the file

    @classmethod
    def without_numbers(cls, name: str, samples: int, content: str) -> "Column":
        """Return a column that is not a channel; it is kept so that a message can show what it holds."""
        return cls(name, "", name, np.full(samples, np.nan), ((0, content),), max(samples, 1))

    @property
    def extent(self) -> tuple[float, float]:
        """The smallest and the largest number; NaN if there is none."""
        return float(np.fmin.reduce(self.values, initial=np.nan)), float(np.fmax.reduce(self.values, initial=np.nan))

    def select(self, rows: Bool) -> "Column":
        """Return the column with the samples of a mask, Bool[samples], alone."""
        # the new number of each sample that remains
        sample = np.cumsum(rows) - 1
        texts = tuple((int(sample[k]), cell) for k, cell in self.texts if rows[k])
        count = self.text_count - (len(self.texts) - len(texts))
        rest = None if self.rest is None else self.rest[rows]
        return replace(self, values=self.values[rows], texts=texts, text_count=count, rest=rest)

    @property
    def is_text(self) -> bool:
        """True if the column holds more text than numbers, so that it is not a channel."""
        return self.text_count > 0 and self.text_count >= int(np.count_nonzero(~np.isnan(self.values)))


@dataclass(frozen=True)
class Table:
    """Columns of one file or sheet; `rows` holds the line (or row) number of each sample, counted from 1."""

    location: Location
    columns: tuple[Column, ...]
    rows: Int  # Int[samples]
    row_word: str = "line"
    names: tuple[str, ...] = ()  # of all columns, those not read included
    findings: tuple[Finding, ...] = ()
    details: tuple[tuple[str, str], ...] = ()
    clock_index: int | None = None  # of the time column if the format itself defines it
    clock_names: tuple[str, ...] = ()  # of all time columns if it defines several, each before its channels
    staggered: bool = False  # times of groups that differ by a constant are different times
    restarts: bool = False  # time that falls begins a new piece, as in a log that continues after a restart
    start_time: datetime | None = None  # the instant of time 0, if the file states it apart from its time column

    @property
    def clock(self) -> Column | None:
        """The time column if the format itself defines it."""
        return None if self.clock_index is None else self.columns[self.clock_index]

    @property
    def errors(self) -> list[Finding]:
        """The findings that make the table unusable."""
        return [finding for finding in self.findings if finding.severity == "error"]

    def with_units(self, units: Mapping[str, str]) -> "Table":
        """Return the table with the units that the caller states for columns; dates stay what they are."""
        columns = (c if c.dated else replace(c, unit=units.get(c.name, c.unit)) for c in self.columns)
        return replace(self, columns=tuple(columns)) if units else self

    def at(self, sample: int, *columns: Column) -> Location:
        """Return the location of a cell: `bench.csv line 17, column Torque`."""
        if columns:
            names = join_names([column.place for column in columns], 3)
            word = "column" if len(columns) == 1 else "columns"
            return self.location.within(f"{self.row_word} {self.rows[sample]}, {word} {names}")
        if self.row_word == "line":
            return replace(self.location, line=int(self.rows[sample]))
        return self.location.within(f"{self.row_word} {self.rows[sample]}")


class ColumnBuilder:
    """Collects a column block by block."""

    def __init__(self, name: str, unit: str, place: str) -> None:
        self.name, self.unit, self.place = name, unit, place
        self._blocks: list[Float] = []
        self._texts: list[tuple[int, object]] = []
        self._text_count = 0
        self._samples = 0
        self._dated = False
        self._origin: datetime | None = None  # of dates that are cells of a spreadsheet
        self._has_days = False  # cells that are dates or durations, not times of day
        self._stamps: StampCollector | None = None  # dates and times as text
        self._has_numbers = False
        self._rests: list[Float | None] | None = [] if may_be_time(name, unit) else None
        self._truths: list[Int] = []  # samples that hold the state of a switch
        self._truth = ""  # the first one

    @classmethod
    def of(cls, header: Header, index: int) -> "ColumnBuilder":
        """Return the builder of a column of a text file."""
        return cls(header.names[index], header.units[index], header.names[index])

    def add(self, cells: Sequence[object], decimal: Decimal = ".") -> None:
        """Take the next cells."""
        values, texts = parse_numbers(cells, decimal)
        if self._stamps is not None or (texts and not self._has_numbers and is_stamp(cells[texts[0]])):
            texts = self._add_stamps(cells, values, texts)
        elif not self._has_numbers:
            self._has_numbers = bool(texts) or not bool(np.isnan(values).all())
        self._note_truths(cells, values)
        if self._rests is not None:
            self._rests.append(rest_of_cells(cells, values, decimal))
        self._blocks.append(values)
        self._texts += [(self._samples + i, cells[i]) for i in texts[: _MAX_QUOTED - len(self._texts)]]
        self._text_count += len(texts)
        self._samples += len(cells)
        # text files cannot hold dates, and a look at each of their cells would cost a third of the reading
        is_text_file = bool(cells) and isinstance(cells[0], str) and isinstance(cells[-1], str)
        self._dated = self._dated or (not is_text_file and any(map(is_dated, cells)))
        self._has_days = self._has_days or (self._dated and any(isinstance(c, date | timedelta) for c in cells))
        is_first = self._dated and self._origin is None
        if is_first and any(isinstance(cell, date) and not is_long_time(cell) for cell in cells):
            self._origin = EPOCH

    def _note_truths(self, cells: Sequence[object], values: Float) -> None:
        """Note the states of switches, which are missing values if the other cells are numbers."""
        candidates = np.flatnonzero((values == 0) | (values == 1))
        truths = [k for k in candidates.tolist() if is_truth(cells[k])] if candidates.size else []
        if truths:
            self._truth = self._truth or str(cells[truths[0]]).strip()
            self._truths.append(np.array(truths, dtype=np.int64) + self._samples)

    def _without_truths(self, values: Float) -> tuple[int, str]:
        """Make the states of switches among other numbers NaN; return how many they are, and the first one."""
        if not self._truths:
            return 0, ""
        truths = np.concatenate(self._truths)
        others = np.delete(values, truths)
        if np.all(np.isnan(others) | (others == 0) | (others == 1)):
            return 0, ""
        values[truths] = np.nan
        return truths.size, self._truth

    def _add_stamps(self, cells: Sequence[object], values: Float, texts: list[int]) -> list[int]:
        """Take a block of a column of stamps; return the positions of other text."""
        stamps = self._stamps or StampCollector(stated_order(f"{self.name} {self.unit}"))
        if self._stamps is None:
            for block in self._blocks:  # all of them gaps
                stamps.extend(block)
        if texts and stamps.add(cells):
            self._stamps, self._dated = stamps, True
            return []
        stamps.extend(values)
        self._has_numbers = True  # or text: later stamps do not make it a column of stamps
        return texts

    def build(self) -> Column:
        """Return the column of all cells taken."""
        doubt, origin_doubt, words, origin = "", "", (0, ""), self._origin
        if self._dated and self._stamps is not None:
            values, origin = self._stamps.build(), self._stamps.origin
            doubt, origin_doubt = self._stamps.doubt, self._stamps.origin_doubt
        else:
            values = np.concatenate(self._blocks) if self._blocks else np.empty(0)
            words = self._without_truths(values)
            if self._dated and not self._has_days:
                values = continued(values)
        values.setflags(write=False)
        return Column(
            self.name,
            self.unit,
            self.place,
            values,
            tuple(self._texts),
            self._text_count,
            self._dated,
            origin,
            words=words,
            doubt=doubt,
            origin_doubt=origin_doubt,
            rest=None if self._dated else self._rest(),
        )

    def _rest(self) -> Float | None:
        rests = self._rests or ()
        if all(rest is None for rest in rests):
            return None
        return np.concatenate(
            [np.zeros(block.size) if rest is None else rest for block, rest in zip(self._blocks, rests, strict=True)]
        )


def text_findings(table: Table, columns: Iterable[Column]) -> list[Finding]:
    """Return one finding for each row that holds text in columns of numbers."""
    by_row: dict[int, list[tuple[Column, object]]] = {}
    unseen = 0
    for column in columns:
        unseen += column.text_count - len(column.texts)
        for sample, cell in column.texts:
            by_row.setdefault(sample, []).append((column, cell))
    message = "rows that hold text among numbers"
    rows = sorted(by_row.items())
    return limit_findings(rows, lambda row: _text_finding(table, *row), table.location, message, unseen)


def _text_finding(table: Table, sample: int, cells: list[tuple[Column, object]]) -> Finding:
    location = table.at(sample, *(column for column, _ in cells))
    if len(cells) > 1:
        quoted = join_names([quote_cell(cell) for _, cell in cells], 3)
        remedy = f"Remove the {table.row_word} if it is a second header or unit row, or correct it."
        return Finding(location, f"must be numbers, got {quoted}", remedy)
    cell = cells[0][1]
    if str(cell).strip().replace(".", "").replace(",", "").lstrip("+-").isdigit():
        remedy = "Write it without a thousands separator and with the same decimal mark as the rest of the file."
    else:
        remedy = "Correct it, or leave the cell empty if there is no value."
    return Finding(location, f"must be a number, got {quote_cell(cell)}", remedy)


def limit_findings(
    items: Sequence[_T], report: Callable[[_T], Finding], location: Location, message: str, unseen: int = 0
) -> list[Finding]:
    """Return a finding for each of the first twenty items, and one with the number of the others."""
    more = max(len(items) - _MAX_FINDINGS, 0) + unseen
    summary = [Finding(location, f"{more} more {message}")] if more else []
    return [*map(report, items[:_MAX_FINDINGS]), *summary]


def with_word_warnings(table: Table) -> Table:
    """Return the table with a warning for each column of numbers in which words such as OFF are missing values."""
    findings = []
    for column in table.columns:
        count, word = column.words
        if count:
            message = (
                f"{count} of {column.values.size} cells hold {word!r} or the like among numbers and are missing values"
            )
            remedy = "Write 0 or 1 instead if that is meant."
            location = table.location.within(f"column {column.place}")
            findings.append(Finding(location, message, remedy, severity="warning"))
    return replace(table, findings=(*table.findings, *findings)) if findings else table


def without_infinite(table: Table) -> Table:
    """Return the table with NaN in place of infinite values, and a warning for each column that has some.

    >>> column = Column("v", "", "v", np.array([1.0, np.inf]))
    >>> table = without_infinite(Table(Location("a.csv"), (column,), np.arange(1, 3)))
    >>> print(table.columns[0].values, *table.findings)
    [ 1. nan] a.csv line 2, column v: 1 of 2 values is infinite and treated as missing
    """
    columns, findings = [], []
    for column in table.columns:
        values, message = replace_infinite(column.values)
        if message:
            first = int(np.argmax(np.isinf(column.values)))
            findings.append(Finding(table.at(first, column), message, severity="warning"))
            column = replace(column, values=values)
        columns.append(column)
    return replace(table, columns=tuple(columns), findings=(*table.findings, *findings)) if findings else table


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
