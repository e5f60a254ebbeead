"""Settings of recordings: what a dataset is made of, and how it is prepared."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from kennfeld.dataset import Use

__all__ = ["DataSettings", "DatasetEntry", "SteadyEntry"]


@dataclass(frozen=True)
class SteadyEntry:
    """One condition of `steady`: the channel stays within a band of +-tolerance for at least `window` s."""

    channel: str
    window: float
    tolerance: float


@dataclass(frozen=True)
class DatasetEntry:
    """One `[[dataset]]`."""

    place: str
    files: tuple[str, ...]
    name: str = ""
    use: Use = "training"
    weight: float = 1.0
    raster: float | None = None
    where: str = ""
    warmup: float = 0.0
    max_gap: float = 0.0
    shift: Mapping[str, float] | None = None
    unknown_shifts: tuple[str, ...] = ()  # channels whose shift is to be found
    weight_channel: str = ""
    settle: float | None = None
    average: float = 0.0
    step: float | None = None
    steady: tuple[SteadyEntry, ...] = ()
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
