"""Opens .xlsx, .xlsm, .xlsb, .xls and .ods files and reads the cells of their sheets.

The library that reads them is written in Rust and panics on some damaged files.
"""

import os
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import SEEK_END, BytesIO
from typing import Any, BinaryIO

from kennfeld.base.archives import ZIP_ERRORS, find_oversized, iterate_chunks
from kennfeld.base.errors import InputError, Location
from kennfeld.base.formatting import reason_of
from kennfeld.base.process_limits import memory_bound
from kennfeld.base.workbooks.biff import check_records
from kennfeld.base.workbooks.compound import MAGIC, workbook_stream
from kennfeld.base.workbooks.formulas import UnsavedFormulas, find_unsaved
from kennfeld.base.workbooks.relationships import relationship_targets
from kennfeld.base.workbooks.sheet_extent import OVERLAP, check_end, extent_of_records, extent_of_text

_MAX_CELLS = 60_000_000  # of a sheet's rectangle; the reader holds them all
_CELL = 40  # bytes of memory of an empty cell
_MAX_PARTS = 100_000
_MAX_BINARY_BYTES = 1_000_000_000  # bytes of a sheet of a binary workbook, unpacked
_SHEET = re.compile(r"xl/worksheets/.*\.(?:xml|bin)", re.IGNORECASE)
_BINARY_BOOK, _BINARY_LINKS = "xl/workbook.bin", "xl/_rels/workbook.bin.rels"
_MANIFEST = "META-INF/manifest.xml"  # of OpenDocument
_ENCRYPTED_PACKAGE = "EncryptedPackage\0".encode("utf-16-le")  # the stream of a protected .xlsx or .xlsb
_SAVE_AGAIN = "Open it in Excel and save it again."


class PanicError(ValueError):
    """The library panicked; the text is its message."""


@contextmanager
def convert_panics() -> Iterator[None]:
    """Convert panics, which are not an `Exception`, to `PanicError`, and suppress what the library prints."""
    try:
        with _no_stderr():
            yield
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # a class that no module offers
            raise
        message = str(error)
    else:
        return
    raise PanicError(message)


@contextmanager
def _no_stderr() -> Iterator[None]:
    try:
        original = os.dup(2)
    except OSError:  # a program without a console
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        # the library writes to the descriptor itself, not through Python
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(original, 2)
        os.close(original)
        os.close(nowhere)


def column_letters(index: int) -> str:
    """Return the letters of a spreadsheet column, counted from 0.

    >>> column_letters(0), column_letters(27)
    ('A', 'AB')
    """
    letters = ""
    index += 1
    while index:
        # the letters are digits from 1 to 26, without a zero
        index, rest = divmod(index - 1, 26)
        letters = chr(65 + rest) + letters
    return letters


class Workbook:
    """A workbook whose sheets are read on demand."""

    def __init__(self, name: str, book: Any, content: BinaryIO) -> None:
        self.name = name
        self._book, self._content = book, content
        self._charts = {each.name for each in book.sheets_metadata if str(each.typ).endswith("ChartSheet")}

    @property
    def names(self) -> list[str]:
        """The names of all sheets."""
        return list(self._book.sheet_names)

    @property
    def visible(self) -> list[str]:
        """The names of the sheets that are not hidden."""
        shown = (sheet for sheet in self._book.sheets_metadata if str(sheet.visible).endswith("Visible"))
        return [sheet.name for sheet in shown if "Hidden" not in str(sheet.visible)]

    def cells(self, sheet: str) -> list[list[object]]:
        """Return the rows of a sheet from its first cell on, empty cells as ""; `InputError` if it is damaged.

        A sheet that is a chart has none, although .xls stores a copy of its data there.
        """
        import python_calamine

        if sheet in self._charts:
            return []
        try:
            with _guard_damage(self.name):
                rows: list[list[object]] = self._book.get_sheet_by_name(sheet).to_python(skip_empty_area=False)
        except python_calamine.WorksheetNotFound:
            return []  # of another kind without cells
        return rows

    def unsaved_formulas(self, sheet: str) -> UnsavedFormulas | None:
        """Return the formulas of a sheet whose values were not saved, so that their cells look empty."""
        with _guard_damage(self.name):
            if not zipfile.is_zipfile(self._content):
                return None
            with zipfile.ZipFile(self._content) as archive:
                return find_unsaved(archive, sheet)


