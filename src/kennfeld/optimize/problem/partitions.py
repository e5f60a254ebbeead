"""Data in partitions: groups of files, or parts of long ones, that are evaluated one by one, on any machine.

Partitions are fixed by the files and their lengths, never by who evaluates them, and sums over them are added in the
order of the files. So one process and any number of workers compute the same, bit for bit.
"""

import pickle
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, overload

import numpy as np

from kennfeld.base.errors import Finding, InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.base.task_runner import Task, TaskRunner, worker_name
from kennfeld.domain.dataset import Dataset, concatenate
from kennfeld.domain.file_spans import FileSpans
from kennfeld.preprocessing.prepared_files import DatasetRecipe, PreparedFiles, cut
from kennfeld.preprocessing.recording_sources import RecordingSource
from kennfeld.preprocessing.time_shift import inside_pieces, shifted_values

LEAST_STRETCH = 10_000  # samples


@dataclass(frozen=True)
class Part:
    """Samples of one file, from `first` to before `last`, that belong to a dataset, by number.

    `shift` are the times in s by which channels are moved, for steady-state data in samples, and `margin` is the number
    of samples at the ends of each piece that are not scored. `factors` multiply the weights of the criteria; none if
    empty.
    """

    dataset: int
    source: RecordingSource
    first: int
    last: int
    shift: tuple[tuple[str, float], ...] = ()
    margin: int = 0
    factors: tuple[float, ...] = ()

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.last - self.first


@dataclass(frozen=True)
class Partition:
    """Parts of one dataset that are evaluated together."""

    parts: tuple[Part, ...]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return sum(part.samples for part in self.parts)


@dataclass(frozen=True)
class Recordings:
    """The recipes of the datasets and the folder of prepared files, by which a process opens any partition."""

    recipes: tuple[DatasetRecipe, ...]
    files: PreparedFiles

    def open(self, part: Part) -> Dataset:
        """Return the samples of a part.

        Raises:
            InputError: its file cannot be read.
        """
        return _select(self._prepared(part), part, part.first, part.last)

    def file(self, part: Part) -> Dataset:
        """Return all samples of the file of a part; errors as for `open`."""
        data = self._prepared(part)
        return _select(data, part, 0, data.samples)

    def begins_inside(self, part: Part) -> bool:
        """Return whether a part begins within a piece of its file."""
        return part.first not in self._prepared(part).piece_starts

    def _prepared(self, part: Part) -> Dataset:
        prepared = self.files.file(self.recipes[part.dataset], part.source)
        if prepared.failed or prepared.dataset is None:
            raise InputError(with_worker(f for f in prepared.findings if f.severity == "error"))
        return prepared.dataset


def _select(data: Dataset, part: Part, first: int, last: int) -> Dataset:
    """Return samples of a file, with the shifts and the margin of a part; only these are computed."""
    # the file is named by its source, so that errors by file have one name wherever it is read
    data = replace(data, files=FileSpans.joined([part.source.address], [data.samples], [data.start_time]))
    result = data if (first, last) == (0, data.samples) else cut(data, first, last)
    # from the whole file: shifted samples of a part come from its neighbours
    moved = shifted_values(data, dict(part.shift), first, last)
    if moved:
        result = result.with_channels(*(replace(result[name], values=values) for name, values in moved.items()))
    if part.margin:
        result = replace(result, scored=result.counting & inside_pieces(data, part.margin, first, last))
    return result


