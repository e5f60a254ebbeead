"""Conversion of data that callers of the Python API pass: datasets, or columns by name.

A time column is recognised by the same rules as in files.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kennfeld.base.arrays import ArrayLike, Float
from kennfeld.base.errors import ArgumentError, InputError, Location, warn
from kennfeld.domain.dataset import Dataset
from kennfeld.graph import Graph
from kennfeld.measurement.table import Column, Table
from kennfeld.measurement.time_column import clock_of, find_time, time_in_seconds
from kennfeld.measurement.unit_text import split_name, time_unit

Data = Dataset | Mapping[str, ArrayLike]

_INDEX = "the index"


def to_dataset(data: Data, name: str, graph: Graph, asked: Collection[str]) -> Dataset:
    """Return data as a dataset, with the time stamps that a column holds.

    Columns remain channels as well, so that a function may have an input called `time`. A channel of a `Dataset`
    without time stamps becomes its time only if the function needs time.

    Args:
        data: a dataset, or columns by name: a dict of arrays, a pandas DataFrame.
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
        needs_time = data.time is None and data.settling is None and graph.is_timed
        columns = [_column(c.name, c.values, c.unit) for c in data.channels] if needs_time else []
        return _add_time(data, columns, graph, asked)
    _check_columns(data)
    stamps = {str(key): column for key in data if (column := _stamps(data[key], str(key))) is not None}
    plain = {key: data[key] for key in data if str(key) not in stamps or str(key) in asked}
    # a column that is read as time is a channel in s; other dates stay what the caller passed
    times = {key: stamps[str(key)].values for key in plain if str(key) in stamps and time_unit(str(key), "")}
    dataset = Dataset.of(name, plain | times)
    locations = {Location(f"dataset {name}, channel {channel}") for channel in asked}
    warn(finding for finding in dataset.findings if finding.location in locations)
    columns = [stamps[c] if c in stamps else _column(c, dataset[c].values) for c in map(str, data)]
    return _add_time(dataset, [*columns, *_index(data)], graph, asked)


def _check_columns(data: object) -> None:
    """Raise `ArgumentError` for an object without named columns, such as the name of a file."""
    if not (isinstance(data, Mapping) or (hasattr(data, "columns") and hasattr(data, "keys"))):
        message = f"data must be a dataset or columns by name, a dict or a DataFrame, got {type(data).__name__}"
        raise ArgumentError(f"{message}. kennfeld.read reads a file.")


def _add_time(dataset: Dataset, columns: list[Column], graph: Graph, asked: Collection[str]) -> Dataset:
    # columns go by their names without units: `t [s]` is `t`
    names = {*asked, *(split_name(name)[0] for name in asked)}
    rows = np.arange(columns[0].values.size if columns else 0)
    table = Table(Location(dataset.name), tuple(columns), rows, names=tuple(c.name for c in columns))
    column = find_time(table, names)
    if column is None:
        return dataset
    time = time_in_seconds(column)
    # so that NaN is wrong, too
    wrong = np.flatnonzero(~(np.diff(time) > 0))
    if wrong.size and graph.is_timed:
        k = int(wrong[0])
        message = f"{column.place} does not increase at sample {k + 2}: {time[k]:g} s, then {time[k + 1]:g} s"
        remedy = "Sort the rows by time, and pass each recording as a dataset of its own."
        raise InputError.of(Location(f"dataset {dataset.name}"), message, remedy)
    # a function without time runs over unordered stamps as over points
    return dataset if wrong.size else replace(dataset, time=time, clock=clock_of(column))


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


def _index(data: Any) -> list[Column]:
    """Return the index of a DataFrame if it holds dates or has a name of time."""
    index = getattr(data, "index", None)
    if index is None or not hasattr(data, "columns"):
        return []
    label = "" if index.name is None else str(index.name)
    dates = _stamps(index, "time")
    if dates is not None:
        return [replace(dates, place=_INDEX)]
    if time_unit(label, "") is None:
        return []
    return [replace(_column(label, np.asarray(index, dtype=np.float64)), place=f"{_INDEX} {label}")]
