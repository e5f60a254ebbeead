"""Where channels of a recording stand still, and the mean of every channel over each such stretch.

The steady-state points of a recording, as a `[[dataset]]` asks for them, or why there are none.
"""

import heapq
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.dataset import PAUSE, Dataset
from kennfeld.errors import Finding
from kennfeld.preprocessing.recipe import DatasetEntry, SteadyEntry

__all__ = ["averaged", "least_tolerance", "longest", "plateaus", "segments", "steady_points", "stretches"]

_NEAR = 1e-6  # s; time stamps are no closer
_ROUNDING = 1e-9  # of a band's width, for limits that values meet exactly
_Run = tuple[float, int, int]  # minus the length in s, so that a heap has the longest first; first and last sample


def segments(time: Float, starts: Int, counts: Bool, max_gap: float) -> Int:
    """Where among the samples that count a piece, or what follows on a gap, begins.

    A gap is a row of samples that do not count and lasts longer than `max_gap` s from the sample before it to that
    after it, or a time step longer than that and than `PAUSE` usual ones.

    >>> time, first = np.arange(6.0), np.zeros(1, dtype=int)
    >>> segments(time, first, np.array([True, True, False, True, True, True]), 0.0)
    array([0, 2])
    >>> segments(time, first, np.array([True, True, False, True, True, True]), 2.0)
    array([0])
    """
    kept = np.flatnonzero(counts)
    if kept.size < 2:
        return np.zeros(kept.size, dtype=np.int64)
    steps, piece = np.diff(time[kept]), np.searchsorted(starts, kept, side="right")
    within = np.diff(time)[np.diff(np.searchsorted(starts, np.arange(time.size), side="right")) == 0]
    pause = max(PAUSE * float(np.median(within)), max_gap) if within.size else np.inf
    gap = np.where(np.diff(kept) > 1, steps > max_gap + _NEAR, steps > pause)
    return np.concatenate([[0], np.flatnonzero(gap | (np.diff(piece) > 0)) + 1])


def stretches(values: Float, tolerance: float, starts: Int) -> Int:
    """For each sample the first one from which the values up to it stay within a band of +-tolerance.

    Values in a band are at most two tolerances apart. `starts` are the samples at which no stretch goes on. Takes a
    time that grows with the number of samples alone, whatever the length of the stretches (two monotone queues).

    >>> stretches(np.array([0.0, 1.0, 2.0, 3.0]), 1.0, np.array([0]))
    array([0, 0, 0, 1])
    """
    first = np.empty(values.size, dtype=np.int64)
    width = 2.0 * tolerance * (1.0 + _ROUNDING)
    for begin, end in pairwise([*starts.tolist(), values.size]):
        first[begin:end] = _first_of_band(values[begin:end].tolist(), width)
        first[begin:end] += begin
    return first


def _first_of_band(values: list[float], width: float) -> list[int]:
    """The same for a segment: for each value the number of the first one that its band reaches back to."""
    falling: deque[int] = deque()  # candidates for the largest value of the band
    rising: deque[int] = deque()  # and for the smallest
    found, left = [], 0
    for at, value in enumerate(values):
        while falling and values[falling[-1]] <= value:
            falling.pop()
        while rising and values[rising[-1]] >= value:
            rising.pop()
        falling.append(at)
        rising.append(at)
        while values[falling[0]] - values[rising[0]] > width:
            oldest = falling if falling[0] < rising[0] else rising
            left = oldest.popleft() + 1
        found.append(left)
    return found


def plateaus(time: Float, first: Int, window: float) -> list[tuple[int, int]]:
    """The stretches of at least `window` s, as first and last sample, in the order of time; none overlaps another.

    `first` is what `stretches` found. Where stretches overlap, the longest counts; of the others what is left of
    them, if it is long enough.

    >>> plateaus(np.arange(8.0), np.array([0, 0, 0, 0, 2, 4, 5, 6]), 2.0)
    [(0, 3)]
    """
    heap = _candidates(time, first, window)
    begins: list[int] = []
    ends: dict[int, int] = {}
    while heap:
        _, begin, end = heapq.heappop(heap)
        free = _free(begin, end, begins, ends)
        if free == (begin, end):
            insort(begins, begin)
            ends[begin] = end
        elif free[0] < free[1] and (left := time[free[1]] - time[free[0]]) >= window - _NEAR:
            heapq.heappush(heap, (-float(left), *free))
    return [(begin, ends[begin]) for begin in begins]


