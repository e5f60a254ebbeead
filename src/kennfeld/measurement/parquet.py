"""Reader of Parquet files."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import InputError
from kennfeld.measurement.arrow_numbers import numbers_of
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.header import Header
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.unit_text import split_name

_INDEX = "__index_level_"  # how pandas calls an index without a name
_AT_ONCE = 1 << 22  # values; each reading goes through the names of all columns


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the one table of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with source.path.open("rb") as stream, pq.ParquetFile(stream) as file:
            schema = file.schema_arrow  # made again each time it is asked for
            header = _header(schema)
            asked = selection.wants(header)
            numeric = [i for i in asked if _is_numeric(schema.field(i).type)]
            count = file.metadata.num_rows
            columns = list(_columns(file, schema, header, numeric))
            texts = [
                Column.without_numbers(header.names[i], count, f"a value of type {schema.field(i).type}")
                for i in asked
                if not _is_numeric(schema.field(i).type)
            ]
            if odd := [column.name for column in columns if column.values.size != count]:
                raise ValueError(f"{odd[0]} does not hold {count} values")
    except (pa.ArrowException, OSError, ValueError, MemoryError, OverflowError, KeyError) as error:
        message = f"the Parquet file is damaged or cut off ({' '.join(str(error).split())[:200]})"
        raise InputError.of(source.location, message, "Copy or write it again.") from None
    if not count:
        raise InputError.of(source.location, "holds no rows", "Is it the right file?")
    rows = np.arange(1, count + 1)
    return [Table(source.location, (*columns, *texts), rows, row_word="row", names=header.names)]


def _header(schema: Any) -> Header:
    import pyarrow as pa

    names, units = [], []
    split = [split_name(field.name) for field in schema]
    short = Counter(name for name, _ in split)
    for field, (name, unit) in zip(schema, split, strict=True):
        notes = {key.decode(errors="replace").casefold(): value for key, value in (field.metadata or {}).items()}
        stated = notes.get("unit", notes.get("units", b"")).decode(errors="replace")
        if name.startswith(_INDEX):
            name = "time" if pa.types.is_timestamp(field.type) and "time" not in short else ""
        names.append(field.name if short[name] > 1 else name)
        units.append(stated or unit)
    return Header(0, 0, tuple(names), tuple(units))


def _is_numeric(kind: Any) -> bool:
    import pyarrow as pa

    plain = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
    return bool(plain or pa.types.is_decimal(kind) or pa.types.is_timestamp(kind) or pa.types.is_duration(kind))


def _columns(file: Any, schema: Any, header: Header, wanted: Sequence[int]) -> Iterator[Column]:
    """Yield columns of numbers, several at a time as far as memory allows."""
    size = max(1, _AT_ONCE // max(1, file.metadata.num_rows))
    for start in range(0, len(wanted), size):
        block = wanted[start : start + size]
        names = [schema.field(i).name for i in block]
        read = file.read(columns=names)
        places = {name: at for at, name in reversed(list(enumerate(read.column_names)))}
        yield from (_column(read.column(places[name]), header, i) for i, name in zip(block, names, strict=True))


def _column(chunked: Any, header: Header, index: int) -> Column:
    import pyarrow as pa

    dated = pa.types.is_timestamp(chunked.type) or pa.types.is_duration(chunked.type)
    values = _seconds(chunked) if dated else numbers_of(chunked)
    name = header.names[index]
    return Column(name, "s" if dated else header.units[index], name, values, dated=dated)


def _seconds(chunked: Any) -> Float:
    import pyarrow as pa

    scale = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[chunked.type.unit]
    ticks = chunked.cast(pa.int64())
    # counted from the first stamp before they become floats: nanoseconds since 1970 need more than 53 bits
    first = next((value for value in ticks[:1].to_pylist() if value is not None), 0)
    return numbers_of(pa.compute.subtract(ticks, first)) / scale
