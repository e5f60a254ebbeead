"""Reader of large text files through the CSV parser of Arrow.

Anything unusual (text in a column that began with numbers, rows of another length, blank lines) is left to the exact
reader, which knows the line of each cell.
"""

import itertools
import mmap
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyarrow as pa
from pyarrow import csv

from kennfeld.arrays import Float
from kennfeld.measurement.cells import MISSING, TRUTH, parse_number
from kennfeld.measurement.csv_dialect import Dialect, is_comment, split_line
from kennfeld.measurement.encoding import GUESSED_ENCODINGS
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.header import Header
from kennfeld.measurement.table import BLOCK, Column, ColumnBuilder, Selection, Table

_LINE = 1 << 24  # bytes
_SAMPLE = 200  # lines
_TAIL = 4096  # bytes that are searched for empty lines at the end
_CHUNK = 1 << 24
_SEVERAL_BLANKS = (b"  ", b" \n", b" \r", b"\n ")  # are one separator, or none


def read_bulk(source: MeasurementFile, dialect: Dialect, selection: Selection) -> Table | None:
    """Return the table of a text file; None if the exact reader is required."""
    header = dialect.header
    with source.open() as stream:
        begin = sum(len(stream.readline(_LINE)) for _ in range(header.data))
        lines = [stream.readline(_LINE) for _ in range(_SAMPLE)]
    sample = [line.decode(dialect.encoding, "replace").rstrip("\r\n") for line in lines if line]
    cells = [split_line(line, dialect.separator) for line in sample]
    if dialect.encoding == "utf-16" or any(map(is_comment, sample)) or len({len(row) for row in cells}) != 1:
        return None
    width = len(cells[0])
    types = {i: _column_type([row[i] for row in cells], dialect) for i in selection.wants(header) if i < width}
    content = _content(source)
    if width < header.width or not types or _has_several_blanks(content, begin, dialect):
        return None
    tail = content[max(len(content) - _TAIL, 0) :]
    data = memoryview(content)[begin : len(content) - len(tail) + len(tail.rstrip(b"\r\n"))]
    processors = os.cpu_count() or 1
    with ThreadPoolExecutor(processors) as pool:  # threads of Arrow itself can abort a process that ends early
        parts = list(pool.map(lambda part: _parse(part, dialect, types, width), _split_lines(data, processors)))
        tables = [part for part in parts if part is not None]
        if len(tables) < len(parts):
            return None
        table = pa.concat_tables(tables)
        columns = list(pool.map(lambda i: _column(header, i, table.column(str(i)), dialect), types))
    if _has_empty_row([column.values for column in columns]):  # perhaps a blank line
        return None
    rows = np.arange(table.num_rows) + header.data + 1
    return Table(source.location, tuple(columns), rows, names=header.names, details=dialect.details)


def _column_type(cells: list[str], dialect: Dialect) -> str:
    """Return the type that the column seems to hold, as Arrow calls it; "binary" for text."""
    if any(parse_number(cell, dialect.decimal) is None for cell in cells):
        return "binary"
    return "bool" if any(cell.strip().casefold() in TRUTH for cell in cells) else "double"


def _content(source: MeasurementFile) -> bytes | mmap.mmap:
    with source.open() as stream:
        return stream.read() if source.packed else mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)


def _has_several_blanks(content: bytes | mmap.mmap, begin: int, dialect: Dialect) -> bool:
    if dialect.separator != " ":
        return False
    return content[-1:] == b" " or any(content.find(blanks, begin - 1) >= 0 for blanks in _SEVERAL_BLANKS)


def _split_lines(data: memoryview, count: int) -> list[memoryview]:
    """Return at most so many parts of similar size, each of whole lines."""
    ends = {_line_end(data, len(data) * k // count) for k in range(1, count)} | {len(data)}
    bounds = [0, *sorted(ends)]
    return [data[begin:end] for begin, end in itertools.pairwise(bounds)]


def _line_end(data: memoryview, position: int) -> int:
    """Return where the line that holds this position ends, behind its line feed."""
    while position < len(data):
        feed = bytes(data[position : position + _TAIL]).find(b"\n")
        if feed >= 0:
            return position + feed + 1
        position += _TAIL
    return len(data)


def _parse(data: memoryview, dialect: Dialect, types: dict[int, str], width: int) -> pa.Table | None:
    """Return the columns of these types, by their number; None if a cell or a row does not fit."""
    encoding = dialect.encoding if dialect.encoding in GUESSED_ENCODINGS else "utf8"  # others have ASCII separators
    reading = csv.ReadOptions(use_threads=False, column_names=[str(i) for i in range(width)], encoding=encoding)
    parsing = csv.ParseOptions(delimiter=dialect.separator, ignore_empty_lines=False)
    conversion = csv.ConvertOptions(
        check_utf8=False,
        column_types={str(i): kind for i, kind in types.items()},
        include_columns=[str(i) for i in types],
        null_values=_spell(MISSING),
        true_values=_spell(word for word, value in TRUTH.items() if value),
        false_values=_spell(word for word, value in TRUTH.items() if not value),
        decimal_point=dialect.decimal,
    )
    try:
        table = csv.read_csv(pa.BufferReader(pa.py_buffer(data)), reading, parsing, conversion)
    except pa.ArrowInvalid:
        return None
    return None if table.num_rows != _count_lines(data) or any(map(_has_quotes, table.columns)) else table


def _has_empty_row(columns: list[Float]) -> bool:
    empty = np.isnan(columns[0])
    for values in columns[1:]:
        if not empty.any():
            break
        empty &= np.isnan(values)
    return bool(empty.any())


def _has_quotes(column: pa.ChunkedArray) -> bool:
    """Return whether a column of text holds quotes, which may be unbalanced."""
    if not pa.types.is_binary(column.type):
        return False
    from pyarrow import compute

    return compute.any(compute.match_substring(column, '"')).as_py() is True


def _spell(words: Iterable[str]) -> list[str]:
    """Return the words as files spell them; Arrow compares them letter by letter."""
    return sorted({spelt for word in words for spelt in (word, word.upper(), word.title(), word.replace("nan", "NaN"))})


def _count_lines(data: memoryview) -> int:
    """Return the number of lines; there are more than rows if a cell spans several."""
    chunks = (np.frombuffer(data[k : k + _CHUNK], np.uint8) for k in range(0, len(data), _CHUNK))
    feeds = sum(int(np.count_nonzero(chunk == ord("\n"))) for chunk in chunks)  # bytes.count is 7 times slower
    return feeds + (bytes(data[-1:]) != b"\n")


def _column(header: Header, index: int, values: pa.ChunkedArray, dialect: Dialect) -> Column:
    name, unit = header.names[index], header.units[index]
    if not pa.types.is_binary(values.type):
        return Column(name, unit, name, values.cast(pa.float64()).to_numpy())
    encoding = "utf8" if dialect.encoding in GUESSED_ENCODINGS else dialect.encoding  # Arrow has converted the others
    builder = ColumnBuilder(name, unit, name)
    for begin in range(0, len(values), BLOCK):
        cells = values.slice(begin, BLOCK).to_pylist()
        builder.add([cell.decode(encoding, "replace") for cell in cells], dialect.decimal)
    return builder.build()
