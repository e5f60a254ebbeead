"""Reads a calibration workbook: its index lists the parameters and the sheets of their values."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kennfeld.calfiles.excel.layout import (
    AXES,
    AXES_HEADING,
    INDEX,
    INDEX_HEADING,
    KINDS,
    SCALARS,
    SCALARS_HEADING,
    TEXT_KINDS,
    TEXTS,
    TEXTS_HEADING,
    Sheet,
    index_heading,
    number_fault,
    open_source,
    sheet_of,
)
from kennfeld.calfiles.excel.tables import AxisCells, Grid, read_grid, read_number
from kennfeld.calfiles.format import CalibrationSource, Findings, ReadResult, build_set
from kennfeld.errors import ArgumentError
from kennfeld.formatting import nearest
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Parameter, Scalar, Text, TextKind, parameter
from kennfeld.workbooks import Workbook

Item = Parameter | Text
Key = tuple[str, str]  # name and variant
_TABLES = {"curve": (1, 1), "map": (2, 2), "cube": (3, 4)}  # the least and the most axes


def read_excel(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a workbook with an index; sheets that the index does not name are the user's own.

    Of a label with several variants the first one counts. Raises `InputError` with all findings and its cell.
    """
    findings = Findings(source.name)
    book = open_source(source)
    index = sheet_of(book, INDEX) if INDEX in book.names else Sheet(INDEX, [])
    heading = index_heading(index)
    if heading is None:
        message = f"is an Excel workbook without a sheet {INDEX} that lists name, kind and sheet of each parameter"
        findings.error(0, "", message, "Use a workbook of measured data as a dataset.")
        findings.finish()
    assert heading is not None
    reader = _SheetReader(book, findings)
    reader.read(_rows(index, heading, INDEX_HEADING, findings))
    remarks = findings.finish()
    return ReadResult("Excel", reader.parameters(), remarks)


@dataclass(frozen=True)
class _SheetRow:
    """One row of a list: its cells by heading."""

    sheet: Sheet
    row: int
    columns: dict[str, int]

    def text(self, heading: str) -> str:
        return self.sheet.text(self.row, self.columns[heading]) if heading in self.columns else ""

    @property
    def name(self) -> str:
        return self.text("name").strip()

    @property
    def key(self) -> Key:
        return self.name, self.text("variant")

    def place(self, heading: str) -> str:
        return self.sheet.place(self.row, self.columns.get(heading, 0))

    def labels(self) -> dict[str, Any]:
        functions = tuple(word.strip() for word in self.text("functions").split(",") if word.strip())
        named = {"display_name": self.text("display name"), "variant": self.text("variant")}
        return {"description": self.text("description"), "functions": functions, **named}


def _rows(sheet: Sheet, heading: int | None, words: tuple[str, ...], findings: Findings) -> list[_SheetRow]:
    """Return the rows of a list below its headings, whose columns may have moved."""
    if heading is None:
        heading = next((row for row in range(min(len(sheet.rows), 50)) if words[0] in _words(sheet, row)), None)
    if heading is None:
        findings.error(0, "", f"Sheet {sheet.name} has no header row", f"Its first row must be: {', '.join(words)}.")
        return []
    found = _words(sheet, heading)
    columns = {word: found.index(word) for word in words if word in found}
    rows = [_SheetRow(sheet, row, columns) for row in range(heading + 1, len(sheet.rows))]
    first = columns.get(words[0], 0)
    return [row for row in rows if sheet.text(row.row, first).strip()]


def _words(sheet: Sheet, row: int) -> list[str]:
    return [str(cell).strip().casefold() for cell in sheet.rows[row]]


