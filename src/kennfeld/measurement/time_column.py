"""Detection of the time column of a table, its conversion to seconds, and checks of time stamps.

Logs may contain records without a time: a logger writes some before its clock runs, or while it connects.
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

LONG_STEP = 5.0  # s; recordings of a function in time have shorter steps, and milliseconds have longer ones
SAME_INSTANT = 1e-9  # s; stamps closer than this belong to one instant (rasters of a logger that were merged)

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


def time_in_seconds(column: Column) -> Float:
    """Return the time stamps in seconds; dates count from the first one.

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
    return Clock(column.name, far and _are_whole(known))


def _are_whole(values: Float) -> bool:
    """Return whether all are whole numbers up to rounding: 0.3 s may become 300.00000000000006 ms."""
    return bool(np.all(np.abs(values - np.round(values)) <= 1e-12 * np.abs(values)))


def unit_remedy(name: str) -> str:
    """Return the remedy for a time column that looks like milliseconds: state its unit."""
    return (
        f'If they are, write [units] {name} = "ms", else "s"; in Python kennfeld.read(..., units={{"{name}": "ms"}}).'
    )


def time_findings(table: Table, column: Column, time: Float) -> list[Finding]:
    """Report missing time stamps, steps backwards, and a clock that does not advance."""
    message = "rows with a wrong time stamp"
    gaps = np.flatnonzero(np.isnan(time))
    if gaps.size:
        remedy = "Remove the row or add its time."
        return limit_findings(
            [Finding(table.at(k, column), "the time stamp is missing", remedy) for k in gaps[:200]],
            table.place,
            message,
            max(gaps.size - 200, 0),
        )
    latest = np.maximum.accumulate(time)
    back = np.flatnonzero(time[1:] < time[:-1] - SAME_INSTANT) + 1
    findings = [_backwards(table, column, time, int(k)) for k in back[:200]]
    findings = [] if table.restarts else findings
    still = int(np.count_nonzero(time[1:] < (time if table.restarts else latest)[:-1] + SAME_INSTANT))
    if not findings and 2 * still > time.size:
        remedy = "Write the time with more digits, or rename the column if it is not a time."
        findings = [
            Finding(f"{table.place}, column {column.place}", f"time does not increase at {still} samples", remedy)
        ]
    return limit_findings(findings, table.place, message, 0 if table.restarts else max(back.size - 200, 0))


def _backwards(table: Table, column: Column, time: Float, k: int) -> Finding:
    message = f"time goes backwards, from {time[k - 1]:.12g} s to {time[k]:.12g} s"
    return Finding(table.at(k, column), message, "Split the file here, or rename the column if it is not a time.")


def split_pieces(table: Table, time: Float) -> list[slice]:
    """Return the samples of each piece: a new one begins if time falls in a table that allows it.

    >>> table = Table("run.msl", (), np.arange(3), restarts=True)
    >>> split_pieces(table, np.array([0.0, 1.0, 0.5]))
    [slice(0, 2, None), slice(2, 3, None)]
    """
    falls = np.flatnonzero(time[1:] < time[:-1] - SAME_INSTANT) + 1 if table.restarts else np.empty(0, dtype=np.int64)
    ends = [0, *falls.tolist(), time.size]
    return [slice(begin, end) for begin, end in pairwise(ends)]


def merge_instants(time: Float, columns: Sequence[Float]) -> tuple[Float, list[Float]]:
    """Merge samples of one instant: the first value of each column that is present.

    >>> nan = np.nan
    >>> merge_instants(np.array([0.0, 1.0, 1.0 + 1e-12]), [np.array([5.0, nan, 6.0])])
    (array([0., 1.]), [array([5., 6.])])
    """
    fresh = np.concatenate([[True], time[1:] >= np.maximum.accumulate(time)[:-1] + SAME_INSTANT])
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


def drop_untimed(table: Table) -> Table:
    """Return the table without records that have no time stamp, and without a first one that belongs to another log.

    Such a first record is later than the second one: it is left over from the previous log. A remark counts them.
    """
    clock = find_time(table)
    if clock is None:
        return table
    time = time_in_seconds(clock)
    kept: Bool = ~np.isnan(time)
    known = np.flatnonzero(kept)
    if known.size > 1 and time[known[1]] < time[known[0]] - SAME_INSTANT:
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
    message = f"{lost.size} {word} of {kept.size} skipped: without a time stamp or later than the next one"
    severity = "warning" if lost.size > _SHARE * kept.size and lost.size > 1 else "remark"
    return Finding(table.at(int(lost[0])), message, severity=severity)  # type: ignore[arg-type]
