"""The layout of a calibration workbook, shared by its reader and writer.

    Parameters   the index: one row per parameter, with the sheet of its values
    Scalars      one row per single value
    Texts        one row per text
    Axes         one row per group axis, where it is edited; tables refer to it by formulas
    MapX         one sheet per table: its axes, then the numbers

A table has x to the right and y down; the cell above and left of the numbers says so (`y down / x right`). Breakpoints
rise, or fall if those of the axis do in files. Higher dimensions are tables below each other, each with its breakpoints
in a row `z | 0.5` above it.
"""

import re
import zipfile
from collections.abc import Iterable
from datetime import date, time, timedelta
from io import BytesIO
from math import isfinite, nan

from kennfeld.base.archives import ZIP_ERRORS
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.workbooks import Workbook, column_letters, open_workbook
from kennfeld.calfiles.content import parse_float
from kennfeld.calfiles.format import FileFindings
from kennfeld.domain.texts import TextKind
from kennfeld.files.head import FileHead

INDEX, SCALARS, TEXTS, AXES = "Parameters", "Scalars", "Texts", "Axes"
_LABELS = ("functions", "display name", "variant")
INDEX_HEADING = ("name", "kind", "size", "unit", "description", *_LABELS, "sheet")
SCALARS_HEADING = ("name", "value", "unit", "description", *_LABELS, "size")
TEXTS_HEADING = ("name", "text", "description", *_LABELS)
AXES_HEADING = ("group axis", "unit", "input", "breakpoints")
AXIS_HEADING = ("axis", "input", "unit", "group axis")
CORNERS = ("x right", "y down / x right")  # of one direction, of two and more
TEXT_KINDS: tuple[TextKind, ...] = ("text", "enumeration", "boolean")
KINDS = ("scalar", "block", "curve", "map", "cube", *TEXT_KINDS)
_MAX_SEARCHED = 200_000_000  # bytes of a workbook that may hold parameters
_MAX_NAME_LENGTH = 31  # characters, a limit of Excel
_INVALID_IN_NAME = re.compile(r"[\[\]:*?/\\\x00-\x1f]")

_ZIP = b"PK\x03\x04"
_MAX_SHEET_LIST = 10_000_000  # bytes; no list of sheets is longer
_SHEET_NAME = re.compile(rb'<(?:\w+:)?sheet\s[^>]*?name="([^"]*)"')


def sheet_names(names: Iterable[str]) -> list[str]:
    """Return a name that Excel accepts for each sheet, different from the others without regard to case.

    >>> sheet_names(["MapX", "mapx", "a[0]", "Axes"])
    ['MapX', 'mapx (2)', 'a(0)', 'Axes (2)']
    """
    # Excel keeps the name History for itself
    taken = {name.casefold() for name in (INDEX, SCALARS, TEXTS, AXES, "History")}
    sheets = []
    for name in names:
        valid = _INVALID_IN_NAME.sub("_", name.replace("[", "(").replace("]", ")")).strip("' ") or "_"
        sheet, number = valid[:_MAX_NAME_LENGTH].rstrip("' "), 1
        while sheet.casefold() in taken or not sheet:
            number += 1
            ending = f" ({number})"
            sheet = valid[: _MAX_NAME_LENGTH - len(ending)] + ending
        taken.add(sheet.casefold())
        sheets.append(sheet)
    return sheets


