"""What a text file leaves open, and how it was taken: its encoding, and points that may separate thousands."""

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from kennfeld.errors import Finding
from kennfeld.measurement.columns import Table
from kennfeld.measurement.dialect import Dialect
from kennfeld.measurement.encoding import GUESSED
from kennfeld.measurement.sniff import Source

__all__ = ["with_doubts"]

_START = 1 << 16  # characters that settle it in most files
_MOST = 64_000_000  # characters that are looked at
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}\.\d{3}")  # 1.100, which may be 1100
_POINTED = re.compile(r"[+-]?(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?")
_LEAST_GROUPED = 1000  # plain numbers from here on would have a separator, too


def with_doubts(source: Source, dialect: Dialect, table: Table) -> Table:
    """Return the table of a text file with a remark for each thing that the file leaves open."""
    remarks = [*_encoding(source, dialect), *_thousands(source, dialect, table)]
    return replace(table, remarks=(*table.remarks, *remarks)) if remarks else table


def _encoding(source: Source, dialect: Dialect) -> Iterator[Finding]:
    if dialect.encoding in GUESSED:
        what = f"is not UTF-8 and was read as {GUESSED[dialect.encoding]}, which most of its characters suggest"
        yield Finding(source.name, what, "Save it as UTF-8 if names or units are wrong.", severity="remark")


@dataclass
class _Grouped:
    """The numbers of a column that may be grouped by thousands: the first one, its line, and how many there are."""

    text: str
    line: int
    count: int = 0


def _thousands(source: Source, dialect: Dialect, table: Table) -> Iterator[Finding]:
    """A warning for each column that holds 1.100 beside 950 in a file that shows no other decimal point."""
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
        what = f"{cell.text} is read as {float(cell.text):g}, but may mean {meant}: other cells have no point"
        mend = f"If it means {meant}, export the file without thousands separators; if not, ignore this."
        yield Finding(f"{table.place} line {cell.line}, column {column.place}", what, mend, severity="warning")


def _grouped(source: Source, dialect: Dialect) -> dict[int, _Grouped]:
    """The numbers of each column that may be grouped; none if any cell of the file has a decimal point for sure."""
    found: dict[int, _Grouped] | None = {}
    for size in (_START, _MOST):
        with io.TextIOWrapper(source.open(), dialect.encoding, errors="replace", newline=None) as stream:
            text = stream.read(size)
        found = _grouped_in(text, dialect)
        if found is None or len(text) < size:
            break
    return found or {}


def _grouped_in(text: str, dialect: Dialect) -> dict[int, _Grouped] | None:
    """The same of a text; None if it shows a decimal point."""
    found: dict[int, _Grouped] = {}
    for number, line in enumerate(text.split("\n"), 1):
        if number <= dialect.header.data or "." not in line:
            continue
        for i, raw in enumerate(line.split(dialect.separator)):
            cell = raw.strip(' "')
            if "." not in cell or not _POINTED.fullmatch(cell):
                continue
            if not _GROUPED.fullmatch(cell):
                return None
            found.setdefault(i, _Grouped(cell, number)).count += 1
    return found
