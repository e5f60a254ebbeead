"""Estimation of the time shift of recorded channels: the shift with which the model fits the data best.

First whole samples: a short fit at every lag within a window, starting from the values at the neighbouring lag; the
best few are fitted again from the start values. A full scan is needed since a fit at one lag does not show in which
direction a better one lies: with points in arbitrary order, values that fit a wrong lag fit no other. All fits are
scored on the same samples, those that every lag leaves available.

Then the neighbouring lags: the search continues while a neighbour is better, and the vertex of the parabola through the
best three costs gives the fraction of a sample. Recorded values are not interpolated for that, since interpolation
averages noise and so favours lags between samples.

A window whose best lag is at its edge is doubled, up to `WIDEST` samples and a quarter of the recording, and scanned
again. Both sides are widened, since the edge nearer to a distant minimum need not have the lower cost.

With data in partitions, lags are scanned on a part of the recordings, which depends on the files and their lengths
alone, and the neighbouring lags are compared on all of them.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from kennfeld.base.errors import Finding, Findings, Location
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.ends.zero_slopes import departure
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.preprocessing.time_shift import inside_pieces, shift_channels

MIN_LIKELIHOOD_RATIO = 10.0  # as a difference of -2 log L, from which another lag is ruled out
NEIGHBOURHOOD = 2.0  # samples around a lag in time within which others are about as good
EDGE_DISTANCE = 0.6  # samples

WINDOW = 20  # samples to either side
WIDEST = 8 * WINDOW  # of a window that was widened
SCANNED_SAMPLES = 300_000  # of data in partitions
ROUNDS = 3  # scans of each lag, if there are several
CANDIDATES = 3  # lags that are fitted again from the start values
WHOLE_LAG_TOLERANCE = 0.05  # of a sample
ROUGH = SolverSettings(max_iterations=30, tolerance=1e-5, patience=2)
SCAN = SolverSettings(max_iterations=5, tolerance=1e-2, patience=1)

Shifts = Mapping[str, Mapping[str, float]]  # by dataset and channel; s, for steady-state data samples


@dataclass(frozen=True)
class Minimum:
    """The estimated lag of a channel, and the mean costs of the fits at all lags of the window."""

    channel: str
    dataset: str
    shift: float  # in `unit`
    step: float  # length of a sample in `unit`
    unit: Literal["s", "samples"]  # samples for steady-state data
    lag: float  # the shift in samples
    most: int  # half the width of the window in samples
    costs: Mapping[float, float]  # mean cost by lag in samples
    scored: int  # number of scored samples

    @property
    def at_the_end(self) -> bool:
        """True if the lag is at the edge of the window."""
        return abs(self.lag) > self.most - EDGE_DISTANCE

    @property
    def rival(self) -> float:
        """The best of the other lags, without close neighbours in time."""
        near = 0.5 if self.unit == "samples" else NEIGHBOURHOOD
        others = [lag for lag in self.costs if abs(lag - self.lag) > near] or list(self.costs)
        return min(others, key=lambda lag: self.costs[lag])

    @property
    def clear(self) -> bool:
        """True if the data rule out the rival, assuming independent errors."""
        best, other = min(self.costs.values()), self.costs[self.rival]
        # an exact fit, or lags at which no fit exists
        if not (np.isfinite(other) and best > 0):
            return not other <= best
        # -2 log L of n normal errors of unknown variance is n log(mean square)
        return self.scored * float(np.log(other / best)) > MIN_LIKELIHOOD_RATIO

    @property
    def errors(self) -> str:
        """The errors at the lag and at the best of the others."""
        best, other = (float(np.sqrt(cost)) for cost in (min(self.costs.values()), self.costs[self.rival]))
        shift, rival = f"{self.shift:g} {self.unit}", f"{self.rival * self.step:g} {self.unit}"
        return f"the error is {best:.4g} at {shift} and {other:.4g} at {rival}"

    def __str__(self) -> str:
        name = f"{self.channel} in {self.dataset}"
        if self.clear:
            return f"The estimated shift of {name} is {self.shift:g} {self.unit}: {self.errors}."
        return f"The estimated shift of {name} is ambiguous: {self.errors}. Set it to a number."


def describe_shifts(minima: Sequence[Minimum]) -> str:
    """Describe the estimated lags, those at the edge of their window first."""
    sentences = []
    for most in sorted({m.most for m in minima if m.at_the_end}):
        names = ", ".join(f"{m.channel} in {m.dataset}" for m in minima if m.at_the_end and m.most == most)
        sentences.append(f"The estimated shift of {names} is at the edge of the search window ({most} samples).")
    return " ".join([*sentences, *(str(m) for m in minima if not m.at_the_end)])


def _find_doubtful(minima: Sequence[Minimum]) -> Iterator[Finding]:
    """Yield a warning for each estimated shift at the edge of its window, and for each ambiguous one."""
    for each in minima:
        name = f"the estimated shift of {each.channel}, {each.shift:g} {each.unit},"
        number = f"write it as a number, shift = {{ {each.channel} = ... }}"
        location = Location(f"shift of dataset {each.dataset}")
        if each.at_the_end:
            edge = f"{each.most} samples" if each.unit == "samples" else f"{each.most * each.step:g} s"
            message = f"{name} is at the edge of the search window, {edge} to either side; the delay may be longer"
            yield Finding(location, message, f"If it is known, {number}. {_wider(each)}", severity="warning")
        elif not each.clear:
            message = f"{name} is ambiguous: {each.errors}"
            yield Finding(location, message, f"If it is known, {number}.", severity="warning")


def _wider(minimum: Minimum) -> str:
    """Return how to search a wider window than that of a minimum at its edge."""
    if minimum.most < WIDEST:
        return "A longer recording has a wider window, up to a quarter of it."
    if minimum.unit == "samples":
        return f"More than {WIDEST} samples are not searched."
    return f"A coarser raster, such as raster = {10 * minimum.step:g}, has a wider window."


class EstimatedShifts(NamedTuple):
    """The estimated shifts of a problem.

    Attributes:
        problem: the problem with the channels of `unknown_shifts` shifted.
        shifts: the shifts by dataset and channel in s, or in samples for steady-state data.
        sentences: how distinct they are.
        warnings: shifts at the edge of their window, and ambiguous ones.
    """

    problem: Problem
    shifts: dict[str, dict[str, float]]
    sentences: str
    warnings: tuple[Finding, ...]


def apply_shifts(problem: Problem, shifts: Shifts) -> Problem:
    """Return the problem with channels of its datasets shifted by known times."""
    if not shifts:
        return problem
    datasets = tuple(shift_channels(data, shifts.get(data.name, {})) for data in problem.datasets)
    partitions = problem.partitions
    if partitions is not None:
        partitions = partitions.shifted(shifts)
    return replace(problem, datasets=datasets, partitions=partitions, unknown_shifts={})


def estimate_shifts(problem: Problem) -> EstimatedShifts:
    """Estimate the automatic shifts of a problem.

    A shift is estimated for each training dataset that has it as automatic; test datasets get the median of these, so
    that they remain unseen.

    Raises:
        InputError: a channel is not used by the problem, or its shift is automatic in test data only.
    """
    sought = _find_channels(problem)
    scanned, remark = _part_to_scan(problem)
    search = _ShiftSearch(scanned, sought)
    lags = search.scan()
    lags = (search.over_all(problem, lags) if remark else search).refine(lags)
    shifts: dict[str, dict[str, float]] = {}
    for at, lag in zip(sought, lags, strict=True):
        data = scanned.datasets[at.dataset]
        # rounds off the noise of the last digits; -0 becomes 0
        shifts.setdefault(data.name, {})[at.channel] = float(f"{lag * sample_time(data):.6g}") + 0.0
    for data in problem.datasets:
        for channel in problem.unknown_shifts.get(data.name, ()):
            if channel not in shifts.get(data.name, {}):
                known = [own[channel] for own in shifts.values() if channel in own]
                shifts.setdefault(data.name, {})[channel] = float(np.median(known))
    minima = [search.minimum(i, lag, shifts) for i, lag in enumerate(lags)]
    sentences = " ".join([describe_shifts(minima), *remark])
    return EstimatedShifts(apply_shifts(problem, shifts), shifts, sentences, tuple(_find_doubtful(minima)))


def _part_to_scan(problem: Problem) -> tuple[Problem, tuple[str, ...]]:
    """Return the problem with the data on which lags are scanned, in this process, and a remark if these are a part."""
    partitions = problem.partitions
    if partitions is None:
        return problem, ()
    excerpt = partitions.excerpt(SCANNED_SAMPLES)
    datasets = tuple(excerpt.get(data.name, data) for data in problem.datasets)
    scanned, whole = sum(data.samples for data in excerpt.values()), partitions.samples
    remark = f"Shifts were scanned on {scanned} of {whole} training samples, and compared with their neighbours on all."
    return replace(problem, datasets=datasets, partitions=None), (remark,) if scanned < whole else ()


@dataclass(frozen=True)
class _Sought:
    dataset: int
    channel: str


def _find_channels(problem: Problem) -> list[_Sought]:
    """Return the channels whose lags are estimated on training data."""
    inputs = {problem.channels.get(name, name) for name in problem.model.graph.inputs}
    targets = {c.target.name for c in problem.criteria if problem.target_node(c) is None and c.target.name}
    used, sought = inputs | targets, []
    findings = [*_ambiguous_names(problem)]
    shifts = [
        (i, data, channel)
        for i, data in enumerate(problem.datasets)
        for channel in problem.unknown_shifts.get(data.name, ())
    ]
    for number, data, channel in shifts:
        if channel not in used or channel not in data:
            remedy = nearest(channel, used) or f"Name one of {', '.join(sorted(used))}."
            message = f"{channel} is neither an input of the function nor a target"
            findings.append(Finding(Location(f"shift of dataset {data.name}"), message, remedy))
        elif data.is_fitted:
            sought.append(_Sought(number, channel))
    estimated = {at.channel for at in sought}
    for _, data, channel in shifts:
        if channel not in estimated and channel in used and channel in data:
            message = f'shift = "auto" for {channel} must be set on a training dataset'
            location = Location(f"shift of dataset {data.name}")
            findings.append(Finding(location, message, "Set it there, or use a number."))
    Findings(dict.fromkeys(findings)).finish()
    return sought


def _ambiguous_names(problem: Problem) -> Iterator[Finding]:
    names = Counter(d.name for d in problem.datasets if d.use == "training" and problem.unknown_shifts.get(d.name))
    for name, count in names.items():
        if count > 1:
            message = f"{count} training datasets of this name have an automatic shift"
            yield Finding(Location(f"dataset {name}"), message, "Give each dataset a unique name.")


class _ShiftSearch:
    """Searches for all lags in samples: one after the other, repeated if another one has changed."""

    def __init__(self, problem: Problem, sought: Sequence[_Sought]) -> None:
        self.problem, self.sought = problem, sought
        data = [problem.datasets[at.dataset] for at in sought]
        self.most, self.steps = [half_width(own) for own in data], [sample_time(own) for own in data]
        self.widest = [max(most, _greatest_half_width(own)) for most, own in zip(self.most, data, strict=True)]
        self.fits: dict[tuple[SolverSettings, tuple[float, ...]], tuple[float, ParameterSet]] = {}
        self.scans: dict[int, dict[float, float]] = {}
        self.compiled = CompiledProblem(self._shift([0.0] * len(sought)))
        limits = linear_limits(problem, self.compiled.values)
        objective = LeastSquaresObjective(self.compiled)
        projected, _ = project(objective.start, limits)
        off = None if projected is None else departure(objective, self.compiled, projected, limits)
        # the start values, moved off a saddle point
        self.begin = problem.parameters if off is None else self.compiled.parameters(off.values)

    def over_all(self, problem: Problem, lags: Sequence[float]) -> "_ShiftSearch":
        """Return the search over all data in partitions, from the values of the fit at these lags."""
        other = copy(self)
        other.problem, other.fits = problem, {}
        # by this search, on the data that were scanned
        other.begin = self._cached_fit(lags, self.begin, ROUGH)[1]
        other.compiled = CompiledProblem(other._shift(lags))
        return other

    def scan(self) -> list[float]:
        """Return the best whole lags within the windows, which are widened while one of the lags is at an edge."""
        lags = self._scan_windows([0.0] * len(self.sought))
        while self._widen(lags):
            lags = self._scan_windows(lags)
        return lags

    def _widen(self, lags: Sequence[float]) -> bool:
        """Double the windows whose lag is at an edge, if they may be wider; return False if none was."""
        wider = [
            min(2 * most, widest) if abs(lag) >= most - 1 else most  # the next fits may move a lag by a sample
            for lag, most, widest in zip(lags, self.most, self.widest, strict=True)
        ]
        if wider == self.most:
            return False
        self.most, self.fits = wider, {}  # fits in another window are scored on other samples
        return True

    def _scan_windows(self, lags: list[float]) -> list[float]:
        """Return the best whole lags within the windows as they are."""
        for _ in range(ROUNDS):
            before = list(lags)
            for which in range(len(lags)):
                lags = self._find_best(which, lags)
            if lags == before or len(lags) == 1:
                break
        return lags

    def refine(self, lags: list[float]) -> list[float]:
        """Return the best lags, starting at whole ones."""
        for i in range(len(lags)):
            lags = self._descend(i, lags)
        return [self._interpolate_lag(i, lags) for i in range(len(lags))]

    def _find_best(self, which: int, lags: Sequence[float]) -> list[float]:
        """Return the lags with one of them at its best within the window."""
        costs = self._scan(which, lags)
        self.scans[which] = costs
        # costs of the scan depend on the way there: the best, of equal ones the smaller shifts, are fitted again
        candidates = sorted(costs, key=lambda lag: (costs[lag], abs(lag)))[:CANDIDATES]
        for lag in candidates:
            trial = _with_lag(lags, which, lag)
            costs[lag] = min(costs[lag], self._fit(trial, self.begin, ROUGH)[0])
        return _with_lag(lags, which, min(candidates, key=lambda lag: (costs[lag], abs(lag))))

    def _scan(self, which: int, lags: Sequence[float]) -> dict[float, float]:
        """Return the cost of a fit at every whole lag of the window, from the current lag outwards."""
        here, most = round(lags[which]), self.most[which]
        cost, parameters = self._cached_fit(_with_lag(lags, which, here), self.begin, SCAN)
        costs = {float(here): cost}
        for side in (range(here + 1, most + 1), range(here - 1, -most - 1, -1)):
            # to each side, a fit begins at the values of the lag before it
            near = parameters
            for lag in side:
                costs[float(lag)], near = self._cached_fit(_with_lag(lags, which, lag), near, SCAN)
        return costs

    def _descend(self, which: int, lags: list[float]) -> list[float]:
        """Return the lags with one of them moved until no neighbour gives a better fit."""
        parameters = self._cached_fit(lags, self.begin, ROUGH)[1]
        for _ in range(WINDOW):
            sides = [_with_lag(lags, which, lags[which] + step) for step in (-1.0, 1.0)]
            costs = [self._cached_fit(side, parameters, ROUGH)[0] for side in sides]
            best = int(np.argmin(costs))
            if (
                costs[best] >= self._cached_fit(lags, parameters, ROUGH)[0]
                or abs(sides[best][which]) > self.most[which]
            ):
                break
            lags, parameters = sides[best], self._cached_fit(sides[best], parameters, ROUGH)[1]
        return lags

    def _interpolate_lag(self, which: int, lags: list[float]) -> float:
        """Return the vertex of the parabola through the costs at a lag and its neighbours; whole lags without time."""
        if self.problem.datasets[self.sought[which].dataset].time is None:
            return lags[which]
        parameters = self._cached_fit(lags, self.begin, ROUGH)[1]
        near = [_with_lag(lags, which, lags[which] + step) for step in (-1.0, 0.0, 1.0)]
        before, here, after = (self._cached_fit(at, parameters, ROUGH)[0] for at in near)
        bend = before - 2 * here + after
        # the parabola c(s) through c(-1), c(0) and c(1) has its vertex at s = (c(-1) - c(1)) / (2 c'')
        fraction = float(np.clip((before - after) / (2 * bend), -0.5, 0.5)) if bend > 0 else 0.0
        return lags[which] + (fraction if abs(fraction) > WHOLE_LAG_TOLERANCE else 0.0)

    def minimum(self, which: int, lag: float, shifts: Shifts) -> Minimum:
        """Return the minimum of the scan of a channel."""
        at = self.sought[which]
        data = self.problem.datasets[at.dataset]
        return Minimum(
            channel=at.channel,
            dataset=data.name,
            shift=shifts[data.name][at.channel],
            step=self.steps[which],
            unit="samples" if data.time is None else "s",
            lag=lag,
            most=self.most[which],
            costs=self.scans[which],
            scored=int(np.count_nonzero(self._shift([0.0] * len(self.sought)).datasets[at.dataset].counting)),
        )

    def _cached_fit(
        self, lags: Sequence[float], start: ParameterSet, settings: SolverSettings
    ) -> tuple[float, ParameterSet]:
        """Return the mean cost and the values of a short fit, from a cache by settings and lags."""
        key = settings, tuple(lags)
        if key not in self.fits:
            self.fits[key] = self._fit(lags, start, settings)
        return self.fits[key]

    def _fit(self, lags: Sequence[float], start: ParameterSet, settings: SolverSettings) -> tuple[float, ParameterSet]:
        problem = replace(self._shift(lags), parameters=start)
        compiled = self.compiled.over(problem)
        limits = linear_limits(problem, compiled.values)
        # a scan only compares, for which half the digits are enough
        objective = LeastSquaresObjective(compiled, by_rows=settings is not SCAN)
        begin, _ = project(objective.start, limits)
        if begin is None or not compiled.sample_count:
            return np.inf, start
        end = levenberg_marquardt(objective, begin, limits, settings)
        result = end.cost / compiled.weights, compiled.parameters(end.values)
        compiled.discard_samples()
        return result

    def _shift(self, lags: Sequence[float]) -> Problem:
        """Return the problem with shifted channels; only samples that every lag leaves available are scored."""
        shifts: dict[int, dict[str, float]] = {}
        margins: dict[int, int] = {}
        for at, lag, most, step in zip(self.sought, lags, self.most, self.steps, strict=True):
            shifts.setdefault(at.dataset, {})[at.channel] = lag * step
            # scored only where a shift by the whole window stays within the recording
            margins[at.dataset] = max(most, margins.get(at.dataset, 0))
        if self.problem.partitions is not None:
            names = [data.name for data in self.problem.datasets]
            moved = {names[number]: own for number, own in shifts.items()}
            ends = {names[number]: most for number, most in margins.items()}
            return replace(self.problem, partitions=self.problem.partitions.shifted(moved, ends))
        data = list(self.problem.datasets)
        for number, own in shifts.items():
            data[number] = exclude_ends(shift_channels(data[number], own), margins[number])
        return replace(self.problem, datasets=tuple(data))


def half_width(data: Dataset) -> int:
    """Return half the width of the window in samples: a quarter of the longest piece, at most `WINDOW`."""
    longest = int(np.diff([*data.piece_starts, data.samples]).max())
    return min(WINDOW, max(longest // 4, 1))


def _greatest_half_width(data: Dataset) -> int:
    """Return half the width up to which a window may grow: a quarter of the piece that the median sample is in."""
    lengths = np.diff([*data.piece_starts, data.samples])
    # not the median piece: many short ones may hold few of the samples
    typical = int(np.sort(lengths)[np.searchsorted(np.cumsum(np.sort(lengths)), data.samples / 2)])
    return min(WIDEST, max(typical // 4, 1))


def exclude_ends(data: Dataset, margin: int) -> Dataset:
    """Exclude the ends of the pieces of a dataset from scoring."""
    return replace(data, scored=data.counting & inside_pieces(data, margin, 0, data.samples))


def _with_lag(lags: Sequence[float], which: int, lag: float) -> list[float]:
    return [float(lag) if i == which else other for i, other in enumerate(lags)]


def sample_time(data: Dataset) -> float:
    """Return the sample time in s; 1 for steady-state data, which count in samples."""
    if data.time is None or data.samples < 2:
        return 1.0
    # without the jumps of time from one piece to the next
    return float(np.median(np.delete(np.diff(data.time), data.piece_starts[1:] - 1)))
