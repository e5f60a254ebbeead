"""Statistics of the errors of one criterion over parts of a dataset, in two passes.

The first pass counts and sums, the second finds quantiles around those counts, autocorrelations around the mean, the
largest errors, and scaled errors that are rare. All of them can be merged with those of other parts.
"""

from dataclasses import field

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.sample_statistics import Moments, QuantileSearch, Ranks
from kennfeld.optimize.quality.error_sums import ErrorSums
from kennfeld.optimize.trust.persistence import LaggedProducts

MIDDLE, MOST = 0.5, 0.95  # quantiles of the size of the errors
TAILS = 0.001  # share of the errors on each side that may lie outside a histogram
EVEN = 1e-3  # relative difference of time steps that count as equal
BEYOND = 3.0  # scaled errors that are rare for a normal distribution: 0.3 %
ROUNDING = 1e-9  # relative; by which bounds are widened


@dataclass
class ErrorRange:
    """The known errors at one set of values: infinite ones are known, NaN are not."""

    sums: ErrorSums
    low: float
    high: float
    ranks: Ranks  # of the finite ones

    @classmethod
    def of(cls, error: Float) -> "ErrorRange":
        """Measure the range of errors, Float[samples]."""
        known = error[~np.isnan(error)]
        finite = _finite(known)
        low, high = finite.min(initial=np.inf), finite.max(initial=-np.inf)
        return cls(ErrorSums.of(known), float(low), float(high), Ranks.of(finite))

    def merge(self, later: "ErrorRange") -> None:
        """Take in the errors at other samples."""
        self.sums.merge(later.sums)
        self.low, self.high = min(self.low, later.low), max(self.high, later.high)
        self.ranks.merge(later.ranks)


@dataclass
class ErrorCounts:
    """First pass: counts, sums and ranks of the errors of one criterion, before and after a calibration."""

    target: Moments
    finite: Moments
    before: ErrorRange
    after: ErrorRange
    relative: Ranks
    steps: tuple[float, float, float]  # time steps in s: the median of the first part, the shortest, the longest
    unit: str

    @classmethod
    def of(cls, before: CriterionSeries, after: CriterionSeries) -> "ErrorCounts":
        """Return the counts over a part of a dataset."""
        return cls(
            target=Moments.of(after.measured[after.scored]),
            finite=Moments.of(_finite(after.error)),
            before=ErrorRange.of(before.error),
            after=ErrorRange.of(after.error),
            relative=Ranks.of(np.abs(_finite(relative_errors(after)))),
            steps=_steps(after),
            unit=after.unit,
        )

    def merge(self, later: "ErrorCounts") -> None:
        """Take in the counts over the following part."""
        for name in ("target", "finite", "before", "after", "relative"):
            getattr(self, name).merge(getattr(later, name))
        first, low, high = self.steps
        # a part whose pieces have one sample each has no step
        first = later.steps[0] if np.isnan(first) else first
        self.steps = first, float(np.fmin(low, later.steps[1])), float(np.fmax(high, later.steps[2]))

    @property
    def step(self) -> float | None:
        """The time step in s if it is even."""
        step, low, high = self.steps
        # NaN, of data without time, fails the comparison
        return step if max(high - step, step - low) <= EVEN * step else None

    def searches(self) -> "ErrorSearches":
        """Return the searches for all quantiles."""
        return ErrorSearches(
            self.after.ranks.sizes.search([MIDDLE, MOST]),
            self.relative.search([0.5]),
            *(each.ranks.search([TAILS, 1.0 - TAILS]) for each in (self.before, self.after)),
        )


def _steps(series: CriterionSeries) -> tuple[float, float, float]:
    steps = np.zeros(0) if series.time is None else np.delete(np.diff(series.time), series.bound.starts[1:] - 1)
    if not steps.size:
        return (np.nan, np.nan, np.nan)
    return float(np.median(steps)), float(steps.min()), float(steps.max())


def _finite(values: Float) -> Float:
    finite = np.isfinite(values)
    return values if finite.all() else values[finite]


def relative_errors(series: CriterionSeries) -> Float:
    """Divide the errors by the size of the measurement, NaN if that is 0; Float[samples]."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        size = np.abs(series.measured)
        return np.where(size > 0, series.error / size, np.nan)


def scaled_errors(error: Float, deviation: float, leverage: Float) -> Float:
    """Divide errors Float[samples] by their standard deviation, in their unit, at samples of some leverage."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # var r_i = s^2 (1 - h_i)
        each = deviation * np.sqrt(1.0 - leverage)
        return np.where(each > 0, error / each, np.nan)


@dataclass
class ErrorSearches:
    """Second pass: searches for the quantiles of the errors."""

    size: QuantileSearch
    relative: QuantileSearch
    before: QuantileSearch
    after: QuantileSearch

    def part(self, before: CriterionSeries, after: CriterionSeries) -> "ErrorSearches":
        """Return the same searches over a part of a dataset."""
        error, old = _finite(after.error), _finite(before.error)
        relative = np.abs(_finite(relative_errors(after)))
        return ErrorSearches(
            self.size.part(np.abs(error)), self.relative.part(relative), self.before.part(old), self.after.part(error)
        )

    def merge(self, later: "ErrorSearches") -> None:
        """Take in the searches over other parts."""
        for name, search in vars(later).items():
            getattr(self, name).merge(search)


