"""Several recordings joined into one dataset while they are read, so that no recording is kept beside it."""

from collections.abc import Mapping
from dataclasses import field, replace
from datetime import datetime

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Channel, Dataset, common_start_time, join_files
from kennfeld.domain.file_spans import FileSpans
from kennfeld.preprocessing.recipe import DatasetEntry
from kennfeld.preprocessing.units import compare_units, is_unit_missing

GROWTH = 1.25  # most by which memory exceeds the samples so far


class GrowingColumn:
    """Numbers that are appended to; most systems enlarge a large array where it is.

    >>> column = GrowingColumn()
    >>> column.append(np.ones(2), 2)
    >>> column.append(np.zeros(1), 5)
    >>> column.finish()
    array([1., 1., 0.])
    """

    def __init__(self) -> None:
        self.size = 0
        self._values = np.empty(0)

    def append(self, values: Float, expected: int) -> None:
        """Append numbers, Float[samples]; `expected` is the size that the column will probably have in the end."""
        end = self.size + values.size
        if end > self._values.size:
            # capped, since the first file may be the longest by far
            self._values.resize(max(end, min(expected, int(GROWTH * end))), refcheck=False)
        self._values[self.size : end] = values
        self.size = end

    def finish(self) -> Float:
        """Return the numbers, read-only."""
        self._values.resize(self.size, refcheck=False)
        self._values.setflags(write=False)
        return self._values


@dataclass
class JoinedRecordings:
    """Recordings of one dataset, each a piece; a channel that some of them lack is NaN there.

    `total` is the number of files, `findings` warns of each channel whose unit in one file is not that in another.
    """

    name: str
    entry: DatasetEntry
    total: int
    findings: list[Finding] = field(default_factory=list)
    _starts: list[int] = field(default_factory=list)
    _files: list[tuple[FileSpans | None, int]] = field(default_factory=list)  # of each recording, and its samples
    _start_times: list[datetime | None] = field(default_factory=list)  # of each recording
    _samples: int = 0
    _mixed: bool = False
    _remarks: dict[Finding, None] = field(default_factory=dict)  # of the readers
    _first: Dataset | None = None
    _channels: dict[str, Channel] = field(default_factory=dict)  # of the first recording that has them
    _columns: dict[str, GrowingColumn] = field(default_factory=dict)
    _time: GrowingColumn = field(default_factory=GrowingColumn)
    _units: dict[str, str] = field(default_factory=dict)

    def add(self, part: Dataset) -> None:
        """Append a recording."""
        self._compare_units(part)
        self._remarks |= dict.fromkeys(part.findings)
        if self._first is None:
            self._first = part
            return
        self._mixed |= (part.time is None) != (self._first.time is None)
        if self._mixed:
            return
        # the first recording is copied only once there is a second: a single one is the dataset as it is
        if not self._columns:
            self._append(self._first)
        self._append(part)

    def dataset(self) -> Dataset | None:
        """Return the dataset with the settings of its entry; None if there is no recording.

        Raises:
            ArgumentError: some recordings have time stamps and some have none.
        """
        if self._mixed:
            raise ArgumentError(f"dataset {self.name} mixes recordings with and without time stamps")
        if self._first is None:
            return None
        joined = self._first
        if self._columns:
            channels = (replace(c, values=self._columns.pop(n).finish()) for n, c in self._channels.items())
            time = None if joined.time is None else self._time.finish()
            starts = np.array(self._starts, dtype=np.int64)
            files = join_files(*zip(*self._files, strict=True))
            joined = replace(
                joined,
                channels=tuple(channels),
                time=time,
                piece_starts=starts,
                files=files,
                start_time=common_start_time(self._start_times),
            )
        entry = self.entry
        return replace(
            joined,
            name=self.name,
            findings=tuple(self._remarks),
            use=entry.scored_as,
            weight=entry.weight,
            weight_channel=entry.weight_channel,
            max_gap=entry.max_gap,
            warmup=entry.warmup,
        )

    def _append(self, part: Dataset) -> None:
        count = len(self._starts) + 1
        end = self._samples + part.samples
        # as if the files to come were as long as those so far on average
        expected = end * self.total // count
        for name, channel in part.items():
            if name not in self._columns:
                self._channels[name] = replace(channel, values=np.empty(0))
                self._columns[name] = _missing(self._samples)
        for name, column in self._columns.items():
            column.append(part[name].values if name in part else np.full(part.samples, np.nan), expected)
        if part.time is not None:
            self._time.append(part.time, expected)
        self._starts += (part.piece_starts + self._samples).tolist()
        self._files.append((part.files, part.samples))
        self._start_times.append(part.start_time)
        self._samples = end

    def _compare_units(self, part: Mapping[str, Channel]) -> None:
        for channel in part.values():
            if is_unit_missing(channel.unit):
                continue
            first = self._units.setdefault(channel.name, channel.unit)
            if channel.unit != first and compare_units(channel.unit, first) != "same":
                message = f"channel {channel.name} is in {first} in one file and in {channel.unit} in another"
                location = self.entry.location.within("files")
                self.findings.append(Finding(location, message, "Split the dataset.", severity="warning"))
                # further files in this unit are not reported again
                self._units[channel.name] = channel.unit


def _missing(samples: int) -> GrowingColumn:
    column = GrowingColumn()
    column.append(np.full(samples, np.nan), samples)
    return column
