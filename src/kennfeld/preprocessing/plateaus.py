"""Plateaus: the stretches of a recording over which channels stay constant, averaged to steady-state points."""

import heapq
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import count_noun
from kennfeld.domain.dataset import Dataset, longest_usual_step
from kennfeld.preprocessing.recipe import DatasetEntry

_TIME_TOLERANCE = 1e-6  # s; time stamps are further apart
_ROUNDING = 1e-9  # of a band's width, for limits that values meet exactly


def steady_points(dataset: Dataset, entry: DatasetEntry) -> tuple[Dataset, Finding]:
    """Return a dataset with a point for each plateau of a recording, and a remark on the plateaus.

    A plateau is a stretch of at least the longest `window` in which every channel of `steady` stays within a band of
    +-tolerance. Samples that are not scored, or lack one of these channels, are excluded from the means; a run of them
    that lasts longer than `max_gap` ends a plateau, as a pause and the end of a piece do.

    Args:
        dataset: a recording with time stamps.
        entry: its settings.

    Raises:
        InputError: there is no plateau; the message says which tolerance or window would give one.
    """
    if dataset.time is None:
        raise AssertionError("plateaus require time stamps")
    search = _PlateauSearch(dataset, dataset.time, entry)
    ranges = find_plateaus(search.time, search.first, search.window) if search.time.size else []
    location = entry.location.within("steady")
    if not ranges:
        raise InputError.of(location, *search.explain_none())
    remark = Finding(location, search.describe(ranges), severity="remark")
    return average_plateaus(dataset, search.counts, ranges), remark


def segment_starts(time: Float, starts: Int, counts: Bool, max_gap: float) -> Int:
    """Find the first sample of each segment without a gap, numbered among the samples that count.

    A gap is a run of samples that do not count and lasts longer than `max_gap` from the sample before it to that after
    it, or a time step longer than that and than `PAUSE` usual ones. A piece starts a segment too.

    Args:
        time: time stamps in s; Float[samples].
        starts: first sample of each piece; Int[pieces].
        counts: samples that count; Bool[samples].
        max_gap: s.

    >>> time, first = np.arange(6.0), np.zeros(1, dtype=int)
    >>> segment_starts(time, first, np.array([True, True, False, True, True, True]), 0.0)
    array([0, 2])
    >>> segment_starts(time, first, np.array([True, True, False, True, True, True]), 2.0)
    array([0])
    """
    kept = np.flatnonzero(counts)
    if kept.size < 2:
        return np.zeros(kept.size, dtype=np.int64)
    steps, piece = np.diff(time[kept]), np.searchsorted(starts, kept, side="right")
    within = np.diff(time)[np.diff(np.searchsorted(starts, np.arange(time.size), side="right")) == 0]
    pause = max(longest_usual_step(within), max_gap) if within.size else np.inf
    gap = np.where(np.diff(kept) > 1, steps > max_gap + _TIME_TOLERANCE, steps > pause)
    return np.concatenate([[0], np.flatnonzero(gap | (np.diff(piece) > 0)) + 1])


def first_in_band(values: Float, tolerance: float, starts: Int) -> Int:
    """Find for each sample the first one from which the values up to it stay within a band of +-tolerance.

    `values` Float[samples] and `tolerance` have the same unit; values in a band are at most two tolerances apart.
    `starts` are the first samples of the segments, Int[segments]. Runs in linear time, whatever the length of the
    stretches (two monotone queues).

    >>> first_in_band(np.array([0.0, 1.0, 2.0, 3.0]), 1.0, np.array([0]))
    array([0, 0, 0, 1])
    """
    first = np.empty(values.size, dtype=np.int64)
    width = 2.0 * tolerance * (1.0 + _ROUNDING)
    for begin, end in pairwise([*starts.tolist(), values.size]):
        # as a list: a Python loop reads single elements of an array slowly
        first[begin:end] = _first_of_band(values[begin:end].tolist(), width)
        first[begin:end] += begin
    return first


class _SlidingRange:
    """The range of the values in a sliding window.

    `falling` holds the candidates for the maximum of the window and `rising` those for its minimum: a value leaves its
    queue as soon as a later one is at least as extreme.
    """

    def __init__(self, values: list[float]) -> None:
        self.values = values
        self.falling: deque[int] = deque()
        self.rising: deque[int] = deque()

    def append(self, index: int) -> None:
        values, falling, rising = self.values, self.falling, self.rising
        while falling and values[falling[-1]] <= values[index]:
            falling.pop()
        while rising and values[rising[-1]] >= values[index]:
            rising.pop()
        falling.append(index)
        rising.append(index)

    def drop_before(self, first: int) -> None:
        for queue in (self.falling, self.rising):
            while queue[0] < first:
                queue.popleft()

    @property
    def width(self) -> float:
        return self.values[self.falling[0]] - self.values[self.rising[0]]


