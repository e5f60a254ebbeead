"""Conversion of data that callers of the Python API pass: datasets, or columns by name.

A time column is recognised by the same rules as in files.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kennfeld.arrays import ArrayLike, Float
from kennfeld.dataset import Dataset
from kennfeld.errors import ArgumentError, InputError, warn
from kennfeld.graph import Graph
from kennfeld.measurement.table import Column, Table
from kennfeld.measurement.time_column import clock_of, find_time, time_in_seconds
from kennfeld.measurement.unit_text import split_name, time_unit
from kennfeld.preprocessing.model_step import is_timed

Data = Dataset | Mapping[str, ArrayLike]

_INDEX = "the index"


def to_dataset(given: Data, name: str, graph: Graph, asked: Collection[str]) -> Dataset:
    """Return data as a dataset, with the time stamps that a column holds.

    Columns remain channels as well, so that a function may have an input called `time`. A channel of a `Dataset`
    without time stamps becomes its time only if the function needs time.

    Args:
        given: a dataset, or columns by name: a dict of arrays, a pandas DataFrame.
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
    if isinstance(given, Dataset):
        wanted = given.time is None and given.settling is None and is_timed(graph)
        columns = [_column(c.name, c.values, c.unit) for c in given.channels] if wanted else []
        return _with_time(given, columns, graph, asked)
    _check_columns(given)
    stamps = {str(key): column for key in given if (column := _stamps(given[key], str(key))) is not None}
    plain = {key: given[key] for key in given if str(key) not in stamps or str(key) in asked}
    dataset = Dataset.of(name, {key: _in_seconds(stamps, str(key), column) for key, column in plain.items()})
    places = {f"dataset {name}, channel {channel}" for channel in asked}
    warn(remark for remark in dataset.remarks if str(remark.location) in places)
    columns = [stamps[c] if c in stamps else _column(c, dataset[c].values) for c in map(str, given)]
    return _with_time(dataset, [*columns, *_index(given)], graph, asked)


def _check_columns(given: object) -> None:
    """Raise `ArgumentError` for an object without named columns, such as the name of a file."""
    if not (isinstance(given, Mapping) or (hasattr(given, "columns") and hasattr(given, "keys"))):
        message = f"data must be a dataset or columns by name, a dict or a DataFrame, got {type(given).__name__}"
        raise ArgumentError(f"{message}. kennfeld.read reads a file.")


def _with_time(dataset: Dataset, columns: list[Column], graph: Graph, asked: Collection[str]) -> Dataset:
    names = {*asked, *(split_name(one)[0] for one in asked)}
    rows = np.arange(columns[0].values.size if columns else 0)
    column = find_time(Table(dataset.name, tuple(columns), rows, names=tuple(c.name for c in columns)), names)
    if column is None:
        return dataset
    time = time_in_seconds(column)
    wrong = np.flatnonzero(~(np.diff(time) > 0))
    if wrong.size and is_timed(graph):
        k = int(wrong[0])
        message = f"{column.place} does not increase at sample {k + 2}: {time[k]:g} s, then {time[k + 1]:g} s"
        remedy = "Sort the rows by time, and pass each recording as a dataset of its own."
        raise InputError.of(f"dataset {dataset.name}", message, remedy)
    return dataset if wrong.size else replace(dataset, time=time, clock=clock_of(column))


def _column(name: str, values: Float, unit: str = "") -> Column:
    plain, stated = split_name(name)
    return Column(plain, unit or stated, name, values)


def _stamps(given: Any, name: str) -> Column | None:
    """Return the column of dates or time differences, in seconds from the first; None if it holds anything else."""
    kind = getattr(getattr(given, "dtype", None), "kind", "")
    if kind not in ("M", "m"):
        return None
    unit = "M8[ns]" if kind == "M" else "m8[ns]"
    stamps = np.asarray(given, dtype=unit)
    known = stamps[~np.isnat(stamps)]
    values = (stamps - (known[0] if known.size and kind == "M" else np.zeros((), unit))) / np.timedelta64(1, "s")
    return Column(name, "s", name, values, dated=kind == "M")


def _in_seconds(stamps: Mapping[str, Column], name: str, given: Any) -> Any:
    """Return the seconds of a column of dates with a name of time; other columns unchanged."""
    return stamps[name].values if name in stamps and time_unit(name, "") is not None else given


def _index(given: Any) -> list[Column]:
    """Return the index of a DataFrame if it holds dates or has a name of time."""
    index = getattr(given, "index", None)
    if index is None or not hasattr(given, "columns"):
        return []
    label = "" if index.name is None else str(index.name)
    dates = _stamps(index, "time")
    if dates is not None:
        return [replace(dates, place=_INDEX)]
    if time_unit(label, "") is None:
        return []
    return [replace(_column(label, np.asarray(index, dtype=np.float64)), place=f"{_INDEX} {label}")]
