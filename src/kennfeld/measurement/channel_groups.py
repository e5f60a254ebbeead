"""Recordings in several rasters: groups of channels, each with its own time stamps, are joined into one dataset.

INCA, MDA and LabVIEW write such groups side by side in one table: each time column belongs to the channels after it, up
to the next time column.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.dataset import Channel, Clock, Dataset
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import join_names, nearest
from kennfeld.measurement.resampling import even_grid, resample_all
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.table_conversion import assemble, check_columns, readonly_view
from kennfeld.measurement.time_column import SAME_INSTANT, clock_of, merge_instants, time_in_seconds
from kennfeld.measurement.unit_text import is_clock

_Group = tuple[Table, Float, list[Column], list[Float], Clock]  # stamps, channels and their values, where time stands


def join_groups(
    place: str, tables: Sequence[Table], name: str, selection: Selection, raster: float | None = None
) -> Dataset:
    """Return the dataset of all groups, over the time that they share; nothing is extrapolated.

    Groups with equal time stamps are joined as they are. Others need a raster, in s; its points coincide with samples
    of the group with the smallest step. Raises `InputError` with all problems.
    """
    missing = _missing(place, tables, selection)
    if missing:
        raise InputError(missing)
    if len(tables) == 1:
        return assemble(tables[0], name, selection, raster)
    groups = _read_groups(tables, selection, raster)
    stamps = groups[0][1]
    if raster is None and not all(_equal(stamps, group[1]) for group in groups):
        raise InputError.of(place, f"the channels have different rasters: {_rasters(groups)}", _raster_remedy(groups))
    if raster is not None:
        stamps = _shared(place, groups, raster)
    channels: list[Channel] = []
    for _, time, columns, values, _ in groups:
        found = values if raster is None else resample_all(time, values, stamps, [c.held for c in columns])
        channels += [
            Channel(c.name, readonly_view(v), c.unit, c.description) for c, v in zip(columns, found, strict=True)
        ]
    doubtful = [group[4] for group in groups if group[4].in_milliseconds]
    clock = (doubtful or [groups[0][4]])[0]
    remarks = tuple(dict.fromkeys(remark for table, *_ in groups for remark in table.remarks))
    return Dataset(name, tuple(channels), readonly_view(stamps), clock=clock, remarks=remarks)


def _missing(place: str, tables: Sequence[Table], selection: Selection) -> list[Finding]:
    """Return the channels that no group has."""
    names = dict.fromkeys(name for table in tables for name in table.names if name)
    return [
        Finding(place, f"has no channel {name}", nearest(name, names) or f"It has {join_names(names)}.")
        for name in selection.channels or ()
        if name not in names
    ]


def _read_groups(tables: Sequence[Table], selection: Selection, raster: float | None) -> list[_Group]:
    findings: list[Finding] = []
    groups = []
    taken: set[str] = set()
    for table in tables:
        names = None if selection.channels is None else [n for n in selection.channels if n in table.names]
        own = Selection(None if names is None else tuple(n for n in names if n not in taken))
        taken |= set(names or ())
        try:
            time, columns = check_columns(table, own, raster)
        except InputError as error:
            findings += error.findings
            continue
        if time is None:
            message = "has no time stamps, so its channels cannot be joined with those of other groups"
            findings.append(Finding(table.place, message, "Read them separately."))
        else:
            groups.append((table, *_merged(time, columns), clock_of(time)))
    if findings:
        raise InputError(findings)
    return groups


def _merged(time: Column, columns: list[Column]) -> tuple[Float, list[Column], list[Float]]:
    stamps, values = merge_instants(time_in_seconds(time), [column.values for column in columns])
    return stamps, columns, values


def _equal(first: Float, other: Float) -> bool:
    return first.size == other.size and bool(np.all(np.abs(first - other) < SAME_INSTANT))


def _step(stamps: Float) -> float:
    return float(np.median(np.diff(stamps))) if stamps.size > 1 else np.inf


def _rasters(groups: Sequence[_Group]) -> str:
    rasters = [
        f"{columns[0].name} {f'every {_step(stamps):.3g} s' if stamps.size > 1 else 'once'} from {stamps[0]:.6g} s"
        for _, stamps, columns, *_ in groups
        if columns
    ]
    return join_names(rasters, 4)


def _raster_remedy(groups: Sequence[_Group]) -> str:
    finest = min(_step(group[1]) for group in groups)
    return f"Give a raster in s, such as raster = {finest if np.isfinite(finest) else 0.1:.3g}."


def _shared(place: str, groups: Sequence[_Group], raster: float) -> Float:
    """Return the even raster over the time that all groups cover."""
    begin = max(float(group[1][0]) for group in groups)
    end = min(float(group[1][-1]) for group in groups)
    if end < begin:
        ranges = [f"{c[0].name} from {s[0]:.6g} s to {s[-1]:.6g} s" for _, s, c, *_ in groups if c]
        message = f"the time ranges of the channels do not overlap: {join_names(ranges, 4)}"
        raise InputError.of(place, message, "Omit one of them.")
    densest = min((group[1] for group in groups), key=_step)
    within = densest[(densest >= begin - SAME_INSTANT) & (densest <= end + SAME_INSTANT)]
    return even_grid(np.array([within[0] if within.size else begin, end]), raster)


def split_timelines(table: Table, selection: Selection) -> list[Table]:
    """Return a table for each time column with requested channels; the table itself if it has a single time."""
    clocks = [k for k, column in enumerate(table.columns) if _may_be_clock(column, selection)]
    if len(clocks) < 2 or clocks[0] != 0:
        return [table]
    if not _differ([table.columns[k] for k in clocks]):
        return [_without_copies(table, clocks)]
    ends = [*clocks[1:], len(table.columns)]
    groups = [(table.columns[k], table.columns[k + 1 : end]) for k, end in zip(clocks, ends, strict=True)]
    groups = [group for group in groups if group[1]]
    if not groups or _count_groups(table.names, {table.columns[k].name for k in clocks}) < 2:
        return [table]
    asked = [group for group in groups if any(selection.includes(channel.name) for channel in group[1])]
    parts = [_part(table, *group) for group in asked or groups[:1]]
    return [replace(part, findings=table.findings if k == 0 else ()) for k, part in enumerate(parts)]


def _count_groups(names: Sequence[str], clocks: set[str]) -> int:
    """Return the number of time columns followed by channels, including channels that were not read."""
    return sum(name not in clocks and before in clocks for before, name in pairwise(name for name in names if name))


def _without_copies(table: Table, clocks: Sequence[int]) -> Table:
    """Return the table without repetitions of its time column."""
    first = table.columns[0].name
    copies = {k for k in clocks[1:] if table.columns[k].name == first}
    return replace(table, columns=tuple(c for k, c in enumerate(table.columns) if k not in copies))


def _may_be_clock(column: Column, selection: Selection) -> bool:
    if not is_clock(column.name, column.unit) or column.text_count or column.name in (selection.channels or ()):
        return False
    known = column.values[~np.isnan(column.values)]
    return known.size > 0 and bool(np.all(known[1:] >= known[:-1]))


def _differ(clocks: Sequence[Column]) -> bool:
    """Return whether the time columns differ by more than a constant shift."""
    first = time_in_seconds(clocks[0])
    return any(not _same(first, time_in_seconds(clock)) for clock in clocks[1:])


def _same(first: Float, other: Float) -> bool:
    if not np.array_equal(np.isnan(first), np.isnan(other)):
        return False
    shift = (other - first)[~np.isnan(first)]
    return bool(np.ptp(shift) <= max(SAME_INSTANT, 1e-3 * np.ptp(first[~np.isnan(first)])))


def _part(table: Table, clock: Column, channels: Sequence[Column]) -> Table:
    """Return the rows in which this time, or one of its channels, has a value."""
    rows: Bool = ~np.isnan(clock.values)
    for column in channels:
        rows |= ~np.isnan(column.values)
        rows[[sample for sample, _ in column.texts]] = True
    own = tuple(column.kept(rows) for column in (clock, *channels))
    return replace(
        table,
        columns=own,
        rows=table.rows[rows],
        names=tuple(column.name for column in own),
        details=(("group", clock.name), *table.details),
        clock=own[0],
    )
