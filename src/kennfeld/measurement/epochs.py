"""Time stamps as numbers without a unit that count from a distant date, as databases and spreadsheets write them.

Milliseconds, microseconds and nanoseconds since 1970 (Unix, pandas), ticks of 100 ns (.NET, Windows), and days
(spreadsheets, MATLAB's `datenum`). Read as seconds, they would silently give steps that are 1000 times too long, or
86400 times too short.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.unit_text import in_seconds, plain_unit, says_time, states_unit_of_time, time_unit

_SINCE, _UNTIL = 946_684_800.0, 4_102_444_800.0  # s from 1970 to 2000 and to 2100
_LONGEST_STEP = 3600.0  # s between samples of a recording
_LONGEST_STEP_IN_DAYS = 2e-4  # of numbers that may also be seconds: 17 s, or 5 kHz
_DECIMALS = 1e6  # seconds have at most six digits behind the point, days of a clock more


@dataclass(frozen=True)
class Epoch:
    """A way to count: the unit of the numbers, what 1970 is in it, and how a message calls it."""

    unit: str
    name: str
    zero: float = 0.0  # the number that stands for 1970

    @property
    def per_second(self) -> float:
        """The numbers that pass in a second."""
        factor, divisor = in_seconds(self.unit) or (1.0, 1.0)
        return divisor / factor

    def counts(self, column: Column) -> bool:
        """Return whether the numbers are dates from 2000 to 2100, in the steps of a recording."""
        low, high = column.extent
        if not (self._number(_SINCE) <= low and high <= self._number(_UNTIL)):
            return False
        known: Float = column.values[~np.isnan(column.values)]
        step = float(np.median(np.abs(np.diff(known)))) if known.size > 1 else 0.0
        if step > _LONGEST_STEP * self.per_second:
            return False
        # days from 2000 to 2100 are also seconds of half a day or of a week; their steps tell
        return self.unit != "days" or (0.0 < step < _LONGEST_STEP_IN_DAYS and _has_many_decimals(known))

    def _number(self, seconds: float) -> float:
        return self.zero + seconds * self.per_second


_EPOCHS = (
    # the ranges of the years 2000 to 2100 do not overlap, so at most one fits
    Epoch("ms", "milliseconds since 1970"),
    Epoch("us", "microseconds since 1970"),
    Epoch("ns", "nanoseconds since 1970"),
    Epoch("100ns", "ticks of 100 ns since the year 1", 621_355_968_000_000_000.0),
    Epoch("100ns", "ticks of 100 ns since 1601", 116_444_736_000_000_000.0),
    Epoch("days", "days since 1900, as spreadsheets count them,", 25_569.0),
    Epoch("days", "days of MATLAB (datenum)", 719_529.0),
)


def with_epochs(table: Table, selection: Selection) -> Table:
    """Return the table with the unit of time columns whose numbers count from a distant date."""
    columns = [_with_epoch(column, selection) for column in table.columns]
    findings = [finding for pair in zip(table.columns, columns, strict=True) for finding in _remarks(table, *pair)]
    return replace(table, columns=tuple(columns), findings=(*table.findings, *findings)) if findings else table


def _with_epoch(column: Column, selection: Selection) -> Column:
    epoch = None if column.name in selection.units else epoch_of(column)
    return column if epoch is None else replace(column, unit=epoch.unit)


def _remarks(table: Table, column: Column, converted: Column) -> Iterator[Finding]:
    location = table.location.within(f"column {column.place}")
    if converted is not column:
        epoch = epoch_of(column)
        message = f"the numbers are {epoch.name if epoch else ''} and were read as such"
        yield Finding(location, message, "State the unit of the column if that is wrong.", severity="remark")
    elif plain_unit(column.unit) == "s" and (epoch := epoch_of(replace(column, unit=""))) is not None:
        message = f"the time is in s as stated, but its numbers look like {epoch.name.rstrip(',')}"
        remedy = f'State the unit of the column if they are: [units] of a project, "{epoch.unit}".'
        yield Finding(location, message, remedy, severity="warning")


def epoch_of(column: Column) -> Epoch | None:
    """Return how the numbers of a time column without a unit count from a distant date; None if they do not.

    >>> column = Column("timestamp", "", "timestamp", np.array([1767225600000.0, 1767225600100.0]))
    >>> epoch_of(column).name
    'milliseconds since 1970'
    """
    if column.dated or column.text_count or states_unit_of_time(column.name, column.unit):
        return None
    if time_unit(column.name, column.unit) is None and not says_time(column.name):
        return None
    return next((epoch for epoch in _EPOCHS if epoch.counts(column)), None)


def _has_many_decimals(numbers: Float) -> bool:
    """Return whether some number, Float[samples], has more than six digits behind the point."""
    scaled = numbers * _DECIMALS
    return bool(np.any(np.abs(scaled - np.round(scaled)) > 8 * np.spacing(np.abs(scaled))))
