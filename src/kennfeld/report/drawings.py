"""The points of time plots, scatter plots and histograms, chosen in one pass over the parts of all datasets.

Their number is bounded, whatever the number of samples. What is drawn of a part can be merged with that of the next.
"""

from collections.abc import Mapping, Sequence
from dataclasses import field
from itertools import pairwise

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.analysis.part_evaluation import EvaluatedPart, PartEvaluator, PartPasses, PartPlace
from kennfeld.analysis.residual_statistics import TAILS, ErrorRange
from kennfeld.analysis.residuals import Fit
from kennfeld.arrays import Float, Int
from kennfeld.lazy_dataclass import dataclass
from kennfeld.sample_statistics import QuantileSearch
from kennfeld.trace_envelope import Trace, TraceEnvelope

TOTAL_POINTS = 120_000  # of all time plots and scatter plots together
TRACE_POINTS = (400, 4000)  # minimum and maximum of one trace
SCATTER_POINTS = (200, 3000)
BINS = 50
EQUAL_TOLERANCE = 1e-12  # relative range of errors up to which they count as equal

Ends = tuple[float, float]


def sample_indices(count: int, most: int) -> Int:
    """Draw at most `most` of `count` sample numbers, in order and reproducibly."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))


@dataclass
class Histogram:
    """Counts of errors in bins of equal width; `beyond` of them lie outside and count in the first and last bin."""

    ends: Ends
    counts: Int
    beyond: int

    @classmethod
    def of(cls, values: Float, ends: Ends, bins: int = BINS) -> "Histogram":
        """Count the finite values."""
        known = values[np.isfinite(values)]
        beyond = int(np.count_nonzero((known < ends[0]) | (known > ends[1])))
        return cls(ends, np.histogram(np.clip(known, *ends), bins, ends)[0].astype(np.int64), beyond)

    def merge(self, later: "Histogram") -> None:
        """Take in the counts of other errors."""
        self.counts += later.counts
        self.beyond += later.beyond


def histogram_ends(errors: ErrorRange, search: QuantileSearch) -> Ends:
    """Return the range of a histogram: that of all errors, or of nearly all if there are outliers."""
    if not np.isfinite(errors.low):
        return -1.0, 1.0
    low, high = search.quantile(TAILS), search.quantile(1.0 - TAILS)
    spread = max(high - low, 1e-12 * max(abs(low), abs(high), 1e-300))
    low, high = max(errors.low, low - 0.5 * spread), min(errors.high, high + 0.5 * spread)
    size = max(abs(low), abs(high))
    if high - low > EQUAL_TOLERANCE * size:
        return float(low), float(high)
    half = 0.5 * (size or 1.0)  # the errors differ by rounding only, too little for bins
    return float(low) - half, float(high) + half


@dataclass(frozen=True, eq=False)
class DrawingPlan:
    """The points to be drawn of one criterion on one dataset."""

    unit: str
    timed: bool
    samples: int  # that are scored
    groups: TraceEnvelope
    chosen: Int  # of the scored samples, for the scatter plot
    worst: Sequence[int]  # samples of the dataset that it shows as well
    criterion: int
    ends: Mapping[str, Ends]  # of the histograms before and after

    @classmethod
    def of(cls, fit: Fit, worst: Sequence[int], series: int) -> "DrawingPlan":
        """Return the plan for a fit, one of `series`."""
        most = int(np.clip(TOTAL_POINTS // (5 * max(series, 1)), *TRACE_POINTS))
        dots = int(np.clip(TOTAL_POINTS // (6 * max(series, 1)), *SCATTER_POINTS))
        counts, searches = fit.counts, fit.details.searches
        return cls(
            unit=counts.unit,
            timed=fit.data.is_timed,
            samples=fit.samples,
            groups=TraceEnvelope(fit.data.count, most),
            chosen=sample_indices(fit.samples, dots),
            worst=worst,
            criterion=fit.number,
            ends={
                "before": histogram_ends(counts.before, searches.before),
                "after": histogram_ends(counts.after, searches.after),
            },
        )

    @property
    def shared(self) -> Ends:
        """The range of both histograms."""
        lows, highs = zip(*self.ends.values(), strict=True)
        return min(lows), max(highs)


@dataclass
class Stamps:
    """Times of the drawn samples, or their numbers; and the first, second and last time of each piece."""

    timed: bool
    whole: bool
    drawn: list[Float] = field(default_factory=list)
    owners: list[Int] = field(default_factory=list)  # the piece of each drawn sample
    pieces: list[Float] = field(default_factory=list)  # Float[3, pieces]

    @classmethod
    def of(cls, plan: DrawingPlan, place: PartPlace, series: CriterionSeries) -> "Stamps":
        """Return the stamps of a part."""
        bound, time = series.bound, series.time
        at = plan.groups.firsts(place.first, place.first + bound.count) - place.first
        stamps = cls(plan.timed, plan.groups.whole)
        numbers = (place.begin + bound.kept).astype(np.float64) if time is None else time
        stamps.drawn.append(numbers[at])
        stamps.owners.append(place.piece + np.searchsorted(bound.starts, at, side="right") - 1)
        edges = [*bound.starts[place.continues :].tolist(), bound.count]
        ends = [[numbers[a], numbers[min(a + 1, b - 1)], numbers[b - 1]] for a, b in pairwise(edges)]
        stamps.pieces.append(np.array(ends).reshape(-1, 3).T)
        return stamps

    def merge(self, later: "Stamps") -> None:
        """Take in the stamps of the following part."""
        self.drawn += later.drawn
        self.owners += later.owners
        self.pieces += later.pieces

    def along(self) -> tuple[Float, str, str, Float]:
        """Return the x axis with its title and unit, and where pieces begin.

        That is the time, with pieces in a row if it restarts in each, else the sample number.
        """
        drawn, owners = np.concatenate(self.drawn), np.concatenate(self.owners)
        firsts, seconds, lasts = np.concatenate(self.pieces, axis=1)
        twice = drawn if self.whole else np.repeat(drawn, 2)
        if not self.timed:
            return twice, "sample", "", firsts[1:]
        if np.all(firsts[1:] > lasts[:-1]):
            return twice, "time", "s", firsts[1:]
        shifts, end = np.empty(firsts.size), 0.0
        for number, (first, second, last) in enumerate(zip(firsts, seconds, lasts, strict=True)):
            shifts[number] = end - first
            end = float(last + shifts[number]) + float(second - first)
        row = drawn + shifts[owners]
        return row if self.whole else np.repeat(row, 2), "time, recordings in a row", "s", (firsts + shifts)[1:]


@dataclass
class DrawnPoints:
    """The points of one criterion on a dataset or a part of it."""

    stamps: Stamps
    traces: dict[str, Trace]
    scattered: list[Float]  # Float[4, dots]: number, measured, before, after
    own: dict[str, Histogram]
    equal: dict[str, Histogram]

    @classmethod
    def of(cls, plan: DrawingPlan, place: PartPlace, before: CriterionSeries, after: CriterionSeries) -> "DrawnPoints":
        """Return the points of a part of the dataset."""
        errors = {"before": before.error, "after": after.error}
        signals = {"measured": after.measured, "before": before.model, "after": after.model}
        signals |= {"errorBefore": errors["before"], "error": errors["after"]}
        traces = {name: Trace() for name in signals}
        for name, trace in traces.items():
            trace.add(plan.groups, place.first, signals[name])
        return cls(
            stamps=Stamps.of(plan, place, after),
            traces=traces,
            scattered=[_scatter(plan, place, before, after)],
            own={name: Histogram.of(error, plan.ends[name]) for name, error in errors.items()},
            equal={name: Histogram.of(error, plan.shared) for name, error in errors.items()},
        )

    def merge(self, later: "DrawnPoints") -> None:
        """Take in the points of the following part."""
        self.stamps.merge(later.stamps)
        self.scattered += later.scattered
        for name in ("traces", "own", "equal"):
            for key, drawn in getattr(later, name).items():
                getattr(self, name)[key].merge(drawn)

    @property
    def dots(self) -> dict[str, Float]:
        """The columns of the scatter plot: `number`, `measured`, `before` and `after`."""
        return dict(zip(("number", "measured", "before", "after"), np.concatenate(self.scattered, axis=1), strict=True))


@dataclass(frozen=True, eq=False)
class Drawing:
    """The points of one criterion on one dataset, and their plan."""

    plan: DrawingPlan
    points: DrawnPoints


def _scatter(plan: DrawingPlan, place: PartPlace, before: CriterionSeries, after: CriterionSeries) -> Float:
    """Return number, measurement and model of the chosen samples and of the worst ones of a part."""
    scored, first = np.flatnonzero(after.scored), place.scored[plan.criterion]
    numbers = place.begin + after.bound.kept[scored]
    picked = np.isin(numbers, plan.worst)
    chosen = plan.chosen[slice(*np.searchsorted(plan.chosen, [first, first + scored.size]))] - first
    picked[chosen] = True
    at = scored[picked]
    return np.array([numbers[picked], after.measured[at], before.model[at], after.model[at]], dtype=np.float64)


def draw(passes: PartPasses, fits: Sequence[Fit], worst: Mapping[int, Mapping[str, Sequence[int]]]) -> list[Drawing]:
    """Return the drawing of each fit.

    Args:
        passes: over the criteria.
        fits: their statistics, dataset by dataset.
        worst: samples that are drawn in any case, by the number of the criterion and the dataset.
    """
    drawings: list[Drawing] = []
    for data in {id(fit.data): fit.data for fit in fits}.values():
        own = [fit for fit in fits if fit.data is data]
        plans = [DrawingPlan.of(fit, worst[fit.number].get(data.name, ()), len(fits)) for fit in own]
        drawings += map(Drawing, plans, passes.over(data, _draw_part, plans).points)
    return drawings


def _draw_part(
    evaluator: PartEvaluator, evaluated: EvaluatedPart, place: PartPlace, plans: Sequence[DrawingPlan]
) -> "_Points":
    before, after = evaluated.before, evaluated.after
    return _Points([DrawnPoints.of(plan, place, before[plan.criterion], after[plan.criterion]) for plan in plans])


@dataclass
class _Points:
    points: list[DrawnPoints]

    def merge(self, later: "_Points") -> None:
        for own, other in zip(self.points, later.points, strict=True):
            own.merge(other)
