"""Reader of HDF5 files, netCDF 4 included: vectors of equal length, tables, frames of pandas.

The vectors of a group that have one length are channels of one raster. Their time is one of them, or a vector of this
length in a group above, as the dimension scales of netCDF are. MATLAB files of version 7.3 have a reader of their own.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import InputError
from kennfeld.formatting import join_names
from kennfeld.matlab import mat_v73
from kennfeld.measurement import matlab
from kennfeld.measurement.damage import damaged
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.recorded_groups import RecordedChannel, RecordedGroup, tables_of
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.table_conversion import TableDescription, describe_table
from kennfeld.measurement.unit_text import may_be_time, split_name
from kennfeld.measurement.variable_attributes import description_of, unit_of, unpack_numbers

_MAX_OBJECTS = 100_000
_MAX_DEPTH = 20
_MAX_RATIO = 1000  # bytes of numbers for each byte of the file
_HARMLESS = 1_000_000_000  # bytes of numbers that are read from any file
_COLUMN_NAMES = ("column_names", "columns", "names", "labels")
_RESOLUTIONS = {"datetime64[s]": 1.0, "datetime64[ms]": 1e-3, "datetime64[us]": 1e-6}  # s; else ns
_FRAME = b"frame"  # as pandas marks a DataFrame of its fixed format


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each raster that has a requested channel."""
    if _is_matlab(source):
        return matlab.read_tables(source, selection)
    return _with_file(source, lambda groups: tables_of(source.location, groups, selection))


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return a description of each raster."""
    if _is_matlab(source):
        return matlab.describe_tables(source)
    return [describe_table(table) for table in read_tables(source, Selection())]


def _is_matlab(source: MeasurementFile) -> bool:
    try:
        return mat_v73.is_matlab(source.path)
    except Exception as error:  # of many kinds: the library trusts what it reads
        raise damaged(source, "HDF5", error) from None


def _with_file(source: MeasurementFile, work: Callable[[list[RecordedGroup]], list[Table]]) -> list[Table]:
    import h5py

    try:
        with h5py.File(source.path, "r") as file:
            content = _Content(source.size)
            content.visit(file, "", 0, {})
            if content.groups:
                return work(content.groups)
    except InputError:
        raise
    except Exception as error:  # of many kinds, as above
        raise damaged(source, "HDF5", error) from None
    if content.others:
        message = f"holds no vectors: {join_names(content.others, 8)}"
        raise InputError.of(source.location, message, "Store channels as vectors of equal length, with a vector time.")
    raise InputError.of(source.location, "holds no data", "Is it the right file?")


class _Content:
    """The rasters of a file."""

    def __init__(self, size: int) -> None:
        self.groups: list[RecordedGroup] = []
        self.others: list[str] = []  # what is no vector
        self._room = max(_HARMLESS, _MAX_RATIO * size)
        self._objects = 0

    def visit(self, group: Any, path: str, depth: int, times: Mapping[int, RecordedChannel]) -> None:
        """Add the rasters of a group and of those in it; `times` are vectors of time in groups above, by length."""
        if depth > _MAX_DEPTH:
            raise ValueError("its groups are nested too deeply")
        vectors: dict[int, list[RecordedChannel]] = defaultdict(list)
        inner: list[tuple[str, Any]] = []
        for name, item in _members(group):
            self._objects += 1
            if self._objects > _MAX_OBJECTS:
                raise ValueError(f"it holds more than {_MAX_OBJECTS} objects")
            if hasattr(item, "keys"):
                inner.append((name, item))
            else:
                self._add(item, name, f"{path}/{name}".lstrip("/"), vectors)
        if _is_frame(group):
            vectors = _frame(group, path)
        own = {length: time for length, channels in vectors.items() if (time := _time_among(channels)) is not None}
        for length, channels in vectors.items():
            above = times.get(length) if length not in own else None
            if not path and channels == [own.get(length)] and len(channels) == 1:
                continue  # the time of groups below
            members = [above, *channels] if above is not None else channels
            label = path or ("" if len(vectors) == 1 else f"{length} samples")
            self.groups.append(RecordedGroup(label, length, [member for member in members if member is not None]))
        for name, item in inner:
            if not _is_frame(group):
                self.visit(item, f"{path}/{name}".lstrip("/"), depth + 1, {**times, **own})

    def _add(self, item: Any, name: str, path: str, vectors: dict[int, list[RecordedChannel]]) -> None:
        """Add the channels of a dataset."""
        shape = item.shape or ()
        if item.dtype.names and len(shape) == 1:
            for each in item.dtype.names:
                if not item.dtype[each].shape:
                    attributes = dict(item.attrs)
                    kind = item.dtype[each]
                    self._append(vectors, item, each, f"{path}/{each}", kind, partial(_field, item, each), attributes)
        elif len(shape) == 1:
            attributes = dict(item.attrs)
            self._append(vectors, item, name, path, item.dtype, partial(_vector, item, attributes), attributes)
        elif len(shape) == 2 and (columns := _column_names(item)):
            for number, each in enumerate(columns):
                self._append(vectors, item, each, f"{path}/{each}", item.dtype, partial(_matrix, item, number), {})
        elif shape:
            self.others.append(f"{path} ({' x '.join(map(str, shape))})")

    def _append(
        self,
        vectors: dict[int, list[RecordedChannel]],
        item: Any,
        name: str,
        path: str,
        kind: Any,
        load: Callable[[], Float],
        attributes: Mapping[str, Any],
    ) -> None:
        length = int(item.shape[0])
        if not length:
            return
        self._room -= 8 * length
        if self._room < 0:
            raise ValueError("it claims to hold far more numbers than its size allows")
        content = "" if kind.kind in "fiub" else "a text" if kind.kind in "OSU" else "a value of another kind"
        short, unit = split_name(name)
        unit = unit_of(attributes) or unit
        vectors[length].append(RecordedChannel(short, path, unit, load, description_of(attributes), content=content))


def _members(group: Any) -> Iterator[tuple[str, Any]]:
    """Yield the members of the group itself; links to other places and files are not followed."""
    import h5py

    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            yield name, group[name]


def _time_among(channels: list[RecordedChannel]) -> RecordedChannel | None:
    return next((each for each in channels if not each.content and may_be_time(each.name, each.unit)), None)


def _vector(item: Any, attributes: Mapping[str, Any]) -> Float:
    return unpack_numbers(item[()], attributes)


def _field(item: Any, name: str) -> Float:
    return np.asarray(item.fields(name)[()], dtype=np.float64)


def _matrix(item: Any, column: int) -> Float:
    return np.asarray(item[:, column], dtype=np.float64)


def _column_names(item: Any) -> list[str]:
    """Return the names of a matrix' columns from its attributes; none if there are not as many."""
    for attribute in _COLUMN_NAMES:
        names = item.attrs.get(attribute)
        if isinstance(names, np.ndarray | list | tuple) and len(names) == item.shape[1]:
            return [name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name) for name in names]
    return []


