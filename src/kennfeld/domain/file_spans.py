"""The files that the samples of a dataset come from."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import PurePath
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Int
from kennfeld.base.lazy_dataclass import dataclass


@dataclass(frozen=True, eq=False)
class FileSpans:
    """The files of a dataset, one after the other.

    Attributes:
        names: paths or addresses.
        starts: first sample of each file, rising, Int[files]; negative if the dataset begins within a file.
        lengths: samples of each file, Int[files]; the last one may end behind the dataset.
        start_times: the instant of time stamp 0 of each file, as `Dataset.start_time`; by default all are unknown.

    >>> files = FileSpans.joined(["a.csv", "b.csv"], [3, 2])
    >>> part = files.cut(1, 4)
    >>> part.names, part.starts, part.lengths
    (('a.csv', 'b.csv'), array([-1,  2]), array([3, 2]))
    """

    names: tuple[str, ...]
    starts: Int
    lengths: Int
    start_times: tuple[datetime | None, ...] = ()

    def __post_init__(self) -> None:
        if not self.start_times:
            object.__setattr__(self, "start_times", (None,) * len(self.names))

    @classmethod
    def joined(cls, names: Sequence[str], lengths: Sequence[int], start_times: Sequence[datetime | None] = ()) -> Self:
        """Return whole files, of which each begins where the one before it ends."""
        edges = np.cumsum([0, *lengths], dtype=np.int64)
        return cls(tuple(names), edges[:-1], np.diff(edges), tuple(start_times))

    def covers(self, samples: int) -> bool:
        """Return whether each of a number of samples comes from one of the files."""
        ends = self.starts + self.lengths
        if not samples:
            return True
        # each ends where the next one begins
        gapless = bool(np.array_equal(ends[:-1], self.starts[1:]))
        return bool(self.names) and gapless and bool(self.starts[0] <= 0) and bool(ends[-1] >= samples)

    def cut(self, first: int, last: int) -> Self:
        """Return the files of the samples from `first` to before `last`."""
        inside = (self.starts < last) & (self.starts + self.lengths > first)
        names = tuple(name for name, taken in zip(self.names, inside, strict=True) if taken)
        times = tuple(time for time, taken in zip(self.start_times, inside, strict=True) if taken)
        return type(self)(names, self.starts[inside] - first, self.lengths[inside], times)

    def picked(self, samples: Int) -> Self | None:
        """Return the files of some samples, Int[picked], as if they had no others; None unless the numbers rise."""
        if np.any(np.diff(samples) <= 0):
            return None
        # the edges between files, counted in picked samples
        edges = np.searchsorted(samples, np.append(self.starts, self.starts[-1:] + self.lengths[-1:]))
        return type(self)(self.names, edges[:-1], np.diff(edges), self.start_times)

    def parts(self, values: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield each file with its part of the values of a dataset: [samples], any type -> [samples of the file]."""
        for name, start, length in zip(self.names, self.starts, self.lengths, strict=True):
            # a negative start would count from the end
            yield name, values[max(start, 0) : start + length]

    def sizes(self, samples: int) -> Int:
        """Return how many of a number of samples come from each file, Int[files]."""
        ends = np.append(self.starts, self.starts[-1:] + self.lengths[-1:])
        # what lies outside of the samples has no length once its edges are cut
        return np.diff(np.clip(ends, 0, samples))


def short_names(names: Sequence[str]) -> dict[str, str]:
    """Return the shortest end of each path that no other path has; without its folder if file names differ.

    >>> short_names(["runs/mon/a.csv", "runs/tue/a.csv", "runs/b.csv"])
    {'runs/mon/a.csv': 'mon/a.csv', 'runs/tue/a.csv': 'tue/a.csv', 'runs/b.csv': 'b.csv'}
    """
    parts = {name: PurePath(name).parts for name in names}
    longest = max(map(len, parts.values()), default=0)
    short: dict[str, str] = {}
    for count in range(1, longest + 1):
        ends: dict[str, list[str]] = {}
        for name in (name for name in parts if name not in short):
            # an end that a single path has becomes its name; those that share one take a part more
            ends.setdefault("/".join(parts[name][-count:]), []).append(name)
        short |= {own[0]: end for end, own in ends.items() if len(own) == 1 or count == longest}
        if len(short) == len(parts):
            break
    return {name: short.get(name, name) for name in parts}
