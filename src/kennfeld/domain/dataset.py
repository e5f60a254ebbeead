"""Datasets: recorded channels of equal length, with or without time stamps, in one or more pieces."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, field, replace
from datetime import datetime
from functools import wraps
from importlib import import_module
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import ArrayLike, Bool, Float, Int, readonly
from kennfeld.base.errors import ArgumentError, Finding, Location, renamed, warn_deprecated
from kennfeld.base.formatting import count_noun, join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.notebook_display import NotebookDisplay
from kennfeld.base.numeric import array, number, truths
from kennfeld.domain.data_frames import Table, sample_frame
from kennfeld.domain.file_spans import FileSpans

Use = Literal["training", "test"]

PAUSE = 20.0  # usual steps; a longer one is a pause of the recording
_COLUMNS = "kennfeld.preprocessing.coercion"  # in a higher layer, which knows how files name their time
_USUAL = 0.75  # quantile of the steps
_ROUNDING = 1e-6  # relative, of differences of time stamps
MAX_NAMES = 6  # of channels that a text shows
SAMPLES_PER_BLOCK = 65536  # processed at once, so that memory does not grow with the data


@dataclass(frozen=True, eq=False)
class Channel(NotebookDisplay):
    """One recorded quantity; NaN marks a sample without a value.

    Attributes:
        name: its name in formulas and project files.
        values: Float[samples], in its unit.
        unit: empty if it is unknown.
        description: free text.

    Raises:
        ArgumentError: the values are not one-dimensional.

    >>> speed = Channel("Speed", [1000, 2000, 3000], unit="rpm")
    >>> len(speed), speed.unit
    (3, 'rpm')
    """

    name: str
    values: Float  # Float[samples]
    unit: str = ""
    description: str = ""

    def __post_init__(self) -> None:
        values = readonly(array(self.values, f"channel {self.name}"))
        if values.ndim != 1:
            raise ArgumentError(f"channel {self.name} must be one-dimensional, got shape {values.shape}")
        object.__setattr__(self, "values", values)

    def __len__(self) -> int:
        return self.values.size

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the values for NumPy, `np.asarray(channel)`."""
        return np.array(self.values, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        unit = f", unit={self.unit!r}" if self.unit else ""
        return f"Channel({self.name!r}, {count_noun(len(self), 'value')}{unit})"


@dataclass(frozen=True)
class Clock:
    """The column of a file that time was read from.

    `in_milliseconds` is true if its numbers look like milliseconds but were read as seconds because the file states no
    unit.
    """

    name: str
    in_milliseconds: bool = False


@dataclass(frozen=True)
class Settling:
    """Simulation of steady-state points by a model with memory: each is held for `seconds` from the initial states.

    Attributes:
        seconds: how long a point is held.
        average: the result is the mean over these last seconds, or the last value if that is 0.
        step: step of the model in s; by default its own.

    Raises:
        ArgumentError: a time is negative, or longer than `seconds`.

    >>> Settling(5.0, average=1.0, step=0.1).seconds
    5.0
    """

    seconds: float
    average: float = 0.0
    step: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "seconds", number(self.seconds, "seconds", "a settling", above=0))
        object.__setattr__(self, "average", number(self.average, "average", "a settling"))
        if self.step is not None:
            object.__setattr__(self, "step", number(self.step, "step", "a settling", above=0))
        if not 0 <= self.average <= self.seconds:
            raise ArgumentError(f"average={self.average} of a settling must be >= 0 and <= seconds={self.seconds:g}")
        if self.step is not None and not 0 < self.step <= self.seconds:
            raise ArgumentError(f"step={self.step} of a settling must be > 0 and <= seconds={self.seconds:g}")


