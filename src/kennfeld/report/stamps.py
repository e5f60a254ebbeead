"""Times of the points of a trace, collected part by part."""

from dataclasses import field
from itertools import pairwise

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.analysis.part_evaluation import PartPlace
from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.trace_envelope import TraceEnvelope


@dataclass
class Stamps:
    """Times of the drawn samples, or their numbers; and the first, second and last time of each piece."""

    timed: bool
    whole: bool
    drawn: list[Float] = field(default_factory=list)
    owners: list[Int] = field(default_factory=list)  # the piece of each drawn sample
    pieces: list[Float] = field(default_factory=list)  # Float[3, pieces]

    @classmethod
    def of(cls, groups: TraceEnvelope, timed: bool, place: PartPlace, series: CriterionSeries) -> "Stamps":
        """Return the stamps of a part, one for each group."""
        bound, time = series.bound, series.time
        at = groups.firsts(place.first, place.first + bound.count) - place.first
        stamps = cls(timed, groups.whole)
        numbers = (place.begin + bound.kept).astype(np.float64) if time is None else time
        stamps.drawn.append(numbers[at])
        stamps.owners.append(place.piece + np.searchsorted(bound.starts, at, side="right") - 1)
        # a piece that continues has its first time in the part before
        edges = [*bound.starts[place.continues :].tolist(), bound.count]
        ends = [[numbers[a], numbers[min(a + 1, b - 1)], numbers[b - 1]] for a, b in pairwise(edges)]
        stamps.pieces.append(np.array(ends).reshape(-1, 3).T)
        return stamps

    def merge(self, later: "Stamps") -> None:
        """Take in the stamps of the following part."""
        self.drawn += later.drawn
        self.owners += later.owners
        self.pieces += later.pieces

    def along(self) -> tuple[Float, str, str, Float]:
        """Return the x axis Float[points] with its title and unit, and where pieces begin, Float[pieces - 1].

        That is the time, with pieces in a row if it restarts in each, else the sample number.
        """
        drawn, owners = np.concatenate(self.drawn), np.concatenate(self.owners)
        firsts, seconds, lasts = np.concatenate(self.pieces, axis=1)
        # minimum and maximum of a group are drawn at the time of its first sample
        twice = drawn if self.whole else np.repeat(drawn, 2)
        if not self.timed:
            return twice, "sample", "", firsts[1:]
        # time goes on from piece to piece, as in one recording with gaps
        if np.all(firsts[1:] > lasts[:-1]):
            return twice, "time", "s", firsts[1:]
        shifts, end = np.empty(firsts.size), 0.0
        for number, (first, second, last) in enumerate(zip(firsts, seconds, lasts, strict=True)):
            shifts[number] = end - first
            # the next piece begins a step after this one ends
            end = float(last + shifts[number]) + float(second - first)
        row = drawn + shifts[owners]
        return row if self.whole else np.repeat(row, 2), "time, recordings in a row", "s", (firsts + shifts)[1:]
