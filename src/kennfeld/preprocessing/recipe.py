"""Settings of datasets: their files, and how they are prepared."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Literal, Protocol

from kennfeld.base.errors import Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Use
from kennfeld.domain.file_keys import KeyProblem, key
from kennfeld.measurement.bus_databases import Network

_DBC_EXAMPLE = 'Write dbc = "engine.dbc", or { file = "engine.dbc", bus = 1 }.'
_EXAMPLE = 'Write steady = { channel = "Speed", window = 5.0, tolerance = 10 }.'


@dataclass(frozen=True)
class SteadyEntry:
    """One condition of `steady`: the channel stays within a band of +-tolerance for at least `window` s."""

    channel: str = key("the channel that is steady", holds="channel", missing=_EXAMPLE)
    window: float = key("the shortest plateau", above=0, unit="s", missing=_EXAMPLE)
    tolerance: float = key("half the width of the band", least=0, missing=_EXAMPLE)


@dataclass(frozen=True)
class DatabaseEntry:
    """One CAN database in `dbc`, and the bus that it describes."""

    file: str = key("the database (DBC)", holds="CAN database", missing=_DBC_EXAMPLE)
    bus: int | None = key("number of the channel that it describes", None, least=1, default_text="all")
    network: Network = key('the kind of bus, `"CAN"` or `"LIN"`', "CAN")


@dataclass(frozen=True)
class DatasetEntry:
    """The settings of one dataset, a `[[dataset]]` of a project file."""

    location: Location
    files: tuple[str, ...] = key(
        "paths or patterns such as `drive_*.csv`; `book.xlsx#Sheet` names a sheet. Each file is a separate piece: "
        "memories are reset at its start",
        holds="recording",
        missing='Write files = ["..."].',
    )
    dbc: tuple[str | DatabaseEntry, ...] = key(
        "for [bus logs](formats.md#bus-logs): a CAN database (DBC), a pattern, or a list of them. "
        '`{ file = "engine.dbc", bus = 1 }` describes one channel of the logger, and `network = "LIN"` LIN frames',
        (),
        word="one bus",
        remedy=_DBC_EXAMPLE,
        holds="CAN database",
    )
    name: str = key("name of the dataset in messages and results", "", default_text="the file's stem")
    use: Literal["training", "test", "off"] = key(
        '`"test"`: scored, never fitted; `"off"`: not read, as if it were not there', "training"
    )
    weight: float = key("factor on the squared errors; 0 switches off", 1.0, least=0)
    raster: float | None = key(
        "resamples recordings to a uniform raster; required for MDF channels with different rasters",
        None,
        above=0,
        unit="s",
    )
    where: str = key(
        "a condition over channels; samples that do not satisfy it are simulated, but not scored", "", holds="condition"
    )
    warmup: float = key(
        "time at the start of each piece, also after a gap, that is simulated, but not scored", 0.0, least=0, unit="s"
    )
    max_gap: float = key(
        "gaps in an input up to this length are interpolated, longer ones split the piece. Pauses of the recording "
        "also split it: time steps longer than this and longer than 20 typical steps",
        0.0,
        least=0,
        unit="s",
    )
    shift: Mapping[str, float | Literal["auto"]] = key(
        "`{ Torque = -1.0 }` shifts a channel: value(t) = recorded(t - shift). In s; for steady points in samples. "
        '`{ Torque = "auto" }` [estimates it](method.md#shifts)',
        factory=dict,
        by="channel",
    )
    weight_channel: str = key(
        "a channel with the weight of each sample, >= 0; missing values count as 0", "", holds="channel"
    )
    steady: tuple[SteadyEntry, ...] = key(
        '`{ channel = "Speed", window = 5.0, tolerance = 10 }` [averages the plateaus](#steady-points-of-a-recording) '
        "of a recording to steady points",
        (),
        word="steady",
        fault="must be a table or a list of tables",
        remedy=_EXAMPLE,
        takes_one=True,
        fills=True,
    )
    settle: float | None = key(
        "for functions with memory on steady-state points: how long each [point is "
        "held](method.md#steady-state-points-and-memory). Time stamps are ignored",
        None,
        above=0,
        unit="s",
    )
    average: float = key(
        "time at the end of `settle` over which the output is averaged; 0 takes the last value",
        0.0,
        least=0,
        unit="s",
    )
    cache: bool = key("`false`: the files are [read again](#files-that-take-long-to-read) in each run", True)
    step: float | None = key(
        "the step of the function while a point is held",
        None,
        above=0,
        unit="s",
        default_text="`step` of `[model]`",
    )

    @property
    def scored_as(self) -> Use:
        """The use of what is read: an entry that is off is none of a project."""
        return "test" if self.use == "test" else "training"

    @property
    def is_fitted(self) -> bool:
        """True if values are fitted to it: training data with a weight above 0."""
        return self.use == "training" and self.weight > 0

    @property
    def database_files(self) -> tuple[str, ...]:
        """The CAN databases, as paths or patterns."""
        return tuple(item if isinstance(item, str) else item.file for item in self.dbc)

    @property
    def known_shifts(self) -> dict[str, float]:
        """The given shifts by channel, in s, or in samples without time stamps."""
        return {name: shift for name, shift in self.shift.items() if shift != "auto"}

    @property
    def unknown_shifts(self) -> tuple[str, ...]:
        """Channels whose shift is to be estimated."""
        return tuple(name for name, shift in self.shift.items() if shift == "auto")

    def problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        """Yield contradictions between the keys."""
        if "settle" in present:
            yield from self._settle_problems(present)
        else:
            remedy = "Write settle = ... in s, or remove it."
            yield from ((name, f"{name} requires settle", remedy) for name in ("average", "step") if name in present)
        if "steady" in present:
            yield from self._steady_problems(present)

    def _settle_problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        for name in ("raster", "warmup", "max_gap"):
            if name in present and "steady" not in present:  # which averages a recording to points first
                yield name, f"{name} contradicts settle, which is for steady-state points", "Remove one."
        for name, value in (("average", self.average), ("step", self.step)):
            if self.settle is not None and value is not None and value > self.settle:
                yield name, f"must be <= settle = {self.settle:g} s, got {value:g} s", "Shorten it."

    def _steady_problems(self, present: Collection[str]) -> Iterator[KeyProblem]:
        channels = [condition.channel for condition in self.steady]
        for number, channel in enumerate(channels, 1):
            if channel in channels[: number - 1]:
                yield f"steady {number}", f"duplicate channel {channel}", "Remove one."
        if "warmup" in present:
            remedy = f'Write where = "t > {self.warmup:g}", or remove it.'
            yield "warmup", "warmup contradicts steady: averaged points have no warm-up", remedy
        if self.unknown_shifts:
            message = 'shift = "auto" contradicts steady: averaged points have no time'
            yield "shift", message, f"Write {self.unknown_shifts[0]} = ... in s."


def used_entries(entries: Iterable[DatasetEntry]) -> tuple[DatasetEntry, ...]:
    """Return the entries that are not off."""
    return tuple(entry for entry in entries if entry.use != "off")


class DataSettings(Protocol):
    """All settings of the recordings of a project."""

    @property
    def folder(self) -> Path:
        """Folder that file names are relative to."""

    @property
    def datasets(self) -> tuple[DatasetEntry, ...]:
        """Datasets, in order."""

    @property
    def channels(self) -> Mapping[str, str]:
        """Channel of each input that has another name."""

    @property
    def calculated(self) -> Mapping[str, str]:
        """Formula of each calculated channel."""

    @property
    def units(self) -> Mapping[str, str]:
        """Stated unit of each channel."""

    def location(self, *keys: str | int) -> Location:
        """Return the location of a section or key, such as `"units", "Speed"`."""
