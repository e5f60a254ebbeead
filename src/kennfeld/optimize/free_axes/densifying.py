"""Denser axes: the same surfaces over more breakpoints, which stand still."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.graph.free_axes import AxisKey
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.optimize.problem import Factor, Problem
from kennfeld.parameters import Axis, Parameter

__all__ = ["densified", "parts_of", "thickened", "turns_of"]

PARTS = 8  # cells that a cell of a free axis is cut into
MOST_VALUES = 1000  # of the dense problem
MOST_OF_ONE = 2000  # where a single axis is dense


def turns_of(problem: Problem) -> list[tuple[AxisKey, ...]]:
    """The free axes that are made dense together: all at once, or one after the other where that is too much."""
    together = tuple(problem.free_axes)
    if parts_of(problem, together):
        return [together]
    return [(key,) for key in together if parts_of(problem, (key,))]


def parts_of(problem: Problem, keys: Collection[AxisKey]) -> dict[AxisKey, Int]:
    """Into how many parts to cut each cell of some axes, so that the dense problem stays moderate.

    Empty where no cell can be cut.
    """
    for parts in range(PARTS, 1, -1):
        found = {key: _parts(problem.free_axes[key].axis, parts) for key in keys}
        most = MOST_OF_ONE if len(found) == 1 else MOST_VALUES
        if sum(_size(problem, name, found) for name in problem.free_names) <= most:
            return found if any((cells > 1).any() for cells in found.values()) else {}
    return {}


def _parts(axis: Axis, most: int) -> Int:
    """Parts of each cell, none narrower than breakpoints may be apart."""
    room = np.diff(axis.breakpoints) / axis.least_distance * (1 + 1e-9)
    return np.clip(room, 1, most).astype(np.int64)


def _size(problem: Problem, name: str, parts: Mapping[AxisKey, Int]) -> int:
    size = problem.parameters[name].size
    for key, cells in parts.items():
        for table, _ in problem.free_axes[key].places:
            if table == name:
                size = size // (cells.size + 1) * (int(cells.sum()) + 1)
    return size


def densified(points: Float, parts: Int) -> Float:
    """Breakpoints with each cell cut into even parts; the given ones stay, bit for bit.

    >>> densified(np.array([0.0, 1.0, 3.0]), np.array([1, 2])).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    cells = [np.linspace(a, b, n + 1)[:-1] for (a, b), n in zip(pairwise(points), parts, strict=True)]
    return np.concatenate([*cells, points[-1:]])


def thickened(problem: Problem, parts: Mapping[AxisKey, Int]) -> Problem:
    """The problem on denser axes; the same surfaces, the same price of roughness. All axes stand still."""
    tables: dict[str, Parameter] = {}
    smoothness = dict(problem.smoothness)
    for key, axis in problem.free_axes.items():
        cells = parts.get(key, np.ones(len(axis.axis) - 1, dtype=np.int64))
        still = axis.axis.changed(breakpoints=densified(axis.axis.breakpoints, cells), free=False)
        for name, which in axis.places:
            known = smoothness[name] if name in tables else problem.factors(name)
            factors: list[Factor] = [known] if isinstance(known, float | str) else [*known]
            factors[which] = float(factors[which]) * (cells.sum() / max(cells.size, 1)) ** 4
            tables[name] = _on(tables.get(name, problem.parameters[name]), which, still)
            smoothness[name] = tuple(factors)
    return replace(
        problem,
        parameters=problem.parameters.with_parameters(*tables.values()),
        smoothness=smoothness,
        restraints={name: restraint for name, restraint in problem.restraints.items() if name not in tables},
    )


def _on(table: Parameter, which: int, axis: Axis) -> Parameter:
    """A table on a denser axis; what lies between two locked values is locked, its bounds are the wider ones."""
    place = position(axis.breakpoints, table.axes[which].breakpoints, "clip")
    weights, _ = cell_weights(place, len(table.axes[which]))
    left = np.floor(place).astype(np.int64)
    right = np.ceil(place).astype(np.int64)
    values = np.moveaxis(np.tensordot(weights, table.values, axes=(1, which)), 0, which)

    def both(array: Any) -> tuple[Any, Any]:
        return np.take(array, left, axis=which), np.take(array, right, axis=which)

    return table.changed(
        values=values,
        axes=tuple(axis if i == which else old for i, old in enumerate(table.axes)),
        lower=np.minimum(*both(table.lower)),
        upper=np.maximum(*both(table.upper)),
        locked=np.logical_and(*both(table.locked)),
    )
