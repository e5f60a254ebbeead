"""Residuals of a parameter set: absolute, relative and studentized, with summaries and the worst samples."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Literal

import numpy as np

from kennfeld.analysis.autocorrelation import Autocorrelation, autocorrelation
from kennfeld.analysis.cell_errors import CellErrors, tally
from kennfeld.analysis.evaluation import CriterionSeries, Evaluator
from kennfeld.arrays import Float, Int
from kennfeld.dataset import Use
from kennfeld.optimize.lookup_coverage import Lookup, Lookups
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.quality import spread
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.sample_weights import sample_weights

MAX_LEVERAGE = 0.999  # a sample that alone determines a value has no residual

Scaling = Literal["studentized", "standardised"]


def sample_leverage(
    problem: Problem, lookups: Lookups, series: Sequence[CriterionSeries], leverage: Mapping[str, Float]
) -> dict[int, Float]:
    """Approximate the leverage of each training sample, by the number of its series.

    The leverage of a grid point, 1 if the data alone determine it, is distributed among the samples that look it up,
    by their weights in the lookup and in the cost. Its sum over all samples equals that over all grid points, the
    number of values that the data determine. For a single table whose samples are at its grid points this is the
    diagonal of the hat matrix; otherwise it approximates it without a matrix of samples by values.

    Args:
        problem: criteria and their weights.
        lookups: at the values of the fit.
        series: the criteria on the datasets.
        leverage: of the grid points, by table.

    Returns:
        Float[samples] by number of the series.
    """
    training = {i: entry for i, entry in enumerate(series) if entry.bound.dataset.use == "training"}
    weights = {i: _weight(problem, entry) for i, entry in training.items()}
    totals = {name: np.zeros(values.size) for name, values in leverage.items() if name in lookups.reached}
    for i, lookup, at, weight in _corners(lookups, training, totals):
        total = totals[lookup.table.name]
        total += np.bincount(at, weight * weights[i][lookup.samples], minlength=total.size)
    pulls = {i: np.zeros(entry.bound.count) for i, entry in training.items()}
    for i, lookup, at, weight in _corners(lookups, training, totals):
        total, own = totals[lookup.table.name], leverage[lookup.table.name].ravel()
        each = np.divide(own, total, out=np.zeros(total.size), where=total > 0)
        pulls[i][lookup.samples] += each[at] * (weight * weights[i][lookup.samples])
    return {i: np.clip(np.nan_to_num(values), 0.0, MAX_LEVERAGE) for i, values in pulls.items()}


def _weight(problem: Problem, series: CriterionSeries) -> Float:
    criterion = problem.criteria[series.criterion]
    weight = criterion.weight * series.bound.dataset.weight / criterion.scale**2
    own = sample_weights(criterion, series.bound.dataset)
    each = weight if own is None else weight * own[series.bound.kept]
    return np.where(series.scored, each, 0.0)


def _corners(
    lookups: Lookups, training: Mapping[int, CriterionSeries], tables: Mapping[str, Float]
) -> Iterator[tuple[int, Lookup, Int, Float]]:
    """Yield the grid points and weights of lookups of these tables, by number of the series that depends on them."""
    for i, entry in training.items():
        for lookup in lookups.blocks(entry.bound):
            if lookup.table.name in tables and entry.criterion in lookups.reached[lookup.table.name]:
                for at, weight in lookup.corners():
                    yield i, lookup, at, np.clip(weight, 0.0, None)


@dataclass(frozen=True, eq=False)
class Errors:
    """The errors of a criterion on one dataset, model minus measurement; NaN if not scored.

    `relative` is the error over the size of the measurement, NaN if that is 0. `scaled` is the error over its
    standard deviation; see `Residuals.scaling`.
    """

    dataset: str
    use: Use
    absolute: Float  # Float[samples], in the unit of the target
    relative: Float  # Float[samples]
    scaled: Float  # Float[samples]


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
    errors: tuple[Errors, ...]
    summaries: tuple[Summary, ...]
    cells: tuple[CellErrors, ...]
    worst: tuple[WorstSample, ...]


def residuals(
    problem: Problem,
    parameters: ParameterSet,
    *,
    trust: Any = None,
    worst: int = 20,
    series: Sequence[CriterionSeries] | None = None,
    lookups: Lookups | None = None,
    cells: tuple[CellErrors, ...] | None = None,
) -> tuple[Residuals, ...]:
    """Analyse the errors of a parameter set, one entry per criterion.

    An error is studentized, r / (s sqrt(1 - h)), if `trust.leverage` is known; h is the sample's leverage and
    s^2 = sum r^2 / (n - sum h) over the training samples. h = 0 for test data.

    Args:
        problem: function, data and criteria.
        parameters: the values to analyse.
        trust: the trust of a result; its `leverage` by table is used if it has one.
        worst: number of the largest errors to list.
        series: the criteria at `parameters`, if computed already.
        lookups: the lookups at `parameters`, if computed already.
        cells: the errors by cell, if computed already.

    Returns:
        The residuals of each criterion that has a scored sample.

    Source of the studentized residual: R. D. Cook, S. Weisberg: Residuals and Influence in Regression, 1982, ch. 2.
    """
    series = Evaluator(problem).series(parameters) if series is None else series
    lookups = Lookups(problem, parameters) if lookups is None else lookups
    cells = tally(lookups, parameters, series).cells if cells is None else cells
    by_table = getattr(trust, "leverage", None)
    leverage = sample_leverage(problem, lookups, series, by_table) if by_table else None
    pairs = [(entry, (leverage or {}).get(i, np.zeros(entry.bound.count))) for i, entry in enumerate(series)]
    return tuple(
        _residuals_of_criterion(
            problem,
            list(group),
            "standardised" if leverage is None else "studentized",
            tuple(cell for cell in cells if cell.criterion == number),
            worst,
        )
        for number, group in groupby(sorted(pairs, key=_criterion), _criterion)
    )


def _criterion(pair: tuple[CriterionSeries, Float]) -> int:
    return pair[0].criterion


def _residuals_of_criterion(
    problem: Problem,
    pairs: Sequence[tuple[CriterionSeries, Float]],
    scaling: Scaling,
    cells: tuple[CellErrors, ...],
    worst: int,
) -> Residuals:
    """Return the residuals of the series of one criterion, each paired with the leverage of its samples."""
    series = [entry for entry, _ in pairs]
    criterion = problem.criteria[series[0].criterion]
    deviation = _deviation(pairs)
    errors = tuple(_errors(entry, deviation * np.sqrt(1.0 - leverage)) for entry, leverage in pairs)
    return Residuals(
        criterion=criterion.node,
        target=str(criterion.target),
        unit=series[0].unit,
        scaling=scaling,
        deviation=deviation,
        errors=errors,
        summaries=tuple(map(_summary, series, errors)),
        cells=cells,
        worst=_worst(problem, series, errors, worst),
    )


def _deviation(pairs: Sequence[tuple[CriterionSeries, Float]]) -> float:
    """Return the root of sum r^2 / (n - sum h) over the training samples, or over all if there are none."""
    used = [(s, h) for s, h in pairs if s.bound.dataset.use == "training" and s.bound.dataset.weight > 0] or pairs
    with np.errstate(over="ignore", invalid="ignore"):
        total = sum(float(np.nansum(s.error**2)) for s, _ in used)
    free = sum(float(np.sum(1.0 - h[s.scored])) for s, h in used)
    return float(np.sqrt(total / free)) if free > 0 else float("nan")


def _errors(series: CriterionSeries, deviation: Float) -> Errors:
    error, data = series.error, series.bound.dataset
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        size = np.abs(series.measured)
        relative = np.where(size > 0, error / size, np.nan)
        scaled = np.where(deviation > 0, error / deviation, np.nan)
    return Errors(data.name, data.use, error, relative, scaled)


def _summary(series: CriterionSeries, errors: Errors) -> Summary:
    measured = series.measured[series.scored]
    variation = spread(measured)
    determined = variation > 0 and np.isfinite(errors.absolute).sum() == measured.size
    size = np.abs(errors.absolute)
    with np.errstate(over="ignore", invalid="ignore"):
        return Summary(
            dataset=errors.dataset,
            use=errors.use,
            samples=measured.size,
            mean=_of_known(errors.absolute, np.mean),
            deviation=_of_known(errors.absolute, np.std),
            rmse=_of_known(errors.absolute, lambda error: np.sqrt(np.mean(error**2))),
            r2=_of_known(errors.absolute, lambda error: 1.0 - np.sum(error**2) / variation) if determined else np.nan,
            median=_of_known(size, lambda size: np.quantile(size, 0.5)),
            percentile_95=_of_known(size, lambda size: np.quantile(size, 0.95)),
            largest=_of_known(size, np.max),
            relative=_of_known(np.abs(errors.relative), np.median),
            beyond=_of_known(errors.scaled, lambda scaled: np.mean(np.abs(scaled) > 3)),
            autocorrelation=_autocorrelation(series),
        )


def _of_known(values: Float, statistic: Callable[[Float], Any]) -> float:
    """Return a statistic of the finite values, NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(statistic(known)) if known.size else float("nan")


