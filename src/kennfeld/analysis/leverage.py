"""Leverage of samples: the influence of each on the values that are fitted to it.

The leverage of a grid point, 1 if the data alone determine it, is distributed among the samples that look it up, by
their weights in the lookup and in the cost. Its sum over all samples equals that over all grid points, the number of
values that the data determine. For a single table whose samples are at its grid points this is the diagonal of the hat
matrix; otherwise it approximates it without a matrix of samples by values.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import field

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.lookup_coverage import Lookup, Lookups
from kennfeld.preprocessing.sample_weights import sample_weights

MAX_LEVERAGE = 0.999  # a sample that alone determines a value has no residual


def _fits(series: CriterionSeries) -> bool:
    return series.bound.dataset.use == "training"


@dataclass
class LookupWeights:
    """The weight of all training samples at each grid point, by table; can be merged with that of other samples."""

    totals: dict[str, Float] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        problem: Problem,
        lookups: Lookups,
        located: Iterable[Lookup],
        series: Sequence[CriterionSeries],
        tables: Collection[str],
    ) -> "LookupWeights":
        """Return the weights of the samples of a dataset or a part of one in some tables."""
        result, located = cls(), list(located)
        for entry in series if _fits(series[0]) else ():
            own = _weight(problem, entry)
            for lookup in _reaching(lookups, located, entry, tables):
                total = result.totals.setdefault(lookup.table.name, np.zeros(lookup.table.size))
                first, here = lookup.first_corner, own[lookup.samples]
                for distance, weight in _positive_weights(lookup):
                    # a corner is at the same distance behind the first one for all samples: one count, shifted
                    corner = np.bincount(first, weight * here, minlength=total.size)
                    total[distance:] += corner[: total.size - distance]
        return result

    def merge(self, later: "LookupWeights") -> None:
        """Take in the weights of other samples."""
        for name, total in later.totals.items():
            self.totals[name] = self.totals[name] + total if name in self.totals else total

    def leverage(
        self,
        problem: Problem,
        lookups: Lookups,
        located: Iterable[Lookup],
        series: CriterionSeries,
        leverage: Mapping[str, Float],
    ) -> Float:
        """Share out the leverage of grid points to the samples of a series, after all weights are in.

        Args:
            problem: criteria and their weights.
            lookups: at the values of the fit.
            located: the lookups of the samples.
            series: a criterion on the samples.
            leverage: of the grid points, by table.

        Returns:
            Float[samples].
        """
        pulls = np.zeros(series.bound.count)
        if not _fits(series):
            return pulls
        own = _weight(problem, series)
        for lookup in _reaching(lookups, located, series, leverage):
            total, table = self.totals[lookup.table.name], leverage[lookup.table.name].ravel()
            # leverage per unit of weight
            each = np.divide(table, total, out=np.zeros(total.size), where=total > 0)
            first, pull = lookup.first_corner, np.zeros(lookup.known.size)
            for distance, weight in _positive_weights(lookup):
                pull += each[distance:].take(first) * weight
            pulls[lookup.samples] += pull * own[lookup.samples]
        # fmax also turns NaN into 0
        return np.fmin(np.fmax(pulls, 0.0), MAX_LEVERAGE)


def _weight(problem: Problem, series: CriterionSeries) -> Float:
    criterion = problem.criteria[series.criterion]
    weight = criterion.weight * series.bound.dataset.weight / criterion.scale**2
    own = sample_weights(criterion, series.bound.dataset)
    each = weight if own is None else weight * own[series.bound.kept]
    return np.where(series.scored, each, 0.0)


def _reaching(
    lookups: Lookups, located: Iterable[Lookup], series: CriterionSeries, tables: Collection[str]
) -> Iterator[Lookup]:
    """Yield the lookups of these tables on which the criterion depends."""
    for lookup in located:
        if lookup.table.name in tables and series.criterion in lookups.reached[lookup.table.name]:
            yield lookup


def _positive_weights(lookup: Lookup) -> Iterator[tuple[int, Float]]:
    """Yield the weights of the corners as `Lookup.weights` does, 0 for those that are negative by extrapolation."""
    for distance, weight in lookup.weights():
        yield distance, weight if lookup.table.extrapolation == "clip" else np.maximum(weight, 0.0)
