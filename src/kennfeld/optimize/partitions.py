"""Data in partitions: groups of files, or parts of long ones, that are evaluated one by one, on any machine.

Partitions are fixed by the files and their lengths, never by who evaluates them, and sums over them are added in the
order of the files. So one process and any number of workers compute the same, bit for bit.
"""

import pickle
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, overload

from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError
from kennfeld.portable_pickle import pickle_content
from kennfeld.preprocessing.prepared_files import DatasetRecipe, PreparedFiles, cut
from kennfeld.preprocessing.recording_sources import RecordingSource
from kennfeld.task_runner import Task, TaskRunner, worker_name


@dataclass(frozen=True)
class Part:
    """Samples of one file, from `first` to before `last`, that belong to a dataset, by number."""

    dataset: int
    source: RecordingSource
    first: int
    last: int


@dataclass(frozen=True)
class Partition:
    """Parts of one dataset that are evaluated together."""

    parts: tuple[Part, ...]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return sum(part.last - part.first for part in self.parts)


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
        data = self.file(part)
        return data if (part.first, part.last) == (0, data.samples) else cut(data, part.first, part.last)

    def file(self, part: Part) -> Dataset:
        """Return all samples of the file of a part; errors as for `open`."""
        prepared = self.files.file(self.recipes[part.dataset], part.source)
        if prepared.failed or prepared.dataset is None:
            raise InputError(with_worker(f for f in prepared.findings if f.severity == "error"))
        return prepared.dataset


def with_worker(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings whose errors name the worker that runs this."""
    name = worker_name()
    return tuple(
        replace(f, message=f"{f.message} (on worker {name})") if name and f.severity == "error" else f for f in findings
    )


class StoredDatasets(Sequence[Dataset]):
    """The datasets of some parts, one for each, opened when they are first used."""

    def __init__(self, recordings: Recordings, parts: Sequence[Part]) -> None:
        self._recordings, self._parts = recordings, parts
        self._opened: tuple[Dataset, ...] | None = None

    @property
    def _datasets(self) -> tuple[Dataset, ...]:
        if self._opened is None:
            self._opened = tuple(self._recordings.open(part) for part in self._parts)
        return self._opened

    @overload
    def __getitem__(self, at: int) -> Dataset: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Dataset]: ...
    def __getitem__(self, at: int | slice) -> Dataset | Sequence[Dataset]:
        return self._datasets[at]

    def __len__(self) -> int:
        return len(self._parts)


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
    groups: list[list[Part]] = []
    for part in parts:
        filled = sum(other.last - other.first for other in groups[-1]) if groups else size
        if filled + part.last - part.first > size:
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
        if end - cuts[-1] > size and start > cuts[-1]:
            cuts.append(start)
    return list(pairwise([*cuts, length]))


def without_values(data: Dataset) -> Dataset:
    """Return a dataset with the same channels and settings, but no sample."""
    return replace(cut(data, 0, 0), findings=())
