"""Looks through the sheets of a binary workbook before a library does.

That one asks for the memory of their rectangle, and searches without end for records that are missing.

Layout: Microsoft, [MS-XLSB]: records of type, size and content, where type and size take as many bytes as they need.
"""

from collections.abc import Iterator

__all__ = ["check_end", "extent_of"]

_ROW = 0  # the record that begins a row; those up to the last kind of cell give a column
_LAST_CELL = 11
_MOST_COLUMNS, _MOST_ROWS = 16_384, 1_048_576
_END_OF_CELLS = 146
_END_OF_SHEETS = 144


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
            width, height = (width, max(height, position)) if kind == _ROW else (max(width, position), height)
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