def _autocorrelation(series: CriterionSeries) -> Autocorrelation | None:
    """Return the autocorrelation of the errors of a recording, in s if its time step is even."""
    if series.time is None:
        return None
    steps = np.delete(np.diff(series.time), series.bound.starts[1:] - 1)
    step = float(np.median(steps)) if steps.size else 0.0
    even = bool(steps.size and np.all(np.abs(steps - step) <= 1e-3 * step))
    return autocorrelation(series.error, series.bound.starts, step if even else None)


def _worst(
    problem: Problem, series: Sequence[CriterionSeries], errors: Sequence[Errors], count: int
) -> tuple[WorstSample, ...]:
    """Return the largest errors of all datasets in descending order; an error that is not finite is the largest.

    Of neighbours in time whose errors have the same sign only the worst is listed: they are one event.
    """
    largest: list[tuple[float, int, int]] = []
    for i, (entry, own) in enumerate(zip(series, errors, strict=True)):
        size = np.where(entry.scored, np.nan_to_num(np.abs(own.absolute), nan=np.inf), -1.0)
        places = np.arange(size.size) if entry.time is None else _peaks(size, own.absolute, entry.bound.starts)
        if places.size > count:
            places = places[np.argpartition(-size[places], count)[:count]]
        largest += [(-float(size[at]), i, int(at)) for at in places if size[at] >= 0]
    return tuple(_worst_sample(problem, series[i], errors[i], at) for _, i, at in sorted(largest)[:count])


def _peaks(size: Float, error: Float, starts: Int) -> Int:
    """Return the index of the largest of each run of errors of one sign."""
    sign = np.where(size < 0, 0, np.where(error > 0, 1, -1))
    fresh = np.ones(size.size, dtype=bool)
    fresh[1:] = sign[1:] != sign[:-1]
    fresh[starts] = True
    firsts = np.flatnonzero(fresh)
    run = np.cumsum(fresh) - 1
    places = np.flatnonzero(size == np.maximum.reduceat(size, firsts)[run]) if size.size else firsts
    return places[np.unique(run[places], return_index=True)[1]]


def _worst_sample(problem: Problem, series: CriterionSeries, errors: Errors, at: int) -> WorstSample:
    number, time = int(series.bound.kept[at]), series.time
    return WorstSample(
        dataset=errors.dataset,
        use=errors.use,
        sample=number,
        piece=int(series.piece[at]),
        time=None if time is None else float(time[at]),
        measured=float(series.measured[at]),
        model=float(series.model[at]),
        error=float(errors.absolute[at]),
        relative=float(errors.relative[at]),
        scaled=float(errors.scaled[at]),
        inputs={name: float(series.bound.inputs[name][number]) for name in problem.model.graph.inputs},
    )
