"""How much a sample pulls the fit towards itself, so that its error can be judged."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from kennfeld.analysis.lookups import Lookup, Lookups
from kennfeld.analysis.series import Series
from kennfeld.arrays import Float
from kennfeld.optimize import Problem
from kennfeld.optimize.data.weighting import sample_weights

__all__ = ["sample_leverage"]

MOST = 0.999  # a sample that decides a value alone has no error left to judge


def sample_leverage(
    problem: Problem, lookups: Lookups, series: Sequence[Series], leverage: Mapping[str, Float]
) -> dict[int, Float]:
    """The leverage of each training sample, by the number of its series.

    The leverage of a grid point, 1 where the data alone decide it, is shared out among the samples that look it up,
    by their weights in the lookup and in the cost. Over all samples it adds up to that of all grid points, which is
    the number of values that the data determine. For a table alone whose samples lie on its grid points this is the
    diagonal of the hat matrix; else it approximates it without a matrix of samples by values.
    """
    training = {i: one for i, one in enumerate(series) if one.bound.dataset.use == "training"}
    weights = {i: _weight(problem, one) for i, one in training.items()}
    totals = {name: np.zeros(values.size) for name, values in leverage.items() if name in lookups.reached}
    for i, lookup in _reaching(lookups, training, totals):
        total = totals[lookup.table.name]
        for at, weight in lookup.corners():
            total += np.bincount(at, _share(weight, weights[i][lookup.samples]), minlength=total.size)
    found = {i: np.zeros(one.bound.count) for i, one in training.items()}
    for i, lookup in _reaching(lookups, training, totals):
        name = lookup.table.name
        each = np.divide(leverage[name].ravel(), totals[name], out=np.zeros(totals[name].size), where=totals[name] > 0)
        for at, weight in lookup.corners():
            found[i][lookup.samples] += each[at] * _share(weight, weights[i][lookup.samples])
    return {i: np.clip(np.nan_to_num(values), 0.0, MOST) for i, values in found.items()}


def _weight(problem: Problem, series: Series) -> Float:
    criterion = problem.criteria[series.criterion]
    weight = criterion.weight * series.bound.dataset.weight / criterion.scale**2
    own = sample_weights(criterion, series.bound.dataset)
    each = weight if own is None else weight * own[series.bound.kept]
    return np.where(series.scored, each, 0.0)


def _share(weight: Float, of_sample: Float) -> Float:
    return np.clip(weight, 0.0, None) * of_sample


def _reaching(
    lookups: Lookups, training: Mapping[int, Series], wanted: Mapping[str, Float]
) -> Iterator[tuple[int, Lookup]]:
    """Lookups of the wanted tables, with the number of each series that depends on them."""
    for i, one in training.items():
        for lookup in lookups.blocks(one.bound):
            if lookup.table.name in wanted and one.criterion in lookups.reached[lookup.table.name]:
                yield i, lookup
