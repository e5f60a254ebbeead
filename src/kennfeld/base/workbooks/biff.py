"""Checks the records of an .xls before a library reads them, which would allocate whatever they claim.

Layout: Microsoft, [MS-XLS]: records of kind, size and content; first those of the book, with the offset of each sheet,
then those of the sheets.
"""

import struct
from collections.abc import Iterator

_HEAD = struct.Struct("<HH")
_PLACE = struct.Struct("<HH")  # row and column of a cell
_END, _SHEET, _TEXTS, _DIMENSIONS, _SEVERAL = 0x000A, 0x0085, 0x00FC, 0x0200, 0x00BD
_CELLS = frozenset((0x0006, 0x0203, 0x0204, 0x0205, 0x00FD, 0x027E, _SEVERAL))
_ROWS, _COLUMNS = 65_536, 256
_SHORTEST_TEXT = 3  # bytes
_LARGE_RECTANGLE = 2_000_000  # cells of a rectangle, beyond which
_MIN_FILLED = 0.01  # of them have to be there: the library makes room for all


def check_records(stream: bytes, most_cells: int) -> None:
    """Raise `ValueError` if the records ask for more memory than their content can need."""
    sheets = []
    for kind, at, size in _records(stream, 0):
        if kind == _SHEET and size >= 4:
            sheets.append(int.from_bytes(stream[at : at + 4], "little"))
        elif kind == _TEXTS and size >= 8:
            texts, available = int.from_bytes(stream[at + 4 : at + 8], "little"), len(stream) - at
            if texts * _SHORTEST_TEXT > available:
                raise ValueError(f"it claims {texts} texts in {available} bytes")
    cells = walked = 0
    for begin in sheets:
        width, height, filled, end = _extent(stream, begin)
        if width > _COLUMNS:
            raise ValueError(f"a sheet has a cell in column {width}")
        if width * height > _LARGE_RECTANGLE and filled < _MIN_FILLED * width * height:
            raise ValueError(f"a sheet has {filled} cells, but spans {height} rows and {width} columns")
        cells += width * height
        walked += end - begin
        if cells > most_cells:
            raise ValueError(f"its sheets span more than {most_cells} cells")
        # records that sheets share would be read again for each of them
        if walked > 2 * len(stream):
            raise ValueError("its sheets overlap")


def _extent(stream: bytes, begin: int) -> tuple[int, int, int, int]:
    """Return the columns and rows of a sheet, its number of cells, and the end of its records."""
    width = height = 1
    filled = 0
    end = begin
    for kind, at, size in _records(stream, begin):
        end = at + size
        if kind in _CELLS and size >= 4:
            row, column = _PLACE.unpack_from(stream, at)
            if kind == _SEVERAL:
                # row, first column, 6 bytes a cell, last column: size // 6 - 1 cells, one of which is counted below
                filled += size // 6 - 2
                column = max(column, int.from_bytes(stream[end - 2 : end], "little"))
            filled += 1
            width, height = max(width, column + 1), max(height, row + 1)
        elif kind == _DIMENSIONS:
            _check_dimensions(stream[at:end])
    return width, height, filled, end


def _check_dimensions(content: bytes) -> None:
    shape = {10: "<HHHH", 14: "<IIHH"}.get(len(content))
    if shape is None:
        return
    first_row, end_row, first_column, end_column = struct.unpack_from(shape, content)
    if not (first_row <= end_row <= _ROWS and first_column <= end_column <= _COLUMNS):
        span = f"rows {first_row} to {end_row} and columns {first_column} to {end_column}"
        raise ValueError(f"a sheet claims {span}")


def _records(stream: bytes, at: int) -> Iterator[tuple[int, int, int]]:
    """Yield the kind, content offset and size of each record up to the end record.

    One that is cut off ends them too: the library refuses it.
    """
    while at + 4 <= len(stream):
        kind, size = _HEAD.unpack_from(stream, at)
        if at + 4 + size > len(stream):
            return
        yield kind, at + 4, size
        at += 4 + size
        if kind == _END:
            return
