"""Columns of Arrow tables, as the files of Parquet and Feather hold them."""

from collections import Counter
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.measurement.arrow_numbers import numbers_of
from kennfeld.measurement.exact_numbers import rest_of_integers
from kennfeld.measurement.header import Header
from kennfeld.measurement.table import Column
from kennfeld.measurement.unit_text import may_be_time, split_name

_SCALES = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
_INDEX = "__index_level_"  # how pandas calls an index without a name


def header_of(schema: Any) -> Header:
    """Return names and units of the columns; a unit is in the metadata of the field, or in brackets in its name."""
    import pyarrow as pa

    names, units = [], []
    split = [split_name(field.name) for field in schema]
    short = Counter(name for name, _ in split)
    for field, (name, unit) in zip(schema, split, strict=True):
        notes = {key.decode(errors="replace").casefold(): value for key, value in (field.metadata or {}).items()}
        stated = notes.get("unit", notes.get("units", b"")).decode(errors="replace")
        # an index of pandas without a name; one of stamps is the clock, unless a column has that name
        if name.startswith(_INDEX):
            clock = pa.types.is_timestamp(field.type) or pa.types.is_duration(field.type)
            name = "time" if clock and "time" not in short else ""
        # `p [bar]` beside `p [kPa]`: only the whole names differ
        names.append(field.name if short[name] > 1 else name)
        units.append(stated or unit)
    return Header(0, 0, tuple(names), tuple(units))


def is_numeric(kind: Any) -> bool:
    """Return whether values of a type of Arrow are numbers, dates or durations."""
    import pyarrow as pa

    plain = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
    return bool(plain or pa.types.is_decimal(kind) or pa.types.is_timestamp(kind) or pa.types.is_duration(kind))


def column_of(chunked: Any, header: Header, index: int) -> Column:
    """Return a chunked array of a numeric type as a column; dates count from the first one."""
    import pyarrow as pa

    dated = pa.types.is_timestamp(chunked.type) or pa.types.is_duration(chunked.type)
    values = _seconds(chunked) if dated else numbers_of(chunked)
    origin = _first_stamp(chunked) if pa.types.is_timestamp(chunked.type) else None
    name, unit = header.names[index], header.units[index]
    if dated:
        return Column(name, "s", name, values, dated=True, origin=origin)
    return Column(name, unit, name, values, rest=_rest(chunked) if may_be_time(name, unit) else None)


def _rest(chunked: Any) -> Float | None:
    """Return what doubles lack of the integers of a clock."""
    import pyarrow as pa

    if not pa.types.is_integer(chunked.type) or chunked.null_count:
        return None
    # the integers as stored: buffer 0 holds the bits of validity, buffer 1 the data, from the chunk's offset on
    buffers = [(chunk.buffers()[1], chunk) for chunk in chunked.chunks]
    kind = np.dtype(str(chunked.type))
    parts = [np.frombuffer(data or b"", kind, len(chunk), kind.itemsize * chunk.offset) for data, chunk in buffers]
    return rest_of_integers(np.concatenate([np.zeros(0, kind), *parts]))


def text_column(schema: Any, header: Header, index: int, samples: int) -> Column:
    """Return a column that holds no numbers."""
    return Column.without_numbers(header.names[index], samples, f"a value of type {schema.field(index).type}")


def _seconds(chunked: Any) -> Float:
    import pyarrow as pa

    # counted from the first stamp before they become floats: nanoseconds since 1970 need more than 53 bits
    return numbers_of(pa.compute.subtract(chunked.cast(pa.int64()), _first_tick(chunked))) / _SCALES[chunked.type.unit]


def _first_stamp(chunked: Any) -> datetime | None:
    """Return the instant that `_seconds` counts from; None if Python has no such date."""
    zone = None if chunked.type.tz is None else UTC
    try:
        # `datetime` resolves microseconds; what a tick has below them is dropped from the origin alone
        elapsed = timedelta(microseconds=_first_tick(chunked) * 10**6 // int(_SCALES[chunked.type.unit]))
        return datetime(1970, 1, 1, tzinfo=zone) + elapsed
    except OverflowError:
        return None


def _first_tick(chunked: Any) -> int:
    import pyarrow as pa

    return next((value for value in chunked[:1].cast(pa.int64()).to_pylist() if value is not None), 0)