@dataclass(frozen=True)
class Sheet:
    """The cells of one sheet; rows and columns are counted from 0."""

    name: str
    rows: list[list[object]]
    findings: FileFindings

    def cell(self, row: int, column: int) -> object:
        """Return the value of a cell; None if it is empty or beyond the last one."""
        if row >= len(self.rows) or column >= len(self.rows[row]):
            return None
        value = self.rows[row][column]
        return None if value == "" else value

    def text(self, row: int, column: int) -> str:
        """Return the value of a cell as text."""
        value = self.cell(row, column)
        # Excel shows at most 15 digits
        return "" if value is None else f"{value:.15g}" if isinstance(value, float) else str(value)

    def words(self, row: int) -> list[str]:
        """Return the texts of a row without regard to case."""
        return [str(cell).strip().casefold() for cell in self.rows[row]]

    def place(self, row: int, column: int) -> str:
        """Return the location of a cell for messages: `Sheet MapX cell C4`."""
        return f"Sheet {self.name} cell {column_letters(column)}{row + 1}"

    def error(self, message: str, remedy: str = "") -> None:
        """Add an error, whose message names the cell."""
        self.findings.error(0, "", message, remedy)

    def has_number(self, row: int, column: int) -> bool:
        return not number_fault(self.cell(row, column))

    def number(self, row: int, column: int) -> float | None:
        """Return the number of a cell; None, with an error, if it contains none."""
        value = self.cell(row, column)
        fault = number_fault(value)
        number = float(value) if isinstance(value, (int, float)) and not fault else nan
        if fault:
            is_text = isinstance(value, str) and isfinite(parse_float(value.replace(",", ".")))
            remedy = "Write it as a number: the cell contains text." if is_text else "Write a number."
            self.error(f"{self.place(row, column)} {fault}", remedy)
        elif not isfinite(number):
            self.error(f"{self.place(row, column)} must be finite, got {number}")
        return number if isfinite(number) else None

    def breakpoints(self, cells: list[tuple[int, int]]) -> "AxisCells | None":
        """Return the breakpoints in some cells; None, with an error for each cell that contains no number."""
        points = [self.number(*cell) for cell in cells]
        numbers = [point for point in points if point is not None]
        return AxisCells(numbers, cells) if len(numbers) == len(points) else None


@dataclass
class AxisCells:
    """The breakpoints of one direction, the cell of each, and what the sheet says about the axis."""

    points: list[float]
    cells: list[tuple[int, int]]
    input: str = ""
    unit: str = ""
    group: str = ""


def number_fault(value: object) -> str:
    """Return why a cell is not a number; empty for a number."""
    if value is None:
        return "must be a number, but is empty"
    if isinstance(value, bool):
        return f"must be a number, got {value}"
    if isinstance(value, (date, time, timedelta)):
        return "must be a number, got a date or time"
    return "" if isinstance(value, (int, float)) else f"must be a number, got {str(value)[:60]!r}"


def holds_calibration(head: FileHead) -> bool:
    """Check whether a workbook holds parameters rather than measured data: it has the index that lists them."""
    if not head.raw.startswith(_ZIP):
        return False
    raw = head.whole(_MAX_SEARCHED)
    try:
        # most workbooks are measured data, which the list of their sheets shows without opening them
        with zipfile.ZipFile(BytesIO(raw)) as archive, archive.open("xl/workbook.xml") as stream:
            names = _SHEET_NAME.findall(stream.read(_MAX_SHEET_LIST))
        if INDEX.encode() not in names:
            return False
        book = open_workbook(head.name, raw)
        return index_heading(sheet_of(book, INDEX, FileFindings(head.name))) is not None
    except (InputError, OSError, *ZIP_ERRORS):
        return False


def index_heading(sheet: Sheet) -> int | None:
    """Return the row with the headings of the index."""
    for row in range(min(len(sheet.rows), 50)):
        if {INDEX_HEADING[0], INDEX_HEADING[1], INDEX_HEADING[-1]} <= set(sheet.words(row)):
            return row
    return None


def sheet_of(book: Workbook, name: str, findings: FileFindings) -> Sheet:
    """Return the cells of a sheet; raises `InputError` if it is damaged, or formulas in it have no saved values."""
    if (unsaved := book.unsaved_formulas(name)) is not None:
        raise InputError.of(Location(book.name), str(unsaved), unsaved.remedy)
    return Sheet(name, book.cells(name), findings)