def _first_of_band(values: list[float], width: float) -> list[int]:
    """Return the same for one segment."""
    window, firsts, first = _SlidingRange(values), [], 0
    for index in range(len(values)):
        window.append(index)
        while window.width > width:
            # the range cannot shrink before the older of its two extremes has gone
            first = min(window.falling[0], window.rising[0]) + 1
            window.drop_before(first)
        firsts.append(first)
    return firsts


def find_plateaus(time: Float, first: Int, window: float) -> list[tuple[int, int]]:
    """Find the stretches of at least `window` s as first and last sample, in the order of time, without overlap.

    `time` is in s, Float[samples], and `first` the result of `first_in_band`. If stretches overlap, the longest is kept
    whole, and the remainders of the others if they are long enough.

    >>> find_plateaus(np.arange(8.0), np.array([0, 0, 0, 0, 2, 4, 5, 6]), 2.0)
    [(0, 3)]
    """
    least = window - _TIME_TOLERANCE
    last = np.append(np.diff(first) > 0, True)  # the next sample's band no longer reaches back as far
    stretches = [(int(first[end]), int(end)) for end in np.flatnonzero(last[: first.size])]
    # minus the length, so that the heap has the longest first
    heap = [(-length, begin, end) for begin, end in stretches if (length := float(time[end] - time[begin])) >= least]
    heapq.heapify(heap)
    begins: list[int] = []
    ends: dict[int, int] = {}
    while heap:
        _, begin, end = heapq.heappop(heap)
        free = _uncovered(begin, end, begins, ends)
        if free == (begin, end):
            insort(begins, begin)
            ends[begin] = end
        # a remainder competes again by its own length: another stretch may be the longest there
        elif free[0] < free[1] and (length := float(time[free[1]] - time[free[0]])) >= least:
            heapq.heappush(heap, (-length, *free))
    return [(begin, ends[begin]) for begin in begins]


def _uncovered(begin: int, end: int, begins: Sequence[int], ends: dict[int, int]) -> tuple[int, int]:
    """Return the part of a stretch that no plateau covers; none lies inside it, since longer ones came first."""
    position = bisect_left(begins, begin)
    if position and ends[begins[position - 1]] >= begin:
        begin = ends[begins[position - 1]] + 1
    if position < len(begins) and begins[position] <= end:
        inner = begins[position]
        if inner <= begin:
            return ends[inner] + 1, end
        end = inner - 1
    return begin, end


def longest_stretch(time: Float, first: Int) -> tuple[float, float]:
    """Find the length of the longest stretch and its first time stamp, in s; there must be samples.

    `time` is in s, Float[samples]; `first` is the result of `first_in_band`, Int[samples].
    """
    lengths = time - time[first]
    last = int(np.argmax(lengths))
    return float(lengths[last]), float(time[first[last]])


def least_tolerance(time: Float, values: Float, starts: Int, window: float) -> float:
    """Find the smallest tolerance that gives a stretch of `window` s; infinite if no segment is that long.

    `time` is in s, Float[samples]; `values` Float[samples] are in the unit of the tolerance; `starts` as in
    `first_in_band`.

    >>> least_tolerance(np.arange(4.0), np.array([0.0, 4.0, 5.0, 9.0]), np.array([0]), 1.0)
    0.5
    """
    segments = pairwise([*starts.tolist(), values.size])
    widths = [_narrowest(time[begin:end], values[begin:end].tolist(), window) for begin, end in segments]
    return min(widths, default=np.inf) / 2.0


def _narrowest(time: Float, values: list[float], window: float) -> float:
    """Return the width of the narrowest band of any stretch of a segment that is just long enough."""
    # the latest sample that lies a window before each one; -1 if the segment is not that long yet
    begins = (np.searchsorted(time, time - window + _TIME_TOLERANCE, side="right") - 1).tolist()
    band, least = _SlidingRange(values), np.inf
    for index, begin in enumerate(begins):
        band.append(index)
        if begin >= 0:
            band.drop_before(begin)
            least = min(least, band.width)
    return least