@dataclass(frozen=True, eq=False)
class Dataset(NotebookDisplay, Mapping[str, Channel]):
    """Channels over the same samples.

    Attributes:
        name: how messages name it.
        channels: recorded quantities of equal length.
        time: time stamps in s, Float[samples], increasing within each piece; None for steady-state points.
        piece_starts: first sample of each piece, Int[pieces]; a model's states restart there.
        weight: multiplies the loss of all samples.
        use: "training" or "test".
        scored: samples that are scored, Bool[samples]; the others are only simulated. None for all.
        findings: warnings and remarks of the reader, such as the number of infinite values.
        max_gap: longest gap of NaN in an input that is interpolated, in s; longer ones end a piece, and so does a
            time step longer than both this gap and `PAUSE` (20) times the upper quartile of the steps.
        weight_channel: channel that multiplies the loss of each sample; empty for none.
        settling: simulation of steady-state points by a model with memory.
        warmup: time from the start of each piece that is simulated but not scored, in s.
        clock: the column that time was read from, for a dataset from a file.
        files: the files that the samples come from; None if that is unknown.
        start_time: the instant of time stamp 0 as the recording states it, None if it does not, or if several
            recordings differ. Without a time zone it is a local time of an unknown zone.
        recorded: samples that were recorded, Bool[samples]; the others are steps of the model between them. None for
            all.

    Raises:
        ArgumentError: lengths differ, or time does not increase.

    >>> data = Dataset.of("bench", {"Speed": [1000, 2000], "Torque": [80.0, 95.0]}, units={"Speed": "rpm"})
    >>> data.samples, data["Speed"].unit
    (2, 'rpm')
    """

    name: str
    channels: tuple[Channel, ...]
    time: Float | None = None  # Float[samples]
    piece_starts: Int = field(default_factory=lambda: np.zeros(1, dtype=np.int64))  # Int[pieces]
    _: KW_ONLY
    weight: float = 1.0
    use: Use = "training"
    scored: Bool | None = None  # Bool[samples]
    findings: tuple[Finding, ...] = ()
    max_gap: float = 0.0
    weight_channel: str = ""
    settling: Settling | None = None
    warmup: float = 0.0
    clock: Clock | None = None
    files: FileSpans | None = None
    start_time: datetime | None = None
    recorded: Bool | None = None

    def __post_init__(self) -> None:
        by_name: dict[str, Channel] = {}
        for channel in self.channels:
            if channel.name in by_name:
                raise ArgumentError(f"dataset {self.name} has channel {channel.name} twice")
            by_name[channel.name] = channel
        object.__setattr__(self, "_by_name", by_name)
        lengths = {len(channel) for channel in self.channels}
        if len(lengths) > 1:
            sizes = ", ".join(f"{c.name} {len(c)}" for c in self.channels[:6])
            raise ArgumentError(f"channels of dataset {self.name} differ in length: {sizes}")
        for key in ("weight", "warmup", "max_gap"):
            object.__setattr__(self, key, number(getattr(self, key), key, f"dataset {self.name}", least=0))
        if self.use not in ("training", "test"):
            raise ArgumentError(f"use={self.use!r} of dataset {self.name} must be training or test")
        starts = np.array(self.piece_starts, dtype=np.int64)
        # a dataset without samples has one piece, which is empty
        if starts.size == 0 or starts[0] != 0 or np.any(np.diff(starts) <= 0) or starts[-1] > max(self.samples - 1, 0):
            raise ArgumentError(
                f"piece_starts={starts.tolist()} of dataset {self.name} must rise from 0 within {self.samples} samples"
            )
        object.__setattr__(self, "piece_starts", starts)
        if self.settling is not None and self.time is not None:
            raise ArgumentError(f"settling={self.settling} of dataset {self.name} requires points without time stamps")
        if self.time is not None:
            self._check_time(readonly(array(self.time, f"time of dataset {self.name}")))
        for key in ("scored", "recorded"):
            if getattr(self, key) is not None:
                marks = truths(getattr(self, key), f"{key} of dataset {self.name}")
                if marks.shape != (self.samples,):
                    raise ArgumentError(f"{key} of dataset {self.name} must have one entry per sample, {self.samples}")
                object.__setattr__(self, key, marks)
        if self.files is not None and not self.files.covers(self.samples):
            object.__setattr__(self, "files", None)  # of other samples

    def _check_time(self, time: Float) -> None:
        if time.shape != (self.samples,):
            raise ArgumentError(
                f"time of dataset {self.name} has shape {time.shape}, its channels have {self.samples} samples"
            )
        # from one piece to the next, time may go back
        for first, steps in time_steps(time, self.piece_starts, between=1.0):
            # NaN counts as well
            bad = np.flatnonzero(~(steps > 0))
            if bad.size:
                k = first + int(bad[0]) - 1
                raise ArgumentError(
                    f"time of dataset {self.name} does not increase at sample {k + 1}: "
                    f"{time[k]:g} s, then {time[k + 1]:g} s"
                )
        object.__setattr__(self, "time", time)

    @classmethod
    def of(
        cls,
        name: str,
        columns: Table,
        *,
        units: Mapping[str, str] | None = None,
        time: ArrayLike | None = None,
        piece_starts: ArrayLike | None = None,
        settling: Settling | None = None,
        weight: float = 1.0,
        use: Use = "training",
        scored: ArrayLike | None = None,
        max_gap: float = 0.0,
        weight_channel: str = "",
        warmup: float = 0.0,
        files: FileSpans | None = None,
        start_time: datetime | None = None,
        recorded: ArrayLike | None = None,
        starts: ArrayLike | None = None,
    ) -> Self:
        """Return a dataset of named columns.

        A column `time`, one of dates, or such an index of a DataFrame becomes the time of the samples, unless `time` or
        `settling` is given; without it, the samples are steady-state points. A column or a level of the index called
        `piece` then begins a new piece where its value changes. Columns of time and pieces remain channels; those of
        other dates are left out.

        Args:
            name: how messages name it.
            columns: numbers by name: a dict of arrays, a DataFrame of pandas, polars or PyArrow, or a Dataset of
                xarray. Attributes `units` of pandas and xarray state units.
            units: the units of channels, by name.
            time: time stamps in s, Float[samples].
            piece_starts: first sample of each piece, Int[pieces].
            settling: simulation of steady-state points by a model with memory.
            weight: multiplies the loss of all samples.
            use: "training" or "test".
            scored: samples that are scored, Bool[samples].
            max_gap: longest gap of NaN in an input that is interpolated, in s.
            weight_channel: channel that multiplies the loss of each sample.
            warmup: time from the start of each piece that is simulated but not scored, in s.
            files: the files that the samples come from.
            start_time: the instant of time stamp 0.
            recorded: samples that were recorded, Bool[samples].
            starts: former name of `piece_starts`.

        Raises:
            InputError: columns do not hold numbers; reports all of them.
            ArgumentError: lengths or attributes are inconsistent.
        """
        timed = time is None and settling is None
        held = import_module(_COLUMNS).read_recording(name, columns, units, timed=timed)
        piece_starts = renamed(piece_starts, starts, "piece_starts", "starts")
        pieces = held.starts if piece_starts is None else np.asarray(piece_starts)
        return cls(
            name,
            held.channels,
            held.time if time is None else array(time, f"time of dataset {name}"),
            np.zeros(1, dtype=np.int64) if pieces is None else pieces,
            weight=weight,
            use=use,
            scored=_truths_or_none(scored, f"scored of dataset {name}"),
            max_gap=max_gap,
            weight_channel=weight_channel,
            settling=settling,
            warmup=warmup,
            clock=held.clock,
            files=files,
            start_time=start_time,
            recorded=_truths_or_none(recorded, f"recorded of dataset {name}"),
        ).without_infinite()

    @property
    def starts(self) -> Int:
        """The former name of `piece_starts`."""
        warn_deprecated("Dataset.starts is now called piece_starts")
        return self.piece_starts

    @property
    def samples(self) -> int:
        """Number of samples of every channel."""
        return len(self.channels[0]) if self.channels else (0 if self.time is None else self.time.size)

    def __repr__(self) -> str:
        pieces = f" in {self.piece_starts.size} pieces" if self.piece_starts.size > 1 else ""
        kind = (
            f" over {self.time[-1] - self.time[0]:g} s" if self.time is not None and self.piece_starts.size == 1 else ""
        )
        channels = join_names(list(self), MAX_NAMES)
        return f"Dataset({self.name!r}, {count_noun(self.samples, 'sample')}{pieces}{kind}: {channels})"

    @property
    def is_fitted(self) -> bool:
        """True if values are fitted to it: training data with a weight above 0."""
        return self.use == "training" and self.weight > 0

    @property
    def counting(self) -> Bool:
        """The samples that are scored, Bool[samples]."""
        return np.ones(self.samples, dtype=bool) if self.scored is None else self.scored

    @property
    def pieces(self) -> Sequence[slice]:
        """The samples of each piece."""
        ends = [*self.piece_starts[1:].tolist(), self.samples]
        return [slice(int(a), int(b)) for a, b in zip(self.piece_starts, ends, strict=True)]

    def with_channels(self, *added: Channel) -> Self:
        """Return the same dataset with channels added, or replaced where the name is taken."""
        if not added:
            return self
        by_name = {channel.name: channel for channel in (*self.channels, *added)}
        return replace(self, channels=tuple(by_name.values()))

    def with_findings(self, *added: Finding) -> Self:
        """Return the same dataset with further findings."""
        return replace(self, findings=(*self.findings, *added)) if added else self

    def without_infinite(self) -> Self:
        """Return the dataset with NaN for infinite values, and a warning for each channel that has some."""
        channels, findings = [], []
        for channel in self.channels:
            values, message = replace_infinite(channel.values)
            if message:
                channel = replace(channel, values=values)
                findings.append(Finding(self._location_of(channel.name), message, severity="warning"))
            channels.append(channel)
        return replace(self, channels=tuple(channels), findings=(*self.findings, *findings)) if findings else self

    def had_infinite(self, name: str) -> bool:
        """Return True if `without_infinite` has replaced values of a channel."""
        return any(finding.location == self._location_of(name) for finding in self.findings)

    def _location_of(self, name: str) -> Location:
        return Location(f"dataset {self.name}, channel {name}")

    def to_frame(self) -> Any:
        """Return the channels as the columns of a DataFrame of pandas.

        The index is the time in s, or the number of the sample for steady-state points; several pieces are a level
        `piece` before it. `attrs["units"]` has the units. `Dataset.of` reads all of them back.

        Raises:
            InputError: pandas is not installed; the message has the command that installs it.
        """
        units = {channel.name: channel.unit for channel in self.channels if channel.unit}
        values = {channel.name: channel.values for channel in self.channels}
        return sample_frame(values, units, self.time, self.piece_starts)

    def select(self, samples: ArrayLike) -> Self:
        """Return the samples of a steady-state dataset that an index array or a mask picks, in that order."""
        if self.time is not None:
            raise ArgumentError(
                f"dataset {self.name} has time stamps; only samples of steady-state data can be selected"
            )
        indices = np.asarray(samples)
        channels = tuple(replace(c, values=c.values[indices]) for c in self.channels)
        scored = None if self.scored is None else self.scored[indices]
        # a mask becomes numbers, as an index array is
        files = None if self.files is None else self.files.picked(np.arange(self.samples)[indices])
        return replace(self, channels=channels, piece_starts=np.zeros(1, dtype=np.int64), scored=scored, files=files)

    def __getitem__(self, name: str) -> Channel:
        by_name: dict[str, Channel] = self.__dict__["_by_name"]
        if name not in by_name:
            raise KeyError(f"{name} is not a channel of dataset {self.name}. {nearest(name, by_name)}".strip())
        return by_name[name]

    def __contains__(self, name: object) -> bool:
        # that of `Mapping` asks for the channel, and an error looks for similar names
        return name in self.__dict__["_by_name"]

    def __iter__(self) -> Iterator[str]:
        return iter(self.__dict__["_by_name"])

    def __len__(self) -> int:
        return len(self.channels)


