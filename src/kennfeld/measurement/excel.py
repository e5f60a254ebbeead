"""Reads spreadsheets: xlsx, xlsm, xlsb, xls, ods."""

import re
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kennfeld.archives import overgrown
from kennfeld.errors import InputError, nearest
from kennfeld.measurement.cells import is_missing
from kennfeld.measurement.columns import ColumnBuilder, Selection, Table
from kennfeld.measurement.header import Header, find_header
from kennfeld.measurement.panic import panics
from kennfeld.measurement.sniff import Source
from kennfeld.measurement.xlsb import check_end, extent_of

__all__ = ["column_letters", "read_tables"]

_HEAD_ROWS = 200
_CELLS = 60_000_000  # of a sheet's rectangle; the reader holds them all
_SHEET = re.compile(r"xl/worksheets/.*\.(?:xml|bin)")
_BINARY = 1_000_000_000  # bytes of a sheet of a binary workbook, unpacked
_FAR = re.compile(rb'\sr="([A-Z]{2,})[0-9]')
_ROW = re.compile(rb'\sr="[A-Z]{1,3}([0-9]{1,30})"')
_ROW_FAR = re.compile(rb'\sr="[A-Z]{1,3}([0-9]{7,30})"')


def read_tables(source: Source, selection: Selection) -> list[Table]:
    """The numeric tables of a workbook, one a sheet; of the sheet alone that `source` names."""
    with source.path.open("rb") as stream:
        _check_size(source)
        book = _workbook(source, stream)
        sheets = _sheets(source, book)
        tables = [_table(source, name, _grid(source, book, name), selection) for name in sheets]
    found = [table for table in tables if table is not None]
    if not found:
        where = f"sheet {sheets[0]}" if len(sheets) == 1 else f"none of its {len(sheets)} sheets"
        what = f"{where} holds {'no' if len(sheets) == 1 else 'a'} row of names with numbers below"
        raise InputError.of(source.name, what, "Put the names of the channels into the row above the numbers.")
    return found


def _check_size(source: Source) -> None:
    """Refuse a sheet whose rectangle would not fit: one stray cell in the last row and column is enough for that."""
    if not zipfile.is_zipfile(source.path):
        return
    try:
        with zipfile.ZipFile(source.path) as archive:
            if bomb := overgrown(archive):
                raise InputError.of(source.name, bomb, "Such a file is made to exhaust a machine; export it anew.")
            if "xl/workbook.bin" in archive.namelist():
                check_end(archive.read("xl/workbook.bin"))
            sheets = [m for m in archive.infolist() if _SHEET.fullmatch(m.filename)]
            extents = [(sheet.filename, *_extent(archive, sheet)) for sheet in sheets]
    except _damage() as error:
        raise _damaged(source, error) from None
    for name, width, height in extents:
        if width * height > _CELLS:
            what = f"{name} spans {height} rows and {width} columns"
            raise InputError.of(source.name, what, "Delete the stray cells far from the table.")


def _extent(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[int, int]:
    """Columns and rows of the rectangle that holds all cells.

    Rows follow each other in a file, so that the last cell of each chunk and rows beyond a million are enough; where
    a row out of order could matter, every cell is looked at.
    """
    if member.filename.endswith(".bin"):
        return (_CELLS, 2) if member.file_size > _BINARY else extent_of(archive.read(member))
    width = height = 1
    for text in _chunks(archive, member):
        width = max([width, *(_position(letters) for letters in set(_FAR.findall(text)))])
        last = text.rfind(b' r="')
        rows = set(_ROW_FAR.findall(text)) | set(_ROW.findall(text, max(last, 0)))
        height = max([height, *map(int, rows)])
    width = max(width, 26)
    if width * 1_000_000 > _CELLS:
        height = max([height, *(int(row) for text in _chunks(archive, member) for row in set(_ROW.findall(text)))])
    return width, height


def _chunks(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Iterator[bytes]:
    """The text of a member in parts that overlap by more than a cell reference."""
    tail = b""
    with archive.open(member) as stream:
        while chunk := stream.read(1 << 20):
            yield tail + chunk
            tail = chunk[-64:]


def _position(letters: bytes) -> int:
    position = 0
    for letter in letters:
        position = 26 * position + letter - 64
    return position


def _workbook(source: Source, stream: Any) -> Any:
    import python_calamine

    try:
        with panics():
            return python_calamine.CalamineWorkbook.from_filelike(stream)
    except python_calamine.PasswordError:
        raise InputError.of(source.name, "the workbook is protected by a password", "Save it without one.") from None
    except _damage() as error:
        raise _damaged(source, error) from None


def _damage() -> tuple[type[BaseException], ...]:
    import python_calamine

    unpacking = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
    return (python_calamine.CalamineError, OSError, ValueError, *unpacking)


def _damaged(source: Source, error: BaseException) -> InputError:
    return InputError.of(source.name, f"the workbook cannot be read ({error})", "Open it in Excel and save it anew.")


def _sheets(source: Source, book: Any) -> list[str]:
    visible = [
        s.name for s in book.sheets_metadata if str(s.visible).endswith("Visible") and "Hidden" not in str(s.visible)
    ]
    if source.sheet is None:
        return visible or list(book.sheet_names)
    if source.sheet not in book.sheet_names:
        listed = ", ".join(book.sheet_names)
        mend = nearest(source.sheet, book.sheet_names) or f"It has {listed}."
        raise InputError.of(source.name, f"has no sheet {source.sheet}", mend)
    return [source.sheet]


def _grid(source: Source, book: Any, name: str) -> list[list[object]]:
    import python_calamine

    try:
        with panics():
            grid: list[list[object]] = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
    except python_calamine.WorksheetNotFound:
        return []  # a chart
    except _damage() as error:
        raise _damaged(source, error) from None
    return grid


def _table(source: Source, sheet: str, grid: list[list[object]], selection: Selection) -> Table | None:
    header = find_header(grid[:_HEAD_ROWS])
    if header is None:
        return None
    rows = [i for i in range(header.data, len(grid)) if any(not _is_blank(cell) for cell in grid[i])]
    return Table(
        f"{source.name} sheet {sheet}",
        tuple(_column(header, i, [grid[row][i] for row in rows]) for i in selection.wants(header)),
        np.array(rows, dtype=np.int64) + 1,
        row_word="row",
        names=header.names,
        details=(("sheet", sheet), ("names in row", str(header.row + 1))),
    )


def _is_blank(cell: object) -> bool:
    return isinstance(cell, str) and is_missing(cell) and not cell.strip()


def _column(header: Header, index: int, cells: Sequence[object]) -> Any:
    name = header.names[index]
    builder = ColumnBuilder(name, header.units[index], f"{column_letters(index)} ({name})")
    builder.add(cells)
    return builder.built()


def column_letters(index: int) -> str:
    """The letters of a spreadsheet column, counted from 0.

    >>> column_letters(0), column_letters(27)
    ('A', 'AB')
    """
    letters = ""
    index += 1
    while index:
        index, rest = divmod(index - 1, 26)
        letters = chr(65 + rest) + letters
    return letters
