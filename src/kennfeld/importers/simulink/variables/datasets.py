"""Objects that hold recorded signals: timeseries, and datasets of them, as files of scenarios and logs contain them."""

from collections.abc import Mapping
from typing import Final, TypeAlias, Union

import numpy as np

from kennfeld.importers.simulink.variables.stored_variables import StoredVariable, Value
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Numbers

# a signal: times in s, Float[points], and values, Float[points, elements]; or a bus of such signals by name
Recorded: TypeAlias = Union["tuple[Numbers, Numbers]", "dict[str, Recorded]"]

_MAX_POINTS: Final = 100_000_000
_SECONDS: Final[Mapping[str, float]] = {
    "": 1.0, "seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0,
    "hours": 3600.0, "days": 86400.0,
}  # fmt: skip


def is_timeseries(value: Value) -> bool:
    """Return True if a stored value is a timeseries object."""
    return isinstance(value, StoredVariable) and value.kind == "timeseries"


def timeseries_points(stored: StoredVariable) -> tuple[Numbers, Numbers]:
    """Return times in s and values, Float[points, elements], of a timeseries object.

    Raises:
        EvaluationError: if its times or values are in an unknown form.
    """
    times, data = _times(stored), stored.properties.get("Data_")
    if not isinstance(data, np.ndarray) or not data.size:
        raise EvaluationError("its timeseries has no numbers")
    values = np.asarray(data, dtype=np.float64)
    # the time is the first dimension of values that are rows, and the last one of matrices
    if not _flag(stored.properties.get("IsTimeFirst_")) and values.shape[-1] == times.size:
        values = np.moveaxis(values, -1, 0)
    if values.shape[0] != times.size:
        raise EvaluationError(f"its timeseries has {times.size} times for values of size {data.shape}")
    # elements of a matrix are numbered by columns
    return times, values.reshape(times.size, -1, order="F")


def _times(stored: StoredVariable) -> Numbers:
    """Return the times in s: as listed, or evenly spaced."""
    info = stored.properties.get("TimeInfo")
    fields = info.properties if isinstance(info, StoredVariable) else {}
    unit = fields.get("Units")
    scale = _SECONDS.get(unit if isinstance(unit, str) else "")
    if scale is None:
        raise EvaluationError(f"its timeseries has the unknown time unit {str(unit)[:20]!r}")
    listed = [fields.get("Time_"), stored.properties.get("Time_")]
    times = next((part for part in listed if isinstance(part, np.ndarray) and part.size), None)
    if times is not None:
        return np.asarray(times.ravel() * scale, dtype=np.float64)
    start, increment, length = (stored_number(fields.get(key)) for key in ("Start_", "Increment_", "Length"))
    # a length that a damaged file states could take all memory
    if increment is None or length is None or not 0 <= length <= _MAX_POINTS:
        raise EvaluationError("its timeseries has no times")
    return np.asarray(((start or 0.0) + increment * np.arange(int(length))) * scale, dtype=np.float64)


def _flag(value: Value) -> bool:
    return bool(stored_number(value))


def stored_number(value: Value) -> float | None:
    return float(value.item()) if isinstance(value, np.ndarray) and value.size == 1 else None


def dataset_signals(stored: Value) -> tuple[Recorded, ...]:
    """Return the signals of a Simulink.SimulationData.Dataset, in their order.

    Raises:
        EvaluationError: if it is no dataset of timeseries.
    """
    elements = _elements(stored)
    if not elements:
        raise EvaluationError("it is not a dataset of timeseries")
    return tuple(map(_recorded, elements))


def _elements(stored: Value) -> tuple[Value, ...]:
    """Return the elements of a dataset; each layer of its classes keeps its content below `any`."""
    if not isinstance(stored, StoredVariable) or not stored.kind.endswith(".Dataset"):
        return ()
    here: Value = stored
    for name in ("Storage", "Elements"):
        layer = _properties(here)
        inner = layer.get("any")
        here = (inner if isinstance(inner, Mapping) and name in inner else layer).get(name)
    return here if isinstance(here, tuple) else (here,) if here is not None else ()


def _properties(value: Value) -> Mapping[str, Value]:
    return value.properties if isinstance(value, StoredVariable) else value if isinstance(value, Mapping) else {}


def _recorded(element: Value) -> Recorded:
    if isinstance(element, StoredVariable) and is_timeseries(element):
        return timeseries_points(element)
    if isinstance(element, StoredVariable) and "Values" in element.properties:  # a Simulink.SimulationData.Signal
        return _recorded(element.properties["Values"])
    if isinstance(element, Mapping) and element:
        return {name: _recorded(part) for name, part in element.items()}
    kind = element.kind if isinstance(element, StoredVariable) else "another value"
    raise EvaluationError(f"its dataset contains {kind}, not a timeseries")
