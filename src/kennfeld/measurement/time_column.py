"""Records of a log that say no time: a logger writes some before its clock runs, or while it connects.

Finds the column that holds the time of the samples and turns it into seconds.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.dataset import Clock
from kennfeld.errors import Finding
from kennfeld.measurement.table import Column, Table, limit_findings
from kennfeld.measurement.unit_text import in_seconds, plain_unit, states_unit_of_time, time_unit

__all__ = [
    "SAME",
    "clock_of",
    "find_time",
    "merge",
    "pieces",
    "seconds",
    "time_findings",
    "unit_remedy",
    "without_untimed",
]

LONG = 5.0  # s; recordings of a function in time have shorter steps, and milliseconds have longer ones
SAME = 1e-9  # s; stamps closer than this belong to one instant (rasters of a logger that were merged)

_SHARE = 0.1  # of the records, beyond which their loss is a warning


def find_time(table: Table, asked: Collection[str] = ()) -> Column | None:
    """The time column: one that is called so, or a first column with a unit of time that rises.

    A column that never changes is no time, nor is one called just `t` that falls somewhere. `asked` names the channels
    that somebody wants: of these, `t` without a unit and columns of another name are channels, even if they rise.
    """
    if table.clock is not None:
        return table.clock
    for column in table.columns:
        named = time_unit(column.name, column.unit) is not None
        sure = column.name.casefold() != "t" or plain_unit(column.unit) not in ("", "-")
        guessed = column.name not in asked and _rises(column.values)
        if named and _is_usable(column) and (sure or guessed):
            return column
    first = next((name for name in table.names if name), None)
    for column in table.columns[:1]:
        clock = column.dated or (in_seconds(column.unit) is not None and column.name not in asked)
        if column.name == first and clock and _is_usable(column) and _rises(column.values):
            return column
    dates = (column for column in table.columns if column.dated and column.name not in asked)
    return next((column for column in dates if _is_usable(column) and _rises(column.values)), None)


def _is_usable(column: Column) -> bool:
    return not column.is_text and _varies(column.values)


def _varies(values: Float) -> bool:
    known = values[~np.isnan(values)]
    return known.size == 1 == values.size or bool(known.size and np.any(known != known[0]))


def _rises(values: Float) -> bool:
    return bool(np.all(values[1:] > values[:-1]))


def seconds(column: Column) -> Float:
    """The time stamps in seconds; dates count from the first one.

    >>> seconds(Column("t", "ms", "t", np.array([0.0, 10.0])))
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


def clock_of(column: Column) -> Clock:
    """Return what is known of a time column: whole numbers without a unit that are far apart look like milliseconds.

    >>> clock_of(Column("Time", "", "Time", np.array([0.0, 10.0, 20.0])))
    Clock(name='Time', in_milliseconds=True)
    """
    if column.dated or states_unit_of_time(column.name, column.unit):
        return Clock(column.name)
    known = column.values[np.isfinite(column.values)]
    steps = np.diff(known)
    far = steps.size > 0 and float(np.median(steps)) > LONG
    return Clock(column.name, far and _are_whole(known))


def _are_whole(values: Float) -> bool:
    """Whether all are whole numbers, but for the rounding of what was once 0.3 s and became 300.00000000000006 ms."""
    return bool(np.all(np.abs(values - np.round(values)) <= 1e-12 * np.abs(values)))


def unit_remedy(name: str) -> str:
    """Return how the unit of a time column is stated, for one that looks like milliseconds."""
    return (
        f'If they are, write [units] {name} = "ms", else "s"; in Python kennfeld.read(..., units={{"{name}": "ms"}}).'
    )


