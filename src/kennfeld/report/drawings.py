"""The points of time plots, scatter plots and histograms, chosen in one pass over the parts of all datasets.

Their number is bounded, whatever the number of samples. What is drawn of a part can be merged with that of the next.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.analysis.part_evaluation import EvaluatedPart, PartEvaluator, PartPasses, PartPlace
from kennfeld.analysis.residual_statistics import TAILS, ErrorRange
from kennfeld.analysis.residuals import Fit
from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.sample_statistics import QuantileSearch
from kennfeld.base.trace_envelope import Trace, TraceEnvelope
from kennfeld.report.stamps import Stamps
from kennfeld.report.strip_details import SAMPLED, DetailRoom, DrawnSignals, SignalPlan

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
        """Count the finite values, Float[samples], between `ends` in their unit."""
        known = values[np.isfinite(values)]
        beyond = int(np.count_nonzero((known < ends[0]) | (known > ends[1])))
        return cls(ends, np.histogram(np.clip(known, *ends), bins, ends)[0].astype(np.int64), beyond)

    def merge(self, later: "Histogram") -> None:
        """Take in the counts of other errors."""
        self.counts += later.counts
        self.beyond += later.beyond


def histogram_ends(errors: ErrorRange, search: QuantileSearch) -> Ends:
    """Choose the range of a histogram, in the unit of the errors: of all, or of nearly all if there are outliers."""
    # low is infinite if no error is finite
    if not np.isfinite(errors.low):
        return -1.0, 1.0
    low, high = search.quantile(TAILS), search.quantile(1.0 - TAILS)
    # > 0 also for errors that are equal, so that outliers beside them are cut off
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
    detail: TraceEnvelope | None  # of what is shown when the strip is zoomed
    chosen: Int  # of the scored samples, for the scatter plot
    worst: Sequence[int]  # samples of the dataset that it shows as well
    criterion: int
    ends: Mapping[str, Ends]  # of the histograms before and after

    @classmethod
    def of(
        cls, fit: Fit, worst: Sequence[int], series: int, groups: TraceEnvelope, detail: TraceEnvelope | None
    ) -> "DrawingPlan":
        """Return the plan for a fit, one of `series`."""
        dots = int(np.clip(TOTAL_POINTS // (6 * max(series, 1)), *SCATTER_POINTS))
        counts, searches = fit.counts, fit.details.searches
        return cls(
            unit=counts.unit,
            timed=fit.data.is_timed,
            samples=fit.samples,
            groups=groups,
            detail=detail,
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
class DetailPoints:
    """Details of the strip of a criterion, which it shows when it is zoomed."""

    stamps: Stamps
    traces: dict[str, Trace]

    @classmethod
    def of(
        cls,
        groups: TraceEnvelope,
        timed: bool,
        place: PartPlace,
        series: CriterionSeries,
        signals: Mapping[str, Float],
    ) -> "DetailPoints":
        """Return the points of a part of the dataset."""
        if groups.whole:  # errors are differences of samples
            signals = {name: signals[name] for name in SAMPLED}
        return cls(Stamps.of(groups, timed, place, series), _traces(groups, place, signals))

    def merge(self, later: "DetailPoints") -> None:
        """Take in the points of the following part."""
        self.stamps.merge(later.stamps)
        for name, trace in later.traces.items():
            self.traces[name].merge(trace)


def _traces(groups: TraceEnvelope, place: PartPlace, signals: Mapping[str, Float]) -> dict[str, Trace]:
    traces = {name: Trace() for name in signals}
    for name, trace in traces.items():
        trace.add(groups, place.first, signals[name])
    return traces


@dataclass
class DrawnPoints:
    """The points of one criterion on a dataset or a part of it."""

    stamps: Stamps
    traces: dict[str, Trace]
    detail: "DetailPoints | None"
    scattered: list[Float]  # Float[4, dots]: number, measured, before, after
    own: dict[str, Histogram]
    equal: dict[str, Histogram]

    @classmethod
    def of(cls, plan: DrawingPlan, place: PartPlace, before: CriterionSeries, after: CriterionSeries) -> "DrawnPoints":
        """Return the points of a part of the dataset."""
        errors = {"before": before.error, "after": after.error}
        signals = {"measured": after.measured, "before": before.model, "after": after.model}
        signals |= {"errorBefore": errors["before"], "error": errors["after"]}
        return cls(
            stamps=Stamps.of(plan.groups, plan.timed, place, after),
            traces=_traces(plan.groups, place, signals),
            detail=None if plan.detail is None else DetailPoints.of(plan.detail, plan.timed, place, after, signals),
            scattered=[_scatter(plan, place, before, after)],
            own={name: Histogram.of(error, plan.ends[name]) for name, error in errors.items()},
            equal={name: Histogram.of(error, plan.shared) for name, error in errors.items()},
        )

    def merge(self, later: "DrawnPoints") -> None:
        """Take in the points of the following part."""
        self.stamps.merge(later.stamps)
        if self.detail is not None and later.detail is not None:
            self.detail.merge(later.detail)
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
    """The points of one criterion on one dataset, and their plan; and the further signals of the dataset."""

    plan: DrawingPlan
    points: DrawnPoints
    dataset: str
    signals: DrawnSignals | None


def _scatter(plan: DrawingPlan, place: PartPlace, before: CriterionSeries, after: CriterionSeries) -> Float:
    """Return number, measurement and model before and after at the chosen and the worst samples: Float[4, dots]."""
    scored, first = np.flatnonzero(after.scored), place.scored[plan.criterion]
    numbers = place.begin + after.bound.kept[scored]
    picked = np.isin(numbers, plan.worst)
    # numbers among the scored samples of the dataset, here those of this part
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
    # five traces: measured, before, after, and two errors
    most = int(np.clip(TOTAL_POINTS // (5 * max(len(fits), 1)), *TRACE_POINTS))
    views = [TraceEnvelope(fit.data.count, most) for fit in fits]
    room = DetailRoom.of(fits, views)
    planned = [
        (fit.data, DrawingPlan.of(fit, worst[fit.number].get(fit.data.name, ()), len(fits), view, detail))
        for fit, view, detail in zip(fits, views, room.groups, strict=True)
    ]
    drawings: list[Drawing] = []
    # one pass over a dataset draws all its criteria
    for data in {id(fit.data): fit.data for fit in fits}.values():
        plans = [plan for own, plan in planned if own is data]
        further = SignalPlan.of(passes.problem, data, room.signals)
        drawn = passes.over(data, _draw_part, plans, further)
        drawings += [Drawing(*pair, data.name, drawn.signals) for pair in zip(plans, drawn.points, strict=True)]
    return drawings


def _draw_part(
    evaluator: PartEvaluator,
    evaluated: EvaluatedPart,
    place: PartPlace,
    plans: Sequence[DrawingPlan],
    further: SignalPlan | None,
) -> "_DrawnPart":
    before, after = evaluated.before, evaluated.after
    return _DrawnPart(
        points=[DrawnPoints.of(plan, place, before[plan.criterion], after[plan.criterion]) for plan in plans],
        signals=None if further is None else DrawnSignals.of(further, evaluator, evaluated, place),
    )


@dataclass
class _DrawnPart:
    points: list[DrawnPoints]
    signals: DrawnSignals | None

    def merge(self, later: "_DrawnPart") -> None:
        for own, other in zip(self.points, later.points, strict=True):
            own.merge(other)
        if self.signals is not None and later.signals is not None:
            self.signals.merge(later.signals)
