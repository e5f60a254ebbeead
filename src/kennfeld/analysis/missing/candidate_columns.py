"""The columns of a family of candidates at the samples: hats of channels, and slopes by the nodes."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kennfeld.analysis.missing.families import Family, HatPlaces
from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.native.samples import Chunk
from kennfeld.native.workspace import Workspace
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.tuning.holdout_blocks import NEVER, Divisions, number_samples


@dataclass
class CandidateColumns:
    """The columns of a family at the samples, by visit."""

    compiled: CompiledProblem
    family: Family
    blocks: int
    block_of: NDArray[np.int32]
    numbers: Int  # of the sample at each visit
    places: HatPlaces
    channels: Mapping[str, Float]  # by sample
    probes: list[int]  # columns of the kernel

    @classmethod
    def of_all(
        cls, compiled: CompiledProblem, families: Sequence[Family], divisions: Divisions, blocks: int
    ) -> "list[CandidateColumns]":
        """Return the columns of families, which share their channels."""
        numbers, block_of = compiled.sample_numbers(), block_numbers(compiled, divisions, blocks)
        places = [HatPlaces(family.axes) for family in families]
        names = dict.fromkeys(name for own in places for name in own.channels)
        channels = {name: _channel(compiled, name) for name in names}
        probes = [[compiled.values.offsets[name] for name in family.factors] for family in families]
        return [
            cls(compiled, family, blocks, block_of, numbers, own, channels, columns)
            for family, own, columns in zip(families, places, probes, strict=True)
        ]

    def factors(self, space: Workspace, chunk: Chunk, scales: Float | None) -> Float:
        """Return the slopes of outputs, then of states, Float[samples, rows, factors].

        Args:
            space: holds the tape.
            chunk: the samples.
            scales: what the slopes of the samples are multiplied with, Float[samples, factors].
        """
        slopes = np.zeros((chunk.length, space.slope.shape[2], len(self.probes)))
        fixed = self.compiled.kernel.entries.fixed
        for at, column in enumerate(self.probes):
            if fixed:
                for place in np.flatnonzero(space.index[0] == column).tolist():
                    slopes[:, :, at] += space.slope[: chunk.length, place]
                continue
            used = np.arange(space.index.shape[1]) < space.count[: chunk.length, None]
            sample, entry = np.nonzero((space.index[: chunk.length] == column) & used)
            np.add.at(slopes[:, :, at], sample, space.slope[sample, entry])
        if scales is not None:
            slopes *= scales[:, None, :]
        return slopes

    def corners(self, chunk: Chunk) -> list[tuple[NDArray[np.int32], Float, Float]]:
        """Return cells and shares of hats, and the weight of each sample; of maps for both rows of a cell."""
        family = self.family
        cells, shares = self.places.locate(self.channels, self.numbers[chunk.first : chunk.last])
        if not family.grid:
            return [(cells, shares, np.ones(chunk.length))]
        rows, width = (len(axis.points) for axis in family.axes)
        first = np.ascontiguousarray(cells[:, :1] * width + cells[:, 1:] - rows)
        across, along = shares[:, 0], np.ascontiguousarray(shares[:, 1:])
        second = first + np.int32(width)
        return [(first, along, 1 - across), (second, along, across)]


def _channel(compiled: CompiledProblem, name: str) -> Float:
    """Return a channel at all samples, the last known value of the recording in its gaps, Float[samples]."""
    own = [bound.at_kept(_without_gaps(bound.dataset, name)) for bound in compiled.problem.gathered]
    # of one dataset its own array, not a copy
    return own[0] if len(own) == 1 else np.concatenate(own)


def _without_gaps(dataset: Dataset, name: str) -> Float:
    """Return a channel with the last known value of each piece in its gaps, at its start the first one."""
    values = dataset[name].values
    if np.isfinite(values).all():
        return values
    values = values.copy()
    for piece in dataset.pieces:
        own = values[piece]
        known = np.isfinite(own)
        latest = np.maximum.accumulate(np.where(known, np.arange(own.size), -1))
        values[piece] = own[np.maximum(latest, int(np.argmax(known)) if own.size else 0)]
    return values


def block_numbers(compiled: CompiledProblem, divisions: Divisions, blocks: int) -> NDArray[np.int32]:
    """Return the block of each visit; `blocks` for those in none."""
    if not divisions:
        return np.full(compiled.samples.count, blocks, dtype=np.int32)
    numbers = number_samples(compiled, divisions)[compiled.sample_numbers()]
    return np.where(numbers == NEVER, blocks, numbers).astype(np.int32)


def block_runs(blocks: NDArray[np.int32]) -> list[tuple[int, int]]:
    """Return the first sample of each run of one block, and the one behind its last.

    >>> block_runs(np.array([0, 0, 1], dtype=np.int32))
    [(0, 2), (2, 3)]
    """
    edges = [0, *(np.flatnonzero(np.diff(blocks)) + 1).tolist(), blocks.size]
    return [*pairwise(edges)]
