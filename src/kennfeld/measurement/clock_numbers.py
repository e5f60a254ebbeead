"""Clock times written as one number, as GPS loggers do: 235959.9 is 23:59:59.9; or with the date, 20261231235959.

Read as seconds, such a column would jump by 41 s at the end of each minute. It is recognised by its unit, `hhmmss`, or
by numbers that are clock times throughout and pass from 59 s to the next minute.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from datetime import date

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.measurement.table import Column
from kennfeld.measurement.unit_text import states_unit_of_time, time_unit

_UNIT = re.compile(r"hh?:?mm:?ss(?:[.,:]?[sxz0]*)?", re.IGNORECASE)
_MINUTE, _HOUR, _DAY = 60.0, 3600.0, 86_400.0
_FIRST_DATE, _LAST_DATE = 19_700_101, 21_001_231
_LEAST_SHARE = 0.3  # of a minute that the numbers must cover for the pattern to be no chance
_BLOCK = 1 << 16  # samples


def seconds_of_clock(numbers: Float) -> Float | None:
    """Return seconds since the first midnight of clock times HHMMSS.sss, Float[samples]; None if one is none.

    Times that fall by more than half a day belong to the next one.

    >>> seconds_of_clock(np.array([235959.9, 0.4, 100.0]))
    array([86399.9, 86400.4, 86460. ])
    """
    values = np.full(numbers.size, np.nan)
    last, days = np.nan, 0
    for block in _blocks(numbers):
        known = np.isfinite(numbers[block])
        hours, rest = np.divmod(numbers[block][known], 10_000.0)
        minutes, seconds = np.divmod(rest, 100.0)
        # a 61st second is a leap second
        if not np.all((hours >= 0) & (hours < 24) & (minutes < _MINUTE) & (seconds < _MINUTE + 1)):
            return None
        # a double resolves 3e-11 s at 235959.9, so this restores the digits that were written
        clock = np.round(_HOUR * hours + _MINUTE * minutes + seconds, 6)
        day = days + np.cumsum(np.diff(clock, prepend=last) < -_DAY / 2)
        values[block][known] = clock + _DAY * day
        # the next block goes on from the last clock time and the midnights passed so far
        last, days = (clock[-1], day[-1]) if clock.size else (last, days)
    return values


def seconds_of_dates(numbers: Float) -> Float | None:
    """Return seconds since the first day of dates with times YYYYMMDDHHMMSS, Float[samples]; None if one is none.

    >>> seconds_of_dates(np.array([20261231235959.0, 20270101000000.0]))
    array([86399., 86400.])
    """
    values, first = np.full(numbers.size, np.nan), 0
    for block in _blocks(numbers):
        known = np.isfinite(numbers[block])
        days, clock = np.divmod(numbers[block][known], 1e6)
        if not days.size:
            continue
        if days.min() < _FIRST_DATE or days.max() > _LAST_DATE:
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
        first = first or ordinals[0]
        since = _DAY * (np.array(ordinals, dtype=np.float64) - first)
        # a double resolves 0.004 s at 2e13, so further digits are noise
        values[block][known] = since[place] + _HOUR * hours + _MINUTE * minutes + np.round(seconds, 2)
    return values if first else None


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
    jumps, short, count = False, 0, 0
    low, high = np.inf, -np.inf
    last = np.empty(0), np.empty(0)
    for block in _blocks(numbers):
        known = np.isfinite(numbers[block])
        clock, time = (
            np.append(before, each[block][known]) for before, each in zip(last, (numbers, seconds), strict=True)
        )
        steps, elapsed = np.diff(clock), np.diff(time)
        if not np.all((elapsed > 0) & (elapsed < _MINUTE)):
            return False
        # from 59 to 100 the number rises by 41 and the clock by 1 s
        jumps = jumps or bool(np.any(np.abs(steps - elapsed) > 1.0))
        short, count = short + int(np.count_nonzero(elapsed < 0.1 * _MINUTE)), count + elapsed.size
        low, high = min(low, np.min(clock % 100.0, initial=low)), max(high, np.max(clock % 100.0, initial=high))
        last = clock[-1:], time[-1:]
    return jumps and high - low > _LEAST_SHARE * _MINUTE and 2 * short >= count


def _blocks(numbers: Float) -> Iterator[slice]:
    """Yield the samples in blocks: a long recording shall not need many times its size in memory."""
    for begin in range(0, numbers.size, _BLOCK):
        yield slice(begin, begin + _BLOCK)
