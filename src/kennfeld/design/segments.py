"""Pieces of recordings, or of planned manoeuvres, that may be driven by themselves."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Int
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset, pick


@dataclass(frozen=True)
class RecordedSegment:
    """A piece of a recording.

    Attributes:
        dataset: number of the dataset.
        file: the file that it is in; the name of the dataset if that is unknown.
        lead: first sample of the warm-up before it.
        first: first sample that counts.
        last: the sample after the last one.
        begin: time stamp of the first sample in the file, in s.
        end: time stamp of the last one.
    """

    dataset: int
    file: str
    lead: int
    first: int
    last: int
    begin: float
    end: float

    def cut(self, data: Dataset) -> Dataset:
        """Return the segment with its warm-up, which is simulated but not scored."""
        numbers = np.arange(self.lead, self.last)
        part = pick(data, numbers)
        # a warm-up of its own takes the place of that of the recording
        warmup = data.warmup if self.lead == self.first else 0.0
        scored = part.counting & (numbers >= self.first)
        return replace(part, name=f"{data.name} {self.begin:g} s", scored=scored, warmup=warmup)


def cut_segments(datasets: Sequence[Dataset], length: float, warmup: float) -> list[RecordedSegment]:
    """Cut recordings into segments that follow each other; what is too short at the end of a piece is left out.

    Args:
        datasets: recordings with time stamps.
        length: of a segment, in s.
        warmup: time before each segment that the recording must contain, in s.

    Raises:
        InputError: a segment is shorter than the step of a recording.
    """
    segments = [segment for number, data in enumerate(datasets) for segment in _cut(number, data, length, warmup)]
    return _told_apart(segments)


def _cut(number: int, data: Dataset, length: float, warmup: float) -> Iterator[RecordedSegment]:
    assert data.time is not None
    for piece in data.pieces:
        time = data.time[piece]
        if time.size < 2:
            continue
        step = float(np.median(np.diff(time)))
        if length < step:
            message = f"segments of {length:g} s are shorter than the step of {data.name}, {step:g} s"
            raise InputError.of(Location("design"), message, "Increase length.")
        begins = np.arange(time[0] + warmup, time[-1] + 1.5 * step - length, length)
        # half a step of tolerance, so that rounded time stamps do not shorten a segment by a sample
        edges = np.searchsorted(time, [begins - step / 2, begins + length - step / 2, begins - warmup - step / 2])
        for first, last, lead in edges.T.tolist():
            if last > first and (last - first) * step >= 0.5 * length:
                at = piece.start
                ends = float(time[first]), float(time[last - 1])
                yield RecordedSegment(number, file_of(data, at + first), at + lead, at + first, at + last, *ends)


def file_of(data: Dataset, sample: int) -> str:
    """Return the file that a sample comes from; the name of the dataset if that is unknown."""
    if data.files is None:
        return data.name
    return data.files.names[int(np.searchsorted(data.files.starts, sample, side="right")) - 1]


def cut_files(datasets: Sequence[Dataset]) -> list[RecordedSegment]:
    """Return each recording as a whole: the files of the datasets, or their pieces if the files are unknown."""
    located = []
    for number, data in enumerate(datasets):
        spans = [(piece.start, piece.stop, f"{data.name} {i + 1}") for i, piece in enumerate(data.pieces)]
        if len(spans) == 1:
            spans = [(0, data.samples, data.name)]
        if data.files is not None:
            ends = np.minimum(data.files.starts + data.files.lengths, data.samples).tolist()
            spans = list(zip(np.maximum(data.files.starts, 0).tolist(), ends, data.files.names, strict=True))
        for first, last, name in spans:
            if last > first:
                stamps = (0.0, 0.0) if data.time is None else (float(data.time[first]), float(data.time[last - 1]))
                located.append(RecordedSegment(number, name, first, first, last, *stamps))
    return _told_apart(located)


def _told_apart(segments: Sequence[RecordedSegment]) -> list[RecordedSegment]:
    """Return segments in which recordings of one name have their number in the order of the data, as in `drive (2)`."""
    datasets: dict[str, list[int]] = {}
    for segment in segments:
        own = datasets.setdefault(segment.file, [])
        if segment.dataset not in own:
            own.append(segment.dataset)
    return [
        replace(segment, file=f"{segment.file} ({datasets[segment.file].index(segment.dataset) + 1})")
        if len(datasets[segment.file]) > 1
        else segment
        for segment in segments
    ]


def owners(segments: Sequence[RecordedSegment], datasets: Sequence[Dataset]) -> list[Int]:
    """Return for each dataset the number of the segment of every sample, Int[samples]; -1 for none."""
    numbers = [np.full(data.samples, -1, dtype=np.int64) for data in datasets]
    for number, segment in enumerate(segments):
        numbers[segment.dataset][segment.first : segment.last] = number
    return numbers
