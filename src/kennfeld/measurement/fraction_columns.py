"""Parts of the time in columns of their own: the date beside a time of day, and milliseconds beside whole seconds."""

from dataclasses import replace

import numpy as np

from kennfeld.base.errors import Finding
from kennfeld.measurement.table import Column, Table
from kennfeld.measurement.time_column import find_time
from kennfeld.measurement.unit_text import is_fraction_name

_PER_SECOND = 1000
_DAY = 86_400.0  # s


def with_days(table: Table) -> Table:
    """Return the table with times of day on the days of a column of dates, which a pause may have skipped."""
    clock = find_time(table)
    if clock is None or not clock.dated or clock.origin is not None or table.clock is not None:
        return table
    dates = next((column for column in table.columns if _is_days(column)), None)
    if dates is None:
        return table
    stamps = dates.values + clock.values % _DAY
    known = stamps[~np.isnan(stamps)]
    # a date that stays behind at midnight is that of the file
    if known.size < np.count_nonzero(~np.isnan(clock.values)) or np.any(np.diff(known) < 0):
        message = f"its dates do not go with the times of day of {clock.place}, which are read without them"
        return _with_remark(table, dates, message)
    whole = replace(clock, values=stamps, origin=dates.origin)
    return replace(table, columns=tuple(whole if column is clock else column for column in table.columns))


def _is_days(column: Column) -> bool:
    """Return whether a column holds dates without times of day, of several days."""
    known = column.values[~np.isnan(column.values)]
    is_whole = column.dated and column.origin is not None and bool(np.all(known % _DAY == 0))
    return is_whole and known.size > 0 and bool(np.any(known != known[0]))


def with_fractions(table: Table) -> Table:
    """Return the table with the milliseconds of a column of their own added to its time stamps."""
    clock = find_time(table)
    if clock is None or not clock.dated or table.clock is not None:
        return table
    fraction = next((column for column in table.columns if _is_fraction(column)), None)
    known = clock.values[~np.isnan(clock.values)]
    # stamps with fractions of their own lack no milliseconds
    if fraction is None or np.any(known != np.round(known)):
        return table
    stamps = clock.values + fraction.values / _PER_SECOND
    steps = np.diff(stamps[~np.isnan(stamps)])
    # gaps, or stamps that fall, show that the column counts something else
    if np.isnan(stamps).sum() > np.isnan(clock.values).sum() or np.any(steps < 0):
        return table
    columns = tuple(replace(clock, values=stamps) if column is clock else column for column in table.columns)
    message = f"its milliseconds were added to the time stamps of {clock.place}"
    return _with_remark(replace(table, columns=columns), fraction, message)


def _with_remark(table: Table, column: Column, message: str) -> Table:
    remark = Finding(table.location.within(f"column {column.place}"), message, severity="remark")
    return replace(table, findings=(*table.findings, remark))


def _is_fraction(column: Column) -> bool:
    known = column.values[~np.isnan(column.values)]
    whole = known.size > 0 and bool(np.all((known >= 0) & (known < _PER_SECOND) & (known == np.round(known))))
    return whole and not column.dated and not column.text_count and is_fraction_name(column.name)
