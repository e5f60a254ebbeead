"""Reads CVX 2.1, the CSV of INCA: a header that states its separators, then one record per value, curve, map or axis.

A record is an identifier in column 2, a line that begins with its type, and values from column 3 on; columns 1 and 2
contain free text, where INCA writes units as `:"rpm":`. Axes are records of their own: X_AXIS_PTS under the name of
the table, or AXIS_PTS under the name of a group axis. No record states which group axis a table uses; the
specification leaves "axis name information" to the free text of the type line, and so does this reader.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import CalibrationSource, Findings, ReadResult, build_set
from kennfeld.calfiles.verbal_values import unify_text_kinds
from kennfeld.formatting import count_noun
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Text, TextKind, parameter

_TITLE = "CALIBRATION VALUES V"
_HEADER = re.compile(r"CALIBRATION VALUES V(\d+\.\d+)(?:([^\d\n])(?:([.,])\2([^\n]*?)\2\s*([^\n])\5)?)?")
_AXES = ("X_AXIS_PTS", "Y_AXIS_PTS", "AXIS_PTS")
_SKIPPED_TYPES = ("CUBOID", "Z_AXIS_PTS", "RESCALE_AXIS_PTS")
_TYPES = frozenset({"VALUE", "VAL_BLK", "CURVE", "MAP", "ASCII", *_AXES, *_SKIPPED_TYPES})
_CODINGS = frozenset({"FUNCTION", "VARIANT", "DISPLAY_IDENTIFIER"})
_UNIT = re.compile(r""":(["'])(.*)\1:""")  # in the string delimiter of the file


@dataclass(frozen=True)
class _CsvRow:
    line: int
    cells: list[str]

    @property
    def values(self) -> list[str]:
        return self.cells[2:]


@dataclass
class _Record:
    """One record: its type line, the rows of values after it, and the lines that say where it belongs."""

    name: str
    row: _CsvRow
    rows: list[_CsvRow] = field(default_factory=list)
    functions: tuple[str, ...] = ()
    variant: str = ""
    display_name: str = ""

    @property
    def labels(self) -> dict[str, Any]:
        return {"functions": self.functions, "display_name": self.display_name, "variant": self.variant}

    @property
    def kind(self) -> str:
        return self.row.cells[0]

    @property
    def unit(self) -> str:
        cells = [cell for row in (self.row, *self.rows[:2]) for cell in row.cells[:2]]
        found = (_UNIT.search(cell) for cell in cells)
        return next((unit[2].replace(unit[1] * 2, unit[1]) for unit in found if unit), "")


@dataclass(frozen=True)
class _Dialect:
    """The declarations in the first line of a file."""

    version: str
    separator: str = ","
    point: str = "."
    comment: str = "*"
    quote: str = '"'

    def cells(self, line: str) -> list[str]:
        """Split a line into cells, except at separators within quotes; trailing empty cells are dropped."""
        cells = line.split(self.separator) if self.quote not in line else self._quoted_cells(line)
        cells = [cell.strip() for cell in cells]
        while cells and not cells[-1]:
            cells.pop()
        return cells

    def _quoted_cells(self, line: str) -> list[str]:
        cells, inside, start = [], False, 0
        for at, character in enumerate(line):
            if character == self.quote:
                inside = not inside
            elif character == self.separator and not inside:
                cells.append(line[start:at])
                start = at + 1
        return [*cells, line[start:]]

    def text(self, cell: str) -> str | None:
        """Return the text of a quoted cell; None for any other."""
        if len(cell) < 2 or cell[0] != self.quote or cell[-1] != self.quote:
            return None
        return cell[1:-1].replace(self.quote * 2, self.quote)

    def variant(self, cells: list[str]) -> str:
        """Return the variant in the cells `"Car"."Cabrio"`, `"Gear"."Manual"`: Car=Cabrio,Gear=Manual."""
        quote = re.escape(self.quote)
        text = f"{quote}((?:[^{quote}]|{quote}{quote})*){quote}"
        pairs = (re.fullmatch(rf"{text}\s*[.,]\s*{text}", cell) for cell in cells)
        said = [
            f"{self.text(f'{self.quote}{pair[1]}{self.quote}')}={self.text(f'{self.quote}{pair[2]}{self.quote}')}"
            if pair
            else self.text(cell) or cell
            for cell, pair in zip(cells, pairs, strict=True)
        ]
        return ",".join(filter(None, said))

    def numbers(self, cells: list[str]) -> list[float]:
        """Return the numbers of cells; NaN for a cell that holds none."""
        if self.point == ".":
            try:
                if "_" not in "".join(cells):
                    return list(map(float, cells))
            except ValueError:
                pass
        return [self._number(cell) for cell in cells]

    def _number(self, cell: str) -> float:
        written = cell if self.point == "." else cell.replace(".", "_").replace(self.point, ".")
        try:
            # Python would read 1_000 as a thousand.
            return nan if "_" in written else float(written)
        except ValueError:
            return nan


def recognises_cvx(text: str) -> bool:
    """Check whether a text begins with the title of a CVX file."""
    return text.lstrip("\ufeff \t\n").startswith(_TITLE)


def read_cvx(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a CVX file; identifiers are compared without regard to case, as the specification asks.

    Raises `InputError` with all findings.
    """
    findings = Findings(source.name)
    text = source.text.lstrip("\ufeff")
    dialect = _dialect(text, findings)
    reader = _CvxReader(findings, dialect)
    records = _records(text, dialect, findings)
    for record in records:
        if record.kind in _AXES:
            reader.take_axis(record)
    for record in records:
        if record.kind not in _AXES:
            reader.take(record)
    remarks = findings.finish()
    return ReadResult(f"CVX {dialect.version}", reader.parameters(), remarks)


def _dialect(text: str, findings: Findings) -> _Dialect:
    match = _HEADER.match(text.lstrip())
    if match is None:
        findings.error(1, "", "the first line states no version", f"It must begin like {_TITLE}2.1,.,*")
        return _Dialect("")
    version, separator, point, comment, quote = match.groups()
    separator = separator or ","
    # The specification: where both are a comma, the decimal point is the default.
    point = "." if point == separator else point or "."
    return _Dialect(version, separator, point, (comment or "").strip() or "*", quote or '"')


def _rows(text: str, dialect: _Dialect) -> Iterator[_CsvRow]:
    for number, line in enumerate(text.split("\n"), 1):
        if line.lstrip().startswith(dialect.comment):
            continue
        cells = dialect.cells(line)
        if cells:
            yield _CsvRow(number, cells)


def _records(text: str, dialect: _Dialect, findings: Findings) -> list[_Record]:
    records: list[_Record] = []
    before = _CsvRow(0, [])
    for row in _rows(text, dialect):
        if row.cells[0] in _TYPES and len(before.cells) == 2 and before.cells[0] not in _TYPES:
            if records and records[-1].rows:
                records[-1].rows.pop()  # the identifier of this record
            records.append(_Record(before.cells[1], row))
        elif row.cells[0] in _TYPES:
            findings.error(
                row.line, "", f"{row.cells[0]} has no identifier", "Put its name in column 2 of the line above."
            )
            records.append(_Record("", row))
        elif records and row.cells[0].strip("'") in _CODINGS:
            _apply_coding(records[-1], row, dialect)
        elif records:
            records[-1].rows.append(row)
        before = row
    if not records and before.line > 1:
        message = f"contains no record whose cells are separated by {dialect.separator!r}, as its first line declares"
        findings.error(before.line, "", message, "Compare the first line with the others.")
    return [record for record in records if record.name]


def _apply_coding(record: _Record, row: _CsvRow, dialect: _Dialect) -> None:
    """Apply a line with the function, variant or display name of a record."""
    kind = row.cells[0].strip("'")
    first = (dialect.text(row.values[0]) or "") if row.values else ""
    if kind == "VARIANT":
        record.variant = dialect.variant(row.values)
    elif kind == "DISPLAY_IDENTIFIER":
        record.display_name = first
    elif first and first not in record.functions:
        record.functions += (first,)


class _CvxReader:
    def __init__(self, findings: Findings, dialect: _Dialect) -> None:
        self.findings = findings
        self.dialect = dialect
        self.axes: dict[tuple[str, str, str], tuple[_Record, Axis]] = {}  # by type, name and variant
        self.folded: dict[tuple[str, str, str], Axis] = {}  # without regard to case
        self.groups: dict[str, Axis] = {}  # group axes, each in its first variant
        self.groups_folded: dict[str, Axis] = {}
        self.items: dict[tuple[str, str], tuple[_Record, Parameter | Text]] = {}  # by name and variant
        self.first: dict[str, Parameter | Text] = {}  # of each name

    def parameters(self) -> ParameterSet:
        items = unify_text_kinds({key: item for key, (_, item) in self.items.items()})
        return build_set(items, self.groups.values())

    def take_axis(self, record: _Record) -> None:
        cells = [record.row, *record.rows]
        points = self._numbers(record, cells)
        if points is None:
            return
        falling = np.flatnonzero(points[1:] <= points[:-1])
        if not points.size or falling.size or not np.isfinite(points).all():
            message = (
                "has no breakpoints" if not points.size else f"is not strictly increasing: {_describe_fall(points)}"
            )
            self._wrong(record, f"{record.kind} {message}")
            return
        is_group = record.kind == "AXIS_PTS"
        axis = Axis(points, unit=record.unit, name=record.name if is_group else "")
        first, known = self.axes.setdefault((record.kind, record.name, record.variant), (record, axis))
        for variant in (record.variant, ""):
            self.folded.setdefault((record.kind, record.name.casefold(), variant), axis)
        if not np.array_equal(known.breakpoints, points):
            self._repeated(record, first)
        elif is_group:
            self._take_group(record, axis)

    def _take_group(self, record: _Record, axis: Axis) -> None:
        group = self.groups.setdefault(record.name, axis)
        self.groups_folded.setdefault(record.name.casefold(), axis)
        if not np.array_equal(group.breakpoints, axis.breakpoints):
            message = f"is the group axis in another variant ({record.variant}); skipped"
            self.findings.warning(record.row.line, record.name, message)

    def take(self, record: _Record) -> None:
        text = self.dialect.text(record.row.values[0]) if record.row.values else None
        if record.kind in ("ASCII", "VALUE") and text is not None:
            kind: TextKind = "text" if record.kind == "ASCII" else "enumeration"
            self._hold(record, Text(record.name, text, kind=kind, unit=record.unit, **record.labels))
        elif record.kind in _SKIPPED_TYPES or self._holds_text(record):
            self.findings.warning(record.row.line, record.name, f"{record.kind} is not supported here; skipped")
        else:
            member = self._member(record)
            if member is not None:
                self._hold(record, member)

    def _hold(self, record: _Record, item: Parameter | Text) -> None:
        first = self.first.setdefault(record.name, item)
        if isinstance(first, Text) != isinstance(item, Text):
            self._wrong(record, f"{record.name} is defined twice, as a number and as a text")
            return
        before, known = self.items.setdefault((record.name, record.variant), (record, item))
        if not _same_content(known, item):
            message = f"{record.name} is already defined in line {before.row.line}, with other values"
            self._wrong(record, message, "Keep one of the two.")

    def _holds_text(self, record: _Record) -> bool:
        return any(self.dialect.text(cell) is not None for row in (record.row, *record.rows) for cell in row.values)

    def _repeated(self, record: _Record, first: _Record) -> None:
        message = f"{record.name} is already defined in line {first.row.line}, with other values"
        self._wrong(record, message, "Keep one of the two.")

    def _wrong(self, record: _Record, message: str, remedy: str = "") -> None:
        self.findings.error(record.row.line, record.name, message, remedy)

    def _member(self, record: _Record) -> Parameter | None:
        makers: dict[str, Callable[[_Record], Parameter | None]]
        makers = {"VALUE": self._scalar, "VAL_BLK": self._block, "CURVE": self._table, "MAP": self._table}
        if record.kind in makers:
            return makers[record.kind](record)
        self._wrong(record, f"{record.kind} contains no text between {self.dialect.quote}")
        return None

    def _scalar(self, record: _Record) -> Parameter | None:
        values = self._numbers(record, [record.row])
        if values is None or values.size != 1:
            if values is not None:
                self._wrong(record, f"VALUE has {values.size} values, not one")
            return None
        return parameter(record.name, values[0], unit=record.unit, **record.labels)

    def _block(self, record: _Record) -> Parameter | None:
        rows = [row for row in (record.row, *record.rows) if row.values]
        values = self._numbers(record, rows)
        if values is None:
            return None
        widths = {len(row.values) for row in rows}
        if len(widths) != 1:
            self._wrong(record, f"VAL_BLK has rows of {sorted(widths)} values" if rows else "VAL_BLK has no values")
            return None
        shaped = values if len(rows) == 1 else values.reshape(len(rows), -1).T
        return Block(record.name, shaped, unit=record.unit, **record.labels)

    def _table(self, record: _Record) -> Parameter | None:
        letters = "XY" if record.kind == "MAP" else "X"
        axes = [self._axis(record, letter, cell) for cell, letter in enumerate(letters, 1)]
        own = [axis for axis in axes if axis is not None]
        if len(own) < len(axes):
            return None
        count = len(own[1]) if len(own) == 2 else 1
        # One row more is the line of embedded breakpoints, which the specification has every reader discard.
        rows = record.rows[1:] if len(record.rows) == count + 1 else record.rows
        if len(rows) != count:
            self._wrong(
                record, f"{record.kind} has {count_noun(len(rows), 'row')} of values, but its axis requires {count}"
            )
            return None
        if not self._widths_agree(record, rows, len(own[0])):
            return None
        values = self._numbers(record, rows)
        if values is None:
            return None
        shaped = values.reshape(count, -1).T if len(own) == 2 else values
        return parameter(record.name, shaped, own, unit=record.unit, **record.labels)

    def _widths_agree(self, record: _Record, rows: list[_CsvRow], width: int) -> bool:
        short = [row for row in rows if len(row.values) != width]
        for row in short:
            message = f"the row has {count_noun(len(row.values), 'value')}, but the x axis has {width}"
            self.findings.error(row.line, record.name, message)
        return not short

    def _axis(self, record: _Record, letter: str, cell: int) -> Axis | None:
        named = record.row.cells[cell] if cell < len(record.row.cells) else ""
        group = self.groups.get(named) or self.groups_folded.get(named.casefold())
        if named and group is not None:
            return group
        kind = f"{letter}_AXIS_PTS"
        for variant in (record.variant, ""):
            exact = self.axes.get((kind, record.name, variant))
            found = exact[1] if exact else self.folded.get((kind, record.name.casefold(), variant))
            if found is not None:
                return found
        width = max((len(row.values) for row in record.rows), default=0)
        sizes = {len(axis) for axis in self.groups.values()}
        if (width if letter == "X" else len(record.rows)) in sizes | {size + 1 for size in sizes if letter == "Y"}:
            message = f"{record.kind} does not state which group axis is its {letter.lower()} axis; skipped"
            self.findings.warning(record.row.line, record.name, message, "Export it as DCM.")
        else:
            remedy = "The file may be truncated: use a complete copy."
            self._wrong(record, f"{record.kind} has no record {letter}_AXIS_PTS", remedy)
        return None

    def _numbers(self, record: _Record, rows: list[_CsvRow]) -> Float | None:
        """Return all numbers of some rows; None if one of them is none."""
        numbers = [self.dialect.numbers(row.values) for row in rows]
        wrong = [
            (row.line, cell)
            for row, found in zip(rows, numbers, strict=True)
            for cell, number in zip(row.values, found, strict=True)
            if not isfinite(number)
        ]
        for line, cell in wrong:
            self.findings.error(line, record.name, f"must be a number, got {cell[:60]!r}")
        return None if wrong else np.array([number for found in numbers for number in found], dtype=np.float64)


def _same_content(first: Parameter | Text, second: Parameter | Text) -> bool:
    if isinstance(first, Text) or isinstance(second, Text):
        return isinstance(first, Text) and isinstance(second, Text) and first.text == second.text
    return first.values.shape == second.values.shape and np.array_equal(first.values, second.values)


def _describe_fall(points: Float) -> str:
    at = int(np.flatnonzero(points[1:] <= points[:-1])[0])
    return f"breakpoint {at + 2} ({points[at + 1]:g}) does not exceed breakpoint {at + 1} ({points[at]:g})"
