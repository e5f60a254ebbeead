"""Conversion of a file's table to a dataset, or to the description that `kennfeld info` prints."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Channel, Dataset, concatenate
from kennfeld.measurement.cells import quote_cell
from kennfeld.measurement.instants import Instants, instant_findings, separate_instants
from kennfeld.measurement.resampling import even_grid, resample_all, samples_on
from kennfeld.measurement.table import Column, Selection, Table, text_findings, without_infinite
from kennfeld.measurement.time_column import (
    clock_of,
    find_time,
    split_pieces,
    start_time_of,
    time_findings,
    time_in_seconds,
    unit_remedy,
)

_MAX_VALUES = 500_000_000  # of a resampled dataset, 4 GB


def assemble(table: Table, name: str, selection: Selection, raster: float | None = None) -> Dataset:
    """Return the dataset in a table; raise `InputError` with all problems of the required columns."""
    time, columns = check_columns(table, selection, raster)
    if time is None:
        return Dataset(name, to_channels(columns, [c.values for c in columns]), findings=table.findings)
    stamps, clock, begin = time_in_seconds(time), clock_of(time), start_time_of(table, time)

    # pieces first: equal stamps in two of them are different instants
    parts = [
        separate_instants(stamps[piece], [c.values[piece] for c in columns]) for piece in split_pieces(table, stamps)
    ]
    findings = (*table.findings, *instant_findings(table, time, parts))

    def dataset_of(part: Instants) -> Dataset:
        stamps_here, values = part.time, part.values
        if raster is not None:
            even = even_grid(stamps_here, raster)
            stamps_here, values = even, resample_all(stamps_here, values, even, [c.held for c in columns])
        channels = to_channels(columns, values)
        return Dataset(name, channels, readonly_view(stamps_here), clock=clock, findings=findings, start_time=begin)

    return concatenate(name, list(map(dataset_of, parts)))


def to_channels(columns: Sequence[Column], values: Sequence[Float]) -> tuple[Channel, ...]:
    """Return the channels of columns with these values, Float[samples] each."""
    pairs = zip(columns, values, strict=True)
    return tuple(Channel(c.name, readonly_view(v), c.unit, c.description) for c, v in pairs)


def readonly_view(values: Float) -> Float:
    """Make values, Float[samples], read-only in place, so that the domain types need no copy; return them."""
    if values.flags.writeable:
        values.setflags(write=False)
    return values


def check_columns(
    table: Table, selection: Selection, raster: float | None = None
) -> tuple[Column | None, list[Column]]:
    """Return the time column, if any, and the channels; raise `InputError` with all problems."""
    time = find_time(table, selection.channels or ())
    channels = [c for c in table.columns if selection.includes(c.name) and _is_channel(c, time, selection)]
    errors = [*table.errors, *_missing(table, selection), *_duplicates(table, channels)]
    errors += text_findings(table, channels if time is None or time in channels else [time, *channels])
    if not channels and not errors and selection.channels is None:
        errors.append(Finding(table.location, "has no numeric column besides time", "Is it the right file?"))
    if time is not None:
        errors += _time_errors(table, time, raster, len(channels))
    elif raster is not None:
        errors.append(_no_time(table, raster))
    if errors:
        raise InputError(errors)
    return time, channels


def _is_channel(column: Column, time: Column | None, selection: Selection) -> bool:
    if column is time or column.dated:
        return selection.channels is not None
    return not column.is_text


def _missing(table: Table, selection: Selection) -> Iterator[Finding]:
    """Report requested channels that do not exist or hold text."""
    texts = {column.name: column for column in table.columns if column.is_text}
    names = [name for name in table.names if name]
    for name in selection.channels or ():
        if name not in names:
            remedy = nearest(name, names) or f"It has {join_names(names)}."
            yield Finding(table.location, f"has no channel {name}", remedy)
        elif name in texts:
            sample, cell = texts[name].texts[0]
            message = f"the column holds text, such as {quote_cell(cell)}"
            remedy = "Choose another channel, or replace the text by numbers."
            yield Finding(table.at(sample, texts[name]), message, remedy)


def _duplicates(table: Table, channels: Sequence[Column]) -> Iterator[Finding]:
    for name, count in Counter(column.name for column in channels).items():
        if count > 1:
            yield Finding(table.location, f"{count} columns are named {name}", "Rename or remove all but one.")


def _time_errors(table: Table, column: Column, raster: float | None, channels: int) -> list[Finding]:
    time = time_in_seconds(column)
    findings = time_findings(table, column, time)
    if findings or raster is None or not time.size:
        return findings
    points = sum(samples_on(time[piece], raster) for piece in split_pieces(table, time))
    # stamps in ms that are read as s make a raster a thousand times too fine
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
    return Finding(table.location, message, "Name it time, in seconds, or omit the raster for steady-state points.")


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
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Description:
    """Contents of a measurement file."""

    file: str
    kind: str
    tables: tuple[TableDescription, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the contents as plain dicts, lists, numbers and text, for JSON."""
        content = asdict(self)
        for table, plain in zip(self.tables, content["tables"], strict=True):
            del plain["findings"]
            plain["remarks"] = [asdict(f) | {"location": str(f.location)} for f in table.findings]
        return content


def describe_table(table: Table) -> TableDescription:
    """Return the description of one table."""
    table = without_infinite(table)
    time = find_time(table)
    columns = [c for c in table.columns if c is time or not (c.is_text or c.dated)]
    described = {c.name for c in columns}
    stamps = None if time is None else time_in_seconds(time)
    details = dict(table.details)
    group = details.pop("group", "")
    if stamps is not None and (parts := len(split_pieces(table, stamps))) > 1:
        details["pieces"] = f"{parts}, since its time restarts"
    return TableDescription(
        details.get("sheet", group),
        int(table.rows.size),
        tuple(_describe_channel(c, stamps) for c in columns),
        None if time is None else _describe_time(time),
        tuple(name for name in table.names if name and name not in described),
        details,
        findings=table.findings,
    )


def _describe_channel(column: Column, stamps: Float | None) -> ChannelDescription:
    values = column.values
    known = values[np.isfinite(values)]
    share = float(np.isnan(values).mean()) if values.size else 0.0
    low, high = (float(known.min()), float(known.max())) if known.size else (None, None)
    step = 0.0
    if stamps is not None:
        steps = np.diff(stamps[np.isfinite(stamps) & ~np.isnan(values)])
        step = float(np.median(steps)) if steps.size else 0.0
    rate = 1.0 / step if step > 0 else None
    return ChannelDescription(column.name, column.unit, int(values.size), share, low, high, column.description, rate)


def _describe_time(column: Column) -> TimeDescription | None:
    """Return the time of a table; None if no sample has any."""
    time = time_in_seconds(column)
    time = time[np.isfinite(time)]
    if not time.size:
        return None
    step = float(np.median(np.diff(time))) if time.size > 1 else None
    return TimeDescription(column.name, float(time.min()), float(time.max()), step)
