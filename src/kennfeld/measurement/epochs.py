"""Time stamps as numbers since 1970 in ms, us or ns, as loggers, databases and pandas write them without a unit."""

from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding
from kennfeld.measurement.table import Column, Selection, Table
from kennfeld.measurement.unit_text import says_time, states_unit_of_time, time_unit

_SINCE, _UNTIL = 946_684_800.0, 4_102_444_800.0  # s from 1970 to 2000 and to 2100
_UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9}
_NAMES = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
_LONGEST_STEP = 3600.0  # s between samples of a recording


def with_epochs(table: Table, selection: Selection) -> Table:
    """Return the table with the unit of time columns whose numbers count from 1970 in ms, us or ns."""
    columns, findings = [], []
    for column in table.columns:
        unit = "" if column.name in selection.units else epoch_unit(column)
        if unit:
            message = f"the numbers are {_NAMES[unit]} since 1970 and were read as such"
            remedy = "State the unit of the column if that is wrong."
            location = table.location.within(f"column {column.place}")
            findings.append(Finding(location, message, remedy, severity="remark"))
            column = replace(column, unit=unit)
        columns.append(column)
    return replace(table, columns=tuple(columns), findings=(*table.findings, *findings)) if findings else table


def epoch_unit(column: Column) -> str:
    """Return `ms`, `us` or `ns` if the numbers of a time column count these since 1970; else nothing.

    >>> epoch_unit(Column("timestamp", "", "timestamp", np.array([1767225600000.0, 1767225600100.0])))
    'ms'
    """
    if column.dated or column.text_count or states_unit_of_time(column.name, column.unit):
        return ""
    if time_unit(column.name, column.unit) is None and not says_time(column.name):
        return ""
    low, high = column.extent
    # the three ranges are a factor of 1000 apart, so at most one fits
    candidates = [(u, s) for u, s in _UNITS.items() if _SINCE * s <= low and high <= _UNTIL * s]
    if not candidates:
        return ""
    known: Float = column.values[~np.isnan(column.values)]
    step = float(np.median(np.abs(np.diff(known)))) if known.size > 1 else 0.0
    return next((u for u, s in candidates if step <= _LONGEST_STEP * s), "")
