"""Estimation of the measurement noise from the residuals of a fit.

Samples of one criterion in datasets of one weight, with similar sample weights, form a group with its own sigma: the
variance of a sample of weight w is sigma^2 / w, and sigma^2 is the sum of w r^2 divided by its degrees of freedom. The
result is therefore correct both if weights state the quality of the data and if they merely state their importance. The
weight and the scale of a criterion do not affect its noise. Samples of weight 0 do not count.

With robust losses, the moments of psi, half the slope of the loss, replace those of the residual (P. J. Huber: Robust
Regression, Annals of Statistics 1, 1973): the variance of a value is E[psi^2] / E[psi']^2 times that for unit noise.
The loss is applied before the weight, so each group has its own moments as well.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.criteria import Criterion
from kennfeld.native.column_table import ColumnTable
from kennfeld.native.samples import Samples
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.trust.persistence import persistence
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.sample_weights import SampleWeights

MIN_FREEDOM = 1.0  # residual degrees of freedom for an estimate of the noise
MIN_GROUP_FREEDOM = 10.0  # the same for one of several groups; with fewer, the noise is that of the criterion
MAX_CLASSES = 8  # of samples by their own weight
MAX_WEIGHT_RATIO = 1.5  # of the largest to the smallest weight in one class


@dataclass(frozen=True)
class Group:
    """The residuals of one criterion in the datasets of one weight, in units of the scale of the criterion.

    Of samples with weights of their own, the group has those with above < weight <= most.
    """

    criterion: int
    score: float  # weight of criterion times weight of dataset
    count: int
    squares: float  # sum of w psi^2, w the weight of the sample
    weight: float  # mean of psi / residual, the weight in the matrix of the fit
    slope: float  # mean of psi'
    persistence: float  # samples for each one that is independent of those before
    typical: float = 1.0  # mean w
    above: float = 0.0
    most: float = float("inf")

    def contains(self, weights: Float) -> Bool:
        """Return True for the weights of samples in this group."""
        inside: Bool = (weights > self.above) & (weights <= self.most)
        return inside


def groups(
    criteria: Sequence[Criterion], bounds: Sequence[BoundDataset], errors: Sequence[Float], weighting: SampleWeights
) -> list[Group]:
    """Return the groups of the training data.

    Args:
        criteria: the criteria.
        bounds: the training data.
        errors: model minus target for each dataset, NaN if not scored; shape (criteria, samples).
        weighting: sample weights.
    """
    result = []
    for i, criterion in enumerate(criteria):
        for weight in dict.fromkeys(bound.dataset.weight for bound in bounds) if criterion.weight > 0 else ():
            members = [
                _Member(b, e[i] / criterion.scale, _own(weighting, i, b))
                for b, e in zip(bounds, errors, strict=True)
                if b.dataset.weight == weight
            ]
            result += _split(i, criterion, weight, members)
    return [group for group in result if group.count]


class _Member:
    """Scaled residuals of one dataset, NaN if they do not count, and the sample weights."""

    def __init__(self, bound: BoundDataset, residual: Float, weights: Float) -> None:
        self.bound, self.weights = bound, weights
        self.residual = np.where(weights > 0, residual, np.nan)

    @property
    def persistence(self) -> tuple[float, int]:
        """Persistence of the errors of a recording and number of known samples; (1, 0) for steady-state points."""
        if self.bound.dataset.time is None:
            return 1.0, 0
        return persistence(self.residual * np.sqrt(self.weights), self.bound.starts)


def _own(weighting: SampleWeights, criterion: int, bound: BoundDataset) -> Float:
    name = weighting.inputs.get(criterion)
    return np.ones(bound.count) if name is None else weighting.columns(bound)[name]


def _split(number: int, criterion: Criterion, weight: float, members: Sequence[_Member]) -> list[Group]:
    whole = np.concatenate([member.residual for member in members])
    own = np.concatenate([member.weights for member in members])
    known = np.isfinite(whole)
    whole, own = whole[known], own[known]
    length = _mean([member.persistence for member in members])
    result = []
    for above, most in classes(own):
        here = (own > above) & (own <= most)
        r, w = whole[here], own[here]
        ratios, slopes = _influence(r, criterion)
        total = float(w.sum()) or 1.0
        result.append(
            Group(
                criterion=number,
                score=criterion.weight * weight,
                count=r.size,
                squares=float(w @ (r * ratios) ** 2),
                weight=float(w @ ratios) / total if r.size else 1.0,
                slope=max(float(w @ slopes) / total, 1e-3) if r.size else 1.0,
                persistence=length,
                typical=total / max(r.size, 1),
                above=above,
                most=most,
            )
        )
    return result


def classes(weights: Float) -> list[tuple[float, float]]:
    """Return ranges (above, most) of sample weights: one for each weight, or with similar numbers of samples.

    >>> classes(np.array([1.0, 1.0, 4.0, 4.0]))
    [(0.0, 1.0), (1.0, inf)]
    >>> classes(np.array([1.0, 1.1, 1.2]))
    [(0.0, inf)]
    """
    if not weights.size or weights.max() <= MAX_WEIGHT_RATIO * weights.min():
        return [(0.0, float("inf"))]
    edges = np.unique(weights)
    if edges.size > MAX_CLASSES:
        edges = np.unique(np.quantile(weights, np.arange(1, MAX_CLASSES) / MAX_CLASSES, method="lower"))
    inner = edges[edges < weights.max()].tolist()
    return list(pairwise([0.0, *inner, float("inf")]))


def variances(groups: Sequence[Group], used: Sequence[float]) -> list[float]:
    """Return the variance of psi at weight 1 in each group.

    A group with too few samples has that of its criterion, for a variance inversely proportional to the weight; NaN if
    the criterion has too few samples as well.

    Args:
        groups: the groups.
        used: degrees of freedom that the fit used in each.
    """
    pairs = list(zip(groups, used, strict=True))
    result = []
    for group, effective in pairs:
        members = [(g, e) for g, e in pairs if g.criterion == group.criterion]
        own, total = group.count - effective, sum(g.count - e for g, e in members)
        if own >= (MIN_GROUP_FREEDOM if len(members) > 1 else MIN_FREEDOM):
            result.append(group.squares / own)
        elif total >= MIN_FREEDOM:
            result.append(sum(g.score * g.squares for g, _ in members) / total / group.score)
        else:
            result.append(float("nan"))
    return result


def _influence(r: Float, criterion: Criterion) -> tuple[Float, Float]:
    """Return psi / r and psi' of each residual."""
    delta = criterion.delta
    match criterion.loss:
        case "square":
            return np.ones(r.size), np.ones(r.size)
        case "huber":
            inside = np.abs(r) <= delta
            return np.where(inside, 1.0, delta / np.maximum(np.abs(r), delta)), inside.astype(np.float64)
        case "soft_l1":
            root = np.sqrt(1 + (r / delta) ** 2)
            return 1 / root, root**-3
        case "excess":
            above = (r > 0).astype(np.float64)
            return above, above


