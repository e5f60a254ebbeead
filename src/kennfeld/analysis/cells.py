"""Errors by the cell of a table in which a sample lies, and how many samples touch each grid point."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.analysis.lookups import Lookups, cell_shape
from kennfeld.analysis.series import Series
from kennfeld.arrays import Float, Int
from kennfeld.dataset import Use
from kennfeld.parameters import ParameterSet

__all__ = ["Cells", "by_cell", "grid_samples"]


@dataclass(frozen=True, eq=False)
class Cells:
    """The errors of one criterion in each cell of a table, between its breakpoints; NaN where no sample lies.

    A sample beyond an axis counts in the cell at its end; one that looks a table up twice counts twice.
    """

    parameter: str
    criterion: int
    use: Use
    samples: Int  # Int[cells along x, ...]
    mean: Float  # Float[cells along x, ...]
    rmse: Float  # Float[cells along x, ...]


def by_cell(lookups: Lookups, parameters: ParameterSet, series: Sequence[Series]) -> tuple[Cells, ...]:
    """The errors of every criterion by the cells of every table that it depends on, training and test apart."""
    sums: dict[tuple[str, int, Use], Float] = {}
    for one, same in _by_dataset(series).items():
        errors = [(s.criterion, s.error) for s in same]
        for lookup in lookups.blocks(same[0].bound):
            name, shape = lookup.table.name, cell_shape(lookup.table)
            flat = lookup.cell
            for criterion, error in errors:
                if criterion not in lookups.reached[name]:
                    continue
                part = error[lookup.samples]
                counts = lookup.known & np.isfinite(part)
                key = (name, criterion, one[1])
                total = sums.setdefault(key, np.zeros((3, int(np.prod(shape)))))
                for row, power in zip(total, (0, 1, 2), strict=True):
                    row += np.bincount(flat[counts], part[counts] ** power, minlength=row.size)
    return tuple(_cells(*key, cell_shape(parameters[key[0]]), total) for key, total in sums.items())


def _by_dataset(series: Sequence[Series]) -> Mapping[tuple[str, Use], list[Series]]:
    grouped: dict[tuple[str, Use], list[Series]] = {}
    for one in series:
        grouped.setdefault((one.bound.dataset.name, one.bound.dataset.use), []).append(one)
    return grouped


def _cells(name: str, criterion: int, use: Use, shape: tuple[int, ...], total: Float) -> Cells:
    count, first, second = total.reshape(3, *shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, square = first / count, second / count
    return Cells(name, criterion, use, count.astype(np.int64), mean, np.sqrt(square))


def grid_samples(lookups: Lookups, parameters: ParameterSet, series: Sequence[Series]) -> dict[str, Int]:
    """For each table, how many training samples give each grid point a weight.

    Without states only scored samples count; with states every one may matter to a later one.
    """
    touched = {name: np.zeros(parameters[name].size, dtype=np.int64) for name in lookups.reached}
    for (_, use), same in _by_dataset(series).items():
        if use != "training" or same[0].bound.dataset.weight == 0:
            continue
        scored = np.logical_or.reduce([s.scored for s in same])
        for lookup in lookups.blocks(same[0].bound):
            counts = lookup.known if lookups.states else lookup.known & scored[lookup.samples]
            total = touched[lookup.table.name]
            for at, weight in lookup.corners():
                total += np.bincount(at[counts & (weight != 0)], minlength=total.size)
    return {name: total.reshape(parameters[name].values.shape) for name, total in touched.items()}