def _is_frame(group: Any) -> bool:
    return bool(np.bytes_(group.attrs.get("pandas_type", b"")) == _FRAME) and "axis1" in group


def _frame(group: Any, path: str) -> dict[int, list[RecordedChannel]]:
    """Return the channels of a DataFrame as pandas stores it: its index, then blocks of columns of one type."""
    index = group["axis1"]
    kind = _decode(index.attrs.get("kind", b""))
    stamped = kind.startswith("datetime64")
    load = partial(_stamps, index, _RESOLUTIONS.get(kind, 1e-9)) if stamped else partial(_vector, index, {})
    name = "time" if stamped else _decode(index.attrs.get("name", b"")) or "index"
    channels = [RecordedChannel(name, f"{path}/{name}", "s" if stamped else "", load, dated=stamped)]
    for number in range(int(group.attrs.get("nblocks", 0))):
        names, values = group[f"block{number}_items"][()], group[f"block{number}_values"]
        numeric = values.dtype.kind in "fiub" and len(values.shape) == 2
        for column, each in enumerate(map(_decode, names)):
            content = "" if numeric else "a text"
            channels.append(
                RecordedChannel(each, f"{path}/{each}", "", partial(_matrix, values, column), content=content)
            )
    return {int(index.shape[0]): channels}


def _stamps(index: Any, resolution: float) -> Float:
    ticks = index[()].astype(np.int64)
    return np.asarray((ticks - ticks[0]) * resolution, dtype=np.float64)  # ns since 1970 need more than 53 bits


def _decode(name: Any) -> str:
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
