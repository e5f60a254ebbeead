"""Time stamps of fast recordings that count from a distant date.

Doubles resolve 0.24 us in the seconds since 1970, which is 0.2 % of the step of 10 kHz. Differences of such stamps are
taken from the numbers in the file, before they are rounded: of integers, of decimal fractions, or of doubles that stand
for the decimal fraction nearest to them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding
from kennfeld.base.numeric import median
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.time_column import find_time
from kennfeld.measurement.unit_text import in_seconds, time_unit

_FINE = 4096  # resolutions of a double that a step must have
_INTEGERS = 2.0**53  # up to which doubles hold each one
_MOST_DIGITS = 9  # behind the point: nanoseconds


def with_fine_clocks(tables: Sequence[Table], selection: Selection) -> list[Table]:
    """Return the tables of a file; time stamps too coarse for their steps count from the earliest one of all tables."""
    clocks = [find_time(table, selection.channels or ()) for table in tables]
    if not any(clock is not None and _is_coarse(clock) for clock in clocks):
        return list(tables)
    # one origin for all tables, or their clocks would be shifted against each other
    firsts = [_first(clock) for clock in clocks if clock is not None]
    value, rest = min((first for first in firsts if first is not None), key=sum)
    return [
        table if clock is None else _with_clock(table, clock, elapsed_since(clock, value, rest))
        for table, clock in zip(tables, clocks, strict=True)
    ]


def _is_coarse(clock: Column) -> bool:
    """Return whether doubles resolve less than a 4096th of the step of a clock."""
    if clock.dated:
        return False
    known = clock.values[np.isfinite(clock.values)]
    if known.size < 2:
        return False
    steps = np.abs(np.diff(known))
    steps = steps[steps > 0]  # stamps of few digits repeat
    coarse = _FINE * float(np.spacing(np.abs(known).max()))
    # the median is below that if more than half of the steps are; only at a tie does it have to be known
    excess = 2 * int(np.count_nonzero(steps < coarse)) - steps.size
    return median(steps) < coarse if steps.size and excess == 0 else excess > 0


def _first(clock: Column) -> tuple[float, float] | None:
    known = np.flatnonzero(np.isfinite(clock.values))
    if not known.size:
        return None
    rest = 0.0 if clock.rest is None else float(clock.rest[known[0]])
    return float(clock.values[known[0]]), rest


def elapsed_since(clock: Column, value: float, rest: float = 0.0) -> Float:
    """Compute the time stamps of a clock in s, Float[samples], since the stamp `value` + `rest` in the clock's unit.

    >>> stamps = 1767225600 + 0.0001 * np.arange(3)
    >>> elapsed_since(Column("time", "s", "time", stamps), stamps[0])
    array([0.    , 0.0001, 0.0002])
    """
    factor, divisor = in_seconds(time_unit(clock.name, clock.unit) or clock.unit) or (1.0, 1.0)
    if clock.rest is not None:
        # the difference of stamps within a factor of 2 is exact (Sterbenz, 1974); the rests are what the doubles lack
        return ((clock.values - value) + (clock.rest - rest)) * factor / divisor
    power = _decimal_power(clock.values)
    if power is None:
        return (clock.values - value) * factor / divisor
    # decimal fractions become whole ticks, whose differences are exact
    ticks: Float = np.rint(clock.values * power) - np.rint(value * power)
    return ticks * factor / (divisor * power)


def _decimal_power(values: Float) -> float | None:
    """Return the least power of ten by which all doubles are nearest to an integer divided by it."""
    known = values[np.isfinite(values)]
    for digits in range(_MOST_DIGITS + 1):
        power = 10.0**digits
        scaled = known * power
        if np.abs(scaled).max(initial=0.0) >= _INTEGERS:
            return None
        if np.array_equal(np.rint(scaled) / power, known):
            return power
    return None


def _with_clock(table: Table, clock: Column, elapsed: Float) -> Table:
    index = next(i for i, column in enumerate(table.columns) if column is clock)
    own = replace(clock, values=elapsed, unit="s", rest=None)
    message = "its numbers are too large for the steps between them and count from the first one"
    remark = Finding(table.location.within(f"column {clock.place}"), message, severity="remark")
    columns = (*table.columns[:index], own, *table.columns[index + 1 :])
    return replace(table, columns=columns, clock_index=index, findings=(*table.findings, remark))
