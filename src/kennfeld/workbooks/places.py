"""Where the cells of a sheet stand: letters of columns, and the rectangle that holds all cells."""

import re
from collections import Counter
from collections.abc import Callable, Iterator

__all__ = ["column_letters", "extent_of_text"]

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
