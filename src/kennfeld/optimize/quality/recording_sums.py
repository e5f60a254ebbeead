"""Sums of the errors over the samples of each file, and the search for its worst stretch.

The samples of a file are divided into `BINS` bins of equal length, over which squared errors are summed. A window is
1/20 of them, and at least `LEAST_SECONDS` and `LEAST_SAMPLES` long; it may begin at each bin. Windows in which less
than half as many samples are scored as in an average one are ignored, as a few large errors are no stretch.

A file may arrive in parts, which are merged. Once it is complete, only its worst stretch is kept.
"""

from collections.abc import Iterator, Sequence
from dataclasses import field

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.file_spans import FileSpans
from kennfeld.optimize.quality.recording_quality import LEAST_SECONDS, SHARE, RecordingQuality, WorstStretch
from kennfeld.preprocessing.bound_parts import BoundPart

BINS = 160  # of a file, at most
LEAST_SAMPLES = 5
ENOUGH = 0.5  # share of the scored samples of an average window


@dataclass(frozen=True, eq=False)
class ScoredErrors:
    """The errors of a criterion at scored samples of a part; `samples` are their numbers, None if all are scored."""

    samples: Int | None
    target: Float
    before: Float
    after: Float


@dataclass
class _Bins:
    """Sums over the bins of a file, Float[criteria, bins], and the times of their first and last samples, or NaN."""

    begins: Float
    ends: Float
    counts: Int
    squares: Float

    def merge(self, later: "_Bins") -> None:
        # of a bin that two parts share, the first one has the beginning and the later one the end
        self.begins = np.where(np.isnan(self.begins), later.begins, self.begins)
        self.ends = np.where(np.isnan(later.ends), self.ends, later.ends)
        self.counts = self.counts + later.counts
        with np.errstate(over="ignore", invalid="ignore"):
            self.squares = self.squares + later.squares

    @property
    def is_timed(self) -> bool:
        """True if the times are known and rise; those of several recordings without file names do not."""
        begins, ends = self.begins, self.ends
        # false for NaN as well, where a bin has no samples or there is no time
        return bool((ends >= begins).all() and (begins[1:] >= ends[:-1]).all())


@dataclass
class FileSums:
    """The errors over the samples of a file that have arrived, `seen` of `length`; arrays are by criterion."""

    name: str
    length: int
    seen: int
    counts: Int
    before: Float  # sums of squares
    after: Float
    largest: Float
    bins: _Bins | None
    worst: list[WorstStretch | None] = field(default_factory=list)

    def continues(self, later: "FileSums") -> bool:
        """Return whether a later part belongs to the same file."""
        return self.name == later.name and self.seen + later.seen <= self.length == later.length

    def merge(self, later: "FileSums") -> None:
        """Take in later samples of the same file."""
        assert self.bins is not None
        assert later.bins is not None
        self.seen += later.seen
        self.counts = self.counts + later.counts
        with np.errstate(over="ignore", invalid="ignore"):
            self.before, self.after = self.before + later.before, self.after + later.after
        self.largest = np.maximum(self.largest, later.largest)
        self.bins.merge(later.bins)

    def close(self) -> None:
        """Replace the sums over bins by the worst stretches."""
        if self.bins is not None:
            rows = zip(self.bins.counts, self.bins.squares, strict=True)
            self.worst = [_find_worst(self.bins, counts, squares, self.length) for counts, squares in rows]
            self.bins = None

    def quality(self, number: int, criterion: str, data: Dataset, file: str | None) -> RecordingQuality:
        """Return the row of a criterion, by number; the file is closed."""
        count = int(self.counts[number])
        before, after = (
            float(np.sqrt(sums[number] / count)) if count else float("nan") for sums in (self.before, self.after)
        )
        return RecordingQuality(
            criterion=criterion,
            dataset=data.name,
            file=file,
            use=data.use,
            samples=count,
            rmse_before=before,
            rmse_after=after,
            max_abs_after=float(self.largest[number]) if count else float("nan"),
            worst=self.worst[number],
        )


@dataclass
class RecordingSums:
    """The errors over the files of a dataset, in their order."""

    files: list[FileSums]

    @classmethod
    def of(cls, part: BoundPart, errors: Sequence[ScoredErrors]) -> "RecordingSums":
        """Return the sums over a part, given the errors of each criterion."""
        whole = part.whole.dataset
        if part.begin == part.end:
            return cls([])
        files = whole.files or FileSpans.joined([""], [whole.samples])
        return cls(list(_file_sums(files.cut(part.begin, part.end), part, errors)))

    def close(self) -> None:
        """Replace the sums over bins by the worst stretches, once all samples have arrived."""
        for file in self.files:
            file.close()

    def merge(self, later: "RecordingSums") -> None:
        """Take in the sums over later samples."""
        rest = list(later.files)
        if self.files and rest and self.files[-1].bins is not None and self.files[-1].continues(rest[0]):
            self.files[-1].merge(rest.pop(0))
            if self.files[-1].seen == self.files[-1].length:
                self.files[-1].close()
        self.files += rest


