"""Determines the rectangle of a sheet's cells before a library allocates it.

The library also searches without end for missing records of a binary workbook.

Layout: Microsoft, [MS-XLSB]: records of type, size and content, where type and size take as many bytes as they need.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator

_BINARY_ROW = 0  # the record that begins a row; those up to the last kind of cell give a column
_LAST_CELL = 11
_MAX_COLUMNS, _MAX_ROWS = 16_384, 1_048_576
_END_OF_CELLS = 146
_END_OF_SHEETS = 144

# the text of a sheet in parts that overlap by `OVERLAP` bytes, as often as asked
Chunks = Callable[[], Iterator[bytes]]

OVERLAP = 64  # bytes; more than the place of a cell
_MAX_DIGITS = 9
_MAX_WIDTH = 60  # columns; beyond so many, a single row out of order could ask for a rectangle of a billion cells
_PLACE = re.compile(rb"""\br\s*=\s*["']\s*([A-Za-z]*)([0-9]+)""")  # of a cell, or of a row
_ELEMENT = re.compile(rb"<(?:\w+:)?(c|row)[\s/>]")
_PLACED = b'<c r="'
_UNPLACED = re.compile(rb'<(?:\w+:c[\s/>]|c(?:[/>]|\s(?!r="[A-Z])))')
_FAR_COLUMN = re.compile(rb'<c r="([A-Z]{2,})[0-9]')
_ROW = re.compile(rb'<c r="[A-Z]+([0-9]+)')
_FAR_ROW = re.compile(rb'<c r="[A-Z]+([0-9]{7,})')


def extent_of_records(records: bytes) -> tuple[int, int]:
    """Return the columns and rows of a binary sheet; `ValueError` if its records are truncated or garbled.

    >>> extent_of_records(bytes([0, 4, 9, 0, 0, 0, 2, 4, 2, 0, 0, 0, 0x92, 1, 0]))
    (3, 10)
    """
    width = height = 1
    kinds = set()
    for kind, at, size in _records(records):
        kinds.add(kind)
        if kind <= _LAST_CELL and size >= 4:
            position = int.from_bytes(records[at : at + 4], "little") + 1
            width, height = (width, max(height, position)) if kind == _BINARY_ROW else (max(width, position), height)
    if _END_OF_CELLS not in kinds:
        raise ValueError("a sheet has no end")
    if width > _MAX_COLUMNS or height > _MAX_ROWS:
        raise ValueError(f"a sheet has a cell in row {height} and column {width}")
    return width, height


def check_end(records: bytes) -> None:
    """Raise `ValueError` if the list of sheets has no end."""
    if all(kind != _END_OF_SHEETS for kind, _, _ in _records(records)):
        raise ValueError("the list of sheets has no end")


def _records(records: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the kind, content offset and size of each record."""
    at, end = 0, len(records)
    while at + 2 <= end:
        kind = records[at]
        if kind & 0x80:
            # seven bits a byte; the eighth says that another byte follows
            kind, at = kind & 0x7F | (records[at + 1] & 0x7F) << 7, at + 1
        at += 1
        size, shift = 0, 0
        while at < end and shift < 28:
            size |= (records[at] & 0x7F) << shift
            at, shift = at + 1, shift + 7
            if not records[at - 1] & 0x80:
                break
        if at + size > end:
            break
        yield kind, at, size
        at += size
    if at != end:
        raise ValueError("a record is cut off")


def extent_of_text(chunks: Chunks) -> tuple[int, int]:
    """Return the columns and rows of a rectangle with all cells of a sheet, possibly larger than needed.

    >>> extent_of_text(lambda: iter([b'<row r="7"><c r="AB7"/></row>']))
    (28, 7)
    """
    return _extent_of_usual(chunks) or _extent_of_any(chunks)


def _extent_of_usual(chunks: Chunks) -> tuple[int, int] | None:
    """Return the rectangle if each cell begins with its reference, as Excel writes them; None otherwise.

    Rows follow each other, so that the last one of each part and those beyond a million are enough.
    """
    width, height = 26, 1
    for text in chunks():
        begun = text.count(b"<c", 0, len(text) - 4)  # those whose place is within this part
        if (begun != text.count(_PLACED) or b":c" in text) and _UNPLACED.search(text, 0, len(text) - 5):
            return None
        width = max([width, *map(_column_number, set(_FAR_COLUMN.findall(text)))])
        last = _ROW.findall(text, max(text.rfind(_PLACED), 0))
        height = max([height, *map(_parse_row, {*_FAR_ROW.findall(text), *last})])
    return None if width > _MAX_WIDTH else (width, height)


def _extent_of_any(chunks: Chunks) -> tuple[int, int]:
    """Return the rectangle of any cells; those without a reference follow the previous one."""
    width, height = 1, 1
    unplaced: Counter[bytes] = Counter()
    columns: dict[bytes, int] = {}
    for text in chunks():
        for match in _PLACE.finditer(text):
            letters, row = match[1], match[2]
            if letters not in columns:
                columns[letters] = _column_number(letters.upper()[:_MAX_DIGITS])
                width = max(width, columns[letters])
            unplaced[b"c" if letters else b"row"] -= 1
            height = max(height, _parse_row(row))
        unplaced.update(match[1] for match in _ELEMENT.finditer(text))
    # those without a place may all lie behind the last one that has one
    return width + max(unplaced[b"c"], 0), height + max(unplaced[b"row"], 0)


def _parse_row(digits: bytes) -> int:
    return int(digits[:_MAX_DIGITS])


def _column_number(letters: bytes) -> int:
    """Return the number of a column, counted from 1."""
    number = 0
    for letter in letters[:_MAX_DIGITS]:
        # A is 1, Z is 26, AA is 27
        number = 26 * number + letter - 64
    return number
