"""Opens .xlsx, .xlsm, .xlsb, .xls and .ods files and reads the cells of their sheets.

The library that reads them is written in Rust and panics on some damaged files.
"""

import os
import re
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import Any, BinaryIO

from kennfeld.archives import find_oversized
from kennfeld.errors import InputError
from kennfeld.workbooks.biff import check_records
from kennfeld.workbooks.compound import MAGIC, workbook_stream
from kennfeld.workbooks.formulas import Unsaved, unsaved_formulas
from kennfeld.workbooks.sheet_extent import OVERLAP, check_end, extent_of, extent_of_text

_MAX_CELLS = 60_000_000  # of a sheet's rectangle; the reader holds them all
_MAX_PARTS = 100_000
_MAX_BINARY_BYTES = 1_000_000_000  # bytes of a sheet of a binary workbook, unpacked
_SHEET = re.compile(r"xl/worksheets/.*\.(?:xml|bin)", re.IGNORECASE)
_CHUNK = 1 << 20
_SAVE_AGAIN = "Open it in Excel and save it again."


class PanicError(ValueError):
    """The library panicked; the text is its message."""


@contextmanager
def panics() -> Iterator[None]:
    """Convert panics, which are not an `Exception`, to `PanicError`, and suppress what the library prints."""
    try:
        with _no_stderr():
            yield
    except BaseException as error:
        if type(error).__name__ != "PanicException":  # a class that no module offers
            raise
        said = str(error)
    else:
        return
    raise PanicError(said)


@contextmanager
def _no_stderr() -> Iterator[None]:
    try:
        kept = os.dup(2)
    except OSError:  # a program without a console
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def column_letters(index: int) -> str:
    """Return the letters of a spreadsheet column, counted from 0.

    >>> column_letters(0), column_letters(27)
    ('A', 'AB')
    """
    letters = ""
    index += 1
    while index:
        index, rest = divmod(index - 1, 26)
        letters = chr(65 + rest) + letters
    return letters


class Workbook:
    """A workbook whose sheets are read on demand."""

    def __init__(self, name: str, book: Any, content: BinaryIO) -> None:
        self.name = name
        self._book, self._content = book, content

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
        """Return the rows of a sheet from its first cell on, empty cells as ""; `InputError` if it is damaged."""
        import python_calamine

        try:
            with panics():
                rows: list[list[object]] = self._book.get_sheet_by_name(sheet).to_python(skip_empty_area=False)
        except python_calamine.WorksheetNotFound:
            return []  # a chart
        except _damage_errors() as error:
            raise _damaged_error(self.name, error) from None
        return rows

    def unsaved(self, sheet: str) -> Unsaved | None:
        """Return the formulas of a sheet whose values were not saved, so that their cells look empty."""
        try:
            if not zipfile.is_zipfile(self._content):
                return None
            with zipfile.ZipFile(self._content) as archive:
                return unsaved_formulas(archive, sheet)
        except _damage_errors() as error:
            raise _damaged_error(self.name, error) from None


def opened(name: str, content: BinaryIO | bytes) -> Workbook:
    """Open a workbook from a file or bytes, which must stay open while it is used; `name` is for findings.

    Raises `InputError` if it is damaged, encrypted, or asks for more memory than a table needs.
    """
    import python_calamine

    stream = BytesIO(content) if isinstance(content, bytes) else content
    try:
        if zipfile.is_zipfile(stream):
            with zipfile.ZipFile(stream) as archive:
                _check(name, archive)
        stream.seek(0)
        if stream.read(len(MAGIC)) == MAGIC:
            check_records(workbook_stream(MAGIC + stream.read()), _MAX_CELLS)
        stream.seek(0)
        with panics():
            return Workbook(name, python_calamine.CalamineWorkbook.from_filelike(stream), stream)
    except python_calamine.PasswordError:
        raise InputError.of(name, "the workbook is protected by a password", "Save it without one.") from None
    except _damage_errors() as error:
        raise _damaged_error(name, error) from None


def _check(name: str, archive: zipfile.ZipFile) -> None:
    """Refuse what would not fit into memory: one stray cell in the last row and column suffices."""
    if len(archive.namelist()) > _MAX_PARTS:
        raise InputError.of(name, f"has {len(archive.namelist())} parts", _SAVE_AGAIN)
    if bomb := find_oversized(archive):
        raise InputError.of(name, bomb, "Such a file can exhaust the memory; export it again.")
    if "xl/workbook.bin" in archive.namelist():
        check_end(archive.read("xl/workbook.bin"))
    for member in archive.infolist():
        if not _SHEET.fullmatch(member.filename):
            continue
        width, height = _extent(archive, member)
        if width * height > _MAX_CELLS:
            message = f"{member.filename} spans up to {height} rows and {width} columns"
            raise InputError.of(name, message, "Delete the stray cells far from the table.")


def _extent(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> tuple[int, int]:
    if member.filename.lower().endswith(".bin"):
        return (_MAX_CELLS, 2) if member.file_size > _MAX_BINARY_BYTES else extent_of(archive.read(member))
    return extent_of_text(lambda: _chunks(archive, member))


def _chunks(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Iterator[bytes]:
    tail = b""
    with archive.open(member) as stream:
        while chunk := stream.read(_CHUNK):
            if b"\0" in chunk:
                raise ValueError(f"{member.filename} is encoded in a way that Excel does not write")
            yield tail + chunk
            tail = chunk[-OVERLAP:]


def _damage_errors() -> tuple[type[BaseException], ...]:
    import python_calamine

    unpacking = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
    return (python_calamine.CalamineError, OSError, ValueError, OverflowError, *unpacking)


def _damaged_error(name: str, error: BaseException) -> InputError:
    return InputError.of(name, f"the workbook cannot be read ({error})", _SAVE_AGAIN)
