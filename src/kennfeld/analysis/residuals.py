"""Residuals of a parameter set: absolute, relative and studentized, with summaries and the worst samples."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import field
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from kennfeld.analysis.autocorrelation import Autocorrelation, count_lags, of_products
from kennfeld.analysis.cell_errors import CellErrors, CellSums
from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.analysis.leverage import LookupWeights
from kennfeld.analysis.part_evaluation import (
    DatasetExtent,
    EvaluatedPart,
    PartEvaluator,
    PartExtent,
    PartPasses,
    PartPlace,
)
from kennfeld.analysis.residual_statistics import (
    MIDDLE,
    MOST,
    ErrorCounts,
    ErrorDetails,
    ErrorSearches,
    LargeError,
    LargeErrors,
    RareErrors,
    largest_places,
    relative_errors,
    scaled_errors,
)
from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.sample_statistics import Mergeable
from kennfeld.domain.dataset import Use
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.trust.persistence import LaggedProducts

_Row = TypeVar("_Row", bound=Mergeable)  # Python 3.11

Scaling = Literal["studentized", "standardised"]


@dataclass(frozen=True, eq=False)
class Errors:
    """The errors of a criterion on one dataset, model minus measurement; NaN if not scored.

    `relative` is the error over the size of the measurement, NaN if that is 0. `scaled` is the error over its
    standard deviation; see `Residuals.scaling`.
    """

    dataset: str
    use: Use
    absolute: Float = field(repr=False)  # Float[samples], in the unit of the target
    relative: Float = field(repr=False)  # Float[samples]
    scaled: Float = field(repr=False)  # Float[samples]


@dataclass(frozen=True)
class Summary:
    """Statistics of the errors of a criterion on one dataset, in the unit of the target; `mean` is their bias.

    `relative` is the median size of the relative errors. `beyond` is the share of scaled errors above 3 in size: 0.3 %
    for a normal distribution.
    """

    dataset: str
    use: Use
    samples: int
    mean: float
    deviation: float
    rmse: float
    r2: float
    median: float
    percentile_95: float
    largest: float
    relative: float
    beyond: float
    autocorrelation: Autocorrelation | None


@dataclass(frozen=True)
class WorstSample:
    """One sample with a large error. `sample` counts the dataset's samples from 0; `time` is in s."""

    dataset: str
    use: Use
    sample: int
    piece: int
    time: float | None
    measured: float
    model: float
    error: float
    relative: float
    scaled: float
    inputs: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of one criterion.

    Scaled errors are studentized if the leverage of each sample is known, else standardised by `deviation`, their
    standard deviation over the training data.
    """

    criterion: str
    target: str
    unit: str
    scaling: Scaling
    deviation: float
    errors: tuple[Errors, ...] = field(repr=False)
    summaries: tuple[Summary, ...]
    cells: tuple[CellErrors, ...] = field(repr=False)
    worst: tuple[WorstSample, ...] = field(repr=False)


def residuals(
    problem: Problem, parameters: ParameterSet, *, trust: Any = None, worst: int = 20
) -> tuple[Residuals, ...]:
    """Analyse the errors of a parameter set, one entry per criterion.

    An error is studentized, r / (s sqrt(1 - h)), if `trust.leverage` is known; h is the sample's leverage and
    s^2 = sum r^2 / (n - sum h) over the training samples. h = 0 for test data.

    Args:
        problem: function, data and criteria.
        parameters: the values to analyse.
        trust: the trust of a result; its `leverage` and `samples` by table are used if it has them.
        worst: number of the largest errors to list.

    Returns:
        The residuals of each criterion that has a scored sample; of data in partitions without `errors`.

    Source of the studentized residual: R. D. Cook, S. Weisberg: Residuals and Influence in Regression, 1982, ch. 2.

    >>> from kennfeld import Project, read_parameters
    >>> rows = residuals(Project.read("kennfeld.toml").problem(), read_parameters("start.dcm"))
    >>> [(row.criterion, row.summaries[0].samples) for row in rows]
    [('TorquePredict', 2812), ('dragTorque', 27)]
    """
    keep = problem.partitions is None
    return analyse(problem, parameters, parameters, trust=trust, worst=worst, keep=keep).residuals


@dataclass(frozen=True, eq=False)
class Fit:
    """The errors of one criterion on one dataset before and after a calibration; `number` is that of the criterion."""

    number: int
    data: DatasetExtent
    counts: ErrorCounts
    details: ErrorDetails

    @property
    def samples(self) -> int:
        """Number of scored samples."""
        return self.counts.target.count


@dataclass(frozen=True, eq=False)
class Analysis:
    """The errors of all criteria, without the samples themselves; see `residuals`."""

    residuals: tuple[Residuals, ...]
    fits: tuple[Fit, ...]  # dataset by dataset
    touching: Mapping[str, Int]  # training samples by grid point, of tables of which the trust does not tell them


def analyse(
    problem: Problem,
    before: ParameterSet,
    after: ParameterSet,
    *,
    trust: Any = None,
    worst: int = 20,
    keep: bool = False,
    passes: PartPasses | None = None,
) -> Analysis:
    """Analyse the errors before and after a calibration part by part; their samples are forgotten unless kept.

    Args:
        problem: function, data and criteria.
        before: the values at the start.
        after: the values to analyse.
        trust: see `residuals`.
        worst: number of the largest errors to list.
        keep: keep the errors of all samples in the result.
        passes: over the criteria at these values.
    """
    return _ResidualScan(passes or PartPasses(problem, before, after), trust, worst).analysis(keep=keep)


class _ResidualScan:
    """The passes of an analysis; the first result of each is by criterion."""

    def __init__(self, passes: PartPasses, trust: Any, worst: int) -> None:
        self._passes, self._worst = passes, worst
        self._problem = passes.problem
        self._leverage: Mapping[str, Float] = getattr(trust, "leverage", None) or {}
        self._counted = frozenset(getattr(trust, "samples", None) or {})
        self._weights = LookupWeights()

    def analysis(self, *, keep: bool) -> Analysis:
        cells = CellSums(self._counted)
        counts: list[tuple[DatasetExtent, list[ErrorCounts]]] = []
        for number in range(len(self._problem.datasets)):
            first = self._passes.first(number, _count, self._leverage, self._counted)
            if first is None:
                continue
            counts.append((self._passes.extent(number, first.extents), first.counts.rows))
            self._weights.merge(first.weights)
            # with states, all samples of a dataset would count, though it scores none
            if any(count.target.count for count in first.counts.rows):
                cells.merge(first.cells)
        fits = []
        rare = [RareErrors(bounds) for bounds in self._deviation_bounds(counts)]
        for extent, own in counts:
            scored = [number for number, count in enumerate(own) if count.target.count]
            plan = _DetailPlan.of(own, extent, rare, self._worst, keep=keep)
            leverages = self._weights, self._leverage
            details = self._passes.over(extent, _detail, plan, *leverages).rows if scored else []
            fits += [Fit(number, extent, own[number], details[number]) for number in scored]
        tallied = cells.tally(self._passes.evaluator.lookups, self._passes.evaluator.parameters)
        return Analysis(tuple(self._of_criteria(fits, tallied.cells, keep=keep)), tuple(fits), tallied.touching)

    def _deviation_bounds(self, counts: Sequence[tuple[DatasetExtent, list[ErrorCounts]]]) -> list[tuple[float, float]]:
        """Return bounds of `_deviation` for each criterion, given its counts on each dataset.

        The leverages of all samples are at most those of all grid points.
        """
        determined = sum(float(np.nansum(table)) for table in self._leverage.values())
        bounds = []
        for own in zip(*(rows for _, rows in counts), strict=True):
            pairs = [(extent.dataset.is_fitted, count) for (extent, _), count in zip(counts, own, strict=True)]
            # the same choice as in `_deviation`
            used = [count for fitted, count in pairs if fitted and count.target.count] or list(own)
            total, samples = sum(c.after.sums.squares for c in used), sum(c.target.count for c in used)
            # s^2 = sum r^2 / (n - sum h) with 0 <= sum h <= sum over grid points
            bounds.append((_root_of_share(total, samples), _root_of_share(total, samples - determined)))
        return bounds

    def _of_criteria(self, fits: Sequence[Fit], cells: Sequence[CellErrors], *, keep: bool) -> Iterator[Residuals]:
        deviations = {n: _deviation([fit for fit in fits if fit.number == n]) for n in sorted({f.number for f in fits})}
        for number, deviation in deviations.items():
            own_fits = [fit for fit in fits if fit.number == number]
            criterion = self._problem.criteria[number]
            yield Residuals(
                criterion=criterion.node,
                target=str(criterion.target),
                unit=own_fits[0].counts.unit,
                scaling="studentized" if self._leverage else "standardised",
                deviation=deviation,
                errors=tuple(_errors(fit, deviation) for fit in own_fits if keep),
                summaries=tuple(_summary(fit, deviation) for fit in own_fits),
                cells=tuple(cell for cell in cells if cell.criterion == number),
                worst=_worst(own_fits, deviation, self._worst),
            )


@dataclass
class _Rows(Generic[_Row]):
    """Statistics of several criteria."""

    rows: list[_Row]

    def merge(self, later: "_Rows[_Row]") -> None:
        for own, other in zip(self.rows, later.rows, strict=True):
            own.merge(other)


@dataclass
class _FirstPass:
    extents: list[PartExtent]
    counts: _Rows[ErrorCounts]
    cells: CellSums
    weights: LookupWeights

    def merge(self, later: "_FirstPass") -> None:
        self.extents += later.extents
        for name in ("counts", "cells", "weights"):
            getattr(self, name).merge(getattr(later, name))


def _count(
    evaluator: PartEvaluator,
    evaluated: EvaluatedPart,
    place: PartPlace,
    leverage: Mapping[str, Float],
    counted: Collection[str],
) -> _FirstPass:
    lookups, located = evaluator.lookups, evaluator.locate(evaluated)
    return _FirstPass(
        [evaluated.extent],
        _Rows([ErrorCounts.of(*pair) for pair in zip(evaluated.before, evaluated.after, strict=True)]),
        CellSums.of(lookups, located, evaluated.after, counted),
        LookupWeights.of(evaluator.problem, lookups, located, evaluated.after, leverage),
    )


@dataclass(frozen=True)
class _DetailPlan:
    """The second pass over a dataset; `means`, `searches` and `rare` are by criterion."""

    means: Sequence[float]
    searches: Sequence[ErrorSearches]
    rare: Sequence[RareErrors]
    lags: int  # of autocorrelations; 0 for none
    worst: int
    keep: bool

    @classmethod
    def of(
        cls, counts: Sequence[ErrorCounts], extent: DatasetExtent, rare: Sequence[RareErrors], worst: int, *, keep: bool
    ) -> "_DetailPlan":
        # by the whole dataset, so that the sums of all parts have the same length
        lags = count_lags([0], extent.longest) if extent.is_timed else 0
        means, searches = [count.finite.mean for count in counts], [count.searches() for count in counts]
        return cls(means, searches, rare, lags, worst, keep)


def _detail(
    evaluator: PartEvaluator,
    evaluated: EvaluatedPart,
    place: PartPlace,
    plan: _DetailPlan,
    weights: LookupWeights,
    table_leverage: Mapping[str, Float],
) -> _Rows[ErrorDetails]:
    rows = []
    located = evaluator.locate(evaluated) if table_leverage else []
    series = zip(evaluated.before, evaluated.after, strict=True)
    for (before, after), mean, search, large in zip(series, plan.means, plan.searches, plan.rare, strict=True):
        leverage = weights.leverage(evaluator.problem, evaluator.lookups, located, after, table_leverage)
        products = LaggedProducts.of(after.error, after.bound.starts, mean, plan.lags) if plan.lags else None
        rows.append(
            ErrorDetails(
                search.part(before, after),
                products,
                _largest(evaluator.problem, place, after, leverage, plan.worst),
                large.part(after.error, leverage),
                float(np.sum(1.0 - leverage[after.scored])),
                [(after.error, relative_errors(after), leverage)] if plan.keep else [],
            )
        )
    return _Rows(rows)


def _largest(problem: Problem, place: PartPlace, series: CriterionSeries, leverage: Float, worst: int) -> LargeErrors:
    places, size = largest_places(series, worst)
    kept, pieces, relative = series.bound.kept, series.piece, relative_errors(series)
    names = problem.model.graph.inputs
    errors = [
        LargeError(
            size=float(size[at]),
            sample=place.begin + int(kept[at]),
            piece=place.piece + int(pieces[at]),
            time=None if series.time is None else float(series.time[at]),
            measured=float(series.measured[at]),
            model=float(series.model[at]),
            error=float(series.model[at] - series.measured[at]),
            relative=float(relative[at]),
            leverage=float(leverage[at]),
            inputs={name: float(series.bound.inputs[name][kept[at]]) for name in names},
        )
        for at in places.tolist()
    ]
    # merged into an empty one, which sorts and cuts
    largest = LargeErrors(worst)
    largest.merge(LargeErrors(worst, errors))
    return largest


def _deviation(fits: Sequence[Fit]) -> float:
    """Return the root of sum r^2 / (n - sum h) over the training samples, or over all if there are none."""
    used = [fit for fit in fits if fit.data.dataset.is_fitted] or fits
    total = sum(fit.counts.after.sums.squares for fit in used)
    free = sum(fit.details.freedom for fit in used)
    return _root_of_share(total, free) if free > 0 else float("nan")


def _root_of_share(total: float, count: float) -> float:
    """Return the root of a share of a sum of squares, infinite if nothing is counted."""
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.float64(total) / count)) if count > 0 else float("inf")


def _errors(fit: Fit, deviation: float) -> Errors:
    error, relative, leverage = (np.concatenate(parts) for parts in zip(*fit.details.samples, strict=True))
    scaled = scaled_errors(error, deviation, leverage)
    return Errors(fit.data.dataset.name, fit.data.dataset.use, error, relative, scaled)


def _summary(fit: Fit, deviation: float) -> Summary:
    counts, searches = fit.counts, fit.details.searches
    finite, variation = counts.finite, counts.target.squares
    with np.errstate(over="ignore"):
        # sum e^2 = sum (e - mean)^2 + n mean^2
        squares = float(finite.squares + finite.count * np.float64(finite.mean) ** 2)
    # R2 of a part of the samples would compare with the variation of all
    determined = variation > 0 and finite.count == fit.samples
    memory = None
    if fit.details.products is not None:
        memory = of_products(fit.details.products, finite.count, counts.step)
    return Summary(
        dataset=fit.data.dataset.name,
        use=fit.data.dataset.use,
        samples=fit.samples,
        mean=finite.mean,
        deviation=finite.deviation,
        rmse=float(np.sqrt(squares / finite.count)) if finite.count else float("nan"),
        r2=1.0 - squares / variation if determined else float("nan"),
        median=searches.size.quantile(MIDDLE),
        percentile_95=searches.size.quantile(MOST),
        largest=max(-counts.after.low, counts.after.high) if finite.count else float("nan"),
        relative=searches.relative.quantile(0.5),
        beyond=fit.details.rare.share(deviation),
        autocorrelation=memory,
    )


def _worst(fits: Sequence[Fit], deviation: float, count: int) -> tuple[WorstSample, ...]:
    """Return the largest errors of all datasets in descending order; an error that is not finite is the largest.

    Of neighbours in time whose errors have the same sign only the worst is listed: they are one event.
    """
    largest = [(-error.size, i, error.sample) for i, fit in enumerate(fits) for error in fit.details.largest.errors]
    by_place = {(i, error.sample): error for i, fit in enumerate(fits) for error in fit.details.largest.errors}
    return tuple(_worst_sample(fits[i], by_place[i, at], deviation) for _, i, at in sorted(largest)[:count])


def _worst_sample(fit: Fit, error: LargeError, deviation: float) -> WorstSample:
    return WorstSample(
        dataset=fit.data.dataset.name,
        use=fit.data.dataset.use,
        sample=error.sample,
        piece=error.piece,
        time=error.time,
        measured=error.measured,
        model=error.model,
        error=error.error,
        relative=error.relative,
        scaled=float(scaled_errors(np.array([error.error]), deviation, np.array([error.leverage]))[0]),
        inputs=error.inputs,
    )
