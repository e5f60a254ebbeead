"""Reader of delimited text with columns of numbers, truth values and text, by the CSV parser of Arrow."""

from collections.abc import Iterable
from concurrent.futures import Executor

import pyarrow as pa
from pyarrow import csv

from kennfeld.base.threads import available_cores
from kennfeld.files.encoding import GUESSED_ENCODINGS
from kennfeld.measurement.arrow_numbers import numbers_of
from kennfeld.measurement.cells import MISSING, TRUTH
from kennfeld.measurement.csv_body import CsvBody, count_lines
from kennfeld.measurement.csv_dialect import Dialect
from kennfeld.measurement.header import Header
from kennfeld.measurement.table import BLOCK, Column, ColumnBuilder


def read_mixed(body: CsvBody, header: Header, pool: Executor) -> list[Column] | None:
    """Return the columns of `body.types`; None if a cell or a row does not fit."""
    tables = list(pool.map(lambda part: _parse(part, body), body.split(available_cores())))
    if any(table is None for table in tables):
        return None
    table = pa.concat_tables(tables)
    return list(pool.map(lambda i: _column(header, i, table.column(str(i)), body.dialect), body.types))


def _parse(data: memoryview, body: CsvBody) -> pa.Table | None:
    """Return the columns of these types, by their number; None if a cell or a row does not fit."""
    dialect = body.dialect
    encoding = dialect.encoding if dialect.encoding in GUESSED_ENCODINGS else "utf8"  # others have ASCII separators
    reading = csv.ReadOptions(use_threads=False, column_names=[str(i) for i in range(body.width)], encoding=encoding)
    parsing = csv.ParseOptions(delimiter=dialect.separator, ignore_empty_lines=False)
    conversion = csv.ConvertOptions(
        check_utf8=False,
        column_types={str(i): kind for i, kind in body.types.items()},
        include_columns=[str(i) for i in body.types],
        null_values=_spell(MISSING),
        true_values=_spell(word for word, value in TRUTH.items() if value),
        false_values=_spell(word for word, value in TRUTH.items() if not value),
        decimal_point=dialect.decimal,
    )
    try:
        table = csv.read_csv(pa.BufferReader(pa.py_buffer(data)), reading, parsing, conversion)
    except pa.ArrowInvalid:
        return None
    return None if table.num_rows != count_lines(data) or any(map(_has_quotes, table.columns)) else table


def _has_quotes(column: pa.ChunkedArray) -> bool:
    """Return whether a column of text holds quotes, which may be unbalanced."""
    if not pa.types.is_binary(column.type):
        return False
    from pyarrow import compute

    return compute.any(compute.match_substring(column, '"')).as_py() is True


def _spell(words: Iterable[str]) -> list[str]:
    """Return the words as files spell them; Arrow compares them letter by letter."""
    return sorted({spelt for word in words for spelt in (word, word.upper(), word.title(), word.replace("nan", "NaN"))})


def _column(header: Header, index: int, values: pa.ChunkedArray, dialect: Dialect) -> Column:
    name, unit = header.names[index], header.units[index]
    if not pa.types.is_binary(values.type):
        return Column(name, unit, name, numbers_of(values))
    encoding = "utf8" if dialect.encoding in GUESSED_ENCODINGS else dialect.encoding  # Arrow has converted the others
    builder = ColumnBuilder(name, unit, name)
    for begin in range(0, len(values), BLOCK):
        cells = values.slice(begin, BLOCK).to_pylist()
        builder.add([cell.decode(encoding, "replace") for cell in cells], dialect.decimal)
    return builder.build()
