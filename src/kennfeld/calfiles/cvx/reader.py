"""Reads CVX 2.1, the CSV of INCA: a header that states its separators, then one record per value, curve, map or axis.

A record is an identifier in column 2, a line that begins with its type, and values from column 3 on; columns 1 and 2
contain free text, where INCA writes units as `:"rpm":`. Axes are records of their own: X_AXIS_PTS under the name of
the table, or AXIS_PTS under the name of a group axis. No record states which group axis a table uses; the
specification leaves "axis name information" to the free text of the type line, and so does this reader.
"""

import re
from dataclasses import field
from math import isfinite
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import ItemCollector, describe_fall, in_rising_order, parse_float, turn
from kennfeld.calfiles.format import CalibrationSource, FileFindings, ReadResult, build_set
from kennfeld.calfiles.verbal_values import unify_text_kinds
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Block, Parameter, parameter
from kennfeld.domain.texts import Text, TextKind

# CALIBRATION VALUES V2.1,.,*,"", : separator, decimal point, begin of comments, quotes
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
        matches = map(_UNIT.search, cells)
        return next((unit[2].replace(unit[1] * 2, unit[1]) for unit in matches if unit), "")


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
        text = f"({quote}(?:[^{quote}]|{quote}{quote})*{quote})"
        values = []
        for cell in cells:
            pair = re.fullmatch(rf"{text}\s*[.,]\s*{text}", cell)
            values.append(f"{self.text(pair[1])}={self.text(pair[2])}" if pair else self.text(cell) or cell)
        return ",".join(filter(None, values))

    def numbers(self, cells: list[str]) -> list[float]:
        """Return the numbers of cells; NaN for a cell that holds none."""
        if self.point != ".":
            # a point beside a decimal comma makes the cell no number, as `parse_float` refuses `_`
            cells = [cell.replace(".", "_").replace(self.point, ".") for cell in cells]
        return list(map(parse_float, cells))


