"""The samples of a project by file: extremes of signals over equal stretches of its time, and gaps."""

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.signals import SignalName
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Bool, Float, Int, runs_of
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.file_spans import FileSpans, short_names

MAX_GAPS = 50  # of a signal in a file that are listed
MAX_FILES = 200  # that are drawn


@dataclass(frozen=True)
class FileSpan:
    """The samples of one file within a dataset.

    Attributes:
        recording: number of the dataset among those that are used.
        path: of the file, as it was read; empty for data without files.
        name: of the file, as short as it is unique.
        first: number of its first sample in the dataset.
        last: number behind its last sample.
        begin: time stamp of its first sample in s, as recorded; of data without time 0.
        end: that of its last sample; of data without time the number of samples.
        timed: True if it has time stamps.
    """

    recording: int
    path: str
    name: str
    first: int
    last: int
    begin: float
    end: float
    timed: bool


@dataclass(frozen=True)
class FileGap:
    """Missing values of a signal in a file, from one time to another, as `FileSpan` counts it."""

    begin: float
    end: float


def file_spans(view: View) -> list[FileSpan]:
    """Return the files of all datasets, in order; a dataset without files is one without a name."""
    datasets = [recording.bound.dataset for recording in view.model.recordings]
    spans = [data.files or FileSpans.joined([""], [data.samples]) for data in datasets]
    names = short_names([path for each in spans for path in each.names])
    files = []
    for number, (data, each) in enumerate(zip(datasets, spans, strict=True)):
        for path, start, length in zip(each.names, each.starts.tolist(), each.lengths.tolist(), strict=True):
            first, last = max(start, 0), min(start + length, data.samples)
            if last <= first:
                continue
            begin, end = (0.0, float(last - first)) if data.time is None else data.time[[first, last - 1]].tolist()
            files.append(FileSpan(number, path, names[path], first, last, begin, end, data.time is not None))
    return files[:MAX_FILES]


def file_values(view: View, signal: SignalName, files: Sequence[FileSpan]) -> Iterator[Float]:
    """Yield a signal over the samples of each file, Float[samples of the file]; NaN where it is missing.

    Raises:
        KennfeldError: recordings that have it cannot be read.
    """
    whole: dict[int, Float] = {}
    for file in files:
        if file.recording not in whole:
            whole = {file.recording: _whole(view, view.model.recordings[file.recording], signal)}
        yield whole[file.recording][file.first : file.last]


def _whole(view: View, recording: LiveDataset, signal: SignalName) -> Float:
    """Return a signal over all samples of a dataset, also those that the model drops."""
    dataset = recording.bound.dataset
    if signal.kind == "channel" and signal.name in dataset:
        return dataset[signal.name].values
    values = np.full(dataset.samples, np.nan)
    with suppress(KeyError):  # other datasets may have the channel
        values[recording.bound.shown.kept] = view.signals.values(recording, signal)
    return values


def file_line(view: View, file: FileSpan, values: Float, pixels: int) -> Float:
    """Return minimum and maximum of a signal by stretch, Float[2 stretches] in turn; NaN for one without values.

    The stretches divide the time of the file, so that a pause of the recording is a hole in the line. There are as many
    as pixels, or half as many as samples if these are few, so that neighbours stay connected.
    """
    pixels = max(2, min(pixels, (file.last - file.first) // 2))
    edges = _edges(view, file, pixels)
    low, high = np.full(pixels, np.nan), np.full(pixels, np.nan)
    used = np.flatnonzero(np.diff(edges) > 0)
    if used.size:
        low[used] = np.fmin.reduceat(values, edges[used])
        high[used] = np.fmax.reduceat(values, edges[used])
    return np.ravel([low, high], order="F")


def _edges(view: View, file: FileSpan, pixels: int) -> Int:
    """Return the first sample of each stretch of a file, counted from its first one, Int[pixels + 1]."""
    count = file.last - file.first
    time = view.model.recordings[file.recording].bound.dataset.time
    if time is None:
        return np.linspace(0, count, pixels + 1).astype(np.int64)
    here = time[file.first : file.last]
    edges = np.searchsorted(here, np.linspace(file.begin, file.end, pixels + 1))
    edges[-1] = count
    return edges


def find_gaps(view: View, file: FileSpan, missing: Bool) -> list[FileGap]:
    """Return the stretches of a file in which values are missing, Bool[samples of the file], the longest first."""
    firsts, ends = runs_of(missing).T
    time = view.model.recordings[file.recording].bound.dataset.time
    if time is None:
        gaps = [FileGap(float(first), float(end)) for first, end in zip(firsts, ends, strict=True)]
    else:
        here = time[file.first : file.last]
        # from the last value before it to the first one after it
        begins, resumes = here[np.maximum(firsts - 1, 0)], here[np.minimum(ends, here.size - 1)]
        gaps = [FileGap(float(begin), float(end)) for begin, end in zip(begins, resumes, strict=True)]
    return sorted(gaps, key=lambda gap: gap.begin - gap.end)