def _candidates(time: Float, first: Int, window: float) -> list[_Run]:
    """The stretches that are part of no longer one, where they are long enough."""
    last = np.append(np.diff(first) > 0, True)  # the next sample's band no longer reaches back as far
    ends = np.flatnonzero(last[: first.size])
    lengths = time[ends] - time[first[ends]]
    long = lengths >= window - _NEAR
    heap = list(zip((-lengths[long]).tolist(), first[ends][long].tolist(), ends[long].tolist(), strict=True))
    heapq.heapify(heap)
    return heap


def _free(begin: int, end: int, begins: Sequence[int], ends: dict[int, int]) -> tuple[int, int]:
    """What no plateau takes of a stretch; none lies within it, since they came in the order of their length."""
    at = bisect_left(begins, begin)
    if at and ends[begins[at - 1]] >= begin:
        begin = ends[begins[at - 1]] + 1
    if at < len(begins) and begins[at] <= end:
        inner = begins[at]
        if inner <= begin:
            return ends[inner] + 1, end
        end = inner - 1
    return begin, end


def longest(time: Float, first: Int) -> tuple[float, float]:
    """The length in s of the longest stretch, and its first time stamp; both are of no use without samples."""
    lengths = time - time[first]
    at = int(np.argmax(lengths))
    return float(lengths[at]), float(time[first[at]])


def least_tolerance(time: Float, values: Float, starts: Int, window: float) -> float:
    """The smallest tolerance that gives a stretch of `window` s; infinite where no segment is that long.

    >>> least_tolerance(np.arange(4.0), np.array([0.0, 4.0, 5.0, 9.0]), np.array([0]), 1.0)
    0.5
    """
    least = np.inf
    for begin, end in pairwise([*starts.tolist(), values.size]):
        least = min(least, _narrowest(time[begin:end], values[begin:end].tolist(), window))
    return least / 2.0


def _narrowest(time: Float, values: list[float], window: float) -> float:
    """The narrowest band of any stretch of a segment that is just long enough."""
    begins = (np.searchsorted(time, time - window + _NEAR, side="right") - 1).tolist()
    falling: deque[int] = deque()
    rising: deque[int] = deque()
    least = np.inf
    for at, value in enumerate(values):
        while falling and values[falling[-1]] <= value:
            falling.pop()
        while rising and values[rising[-1]] >= value:
            rising.pop()
        falling.append(at)
        rising.append(at)
        if begins[at] < 0:
            continue
        while falling[0] < begins[at]:
            falling.popleft()
        while rising[0] < begins[at]:
            rising.popleft()
        least = min(least, values[falling[0]] - values[rising[0]])
    return least


def averaged(dataset: Dataset, counts: Bool, found: Sequence[tuple[int, int]]) -> Dataset:
    """Steady-state points: the mean of each channel over each plateau, NaN left out.

    `found` holds first and last sample of each, counted among the samples that count.
    """
    kept = np.flatnonzero(counts)
    edges = [(begin, end + 1) for begin, end in found]
    channels = tuple(replace(c, values=_means(c.values[kept], edges)) for c in dataset.channels)
    start = np.zeros(1, dtype=np.int64)
    return replace(dataset, channels=channels, time=None, starts=start, scored=None, max_gap=0.0, warmup=0.0)


def _means(values: Float, edges: Sequence[tuple[int, int]]) -> Float:
    parts = (values[begin:end] for begin, end in edges)
    return np.array([_mean(part[~np.isnan(part)]) for part in parts], dtype=np.float64)


def _mean(values: Float) -> float:
    """Relative to the first value, so that a constant is its own mean, bit for bit."""
    return float(values[0] + np.mean(values - values[0])) if values.size else np.nan