@dataclass
class _SheetReader:
    book: Workbook
    findings: Findings
    items: dict[Key, Item] = field(default_factory=dict)
    groups: dict[str, tuple[Sheet, AxisCells]] = field(default_factory=dict)
    broken: set[str] = field(default_factory=set)  # group axes with a finding of their own
    users: dict[str, str] = field(default_factory=dict)  # the parameter whose table is on a sheet

    def read(self, index: list[_SheetRow]) -> None:
        """Read all items of the index in order, then single values that were added elsewhere."""
        self._read_groups()
        singles = self._listed(SCALARS, SCALARS_HEADING)
        texts = self._listed(TEXTS, TEXTS_HEADING)
        seen: dict[Key, _SheetRow] = {}
        for row in index:
            first = seen.setdefault(row.key, row)
            if first is not row:
                self._wrong(f"{row.place('name')} repeats the name {row.name}", "Delete one of the two rows.")
            else:
                self._take(row, singles, texts)
        for key, row in {**singles, **texts}.items():
            if key not in seen:
                self._hold(key, self._single(row) if key in singles else _text(row))

    def parameters(self) -> ParameterSet:
        return build_set(self.items, [_axis(cells, name) for name, (_, cells) in self.groups.items()])

    def _wrong(self, message: str, remedy: str = "") -> None:
        self.findings.error(0, "", message, remedy)

    def _hold(self, key: Key, item: Item | None) -> None:
        if item is None:
            return
        first = next((known for (name, _), known in self.items.items() if name == key[0]), item) if key[1] else item
        if isinstance(first, Text) != isinstance(item, Text):
            self._wrong(f"{key[0]} is a text in one variant and a number in another", "Rename one of the two.")
        self.items[key] = item

    def _listed(self, name: str, heading: tuple[str, ...]) -> dict[Key, _SheetRow]:
        """Return the rows of the sheet of single values or texts."""
        results: dict[Key, _SheetRow] = {}
        if name not in self.book.names:
            return results
        for row in _rows(sheet_of(self.book, name), None, heading, self.findings):
            if row.key in results:
                self._wrong(f"{row.place('name')} repeats the name {row.name}", "Delete one of the two rows.")
            results.setdefault(row.key, row)
        return results

    def _take(self, row: _SheetRow, singles: dict[Key, _SheetRow], texts: dict[Key, _SheetRow]) -> None:
        kind, sheet = row.text("kind").strip().casefold(), row.text("sheet").strip()
        if kind not in KINDS:
            remedy = nearest(kind, KINDS) or f"Must be one of: {', '.join(KINDS)}."
            self._wrong(f"{row.place('kind')} must be a kind of parameter, got {row.text('kind')[:60]!r}", remedy)
            return
        text_kind = next((one for one in TEXT_KINDS if one == kind), None)
        if text_kind or sheet.casefold() == SCALARS.casefold() or kind == "scalar":
            listed, name = (texts, TEXTS) if text_kind else (singles, SCALARS)
            if row.key not in listed:
                self._wrong(f"{row.place('name')} names {row.name}, which is not on the sheet {name}", "Add it there.")
                return
            found = listed[row.key]
            self._hold(row.key, _text(found, text_kind, row.text("unit")) if text_kind else self._single(found))
        elif sheet not in self.book.names:
            message = f"{row.place('sheet')} refers to the unknown sheet {sheet!r}"
            self._wrong(message, nearest(sheet, self.book.names) or "Write the name of the sheet with its numbers.")
        elif self.users.setdefault(sheet, row.place("name")) != row.place("name"):
            message = f"{row.place('sheet')} refers to the sheet {sheet!r}, which {self.users[sheet]} already uses"
            self._wrong(message, "Each table needs its own sheet.")
        else:
            self._hold(row.key, self._table(row, kind, sheet_of(self.book, sheet)))

    def _single(self, row: _SheetRow) -> Parameter | None:
        if "value" not in row.columns:
            self._wrong(f"Sheet {row.sheet.name} has no column 'value'")
            return None
        number = read_number(row.sheet, row.row, row.columns["value"], self.findings)
        if number is None:
            return None
        attributes = row.labels() | {"unit": row.text("unit")}
        size = row.text("size").split("x")
        if size == [""]:
            return Scalar(row.name, number, **attributes)
        if any(word.strip() != "1" for word in size) or len(size) > 4:
            self._wrong(f"{row.place('size')} contains {row.text('size')!r}, but there is one value")
            return None
        return Block(row.name, np.full([1] * len(size), number), **attributes)

    def _table(self, row: _SheetRow, kind: str, sheet: Sheet) -> Parameter | None:
        grid = read_grid(sheet, self.findings)
        if grid is None:
            return None
        attributes = row.labels() | {"unit": row.text("unit")}
        if kind == "block":
            return Block(row.name, grid.values, **attributes)
        least, most = _TABLES[kind]
        if not least <= len(grid.axes) <= most:
            self._wrong(f"Sheet {sheet.name} has a table of {len(grid.axes)} dimensions, which does not fit a {kind}")
            return None
        axes = [self._table_axis(sheet, cells) for cells in grid.axes]
        if None in axes:
            return None
        return self._made(row, grid, [axis for axis in axes if axis is not None], attributes)

    def _made(self, row: _SheetRow, grid: Grid, axes: list[Axis], attributes: dict[str, Any]) -> Parameter | None:
        try:
            return parameter(row.name, grid.values, axes, **attributes)
        except ArgumentError as error:
            self._wrong(str(error))
            return None

    def _table_axis(self, sheet: Sheet, cells: AxisCells) -> Axis | None:
        if cells.group:
            if cells.group in self.broken:
                return None
            where, known = self.groups.setdefault(cells.group, (sheet, cells))
            if not self._agrees(sheet, cells, where, known):
                return None
        return _axis(cells, cells.group) if self._increases(sheet, cells) else None

    def _agrees(self, sheet: Sheet, cells: AxisCells, where: Sheet, known: AxisCells) -> bool:
        """Check whether the copy of a group axis equals its definition."""
        remedy = f"Edit group axes only on the sheet {AXES}, and let Excel recalculate."
        if len(cells.points) != len(known.points):
            found = f"{sheet.place(*cells.cells[0])} starts {len(cells.points)} breakpoints"
            self._wrong(f"{found}, but the group axis {cells.group} has {len(known.points)}", remedy)
            return False
        for point, cell, other, place in zip(cells.points, cells.cells, known.points, known.cells, strict=True):
            if point != other:
                origin = f"{other:.15g} of the group axis {cells.group} in {where.place(*place)}"
                self._wrong(f"{sheet.place(*cell)} contains {point:.15g} instead of {origin}", remedy)
                return False
        return True

    def _increases(self, sheet: Sheet, cells: AxisCells) -> bool:
        for before, after, place in zip(cells.points, cells.points[1:], cells.cells[1:], strict=False):
            if after <= before:
                shown = f"{sheet.place(*place)} contains {after:.15g}"
                message = f"{shown}, which does not exceed the previous breakpoint {before:.15g}"
                self._wrong(message, "Each breakpoint must be greater than the previous one.")
                return False
        return True

    def _read_groups(self) -> None:
        if AXES not in self.book.names:
            return
        sheet = sheet_of(self.book, AXES)
        for row in _rows(sheet, None, AXES_HEADING, self.findings):
            name = row.text(AXES_HEADING[0]).strip()
            start = row.columns.get("breakpoints", len(AXES_HEADING) - 1)
            cells = _breakpoints(sheet, row.row, start, self.findings)
            if name in self.groups:
                self._wrong(f"{row.place(AXES_HEADING[0])} repeats the name {name}", "Delete one of the two rows.")
            elif cells is None or not self._increases(sheet, cells):
                self.broken.add(name)
            else:
                cells.input, cells.unit = row.text("input"), row.text("unit")
                self.groups[name] = (sheet, cells)


def _text(row: _SheetRow, kind: TextKind = "text", unit: str = "") -> Text:
    return Text(row.name, row.text("text"), kind=kind, unit=unit, **row.labels())


def _breakpoints(sheet: Sheet, row: int, start: int, findings: Findings) -> AxisCells | None:
    end = start
    while sheet.cell(row, end) is not None:
        end += 1
    if not number_fault(sheet.cell(row, end + 1)) or end == start:
        findings.error(0, "", f"{sheet.place(row, end)} is empty; a breakpoint is missing")
        return None
    points = [read_number(sheet, row, column, findings) for column in range(start, end)]
    known = [point for point in points if point is not None]
    return AxisCells(known, [(row, c) for c in range(start, end)]) if len(known) == len(points) else None


def _axis(cells: AxisCells, name: str) -> Axis:
    return Axis(cells.points, cells.input, cells.unit, name)