def _with_former_argument(written: Callable[..., None]) -> Callable[..., None]:
    @wraps(written)
    def construct(data: Dataset, *arguments: Any, **named: Any) -> None:
        if "starts" in named:
            named["piece_starts"] = renamed(None, named.pop("starts"), "piece_starts", "starts")
        written(data, *arguments, **named)

    return construct


Dataset.__init__ = _with_former_argument(Dataset.__init__)  # type: ignore[method-assign]


def _truths_or_none(source: ArrayLike | None, label: str) -> Bool | None:
    return None if source is None else truths(source, label)


def pick(data: Dataset, samples: Int) -> Dataset:
    """Return some samples of a dataset, Int[picked] in rising order; pieces without any of them vanish.

    >>> data = Dataset.of("d", {"x": [0.0, 1.0, 2.0, 3.0, 4.0]}, piece_starts=[0, 2, 3])
    >>> pick(data, np.array([1, 3, 4])).piece_starts
    array([0, 1])
    """
    # the start of a piece that vanishes coincides with the next one, or with the end
    starts = np.unique(np.searchsorted(samples, data.piece_starts))
    return replace(
        data,
        channels=tuple(replace(channel, values=channel.values[samples]) for channel in data.channels),
        time=None if data.time is None else data.time[samples],
        piece_starts=starts[starts < samples.size] if samples.size else np.zeros(1, dtype=np.int64),
        scored=None if data.scored is None else data.scored[samples],
        recorded=None if data.recorded is None else data.recorded[samples],
        files=None if data.files is None else data.files.picked(samples),
    )


