"""Recorded signals: of MAT-files that blocks name, and of Signal Builders in the model file itself.

A Signal Builder keeps groups of signals, one of which is active: as objects (SigSuite) since R2010, before that as
channels with the points of each group.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.model_tree import StoredWorkspace
from kennfeld.importers.simulink.variables.datasets import (
    Recorded,
    dataset_signals,
    is_timeseries,
    stored_number,
    timeseries_points,
)
from kennfeld.importers.simulink.variables.stored_variables import (
    StoredVariable,
    StoredVariables,
    Value,
    mat_variables,
    mxarray_value,
    several,
)
from kennfeld.matlab.mat_nodes import MatFileError
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Numbers


class RecordedSeries(NamedTuple):
    """Values over times in s, Float[points]; two points at one time are a jump."""

    times: Numbers
    values: Numbers


@dataclass(frozen=True, eq=False)
class SignalGroup:
    """The active group of a Signal Builder: its name, the number of groups, and its signals by output."""

    name: str
    count: int
    signals: tuple[RecordedSeries, ...]


def file_recording(stored: StoredVariables) -> tuple[RecordedSeries, ...]:
    """Read the signals of a MAT-file for a From File block: a timeseries, or a matrix with the times in its first row.

    Raises:
        EvaluationError: if the first variable of the file is no such matrix.
    """
    if not stored.entries:
        raise EvaluationError(next(iter(stored.unreadable.values()), "it has no variables"))
    # a From File block names no variable: the first one of the file counts
    name, entry = next(iter(stored.entries.items()))
    if is_timeseries(entry):
        times, values = timeseries_points(entry)
        return tuple(RecordedSeries(times, column) for column in values.T)
    matrix = entry.value
    if not isinstance(matrix, np.ndarray) or matrix.ndim != 2 or matrix.shape[0] < 2:
        raise EvaluationError(f"its variable {name} ({entry.kind}) is not a matrix with the times in its first row")
    numbers = np.asarray(matrix, dtype=np.float64)
    return tuple(RecordedSeries(numbers[0], row) for row in numbers[1:])


def scenario_recording(stored: StoredVariables, scenario: str) -> tuple[Recorded, ...]:
    """Read the signals of a scenario in the file of a Signal Editor, a dataset of its name.

    Raises:
        EvaluationError: if the file has no such dataset.
    """
    if scenario not in stored.entries:
        names = join_names([name for name in stored.entries if name], 5) or "none"
        raise EvaluationError(f"it has no scenario {scenario[:40]}, but {names}")
    return dataset_signals(stored.entries[scenario])


def structure_recording(value: Mapping[str, object]) -> tuple[RecordedSeries, ...]:
    """Return the signals of a structure with time: `time`, and `signals.values` with a row for each time.

    Raises:
        EvaluationError: if the structure lacks these fields, or they do not match.
    """
    times, signals = value.get("time"), value.get("signals")
    parts = signals if isinstance(signals, tuple) else (signals,)
    columns: list[RecordedSeries] = []
    for part in parts:
        values = part.get("values") if isinstance(part, Mapping) else None
        if not isinstance(times, np.ndarray) or not isinstance(values, np.ndarray):
            raise EvaluationError("its structure has no time and signals.values")
        rows = np.asarray(values, dtype=np.float64).reshape(-1, 1) if values.ndim == 1 else np.asarray(values)
        if rows.ndim != 2 or len(rows) != times.size:
            raise EvaluationError(f"its structure has {times.size} times for values of {len(rows)} rows")
        columns += [RecordedSeries(times.ravel(), column) for column in rows.T]
    return tuple(columns)


def builder_recording(stored: StoredWorkspace) -> SignalGroup:
    """Decode the signals of a Signal Builder.

    Raises:
        EvaluationError: if its data are in an unknown form.
    """
    try:
        whole = _whole_value(stored)
    except MatFileError as error:
        raise EvaluationError(f"the data of the Signal Builder cannot be read: {error}") from None
    if not isinstance(whole, Mapping):
        raise EvaluationError("the data of the Signal Builder have an unknown form")
    # newer files keep the channels as well, but without their points
    suite = whole.get("sbobj")
    group = _of_suite(suite) if isinstance(suite, StoredVariable) else _of_channels(whole)
    if not group.signals or any(len(x) != len(y) or len(x) < 2 for x, y in group.signals):
        raise EvaluationError("the data of the Signal Builder have an unknown form")
    return group


def _whole_value(stored: StoredWorkspace) -> Value:
    if stored.kind == "mxarray":
        return mxarray_value(stored.raw)
    entry = mat_variables(stored.raw).entries.get(stored.text)
    return entry.value if entry is not None else None


def _of_suite(suite: StoredVariable) -> SignalGroup:
    groups = [group for group in several(suite.properties.get("Groups")) if isinstance(group, StoredVariable)]
    at = _position(suite.properties.get("ActiveGroup"), len(groups))
    if at is None:
        raise EvaluationError("the Signal Builder has no active group")
    # the order of the signals in a group is that of the outputs
    parts = [part for part in several(groups[at].properties.get("Signals")) if isinstance(part, StoredVariable)]
    signals = tuple(_series(part.properties.get("XData"), part.properties.get("YData")) for part in parts)
    name = groups[at].properties.get("Name")
    return SignalGroup(name if isinstance(name, str) else "", len(groups), signals)


def _of_channels(whole: Mapping[str, Value]) -> SignalGroup:
    channels = [channel for channel in several(whole.get("channels")) if isinstance(channel, Mapping)]
    groups = [group for group in several(whole.get("dataSet")) if isinstance(group, Mapping)]
    at = _position(whole.get("dataSetIdx"), max(len(groups), 1))
    if at is None:
        raise EvaluationError("the Signal Builder has no active group")
    # channels are in the order in which they were drawn
    ordered = sorted(channels, key=lambda channel: stored_number(channel.get("outIndex")) or 0.0)
    name = groups[at].get("name") if groups else ""
    signals = tuple(_of_channel(channel, at) for channel in ordered)
    return SignalGroup(name if isinstance(name, str) else "", max(len(groups), 1), signals)


def _of_channel(channel: Mapping[str, Value], at: int) -> RecordedSeries:
    """Return the points of one group; those that are shown are of the active group, and may be newer."""
    lists = [channel.get(key) for key in ("allXData", "allYData")]
    if all(isinstance(points, tuple) and at < len(points) for points in lists):
        return _series(*(points[at] if isinstance(points, tuple) else None for points in lists))
    return _series(channel.get("xData"), channel.get("yData"))


def _series(x: Value, y: Value) -> RecordedSeries:
    if not isinstance(x, np.ndarray) or not isinstance(y, np.ndarray):
        raise EvaluationError("the data of the Signal Builder have an unknown form")
    return RecordedSeries(*(np.asarray(part, dtype=np.float64).ravel() for part in (x, y)))


def _position(value: Value, count: int) -> int | None:
    """Return a stored number, which counts from 1, as a position among `count`; the first one if it is not stored."""
    at = int(stored_number(value) or 0.0) or 1
    return at - 1 if 1 <= at <= count else None