@dataclass
class RareErrors:
    """Counts scaled errors beyond 3 before the standard deviation that scales them is known, between `bounds`.

    It depends on the leverages of all samples. Until it is known, those errors are kept of which it will decide whether
    they are beyond 3.
    """

    bounds: tuple[float, float]  # of the standard deviation of the errors
    known: int = 0
    certain: int = 0  # errors beyond 3 for any deviation between the bounds
    possible: list[tuple[Float, Float]] = field(default_factory=list)  # other errors, and their leverages

    def part(self, error: Float, leverage: Float) -> "RareErrors":
        """Count over a part of a dataset: Float[samples], NaN if not scored."""
        size, root = np.abs(error), np.sqrt(1.0 - leverage)
        # beyond 3 for every s up to the upper bound, or for some s from the lower one on
        low, high = BEYOND * np.array(self.bounds) * (1 - ROUNDING, 1 + ROUNDING)
        known = np.isfinite(size)
        certain = known & (size > high * root)
        possible = known & (size >= low * root) & ~certain
        kept = [(error[possible], leverage[possible])]
        return RareErrors(self.bounds, int(np.count_nonzero(known)), int(np.count_nonzero(certain)), kept)

    def merge(self, later: "RareErrors") -> None:
        """Take in the count over the following part."""
        self.known += later.known
        self.certain += later.certain
        self.possible += later.possible

    def share(self, deviation: float) -> float:
        """Return the share of errors beyond 3 of their standard deviations; NaN if no scaled error is known."""
        if not self.known or not deviation > 0:
            return float("nan")
        sizes = [np.abs(scaled_errors(error, deviation, leverage)) for error, leverage in self.possible]
        return (self.certain + sum(int(np.count_nonzero(size > BEYOND)) for size in sizes)) / self.known


@dataclass(frozen=True)
class LargeError:
    """A sample with a large error; `sample` and `piece` count from the beginning of the dataset."""

    size: float  # infinite if the error is not finite
    sample: int
    piece: int
    time: float | None
    measured: float
    model: float
    error: float
    relative: float
    leverage: float
    inputs: dict[str, float]


@dataclass
class LargeErrors:
    """The largest errors of a dataset, in descending order; of neighbours in time with one sign only the worst."""

    most: int
    errors: list[LargeError] = field(default_factory=list)

    def merge(self, later: "LargeErrors") -> None:
        """Take in the errors of the following part."""
        self.errors = sorted([*self.errors, *later.errors], key=lambda error: (-error.size, error.sample))[: self.most]


@dataclass
class ErrorDetails:
    """Second pass: quantiles, autocorrelation, largest and rare errors, and the degrees of freedom that they have.

    `samples` are absolute errors, relative errors and leverages of each part, if they are kept.
    """

    searches: ErrorSearches
    products: LaggedProducts | None
    largest: LargeErrors
    rare: RareErrors
    freedom: float
    samples: list[tuple[Float, Float, Float]]

    def merge(self, later: "ErrorDetails") -> None:
        """Take in the details of the following part."""
        self.searches.merge(later.searches)
        if self.products is not None and later.products is not None:
            self.products.merge(later.products)
        self.largest.merge(later.largest)
        self.rare.merge(later.rare)
        self.freedom += later.freedom
        self.samples += later.samples


def largest_places(series: CriterionSeries, count: int) -> tuple[Int, Float]:
    """Find the samples with the largest errors of a part, Int[count], and the size of all errors; -1 if not scored.

    Of samples in a row whose errors have one sign, only the one with the largest error counts.
    """
    size = np.abs(series.error)
    if not np.isfinite(size).all():
        # a simulation that is not a number is the largest error
        size = np.where(series.scored, np.nan_to_num(size, nan=np.inf), -1.0)
    firsts = np.arange(size.size) if series.time is None else _begin_runs(series)
    peaks = np.maximum.reduceat(size, firsts) if size.size else size
    runs = np.arange(peaks.size)
    if peaks.size > count:
        # a selection instead of a sort of all runs
        runs = np.argpartition(peaks, -count)[-count:]
    ends = np.append(firsts[1:], size.size)
    places = [firsts[run] + np.argmax(size[firsts[run] : ends[run]]) for run in runs[peaks[runs] >= 0]]
    return np.array(places, dtype=np.int64), size


def _begin_runs(series: CriterionSeries) -> Int:
    """Return the first sample of each run of errors of one sign, or of samples that are not scored."""
    kinds = (series.error > 0).astype(np.int8)
    kinds[~series.scored] = 2
    fresh = np.ones(kinds.size, dtype=bool)
    np.not_equal(kinds[1:], kinds[:-1], out=fresh[1:])
    # an event ends with its piece
    fresh[series.bound.starts] = True
    return np.flatnonzero(fresh)