def time_findings(table: Table, column: Column, time: Float) -> list[Finding]:
    """What is wrong with the time stamps: gaps, steps backwards, a clock that stands still."""
    message = "rows with a wrong time stamp"
    gaps = np.flatnonzero(np.isnan(time))
    if gaps.size:
        remedy = "Remove the row or give it a time."
        return limit_findings(
            [Finding(table.at(k, column), "the time stamp is missing", remedy) for k in gaps[:200]],
            table.place,
            message,
            max(gaps.size - 200, 0),
        )
    latest = np.maximum.accumulate(time)
    back = np.flatnonzero(time[1:] < time[:-1] - SAME) + 1
    found = [_backwards(table, column, time, int(k)) for k in back[:200]]
    found = [] if table.restarts else found
    still = int(np.count_nonzero(time[1:] < (time if table.restarts else latest)[:-1] + SAME))
    if not found and 2 * still > time.size:
        remedy = "Write the time with more digits, or rename the column if it is no time."
        found = [Finding(f"{table.place}, column {column.place}", f"time stands still at {still} samples", remedy)]
    return limit_findings(found, table.place, message, 0 if table.restarts else max(back.size - 200, 0))


def _backwards(table: Table, column: Column, time: Float, k: int) -> Finding:
    message = f"time goes backwards, from {time[k - 1]:.12g} s to {time[k]:.12g} s"
    return Finding(table.at(k, column), message, "Split the file here, or rename the column if it is no time.")


def pieces(table: Table, time: Float) -> list[slice]:
    """The samples of each piece: one, unless time may fall in this table, and does.

    >>> table = Table("run.msl", (), np.arange(3), restarts=True)
    >>> pieces(table, np.array([0.0, 1.0, 0.5]))
    [slice(0, 2, None), slice(2, 3, None)]
    """
    falls = np.flatnonzero(time[1:] < time[:-1] - SAME) + 1 if table.restarts else np.empty(0, dtype=np.int64)
    ends = [0, *falls.tolist(), time.size]
    return [slice(begin, end) for begin, end in pairwise(ends)]


def merge(time: Float, columns: Sequence[Float]) -> tuple[Float, list[Float]]:
    """Samples of one instant made one: the first value of each column that is there.

    >>> nan = np.nan
    >>> merge(np.array([0.0, 1.0, 1.0 + 1e-12]), [np.array([5.0, nan, 6.0])])
    (array([0., 1.]), [array([5., 6.])])
    """
    fresh = np.concatenate([[True], time[1:] >= np.maximum.accumulate(time)[:-1] + SAME])
    if fresh.all():
        return time, list(columns)
    instant = np.cumsum(fresh) - 1
    merged = []
    for values in columns:
        valid = np.flatnonzero(~np.isnan(values))
        found, first = np.unique(instant[valid], return_index=True)
        one = np.full(int(instant[-1]) + 1, np.nan)
        one[found] = values[valid[first]]
        merged.append(one)
    return time[fresh], merged


def without_untimed(table: Table) -> Table:
    """Return the table without records that have no time stamp, and without a first one that belongs to another log.

    Such a first record is later than the second one: it is left from what was logged before. A remark counts them.
    """
    clock = find_time(table)
    if clock is None:
        return table
    time = seconds(clock)
    kept: Bool = ~np.isnan(time)
    known = np.flatnonzero(kept)
    if known.size > 1 and time[known[1]] < time[known[0]] - SAME:
        kept[known[0]] = False
    if kept.all():
        return table
    columns = {id(column): column.kept(kept) for column in table.columns}
    return replace(
        table,
        columns=tuple(columns.values()),
        rows=table.rows[kept],
        remarks=(*table.remarks, _remark(table, kept)),
        clock=None if table.clock is None else columns.get(id(table.clock), table.clock.kept(kept)),
    )


def _remark(table: Table, kept: Bool) -> Finding:
    lost = np.flatnonzero(~kept)
    word = table.row_word if lost.size == 1 else f"{table.row_word}s"
    message = f"{lost.size} {word} of {kept.size} left out, without a time stamp or later than the next one"
    severity = "warning" if lost.size > _SHARE * kept.size and lost.size > 1 else "remark"
    return Finding(table.at(int(lost[0])), message, severity=severity)  # type: ignore[arg-type]
