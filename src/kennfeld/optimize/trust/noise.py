"""Estimation of the measurement noise from the residuals of a fit.

Samples of one criterion in datasets of one weight, with similar sample weights, form a group with its own sigma: the
variance of a sample of weight w is sigma^2 / w, and sigma^2 is the sum of w r^2 divided by its degrees of freedom. The
result is therefore correct both if weights state the quality of the data and if they merely state their importance. The
weight and the scale of a criterion do not affect its noise. Samples of weight 0 do not count.

With robust losses, the moments of psi, half the slope of the loss, replace those of the residual (P. J. Huber: Robust
Regression, Annals of Statistics 1, 1973): the variance of a value is E[psi^2] / E[psi']^2 times that for unit noise.
The loss is applied before the weight, so each group has its own moments as well.
"""

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

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

Ranges = dict[tuple[int, float], list[tuple[float, float]]]  # of the weights of samples: above, up to


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
        return (weights > self.above) & (weights <= self.most)


def groups(
    criteria: Sequence[Criterion],
    bounds: Sequence[BoundDataset],
    errors: Sequence[Float],
    weighting: SampleWeights,
    ranges: Ranges | None = None,
) -> list[Group]:
    """Return the groups of the training data.

    Args:
        criteria: the criteria.
        bounds: the training data.
        errors: model minus target for each dataset, NaN if not scored; shape (criteria, samples).
        weighting: sample weights.
        ranges: those of the weights of samples, by criterion and weight of the dataset; by default those of these data.
    """
    result: list[Group] = []
    for i, criterion in enumerate(criteria):
        members: dict[float, list[_Member]] = {}  # by the weight of the dataset
        for bound, error in zip(bounds, errors, strict=True) if criterion.weight > 0 else ():
            name = weighting.inputs.get(i)
            weights = np.ones(bound.count) if name is None else weighting.columns(bound)[name]
            residual = np.where(weights > 0, error[i] / criterion.scale, np.nan)
            steady = bound.dataset.time is None
            length = (1.0, 0) if steady else persistence(residual * np.sqrt(weights), bound.starts)
            members.setdefault(bound.dataset.weight, []).append(_Member(residual, weights, length))
        for weight, datasets in members.items():
            result += _split(i, criterion, weight, datasets, (ranges or {}).get((i, criterion.weight * weight)))
    return result


def ranges_of(groups: Sequence[Group]) -> Ranges:
    """Return the ranges of the weights of samples in each group, by criterion and weight of the dataset."""
    ranges: Ranges = {}
    for group in groups:
        ranges.setdefault((group.criterion, group.score), []).append((group.above, group.most))
    return {key: [*pairwise([0.0, *(most for _, most in own[:-1]), float("inf")])] for key, own in ranges.items()}


def merge_groups(parts: Iterable[Sequence[Group]]) -> list[Group]:
    """Return the groups of all data from those of its parts, which have the same ranges of weights."""
    merged: dict[tuple[int, float, float, float], Group] = {}
    for group in (group for part in parts for group in part):
        key = group.criterion, group.score, group.above, group.most
        merged[key] = group if key not in merged else _merge(merged[key], group)
    return [merged[key] for key in sorted(merged, key=lambda key: key[:1])]


def _merge(first: Group, second: Group) -> Group:
    count, pair = first.count + second.count, (first, second)
    total = sum(g.typical * g.count for g in pair)
    return replace(
        first,
        count=count,
        squares=first.squares + second.squares,
        weight=sum(g.weight * g.typical * g.count for g in pair) / total,
        slope=sum(g.slope * g.typical * g.count for g in pair) / total,
        persistence=sum(g.persistence * g.count for g in pair) / count,
        typical=total / count,
    )


class _Member(NamedTuple):
    residual: Float  # of one dataset, in units of the scale of the criterion; NaN if it does not count
    weights: Float  # of the samples
    persistence: tuple[float, int]  # and the number of known samples; (1, 0) for steady-state points