def average_plateaus(dataset: Dataset, counts: Bool, ranges: Sequence[tuple[int, int]]) -> Dataset:
    """Average each plateau to a steady-state point: the mean of each channel, without NaN.

    `counts` marks the samples that count, Bool[samples]; `ranges` holds the first and the last one of each plateau,
    numbered among them.
    """
    channels = []
    for channel in dataset.channels:
        values = channel.values[counts]
        means = [_mean(values[begin : end + 1]) for begin, end in ranges]
        channels.append(replace(channel, values=np.array(means, dtype=np.float64)))
    # a point belongs to the file in which its plateau begins
    firsts = np.flatnonzero(counts)[[begin for begin, _ in ranges]]
    return replace(
        dataset,
        channels=tuple(channels),
        time=None,
        piece_starts=np.zeros(1, dtype=np.int64),
        scored=None,
        recorded=None,
        max_gap=0.0,
        warmup=0.0,
        files=None if dataset.files is None else dataset.files.picked(firsts),
    )


def _mean(values: Float) -> float:
    """Return the mean without NaN, computed relative to the first value so that a constant is its own mean exactly."""
    known = values[~np.isnan(values)]
    return float(known[0] + np.mean(known - known[0])) if known.size else np.nan


class _PlateauSearch:
    """The scored samples of a recording that have all channels of `steady`, in segments without a gap."""

    def __init__(self, dataset: Dataset, time: Float, entry: DatasetEntry) -> None:
        self.entry, self.dataset, self.recorded = entry, dataset, time
        self.window = max(condition.window for condition in entry.steady)
        self.counts = dataset.counting.copy()
        for condition in entry.steady:
            self.counts &= np.isfinite(dataset[condition.channel].values)
        self.time = time[self.counts]
        self.starts = segment_starts(time, dataset.piece_starts, self.counts, entry.max_gap)
        self.values = [dataset[condition.channel].values[self.counts] for condition in entry.steady]
        self.firsts: list[Int] = [
            first_in_band(values, condition.tolerance, self.starts)
            for values, condition in zip(self.values, entry.steady, strict=True)
        ]
        # all channels are in their bands from the latest of these samples on
        self.first: Int = np.maximum.reduce(self.firsts)

    def describe(self, ranges: Sequence[tuple[int, int]]) -> str:
        """Return the number of plateaus, their lengths and their share of the recording."""
        lengths = [float(self.time[end] - self.time[begin]) for begin, end in ranges]
        total = sum(float(self.recorded[piece.stop - 1] - self.recorded[piece.start]) for piece in self.dataset.pieces)
        sizes = " to ".join(dict.fromkeys(f"{length:.3g} s" for length in (min(lengths), max(lengths))))
        share = f"{sum(lengths) / total:.0%} of the {total:.4g} s recorded"
        return f"{count_noun(len(ranges), 'plateau')} of {sizes}, {share}"

    def explain_none(self) -> tuple[str, str]:
        """Return why there is no plateau, and the remedy."""
        if not self.time.size:
            names = ", ".join(condition.channel for condition in self.entry.steady)
            return f"no scored sample has {names}", "Check the channel, and the condition `where`."
        ends = np.append(self.starts[1:], self.time.size) - 1
        longest_segment = float(np.max(self.time[ends] - self.time[self.starts]))
        if longest_segment < self.window:
            message = (
                f"no part of the recording without a gap is {self.window:g} s long; the longest is "
                f"{longest_segment:.3g} s"
            )
            return message, f"Shorten the window, or raise max_gap = {self.entry.max_gap:g}."
        return self._explain_bands()

    def _explain_bands(self) -> tuple[str, str]:
        length, begin = longest_stretch(self.time, self.first)
        bands = " and ".join(f"{condition.channel} within +-{condition.tolerance:g}" for condition in self.entry.steady)
        message = f"no stretch of {self.window:g} s has {bands}; the longest is {length:.3g} s, from {begin:.6g} s"
        if len(self.entry.steady) > 1:
            alone = [
                f"{condition.channel} {longest_stretch(self.time, first)[0]:.3g} s"
                for condition, first in zip(self.entry.steady, self.firsts, strict=True)
            ]
            return f"{message}; each alone: {', '.join(alone)}", "Raise a tolerance, or shorten the window."
        least = _round_up(least_tolerance(self.time, self.values[0], self.starts, self.window))
        return message, f"tolerance = {least:g} would give one."


def _round_up(value: float) -> float:
    """Return the value rounded up to three digits, so that it suffices as written.

    >>> _round_up(13.3333)
    13.4
    """
    if not value > 0:
        return value
    # of the third digit; the quotient below may exceed a whole number by its rounding
    unit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.3g}")