def time_steps(time: Float, starts: Int, between: float = np.nan) -> Iterator[tuple[int, Float]]:
    """Yield a number of a sample and the steps in s before it and the samples after it, block by block.

    Args:
        time: time stamps in s, Float[samples].
        starts: first sample of each piece, Int[pieces].
        between: stands for the steps from one piece to the next.

    >>> [steps for _, steps in time_steps(np.array([0.0, 0.1, 0.0, 0.2]), np.array([0, 2]))]
    [array([0.1, nan, 0.2])]
    """
    for first in range(1, time.size, SAMPLES_PER_BLOCK):
        last = min(first + SAMPLES_PER_BLOCK, time.size)
        steps = np.diff(time[first - 1 : last])
        # steps[k] leads to sample first + k; one that leads to a start comes from another piece
        begin, end = np.searchsorted(starts, [first, last])
        steps[starts[begin:end] - first] = between
        yield first, steps


def longest_usual_step(steps: Float) -> float:
    """Return the step in s beyond which a time step is a pause of the recording.

    The usual step is the upper quartile, not the median: where two rasters share a recording, neither of their steps is
    a pause, even if each second step is many times longer than the one before.

    Args:
        steps: time steps in s within pieces, at least one; Float[steps].

    >>> longest_usual_step(np.array([0.1, 0.1, 0.1, 60.0])) < 60.0
    True
    >>> longest_usual_step(np.array([0.02, 0.5, 0.02, 0.5])) < 0.5
    False
    """
    # "lower" gives a step that occurs, not a number between a usual step and a pause
    return PAUSE * (1.0 + _ROUNDING) * float(np.quantile(steps, _USUAL, method="lower"))


