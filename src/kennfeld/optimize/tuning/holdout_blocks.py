"""Held-out blocks of recordings for cross-validation.

Errors of a model in time are correlated, and only data held out in contiguous blocks show how a fit generalises. A fit
without a block does not need the data again: its matrix is that of all data minus that of the block.

Blocks follow from the recordings and their numbers of scored samples, however these are divided into partitions: one
pass counts, and each partition then numbers its own samples.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.native.samples import Piece, Samples
from kennfeld.native.symmetric import as_array
from kennfeld.optimize.problem.partitions import Part, StoredDatasets, follows
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.partitioned_sums import NormalAddition, PackedNormal, pack
from kennfeld.preprocessing.binding import BoundDataset

BLOCKS = 20  # approximate number of blocks
FEWEST = 3  # blocks
MAX_ENTRIES = 25_000_000  # of all matrices together, 200 MB
NEVER = -1  # block number of samples that are never held out
SAMPLES_PER_BLOCK = 2**16  # targets read at once

Key = Part | int  # a part of a file, or the number of a dataset


class RecordingRange(NamedTuple):
    """Samples of a recording in time, or of its part in a partition, as the data come, and how many of them count."""

    first: int
    last: int
    scored: int


class Division(NamedTuple):
    """The division of a recording into blocks with similar numbers of scored samples.

    `first` and `last` are the samples that a partition has of it, and `before` the scored ones before them.
    """

    first: int
    last: int
    block: int  # number of its first block
    blocks: int
    before: int
    scored: int  # samples of the whole recording


Divisions = Mapping[Key, Sequence[Division]]


@dataclass(frozen=True)
class HoldoutBlock:
    """Contribution of a block with a `share` of the samples: misfit(p + d) = misfit + 2 gradient'd + d'matrix d."""

    misfit: float
    gradient: Float  # Float[values]
    matrix: Float  # Float[values, values]
    share: float


@dataclass(frozen=True, eq=False)
class HoldoutBlocks:
    """The blocks of the recordings of a compiled problem."""

    compiled: CompiledProblem
    divisions: Divisions
    sizes: Int  # Int[blocks], scored samples

    @classmethod
    def of(cls, compiled: CompiledProblem, blocks: int | None = None) -> "HoldoutBlocks | None":
        """Divide the recordings into about `blocks` blocks with similar numbers of scored samples.

        By default they are `BLOCKS`, or as few as the memory of their matrices allows.

        Many short recordings are held out whole, neighbouring ones together. Steady-state points are never held out.
        Returns None if there are fewer than `FEWEST` blocks.
        """
        # each block has a dense matrix of its own
        most = min(BLOCKS, MAX_ENTRIES // max(compiled.values.free**2, 1)) if blocks is None else blocks
        if most < FEWEST:
            return None
        groups = _joined([row for part in compiled.each(_find_recordings) for row in part])
        divisions, sizes = _divide(groups, most)
        return None if sizes.size < FEWEST else cls(compiled, divisions, sizes)

    @property
    def numbers(self) -> Int:
        """The block number of each sample, as the data come, Int[samples]; `NEVER` for samples always fitted."""
        return number_samples(self.compiled, self.divisions)

    def linearise(self, full: Float) -> Iterator[HoldoutBlock]:
        """Yield the contribution of each block at free and fixed values, Float[values]."""
        misfits = np.zeros(self.sizes.size)
        totals: dict[int, NormalAddition] = {}
        for part in self.compiled.each(_sum_blocks, self.divisions, full):
            for number, misfit, normal in part:
                misfits[number] += misfit
                if number in totals:
                    totals[number].add(normal)
                else:
                    totals[number] = NormalAddition(normal)
        for number, share in enumerate(self.sizes / self.sizes.sum()):
            equations = totals.pop(number).result()
            yield HoldoutBlock(float(misfits[number]), equations.gradient, as_array(equations.matrix), float(share))


def _find_recordings(compiled: CompiledProblem) -> list[tuple[Key, bool, list[RecordingRange]]]:
    """Return the recordings in each training dataset, and whether the first one continues that of another part."""
    problem = compiled.problem
    datasets = problem.datasets
    continuing = datasets.continuing if isinstance(datasets, StoredDatasets) else [False] * len(datasets)
    rows = zip(_keys(datasets), continuing, datasets, strict=True)
    fitted = [(key, continues) for key, continues, data in rows if data.is_fitted]
    counted = _count_scored(compiled, sum(bound.count for bound in problem.gathered))
    result, end = [], 0
    for (key, continues), bound in zip(fitted, problem.gathered, strict=True):
        edges = [(end + a, end + b) for a, b in _recordings(problem, bound)]
        result.append((key, continues, [RecordingRange(a, b, int(counted[b] - counted[a])) for a, b in edges]))
        end += bound.count
    return result


def _keys(datasets: Sequence[Dataset]) -> Sequence[Key]:
    return datasets.parts if isinstance(datasets, StoredDatasets) else range(len(datasets))


def _recordings(problem: Problem, bound: BoundDataset) -> Iterator[tuple[int, int]]:
    """Yield the range of samples of each recording in time."""
    # with states, a recording ends where they start anew
    starts = bound.starts if problem.graph.states else bound.dataset.piece_starts
    if bound.dataset.time is not None and bound.hold is None:
        yield from pairwise([*starts.tolist(), bound.count])


def _count_scored(compiled: CompiledProblem, size: int) -> Int:
    """Return the number of samples before each one, as the data come, at which a criterion counts; Int[size + 1]."""
    samples, numbers = compiled.samples, compiled.sample_numbers()
    weighted = [criterion.weight > 0 for criterion in compiled.problem.criteria]
    counting = np.zeros(size + 1, dtype=np.int64)
    for first in range(0, samples.count, SAMPLES_PER_BLOCK):
        visits = np.arange(first, min(first + SAMPLES_PER_BLOCK, samples.count))
        # one place later, so that the running sum counts the samples before each
        counting[numbers[visits] + 1] = np.isfinite(samples.targets_of(visits)[weighted]).any(axis=0)
    return np.cumsum(counting)


_Group = list[tuple[Key, RecordingRange]]  # the parts of one recording


def _joined(rows: Sequence[tuple[Key, bool, list[RecordingRange]]]) -> list[_Group]:
    """Return the recordings of all partitions, those that are cut as one."""
    groups: list[_Group] = []
    for key, continues, recordings in rows:
        for number, recording in enumerate(recordings):
            if number == 0 and continues and groups and _is_next(groups[-1][-1][0], key):
                groups[-1].append((key, recording))
            else:
                groups.append([(key, recording)])
    return groups


def _is_next(key: Key, later: Key) -> bool:
    return isinstance(key, Part) and isinstance(later, Part) and follows(key, later)


def _divide(groups: Sequence[_Group], most: int) -> tuple[dict[Key, list[Division]], Int]:
    """Return the divisions of all recordings with a scored sample, and the sizes of their blocks."""
    scored = np.array([sum(recording.scored for _, recording in group) for group in groups], dtype=np.int64)
    filled = np.flatnonzero(scored)
    divisions: dict[Key, list[Division]] = {key: [] for group in groups for key, _ in group}
    if len(filled) > most:
        numbers, blocks = _number_groups(scored[filled], most), np.ones(filled.size, dtype=np.int64)
    else:
        # no more blocks than scored samples
        blocks = np.minimum(max(most // max(filled.size, 1), 1), scored[filled])
        numbers = np.cumsum(blocks) - blocks
    sizes = np.zeros(int((numbers + blocks).max(initial=0)), dtype=np.int64)
    for at, number, count in zip(filled.tolist(), numbers.tolist(), blocks.tolist(), strict=True):
        whole, before = int(scored[at]), 0
        # the first sample of block b is number ceil(b whole / count)
        sizes[number : number + count] += np.diff(-(-np.arange(count + 1) * whole // count))
        for key, (first, last, own) in groups[at]:
            divisions[key].append(Division(first, last, number, count, before, whole))
            before += own
    return divisions, sizes


def _number_groups(scored: Int, count: int) -> Int:
    """Number groups of neighbouring recordings with similar numbers of scored samples, Int[recordings]."""
    ends = np.cumsum(scored)
    # by the middle of each recording on the scale of all scored samples
    groups = np.minimum(((ends - scored / 2) * count / ends[-1]).astype(np.int64), count - 1)
    return np.asarray(np.unique(groups, return_inverse=True)[1], dtype=np.int64)


def number_samples(compiled: CompiledProblem, divisions: Divisions) -> Int:
    """Return the block number of each sample of the problem or of one partition, as the data come."""
    rows = [row for key in _keys(compiled.problem.datasets) for row in divisions.get(key, ())]
    size = max(int(compiled.sample_numbers().max(initial=-1)) + 1, max((row.last for row in rows), default=0))
    numbers, counted = np.full(size, NEVER, dtype=np.int64), _count_scored(compiled, size)
    for first, last, block, blocks, before, scored in rows:
        # number of each sample among the scored ones of the whole recording, from 1
        position = before + counted[first + 1 : last + 1] - counted[first]
        numbers[first:last] = block + np.minimum((position - 1).clip(0) * blocks // scored, blocks - 1)
    return numbers


def _sum_blocks(compiled: CompiledProblem, divisions: Divisions, full: Float) -> list[tuple[int, float, PackedNormal]]:
    """Return the cost and the normal equations of each block in the problem or in one partition."""
    numbers = number_samples(compiled, divisions)[compiled.sample_numbers()]
    select = _in_time if compiled.stateful else _anywhere
    result = []
    for number in np.unique(numbers[numbers != NEVER]).tolist():
        sums = compiled.sums_over(select(compiled.samples, numbers == number))
        result.append((number, sums.cost(full), pack(sums.normal(full))))
    return result


def _in_time(samples: Samples, mine: Bool) -> Samples:
    """Return the recordings that contain a block, with its targets only: states depend on the samples before."""
    visits = np.flatnonzero(mine)
    # pieces without a sample of the block need not be simulated
    edges = np.searchsorted(visits, [[p.first, p.last] for p in samples.pieces]).tolist()
    pieces = [piece for piece, (first, last) in zip(samples.pieces, edges, strict=True) if last > first]
    targets = np.full((len(samples.wanted.parts), samples.wanted.count), np.nan)
    targets[:, visits] = samples.wanted.take(visits)
    return Samples(samples.inputs.parts, list(targets), pieces)


def _anywhere(samples: Samples, mine: Bool) -> Samples:
    """Return the samples of a block, in the order in which they are visited."""
    order = np.arange(samples.count, dtype=np.uint32) if samples.order is None else samples.order
    # pieces count visits, of which only those of the block remain
    before = np.concatenate([[0], np.cumsum(mine)])
    pieces = [Piece(int(before[p.first]), int(before[p.last]), p.scores) for p in samples.pieces]
    filled = [piece for piece in pieces if piece.last > piece.first]
    return Samples(samples.inputs.parts, samples.wanted.parts, filled, order[mine])
