"""Detection of the time column of a table, its conversion to seconds, and checks of time stamps.

Logs may contain records without a time: a logger writes some before its clock runs, or while it connects.
"""

from collections.abc import Collection
from dataclasses import replace
from datetime import datetime, timedelta
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Finding, Location, Severity
from kennfeld.base.formatting import count_noun, quoted, toml_text
from kennfeld.domain.dataset import Clock
from kennfeld.measurement.cells import quote_cell
from kennfeld.measurement.table import Column, Table, limit_findings
from kennfeld.measurement.unit_text import (
    in_seconds,
    is_called_time,
    plain_unit,
    says_time,
    states_unit_of_time,
    time_unit,
)

LONG_STEP = 5.0  # s; recordings of a function in time have shorter steps, and milliseconds have longer ones
SAME_INSTANT = 1e-9  # s; stamps closer than this belong to one instant (rasters of a logger that were merged)

_LEAST_STAMPS = 3  # different ones of a clock that repeats most of them
_SHARE = 0.1  # of the records, beyond which their loss is a warning


def find_time(table: Table, asked: Collection[str] = ()) -> Column | None:
    """Return the time column: one with a name of time, or an increasing first column with a unit of time.

    A constant column is not time, nor is one called just `t` that decreases. `asked` names the requested channels: of
    these, `t` without a unit and columns of another name are channels, even if they increase.
    """
    if table.clock is not None:
        return table.clock
    for column in table.columns:
        named = time_unit(column.name, column.unit) is not None
        guessed = column.name not in asked and _rises(column.values)
        if named and _is_usable(column) and (guessed or is_named_time(column.name, column.unit)):
            return column
    first = next((name for name in table.names if name), None)
    for column in table.columns[:1]:
        clock = column.dated or (in_seconds(column.unit) is not None and column.name not in asked)
        if column.name == first and clock and _is_usable(column) and _rises(column.values):
            return column
    dates = [c for c in table.columns if c.dated and c.name not in asked and _is_usable(c)]
    # stamps of whole seconds repeat, so they are the time only if no column has finer ones
    rising = next((c for c in dates if _rises(c.values)), None)
    return rising or next((c for c in dates if _does_not_fall(c)), None)


def is_named_time(name: str, unit: str) -> bool:
    """Return whether a column is time by its name, even if a function reads it; just `t` may be any quantity.

    >>> is_named_time("time", ""), is_named_time("t", "s"), is_named_time("t", ""), is_named_time("delay", "s")
    (True, True, False, False)
    """
    return time_unit(name, unit) is not None and (name.casefold() != "t" or plain_unit(unit) not in ("", "-"))


def _is_usable(column: Column) -> bool:
    low, high = column.extent
    varies = low < high or (column.values.size == 1 and low == high)
    return varies and not column.is_text


def _rises(values: Float) -> bool:
    return bool(np.all(values[1:] > values[:-1]))


def _does_not_fall(column: Column) -> bool:
    """Return whether stamps that repeat are a time: most of them differ, or the name says so. Others are dates."""
    steps = np.diff(column.values)
    mostly = 2 * int(np.count_nonzero(steps)) >= steps.size
    return bool(np.all(steps >= 0)) and (mostly or says_time(column.name))


def time_in_seconds(column: Column) -> Float:
    """Convert the time stamps to seconds, Float[samples]; dates count from the first one.

    >>> time_in_seconds(Column("t", "ms", "t", np.array([0.0, 10.0])))
    array([0.  , 0.01])
    """
    factor, divisor = in_seconds(time_unit(column.name, column.unit) or column.unit) or (1.0, 1.0)
    with np.errstate(invalid="ignore"):  # files hold NaNs that complain of being touched
        if column.dated:
            # a difference of two large numbers; nobody stamps finer than that
            known = column.values[~np.isnan(column.values)]
            return np.asarray(np.round(column.values - (known[0] if known.size else 0.0), 9))
        elapsed: Float = column.values * factor / divisor
    return elapsed


def start_time_of(table: Table, column: Column) -> datetime | None:
    """Return the instant of time 0 of `time_in_seconds`: as the table states it, or the first date of the column."""
    if not column.dated or column.origin is None:
        return table.start_time
    known = column.values[~np.isnan(column.values)]
    return column.origin + timedelta(seconds=float(known[0])) if known.size else None


def clock_of(column: Column) -> Clock:
    """Return the clock of a time column: whole numbers without a unit that are far apart look like milliseconds.

    >>> clock_of(Column("Time", "", "Time", np.array([0.0, 10.0, 20.0])))
    Clock(name='Time', in_milliseconds=True)
    """
    if column.dated or states_unit_of_time(column.name, column.unit):
        return Clock(column.name)
    known = column.values[np.isfinite(column.values)]
    steps = np.diff(known)
    far = steps.size > 0 and float(np.median(steps)) > LONG_STEP
    # up to rounding: 0.3 s may become 300.00000000000006 ms
    return Clock(column.name, far and bool(np.all(np.abs(known - np.round(known)) <= 1e-12 * np.abs(known))))


def unit_remedy(name: str) -> str:
    """Return the remedy for a time column that looks like milliseconds: state its unit."""
    python = f'kennfeld.read(..., units={{{toml_text(name)}: "ms"}})'
    return f'If they are, write [units] {quoted(name)} = "ms", else "s"; in Python {python}.'


