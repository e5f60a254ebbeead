"""How much the measurements scatter about the fitted model.

A weight is read as a statement on how good a sample is: its variance is sigma^2 / w, and sigma^2 is the sum of
w r^2 over its degrees of freedom. Whether that is so is not taken on trust. Samples of one criterion in datasets of one
weight, and of about the same weight of their own, form a group, and each group has a sigma of its own. So the result is
right where weights say how good data are, and where they merely say how much data matter. Each criterion has groups of
its own, so that neither its weight nor its scale says anything about its noise. A sample of weight 0 is no sample.

Under robust losses the moments of psi, half the slope of the loss, take the place of those of the residual (P. J.
Huber: Robust Regression, Annals of Statistics 1, 1973): a value's variance is E[psi^2] / E[psi']^2 times that of a unit
noise. The loss judges a residual before its weight, so each group has moments of its own as well.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.criteria import Criterion
from kennfeld.native import Samples
from kennfeld.native.column_table import ColumnTable
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.trust.persistence import persistence
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.sample_weights import SampleWeights

__all__ = ["Group", "groups", "rescored", "variances"]

LEAST = 1.0  # degrees of freedom from which a noise can be told
ENOUGH = 10.0  # the same for one group of several: with fewer, its criterion speaks for it
CLASSES = 8  # of samples by their own weight
EVEN = 1.5  # ratio of the largest weight to the smallest up to which weights are about the same


@dataclass(frozen=True)
class Group:
    """The residuals of one criterion over the datasets of one weight, in units of the criterion's scale.

    Of samples with weights of their own, those above `above` up to `most`.
    """

    criterion: int
    score: float  # weight of criterion times weight of dataset
    count: int
    squares: float  # sum of w psi^2, w the weight of the sample
    weight: float  # mean of psi / residual, what the matrix of the fit was weighted with
    slope: float  # mean of psi'
    persistence: float  # samples for each one that is independent of those before
    typical: float = 1.0  # mean w
    above: float = 0.0
    most: float = float("inf")

    def left(self, effective: float) -> float:
        """Degrees of freedom after a fit that used up so many of them."""
        return self.count - effective

    def holds(self, weights: Float) -> Bool:
        """Which samples are of this group, by their own weight."""
        found: Bool = (weights > self.above) & (weights <= self.most)
        return found


def groups(
    criteria: Sequence[Criterion], bounds: Sequence[BoundDataset], errors: Sequence[Float], weighting: SampleWeights
) -> list[Group]:
    """The groups of the training data; `errors` are model minus target, (criteria, samples), NaN where not scored."""
    found = []
    for i, criterion in enumerate(criteria):
        for weight in dict.fromkeys(bound.dataset.weight for bound in bounds) if criterion.weight > 0 else ():
            members = [
                _Member(b, e[i] / criterion.scale, _own(weighting, i, b))
                for b, e in zip(bounds, errors, strict=True)
                if b.dataset.weight == weight
            ]
            found += _split(i, criterion, weight, members)
    return [group for group in found if group.count]


class _Member:
    """The scaled residuals of one dataset, NaN where they do not count, and the samples' own weights."""

    def __init__(self, bound: BoundDataset, residual: Float, weights: Float) -> None:
        self.bound, self.weights = bound, weights
        self.residual = np.where(weights > 0, residual, np.nan)

    @property
    def lasting(self) -> tuple[float, int]:
        """How long the errors of a recording last, and how many are known; none of steady-state points."""
        if self.bound.dataset.time is None:
            return 1.0, 0
        return persistence(self.residual * np.sqrt(self.weights), self.bound.starts)


def _own(weighting: SampleWeights, criterion: int, bound: BoundDataset) -> Float:
    """The weight that each sample has of its own."""
    name = weighting.inputs.get(criterion)
    return np.ones(bound.count) if name is None else weighting.columns(bound)[name]