def _file_sums(files: FileSpans, part: BoundPart, errors: Sequence[ScoredErrors]) -> Iterator[FileSums]:
    samples, whole = part.end - part.begin, part.whole.dataset
    time = None if whole.time is None else whole.time[part.begin : part.end]
    bins = [-(-length // _bin_size(length)) for length in files.lengths.tolist()]
    each = zip(files.starts.tolist(), files.lengths.tolist(), bins, strict=True)
    edges = np.clip(np.concatenate([np.zeros(0, dtype=np.int64), *(_bin_edges(*file) for file in each)]), 0, samples)
    ends = np.cumsum(np.array(bins, dtype=np.int64) + 1)  # of the edges of each file
    sums = [_SegmentSums.of(own, edges, ends) for own in errors]
    for number, (name, length, seen) in enumerate(zip(files.names, files.lengths, files.sizes(samples), strict=True)):
        last, first = int(ends[number]), int(ends[number]) - bins[number] - 1
        here = slice(first, last - 1)  # segments, which are one fewer than edges
        counts, squares = (np.array([getattr(own, key)[here] for own in sums]) for key in ("counts", "squares"))
        file = FileSums(
            name=name,
            length=int(length),
            seen=int(seen),
            counts=counts.sum(axis=1, dtype=np.int64),
            before=np.array([own.before[number] for own in sums]),
            after=np.array([own.after[number] for own in sums]),
            largest=np.array([own.largest[number] for own in sums]),
            bins=_Bins(*_bin_times(time, edges[first:last]), counts, squares),
        )
        if file.seen == file.length:
            file.close()
        yield file


def _bin_size(length: int) -> int:
    return max(-(-length // BINS), 1)


def _bin_edges(start: int, length: int, bins: int) -> Int:
    edges: Int = start + np.minimum(_bin_size(length) * np.arange(bins + 1), length)
    return edges


def _bin_times(time: Float | None, edges: Int) -> tuple[Float, Float]:
    """Return the times of the first and last sample of each bin; NaN without samples."""
    begins, ends = np.full((2, edges.size - 1), np.nan)
    if time is not None:
        filled = np.diff(edges) > 0
        begins[filled], ends[filled] = time[edges[:-1][filled]], time[edges[1:][filled] - 1]
    return begins, ends


@dataclass(frozen=True, eq=False)
class _SegmentSums:
    """The errors of a criterion by segment between two edges, and by file."""

    counts: Int
    squares: Float
    before: Float
    after: Float
    largest: Float

    @classmethod
    def of(cls, errors: ScoredErrors, edges: Int, ends: Int) -> "_SegmentSums":
        # from samples to scored ones
        places = edges if errors.samples is None else np.searchsorted(errors.samples, edges)
        # first and last edge of each file
        of_files = places[np.append(0, ends[:-1])], places[ends - 1]
        with np.errstate(over="ignore", invalid="ignore"):
            squares = errors.after * errors.after
            return cls(
                counts=np.diff(places),
                squares=_reduce(np.add, squares, places[:-1], places[1:]),
                before=_reduce(np.add, errors.before * errors.before, *of_files),
                after=_reduce(np.add, squares, *of_files),
                largest=_reduce(np.maximum, np.abs(errors.after), *of_files),
            )


def _reduce(operation: np.ufunc, values: Float, firsts: Int, lasts: Int) -> Float:
    """Return a ufunc over segments that follow each other without a gap, and cover all values; 0 over empty ones."""
    reduced = np.zeros(firsts.size)
    filled = lasts > firsts
    if filled.any():
        # `reduceat` gives the element itself for an empty segment
        reduced[filled] = operation.reduceat(values, firsts[filled])
    return reduced


def _find_worst(bins: _Bins, counts: Int, squares: Float, length: int) -> WorstStretch | None:
    total = int(counts.sum())
    if not total:
        return None
    is_timed = bins.is_timed
    width = _window(bins, length, is_timed=is_timed)
    window = np.ones(width)
    scored = np.correlate(counts.astype(np.float64), window)
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.correlate(squares, window) / np.maximum(scored, 1.0)
    # below any mean square, so that it is never the worst
    eligible = np.where(scored >= ENOUGH * total * width / counts.size, size, -1.0)
    # errors that are not finite are the worst
    at = int(np.argmax(np.where(np.isnan(eligible), np.inf, eligible)))
    rmse = float(np.sqrt(size[at]))
    if is_timed:
        return WorstStretch(float(bins.begins[at]), float(bins.ends[at + width - 1]), rmse, "s")
    step = _bin_size(length)
    return WorstStretch(at * step + 1, min((at + width) * step, length), rmse, "samples")


def _window(bins: _Bins, length: int, *, is_timed: bool) -> int:
    """Return the width of a window in bins."""
    count = bins.begins.size
    # bins for 1/20 of the file, and for the least number of samples
    width = max(-(-count // SHARE), -(-LEAST_SAMPLES // _bin_size(length)))
    if is_timed:
        duration = float(bins.ends[-1] - bins.begins[0])
        width = max(width, int(np.ceil(count * LEAST_SECONDS / duration)) if duration > LEAST_SECONDS else count)
    return min(width, count)
