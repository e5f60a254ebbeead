"""Samples with one time stamp: rasters of a logger that were merged, and stamps with too few digits.

If two rows of one stamp differ in a value, its digits do not tell them apart: both are kept, spread evenly up to the
next stamp. Other rows of one instant complete each other and are merged.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Finding, Severity
from kennfeld.base.formatting import count_noun
from kennfeld.measurement.table import Column, Table
from kennfeld.measurement.time_column import SAME_INSTANT, advances


class Instants(NamedTuple):
    """Samples with a time stamp of their own each, and how many of the rows were spread, left out, and differed."""

    time: Float  # Float[samples]
    values: list[Float]  # Float[samples] of each column
    spread: int = 0
    lost: int = 0
    differing: int = 0


def separate_instants(time: Float, columns: Sequence[Float]) -> Instants:
    """Return the samples of rows with rising time, Float[rows]: each has another time stamp.

    Of rows that are merged, the first value of each column that is present counts.

    >>> nan = np.nan
    >>> separate_instants(np.array([0.0, 1.0, 1.0 + 1e-12]), [np.array([5.0, nan, 6.0])])[:2]
    (array([0., 1.]), [array([5., 6.])])
    >>> separate_instants(np.array([0.0, 0.0, 1.0]), [np.array([5.0, 6.0, 7.0])])[:3]
    (array([0. , 0.5, 1. ]), [array([5., 6., 7.])], 1)
    """
    if advances(time):
        return Instants(time, list(columns))
    both, differs = _compare_rows(columns, time.size)
    spread = 0
    # only equal digits are spread; stamps apart by rounding are one instant
    equal = np.append(False, time[1:] == time[:-1])
    if np.any(differs & equal):
        time, spread = _spread(time, equal, both)
        if advances(time):
            return Instants(time, list(columns), spread)
    # later than all rows before, not than the last one alone
    fresh = np.append(True, time[1:] >= np.maximum.accumulate(time)[:-1] + SAME_INSTANT)
    lost = both & ~fresh
    return Instants(
        time[fresh],
        _merge(fresh, columns),
        spread,
        int(np.count_nonzero(lost)),
        int(np.count_nonzero(lost & differs)),
    )


def _compare_rows(columns: Sequence[Float], rows: int) -> tuple[Bool, Bool]:
    """Return which rows have a value in a column of which the row before has one, too, and which have another one."""
    both, differs = np.zeros(rows, dtype=bool), np.zeros(rows, dtype=bool)
    for values in columns:
        pair = ~np.isnan(values[1:]) & ~np.isnan(values[:-1])
        both[1:] |= pair
        differs[1:] |= pair & (values[1:] != values[:-1])
    return both, differs


def _spread(time: Float, equal: Bool, both: Bool) -> tuple[Float, int]:
    """Return time stamps with equal ones spread evenly over the shortest step, and how many were moved.

    Only rows that do not complete each other are spread.
    """
    # runs of equal stamps: their first rows, their sizes, and whether their rows differ
    starts = np.flatnonzero(~equal)
    sizes = np.diff(np.append(starts, time.size))
    apart = np.logical_or.reduceat(both & equal, starts)
    steps = np.diff(time[starts])
    rising = steps[steps >= SAME_INSTANT]
    if not rising.size:
        return time, 0
    # the step after a run may be a pause, and the last run has none
    step = np.minimum(np.append(steps, np.inf), rising.min())
    position = np.arange(time.size) - np.repeat(starts, sizes)
    moved = np.repeat(apart, sizes) & (position > 0)
    # row k of a run of n rows moves by k / n of the step
    spread = time + np.where(moved, position * np.repeat(np.maximum(step, 0.0) / sizes, sizes), 0.0)
    return spread, int(np.count_nonzero(moved))


def _merge(fresh: Bool, columns: Sequence[Float]) -> list[Float]:
    """Return the first value that is present of each instant; it begins at a fresh row."""
    # Int[rows], the instant of each row
    instant = np.cumsum(fresh) - 1
    merged = []
    for values in columns:
        valid = np.flatnonzero(~np.isnan(values))
        known, first = np.unique(instant[valid], return_index=True)
        column = np.full(int(instant[-1]) + 1, np.nan)
        column[known] = values[valid[first]]
        merged.append(column)
    return merged


def instant_findings(table: Table, clock: Column, parts: Sequence[Instants]) -> Iterator[Finding]:
    """Yield what was done with rows that share a time stamp."""
    location = table.location.within(f"column {clock.place}")
    rows = int(table.rows.size)
    if spread := sum(part.spread for part in parts):
        message = (
            f"{count_noun(spread, 'sample')} of {rows} repeat the time stamp before and were spread evenly after it"
        )
        yield Finding(location, message, "Export the time with more digits.", severity="remark")
    if lost := sum(part.lost for part in parts):
        differing = sum(part.differing for part in parts)
        severity: Severity = "warning" if differing else "remark"
        other = f", {differing} of them with other values" if differing else " with the same values"
        message = f"{count_noun(lost, 'sample')} of {rows} repeat the time stamp before{other}, and were left out"
        yield Finding(location, message, severity=severity)