def _mean(persistences: Sequence[tuple[float, int]]) -> float:
    total = sum(count for _, count in persistences)
    return sum(length * count for length, count in persistences) / total if total else 1.0


def rescored(compiled: CompiledProblem, factors: Mapping[Group, float]) -> Samples:
    """Return the samples of some groups with weights multiplied by a factor; all other weights are 0."""
    samples = _with_weights(compiled, factors)
    own = compiled.weighting.inputs
    scores = {(g.criterion, g.score): g.score * (1.0 if g.criterion in own else f) for g, f in factors.items()}
    samples.pieces = tuple(
        replace(piece, scores=np.array([scores.get((c, float(s)), 0.0) for c, s in enumerate(piece.scores)]))
        for piece in samples.pieces
    )
    return samples


def _with_weights(compiled: CompiledProblem, factors: Mapping[Group, float]) -> Samples:
    """Return the samples with their own weights replaced, if they have any."""
    samples = copy(compiled.samples)
    rows = list(samples.inputs.parts)
    for criterion, name in compiled.weighting.inputs.items():
        mine = [(group, factor) for group, factor in factors.items() if group.criterion == criterion]
        rows[compiled.kernel.layout.inputs[name]] = [
            _scaled(compiled.problem.criteria[criterion], bound, compiled.weighting.columns(bound)[name], mine)
            for bound in compiled.problem.gathered
        ]
    samples.inputs = ColumnTable(rows, samples.inputs.count)
    samples.data = samples.inputs.headed(samples.order)
    return samples


def _scaled(criterion: Criterion, bound: BoundDataset, weights: Float, factors: Sequence[tuple[Group, float]]) -> Float:
    score = criterion.weight * bound.dataset.weight
    result = np.zeros(weights.size)
    for group, factor in factors:
        if group.score == score:
            result += np.where(group.contains(weights), factor * weights, 0.0)
    return result
