"""Looks through the sheets of a binary workbook before a library does.

That one asks for the memory of their rectangle, and searches without end for records that are missing.

Layout: Microsoft, [MS-XLSB]: records of type, size and content, where type and size take as many bytes as they need.

Where the cells of a sheet stand: letters of columns, and the rectangle that holds all cells.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator

__all__ = ["OVERLAP", "check_end", "extent_of", "extent_of_text"]

_BINARY_ROW = 0  # the record that begins a row; those up to the last kind of cell give a column
_LAST_CELL = 11
_MOST_COLUMNS, _MOST_ROWS = 16_384, 1_048_576
_END_OF_CELLS = 146
_END_OF_SHEETS = 144

Chunks = Callable[
    [], Iterator[bytes]
]  # the text of a sheet in parts that overlap by `OVERLAP` bytes, as often as asked

OVERLAP = 64  # bytes; more than the place of a cell
_MOST_DIGITS = 9
_MANY = 60  # columns; beyond so many, a single row out of order could ask for a rectangle of a billion cells
_PLACE = re.compile(rb"""\br\s*=\s*["']\s*([A-Za-z]*)([0-9]+)""")  # of a cell, or of a row
_ELEMENT = re.compile(rb"<(?:\w+:)?(c|row)[\s/>]")
_PLACED = b'<c r="'
_UNPLACED = re.compile(rb'<(?:\w+:c[\s/>]|c(?:[/>]|\s(?!r="[A-Z])))')
_FAR_COLUMN = re.compile(rb'<c r="([A-Z]{2,})[0-9]')
_ROW = re.compile(rb'<c r="[A-Z]+([0-9]+)')
_FAR_ROW = re.compile(rb'<c r="[A-Z]+([0-9]{7,})')


def extent_of(records: bytes) -> tuple[int, int]:
    """Columns and rows of the sheet with these records; `ValueError` where they are cut off or garbled.

    >>> extent_of(bytes([0, 4, 9, 0, 0, 0, 2, 4, 2, 0, 0, 0, 0x92, 1, 0]))
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
    if width > _MOST_COLUMNS or height > _MOST_ROWS:
        raise ValueError(f"a sheet has a cell in row {height} and column {width}")
    return width, height


def check_end(records: bytes) -> None:
    """Raise `ValueError` where the list of sheets has no end."""
    if all(kind != _END_OF_SHEETS for kind, _, _ in _records(records)):
        raise ValueError("the list of sheets has no end")


def _records(records: bytes) -> Iterator[tuple[int, int, int]]:
    """Kind of each record, where its content begins, and the size of that."""
    at, end = 0, len(records)
    while at + 2 <= end:
        kind = records[at]
        if kind & 0x80:
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
    """Columns and rows of a rectangle that holds all cells of a sheet, which may be larger than need be.

    >>> extent_of_text(lambda: iter([b'<row r="7"><c r="AB7"/></row>']))
    (28, 7)
    """
    found = _usual(chunks)
    return found if found is not None else _any(chunks)


def _usual(chunks: Chunks) -> tuple[int, int] | None:
    """The rectangle where each cell begins with its place, as Excel writes them; None where one does not.

    Rows follow each other, so that the last one of each part and those beyond a million are enough.
    """
    width, height = 26, 1
    for text in chunks():
        begun = text.count(b"<c", 0, len(text) - 4)  # those whose place is within this part
        if (begun != text.count(_PLACED) or b":c" in text) and _UNPLACED.search(text, 0, len(text) - 5):
            return None
        width = max([width, *map(_number, set(_FAR_COLUMN.findall(text)))])
        last = _ROW.findall(text, max(text.rfind(_PLACED), 0))
        height = max([height, *map(_short, {*_FAR_ROW.findall(text), *last})])
    return None if width > _MANY else (width, height)


def _any(chunks: Chunks) -> tuple[int, int]:
    """The rectangle of any cells; what states no place of its own follows what was before it."""
    width, height = 1, 1
    places: Counter[bytes] = Counter()
    columns: dict[bytes, int] = {}
    kinds: Counter[bytes] = Counter()
    for text in chunks():
        for found in _PLACE.finditer(text):
            letters, row = found[1], found[2]
            if letters not in columns:
                columns[letters] = _number(letters.upper()[:_MOST_DIGITS])
                width = max(width, columns[letters])
            places[b"c" if letters else b"row"] += 1
            height = max(height, _short(row))
        kinds.update(found[1] for found in _ELEMENT.finditer(text))
    return width + max(kinds[b"c"] - places[b"c"], 0), height + max(kinds[b"row"] - places[b"row"], 0)


def _short(digits: bytes) -> int:
    return int(digits[:_MOST_DIGITS])


def _number(letters: bytes) -> int:
    """The number of a column, counted from 1."""
    number = 0
    for letter in letters[:_MOST_DIGITS]:
        number = 26 * number + letter - 64
    return number
