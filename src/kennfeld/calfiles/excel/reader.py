"""Reads a calibration workbook: its index lists the parameters and the sheets of their values."""

from dataclasses import field
from typing import Any

import numpy as np

from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.workbooks import Workbook, open_workbook
from kennfeld.calfiles.content import in_rising_order, turn
from kennfeld.calfiles.excel import layout
from kennfeld.calfiles.excel.layout import AxisCells, Sheet, index_heading, sheet_of
from kennfeld.calfiles.excel.tables import read_grid
from kennfeld.calfiles.format import CalibrationSource, FileFindings, Item, Key, ReadResult, build_set
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Block, Parameter, Scalar, parameter
from kennfeld.domain.texts import Text, TextKind

_TABLES = {"curve": (1, 1), "map": (2, 2), "cube": (3, 4)}  # the least and the most axes


def read_excel(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a workbook with an index; sheets that the index does not name are the user's own.

    Of a label with several variants the first one counts. Raises `InputError` with all findings and its cell.
    """
    findings = FileFindings(source.name)
    book = open_workbook(source.name, source.raw)
    index = sheet_of(book, layout.INDEX, findings) if layout.INDEX in book.names else Sheet(layout.INDEX, [], findings)
    heading = index_heading(index)
    if heading is None:
        message = (
            f"is an Excel workbook without a sheet {layout.INDEX} that lists name, kind and sheet of each parameter"
        )
        raise InputError.of(Location(source.name), message, "Use a workbook of measured data as a dataset.")
    reader = _SheetReader(book, findings)
    reader.read(_rows(index, heading, layout.INDEX_HEADING))
    warnings = findings.finish()
    axes = [_axis(cells, name) for name, (_, cells) in reader.groups.items()]
    return ReadResult("Excel", build_set(reader.items, axes), warnings)


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


def _rows(sheet: Sheet, heading: int | None, words: tuple[str, ...]) -> list[_SheetRow]:
    """Return the rows of a list below its headings, whose columns may have moved."""
    if heading is None:
        heading = next((row for row in range(min(len(sheet.rows), 50)) if words[0] in sheet.words(row)), None)
    if heading is None:
        sheet.error(f"Sheet {sheet.name} has no header row", f"Its first row must be: {', '.join(words)}.")
        return []
    headings = sheet.words(heading)
    columns = {word: headings.index(word) for word in words if word in headings}
    first = columns.get(words[0], 0)
    rows = range(heading + 1, len(sheet.rows))
    return [_SheetRow(sheet, row, columns) for row in rows if sheet.text(row, first).strip()]


@dataclass
class _SheetReader:
    book: Workbook
    findings: FileFindings
    items: dict[Key, Item] = field(default_factory=dict)
    groups: dict[str, tuple[Sheet, AxisCells]] = field(default_factory=dict)
    broken: set[str] = field(default_factory=set)  # group axes with a finding of their own
    users: dict[str, str] = field(default_factory=dict)  # the parameter whose table is on a sheet

    def read(self, index: list[_SheetRow]) -> None:
        """Read all items of the index in order, then single values that were added elsewhere."""
        if layout.AXES in self.book.names:
            self._read_groups(sheet_of(self.book, layout.AXES, self.findings))
        singles = self._listed(layout.SCALARS, layout.SCALARS_HEADING)
        texts = self._listed(layout.TEXTS, layout.TEXTS_HEADING)
        seen: dict[Key, _SheetRow] = {}
        for row in index:
            if seen.setdefault(row.key, row) is row:
                self._take(row, singles, texts)
            else:
                self._wrong(f"{row.place('name')} repeats the name {row.name}", "Delete one of the two rows.")
        for key, row in {**singles, **texts}.items():
            if key not in seen:
                self._hold(key, self._single(row) if key in singles else _text(row))

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
        for row in _rows(sheet_of(self.book, name, self.findings), None, heading) if name in self.book.names else ():
            if results.setdefault(row.key, row) is not row:
                self._wrong(f"{row.place('name')} repeats the name {row.name}", "Delete one of the two rows.")
        return results

    def _take(self, row: _SheetRow, singles: dict[Key, _SheetRow], texts: dict[Key, _SheetRow]) -> None:
        kind, sheet = row.text("kind").strip().casefold(), row.text("sheet").strip()
        if kind not in layout.KINDS:
            remedy = nearest(kind, layout.KINDS) or f"Must be one of: {', '.join(layout.KINDS)}."
            self._wrong(f"{row.place('kind')} must be a kind of parameter, got {row.text('kind')[:60]!r}", remedy)
            return
        text_kind = next((known for known in layout.TEXT_KINDS if known == kind), None)
        if text_kind or sheet.casefold() == layout.SCALARS.casefold() or kind == "scalar":
            listed, name = (texts, layout.TEXTS) if text_kind else (singles, layout.SCALARS)
            if row.key not in listed:
                self._wrong(f"{row.place('name')} names {row.name}, which is not on the sheet {name}", "Add it there.")
                return
            entry = listed[row.key]
            self._hold(row.key, _text(entry, text_kind, row.text("unit")) if text_kind else self._single(entry))
        elif sheet not in self.book.names:
            message = f"{row.place('sheet')} refers to the unknown sheet {sheet!r}"
            self._wrong(message, nearest(sheet, self.book.names) or "Write the name of the sheet with its numbers.")
        elif self.users.setdefault(sheet, row.place("name")) != row.place("name"):
            message = f"{row.place('sheet')} refers to the sheet {sheet!r}, which {self.users[sheet]} already uses"
            self._wrong(message, "Each table needs its own sheet.")
        else:
            self._hold(row.key, self._table(row, kind, sheet_of(self.book, sheet, self.findings)))

    def _single(self, row: _SheetRow) -> Parameter | None:
        if "value" not in row.columns:
            self._wrong(f"Sheet {row.sheet.name} has no column 'value'")
            return None
        number = row.sheet.number(row.row, row.columns["value"])
        if number is None:
            return None
        attributes = row.labels() | {"unit": row.text("unit")}
        size = row.text("size").split("x")
        # a block of one value states its size, `1 x 1`, and a scalar none
        if size == [""]:
            return Scalar(row.name, number, **attributes)
        if any(word.strip() != "1" for word in size) or len(size) > 4:
            self._wrong(f"{row.place('size')} contains {row.text('size')!r}, but there is one value")
            return None
        return Block(row.name, np.full([1] * len(size), number), **attributes)

    def _table(self, row: _SheetRow, kind: str, sheet: Sheet) -> Parameter | None:
        grid = read_grid(sheet)
        if grid is None:
            return None
        attributes = row.labels() | {"unit": row.text("unit")}
        if kind == "block":
            return Block(row.name, grid.values, **attributes)
        least, most = _TABLES[kind]
        if not least <= len(grid.axes) <= most:
            self._wrong(f"Sheet {sheet.name} has a table of {len(grid.axes)} dimensions, which does not fit a {kind}")
            return None
        candidates = [self._table_axis(sheet, cells) for cells in grid.axes]
        axes = [axis for axis in candidates if axis is not None]
        if len(axes) < len(candidates):
            return None
        try:
            return parameter(row.name, turn(grid.values, axes), axes, **attributes)
        except ArgumentError as error:
            self._wrong(str(error))
            return None

    def _table_axis(self, sheet: Sheet, cells: AxisCells) -> Axis | None:
        if cells.group:
            if cells.group in self.broken:
                return None
            # an axis that the sheet of group axes lacks is that of its first table
            home, known = self.groups.setdefault(cells.group, (sheet, cells))
            if not self._agrees(sheet, cells, home, known):
                return None
        return _axis(cells, cells.group) if self._is_ordered(sheet, cells) else None

    def _agrees(self, sheet: Sheet, cells: AxisCells, home: Sheet, known: AxisCells) -> bool:
        """Check whether the copy of a group axis equals its definition."""
        remedy = f"Edit group axes only on the sheet {layout.AXES}, and let Excel recalculate."
        if len(cells.points) != len(known.points):
            start = f"{sheet.place(*cells.cells[0])} starts {len(cells.points)} breakpoints"
            self._wrong(f"{start}, but the group axis {cells.group} has {len(known.points)}", remedy)
            return False
        for point, cell, other, place in zip(cells.points, cells.cells, known.points, known.cells, strict=True):
            if point != other:
                origin = f"{other:.15g} of the group axis {cells.group} in {home.place(*place)}"
                self._wrong(f"{sheet.place(*cell)} contains {point:.15g} instead of {origin}", remedy)
                return False
        return True

    def _is_ordered(self, sheet: Sheet, cells: AxisCells) -> bool:
        """Check whether breakpoints rise or fall; report the first one that does neither."""
        points = in_rising_order(np.array(cells.points))[0].tolist()
        for before, after, place in zip(points, points[1:], cells.cells[1:], strict=False):
            if after <= before:
                shown = f"{sheet.place(*place)} contains {after:.15g}"
                message = f"{shown}, which does not exceed the previous breakpoint {before:.15g}"
                self._wrong(message, "Each breakpoint must be greater than the previous one, or each must be less.")
                return False
        return True

    def _read_groups(self, sheet: Sheet) -> None:
        for row in _rows(sheet, None, layout.AXES_HEADING):
            name = row.text(layout.AXES_HEADING[0]).strip()
            cells = _breakpoints(sheet, row.row, row.columns.get("breakpoints", len(layout.AXES_HEADING) - 1))
            if name in self.groups:
                self._wrong(
                    f"{row.place(layout.AXES_HEADING[0])} repeats the name {name}", "Delete one of the two rows."
                )
            elif cells is None or not self._is_ordered(sheet, cells):
                self.broken.add(name)
            else:
                cells.input, cells.unit = row.text("input"), row.text("unit")
                self.groups[name] = (sheet, cells)


def _text(row: _SheetRow, kind: TextKind = "text", unit: str = "") -> Text:
    return Text(row.name, row.text("text"), kind=kind, unit=unit, **row.labels())


def _breakpoints(sheet: Sheet, row: int, start: int) -> AxisCells | None:
    end = start
    while sheet.cell(row, end) is not None:
        end += 1
    # a number behind the first empty cell belongs to the axis as well
    if end > start and not sheet.has_number(row, end + 1):
        return sheet.breakpoints([(row, column) for column in range(start, end)])
    sheet.error(f"{sheet.place(row, end)} is empty; a breakpoint is missing")
    return None


def _axis(cells: AxisCells, name: str) -> Axis:
    points, falls = in_rising_order(np.array(cells.points))
    return Axis(points, cells.input, cells.unit, name, falling=falls)
