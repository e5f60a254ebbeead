"""Workbooks opened with care: what a hostile or damaged .xlsx could unpack to is bounded before it is read."""

import re
import zipfile
import zlib
from collections import Counter
from dataclasses import dataclass
from datetime import date, time, timedelta
from io import BytesIO
from typing import Any

from kennfeld.calfiles.excel_sheets import INDEX, INDEX_HEADING, column_letters
from kennfeld.calfiles.format import Source
from kennfeld.errors import InputError

__all__ = [
    "Sheet",
    "Workbook",
    "index_heading",
    "is_calibration_workbook",
    "looks_like_a_workbook",
    "number_fault",
    "opened",
]

_ZIP = b"PK\x03\x04"
_MOST_BYTES = 200_000_000  # unpacked, of all parts that are read
_MOST_CELLS = 5_000_000  # of the rectangle of a sheet
_MOST_PARTS = 100_000
_NEEDED = re.compile(
    r"\[Content_Types\]\.xml|_rels/\.rels|xl/(workbook|sharedStrings|styles)\.xml|xl/_rels/.*|xl/worksheets/[^/]*\.xml",
    re.IGNORECASE,
)
_SHEET = re.compile(r"xl/worksheets/[^/]*\.xml", re.IGNORECASE)
_PLACE = re.compile(rb"""\br\s*=\s*["']\s*([A-Za-z]*)([0-9]+)""")  # of a cell, or of a row
_ELEMENT = re.compile(rb"<(?:\w+:)?(c|row)[\s/>]")
_MOST_DIGITS = 9
_SHEET_NAME = re.compile(rb'<(?:\w+:)?sheet\s[^>]*?name="([^"]*)"')
_OPEN_ANEW = "Open it in Excel and save it anew."


@dataclass(frozen=True)
class Sheet:
    """The cells of one sheet; rows and columns are counted from 0."""

    name: str
    rows: list[list[object]]

    def cell(self, row: int, column: int) -> object:
        """What a cell holds; None where it is empty, or beyond the last one."""
        if row >= len(self.rows) or column >= len(self.rows[row]):
            return None
        value = self.rows[row][column]
        return None if value == "" else value

    def text(self, row: int, column: int) -> str:
        """What a cell shows, as text."""
        value = self.cell(row, column)
        return "" if value is None else f"{value:.15g}" if isinstance(value, float) else str(value)

    def width(self, row: int) -> int:
        """How many columns a row has at most."""
        return len(self.rows[row]) if row < len(self.rows) else 0

    def place(self, row: int, column: int) -> str:
        """How a message names a cell.

        >>> Sheet("MapX", []).place(3, 2)
        'Sheet MapX cell C4'
        """
        return f"Sheet {self.name} cell {column_letters(column)}{row + 1}"


def number_fault(value: object) -> str:
    """Why a cell is no number; empty for a number."""
    if value is None:
        return "is empty; a number is missing"
    if isinstance(value, bool):
        return f"holds {value}, which is no number"
    if isinstance(value, (date, time, timedelta)):
        return "holds a date or time, which is no number"
    return "" if isinstance(value, (int, float)) else f"holds {str(value)[:60]!r}, which is no number"


class Workbook:
    """A workbook whose sheets are read when they are asked for."""

    def __init__(self, source: Source, book: Any) -> None:
        self.names: list[str] = list(book.sheet_names)
        self._source = source
        self._book = book

    def sheet(self, name: str) -> Sheet:
        """The cells of a sheet; raises `InputError` where it is damaged."""
        import python_calamine

        try:
            return Sheet(name, self._book.get_sheet_by_name(name).to_python(skip_empty_area=False))
        except python_calamine.WorksheetNotFound:
            return Sheet(name, [])  # a chart
        except _damage() as error:
            raise _damaged(self._source, error) from None
        except BaseException as error:
            raise _told(self._source, error) from None


def looks_like_a_workbook(source: Source) -> bool:
    """Whether a file, of which the beginning may suffice, is an .xlsx."""
    if not source.raw.startswith(_ZIP):
        return False
    try:
        with zipfile.ZipFile(BytesIO(source.raw)) as archive:
            return "xl/workbook.xml" in archive.namelist()
    except (zipfile.BadZipFile, OSError, NotImplementedError, ValueError):
        return b"xl/" in source.raw or source.raw[30:49] == b"[Content_Types].xml"


