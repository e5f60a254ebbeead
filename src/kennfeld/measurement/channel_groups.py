"""Joins the rasters of one recording: groups of channels, each with time stamps of its own.

Tables with several columns of time: each belongs to the channels behind it, up to the next one.

INCA, MDA and LabVIEW write groups of different rasters like that, side by side in one table.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.dataset import Channel, Clock, Dataset
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.measurement.resampling import grid, resample_all
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.table_conversion import assemble, check_columns, readonly_view
from kennfeld.measurement.time_column import SAME, clock_of, merge, seconds
from kennfeld.measurement.unit_text import is_clock

__all__ = ["join", "timelines"]

_Group = tuple[Table, Float, list[Column], list[Float], Clock]  # stamps, channels and their values, where time stands


def join(place: str, tables: Sequence[Table], name: str, selection: Selection, raster: float | None = None) -> Dataset:
    """The dataset of all groups, over the time that they share; nothing is extrapolated.

    Groups with equal time stamps are put side by side. Others need a raster, in s; its points fall on samples of the
    group that is sampled most often. `InputError` with all that is wrong.
    """
    missing = _missing(place, tables, selection)
    if missing:
        raise InputError(missing)
    if len(tables) == 1:
        return assemble(tables[0], name, selection, raster)
    groups = _read_groups(tables, selection, raster)
    stamps = groups[0][1]
    if raster is None and not all(_equal(stamps, group[1]) for group in groups):
        raise InputError.of(place, f"the channels have different rasters: {_rasters(groups)}", _raster_mend(groups))
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
    """The channels that no group has."""
    names = dict.fromkeys(name for table in tables for name in table.names if name)
    listed = ", ".join(list(names)[:8]) + (", ..." if len(names) > 8 else "")
    return [
        Finding(place, f"has no channel {asked}", nearest(asked, names) or f"It has {listed}.")
        for asked in selection.channels or ()
        if asked not in names
    ]


def _read_groups(tables: Sequence[Table], selection: Selection, raster: float | None) -> list[_Group]:
    found: list[Finding] = []
    groups = []
    taken: set[str] = set()
    for table in tables:
        names = None if selection.channels is None else [n for n in selection.channels if n in table.names]
        own = Selection(None if names is None else tuple(n for n in names if n not in taken))
        taken |= set(names or ())
        try:
            time, columns = check_columns(table, own, raster)
        except InputError as error:
            found += error.findings
            continue
        if time is None:
            message = "has no time stamps, so that its channels do not join those of other groups"
            found.append(Finding(table.place, message, "Read them by themselves."))
        else:
            groups.append((table, *_merged(time, columns), clock_of(time)))
    if found:
        raise InputError(found)
    return groups


def _merged(time: Column, columns: list[Column]) -> tuple[Float, list[Column], list[Float]]:
    stamps, values = merge(seconds(time), [column.values for column in columns])
    return stamps, columns, values


def _equal(first: Float, other: Float) -> bool:
    return first.size == other.size and bool(np.all(np.abs(first - other) < SAME))


def _step(stamps: Float) -> float:
    return float(np.median(np.diff(stamps))) if stamps.size > 1 else np.inf


def _rasters(groups: Sequence[_Group]) -> str:
    said = [
        f"{columns[0].name} {f'every {_step(stamps):.3g} s' if stamps.size > 1 else 'once'} from {stamps[0]:.6g} s"
        for _, stamps, columns, *_ in groups
        if columns
    ]
    return ", ".join(said[:4]) + (f" and {len(said) - 4} more" if len(said) > 4 else "")


def _raster_mend(groups: Sequence[_Group]) -> str:
    finest = min(_step(group[1]) for group in groups)
    return f"Give a raster in s, such as raster = {finest if np.isfinite(finest) else 0.1:.3g}."


def _shared(place: str, groups: Sequence[_Group], raster: float) -> Float:
    """The even raster over the time that all groups cover."""
    begin = max(float(group[1][0]) for group in groups)
    end = min(float(group[1][-1]) for group in groups)
    if end < begin:
        ranges = [f"{c[0].name} from {s[0]:.6g} s to {s[-1]:.6g} s" for _, s, c, *_ in groups if c]
        listed = ", ".join(ranges[:4]) + (f" and {len(ranges) - 4} more" if len(ranges) > 4 else "")
        raise InputError.of(place, f"the channels share no time: {listed}", "Leave one of them out.")
    densest = min((group[1] for group in groups), key=_step)
    within = densest[(densest >= begin - SAME) & (densest <= end + SAME)]
    return grid(np.array([within[0] if within.size else begin, end]), raster)


def timelines(table: Table, selection: Selection) -> list[Table]:
    """A table for each column of time that has channels asked for; the table itself where there is but one time."""
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
    """How many of the times have channels behind them, those included that were not read."""
    return sum(name not in clocks and before in clocks for before, name in pairwise(name for name in names if name))


def _without_copies(table: Table, clocks: Sequence[int]) -> Table:
    """The table with one of the columns of time that are called the same and tell the same."""
    first = table.columns[0].name
    copies = {k for k in clocks[1:] if table.columns[k].name == first}
    return replace(table, columns=tuple(c for k, c in enumerate(table.columns) if k not in copies))


def _may_be_clock(column: Column, selection: Selection) -> bool:
    if not is_clock(column.name, column.unit) or column.text_count or column.name in (selection.channels or ()):
        return False
    known = column.values[~np.isnan(column.values)]
    return known.size > 0 and bool(np.all(known[1:] >= known[:-1]))


def _differ(clocks: Sequence[Column]) -> bool:
    """Whether the times are more than one time told in several ways."""
    first = seconds(clocks[0])
    return any(not _same(first, seconds(clock)) for clock in clocks[1:])


def _same(first: Float, other: Float) -> bool:
    if not np.array_equal(np.isnan(first), np.isnan(other)):
        return False
    shift = (other - first)[~np.isnan(first)]
    return bool(np.ptp(shift) <= max(SAME, 1e-3 * np.ptp(first[~np.isnan(first)])))


def _part(table: Table, clock: Column, channels: Sequence[Column]) -> Table:
    """The rows in which this time, or one of its channels, has a value."""
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
