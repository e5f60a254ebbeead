"""Estimation of the measurement noise from the residuals of a fit.

Samples of one criterion in datasets of one weight, with similar sample weights, form a group with its own variance v:
that of a sample of weight w is v w^-g, and v is the sum of w^g r^2 divided by its degrees of freedom. The power g is
that of the whole criterion, see `variance_power`. The result is therefore correct both if weights state the quality of
the data and if they merely state their importance. The weight and the scale of a criterion do not affect its noise.
Samples of weight 0 do not count.

With robust losses, the moments of psi, half the slope of the loss, replace those of the residual (P. J. Huber: Robust
Regression, Annals of Statistics 1, 1973): the variance of a value is E[psi^2] / E[psi']^2 times that for unit noise.
The loss is applied before the weight, so each group has its own moments as well.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.sample_statistics import Moments, gather
from kennfeld.domain.criteria import Criterion
from kennfeld.native.column_table import ColumnTable
from kennfeld.native.losses import LOSS_RULES
from kennfeld.native.samples import Samples
from kennfeld.optimize.problem.partitions import dataset_numbers
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.trust.persistence import MIN_SAMPLES, Correlation, LaggedProducts, persistence_lags
from kennfeld.optimize.trust.variance_power import EXPONENTS, Variance, likely_exponent, sum_squares
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.bound_parts import BoundPart
from kennfeld.preprocessing.sample_weights import SampleWeights

MIN_FREEDOM = 1.0  # residual degrees of freedom for an estimate of the noise
MIN_GROUP_FREEDOM = 10.0  # the same for one of several groups; with fewer, the noise is that of the criterion
MAX_CLASSES = 8  # of samples by their own weight
MAX_WEIGHT_RATIO = 1.5  # of the largest to the smallest weight in one class
VARYING = 0.01  # half the variance of the logarithms of weights that are not about equal

Range = tuple[float, float]  # of sample weights: above the first, up to the second
ANY: Range = (0.0, float("inf"))


@dataclass(frozen=True)
class Group:
    """The residuals of one criterion in the datasets of one weight, in units of the scale of the criterion.

    Of samples with weights of their own, the group has those with above < weight <= most.
    """

    criterion: int
    score: float  # weight of criterion times weight of dataset
    count: int
    squares_by_exponent: tuple[float, ...]  # sum of w^g psi^2, w the weight of the sample; see `variance_power`
    weight: float  # mean of psi / residual, the weight in the matrix of the fit
    slope: float  # mean of psi'
    persistence: float  # samples for each one that is independent of those before
    correlation: Correlation = field(default_factory=Correlation)  # mean over the datasets
    typical: float = 1.0  # mean w
    logarithm: float = 0.0  # mean log w
    above: float = 0.0
    most: float = float("inf")

    @property
    def varies(self) -> bool:
        """True if the weights of the samples are not about equal: their mean is not their geometric mean."""
        return bool(np.log(self.typical) - self.logarithm > VARYING)

    @property
    def squares(self) -> float:
        """Sum of w psi^2."""
        return self.squares_by_exponent[-1]

    def contains(self, weights: Float) -> Bool:
        """Mark the weights of samples, Float[samples], that are in this group, Bool[samples]."""
        return (weights > self.above) & (weights <= self.most)


Classes = Mapping[float, Sequence[Sequence[Range]]]  # by the weight of the dataset and the criterion
Errors = Callable[[BoundDataset], Float]


def groups(
    problem: Problem,
    errors: Errors,
    weighting: SampleWeights,
    partial_sums: Callable[[Classes], Iterable["GroupSums"]] | None = None,
) -> list[Group]:
    """Group the residuals of the training data.

    Args:
        problem: criteria and training data.
        errors: returns model minus target over a part of a dataset, NaN if not scored; shape (criteria, samples).
        weighting: sample weights.
        partial_sums: yields the sums of each partition of the training data; classes are then those of the excerpts.
    """
    residuals = _Residuals(problem, errors, weighting)
    surveys = residuals.survey_all()
    own = residuals.classes(surveys)
    sums = GroupSums()
    for part in [residuals.sum_all(surveys, own)] if partial_sums is None else partial_sums(own):
        sums.merge(part)
    return [
        group
        for position, number in enumerate(residuals.numbers)
        for weight, total in sums.by_weight.items()
        for group in total.rows[position].groups(number, problem.criteria[number], weight)
    ]


def sum_groups(problem: Problem, errors: Errors, weighting: SampleWeights, classes: Classes) -> "GroupSums":
    """Sum over the training data of one partition, in the classes of all data; see `groups`."""
    residuals = _Residuals(problem, errors, weighting)
    return residuals.sum_all(residuals.survey_all(), classes)


class _Residuals:
    """Residuals of the scored criteria over parts of the training data, in units of the scale of the criterion."""

    def __init__(self, problem: Problem, errors: Errors, weighting: SampleWeights) -> None:
        self._problem, self._criteria, self._errors, self._weighting = problem, problem.criteria, errors, weighting
        self.numbers = [i for i, criterion in enumerate(problem.criteria) if criterion.weight > 0]

    def survey_all(self) -> list["_Survey"]:
        """Return the survey of each dataset; of steady-state points with equal weights, `sum` needs none."""
        return [
            _Survey([_Weighted.unknown() for _ in self.numbers])
            if bound.dataset.time is None and not self._weighting.inputs
            else gather(self.survey, self._problem.parts(bound))
            for bound in self._problem.training
        ]

    def classes(self, surveys: Sequence["_Survey"]) -> Classes:
        """Return the classes of weights, by the weight of the dataset and the criterion."""
        same: dict[float, list[_Survey]] = {}
        for bound, survey in zip(self._problem.training, surveys, strict=True):
            same.setdefault(bound.dataset.weight, []).append(survey)
        return {
            weight: [classes(*_join(rows)) for rows in zip(*(survey.rows for survey in own), strict=True)]
            for weight, own in same.items()
        }

    def sum_all(self, surveys: Sequence["_Survey"], classes: Classes) -> "GroupSums":
        """Return the sums over all datasets."""
        sums, datasets = GroupSums(), self._problem.datasets
        fitted = [n for n, data in zip(dataset_numbers(datasets), datasets, strict=True) if data.is_fitted]
        for number, bound, survey in zip(fitted, self._problem.training, surveys, strict=True):
            weight = bound.dataset.weight
            work = partial(self.sum, survey=survey, classes=classes[weight], whole=bound, number=number)
            sums.add(weight, gather(work, self._problem.parts(bound)))
        return sums

    def _over(self, bound: BoundDataset) -> Iterator[tuple[Float, Float]]:
        """Yield residuals, NaN if they do not count, and weights of each criterion, Float[samples] each."""
        errors, columns = self._errors(bound), self._weighting.columns(bound)
        for i in self.numbers:
            name = self._weighting.inputs.get(i)
            weights = np.ones(bound.count) if name is None else columns[name]
            # NaN, like samples without a target: those of weight 0 are not of the fit either
            yield np.where(weights > 0, errors[i] / self._criteria[i].scale, np.nan), weights

    def survey(self, part: BoundPart) -> "_Survey":
        """Return the means and the weights over a part."""
        return _Survey([_Weighted.of(residual, weights) for residual, weights in self._over(part.bound)])

    def sum(
        self, part: BoundPart, survey: "_Survey", classes: Sequence[Sequence[Range]], whole: BoundDataset, number: int
    ) -> "_DatasetSums":
        """Return the sums over a part of dataset `number`, by class of weights."""
        bound, rows = part.bound, []
        lags = 0 if whole.dataset.time is None else persistence_lags(whole.starts, whole.count)
        for (residual, weights), known, own, i in zip(
            self._over(bound), survey.rows, classes, self.numbers, strict=True
        ):
            products = {}
            if lags:
                # any mean near that of all parts keeps digits; `LaggedProducts.centred` takes the mean of all
                errors, mean = residual * np.sqrt(weights), known.residuals.mean
                products[number] = LaggedProducts.of(errors, bound.starts, mean, lags)
            kept = np.isfinite(residual)
            r, w = residual[kept], weights[kept]
            sums = {each: _ClassSums.of(r, w, each, self._criteria[i]) for each in own}
            rows.append(_NoiseSums(sums, products))
        return _DatasetSums(rows)


@dataclass
class _Weighted:
    """The moments of weighted residuals of one criterion, and how often each sample weight occurs."""

    residuals: Moments
    weights: Float
    counts: Int

    @classmethod
    def of(cls, residual: Float, weights: Float) -> "_Weighted":
        known = np.isfinite(residual)
        own = weights[known]
        return cls(Moments.of(residual[known] * np.sqrt(own)), *np.unique(own, return_counts=True))

    @classmethod
    def unknown(cls) -> "_Weighted":
        """Return residuals that were not looked at, of samples with equal weights."""
        return cls(Moments(), np.ones(1), np.ones(1, dtype=np.int64))

    def merge(self, later: "_Weighted") -> None:
        self.residuals.merge(later.residuals)
        self.weights, self.counts = _join([self, later])


def _join(rows: Sequence[_Weighted]) -> tuple[Float, Int]:
    """Return the weights of all rows in rising order, and their counts."""
    weights, place = np.unique(np.concatenate([row.weights for row in rows]), return_inverse=True)
    counts = np.zeros(weights.size, dtype=np.int64)
    np.add.at(counts, place, np.concatenate([row.counts for row in rows]))
    return weights, counts


@dataclass
class _Survey:
    rows: list[_Weighted]  # of each criterion

    def merge(self, later: "_Survey") -> None:
        for own, other in zip(self.rows, later.rows, strict=True):
            own.merge(other)


@dataclass
class _ClassSums:
    """Sums over the samples of one class of weights."""

    count: int
    squares: Float  # Float[exponents]
    ratios: float
    slopes: float
    weights: float
    logarithms: float

    @classmethod
    def of(cls, r: Float, w: Float, inside: Range, criterion: Criterion) -> "_ClassSums":
        if inside != ANY:
            chosen = (w > inside[0]) & (w <= inside[1])
            r, w = r[chosen], w[chosen]
        ratios, slopes = LOSS_RULES[criterion.loss].influence(r, criterion.delta)
        sums = float(w @ ratios), float(w @ slopes), float(w.sum()), float(np.log(w).sum())
        return cls(r.size, sum_squares(r * ratios, w), *sums)

    def merge(self, later: "_ClassSums") -> None:
        for name, value in vars(later).items():
            setattr(self, name, getattr(self, name) + value)


@dataclass
class _NoiseSums:
    """The sums of one criterion by class, and the correlation of each dataset with its number of samples.

    The products of a dataset are kept until all of its parts are in, which may be in several partitions.
    """

    classes: dict[Range, _ClassSums]
    products: dict[int, LaggedProducts]  # by the number of the dataset
    lengths: list[tuple[Correlation, int]] = field(default_factory=list)

    def merge(self, later: "_NoiseSums") -> None:
        for inside, sums in later.classes.items():
            self.classes[inside].merge(sums)
        self.lengths += later.lengths
        # parts come in the order of the datasets: what the later one does not go on with is complete
        self._close(self.products.keys() - later.products.keys() if later.products else ())
        for number, products in later.products.items():
            if number in self.products:
                self.products[number].merge(products)
            else:
                self.products[number] = products

    def _close(self, numbers: Iterable[int]) -> None:
        """Replace the products of datasets, whose parts are all in, by their correlation."""
        for number in sorted(numbers):
            products = self.products.pop(number).centred
            correlation = Correlation()
            if products.count >= MIN_SAMPLES:
                correlation = Correlation.of(products.sums, products.pairs)
            self.lengths.append((correlation, products.count))

    def groups(self, number: int, criterion: Criterion, weight: float) -> Iterator[Group]:
        self._close([*self.products])
        length = _mean(((each.inflation(count), count) for each, count in self.lengths if count), 1.0)
        plain, window = (_mean(((x, n) for x, n in pairs), 1.0) for pairs in _columns(self.lengths))
        for (above, most), sums in self.classes.items():
            if sums.count:
                yield Group(
                    criterion=number,
                    score=criterion.weight * weight,
                    count=sums.count,
                    squares_by_exponent=tuple(sums.squares.tolist()),
                    weight=sums.ratios / sums.weights,
                    # if all residuals are beyond delta, psi' is 0 and no slope is left to divide by
                    slope=max(sums.slopes / sums.weights, 1e-3),
                    persistence=length,
                    correlation=Correlation(plain, window),
                    typical=sums.weights / sums.count,
                    logarithm=sums.logarithms / sums.count,
                    above=above,
                    most=most,
                )


def _columns(lengths: Sequence[tuple[Correlation, int]]) -> tuple[list[tuple[float, int]], list[tuple[float, int]]]:
    return [(each.plain, count) for each, count in lengths], [(each.window, count) for each, count in lengths]


@dataclass
class _DatasetSums:
    rows: list[_NoiseSums]  # of each criterion

    def merge(self, later: "_DatasetSums") -> None:
        for own, other in zip(self.rows, later.rows, strict=True):
            own.merge(other)


@dataclass
class GroupSums:
    """The sums over datasets, by their weight."""

    by_weight: dict[float, _DatasetSums] = field(default_factory=dict)

    def add(self, weight: float, sums: _DatasetSums) -> None:
        """Take in the sums over datasets of one weight."""
        if weight in self.by_weight:
            self.by_weight[weight].merge(sums)
        else:
            self.by_weight[weight] = sums

    def merge(self, later: "GroupSums") -> None:
        """Take in the sums over other datasets."""
        for weight, sums in later.by_weight.items():
            self.add(weight, sums)


def classes(weights: Float, counts: Int | None = None) -> list[Range]:
    """Divide sample weights into ranges (above, most): one for each weight, or with similar numbers of samples.

    `weights` are Float[weights]; `counts`, Int[weights], says how often each of them occurs, which then rise.

    >>> classes(np.array([1.0, 4.0]), np.array([2, 2]))
    [(0.0, 1.0), (1.0, inf)]
    >>> classes(np.array([1.0, 1.1, 1.2]))
    [(0.0, inf)]
    """
    if counts is None:
        weights, counts = np.unique(weights, return_counts=True)
    if not weights.size or weights[-1] <= MAX_WEIGHT_RATIO * weights[0]:
        return [ANY]
    edges, ends = weights, np.cumsum(counts)
    if edges.size > MAX_CLASSES:
        # edges at quantiles of the samples, of which the last is left to the class without an upper end
        ranks = np.floor(np.arange(1, MAX_CLASSES) / MAX_CLASSES * (ends[-1] - 1)).astype(np.int64)
        edges = np.unique(weights[np.searchsorted(ends, ranks, side="right")])
    inner = edges[edges < weights[-1]].tolist()
    return list(pairwise([0.0, *inner, float("inf")]))


def variances(groups: Sequence[Group], used: Sequence[float]) -> list[Variance]:
    """Estimate the variance of psi in each group, in units of the squared scale of its criterion.

    A group with too few samples has that of its criterion; NaN if the criterion has too few samples as well.

    Args:
        groups: the groups.
        used: degrees of freedom that the fit used in each.
    """
    # n - p degrees of freedom, with the p that the fit used among the samples of the group
    pairs = list(zip(groups, used, strict=True))
    result = []
    for group, effective in pairs:
        members = [(g, e) for g, e in pairs if g.criterion == group.criterion]
        own, total = group.count - effective, sum(g.count - e for g, e in members)
        number = _likely_exponent(members)
        exponent = EXPONENTS[number]
        if own >= (MIN_GROUP_FREEDOM if len(members) > 1 else MIN_FREEDOM):
            result.append(Variance(group.squares_by_exponent[number] / own, exponent))
        elif total >= MIN_FREEDOM:
            # the weight of a sample in the cost is w times the score
            squares = sum(g.score**exponent * g.squares_by_exponent[number] for g, _ in members)
            result.append(Variance(squares / total / group.score**exponent, exponent))
        else:
            result.append(Variance(float("nan")))
    return result


def _likely_exponent(members: Sequence[tuple[Group, float]]) -> int:
    """Return the number of the exponent of a criterion, from its groups and the degrees of freedom used in each."""
    # correlated errors say less on the exponent than as many independent ones
    independent = [max(group.count - used, 0.0) / group.persistence for group, used in members]
    pairs = list(zip((group for group, _ in members), independent, strict=True))
    # over groups whose weights are the products of score and sample weight
    squares = np.sum([np.power(g.score, EXPONENTS) * g.squares_by_exponent for g, _ in pairs], axis=0)
    return likely_exponent(squares, sum(n * (g.logarithm + np.log(g.score)) for g, n in pairs), sum(independent))


def noise_of_criteria(
    criteria: Sequence[Criterion], groups: Sequence[Group], variances: Sequence[Variance]
) -> dict[str, float]:
    """Compute the standard deviation of the noise of each criterion in the unit of its target, over all its groups."""
    numbers = [v.at(g.typical) / g.slope**2 for g, v in zip(groups, variances, strict=True)]
    means = _means(criteria, groups, numbers, float("nan"))
    return _by_criterion(criteria, [c.scale * float(np.sqrt(mean)) for c, mean in zip(criteria, means, strict=True)])


def persistence_of_criteria(criteria: Sequence[Criterion], groups: Sequence[Group]) -> dict[str, float]:
    """Average the persistence of the errors of each criterion, in samples, over all its groups."""
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


def rescore(
    compiled: CompiledProblem, factors: Mapping[Group, float], powers: Mapping[Group, float] | None = None
) -> Samples:
    """Give the samples of some groups other weights; all other weights are 0.

    The factor goes into the samples' own weights, if they have any, else into the weights of their piece.

    Args:
        compiled: the problem.
        factors: of the weights, by group.
        powers: to which samples' own weights are raised before, by group; 1 by default.
    """
    samples, weighting = copy(compiled.samples), compiled.weighting
    rows = list(samples.inputs.parts)
    for number, name in weighting.inputs.items():
        own = [
            (group, factor, (powers or {}).get(group, 1.0))
            for group, factor in factors.items()
            if group.criterion == number
        ]
        # weights of samples are an input of the kernel, as a row of their own
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


def _scale_weights(
    samples: Samples, weights: Float, number: int, factors: Sequence[tuple[Group, float, float]]
) -> Float:
    """Return the weights of all samples for a criterion, each with the factor and the power of its group."""
    scores = np.zeros(weights.size)
    for piece in samples.pieces:
        visits = slice(piece.first, piece.last)
        # the score of each sample tells the weight of its dataset
        scores[visits if samples.order is None else samples.order[visits]] = piece.scores[number]
    result = np.zeros(weights.size)
    for group, factor, power in factors:
        result += np.where((scores == group.score) & group.contains(weights), factor * weights**power, 0.0)
    return result
