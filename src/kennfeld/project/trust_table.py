"""The trust in each value as a table for a spreadsheet."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.graph.free_axes import free_axes
from kennfeld.optimize.trust import Trust
from kennfeld.parameters import ParameterSet
from kennfeld.rbf import RBF

__all__ = ["COLUMNS", "write_trust"]

AXES = ("x", "y", "z", "w")
COLUMNS = (
    *("parameter", *AXES, "value", "unit", "deviation", "scatter"),
    *("samples", "leverage", "informed", "by_smoothness"),
)
MANY = 2000  # values up to which the leverage is computed: its cost grows with the third power


def write_trust(trust: Trust, parameters: ParameterSet, path: Path) -> None:
    """Write a line for each free value, breakpoints last; what is not known stays empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        leverage = trust.leverage if sum(a.size for a in trust.deviation.values()) <= MANY else {}
        for name in trust.deviation:
            writer.writerows(_lines(trust, name, *_values(name, parameters), leverage.get(name)))


def _values(name: str, parameters: ParameterSet) -> tuple[Float, str, list[list[float | str]]]:
    """The values of a parameter, their unit, and its breakpoints: of an axis numbers, of an expansion names."""
    if name in parameters:
        table = parameters[name]
        if isinstance(table, RBF):
            return table.values, table.unit, [[table.value_name(i) for i in range(table.size)]]
        return table.values, table.unit, [axis.breakpoints.tolist() for axis in table.index_axes]
    place = next(axis.places[0] for key, axis in free_axes(parameters).items() if name in (str(key), f"axis {key}"))
    axis = parameters[place[0]].axes[place[1]]
    return axis.breakpoints, axis.unit, [np.arange(1.0, len(axis) + 1).tolist()]


def _lines(
    trust: Trust, name: str, values: Float, unit: str, breakpoints: Sequence[list[float | str]], leverage: Float | None
) -> Iterator[list[Any]]:
    for at in np.ndindex(values.shape):
        place = [points[i] for points, i in zip(breakpoints, at, strict=True)]
        yield [
            name,
            *(place + [""] * (len(AXES) - len(place))),
            float(values[at]),
            unit,
            *(_number(array[at]) for array in (trust.deviation[name], trust.scatter[name])),
            int(trust.samples[name][at]),
            "" if leverage is None else _number(leverage[at]),
            *(int(flags[name][at]) for flags in (trust.informed, trust.by_smoothness)),
        ]


def _number(value: Any) -> float | str:
    return "" if np.isnan(value) else float(f"{value:.6g}")
