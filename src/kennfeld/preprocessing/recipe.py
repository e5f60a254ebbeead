"""Settings of datasets: their files, and how they are prepared."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from kennfeld.dataset import Use


@dataclass(frozen=True)
class SteadyEntry:
    """One condition of `steady`: the channel stays within a band of +-tolerance for at least `window` s."""

    channel: str
    window: float
    tolerance: float


@dataclass(frozen=True)
class DatasetEntry:
    """The settings of one dataset, a `[[dataset]]` of a project file."""

    place: str  # location for messages
    files: tuple[str, ...]  # patterns
    name: str = ""
    use: Use = "training"
    weight: float = 1.0
    raster: float | None = None  # s
    where: str = ""  # formula text; samples at which it is 0 are not scored
    warmup: float = 0.0  # s
    max_gap: float = 0.0  # s
    shift: Mapping[str, float] | None = None  # s, or samples without time stamps
    unknown_shifts: tuple[str, ...] = ()  # channels whose shift is to be estimated
    weight_channel: str = ""
    settle: float | None = None  # s for which steady-state points are held
    average: float = 0.0  # s at their end that are averaged
    step: float | None = None  # s, of the model while it settles
    steady: tuple[SteadyEntry, ...] = ()  # conditions of plateaus
    cache: bool = True


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

    def place(self, part: str) -> str:
        """Return how a message names a part of the settings: `kennfeld.toml [units]`."""