def _split(number: int, criterion: Criterion, weight: float, members: Sequence[_Member]) -> list[Group]:
    """The groups of one criterion in datasets of one weight."""
    whole = np.concatenate([member.residual for member in members])
    own = np.concatenate([member.weights for member in members])
    known = np.isfinite(whole)
    whole, own = whole[known], own[known]
    lasting = _mean([member.lasting for member in members])
    found = []
    for above, most in classes(own):
        here = (own > above) & (own <= most)
        r, w = whole[here], own[here]
        ratios, slopes = _influence(r, criterion)
        total = float(w.sum()) or 1.0
        found.append(
            Group(
                criterion=number,
                score=criterion.weight * weight,
                count=r.size,
                squares=float(w @ (r * ratios) ** 2),
                weight=float(w @ ratios) / total if r.size else 1.0,
                slope=max(float(w @ slopes) / total, 1e-3) if r.size else 1.0,
                persistence=lasting,
                typical=total / max(r.size, 1),
                above=above,
                most=most,
            )
        )
    return found


def classes(weights: Float) -> list[tuple[float, float]]:
    """Ranges of samples' weights, above the first number up to the second: of each weight, or of about as many samples.

    >>> classes(np.array([1.0, 1.0, 4.0, 4.0]))
    [(0.0, 1.0), (1.0, inf)]
    >>> classes(np.array([1.0, 1.1, 1.2]))
    [(0.0, inf)]
    """
    if not weights.size or weights.max() <= EVEN * weights.min():
        return [(0.0, float("inf"))]
    edges = np.unique(weights)
    if edges.size > CLASSES:
        edges = np.unique(np.quantile(weights, np.arange(1, CLASSES) / CLASSES, method="lower"))
    inner = edges[edges < weights.max()].tolist()
    return list(pairwise([0.0, *inner, float("inf")]))


def variances(found: Sequence[Group], effective: Sequence[float]) -> list[float]:
    """The variance of psi at weight 1 in each group, after a fit that used so many degrees of freedom in each.

    Where a group has too few samples of its own it is that of its criterion, for a variance that falls with the weight;
    NaN where that has none to spare either.
    """
    pairs = list(zip(found, effective, strict=True))
    made = []
    for group, used in pairs:
        members = [(g, e) for g, e in pairs if g.criterion == group.criterion]
        own = group.left(used)
        left = sum(g.left(e) for g, e in members)
        if own >= (ENOUGH if len(members) > 1 else LEAST):
            made.append(group.squares / own)
        elif left >= LEAST:
            made.append(sum(g.score * g.squares for g, _ in members) / left / group.score)
        else:
            made.append(float("nan"))
    return made


def _influence(r: Float, criterion: Criterion) -> tuple[Float, Float]:
    """Psi / r and psi' of each residual."""
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


def _mean(lasting: Sequence[tuple[float, int]]) -> float:
    total = sum(count for _, count in lasting)
    return sum(length * count for length, count in lasting) / total if total else 1.0


def rescored(compiled: CompiledProblem, factors: Mapping[Group, float]) -> Samples:
    """The samples of some groups, with their weights times a factor; the others count nothing."""
    samples = _with_weights(compiled, factors)
    own = compiled.weighting.inputs
    scores = {(g.criterion, g.score): g.score * (1.0 if g.criterion in own else f) for g, f in factors.items()}
    samples.pieces = tuple(
        replace(piece, scores=np.array([scores.get((c, float(s)), 0.0) for c, s in enumerate(piece.scores)]))
        for piece in samples.pieces
    )
    return samples


def _with_weights(compiled: CompiledProblem, factors: Mapping[Group, float]) -> Samples:
    """The samples with other weights of their own, where they have any."""
    made = copy(compiled.samples)
    rows = list(made.inputs.parts)
    for criterion, name in compiled.weighting.inputs.items():
        mine = [(group, factor) for group, factor in factors.items() if group.criterion == criterion]
        rows[compiled.kernel.layout.inputs[name]] = [
            _scaled(compiled.problem.criteria[criterion], bound, compiled.weighting.columns(bound)[name], mine)
            for bound in compiled.problem.gathered
        ]
    made.inputs = ColumnTable(rows, made.inputs.count)
    made.data = made.inputs.headed(made.order)
    return made


def _scaled(criterion: Criterion, bound: BoundDataset, weights: Float, factors: Sequence[tuple[Group, float]]) -> Float:
    score = criterion.weight * bound.dataset.weight
    found = np.zeros(weights.size)
    for group, factor in factors:
        if group.score == score:
            found += np.where(group.holds(weights), factor * weights, 0.0)
    return found
