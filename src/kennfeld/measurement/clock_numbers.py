"""Clock times written as one number, as GPS loggers do: 235959.9 is 23:59:59.9; or with the date, 20261231235959.

Read as seconds, such a column would jump by 41 s at the end of each minute. It is recognised by its unit, `hhmmss`, or
by numbers that are clock times throughout and pass from 59 s to the next minute.
"""

import re
from dataclasses import replace
from datetime import date

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.measurement.table import Column
from kennfeld.measurement.unit_text import states_unit_of_time, time_unit

_UNIT = re.compile(r"hh?:?mm:?ss(?:[.,:]?[sxz0]*)?", re.IGNORECASE)
_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86_400.0
_FIRST_DATE, _LAST_DATE = 19_700_101, 21_001_231
_LEAST_SHARE = 0.3  # of a minute that the numbers must cover for the pattern to be no chance


def seconds_of_clock(numbers: Float) -> Float | None:
    """Return seconds since the first midnight of clock times HHMMSS.sss, Float[samples]; None if one is none.

    Times that fall by more than half a day belong to the next one.

    >>> seconds_of_clock(np.array([235959.9, 0.4, 100.0]))
    array([86399.9, 86400.4, 86460. ])
    """
    known = np.isfinite(numbers)
    hours, rest = np.divmod(numbers[known], 10_000.0)
    minutes, seconds = np.divmod(rest, 100.0)
    # a 61st second is a leap second
    if not np.all((hours >= 0) & (hours < 24) & (minutes < _MINUTE) & (seconds < _MINUTE + 1)):
        return None
    values = np.full(numbers.size, np.nan)
    values[known] = np.round(_HOUR * hours + _MINUTE * minutes + seconds, 6)
    days = np.cumsum(np.diff(values[known], prepend=values[known][:1]) < -_DAY / 2)
    values[known] += _DAY * days
    return values


def seconds_of_dates(numbers: Float) -> Float | None:
    """Return seconds since the first day of dates with times YYYYMMDDHHMMSS, Float[samples]; None if one is none.

    >>> seconds_of_dates(np.array([20261231235959.0, 20270101000000.0]))
    array([86399., 86400.])
    """
    known = np.isfinite(numbers)
    days, clock = np.divmod(numbers[known], 1e6)
    if not days.size or days.min() < _FIRST_DATE or days.max() > _LAST_DATE:
        return None
    dates, place = np.unique(days, return_inverse=True)
    try:
        ordinals = [date.fromisoformat(f"{day:.0f}").toordinal() for day in dates.tolist()]
    except ValueError:
        return None
    hours, rest = np.divmod(clock, 1e4)
    minutes, seconds = np.divmod(rest, 100.0)
    if not np.all((hours < 24) & (minutes < _MINUTE) & (seconds < _MINUTE + 1)):
        return None
    values = np.full(numbers.size, np.nan)
    since = _DAY * (np.array(ordinals, dtype=np.float64) - ordinals[0])
    values[known] = since[place] + _HOUR * hours + _MINUTE * minutes + np.round(seconds, 2)
    return values


def decode_clock(column: Column) -> Column:
    """Return a time column of clock numbers as one of seconds; other columns as they are."""
    if column.dated or column.text_count:
        return column
    stated = _UNIT.fullmatch(column.unit.strip()) is not None
    named = time_unit(column.name, "") == "s" and not states_unit_of_time(column.name, column.unit)
    if not (stated or named):
        return column
    values = seconds_of_dates(column.values)
    if values is None:
        values = seconds_of_clock(column.values)
        if values is None or not (stated or _passes_minutes(column.values, values)):
            return column
    values.setflags(write=False)
    return replace(column, values=values, unit="", dated=True)


def _passes_minutes(numbers: Float, seconds: Float) -> bool:
    """Return whether the numbers pass from 59 s to the next minute, and never otherwise step more than the seconds."""
    known = np.isfinite(numbers)
    steps, elapsed = np.diff(numbers[known]), np.diff(seconds[known])
    if not steps.size or not np.all((elapsed > 0) & (elapsed < _MINUTE)):
        return False
    jumps: Bool = np.abs(steps - elapsed) > 1.0
    within_minute = (numbers[known] % 100.0).max() - (numbers[known] % 100.0).min()
    return bool(jumps.any()) and within_minute > _LEAST_SHARE * _MINUTE and float(np.median(elapsed)) < 0.1 * _MINUTE
