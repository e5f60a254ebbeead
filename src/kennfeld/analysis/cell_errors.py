"""Errors by table cell, and the number of samples at each grid point."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.arrays import Float, Int
from kennfeld.dataset import Use
from kennfeld.optimize.lookup_coverage import Lookup, Lookups, cell_shape
from kennfeld.parameter_set import ParameterSet


@dataclass(frozen=True, eq=False)
class CellErrors:
    """The errors of one criterion in each cell of a table, between its breakpoints; NaN in cells without samples.

    A sample beyond an axis counts in the cell at its end; a sample that looks up a table twice counts twice.
    """

    parameter: str
    criterion: int
    use: Use
    samples: Int  # Int[cells along x, ...]
    mean: Float  # Float[cells along x, ...]
    rmse: Float  # Float[cells along x, ...]


@dataclass(frozen=True, eq=False)
class Tally:
    """The errors by the cells of every table, and the number of training samples that give each grid point a weight.

    Without states only scored samples count; with states every sample may affect a later one.
    """

    cells: tuple[CellErrors, ...]
    touching: Mapping[str, Int]  # Int of the table's shape


def tally(lookups: Lookups, parameters: ParameterSet, series: Sequence[CriterionSeries]) -> Tally:
    """Sum errors by criterion, cell and use, and count samples at grid points, in one pass over all lookups."""
    sums: dict[tuple[str, int, Use], Float] = {}
    touching = {name: np.zeros(parameters[name].size, dtype=np.int64) for name in lookups.reached}
    by_dataset: dict[tuple[str, Use], list[CriterionSeries]] = {}
    for entry in series:
        by_dataset.setdefault((entry.bound.dataset.name, entry.bound.dataset.use), []).append(entry)
    for (_, use), same in by_dataset.items():
        bound = same[0].bound
        counts = np.ones(bound.count, bool) if lookups.states else np.logical_or.reduce([s.scored for s in same])
        fits = use == "training" and bound.dataset.weight > 0
        for lookup in lookups.blocks(bound):
            name = lookup.table.name
            known = counts[lookup.samples] & lookup.known
            for at, weight in lookup.corners() if fits else ():
                touching[name] += np.bincount(at[known & (weight != 0)], minlength=touching[name].size)
            for errors in same:
                if errors.criterion in lookups.reached[name]:
                    cells = int(np.prod(cell_shape(lookup.table)))
                    _add(sums.setdefault((name, errors.criterion, use), np.zeros((3, cells))), lookup, errors)
    return Tally(
        tuple(_cells(*key, cell_shape(parameters[key[0]]), total) for key, total in sums.items()),
        {name: total.reshape(parameters[name].values.shape) for name, total in touching.items()},
    )


def _add(total: Float, lookup: Lookup, series: CriterionSeries) -> None:
    """Add count, sum and sum of squares of the errors to each cell."""
    errors = series.model[lookup.samples] - series.measured[lookup.samples]
    counts = lookup.known & np.isfinite(errors)
    cell, errors = lookup.cell[counts], errors[counts]
    total[0] += np.bincount(cell, minlength=total.shape[1])
    total[1] += np.bincount(cell, errors, minlength=total.shape[1])
    with np.errstate(over="ignore"):  # a function that explodes
        total[2] += np.bincount(cell, errors * errors, minlength=total.shape[1])


def _cells(name: str, criterion: int, use: Use, shape: tuple[int, ...], total: Float) -> CellErrors:
    count, first, second = total.reshape(3, *shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, square = first / count, second / count
    return CellErrors(name, criterion, use, count.astype(np.int64), mean, np.sqrt(square))
