"""Errors by table cell, and the number of samples at each grid point."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import field

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Use
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.quality.lookup_coverage import Lookup, Lookups, cell_shape


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
    """Sum errors by criterion, cell and use, and count samples at grid points, in one pass over all lookups.

    `series` are the criteria on all datasets; the errors are in the unit of their target.
    """
    # the lookups of a dataset are located once for all its criteria
    by_dataset: dict[tuple[str, Use], list[CriterionSeries]] = {}
    for entry in series:
        by_dataset.setdefault((entry.bound.dataset.name, entry.bound.dataset.use), []).append(entry)
    sums = CellSums()
    for same in by_dataset.values():
        sums.merge(CellSums.of(lookups, lookups.blocks(same[0].bound), same))
    return sums.tally(lookups, parameters)


@dataclass
class CellSums:
    """Sums by cell and counts by grid point, which can be merged with those of other samples.

    The samples at the grid points of the tables `counted` are known already.
    """

    counted: Collection[str] = ()
    errors: dict[tuple[str, int, Use], Float] = field(default_factory=dict)  # Float[3, cells]
    touching: dict[str, Int] = field(default_factory=dict)  # Int[values]

    @classmethod
    def of(
        cls,
        lookups: Lookups,
        located: Iterable[Lookup],
        series: Sequence[CriterionSeries],
        counted: Collection[str] = (),
    ) -> "CellSums":
        """Return the sums over a dataset or a part of one.

        Args:
            lookups: all lookups.
            located: those of the dataset.
            series: all criteria that it scores.
            counted: see the class.
        """
        sums, bound = cls(counted), series[0].bound
        if bound.dataset.is_fitted:
            counts = np.ones(bound.count, bool) if lookups.states else np.logical_or.reduce([s.scored for s in series])
        for lookup in located:
            name = lookup.table.name
            if bound.dataset.is_fitted and name not in counted:
                touching = sums.touching.setdefault(name, np.zeros(lookup.table.size, dtype=np.int64))
                touching += _count_corners(lookup, counts[lookup.samples] & lookup.known)
            for errors in series:
                if errors.criterion in lookups.reached[name] and errors.scored.any():
                    cells = int(np.prod(cell_shape(lookup.table)))
                    key = (name, errors.criterion, bound.dataset.use)
                    _add(sums.errors.setdefault(key, np.zeros((3, cells))), lookup, errors)
        return sums

    def merge(self, later: "CellSums") -> None:
        """Take in the sums over other samples."""
        for key, total in later.errors.items():
            self.errors[key] = self.errors[key] + total if key in self.errors else total
        for name, count in later.touching.items():
            self.touching[name] = self.touching[name] + count if name in self.touching else count

    def tally(self, lookups: Lookups, parameters: ParameterSet) -> Tally:
        """Return the errors by cell and the counts in the shapes of the tables."""
        names = [name for name in lookups.reached if name not in self.counted]
        touching = {name: np.zeros(parameters[name].size, dtype=np.int64) for name in names}
        return Tally(
            tuple(_cells(*key, cell_shape(parameters[key[0]]), total) for key, total in self.errors.items()),
            {name: count.reshape(parameters[name].values.shape) for name, count in (touching | self.touching).items()},
        )


def _count_corners(lookup: Lookup, counts: Bool) -> Int:
    """Return how many of the samples that count give each grid point a weight."""
    touching = np.zeros(lookup.table.size, dtype=np.int64)
    for at, weight in lookup.corners:
        # a sample on a breakpoint gives the corners beyond it the weight 0: it does not touch them
        touching += np.bincount(at[counts & (weight != 0)], minlength=touching.size)
    return touching


def _add(total: Float, lookup: Lookup, series: CriterionSeries) -> None:
    """Add count, sum and sum of squares of the errors to each cell."""
    errors = series.error[lookup.samples]
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
