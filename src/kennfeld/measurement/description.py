"""What `kennfeld info` says of a measurement file."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import Finding
from kennfeld.measurement.columns import Column, Table
from kennfeld.measurement.infinite import without_infinite
from kennfeld.measurement.timing import find_time, pieces, seconds

__all__ = ["ChannelDescription", "Description", "TableDescription", "TimeDescription", "described"]


@dataclass(frozen=True)
class ChannelDescription:
    """One channel; minimum and maximum are None where it has no value at all.

    `rate` is how often it has a value, in Hz, by the median time between two of them; None where there is no time.
    """

    name: str
    unit: str
    samples: int
    nan_share: float
    minimum: float | None
    maximum: float | None
    description: str = ""
    rate: float | None = None


@dataclass(frozen=True)
class TimeDescription:
    """The time of a table in seconds; `step` is the median one, None for a single sample."""

    channel: str
    begin: float
    end: float
    step: float | None


@dataclass(frozen=True)
class TableDescription:
    """One sheet, table or raster; `left_out` names the columns that hold no numbers, `ambiguous` those of several."""

    name: str
    samples: int
    channels: tuple[ChannelDescription, ...]
    time: TimeDescription | None
    left_out: tuple[str, ...]
    details: dict[str, str]
    ambiguous: tuple[str, ...] = ()
    remarks: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Description:
    """What a measurement file holds."""

    file: str
    kind: str
    tables: tuple[TableDescription, ...]

    def as_dict(self) -> dict[str, Any]:
        """The same as plain dicts, lists, numbers and text, ready for JSON."""
        return asdict(self)


def described(table: Table) -> TableDescription:
    """The description of one table."""
    table = without_infinite(table)
    time = find_time(table)
    channels = [c for c in table.columns if c is time or not (c.is_text or c.dated)]
    kept = {c.name for c in channels}
    stamps = None if time is None else seconds(time)
    details = dict(table.details)
    group = details.pop("group", "")
    if time is not None and (parts := len(pieces(table, seconds(time)))) > 1:
        details["pieces"] = f"{parts}, for its time starts anew"
    return TableDescription(
        details.get("sheet", group),
        int(table.rows.size),
        tuple(_channel(c, stamps) for c in channels),
        None if time is None else _time(time),
        tuple(name for name in table.names if name and name not in kept),
        details,
        remarks=table.remarks,
    )


def _channel(column: Column, stamps: Float | None) -> ChannelDescription:
    known = column.values[np.isfinite(column.values)]
    share = float(np.isnan(column.values).mean()) if column.values.size else 0.0
    low, high = (float(known.min()), float(known.max())) if known.size else (None, None)
    rate = None if stamps is None else _rate(stamps[~np.isnan(column.values)] if share else stamps)
    size = int(column.values.size)
    return ChannelDescription(column.name, column.unit, size, share, low, high, column.description, rate)


def _rate(stamps: Float) -> float | None:
    """How often there is a sample, in Hz."""
    steps = np.diff(stamps[np.isfinite(stamps)])
    step = float(np.median(steps)) if steps.size else 0.0
    return 1.0 / step if step > 0 else None


def _time(column: Column) -> TimeDescription | None:
    """The time of a table; None where no sample has any."""
    time = seconds(column)
    time = time[np.isfinite(time)]
    if not time.size:
        return None
    step = float(np.median(np.diff(time))) if time.size > 1 else None
    return TimeDescription(column.name, float(time.min()), float(time.max()), step)
