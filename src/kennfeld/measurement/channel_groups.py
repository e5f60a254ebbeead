"""Recordings in several rasters: groups of channels, each with its own time stamps, are joined into one dataset.

INCA, MDA and LabVIEW write such groups side by side in one table: each time column belongs to the channels after it, up
to the next time column.
"""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Finding, Fix, InputError, Location
from kennfeld.base.formatting import join_names, nearest, one_line
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Channel, Clock, Dataset, common_start_time
from kennfeld.measurement.instants import instant_findings, separate_instants
from kennfeld.measurement.resampling import even_grid, resample_all
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.table_conversion import assemble, check_columns, readonly_view, to_channels
from kennfeld.measurement.time_column import SAME_INSTANT, clock_of, start_time_of, time_in_seconds
from kennfeld.measurement.unit_text import is_clock

RASTER = "raster"  # the key of a fix, of the dataset that has the file
_SHIFT = 1e-3  # of a recording, by which equal times may drift apart by rounding


@dataclass(frozen=True, eq=False)
class _ChannelGroup:
    """The channels of a table with their common time stamps."""

    table: Table
    columns: list[Column]
    stamps: Float  # Float[samples]
    values: list[Float]  # Float[samples] of each column
    clock: Clock
    start_time: datetime | None

    @property
    def step(self) -> float:
        return float(np.median(np.diff(self.stamps))) if self.stamps.size > 1 else np.inf


def join_groups(
    location: Location, tables: Sequence[Table], name: str, selection: Selection, raster: float | None = None
) -> Dataset:
    """Return the dataset of all groups, over the time that they share; nothing is extrapolated.

    Groups with equal time stamps are joined as they are. Others need a raster, in s; its points coincide with samples
    of the group with the smallest step. Raises `InputError` with all problems.
    """
    _check_names(location, tables, selection)
    if len(tables) == 1:
        return assemble(tables[0], name, selection, raster)
    groups = _read_groups(tables, selection, raster)
    stamps = groups[0].stamps if raster is None else _shared_raster(location, groups, raster)
    if raster is None and not all(
        stamps.size == group.stamps.size and np.all(np.abs(stamps - group.stamps) < SAME_INSTANT) for group in groups
    ):
        message = f"the channels have different rasters: {_describe_rasters(groups)}"
        steps = sorted({float(f"{group.step:.3g}") for group in groups if np.isfinite(group.step)}) or [0.1]
        remedy = f"Give a raster in s, such as raster = {steps[0]:.3g}."
        fixes = tuple(Fix.set((RASTER,), step) for step in dict.fromkeys((steps[0], steps[-1])))
        raise InputError([Finding(location, message, remedy, fixes=fixes)])
    channels: list[Channel] = []
    for group in groups:
        values = group.values
        if raster is not None:
            values = resample_all(group.stamps, values, stamps, [c.held for c in group.columns])
        channels += to_channels(group.columns, values)
    clock = next((group.clock for group in groups if group.clock.in_milliseconds), groups[0].clock)
    findings = tuple(dict.fromkeys(finding for group in groups for finding in group.table.findings))
    begin = common_start_time([group.start_time for group in groups])
    return Dataset(name, tuple(channels), readonly_view(stamps), clock=clock, findings=findings, start_time=begin)


def _check_names(location: Location, tables: Sequence[Table], selection: Selection) -> None:
    """Raise `InputError` for channels that no group has."""
    names = dict.fromkeys(name for table in tables for name in table.names if name)
    missing = [name for name in selection.channels or () if name not in names]
    if missing:
        raise InputError(
            Finding(location, f"has no channel {name}", nearest(name, names) or f"It has {join_names(names)}.")
            for name in missing
        )


def _read_groups(tables: Sequence[Table], selection: Selection, raster: float | None) -> list[_ChannelGroup]:
    errors: list[Finding] = []
    groups = []
    taken: set[str] = set()
    for table in tables:
        names = None if selection.channels is None else [n for n in selection.channels if n in table.names]
        # a name that several groups have means the first of them
        own = Selection(None if names is None else tuple(n for n in names if n not in taken))
        taken |= set(names or ())
        try:
            time, columns = check_columns(table, own, raster)
        except InputError as error:
            errors += error.findings
            continue
        if time is None:
            message = "has no time stamps, so its channels cannot be joined with those of other groups"
            errors.append(Finding(table.location, message, "Read them separately."))
        else:
            instants = separate_instants(time_in_seconds(time), [column.values for column in columns])
            said = replace(table, findings=(*table.findings, *instant_findings(table, time, [instants])))
            clock, begin = clock_of(time), start_time_of(table, time)
            groups.append(_ChannelGroup(said, columns, instants.time, instants.values, clock, begin))
    if errors:
        raise InputError(errors)
    return groups


def _describe_rasters(groups: Sequence[_ChannelGroup]) -> str:
    rasters = []
    for group in groups:
        if group.columns:
            step = f"every {group.step:.3g} s" if group.stamps.size > 1 else "once"
            rasters.append(f"{one_line(group.columns[0].name)} {step} from {group.stamps[0]:.6g} s")
    return join_names(rasters, 4)