def steady_points(dataset: Dataset, entry: DatasetEntry, findings: list[Finding]) -> Dataset | None:
    """A point for each plateau of a recording; None, and a finding, where there is no plateau.

    A plateau is a stretch of at least the longest `window` in which every channel of `steady` stays within a band of
    +-tolerance. Samples that do not count, or lack one of these channels, are left out of the means; a row of them
    that lasts longer than `max_gap` ends a plateau, as a pause and the end of a piece do.
    """
    if dataset.time is None:
        raise AssertionError("checked before: there are time stamps")
    work = _Detection(dataset, entry)
    found = work.plateaus()
    if not found:
        message, remedy = work.why_none()
        findings.append(Finding(f"{entry.place} steady", message, remedy))
        return None
    findings.append(Finding(f"{entry.place} steady", work.told(found), severity="remark"))
    return averaged(dataset, work.counts, found)


class _Detection:
    """The samples of a recording that count, in segments without a gap."""

    def __init__(self, dataset: Dataset, entry: DatasetEntry) -> None:
        self.entry, self.whole = entry, dataset
        self.window = max(one.window for one in entry.steady)
        self.counts = _counting(dataset, [one.channel for one in entry.steady])
        stamps = dataset.time if dataset.time is not None else np.empty(0)
        self.time = stamps[self.counts]
        self.starts = segments(stamps, dataset.starts, self.counts, entry.max_gap)
        self.values = [dataset[one.channel].values[self.counts] for one in entry.steady]
        self.firsts: list[Int] = [
            stretches(values, one.tolerance, self.starts) for values, one in zip(self.values, entry.steady, strict=True)
        ]
        self.first: Int = np.maximum.reduce(self.firsts)

    def plateaus(self) -> list[tuple[int, int]]:
        """First and last sample of each plateau, among those that count."""
        return plateaus(self.time, self.first, self.window) if self.time.size else []

    def told(self, found: Sequence[tuple[int, int]]) -> str:
        """How many plateaus there are, and how much of the recording they cover."""
        lengths = [float(self.time[end] - self.time[begin]) for begin, end in found]
        stamps = self.whole.time if self.whole.time is not None else np.empty(0)
        total = sum(float(stamps[piece.stop - 1] - stamps[piece.start]) for piece in self.whole.pieces)
        sizes = " to ".join(dict.fromkeys(f"{length:.3g} s" for length in (min(lengths), max(lengths))))
        count = f"{len(found)} plateau{'s' * (len(found) > 1)} of {sizes}"
        return f"{count}, {sum(lengths) / total:.0%} of the {total:.4g} s recorded"

    def why_none(self) -> tuple[str, str]:
        """What stands in the way of a plateau, and what would give one."""
        if not self.time.size:
            names = ", ".join(one.channel for one in self.entry.steady)
            return f"no sample that counts has {names}", "Check the channel, and the condition `where`."
        ends = np.append(self.starts[1:], self.time.size) - 1
        whole = float(np.max(self.time[ends] - self.time[self.starts]))
        if whole < self.window:
            message = (
                f"no stretch of the recording without a gap is {self.window:g} s long; the longest has {whole:.3g} s"
            )
            return message, f"Shorten the window, or raise max_gap = {self.entry.max_gap:g}."
        return self._none_in_band()

    def _none_in_band(self) -> tuple[str, str]:
        length, begin = longest(self.time, self.first)
        bands = " and ".join(f"{one.channel} within +-{one.tolerance:g}" for one in self.entry.steady)
        message = f"no stretch of {self.window:g} s has {bands}; the longest has {length:.3g} s, from {begin:.6g} s on"
        if len(self.entry.steady) > 1:
            alone = [f"{one.channel} {longest(self.time, first)[0]:.3g} s" for one, first in self._each()]
            return f"{message}; each alone: {', '.join(alone)}", "Raise a tolerance, or shorten the window."
        least = _rounded_up(least_tolerance(self.time, self.values[0], self.starts, self.window))
        return message, f"tolerance = {least:g} would give one."

    def _each(self) -> list[tuple[SteadyEntry, Int]]:
        return list(zip(self.entry.steady, self.firsts, strict=True))


def _counting(dataset: Dataset, names: Sequence[str]) -> Bool:
    """The samples that are scored and have all channels."""
    counts = np.ones(dataset.samples, dtype=bool) if dataset.scored is None else dataset.scored.copy()
    for name in names:
        counts &= np.isfinite(dataset[name].values)
    return counts


def _rounded_up(value: float) -> float:
    """To three digits, so that it suffices as written.

    >>> _rounded_up(13.3333)
    13.4
    """
    if not value > 0:
        return value
    unit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.3g}")
