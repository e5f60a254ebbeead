"""Records of a log that say no time: a logger writes some before its clock runs, or while it connects."""

from dataclasses import replace

import numpy as np

from kennfeld.arrays import Bool
from kennfeld.errors import Finding
from kennfeld.measurement.columns import Table
from kennfeld.measurement.timing import SAME, find_time, seconds

__all__ = ["without_untimed"]

_SHARE = 0.1  # of the records, beyond which their loss is a warning


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
    what = f"{lost.size} {word} of {kept.size} left out, without a time stamp or later than the next one"
    severity = "warning" if lost.size > _SHARE * kept.size and lost.size > 1 else "remark"
    return Finding(table.at(int(lost[0])), what, severity=severity)  # type: ignore[arg-type]