def read_cvx(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a CVX file; identifiers are compared without case, as the specification requires.

    Raises `InputError` with all findings.
    """
    findings = FileFindings(source.name)
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
    warnings = findings.finish()
    parameters = build_set(unify_text_kinds(reader.items.items), reader.groups.values())
    return ReadResult(f"CVX {dialect.version}", parameters, warnings)


def _dialect(text: str, findings: FileFindings) -> _Dialect:
    match = _HEADER.match(text.lstrip())
    if match is None:
        findings.error(1, "", "the first line states no version", "It must begin like CALIBRATION VALUES V2.1,.,*")
        return _Dialect("")
    version, separator, point, comment, quote = match.groups()
    separator = separator or ","
    # The specification: if both are a comma, the decimal point is the default.
    point = "." if point == separator else point or "."
    return _Dialect(version, separator, point, (comment or "").strip() or "*", quote or '"')


def _records(text: str, dialect: _Dialect, findings: FileFindings) -> list[_Record]:
    records: list[_Record] = []
    before = _CsvRow(0, [])
    for number, line in enumerate(text.split("\n"), 1):
        row = _CsvRow(number, dialect.cells(line))
        if not row.cells or line.lstrip().startswith(dialect.comment):
            continue
        if row.cells[0] in _TYPES and len(before.cells) == 2 and before.cells[0] not in _TYPES:
            if records and records[-1].rows:
                records[-1].rows.pop()  # the identifier of this record
            records.append(_Record(before.cells[1], row))
        elif row.cells[0] in _TYPES:
            remedy = "Put its name in column 2 of the line above."
            findings.error(row.line, "", f"{row.cells[0]} has no identifier", remedy)
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
    def __init__(self, findings: FileFindings, dialect: _Dialect) -> None:
        self.findings = findings
        self.dialect = dialect
        self.axes: dict[tuple[str, str, str], tuple[_Record, Axis]] = {}  # by type, name and variant
        self.folded: dict[tuple[str, str, str], Axis] = {}  # without regard to case
        self.groups: dict[str, Axis] = {}  # group axes, each in its first variant
        self.groups_folded: dict[str, Axis] = {}
        self.items = ItemCollector(findings)
        self.skipped: set[tuple[str, str, str]] = set()  # types, names and variants of axes that cannot be read

    def take_axis(self, record: _Record) -> None:
        points = self._numbers(record, [record.row, *record.rows])
        if points is None:
            return
        if not points.size:
            self._wrong(record, f"{record.kind} has no breakpoints")
            return
        points, falls = in_rising_order(points)
        if fall := describe_fall(points):
            message = f"{record.kind} neither rises nor falls: {fall}; skipped with the tables over it"
            self.findings.warning(record.row.line, record.name, message, "Correct its breakpoints.")
            self.skipped.add((record.kind, record.name.casefold(), record.variant))
            return
        is_group = record.kind == "AXIS_PTS"
        axis = Axis(points, unit=record.unit, name=record.name if is_group else "", falling=falls)
        first, known = self.axes.setdefault((record.kind, record.name, record.variant), (record, axis))
        # without its variant as well, for tables whose variant has no axis of its own
        for variant in (record.variant, ""):
            self.folded.setdefault((record.kind, record.name.casefold(), variant), axis)
        if not np.array_equal(known.breakpoints, points) or known.falling != axis.falling:
            self.items.report_repetition(record.name, record.row.line, first.row.line, "with other values")
        elif is_group:
            group = self.groups.setdefault(record.name, axis)
            self.groups_folded.setdefault(record.name.casefold(), axis)
            if not np.array_equal(group.breakpoints, points):
                message = f"is the group axis in another variant ({record.variant})"
                remedy = "Tables of that variant have it as an axis of their own."
                self.findings.warning(record.row.line, record.name, message, remedy)

    def take(self, record: _Record) -> None:
        text = self.dialect.text(record.row.values[0]) if record.row.values else None
        cells = [cell for row in (record.row, *record.rows) for cell in row.values]
        if record.kind in ("ASCII", "VALUE") and text is not None:
            kind: TextKind = "text" if record.kind == "ASCII" else "enumeration"
            item = Text(record.name, text, kind=kind, unit=record.unit, **record.labels)
            self.items.add(item, record.row.line)
        elif record.kind in _SKIPPED_TYPES or any(self.dialect.text(cell) is not None for cell in cells):
            self.findings.warning(record.row.line, record.name, f"{record.kind} is not supported here; skipped")
        elif record.kind == "ASCII":
            self._wrong(record, f"{record.kind} contains no text between {self.dialect.quote}")
        else:
            member = (self._table if record.kind in ("CURVE", "MAP") else self._block)(record)
            if member is not None:
                self.items.add(member, record.row.line)

    def _wrong(self, record: _Record, message: str, remedy: str = "") -> None:
        self.findings.error(record.row.line, record.name, message, remedy)

    def _block(self, record: _Record) -> Parameter | None:
        rows = [row for row in (record.row, *record.rows) if row.values]
        values = self._numbers(record, rows if record.kind == "VAL_BLK" else [record.row])
        if values is None:
            return None
        if record.kind == "VALUE":
            if values.size == 1:
                return parameter(record.name, values[0], unit=record.unit, **record.labels)
            self._wrong(record, f"VALUE has {values.size} values, not one")
            return None
        widths = {len(row.values) for row in rows}
        if len(widths) != 1:
            self._wrong(record, f"VAL_BLK has rows of {sorted(widths)} values" if rows else "VAL_BLK has no values")
            return None
        # a row is one y, and x is the first index here
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
            has = f"{record.kind} has {count_noun(len(rows), 'row')} of values"
            self._wrong(record, f"{has}, but its axis requires {count}")
            return None
        short = [row for row in rows if len(row.values) != len(own[0])]
        for row in short:
            message = f"the row has {count_noun(len(row.values), 'value')}, but the x axis has {len(own[0])}"
            self.findings.error(row.line, record.name, message)
        values = None if short else self._numbers(record, rows)
        if values is None:
            return None
        shaped = values.reshape(count, -1).T if len(own) == 2 else values
        return parameter(record.name, turn(shaped, own), own, unit=record.unit, **record.labels)

    def _axis(self, record: _Record, letter: str, cell: int) -> Axis | None:
        name = record.row.cells[cell] if cell < len(record.row.cells) else ""
        group = self.groups.get(name) or self.groups_folded.get(name.casefold())
        if ("AXIS_PTS", name.casefold(), record.variant) in self.skipped:
            return None
        if name and group is not None:
            own = self._known("AXIS_PTS", name, record.variant) or group  # that of the table's variant
            if not np.array_equal(own.breakpoints, group.breakpoints):
                return own.changed(name="")
            return group if own.falling == group.falling else group.changed(falling=own.falling)
        kind = f"{letter}_AXIS_PTS"
        for variant in (record.variant, ""):
            axis = self._known(kind, record.name, variant)
            if axis is not None:
                return axis
        if {(kind, record.name.casefold()), ("AXIS_PTS", name.casefold())} & {axis[:2] for axis in self.skipped}:
            return None
        width = max((len(row.values) for row in record.rows), default=0)
        sizes = {len(axis) for axis in self.groups.values()}
        # a group axis of this size is probably meant; the rows of a map may include the line of embedded breakpoints
        if (width if letter == "X" else len(record.rows)) in sizes | {size + 1 for size in sizes if letter == "Y"}:
            message = f"{record.kind} does not state which group axis is its {letter.lower()} axis; skipped"
            self.findings.warning(record.row.line, record.name, message, "Export it as DCM.")
        else:
            remedy = "The file may be truncated: use a complete copy."
            self._wrong(record, f"{record.kind} has no record {letter}_AXIS_PTS", remedy)
        return None

    def _known(self, kind: str, name: str, variant: str) -> Axis | None:
        """Return the axis of a record; its name need not be in the same case."""
        exact = self.axes.get((kind, name, variant))
        return exact[1] if exact else self.folded.get((kind, name.casefold(), variant))

    def _numbers(self, record: _Record, rows: list[_CsvRow]) -> Float | None:
        """Return all numbers of some rows; None if one of them is none."""
        numbers: list[float] = []
        for row in rows:
            numbers += self.dialect.numbers(row.values)
        if all(map(isfinite, numbers)):
            return np.array(numbers, dtype=np.float64)
        cells = [(row.line, cell) for row in rows for cell in row.values]
        for (line, cell), number in zip(cells, numbers, strict=True):
            if not isfinite(number):
                self.findings.error(line, record.name, f"must be a number, got {cell[:60]!r}")
        return None
