"""Reader of HDF5 files, netCDF 4 included: vectors of equal length, tables, frames of pandas.

The vectors of a group that have one length are channels of one raster. Their time is one of them, or a vector of this
length in a group above, as the dimension scales of netCDF are. MATLAB files of version 7.3 have a reader of their own.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError
from kennfeld.base.formatting import join_names
from kennfeld.base.process_limits import memory_bound
from kennfeld.matlab import mat_v73
from kennfeld.measurement import matlab
from kennfeld.measurement.damage import damaged
from kennfeld.measurement.exact_numbers import rest_of_integers
from kennfeld.measurement.pandas_frames import DateOrigin, frame_channels, is_stored_frame
from kennfeld.measurement.recorded_groups import (
    RecordedChannel,
    RecordedGroup,
    tables_of,
    unnamed_matrices,
    with_clock,
)
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Selection, Table
from kennfeld.measurement.table_conversion import TableDescription, describe_table
from kennfeld.measurement.unit_text import may_be_time, split_name
from kennfeld.measurement.variable_attributes import (
    description_of,
    is_placeholder,
    is_time_coordinate,
    texts_of,
    unit_of,
    unpack_numbers,
)

_MAX_OBJECTS = 100_000
_MAX_DEPTH = 20
_SCALING = frozenset({"scale_factor", "add_offset", "_Unsigned"})
_COLUMN_NAMES = ("column_names", "columns", "names", "labels")


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return a table for each raster that has a requested channel."""
    tables: list[Table] = mat_v73.LIBRARY.call(read_by_library, source, selection)
    return tables