def with_worker(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings whose errors name the worker that runs this."""
    name = worker_name()
    return tuple(
        replace(f, message=f"{f.message} (on worker {name})") if name and f.severity == "error" else f for f in findings
    )


class StoredDatasets(Sequence[Dataset]):
    """The datasets of some parts, one for each, opened when they are first used."""

    def __init__(self, recordings: Recordings, parts: Sequence[Part]) -> None:
        self._recordings, self.parts = recordings, parts
        self._opened: tuple[Dataset, ...] | None = None

    @property
    def continuing(self) -> list[bool]:
        """True for the parts that begin within a piece of their file."""
        return [self._recordings.begins_inside(part) for part in self.parts]

    @property
    def _datasets(self) -> tuple[Dataset, ...]:
        if self._opened is None:
            self._opened = tuple(self._recordings.open(part) for part in self.parts)
        return self._opened

    @overload
    def __getitem__(self, at: int) -> Dataset: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Dataset]: ...
    def __getitem__(self, at: int | slice) -> Dataset | Sequence[Dataset]:
        return self._datasets[at]

    def __len__(self) -> int:
        return len(self.parts)


def dataset_numbers(datasets: Sequence[Dataset]) -> Sequence[int]:
    """Return the number of each dataset among those of the whole problem, of which they may be parts."""
    return [part.dataset for part in datasets.parts] if isinstance(datasets, StoredDatasets) else range(len(datasets))


@dataclass(frozen=True, eq=False)
class Partitions:
    """The data of a problem, in partitions.

    Attributes:
        recordings: opens partitions.
        training: partitions of the datasets that are fitted.
        test: those of the others.
        runner: evaluates them.
        step: time step of all training data in s; None if it is not the same everywhere, or not needed.
    """

    recordings: Recordings
    training: tuple[Partition, ...]
    test: tuple[Partition, ...]
    runner: TaskRunner
    step: float | None = None

    @property
    def samples(self) -> int:
        """Number of training samples."""
        return sum(partition.samples for partition in self.training)

    def shifted(
        self, shifts: Mapping[str, Mapping[str, float]], margins: Mapping[str, int] | None = None
    ) -> "Partitions":
        """Return the same with channels moved in time; the samples are computed where a part is opened.

        Args:
            shifts: by dataset and channel, in s; for steady-state data in samples.
            margins: samples at the ends of each piece that are not scored, by dataset.
        """

        def shift(part: Part) -> Part:
            name = self._name_of(part)
            return replace(part, shift=tuple(shifts.get(name, {}).items()), margin=(margins or {}).get(name, 0))

        training, test = (
            tuple(Partition(tuple(map(shift, partition.parts))) for partition in own)
            for own in (self.training, self.test)
        )
        return replace(self, training=training, test=test)

    def _name_of(self, part: Part) -> str:
        return self.recordings.recipes[part.dataset].entry.name

    def excerpt(self, most: int) -> dict[str, Dataset]:
        """Return at most about `most` training samples in long stretches, by dataset.

        They depend on the files, their lengths and the size of partitions alone.
        """
        stretches = find_stretches([part for partition in self.training for part in partition.parts], most)
        items = [Partition((part,)) for part in stretches]
        opened: dict[str, list[Dataset]] = {}
        for part, data in zip(stretches, self.map(open_part, self.share(None), items), strict=True):
            opened.setdefault(self._name_of(part), []).append(data)
        return {name: concatenate(name, own) for name, own in opened.items()}

    @property
    def places(self) -> Iterator[list[tuple[str, int]]]:
        """For each training partition, the dataset of each part by name, and the number of its first sample there."""
        ends: dict[int, int] = {}
        for partition in self.training:
            places = []
            for part in partition.parts:
                first = ends.get(part.dataset, 0)
                ends[part.dataset] = first + part.samples
                places.append((self._name_of(part), first))
            yield places

    def share(self, content: Any) -> bytes:
        """Return what all calls of a task share, for `map`; the task reads it by `shared_content`."""
        return pickle_content((self.recordings, content))

    def map(self, task: Task, shared: bytes, partitions: Iterable[Partition], *arguments: Any) -> Iterator[Any]:
        """Yield the results of a task over partitions, in their order."""
        items = [pickle_content(partition) for partition in partitions]
        return self.runner.map(task, shared, items, pickle_content(arguments))


@lru_cache(maxsize=8)
def shared_content(shared: bytes) -> tuple[Recordings, Any]:
    """Return what all calls of a task share, decoded once in each process."""
    recordings, content = pickle.loads(shared)
    return recordings, content


def open_part(shared: bytes, item: bytes, _: bytes) -> Dataset:
    """Return the samples of a partition of one part."""
    recordings, _ = shared_content(shared)
    (part,) = pickle.loads(item).parts
    return recordings.open(part)


def find_stretches(parts: Sequence[Part], most: int) -> list[Part]:
    """Return parts of at most about `most` samples in total, the same number for each dataset.

    If a dataset has more, these are the beginnings of parts that are evenly spread over its samples, and at least
    `LEAST_STRETCH` samples long, so that states settle and little is lost at their ends.

    >>> file = RecordingSource("a.csv", "")
    >>> [(part.first, part.last) for part in find_stretches([Part(0, file, 0, 400), Part(0, file, 400, 700)], 1000)]
    [(0, 700)]
    """
    datasets = dict.fromkeys(part.dataset for part in parts)
    share = most // max(len(datasets), 1)
    return [
        stretch for number in datasets for stretch in _spread([part for part in parts if part.dataset == number], share)
    ]


def _spread(parts: Sequence[Part], most: int) -> list[Part]:
    if sum(part.last - part.first for part in parts) <= most:
        return _joined(parts)
    length = max(most // len(parts), LEAST_STRETCH)
    ends = np.cumsum([min(part.last - part.first, length) for part in parts])
    count = max(most // length, 1)
    # the middles of `count` equal shares of all samples
    places = (np.arange(count) + 0.5) * (ends[-1] / count)
    picked = np.unique(np.searchsorted(ends, places, side="right"))
    return [replace(parts[i], last=min(parts[i].last, parts[i].first + length)) for i in picked]


def _joined(parts: Sequence[Part]) -> list[Part]:
    """Return parts of which those that follow each other in a file are one."""
    joined: list[Part] = []
    for part in parts:
        if joined and follows(joined[-1], part):
            part = replace(joined.pop(), last=part.last)
        joined.append(part)
    return joined


def follows(part: Part, later: Part) -> bool:
    """Return whether a part of a file is followed by another one."""
    return (part.dataset, part.source, part.last) == (later.dataset, later.source, later.first)


def split_files(
    dataset: int, sources: Sequence[RecordingSource], starts: Sequence[Sequence[int]], lengths: Sequence[int], size: int
) -> list[Partition]:
    """Group the files of a dataset into partitions of about `size` samples, and cut those that are longer.

    Args:
        dataset: its number.
        sources: its files.
        starts: samples at which each file may be cut, the first ones of its pieces; empty for anywhere.
        lengths: samples of each file.
        size: samples of a partition; exceeded only by a piece that is longer.

    >>> files = [RecordingSource(name, "") for name in "abc"]
    >>> [p.samples for p in split_files(0, files, [[], [], []], [5, 3, 12], 8)]
    [8, 8, 4]
    """
    parts = [
        Part(dataset, source, first, last)
        for source, own, length in zip(sources, starts, lengths, strict=True)
        for first, last in _cuts(own, length, size)
    ]
    return group_parts(parts, size)


def group_parts(parts: Iterable[Part], size: int) -> list[Partition]:
    """Group consecutive parts of the same dataset into partitions of at most `size` samples, if parts allow it."""
    groups: list[list[Part]] = []
    for part in parts:
        last = groups[-1] if groups else []
        fits = sum(other.samples for other in last) + part.samples <= size
        if not last or not fits or last[0].dataset != part.dataset:
            groups.append([])
        groups[-1].append(part)
    return [Partition(tuple(group)) for group in groups]


def _cuts(starts: Sequence[int], length: int, size: int) -> list[tuple[int, int]]:
    """Return ranges of at most `size` samples, if pieces allow it."""
    if not length:
        return []
    allowed = list(starts) or list(range(0, length, size))
    cuts = [0]
    for start, end in pairwise([*allowed, length]):
        # cut before the piece that would not fit any more; a piece that is too long by itself stays whole
        if end - cuts[-1] > size and start > cuts[-1]:
            cuts.append(start)
    return list(pairwise([*cuts, length]))


def join_files(partitions: Iterable[Partition]) -> list[Partition]:
    """Return partitions in which no file is cut.

    >>> file = RecordingSource("a", "")
    >>> [p.samples for p in join_files(split_files(0, [file, file], [[], []], [12, 3], 8))]
    [12, 3]
    """
    groups: list[list[Part]] = []
    for partition in partitions:
        begins = True
        for part in partition.parts:
            last = groups[-1][-1] if groups else None
            # the next part of the same file, perhaps at the beginning of another partition
            if last is not None and (last.source, last.last) == (part.source, part.first):
                groups[-1][-1] = replace(last, last=part.last)
                continue
            # a group for each partition, without what continues a file of the one before
            if begins:
                groups.append([])
            groups[-1].append(part)
            begins = False
    return [Partition(tuple(group)) for group in groups]


def without_values(data: Dataset) -> Dataset:
    """Return a dataset with the same channels and settings, but no sample."""
    return replace(cut(data, 0, 0), findings=())
