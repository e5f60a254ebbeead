"""Groups of channels with a common time, as files with a directory hold them: TDMS, HDF5, netCDF, DIAdem."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding, Findings, InputError, Location, Severity
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.channel_names import several_channels
from kennfeld.measurement.claimed_values import check_claimed
from kennfeld.measurement.epochs import with_epochs
from kennfeld.measurement.header import Header, unique_names
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.time_column import find_time, with_unread_time
from kennfeld.measurement.unit_text import in_seconds, time_unit

_TIME = "time"
_MAX_WARNINGS = 20
_MAX_NAMES = 5  # of channels in one message


@dataclass(frozen=True, eq=False)
class RecordedChannel:
    """A channel of a file.

    Attributes:
        name: its own name.
        path: its name with that of its group.
        unit: as the file states it.
        load: reads the values, Float[samples].
        description: as the file states it.
        dated: the values are dates, in s from an origin that all channels of the file share.
        content: what a channel holds that is no numbers, as messages say it: "a text".
        clock: the file says that it is the time of its group, whatever its name.
        rest: reads what the values lack of integers in the file, Float[samples] or None.
    """

    name: str
    path: str
    unit: str
    load: Callable[[], Float]
    description: str = ""
    dated: bool = False
    content: str = ""
    clock: bool = False
    rest: Callable[[], Float | None] | None = None


class ValuesFileError(ValueError):
    """A file of values beside a header is missing or too short: a problem of all channels in it."""


def file_beside(header: Path, name: str) -> Path:
    """Return the path of a file beside a header, whatever the folder and the case of its name when it was written."""
    own = header.with_name(PureWindowsPath(name).name)
    if own.is_file():
        return own
    return next((other for other in header.parent.iterdir() if other.name.casefold() == own.name.casefold()), own)


class UnreadableChannel(NamedTuple):
    """A channel whose values cannot be read: an error if it is requested or no other can be read, else a warning."""

    name: str
    problem: str
    remedy: str
    shared: bool = False  # the problem is that of a file of values, so channels with the same one are listed together


@dataclass(frozen=True, eq=False)
class RecordedGroup:
    """Channels of equal length.

    Attributes:
        path: name of the group; empty if the file has one only.
        samples: number of samples.
        channels: the channels.
        time: the time stamps in s, if the format itself defines them, Float[samples].
        start_time: the instant that `time` and dates count from.
    """

    path: str
    samples: int
    channels: Sequence[RecordedChannel]
    time: Callable[[], Float] | None = None
    start_time: datetime | None = None


def with_clock(channels: Sequence[RecordedChannel]) -> list[RecordedChannel]:
    """Return channels with one of them as their clock, if only its unit says that it is a time."""
    if any(channel.clock or time_unit(channel.name, channel.unit) is not None for channel in channels):
        return list(channels)
    timed = [channel for channel in channels if not channel.content and in_seconds(channel.unit) is not None]
    return [replace(channel, clock=timed == [channel]) for channel in channels]


def unnamed_matrices(shapes: Mapping[str, tuple[int, ...]]) -> list[UnreadableChannel]:
    """Return as what cannot be read the matrices under these paths."""
    remedy = "Store it as vectors, or name its columns in an attribute column_names."
    return [
        UnreadableChannel(path, f"is a matrix of {' x '.join(map(str, shape))} and is skipped", remedy)
        for path, shape in shapes.items()
    ]


def tables_of(
    source: MeasurementFile,
    groups: Sequence[RecordedGroup],
    selection: Selection,
    unreadable: Sequence[UnreadableChannel] = (),
    size: int | None = None,
) -> list[Table]:
    """Return a table for each group that has a requested channel; other channels are not read.

    A channel has its own name, or its path if another one has the same name; it may be requested by either.

    Args:
        source: the file.
        groups: its groups.
        selection: the requested channels.
        unreadable: channels that cannot be read.
        size: bytes of the file with those that belong to it; by default its own.

    Raises:
        InputError: the file is too small for the values that it claims, there is no channel, a requested name is that
            of several channels, or one cannot be read.
    """
    location = source.location
    errors = [each for each in unreadable if not groups or each.name in (selection.channels or ())]
    if errors:
        raise InputError(_findings(location, errors, "error"))
    if not groups:
        raise InputError.of(location, "holds no channels with samples", "Is it the right file?")
    names = _unique_names(groups)
    _check_values(source, groups, selection, size)
    chosen = _choose(location, names, selection)
    tables = [_table(location, group, names, chosen, selection) for group in groups]
    kept = [table for table in tables if selection.channels is None or _has_channel(table, selection.channels)]
    first, *others = _with_dates_aligned(
        [with_unread_time(with_epochs(table, selection)) for table in kept or tables[:1]], selection
    )
    return [
        replace(first, findings=(*first.findings, *(() if selection.channels else _warnings(location, unreadable)))),
        *others,
    ]


def _check_values(
    source: MeasurementFile, groups: Sequence[RecordedGroup], selection: Selection, size: int | None
) -> None:
    most = None if selection.channels is None else len(selection.channels) + 1  # a time as well
    check_claimed(source, sum(group.samples * len(group.channels[:most]) for group in groups), size)


def _warnings(location: Location, unreadable: Sequence[UnreadableChannel]) -> tuple[Finding, ...]:
    shared = [each for each in unreadable if each.shared]
    others = [each for each in unreadable if not each.shared]
    findings = _findings(location, [*shared, *others[:_MAX_WARNINGS]], "warning")
    if len(others) > _MAX_WARNINGS:
        message = f"{len(others) - _MAX_WARNINGS} more channels cannot be read"
        findings.append(Finding(location, message, "Request them to see why.", severity="warning"))
    return tuple(findings)


def _findings(location: Location, unreadable: Sequence[UnreadableChannel], severity: Severity) -> list[Finding]:
    """Return a finding for each channel, and only one for all channels that share the problem of a file."""
    names: dict[UnreadableChannel, list[str]] = {}
    for each in unreadable:
        names.setdefault(each._replace(name="") if each.shared else each, []).append(each.name)
    return [
        Finding(
            location.within(f"channel{'s' if len(sharing) > 1 else ''} {join_names(sharing, _MAX_NAMES)}"),
            *(each.problem, each.remedy),
            severity=severity,
        )
        for each, sharing in names.items()
    ]


def _with_dates_aligned(tables: Sequence[Table], selection: Selection) -> list[Table]:
    """Return the tables with dates that are their time counted from the earliest one, so that they can be joined.

    If the format defines the time of a group, the reader counts dates from the same origin.
    """
    clocks = [find_time(table, selection.channels or ()) for table in tables]
    dates = [clock.values for clock in clocks if clock is not None and clock.dated]
    known = [values[~np.isnan(values)] for values in dates]
    shared = any(table.clock is not None for table in tables)
    origin = 0.0 if shared else min((float(values[0]) for values in known if values.size), default=0.0)
    return [_with_clock(table, clock, origin) for table, clock in zip(tables, clocks, strict=True)]


def _with_clock(table: Table, clock: Column | None, origin: float) -> Table:
    if clock is None or not clock.dated:
        return table
    index = next(i for i, column in enumerate(table.columns) if column is clock)
    # a difference of two large numbers; nobody stamps finer than that
    own = replace(clock, values=np.round(clock.values - origin, 9), dated=False)
    columns = (*table.columns[:index], own, *table.columns[index + 1 :])
    begin = None if clock.origin is None else clock.origin + timedelta(seconds=origin)
    return replace(table, columns=columns, clock_index=index, start_time=begin)


def _has_channel(table: Table, asked: Sequence[str]) -> bool:
    return any(column.name in asked for column in table.columns)


def _unique_names(groups: Sequence[RecordedGroup]) -> dict[RecordedChannel, str]:
    channels = list(dict.fromkeys(channel for group in groups for channel in group.channels))  # groups may share a time
    count = Counter(channel.name for channel in channels)
    own = [channel.name if count[channel.name] == 1 else channel.path for channel in channels]
    return dict(zip(channels, unique_names(own), strict=True))


def _choose(location: Location, names: dict[RecordedChannel, str], selection: Selection) -> dict[RecordedChannel, str]:
    """Return the requested channels with the names by which they were requested."""
    if selection.channels is None:
        return names
    chosen: dict[RecordedChannel, str] = {}
    findings = Findings()
    for asked in selection.channels:
        matches = [c for c, name in names.items() if name == asked] or [c for c in names if asked in (c.path, c.name)]
        if len(matches) > 1:
            findings.add(several_channels(location, asked, [names[channel] for channel in matches]))
        elif matches:
            chosen[matches[0]] = asked
    findings.finish()
    return chosen


def _table(
    location: Location,
    group: RecordedGroup,
    names: dict[RecordedChannel, str],
    chosen: dict[RecordedChannel, str],
    selection: Selection,
) -> Table:
    labels = [chosen.get(channel, names[channel]) for channel in group.channels]
    header = Header(0, 0, tuple(labels), tuple(channel.unit for channel in group.channels))
    wanted = set(selection.wants(header)) | {i for i, channel in enumerate(group.channels) if channel in chosen}
    wanted |= {i for i, channel in enumerate(group.channels) if channel.clock}
    columns = [_column(group.channels[i], labels[i], group.samples, group.start_time) for i in sorted(wanted)]
    own = list(_own_time(group, labels))
    # a time that is requested by name is a channel
    stated = {labels[i] for i, channel in enumerate(group.channels) if channel.clock} - set(selection.channels or ())
    clock = next((i for i, column in enumerate(columns) if column.name in stated and _rises(column)), None)
    return Table(
        location.within(group.path) if group.path else location,
        (*own, *columns),
        np.arange(1, group.samples + 1),
        "sample",
        (*(column.name for column in own), *labels),
        details=(("group", group.path),) if group.path else (),
        clock_index=0 if own else clock,
        start_time=group.start_time if own else None,
    )


def _rises(column: Column) -> bool:
    return column.values.size > 1 and bool(np.all(np.diff(column.values) > 0))


def _own_time(group: RecordedGroup, labels: Sequence[str]) -> Iterator[Column]:
    """Yield the time that the format itself defines."""
    if group.time is not None:
        name = unique_names([*labels, _TIME])[-1]
        yield Column(name, "s", name, group.time())


def _column(channel: RecordedChannel, name: str, samples: int, start_time: datetime | None) -> Column:
    if channel.content:
        return Column.without_numbers(name, samples, channel.content)
    unit = "s" if channel.dated else channel.unit
    origin = start_time if channel.dated else None
    rest = None if channel.rest is None else channel.rest()
    values, description = channel.load(), channel.description
    return Column(name, unit, name, values, dated=channel.dated, origin=origin, description=description, rest=rest)
