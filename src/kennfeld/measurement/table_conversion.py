"""Conversion of a file's table to a dataset, or to the description that `kennfeld info` prints."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Channel, Dataset, concatenate
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import join_names, nearest
from kennfeld.measurement.cells import quote_cell
from kennfeld.measurement.resampling import even_grid, resample_all, samples_on
from kennfeld.measurement.table import Column, Selection, Table, text_findings, without_infinite
from kennfeld.measurement.time_column import (
    clock_of,
    find_time,
    merge_instants,
    split_pieces,
    time_findings,
    time_in_seconds,
    unit_remedy,
)

_MAX_VALUES = 500_000_000  # of a resampled dataset, 4 GB


def assemble(table: Table, name: str, selection: Selection, raster: float | None = None) -> Dataset:
    """Return the dataset in a table; raise `InputError` with all problems of the required columns."""
    time, channels = check_columns(table, selection, raster)
    if time is None:
        result = tuple(Channel(c.name, readonly_view(c.values), c.unit, c.description) for c in channels)
        return Dataset(name, result, remarks=table.remarks)
    stamps = time_in_seconds(time)
    parts = [_piece(name, stamps[k], channels, k, raster) for k in split_pieces(table, stamps)]
    whole = parts[0] if len(parts) == 1 else concatenate(name, parts)
    return replace(whole, clock=clock_of(time), remarks=table.remarks)


def _piece(name: str, time: Float, channels: Sequence[Column], piece: slice, raster: float | None) -> Dataset:
    stamps, values = merge_instants(time, [c.values[piece] for c in channels])
    if raster is not None:
        even = even_grid(stamps, raster)
        stamps, values = even, resample_all(stamps, values, even, [c.held for c in channels])
    result = (Channel(c.name, readonly_view(v), c.unit, c.description) for c, v in zip(channels, values, strict=True))
    return Dataset(name, tuple(result), readonly_view(stamps))


def readonly_view(values: Float) -> Float:
    """Return the values, made read-only in place, so that the domain types need no copy."""
    if values.flags.writeable:
        values.setflags(write=False)
    return values


def check_columns(
    table: Table, selection: Selection, raster: float | None = None
) -> tuple[Column | None, list[Column]]:
    """Return the time column, if any, and the channels; raise `InputError` with all problems."""
    time = find_time(table, selection.channels or ())
    channels = [c for c in table.columns if selection.includes(c.name) and _is_channel(c, time, selection)]
    findings = [*table.findings, *_missing(table, selection), *_twice(table, channels)]
    needed = channels if time is None or time in channels else [time, *channels]
    findings += text_findings(table, needed)
    if not channels and not findings and selection.channels is None:
        findings.append(Finding(table.place, "has no numeric column besides time", "Is it the right file?"))
    if time is not None:
        findings += _time_findings(table, time, raster, len(channels))
    elif raster is not None:
        findings.append(_no_time(table, raster))
    if findings:
        raise InputError(findings)
    return time, channels


def _is_channel(column: Column, time: Column | None, selection: Selection) -> bool:
    if column is time or column.dated:
        return selection.channels is not None
    return not column.is_text


def _missing(table: Table, selection: Selection) -> list[Finding]:
    """Report requested channels that do not exist or hold text."""
    findings = []
    by_name = {column.name: column for column in table.columns}
    names = [name for name in table.names if name]
    for name in selection.channels or ():
        if name not in names:
            remedy = nearest(name, names) or f"It has {join_names(names)}."
            findings.append(Finding(table.place, f"has no channel {name}", remedy))
        elif name in by_name and by_name[name].is_text:
            column = by_name[name]
            sample, cell = column.texts[0]
            remedy = "Choose another channel, or replace the text by numbers."
            findings.append(
                Finding(table.at(sample, column), f"the column holds text, such as {quote_cell(cell)}", remedy)
            )
    return findings


def _twice(table: Table, channels: Sequence[Column]) -> list[Finding]:
    groups: dict[str, list[Column]] = {}
    for column in channels:
        groups.setdefault(column.name, []).append(column)
    return [
        Finding(table.place, f"{len(group)} columns are named {name}", "Rename or remove all but one.")
        for name, group in groups.items()
        if len(group) > 1
    ]


def _time_findings(table: Table, column: Column, raster: float | None, channels: int) -> list[Finding]:
    time = time_in_seconds(column)
    findings = time_findings(table, column, time)
    if findings or raster is None or not time.size:
        return findings
    points = sum(samples_on(time[piece], raster) for piece in split_pieces(table, time))
    if points <= 1000.0 * time.size + 1e6 and points * max(channels, 1) <= _MAX_VALUES:
        return []
    widest = int(np.argmax(np.diff(time))) + 1
    message = f"raster={raster:g} s would create {points:.3g} samples of {time.size}; the longest gap ends here"
    remedy = "Choose a coarser raster, or correct the time stamp."
    if clock_of(column).in_milliseconds:
        message += "; the time stamps look like milliseconds"
        remedy = unit_remedy(column.name)
    return [Finding(table.at(widest, column), message, remedy)]


def _no_time(table: Table, raster: float) -> Finding:
    text = next((c for c in table.columns if c.is_text and c.texts and "time" in c.name.casefold()), None)
    message = f"raster={raster:g} s requires a time column, but there is none"
    if text is not None:
        message += f": {text.name} holds text, such as {quote_cell(text.texts[0][1])}"
    return Finding(table.place, message, "Name it time, in seconds, or omit the raster for steady-state points.")


@dataclass(frozen=True)
class ChannelDescription:
    """One channel; minimum and maximum are None if it has no value at all.

    `rate` is the reciprocal of the median time between two values, in Hz; None if there is no time.
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
    """One sheet, table or raster; `left_out` names columns without numbers, `ambiguous` names of several channels."""

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
    """Contents of a measurement file."""

    file: str
    kind: str
    tables: tuple[TableDescription, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the contents as plain dicts, lists, numbers and text, for JSON."""
        return asdict(self)


def describe_table(table: Table) -> TableDescription:
    """Return the description of one table."""
    table = without_infinite(table)
    time = find_time(table)
    channels = [c for c in table.columns if c is time or not (c.is_text or c.dated)]
    kept = {c.name for c in channels}
    stamps = None if time is None else time_in_seconds(time)
    details = dict(table.details)
    group = details.pop("group", "")
    if time is not None and (parts := len(split_pieces(table, time_in_seconds(time)))) > 1:
        details["pieces"] = f"{parts}, since its time restarts"
    return TableDescription(
        details.get("sheet", group),
        int(table.rows.size),
        tuple(_channel(c, stamps) for c in channels),
        None if time is None else _describe_time(time),
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
    """Return the sample rate in Hz."""
    steps = np.diff(stamps[np.isfinite(stamps)])
    step = float(np.median(steps)) if steps.size else 0.0
    return 1.0 / step if step > 0 else None


def _describe_time(column: Column) -> TimeDescription | None:
    """Return the time of a table; None if no sample has any."""
    time = time_in_seconds(column)
    time = time[np.isfinite(time)]
    if not time.size:
        return None
    step = float(np.median(np.diff(time))) if time.size > 1 else None
    return TimeDescription(column.name, float(time.min()), float(time.max()), step)