def open_workbook(name: str, content: BinaryIO | bytes) -> Workbook:
    """Open a workbook from a file or bytes, which must stay open while it is used; `name` is for findings.

    Raises `InputError` if it is damaged, encrypted, or asks for more memory than a table needs.
    """
    import python_calamine

    stream = BytesIO(content) if isinstance(content, bytes) else content
    most_cells = min(_MAX_CELLS, memory_bound(stream.seek(0, SEEK_END)) // _CELL)
    stream.seek(0)
    with _guard_damage(name):
        if zipfile.is_zipfile(stream):
            with zipfile.ZipFile(stream) as archive:
                if _MANIFEST in archive.namelist() and b"encryption-data" in archive.read(_MANIFEST):
                    raise _protected(name)
                _check_size(Location(name), archive, most_cells)
        stream.seek(0)
        if stream.read(len(MAGIC)) == MAGIC:
            package = MAGIC + stream.read()
            if _ENCRYPTED_PACKAGE in package:
                raise _protected(name)
            check_records(workbook_stream(package), most_cells)
        stream.seek(0)
        return Workbook(name, python_calamine.CalamineWorkbook.from_filelike(stream), stream)


def _check_size(location: Location, archive: zipfile.ZipFile, most_cells: int) -> None:
    """Refuse what would not fit into memory: one stray cell in the last row and column suffices."""
    if len(archive.namelist()) > _MAX_PARTS:
        raise InputError.of(location, f"has {len(archive.namelist())} parts", _SAVE_AGAIN)
    if bomb := find_oversized(archive):
        raise InputError.of(location, bomb, "Such a file can exhaust the memory; export it again.")
    if _BINARY_BOOK in archive.namelist():
        check_end(archive.read(_BINARY_BOOK))
    for member in _sheets_of(archive):
        width, height = _extent(archive, member)
        if width * height > most_cells:
            message = f"{member.filename} spans up to {height} rows and {width} columns"
            raise InputError.of(location, message, "Delete the stray cells far from the table.")


def _sheets_of(archive: zipfile.ZipFile) -> Iterator[zipfile.ZipInfo]:
    """Yield the sheets of a workbook; Excel stores an index beside each binary one, which is not a sheet."""
    names = {member.filename.replace("\\", "/"): member for member in archive.infolist()}
    links = names.get(_BINARY_LINKS)
    linked = {} if links is None else relationship_targets(archive, links.filename)
    sheets = {target.casefold() for target in linked.values()}
    for name, member in names.items():
        is_index = name.lower().endswith(".bin") and bool(sheets) and name.casefold() not in sheets
        if _SHEET.fullmatch(name) and not is_index:
            yield member


def _extent(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[int, int]:
    if member.filename.lower().endswith(".bin"):
        return (_MAX_CELLS, 2) if member.file_size > _MAX_BINARY_BYTES else extent_of_records(archive.read(member))
    return extent_of_text(lambda: _text_chunks(archive, member))


def _text_chunks(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Iterator[bytes]:
    for chunk in iterate_chunks(archive, member, OVERLAP):
        # UTF-16, in which the patterns would find nothing
        if b"\0" in chunk:
            raise ValueError(f"{member.filename} is encoded in a way that Excel does not write")
        yield chunk


@contextmanager
def _guard_damage(name: str) -> Iterator[None]:
    """Convert the errors of the libraries for damaged files to `InputError`."""
    import python_calamine

    location = Location(name)
    try:
        with convert_panics():
            yield
    except python_calamine.PasswordError:
        raise _protected(name) from None
    except python_calamine.WorksheetNotFound:
        raise
    except (python_calamine.CalamineError, OSError, OverflowError, *ZIP_ERRORS) as error:
        raise InputError.of(location, f"the workbook cannot be read ({reason_of(error)})", _SAVE_AGAIN) from None


def _protected(name: str) -> InputError:
    return InputError.of(Location(name), "the workbook is protected by a password", "Save it without one.")