def read_by_library(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the tables; the process should be one that may crash or hang."""
    if _is_matlab(source):
        return matlab.tables_by_library(source, selection)
    return _with_file(
        source,
        lambda content: tables_of(source, content.groups, selection, unnamed_matrices(content.matrices)),
    )


def describe_tables(source: MeasurementFile) -> list[TableDescription]:
    """Return a description of each raster."""
    descriptions: list[TableDescription] = mat_v73.LIBRARY.call(describe_by_library, source)
    return descriptions


def describe_by_library(source: MeasurementFile) -> list[TableDescription]:
    """Return the descriptions as `read_by_library` does."""
    if _is_matlab(source):
        return matlab.descriptions_by_library(source)
    return [describe_table(table) for table in read_by_library(source, Selection())]


def _is_matlab(source: MeasurementFile) -> bool:
    try:
        return mat_v73.is_matlab(source.path)
    except Exception as error:  # of many kinds: the library trusts what it reads
        raise damaged(source, "HDF5", error) from None


def _with_file(source: MeasurementFile, work: Callable[["_Content"], list[Table]]) -> list[Table]:
    import h5py

    try:
        with h5py.File(source.path, "r") as file:
            content = _Content(source.stored_size())
            content.visit(file, "", 0, {})
            if content.groups:
                return work(content)
    except InputError:
        raise
    except Exception as error:  # of many kinds, as above
        raise damaged(source, "HDF5", error) from None
    if content.matrices:
        sizes = [f"{path} ({' x '.join(map(str, shape))})" for path, shape in content.matrices.items()]
        message = f"holds no vectors: {join_names(sizes, 8)}"
        raise InputError.of(source.location, message, "Store channels as vectors of equal length, with a vector time.")
    raise InputError.of(source.location, "holds no data", "Is it the right file?")


class _Content:
    """The rasters of a file."""

    def __init__(self, size: int) -> None:
        self.groups: list[RecordedGroup] = []
        self.matrices: dict[str, tuple[int, ...]] = {}  # values that are not vectors: path and size
        self._dates = DateOrigin()
        self._room = memory_bound(size)
        self._objects = 0

    def visit(self, group: Any, path: str, depth: int, times: Mapping[int, RecordedChannel]) -> None:
        """Add the rasters of a group and of those in it; `times` are vectors of time in groups above, by length."""
        if depth > _MAX_DEPTH:
            raise ValueError("its groups are nested too deeply")
        if is_stored_frame(group):
            rows, columns = frame_channels(group, path, self._dates)
            self._reserve(rows * len(columns))
            if rows and columns:
                self.groups.append(RecordedGroup(path, rows, columns))
            return
        vectors: dict[int, list[RecordedChannel]] = defaultdict(list)
        inner: list[tuple[str, Any]] = []
        for name, item in _members(group):
            self._objects += 1
            if self._objects > _MAX_OBJECTS:
                raise ValueError(f"it holds more than {_MAX_OBJECTS} objects")
            if hasattr(item, "keys"):
                inner.append((name, item))
            elif hasattr(item, "shape"):
                self._add(item, name, f"{path}/{name}".lstrip("/"), vectors)
        # before the groups inside, which may lack a time of their own
        own = self._add_rasters(path, vectors, times)
        for name, item in inner:
            self.visit(item, f"{path}/{name}".lstrip("/"), depth + 1, {**times, **own})

    def _add_rasters(
        self, path: str, vectors: dict[int, list[RecordedChannel]], times: Mapping[int, RecordedChannel]
    ) -> dict[int, RecordedChannel]:
        """Add the vectors of a group as rasters; return their times by length."""
        vectors = {length: with_clock(channels) for length, channels in vectors.items()}
        own = {length: time for length, channels in vectors.items() if (time := _time_among(channels)) is not None}
        for length, channels in vectors.items():
            if not path and channels == [own.get(length)]:
                continue  # the time of groups below
            above = times.get(length) if length not in own else None
            label = path or ("" if len(vectors) == 1 else f"{length} samples")
            self.groups.append(RecordedGroup(label, length, channels if above is None else [above, *channels]))
        return own

    def _add(self, item: Any, name: str, path: str, vectors: dict[int, list[RecordedChannel]]) -> None:
        """Add the channels of a dataset."""
        shape: tuple[int, ...] = item.shape or ()
        attributes = dict(item.attrs)
        if is_placeholder(attributes):
            return
        if item.dtype.names and len(shape) == 1:
            for each in item.dtype.names:
                kind = item.dtype[each]
                if kind.shape:
                    self.matrices[f"{path}/{each}"] = (*shape, *kind.shape)
                else:
                    self._append(vectors, item, each, f"{path}/{each}", kind, partial(_field, item, each), {})
        elif len(shape) == 1 or (len(shape) == 2 and 1 in shape):
            load = partial(_vector, item, attributes)
            self._append(vectors, item, name, path, item.dtype, load, attributes)
        elif len(shape) == 2 and (columns := _column_names(item)):
            units = texts_of(attributes, "units") or texts_of(attributes, "unit")
            for number, each in enumerate(columns):
                own = {**attributes, "units": units[number]} if len(units) == len(columns) > 1 else attributes
                load = partial(_matrix, item, number, attributes)
                self._append(vectors, item, each, f"{path}/{each}", item.dtype, load, own, rows=shape[0])
        elif shape and _holds_numbers(item.dtype):
            self.matrices[path] = shape

    def _reserve(self, numbers: int) -> None:
        # chunks that were never written take no space, so a small file may claim any size
        self._room -= 8 * numbers
        if self._room < 0:
            raise ValueError("it claims to hold far more numbers than its size allows")

    def _append(
        self,
        vectors: dict[int, list[RecordedChannel]],
        item: Any,
        name: str,
        path: str,
        kind: Any,
        load: Callable[[], Float],
        attributes: Mapping[str, Any],
        rows: int | None = None,
    ) -> None:
        length = int(item.size if rows is None else rows)
        if not length:
            return
        self._reserve(length)
        content = "" if _holds_numbers(kind) else "a text" if kind.kind in "OSU" else "a value of another kind"
        short, unit = split_name(name)
        unit = unit_of(attributes) or unit
        clock = not content and is_time_coordinate(attributes)
        description = description_of(attributes)
        exact = partial(_rest, item) if kind.kind in "iu" and kind is item.dtype and may_be_time(short, unit) else None
        channel = RecordedChannel(short, path, unit, load, description, content=content, clock=clock, rest=exact)
        vectors[length].append(channel)


def _members(group: Any) -> Iterator[tuple[str, Any]]:
    """Yield the members of the group itself; links to other places and files are not followed."""
    import h5py

    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            item = group[name]
            if not (name.startswith("_i_") and hasattr(item, "keys")):  # indices of PyTables
                yield name, item


def _holds_numbers(kind: Any) -> bool:
    return bool(kind.kind in "fiub")


def _time_among(channels: Sequence[RecordedChannel]) -> RecordedChannel | None:
    stated = next((each for each in channels if each.clock), None)
    return stated or next((each for each in channels if not each.content and may_be_time(each.name, each.unit)), None)


def _vector(item: Any, attributes: Mapping[str, Any]) -> Float:
    return unpack_numbers(np.ravel(item[()]), attributes)


def _rest(item: Any) -> Float | None:
    values = np.ravel(item[()])
    # of packed numbers the integers are not the values
    return rest_of_integers(values) if len(item.attrs.keys() & _SCALING) == 0 else None


def _field(item: Any, name: str) -> Float:
    return np.asarray(item.fields(name)[()], dtype=np.float64)


def _matrix(item: Any, column: int, attributes: Mapping[str, Any]) -> Float:
    return unpack_numbers(item[:, column], attributes)


def _column_names(item: Any) -> list[str]:
    """Return the names of a matrix' columns from its attributes; none if there are not as many."""
    for attribute in _COLUMN_NAMES:
        names = item.attrs.get(attribute)
        if isinstance(names, np.ndarray | list | tuple) and len(names) == item.shape[1]:
            return [name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name) for name in names]
    return []