def _shared_raster(location: Location, groups: Sequence[_ChannelGroup], raster: float) -> Float:
    """Return the even raster over the time that all groups cover."""
    begin = max(float(group.stamps[0]) for group in groups)
    end = min(float(group.stamps[-1]) for group in groups)
    if end < begin:
        ranges = [
            f"{group.columns[0].name} from {group.stamps[0]:.6g} s to {group.stamps[-1]:.6g} s"
            for group in groups
            if group.columns
        ]
        message = f"the time ranges of the channels do not overlap: {join_names(ranges, 4)}"
        raise InputError.of(location, message, "Omit one of them.")
    densest = min(groups, key=lambda group: group.step).stamps
    within = densest[(densest >= begin - SAME_INSTANT) & (densest <= end + SAME_INSTANT)]
    return even_grid(np.array([within[0] if within.size else begin, end]), raster)


def split_timelines(table: Table, selection: Selection) -> list[Table]:
    """Return a table for each time column with requested channels; the table itself if it has a single time."""
    columns = table.columns
    clocks = [k for k, column in enumerate(columns) if _is_stated_clock(table, column) or _may_be_clock(table, column)]
    # a table in groups begins with a time column
    if len(clocks) < 2 or clocks[0] != 0:
        return [table]
    # the same clock again, perhaps from another origin, does not begin a group of its own
    if not _differ([columns[k] for k in clocks], 0.0 if table.staggered else _SHIFT):
        copies = {k for k in clocks[1:] if table.staggered or columns[k].name == columns[0].name}
        copies -= {k for k in copies if selection.requests(columns[k].name)}
        return [replace(table, columns=tuple(c for k, c in enumerate(columns) if k not in copies))]
    ranges = pairwise([*clocks, len(columns)])
    # a time that is requested is a channel of its own group, too
    groups = [columns[k:end] for k, end in ranges if end > k + 1 or selection.requests(columns[k].name)]
    if not groups or _count_groups(table.names, {columns[k].name for k in clocks}) < 2:
        return [table]
    if selection.channels is None:
        groups = _join_texts(groups)
    asked = [
        (clock, *channels)
        for clock, *channels in groups
        if selection.requests(clock.name) or any(selection.includes(channel.name) for channel in channels)
    ]
    parts = [_part(table, group) for group in asked or groups[:1]]
    # a reader stops at errors, so they are needed once
    others = tuple(finding for finding in table.findings if finding.severity != "error")
    return [parts[0], *(replace(part, findings=others) for part in parts[1:])]


def _join_texts(groups: list[tuple[Column, ...]]) -> list[tuple[Column, ...]]:
    """Return the groups with channels of numbers; the first one also gets the texts of the others, to be listed."""
    numeric = [group for group in groups if not all(column.is_text for column in group[1:])]
    texts = [column for group in groups if all(c.is_text for c in group[1:]) for column in group[1:]]
    listed = (replace(column, texts=column.texts[:1]) for column in texts)
    return [(*numeric[0], *listed), *numeric[1:]] if numeric else groups


def _count_groups(names: Sequence[str], clocks: set[str]) -> int:
    """Return the number of time columns followed by channels, including channels that were not read."""
    return sum(name not in clocks and before in clocks for before, name in pairwise(name for name in names if name))


def _is_stated_clock(table: Table, column: Column) -> bool:
    return column.name in table.clock_names


def _may_be_clock(table: Table, column: Column) -> bool:
    if table.clock_names or not is_clock(column.name, column.unit) or column.text_count:
        return False
    known = column.values[~np.isnan(column.values)]
    still = known.size > 2 and known[0] == known[-1]  # a quantity in s or min that does not change
    return known.size > 0 and not still and bool(np.all(known[1:] >= known[:-1]))


def _differ(clocks: Sequence[Column], shift: float) -> bool:
    """Return whether the time columns differ by more than a constant shift; with `shift` 0, whether they differ."""
    first = time_in_seconds(clocks[0])
    known = ~np.isnan(first)
    tolerance = max(SAME_INSTANT, shift * np.ptp(first[known]))
    others = [time_in_seconds(clock) for clock in clocks[1:]]
    # gaps in different rows: the columns belong to different rasters
    if any(not np.array_equal(known, ~np.isnan(other)) for other in others):
        return True
    deviations = [(other - first)[known] for other in others]
    return any((np.ptp(d) if shift else np.abs(d).max(initial=0.0)) > tolerance for d in deviations)


def _part(table: Table, columns: Sequence[Column]) -> Table:
    """Return the rows in which the first column, a time, or one of its channels has a value."""
    rows: Bool = np.any([~np.isnan(column.values) for column in columns], axis=0)
    # a text is NaN among the values, but its row belongs to the group
    for column in columns:
        rows[[sample for sample, _ in column.texts]] = True
    return replace(
        table,
        columns=tuple(column.select(rows) for column in columns),
        rows=table.rows[rows],
        names=tuple(column.name for column in columns),
        details=(("group", columns[0].name), *table.details),
        clock_index=0,
    )
