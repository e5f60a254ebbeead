"""DataFrames and Series in HDF5 files, as `to_hdf` of pandas stores them: in the fixed format, or as a table.

The fixed format has datasets of the index and of blocks, which are matrices of the columns of one type. A table has
a record for each row, whose fields are the index, blocks, and columns that can be queried. Names of a table's columns
are pickled; they are read from the operations of the pickle, and nothing is unpickled.
"""

import pickletools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.measurement.recorded_groups import RecordedChannel

_FIXED = {"frame": "axis1", "series": "index"}  # kinds of the fixed format, and the dataset of their index
_TABLES = ("frame_table", "series_table")
_NANOSECONDS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1000, "ns": 1}
_NONE = "N."  # pickled
_MAX_NAMES = 1_000_000  # bytes of pickled names


class DateOrigin:
    """The earliest date of a file, from which all dates count."""

    def __init__(self) -> None:
        self._columns: list[tuple[Callable[[int], Any], int]] = []

    def add(self, read: Callable[[int], Any], tick: int) -> None:
        """Add dates in ticks of so many ns; `read` returns so many of the first ones, as integers."""
        self._columns.append((read, tick))

    def seconds(self, read: Callable[[int], Any], tick: int, count: int) -> Float:
        """Return `count` dates in s since the earliest one of the file, Float[count]; NaN where there is none."""
        firsts = ((values, own) for values, own in ((read(1), tick) for read, tick in self._columns) if values.size)
        # the least integer is NaT, which pandas stores for a missing date
        known = [int(values[0]) * own for values, own in firsts if values[0] != np.iinfo(np.int64).min]
        ticks = np.asarray(read(count), dtype=np.int64)
        origin = min(known, default=0)
        # whole ticks first, which are exact, then the part of a tick by which the origin differs
        elapsed = (ticks - origin // tick).astype(np.float64) * (tick * 1e-9) - origin % tick * 1e-9
        return np.where(ticks == np.iinfo(np.int64).min, np.nan, elapsed)


def is_stored_frame(group: Any) -> bool:
    """Return whether a group holds a DataFrame or a Series."""
    kind = _text(group.attrs.get("pandas_type", b""))
    return (kind in _FIXED and ("block0_values" in group or "values" in group)) or (
        kind in _TABLES and "table" in group and group["table"].dtype.names is not None
    )


def frame_channels(group: Any, path: str, origin: DateOrigin) -> tuple[int, list[RecordedChannel]]:
    """Return the number of rows and the channels: index and columns."""
    kind = _text(group.attrs["pandas_type"])
    if kind in _TABLES:
        return int(group["table"].shape[0]), list(_table(group["table"], path, origin))
    rows = _rows(group, kind)
    channels = list(_index(group, _FIXED[kind], rows, path, origin))
    return rows, [*channels, *_blocks(group, kind, rows, path, origin)]


def _rows(group: Any, kind: str) -> int:
    index = _FIXED[kind]
    if index in group:
        return int(group[index].shape[0])
    values = group["values" if kind == "series" else "block0_values"]
    return int(values.shape[0])


def _index(group: Any, member: str, rows: int, path: str, origin: DateOrigin) -> Iterator[RecordedChannel]:
    """Yield the index, if it is one column; an index without a name that just counts is none."""
    if member not in group:
        return
    item = group[member]
    tick = _tick(_text(item.attrs.get("kind", b"")))
    name = _text(item.attrs.get("name", b""))
    if tick is None and name == _NONE and item.dtype.kind in "iu":
        return
    name = "time" if tick is not None else "index" if name in ("", _NONE) else name
    yield _channel(name, path, item.dtype, tick, partial(_vector, item), rows, origin)


def _blocks(group: Any, kind: str, rows: int, path: str, origin: DateOrigin) -> Iterator[RecordedChannel]:
    if kind == "series":
        values = group["values"]
        name = _text(group.attrs.get("name", b""))
        own = "value" if name in ("", _NONE) else name
        yield _channel(own, path, values.dtype, _value_tick(values), partial(_vector, values), rows, origin)
        return
    for number in range(int(group.attrs.get("nblocks", 0))):
        names, values = group[f"block{number}_items"], group[f"block{number}_values"]
        # a block of objects is one pickled cell, not a matrix
        numeric = len(values.shape) == 2 and values.shape[0] == rows
        for column, name in enumerate(map(_text, names[()])):
            kind_of = values.dtype if numeric else np.dtype("O")
            read = partial(_column, values, column)
            yield _channel(name, path, kind_of, _value_tick(values), read, rows, origin)


def _table(item: Any, path: str, origin: DateOrigin) -> Iterator[RecordedChannel]:
    rows = int(item.shape[0])
    for field in item.dtype.names:
        kind = item.dtype[field]
        width = kind.shape[0] if kind.shape else 1
        tick = _tick(_text(item.attrs.get(f"{field}_kind" if field == "index" else f"{field}_dtype", b"")))
        if field == "index" and tick is None and kind.base.kind in "iu":
            continue
        names = ["time" if field == "index" and tick is not None else field]
        if kind.shape:
            names = _pickled_names(item.attrs.get(f"{field}_kind", b""))
            names = names if len(names) == width else [f"{field}[{number}]" for number in range(width)]
        for number, name in enumerate(names):
            read = partial(_field, item, field, number if kind.shape else None)
            yield _channel(name, path, kind.base, tick, read, rows, origin)


def _channel(
    name: str,
    path: str,
    kind: Any,
    tick: int | None,
    read: Callable[[int], Any],
    rows: int,
    origin: DateOrigin,
) -> RecordedChannel:
    full = f"{path}/{name}".lstrip("/")
    if tick is not None and kind.kind in "iu":
        origin.add(read, tick)
        return RecordedChannel(name, full, "s", partial(origin.seconds, read, tick, rows), dated=True)
    content = "" if kind.kind in "fiub" else "a text"
    return RecordedChannel(name, full, "", partial(_numbers, read, rows), content=content)


def _numbers(read: Callable[[int], Any], rows: int) -> Float:
    return np.asarray(read(rows), dtype=np.float64)


def _vector(item: Any, count: int) -> Any:
    return item[:count]


def _column(item: Any, column: int, count: int) -> Any:
    return item[:count, column]


def _field(item: Any, field: str, column: int | None, count: int) -> Any:
    values = item.fields(field)[:count]
    return values if column is None else values[:, column]


def _tick(kind: str) -> int | None:
    """Return the resolution of dates and durations in ns; None for other kinds.

    >>> _tick("datetime64[us]"), _tick("timedelta64"), _tick("float64")
    (1000, 1, None)
    """
    word, _, unit = kind.partition("[")
    if word not in ("datetime64", "timedelta64"):
        return None
    return _NANOSECONDS.get(unit.partition(",")[0].rstrip("]") or "ns", 1)


def _value_tick(values: Any) -> int | None:
    return _tick(_text(values.attrs.get("value_type", b"")))


def _pickled_names(raw: Any) -> list[str]:
    """Return the texts of a pickled list of names; none if it holds anything else."""
    content = raw.tobytes() if isinstance(raw, np.void) else raw if isinstance(raw, bytes) else b""
    names: list[str] = []
    try:
        for operation, value, _ in pickletools.genops(content[:_MAX_NAMES]):
            if "UNICODE" in operation.name:
                names.append(str(value))
    except ValueError:
        return []
    return names


def _text(name: Any) -> str:
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