def is_calibration_workbook(source: Source) -> bool:
    """Whether an .xlsx holds parameters rather than measured data: it has the index that lists them."""
    if not source.raw.startswith(_ZIP):
        return False
    try:
        with zipfile.ZipFile(BytesIO(source.raw)) as archive:
            names = _SHEET_NAME.findall(_unpacked(archive, archive.getinfo("xl/workbook.xml"), 10_000_000))
        if INDEX.encode() not in names:
            return False
        book = opened(source)
        return index_heading(book.sheet(INDEX)) is not None
    except (InputError, KeyError):
        return False
    except _damage():
        return False


def index_heading(sheet: Sheet) -> int | None:
    """The row with the headings of the index."""
    for row in range(min(len(sheet.rows), 50)):
        words = {str(cell).strip().casefold() for cell in sheet.rows[row]}
        if {INDEX_HEADING[0], INDEX_HEADING[1], INDEX_HEADING[-1]} <= words:
            return row
    return None


def opened(source: Source) -> Workbook:
    """The workbook, of which nothing is read that would not fit into memory.

    Raises `InputError` where it is damaged, encrypted or larger than a workbook of a person.
    """
    import python_calamine

    try:
        checked = _repacked(source)
        return Workbook(source, python_calamine.CalamineWorkbook.from_filelike(checked))
    except python_calamine.PasswordError:
        raise InputError.of(source.name, "the workbook is protected by a password", "Save it without one.") from None
    except _damage() as error:
        raise _damaged(source, error) from None
    except BaseException as error:
        raise _told(source, error) from None


def _repacked(source: Source) -> BytesIO:
    """The parts of the workbook that hold cells, in an archive whose sizes are true.

    An archive may state other sizes than its parts unpack to, so each part is unpacked here within a bound.
    """
    made, left = BytesIO(), _MOST_BYTES
    with zipfile.ZipFile(BytesIO(source.raw)) as archive, zipfile.ZipFile(made, "w", zipfile.ZIP_STORED) as plain:
        parts = archive.infolist()
        if len(parts) > _MOST_PARTS:
            raise InputError.of(source.name, f"has {len(parts)} parts", _OPEN_ANEW)
        for part in parts:
            if not _NEEDED.fullmatch(part.filename):
                continue
            raw = _unpacked(archive, part, left)
            if raw is None:
                what = f"unpacks to more than {_MOST_BYTES // 1_000_000} MB"
                raise InputError.of(source.name, what, "Delete what is no part of the calibration.")
            left -= len(raw)
            if _SHEET.fullmatch(part.filename):
                _check_extent(source, part.filename, raw)
            plain.writestr(part.filename, raw)
    made.seek(0)
    return made


def _unpacked(archive: zipfile.ZipFile, part: zipfile.ZipInfo, most: int) -> Any:
    """The bytes of a part; None where they are more than `most`."""
    if part.file_size > most:
        return None
    with archive.open(part) as stream:
        raw = stream.read(most + 1)
    return raw if len(raw) <= most else None


def _check_extent(source: Source, part: str, raw: bytes) -> None:
    """Refuse a sheet whose rectangle would not fit: one stray cell in the last row and column is enough for that."""
    if b"\0" in raw:
        raise InputError.of(source.name, f"{part} is encoded in a way that Excel does not write", _OPEN_ANEW)
    width = height = places = 0
    columns: dict[bytes, int] = {}
    for found in _PLACE.finditer(raw):
        letters, row = found[1], found[2]
        if letters not in columns:
            columns[letters] = _position(letters.upper()[:_MOST_DIGITS])
            width = max(width, columns[letters])
        places += bool(letters)
        height = max(height, int(row[:_MOST_DIGITS]))
    # What states no place of its own follows what was before it.
    kinds = Counter(found[1] for found in _ELEMENT.finditer(raw))
    if kinds[b"c"] > places:
        width += kinds[b"c"] - places
    height += kinds[b"row"]
    if kinds[b"c"] > _MOST_CELLS:
        raise InputError.of(source.name, f"{part} has more than {_MOST_CELLS} cells", "Delete what is no table.")
    if width * height > _MOST_CELLS:
        what = f"{part} spans up to {height} rows and {width} columns"
        raise InputError.of(source.name, what, "Delete the stray cells far from the table.")


def _position(letters: bytes) -> int:
    position = 0
    for letter in letters:
        position = 26 * position + letter - 64
    return position


def _damage() -> tuple[type[BaseException], ...]:
    import python_calamine

    unpacking = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
    return (python_calamine.CalamineError, OSError, ValueError, OverflowError, *unpacking)


def _told(source: Source, error: BaseException) -> BaseException:
    """A panic within the library, which is no `Exception`, as damage; anything else as it is."""
    return _damaged(source, error) if type(error).__name__ == "PanicException" else error


def _damaged(source: Source, error: BaseException) -> InputError:
    return InputError.of(source.name, f"the workbook cannot be read ({error})", _OPEN_ANEW)
