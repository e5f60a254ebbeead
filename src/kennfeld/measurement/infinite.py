"""Infinite values of a recording: no sensor measures them, so they are missing values, whatever the format."""

from dataclasses import replace

import numpy as np

from kennfeld.errors import Finding
from kennfeld.measurement.columns import Column, Table

__all__ = ["without_infinite"]


def without_infinite(table: Table) -> Table:
    """Return the table with NaN in place of infinite values, and a warning for each column that has some.

    >>> table = without_infinite(Table("a.csv", (Column("v", "", "v", np.array([1.0, np.inf])),), np.arange(1, 3)))
    >>> print(table.columns[0].values, *table.remarks)
    [ 1. nan] a.csv line 2, column v: 1 of 2 values is infinite and taken as missing
    """
    finite = {id(column): _finite(column) for column in table.columns}
    changed = [column for column in table.columns if finite[id(column)] is not column]
    if not changed:
        return table
    clock = None if table.clock is None else finite.get(id(table.clock), table.clock)
    columns = tuple(finite[id(column)] for column in table.columns)
    remarks = tuple(_warning(table, column) for column in changed)
    return replace(table, columns=columns, clock=clock, remarks=(*table.remarks, *remarks))


def _finite(column: Column) -> Column:
    infinite = np.isinf(column.values)
    return replace(column, values=np.where(infinite, np.nan, column.values)) if infinite.any() else column


def _warning(table: Table, column: Column) -> Finding:
    at = np.flatnonzero(np.isinf(column.values))
    what = f"{at.size} of {column.values.size} values {'is' if at.size == 1 else 'are'} infinite and taken as missing"
    return Finding(table.at(int(at[0]), column), what, severity="warning")
