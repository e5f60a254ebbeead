"""The steady-state points of a recording, as a `[[dataset]]` asks for them, or why there are none."""

from collections.abc import Sequence

import numpy as np

from kennfeld.arrays import Bool, Int
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding
from kennfeld.project.plateaus import averaged, least_tolerance, longest, plateaus, segments, stretches
from kennfeld.project.schema import DatasetEntry, SteadyEntry

__all__ = ["steady_points"]


def steady_points(dataset: Dataset, entry: DatasetEntry, findings: list[Finding]) -> Dataset | None:
    """A point for each plateau of a recording; None, and a finding, where there is no plateau.

    A plateau is a stretch of at least the longest `window` in which every channel of `steady` stays within a band of
    +-tolerance. Samples that do not count, or lack one of these channels, are left out of the means; a row of them
    that lasts longer than `max_gap` ends a plateau, as a pause and the end of a piece do.
    """
    if dataset.time is None:
        raise AssertionError("checked before: there are time stamps")
    work = _Detection(dataset, entry)
    found = work.plateaus()
    if not found:
        what, mend = work.why_none()
        findings.append(Finding(f"{entry.place} steady", what, mend))
        return None
    findings.append(Finding(f"{entry.place} steady", work.told(found), severity="remark"))
    return averaged(dataset, work.counts, found)


class _Detection:
    """The samples of a recording that count, in segments without a gap."""

    def __init__(self, dataset: Dataset, entry: DatasetEntry) -> None:
        self.entry, self.whole = entry, dataset
        self.window = max(one.window for one in entry.steady)
        self.counts = _counting(dataset, [one.channel for one in entry.steady])
        stamps = dataset.time if dataset.time is not None else np.empty(0)
        self.time = stamps[self.counts]
        self.starts = segments(stamps, dataset.starts, self.counts, entry.max_gap)
        self.values = [dataset[one.channel].values[self.counts] for one in entry.steady]
        self.firsts: list[Int] = [
            stretches(values, one.tolerance, self.starts) for values, one in zip(self.values, entry.steady, strict=True)
        ]
        self.first: Int = np.maximum.reduce(self.firsts)

    def plateaus(self) -> list[tuple[int, int]]:
        """First and last sample of each plateau, among those that count."""
        return plateaus(self.time, self.first, self.window) if self.time.size else []

    def told(self, found: Sequence[tuple[int, int]]) -> str:
        """How many plateaus there are, and how much of the recording they cover."""
        lengths = [float(self.time[end] - self.time[begin]) for begin, end in found]
        stamps = self.whole.time if self.whole.time is not None else np.empty(0)
        total = sum(float(stamps[piece.stop - 1] - stamps[piece.start]) for piece in self.whole.pieces)
        sizes = " to ".join(dict.fromkeys(f"{length:.3g} s" for length in (min(lengths), max(lengths))))
        count = f"{len(found)} plateau{'s' * (len(found) > 1)} of {sizes}"
        return f"{count}, {sum(lengths) / total:.0%} of the {total:.4g} s recorded"

    def why_none(self) -> tuple[str, str]:
        """What stands in the way of a plateau, and what would give one."""
        if not self.time.size:
            names = ", ".join(one.channel for one in self.entry.steady)
            return f"no sample that counts has {names}", "Check the channel, and the condition `where`."
        ends = np.append(self.starts[1:], self.time.size) - 1
        whole = float(np.max(self.time[ends] - self.time[self.starts]))
        if whole < self.window:
            what = f"no stretch of the recording without a gap is {self.window:g} s long; the longest has {whole:.3g} s"
            return what, f"Shorten the window, or raise max_gap = {self.entry.max_gap:g}."
        return self._none_in_band()

    def _none_in_band(self) -> tuple[str, str]:
        length, begin = longest(self.time, self.first)
        bands = " and ".join(f"{one.channel} within +-{one.tolerance:g}" for one in self.entry.steady)
        what = f"no stretch of {self.window:g} s has {bands}; the longest has {length:.3g} s, from {begin:.6g} s on"
        if len(self.entry.steady) > 1:
            alone = [f"{one.channel} {longest(self.time, first)[0]:.3g} s" for one, first in self._each()]
            return f"{what}; each alone: {', '.join(alone)}", "Raise a tolerance, or shorten the window."
        least = _rounded_up(least_tolerance(self.time, self.values[0], self.starts, self.window))
        return what, f"tolerance = {least:g} would give one."

    def _each(self) -> list[tuple[SteadyEntry, Int]]:
        return list(zip(self.entry.steady, self.firsts, strict=True))


def _counting(dataset: Dataset, names: Sequence[str]) -> Bool:
    """The samples that are scored and have all channels."""
    counts = np.ones(dataset.samples, dtype=bool) if dataset.scored is None else dataset.scored.copy()
    for name in names:
        counts &= np.isfinite(dataset[name].values)
    return counts


def _rounded_up(value: float) -> float:
    """To three digits, so that it suffices as written.

    >>> _rounded_up(13.3333)
    13.4
    """
    if not value > 0:
        return value
    unit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.3g}")
