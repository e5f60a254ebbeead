"""Reader of Parquet files."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.measurement.arrow_columns import column_of, header_of, is_numeric, text_column
from kennfeld.measurement.claimed_values import check_claimed
from kennfeld.measurement.damage import damaged
from kennfeld.measurement.header import Header
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, Selection, Table

_AT_ONCE = 1 << 22  # values; each reading goes through the names of all columns


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the one table of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with source.path.open("rb") as stream, pq.ParquetFile(stream) as file:
            schema = file.schema_arrow  # made again each time it is asked for
            header = header_of(schema)
            asked = selection.wants(header)
            numeric = [i for i in asked if is_numeric(schema.field(i).type)]
            count = file.metadata.num_rows
            check_claimed(source, count * (len(numeric) or 1))
            columns = list(_columns(file, schema, header, numeric))
            texts = [text_column(schema, header, i, count) for i in asked if not is_numeric(schema.field(i).type)]
            if odd := [column.name for column in columns if column.values.size != count]:
                raise ValueError(f"{odd[0]} does not hold {count} values")
    except (pa.ArrowException, OSError, ValueError, MemoryError, OverflowError, KeyError) as error:
        raise damaged(source, "Parquet", error, "Copy or write it again.") from None
    if not count:
        raise InputError.of(source.location, "holds no rows", "Is it the right file?")
    rows = np.arange(1, count + 1)
    return [Table(source.location, (*columns, *texts), rows, row_word="row", names=header.names)]


def _columns(file: Any, schema: Any, header: Header, wanted: Sequence[int]) -> Iterator[Column]:
    """Yield columns of numbers, several at a time as far as memory allows."""
    size = max(1, _AT_ONCE // max(1, file.metadata.num_rows))
    for start in range(0, len(wanted), size):
        block = wanted[start : start + size]
        names = [schema.field(i).name for i in block]
        read = file.read(columns=names)
        # of several columns with one name, the first
        places = {name: at for at, name in reversed(list(enumerate(read.column_names)))}
        yield from (column_of(read.column(places[name]), header, i) for i, name in zip(block, names, strict=True))
