"""The trust in each value as a table for a spreadsheet."""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.trust import Trust
from kennfeld.parameters import Parameter, ParameterSet

__all__ = ["COLUMNS", "write_trust"]

AXES = ("x", "y", "z", "w")
COLUMNS = (
    *("parameter", *AXES, "value", "unit", "deviation", "scatter"),
    *("samples", "leverage", "informed", "by_smoothness"),
)
MANY = 2000  # values up to which the leverage is computed: its cost grows with the third power


def write_trust(trust: Trust, parameters: ParameterSet, path: Path) -> None:
    """Write a line for each free value; what is not known stays empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        leverage = trust.leverage if sum(a.size for a in trust.deviation.values()) <= MANY else {}
        for name in trust.deviation:
            writer.writerows(_lines(trust, parameters[name], leverage.get(name)))


def _lines(trust: Trust, table: Parameter, leverage: Float | None) -> Iterator[list[Any]]:
    name = table.name
    for at in np.ndindex(table.values.shape):
        place = [float(axis.breakpoints[i]) for axis, i in zip(table.index_axes, at, strict=True)]
        yield [
            name,
            *(place + [""] * (len(AXES) - len(place))),
            float(table.values[at]),
            table.unit,
            *(_number(array[at]) for array in (trust.deviation[name], trust.scatter[name])),
            int(trust.samples[name][at]),
            "" if leverage is None else _number(leverage[at]),
            *(int(flags[name][at]) for flags in (trust.informed, trust.by_smoothness)),
        ]


def _number(value: Any) -> float | str:
    return "" if np.isnan(value) else float(f"{value:.6g}")
