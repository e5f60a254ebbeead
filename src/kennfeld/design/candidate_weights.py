"""Weights and noise of samples that are not measured yet, by those of the training data.

A sample counts in the curvature by the score of its criterion, by its own weight w and, with a robust loss, by psi',
half the second derivative of the loss. Of a sample to come, psi' is the mean of its criterion so far, and so is the
part of w that channels give. Regions are evaluated at a candidate, if it has their channels.
"""

from collections.abc import Callable, Collection
from dataclasses import replace
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Location
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.domain.criteria import Criterion, Region
from kennfeld.domain.dataset import Dataset
from kennfeld.models.formula import expression
from kennfeld.optimize.trust.covariance import noise_share
from kennfeld.optimize.trust.noise import Group
from kennfeld.optimize.trust.variance_power import Variance
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.sample_weights import sample_weights


class CandidateWeights:
    """Weights of candidates for one criterion, and their noise.

    Args:
        fitted: the fit.
        number: of the criterion in its problem.
        unknown: channels that candidates do not have, such as targets.
        recorded: the candidates are training data, and keep their own weights.
    """

    def __init__(
        self, fitted: FittedFunction, number: int, unknown: Collection[str] = (), *, recorded: bool = False
    ) -> None:
        self._fitted, self._number, self._recorded = fitted, number, recorded
        self._criterion, self._unknown = fitted.problem.criteria[number], {*unknown}
        self._mean_of: dict[Region, float] = {}

    @cached_property
    def mean(self) -> float:
        """The mean weight that channels give to the training samples; 1 for candidates that keep their own."""
        return 1.0 if self._recorded else self._mean(lambda data: sample_weights(self._plain(), data))

    @cached_property
    def slope(self) -> float:
        """The mean of psi'."""
        groups = [group for group, _ in self._groups]
        count = sum(group.count for group in groups)
        return sum(group.slope * group.count for group in groups) / count if count else 1.0

    def factors(self, data: Dataset) -> Float | None:
        """Return the weights of the samples of candidates relative to the mean, Float[samples]; None if all are 1."""
        if self._recorded:
            return sample_weights(self._criterion, data)
        each = [self._factor(region, data) for region in self._criterion.regions]
        return np.asarray(np.prod(each, axis=0)) if each else None

    def shares(self, score: float, weights: Float) -> Float:
        """Return the variance of the gradient per curvature, Float[samples].

        Args:
            score: weight of the criterion times that of the data.
            weights: weights of the samples, Float[samples].
        """
        groups = [pair for pair in self._groups if np.isfinite(noise_share(*pair))]
        # data of the same weight tell; of others, the noise of a sample is taken to be the same
        known = [pair for pair in groups if pair[0].score == score] or groups
        total = sum(group.count for group, _ in known)
        if not total:
            return np.full(weights.size, self._fitted.estimate.dispersion)
        each = np.array([_share(group, variance, score, weights) for group, variance in known])
        shares = np.array([group.count / total for group, _ in known]) @ each
        for (group, _), own in zip(known, each, strict=True):
            # classes of weights have a noise of their own
            inside: Bool = group.contains(weights) & (group.score == score)
            shares[inside] = own[inside]
        return np.asarray(shares)

    @cached_property
    def _groups(self) -> list[tuple[Group, Variance]]:
        estimate = self._fitted.estimate
        pairs = zip(estimate.groups, estimate.variances, strict=True)
        return [(group, variance) for group, variance in pairs if group.criterion == self._number]

    def _plain(self, *regions: Region) -> Criterion:
        return replace(self._criterion, regions=regions)

    def _factor(self, region: Region, data: Dataset) -> Float:
        """Return the factor of a region, Float[samples]; its mean so far if candidates do not say where they are."""
        condition = expression(region.where, Location("where"))
        known = all(name in data and name not in self._unknown for name in condition.inputs)
        only = replace(self._plain(region), weight_channel="")

        def factor(each: Dataset) -> Float | None:
            return sample_weights(only, replace(each, weight_channel=""))

        # the clock of a recording says nothing of that of the next one
        if known and not condition.clocks:
            own = factor(data)
            return np.ones(data.samples) if own is None else own
        if region not in self._mean_of:
            self._mean_of[region] = self._mean(factor)
        return np.full(data.samples, self._mean_of[region])

    def _mean(self, weights: Callable[[Dataset], Float | None]) -> float:
        """Return a mean over the training samples that the criterion scores; 1 if there are none."""
        total, count = 0.0, 0
        for bound in self._fitted.problem.training:
            own, scored = weights(bound.dataset), self._scored(bound)
            total += float(scored.sum() if own is None else own[bound.kept][scored].sum())
            count += int(scored.sum())
        return total / count if total > 0 else 1.0

    def _scored(self, bound: BoundDataset) -> Bool:
        return np.isfinite(self._fitted.problem.target(self._criterion, bound))


def _share(group: Group, variance: Variance, score: float, weights: Float) -> Float:
    """Return the share of a group at other weights: of the variance w^-g of a sample, w^(1 - g) is left of w^2 / w."""
    relative = np.power(weights / group.typical, 1 - variance.exponent)
    return np.asarray(noise_share(group, variance) * score / group.score * relative)