def time_findings(table: Table, column: Column, time: Float) -> list[Finding]:
    """Report missing stamps among `time`, Float[samples] in s, steps backwards, and a clock that does not advance."""
    message = "rows with a wrong time stamp"
    gaps = np.flatnonzero(np.isnan(time)).tolist()
    if gaps:
        remedy = "Remove the row or add its time."
        return limit_findings(
            gaps, lambda k: Finding(table.at(k, column), "the time stamp is missing", remedy), table.location, message
        )
    if advances(time):
        return []
    # where a log may restart, only neighbours are compared
    earlier = time if table.restarts else np.maximum.accumulate(time)
    back = [] if table.restarts else _falls(time)
    still = int(np.count_nonzero(time[1:] < earlier[:-1] + SAME_INSTANT))
    if not back and 2 * still > time.size and np.unique(time).size < _LEAST_STAMPS:
        remedy = "Write the time with more digits, or rename the column if it is not a time."
        location = Location(f"{table.location}, column {column.place}")
        return [Finding(location, f"time does not increase at {still} samples", remedy)]

    def report(k: int) -> Finding:
        backwards = f"time goes backwards, from {time[k - 1]:.12g} s to {time[k]:.12g} s"
        remedy = "Split the file here, or rename the column if it is not a time."
        return Finding(table.at(k, column), backwards, remedy)

    return limit_findings(back, report, table.location, message)


def advances(time: Float) -> bool:
    """Return True if each stamp, Float[samples] in s, is later than the one before."""
    return bool(np.all(time[1:] >= time[:-1] + SAME_INSTANT))


def _falls(time: Float) -> list[int]:
    """Return the samples that are earlier than the one before."""
    falls: list[int] = (np.flatnonzero(time[1:] < time[:-1] - SAME_INSTANT) + 1).tolist()
    return falls


def split_pieces(table: Table, time: Float) -> list[slice]:
    """Split stamps, Float[samples] in s, into pieces: a new one begins if time falls in a table that allows it.

    >>> table = Table(Location("run.msl"), (), np.arange(3), restarts=True)
    >>> split_pieces(table, np.array([0.0, 1.0, 0.5]))
    [slice(0, 2, None), slice(2, 3, None)]
    """
    ends = [0, *(_falls(time) if table.restarts else ()), time.size]
    return [slice(begin, end) for begin, end in pairwise(ends)]


def with_unread_time(table: Table) -> Table:
    """Return the table with a warning if it has no time, but a column with the name of one."""
    if find_time(table) is not None:
        return table
    finding = next((found for column in table.columns if (found := _unread(table, column)) is not None), None)
    return table if finding is None else replace(table, findings=(*table.findings, finding))


def _unread(table: Table, column: Column) -> Finding | None:
    """Return why a column with the name of time is not the time; None if it has another name."""
    steady = "so the samples are steady-state points"
    if column.is_text:
        if not column.texts or not _names_time(column):
            return None
        sample, cell = column.texts[0]
        message = f"{quote_cell(cell)} cannot be read as a time, {steady}"
        remedy = "Write the time in seconds, or as 2026-12-31 23:59:59.9 or 23:59:59.9."
        return Finding(table.at(sample, column), message, remedy, severity="warning")
    if not is_called_time(column.name) or column.values.size < 2:
        return None
    unit, location = plain_unit(column.unit), table.location.within(f"column {column.place}")
    if time_unit(column.name, column.unit) is None and _does_not_fall(column):
        stated = f"{unit!r} is not a unit of time" if unit else "its unit cannot be read from its name"
        # a name such as `Time (ticks)` is not that of a time, whatever unit is stated
        known = time_unit(column.name, "s") is not None
        unit_known = f'State its unit if it is the time: [units] {quoted(column.name)} = "ms" or another one.'
        remedy = unit_known if known else "If it is the time, rename it: time [s]."
        return Finding(location, f"{stated}, {steady}", remedy, severity="warning")
    if not _is_usable(column):
        remedy = "Rename the column if it is not a time."
        return Finding(location, f"the time does not advance, {steady}", remedy, severity="warning")
    return None


def with_date_doubts(table: Table) -> Table:
    """Return the table with a warning for each column whose dates read either way.

    In the time column, the day of the recording counts, too.
    """
    if not any(column.doubt or column.origin_doubt for column in table.columns):
        return table
    clock = find_time(table)
    remedy = "Export the file with ISO dates, 2026-12-31, if that is wrong."
    findings = [
        Finding(table.location.within(f"column {column.place}"), doubt, remedy, severity="warning")
        for column in table.columns
        if (doubt := column.doubt or (column.origin_doubt if column is clock else ""))
    ]
    return replace(table, findings=(*table.findings, *findings))


def _names_time(column: Column) -> bool:
    return time_unit(column.name, column.unit) is not None or says_time(column.name)


def drop_untimed(table: Table) -> Table:
    """Return the table without records that have no time stamp, and without a first one that belongs to another log.

    Such a first record is later than the second one: it is left over from the previous log. A remark counts them.
    """
    clock = find_time(table)
    if clock is None:
        return table
    time = time_in_seconds(clock)
    timed: Bool = ~np.isnan(time)
    known = np.flatnonzero(timed)
    if known.size > 1 and time[known[1]] < time[known[0]] - SAME_INSTANT:
        timed[known[0]] = False
    if timed.all():
        return table
    lost = np.flatnonzero(~timed)
    records = count_noun(lost.size, table.row_word)
    message = f"{records} of {timed.size} skipped: without a time stamp or later than the next one"
    severity: Severity = "warning" if lost.size > _SHARE * timed.size and lost.size > 1 else "remark"
    finding = Finding(table.at(int(lost[0])), message, severity=severity)
    columns = tuple(column.select(timed) for column in table.columns)
    return replace(table, columns=columns, rows=table.rows[timed], findings=(*table.findings, finding))
