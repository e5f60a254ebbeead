"""Some recordings of data in partitions, evenly spaced, as partitions of their own: a search begins with them."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.samples import Samples, pick_evenly
from kennfeld.optimize.problem.partitions import Part, Partitions, group_parts
from kennfeld.preprocessing.binding import BoundDataset

GROUPS = 8  # about as many partitions: enough for several workers, and few enough to be sent quickly


class _BoundProblem(Protocol):
    """A problem over one partition."""

    @property
    def gathered(self) -> tuple[BoundDataset, ...]: ...


class _CompiledPartition(Protocol):
    """The compiled problem over one partition."""

    @property
    def problem(self) -> _BoundProblem: ...
    @property
    def samples(self) -> Samples: ...


@dataclass(frozen=True)
class PartRecording:
    """A recording within a part of a partition: samples `first` to before `last`, and how many each criterion scores.

    `part` is the number of the part in its partition.
    """

    part: int
    first: int
    last: int
    scored: tuple[int, ...]


def count_recordings(compiled: _CompiledPartition) -> list[PartRecording]:
    """Return the recordings of one partition; for models with memory, whose samples are in the order of the data."""
    samples, recordings, end = compiled.samples, list[PartRecording](), 0
    for number, bound in enumerate(compiled.problem.gathered):
        starts, kept = bound.dataset.piece_starts, bound.kept
        counts = np.zeros((starts.size, len(samples.targets)), dtype=np.int64)
        for piece in samples.pieces:
            if end <= piece.first < end + bound.count:
                # states may restart within a recording: a piece belongs to the recording in which it begins
                at = np.searchsorted(starts, kept[piece.first - end], side="right") - 1
                counts[at] += samples.scored(piece)
        end += bound.count
        edges = pairwise([*starts.tolist(), bound.dataset.samples])
        recordings += [
            PartRecording(number, *edge, tuple(own)) for edge, own in zip(edges, counts.tolist(), strict=True)
        ]
    return recordings


def pick_recordings(
    partitions: Partitions, counted: Iterable[Sequence[PartRecording]], share: float, least: int
) -> Partitions:
    """Return about this share of the recordings, evenly spaced, with the total weight of all.

    They follow from the files and what they measure, never from who evaluates them.

    Args:
        partitions: the data; returned if there are few recordings, or if half of the samples would not do.
        counted: the recordings of each training partition.
        share: of the recordings.
        least: number of those that measure the same.
    """
    parts: list[Part] = []
    scored: list[tuple[int, ...]] = []
    for partition, recordings in zip(partitions.training, counted, strict=True):
        for each in recordings:
            whole = partition.parts[each.part]
            parts.append(replace(whole, first=whole.first + each.first, last=whole.first + each.last))
            scored.append(each.scored)
    if len(parts) < 2 * least:
        return partitions
    weights = [np.float64(partitions.recordings.recipes[part.dataset].entry.weight).tobytes() for part in parts]
    factors = pick_evenly(weights, np.array(scored), share, least)
    picked = [replace(parts[i], factors=tuple(own.tolist())) for i, own in factors.items()]
    samples = sum(part.samples for part in picked)
    # more than half of the samples would save little
    if not picked or 2 * samples > partitions.samples:
        return partitions
    return replace(partitions, training=tuple(group_parts(picked, -(-samples // GROUPS))))
