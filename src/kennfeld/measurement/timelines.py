"""Tables with several columns of time: each belongs to the channels behind it, up to the next one.

INCA, MDA and LabVIEW write groups of different rasters like that, side by side in one table.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.measurement.columns import Column, Selection, Table
from kennfeld.measurement.timing import SAME, seconds
from kennfeld.measurement.units import is_clock

__all__ = ["timelines"]


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
    if not groups or _groups(table.names, {table.columns[k].name for k in clocks}) < 2:
        return [table]
    asked = [group for group in groups if any(selection.includes(channel.name) for channel in group[1])]
    parts = [_part(table, *group) for group in asked or groups[:1]]
    return [replace(part, findings=table.findings if k == 0 else ()) for k, part in enumerate(parts)]


def _groups(names: Sequence[str], clocks: set[str]) -> int:
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
