"""Reader of large text files: columns of numbers by machine code, others by the CSV parser of Arrow.

Anything unusual (text in a column that began with numbers, rows of another length, blank lines) is left to the exact
reader, which knows the line of each cell.
"""

import mmap
import sys
from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.threads import available_cores
from kennfeld.files.encoding import GUESSED_ENCODINGS
from kennfeld.measurement.cells import TRUTH, parse_number
from kennfeld.measurement.csv_body import CsvBody
from kennfeld.measurement.csv_dialect import Dialect, is_comment, split_line
from kennfeld.measurement.exact_numbers import has_many_digits
from kennfeld.measurement.header import Header
from kennfeld.measurement.plain_csv import read_numbers
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.unit_text import may_be_time

_LINE = 1 << 24  # bytes
_SAMPLE = 200  # lines
_TAIL = 4096  # bytes that are searched for empty lines at the end
_SEVERAL_BLANKS = (b"  ", b" \n", b" \r", b"\n ")  # are one separator, or none


def read_bulk(source: MeasurementFile, dialect: Dialect, selection: Selection) -> Table | None:
    """Return the table of a text file; None if the exact reader is required."""
    header = dialect.header
    with source.open() as stream:
        begin = sum(len(stream.readline(_LINE)) for _ in range(header.data))
        lines = [stream.readline(_LINE) for _ in range(_SAMPLE)]
    sample = [line.decode(dialect.encoding, "replace").rstrip("\r\n") for line in lines if line]
    cells = [split_line(line, dialect.separator) for line in sample]
    if (
        dialect.encoding == "utf-16"
        or dialect.grouped
        or any(map(is_comment, sample))
        or len({len(row) for row in cells}) != 1
    ):
        return None
    width = len(cells[0])
    types = {
        i: _column_type(header, i, [row[i] for row in cells], dialect) for i in selection.wants(header) if i < width
    }
    content = _content(source)
    if width < header.width or not types or _has_several_blanks(content, begin, dialect):
        return None
    # empty lines at the end would be rows of gaps; a map has no `rstrip`, and a copy of all of it may not fit in memory
    tail = content[max(len(content) - _TAIL, 0) :]
    data = memoryview(content)[begin : len(content) - len(tail) + len(tail.rstrip(b"\r\n"))]
    body = CsvBody(data, dialect, width, types)
    with ThreadPoolExecutor(available_cores()) as pool:  # threads of Arrow itself can abort a process that ends early
        columns = _read_numbers(body, header, pool) or _read_mixed(body, header, pool)
    if columns is None or _has_empty_row([column.values for column in columns]):  # perhaps a blank line
        return None
    rows = np.arange(columns[0].values.size) + header.data + 1
    return Table(source.location, tuple(columns), rows, names=header.names, details=dialect.details)


def _column_type(header: Header, index: int, cells: list[str], dialect: Dialect) -> str:
    """Return the type that a column seems to hold, as Arrow calls it; "binary" for text and for exact time stamps."""
    if any(parse_number(cell, dialect.decimal) is None for cell in cells):
        return "binary"
    if may_be_time(header.names[index], header.units[index]) and any(map(has_many_digits, cells)):
        return "binary"
    return "bool" if any(cell.strip().casefold() in TRUTH for cell in cells) else "double"


def _content(source: MeasurementFile) -> bytes | mmap.mmap:
    with source.open() as stream:
        # a member of an archive has no file that could be mapped
        return stream.read() if source.packed else mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)


def _has_several_blanks(content: bytes | mmap.mmap, begin: int, dialect: Dialect) -> bool:
    if dialect.separator != " ":
        return False
    return content[-1:] == b" " or any(content.find(blanks, begin - 1) >= 0 for blanks in _SEVERAL_BLANKS)


def _read_numbers(body: CsvBody, header: Header, pool: Executor) -> list[Column] | None:
    """Return the columns if they hold nothing but numbers and gaps."""
    unusual = set(body.types.values()) != {"double"} or body.dialect.encoding in GUESSED_ENCODINGS
    if unusual or sys.byteorder != "little":
        return None
    values = read_numbers(body, pool)
    if values is None:
        return None
    return [Column(header.names[i], header.units[i], header.names[i], values[i]) for i in values]


def _read_mixed(body: CsvBody, header: Header, pool: Executor) -> list[Column] | None:
    from kennfeld.measurement.arrow_csv import read_mixed  # its import takes longer than most files

    return read_mixed(body, header, pool)


def _has_empty_row(columns: list[Float]) -> bool:
    empty = np.isnan(columns[0])
    for values in columns[1:]:
        if not empty.any():
            break
        empty &= np.isnan(values)
    return bool(empty.any())
