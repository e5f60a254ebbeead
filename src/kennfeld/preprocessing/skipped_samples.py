"""Samples of a dataset on which a model cannot be run, because one of its inputs has no value there."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool, Float, runs_of
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.preprocessing.binding import BoundDataset

MAX_GAPS = 100  # that are listed


@dataclass(frozen=True)
class Gap:
    """Consecutive samples without a value of an input; numbered from 1, and in s if the data have time stamps."""

    first: int
    last: int
    begin: float | None
    end: float | None

    def __str__(self) -> str:
        numbers = f"sample {self.first}" if self.first == self.last else f"samples {self.first} to {self.last}"
        if self.begin is None or self.end is None:
            return numbers
        return f"{numbers} ({self.begin:.6g} s)" if self.first == self.last else f"{numbers} ({self._span})"

    @property
    def _span(self) -> str:
        return f"{self.begin:.6g} to {self.end:.6g} s"


@dataclass(frozen=True)
class SkippedSamples:
    """The samples of a dataset that are not simulated.

    Attributes:
        dataset: its name.
        recorded: number of its samples.
        skipped: number of those that are not simulated.
        inputs: how many samples each channel that the model reads has no value at, by its name.
        gap_count: number of runs of consecutive skipped samples.
        gaps: the first of them; empty if they are not known.
        restarts: True if states start anew after each gap.
    """

    dataset: str
    recorded: int
    skipped: int
    inputs: Mapping[str, int]
    gap_count: int
    gaps: tuple[Gap, ...]
    restarts: bool

    @classmethod
    def of(
        cls, bound: BoundDataset, channels: Mapping[str, str], *, restarts: bool, recorded: Bool | None = None
    ) -> "SkippedSamples | None":
        """Collect the samples of a bound dataset that are not kept, None if all are.

        Args:
            bound: the dataset.
            channels: the channel of each input that has another name.
            restarts: if the model has states.
            recorded: the samples of the data among those of a finer step of the model.
        """
        dataset, skips = bound.dataset, np.ones(bound.dataset.samples, dtype=bool)
        skips[bound.kept] = False
        here = slice(None) if recorded is None else recorded
        skips, time = skips[here], None if dataset.time is None else dataset.time[here]
        if not skips.any():
            return None
        missing = {
            channels.get(n, n): int(np.count_nonzero(skips & ~np.isfinite(x[here]))) for n, x in bound.inputs.items()
        }
        inputs = {name: count for name, count in missing.items() if count}
        runs = runs_of(skips)
        gaps = tuple(_gap(time, first, end - 1) for first, end in runs[:MAX_GAPS].tolist())
        return cls(dataset.name, skips.size, int(np.count_nonzero(skips)), inputs, len(runs), gaps, restarts)

    def joined(self, other: "SkippedSamples | None") -> "SkippedSamples":
        """Return both together, without the places of the gaps."""
        if other is None:
            return self
        names = dict.fromkeys((*self.inputs, *other.inputs))
        inputs = {name: self.inputs.get(name, 0) + other.inputs.get(name, 0) for name in names}
        sums = {name: getattr(self, name) + getattr(other, name) for name in ("recorded", "skipped", "gap_count")}
        return replace(self, inputs=inputs, gaps=(), **sums)

    def finding(self, location: Location) -> Finding:
        """Return a warning that says which samples are skipped, and why."""
        names = join_names(list(self.inputs), 4)
        has = "have" if len(self.inputs) > 1 else "has"
        first = f", the first one at {self.gaps[0]}" if self.gaps else ""
        place = (
            f" in {self.gap_count} gaps{first}" if self.gap_count > 1 else f" at {self.gaps[0]}" if self.gaps else ""
        )
        are = "is" if self.skipped == 1 else "are"
        message = f"{self.skipped} of {self.recorded} samples {are} not simulated: {names} {has} no value{place}"
        is_timed = bool(self.gaps) and self.gaps[0].begin is not None
        again = "The states start anew after each gap; m" if self.restarts else "M"
        remedy = f"{again}ax_gap, in s, interpolates short ones." if is_timed else ""
        return Finding(location, message, remedy, severity="warning")

    def as_dict(self) -> dict[str, Any]:
        """Return the contents for JSON."""
        return {name: value for name, value in asdict(self).items() if name not in ("dataset", "restarts")}


def _gap(time: Float | None, first: int, last: int) -> Gap:
    begin, end = (None, None) if time is None else (float(time[first]), float(time[last]))
    return Gap(first + 1, last + 1, begin, end)