def _split(
    number: int,
    criterion: Criterion,
    weight: float,
    members: Sequence[_Member],
    ranges: Sequence[tuple[float, float]] | None,
) -> list[Group]:
    whole = np.concatenate([member.residual for member in members])
    own = np.concatenate([member.weights for member in members])
    known = np.isfinite(whole)
    whole, own = whole[known], own[known]
    length = _mean((member.persistence for member in members), 1.0)
    result = []
    for above, most in classes(own) if ranges is None else ranges:
        inside = (own > above) & (own <= most)
        r, w = whole[inside], own[inside]
        if not r.size:
            continue
        ratios, slopes = _influence(r, criterion)
        total = float(w.sum())
        result.append(
            Group(
                criterion=number,
                score=criterion.weight * weight,
                count=r.size,
                squares=float(w @ (r * ratios) ** 2),
                weight=float(w @ ratios) / total,
                slope=max(float(w @ slopes) / total, 1e-3),
                persistence=length,
                typical=total / r.size,
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


def noise_of_criteria(
    criteria: Sequence[Criterion], groups: Sequence[Group], variances: Sequence[float]
) -> dict[str, float]:
    """Return the standard deviation of the noise of each criterion in the unit of its target, over all its groups."""
    numbers = [v / g.slope**2 / g.typical for g, v in zip(groups, variances, strict=True)]
    means = _means(criteria, groups, numbers, float("nan"))
    return _by_criterion(criteria, [c.scale * float(np.sqrt(mean)) for c, mean in zip(criteria, means, strict=True)])


def persistence_of_criteria(criteria: Sequence[Criterion], groups: Sequence[Group]) -> dict[str, float]:
    """Return the persistence of the errors of each criterion, over all its groups."""
    return _by_criterion(criteria, _means(criteria, groups, [group.persistence for group in groups], 1.0))


def _by_criterion(criteria: Sequence[Criterion], numbers: Sequence[float]) -> dict[str, float]:
    """Key numbers by the node of the criterion, with its target if several criteria have the same node."""
    nodes = [criterion.node for criterion in criteria]
    names = [c.node if nodes.count(c.node) == 1 else f"{c.node} against {c.target}" for c in criteria]
    return dict(zip(names, numbers, strict=True))


def _means(
    criteria: Sequence[Criterion], groups: Sequence[Group], numbers: Sequence[float], empty: float
) -> list[float]:
    """Return the mean over the samples of each criterion."""
    pairs = [(group.criterion, number, group.count) for group, number in zip(groups, numbers, strict=True)]
    return [_mean(((x, n) for c, x, n in pairs if c == i), empty) for i in range(len(criteria))]


def _mean(pairs: Iterable[tuple[float, int]], empty: float) -> float:
    """Return the mean of numbers with their counts."""
    counted = [*pairs]
    total = sum(count for _, count in counted)
    return sum(number * count for number, count in counted) / total if total else empty


def rescore(compiled: CompiledProblem, factors: Mapping[Group, float]) -> Samples:
    """Return the samples of some groups with weights multiplied by a factor; all other weights are 0.

    The factor goes into the samples' own weights, if they have any, else into the weights of their piece.
    """
    samples, weighting = copy(compiled.samples), compiled.weighting
    rows = list(samples.inputs.parts)
    for number, name in weighting.inputs.items():
        own = [(group, factor) for group, factor in factors.items() if group.criterion == number]
        row = compiled.kernel.layout.inputs[name]
        rows[row] = [_scale_weights(samples, np.concatenate(rows[row]), number, own)]
    samples.inputs = ColumnTable(rows, samples.inputs.count)
    samples.data = samples.inputs.headed(samples.order)
    scores = {
        (g.criterion, g.score): g.score * (1.0 if g.criterion in weighting.inputs else factor)
        for g, factor in factors.items()
    }
    samples.pieces = tuple(
        replace(piece, scores=np.array([scores.get((c, float(s)), 0.0) for c, s in enumerate(piece.scores)]))
        for piece in samples.pieces
    )
    return samples


def _scale_weights(samples: Samples, weights: Float, number: int, factors: Sequence[tuple[Group, float]]) -> Float:
    """Return the weights of all samples for a criterion, each multiplied by the factor of its group."""
    scores = np.zeros(weights.size)
    for piece in samples.pieces:
        visits = slice(piece.first, piece.last)
        scores[visits if samples.order is None else samples.order[visits]] = piece.scores[number]
    result = np.zeros(weights.size)
    for group, factor in factors:
        result += np.where((scores == group.score) & group.contains(weights), factor * weights, 0.0)
    return result
