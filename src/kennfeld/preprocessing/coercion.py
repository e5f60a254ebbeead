"""Conversion of data that callers of the Python API pass: datasets, or columns by name.

`Dataset.of`, `calibrate`, `simulate` and `cross_validate` convert columns by `read_recording`. A time column is
recognised by the same rules as in files.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location, warn
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import array
from kennfeld.domain.data_frames import Table
from kennfeld.domain.dataset import Channel, Clock, Dataset
from kennfeld.graph import Graph
from kennfeld.measurement.table import Column
from kennfeld.measurement.table import Table as FileTable
from kennfeld.measurement.time_column import clock_of, find_time, is_named_time, time_in_seconds
from kennfeld.measurement.unit_text import split_name, time_unit
from kennfeld.preprocessing.columns import Columns, column_names, read_columns

Data = Dataset | Table

_INDEX = "the index"
_PIECE = "piece"  # level of an index, or column, that numbers the pieces of a recording


@dataclass(frozen=True, eq=False)
class RecordedColumns:
    """Channels of named columns, with time stamps in s, Float[samples], and pieces, Int[pieces], if they hold these.

    `disorder` is the error that the stamps do not increase, so that they cannot be the time.
    """

    channels: tuple[Channel, ...]
    time: Float | None = None
    starts: Int | None = None
    clock: Clock | None = None
    disorder: Finding | None = None


def to_dataset(data: Data, name: str, graph: Graph, asked: Collection[str]) -> Dataset:
    """Return data as a dataset, with the time stamps that a column holds.

    Columns remain channels as well, so that a function may have an input called `time`.

    Args:
        data: a dataset, or columns by name: a dict of arrays, a DataFrame.
        name: the name of the dataset, unless it is one.
        graph: the function that runs over the data.
        asked: the channels that the function reads or is compared with; `t` and columns of dates are not time if they
            are among these.

    Returns:
        The dataset; its channels are Float[samples], its time is in s.

    Warns:
        InputWarning: a column in `asked` holds infinite values, which are treated as missing.

    Raises:
        InputError: a column does not hold numbers, or time does not increase and the function needs it.
    """
    if isinstance(data, Dataset):
        dataset = _with_time(data, asked) if graph.is_timed else _without_guessed_time(data, asked)
    else:
        recorded = read_recording(name, data, asked=asked)
        if recorded.disorder is not None and graph.is_timed:
            raise InputError([recorded.disorder])
        dataset = dataset_of(name, recorded)
    locations = {Location(f"dataset {dataset.name}, channel {channel}") for channel in asked}
    warn(finding for finding in dataset.findings if finding.location in locations)
    return dataset


def dataset_of(name: str, recorded: RecordedColumns) -> Dataset:
    """Return the dataset of columns, with NaN for infinite values."""
    starts = np.zeros(1, dtype=np.int64) if recorded.starts is None else recorded.starts
    data = Dataset(name, recorded.channels, recorded.time, starts, clock=recorded.clock)
    return data.without_infinite()


def names_of(data: Data) -> set[str]:
    """Return the names of the channels of a dataset, or of columns."""
    return set(data) if isinstance(data, Dataset) else column_names(data)


def read_recording(
    name: str,
    data: Table,
    units: Mapping[str, str] | None = None,
    asked: Collection[str] = (),
    *,
    timed: bool = True,
) -> RecordedColumns:
    """Return the channels of named columns, and the time and the pieces that a column or an index holds.

    A column or level called `piece` begins a new piece where its value changes, if there is time, which increases
    within each piece. Columns of dates that are neither the time nor in `asked` are left out.

    Args:
        name: the name of the dataset, for messages.
        data: columns by name.
        units: of columns, by name; they precede those that the table states.
        asked: the channels that a function reads or is compared with, which dates and `t` may be.
        timed: False if the caller says what the time is.

    Raises:
        InputError: columns do not hold numbers; reports all of them.
        ArgumentError: a unit of an unknown column, or data without named columns.
    """
    columns = read_columns(data)
    units = {**columns.units, **_checked_units(name, units or {}, columns)}
    stamps = {key: found for key, column in columns.values.items() if (found := _stamps(column, key)) is not None}
    channels = _channels(name, columns, units, stamps, asked)
    if not timed:
        return RecordedColumns(channels)
    by_name = {channel.name: channel for channel in channels}
    kept = (key for key in columns.values if key in stamps or key in by_name)
    clocks = [
        *_index(columns),
        *(stamps.get(key) or _column(key, by_name[key].values, units.get(key, "")) for key in kept),
    ]
    return _timed(name, channels, clocks, _pieces(columns, by_name, asked), asked)


def _checked_units(name: str, units: Mapping[str, str], columns: Columns) -> Mapping[str, str]:
    for channel in units:
        if channel not in columns.values:
            remedy = nearest(channel, columns.values)
            raise ArgumentError(f"units of dataset {name}: there is no column {channel}. {remedy}".strip())
    return units


def _channels(
    name: str, columns: Columns, units: Mapping[str, str], stamps: Mapping[str, Column], asked: Collection[str]
) -> tuple[Channel, ...]:
    channels, findings = [], []
    for key, column in columns.values.items():
        if key in stamps:
            # a column that is read as time is a channel in s
            is_time = time_unit(key, "") is not None
            if not is_time and key not in asked:
                continue
            column = stamps[key].values if is_time else column
        try:
            channels.append(Channel(key, array(column, f"channel {key}"), units.get(key, "")))
        except ArgumentError as error:
            remedy = "Omit it, or replace it by numbers."
            findings.append(Finding(Location(f"dataset {name}"), str(error), remedy))
    if findings:
        raise InputError(findings)
    return tuple(channels)


def _pieces(columns: Columns, channels: Mapping[str, Channel], asked: Collection[str]) -> Any:
    """Return the values that number the pieces; None if there are none."""
    levels = [values for label, values in columns.levels if label == _PIECE]
    if levels:
        return np.asarray(levels[0])
    return channels[_PIECE].values if _PIECE in channels and _PIECE not in asked else None


def _timed(
    name: str, channels: tuple[Channel, ...], clocks: list[Column], pieces: Any, asked: Collection[str]
) -> RecordedColumns:
    """Return the channels with the time among some columns."""
    column = _find_time(name, clocks, asked)
    if column is None:
        return RecordedColumns(channels)
    time = time_in_seconds(column)
    starts = np.zeros(1, dtype=np.int64)
    if pieces is not None:
        starts = np.append(starts, np.flatnonzero(pieces[1:] != pieces[:-1]) + 1)
    if (wrong := _disorder(name, column, time, starts)) is not None:
        return RecordedColumns(channels, disorder=wrong)
    return RecordedColumns(channels, time, starts, clock_of(column))


def _find_time(name: str, columns: list[Column], asked: Collection[str]) -> Column | None:
    # columns go by their names without units: `t [s]` is `t`
    names = {*asked, *(split_name(each)[0] for each in asked)}
    rows = np.arange(columns[0].values.size if columns else 0)
    return find_time(FileTable(Location(name), tuple(columns), rows, names=tuple(c.name for c in columns)), names)


def _disorder(name: str, column: Column, time: Float, starts: Int) -> Finding | None:
    """Return the error that stamps do not increase within a piece; None if they do."""
    steps = np.diff(time)
    steps[starts[1:] - 1] = 1.0  # from one piece to the next, time may go back
    # so that NaN is wrong, too
    wrong = np.flatnonzero(~(steps > 0))
    if not wrong.size:
        return None
    k = int(wrong[0])
    message = f"{column.place} does not increase at sample {k + 2}: {time[k]:g} s, then {time[k + 1]:g} s"
    remedy = "Sort the rows by time, and pass each recording as a dataset of its own."
    return Finding(Location(f"dataset {name}"), message, remedy)


def _with_time(data: Dataset, asked: Collection[str]) -> Dataset:
    """Return a dataset for a function that needs time, with that of a channel if it has none of its own."""
    if data.time is not None or data.settling is not None:
        return data
    clocks = [_column(c.name, c.values, c.unit) for c in data.channels]
    column = _find_time(data.name, clocks, asked)
    if column is None:
        return data
    time = time_in_seconds(column)
    if (wrong := _disorder(data.name, column, time, data.piece_starts)) is not None:
        raise InputError([wrong])
    return replace(data, time=time, clock=clock_of(column))


def _without_guessed_time(data: Dataset, asked: Collection[str]) -> Dataset:
    """Return the points of a dataset whose column of time, such as `t`, turns out to be a channel of the function."""
    clock = data.clock
    if data.time is None or clock is None or clock.name not in asked:
        return data
    unit = data[clock.name].unit if clock.name in data else ""
    return data if is_named_time(clock.name, unit) else replace(data, time=None, clock=None)


def _column(name: str, values: Float, unit: str = "") -> Column:
    plain, stated = split_name(name)
    return Column(plain, unit or stated, name, values)


def _stamps(column: Any, name: str) -> Column | None:
    """Return the column of dates or time differences, in seconds from the first; None if it holds anything else."""
    kind = getattr(getattr(column, "dtype", None), "kind", "")
    if kind not in ("M", "m"):
        return None
    unit = "M8[ns]" if kind == "M" else "m8[ns]"
    stamps = np.asarray(column, dtype=unit)
    known = stamps[~np.isnat(stamps)]
    values = (stamps - (known[0] if known.size and kind == "M" else np.zeros((), unit))) / np.timedelta64(1, "s")
    return Column(name, "s", name, values, dated=kind == "M")


def _index(columns: Columns) -> Iterator[Column]:
    """Yield the levels of an index that hold dates or have a name of time."""
    for label, values in columns.levels:
        dates = _stamps(values, "time")
        name, unit = split_name(label)
        if dates is not None:
            yield replace(dates, place=_INDEX)
        elif time_unit(name, unit) is not None:
            yield replace(_column(label, np.asarray(values, dtype=np.float64)), place=f"{_INDEX} {label}")