def replace_infinite(values: Float) -> tuple[Float, str]:
    """Replace infinite values by NaN, Float[any], and count them in a message; it is empty if there are none.

    >>> replace_infinite(np.array([1.0, np.inf]))
    (array([ 1., nan]), '1 of 2 values is infinite and treated as missing')
    """
    infinite = np.isinf(values)
    count = int(np.count_nonzero(infinite))
    if not count:
        return values, ""
    verb = "is" if count == 1 else "are"
    return np.where(infinite, np.nan, values), f"{count} of {values.size} values {verb} infinite and treated as missing"


def concatenate(name: str, parts: Sequence[Dataset]) -> Dataset:
    """Return one dataset of several recordings, each a separate piece, with the channels common to all.

    Time stamps are unchanged; either all parts must have them or none. Other attributes are those of the first part.
    """
    if not parts:
        raise ArgumentError(f"dataset {name} needs at least one recording")
    if len({part.time is None for part in parts}) > 1:
        raise ArgumentError(f"dataset {name} mixes recordings with and without time stamps")
    if len(parts) == 1:
        return parts[0] if parts[0].name == name else replace(parts[0], name=name)
    shared = [channel for channel in parts[0].channels if all(channel.name in part for part in parts)]
    channels = tuple(replace(c, values=np.concatenate([part[c.name].values for part in parts])) for c in shared)
    # starts count from the beginning of their own part
    offsets = np.cumsum([0, *(part.samples for part in parts[:-1])])
    starts = np.concatenate([part.piece_starts + offset for part, offset in zip(parts, offsets, strict=True)])
    time = None if parts[0].time is None else np.concatenate([p.time for p in parts if p.time is not None])
    scored, recorded = None, None
    if any(part.scored is not None for part in parts):
        scored = np.concatenate([part.counting for part in parts])
    if any(part.recorded is not None for part in parts):
        recorded = np.concatenate([np.ones(p.samples, bool) if p.recorded is None else p.recorded for p in parts])
    # parts of one recording repeat what its reader has reported
    findings = tuple(dict.fromkeys(finding for part in parts for finding in part.findings))
    return replace(
        parts[0],
        name=name,
        channels=channels,
        time=time,
        piece_starts=starts,
        scored=scored,
        recorded=recorded,
        findings=findings,
        files=join_files([part.files for part in parts], [part.samples for part in parts]),
        start_time=common_start_time([part.start_time for part in parts]),
    )


def common_start_time(times: Sequence[datetime | None]) -> datetime | None:
    """Return the start time of recordings that are joined; None if they differ."""
    return times[0] if len(set(times)) == 1 else None


def join_files(files: Sequence[FileSpans | None], samples: Sequence[int]) -> FileSpans | None:
    """Return the files of parts that follow each other, given their samples; None if those of a part are unknown.

    A part of a file counts as a whole file.
    """
    names: list[str] = []
    lengths: list[int] = []
    times: list[datetime | None] = []
    for own, count in zip(files, samples, strict=True):
        if own is None:
            return None
        names += own.names
        # without the samples of the file that are outside of the part
        lengths += own.sizes(count).tolist()
        times += own.start_times
    return FileSpans.joined(names, lengths, times)
