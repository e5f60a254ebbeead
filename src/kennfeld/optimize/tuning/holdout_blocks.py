"""Held-out blocks of recordings for cross-validation, and the number of independent samples.

Errors of a model in time are correlated. Counting every sample as independent would let tables follow them, and only
data held out in contiguous blocks show how a fit generalises. A fit without a block does not need the data again: its
matrix is that of all data minus that of the block.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.native.samples import Piece, Samples
from kennfeld.native.symmetric import as_array
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.problem import Problem
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset

BLOCKS = 20  # approximate number of blocks
FEWEST = 3  # blocks
MAX_ENTRIES = 25_000_000  # of all matrices together, 200 MB
NEVER = -1  # block number of samples that are never held out


def correlation_time(pieces: Sequence[Float]) -> float:
    """Return 1 + 2 sum of the autocorrelation in samples, up to the lag where it is largest; NaN is ignored.

    The variance of a mean of n correlated samples is that of n / (this number) independent ones.

    >>> correlation_time([np.array([1.0, -1.0] * 50)])
    1.0
    >>> bool(correlation_time([np.repeat(np.random.default_rng(0).normal(size=2000), 10)]) > 8)
    True
    """
    longest = max((piece.size for piece in pieces), default=0)
    sums = np.zeros(max(longest, 1))
    for piece in pieces:
        known = np.nan_to_num(piece)
        spectrum = np.fft.rfft(known, 2 * max(piece.size, 1))
        sums[: piece.size] += np.fft.irfft(np.abs(spectrum) ** 2, 2 * max(piece.size, 1))[: piece.size]
    if not sums[0] > 0:
        return 1.0
    shares = sums[1 : longest // 2] / sums[0]
    return float(1 + 2 * np.max(np.cumsum(shares), initial=0.0))


def independent_samples(
    problem: Problem, errors: Callable[[BoundDataset, ParameterSet], Float], parameters: ParameterSet
) -> float:
    """Return the effective number of scored training samples of all criteria.

    Samples of data with time are divided by their correlation time. `errors` returns the errors of a bound dataset,
    shape (criteria, samples).
    """
    total = 0.0
    for bound in problem.training:
        in_time = bound.dataset.time is not None and bound.hold is None
        pieces = list(pairwise([*bound.starts.tolist(), bound.count]))
        for row, criterion in zip(errors(bound, parameters), problem.criteria, strict=True):
            if criterion.weight > 0:
                count = float(np.isfinite(row).sum())
                total += count / correlation_time([row[a:b] for a, b in pieces]) if in_time else count
    return total


@dataclass(frozen=True)
class HoldoutBlock:
    """Contribution of a block with a `share` of the samples: misfit(p + d) = misfit + 2 gradient'd + d'matrix d."""

    misfit: float
    gradient: Float  # Float[values]
    matrix: Float  # Float[values, values]
    share: float


@dataclass(frozen=True, eq=False)
class HoldoutBlocks:
    """The block number of each sample of a compiled problem, `NEVER` for samples that are always fitted."""

    compiled: CompiledProblem
    numbers: Int  # Int[samples], as the data come
    sizes: Int  # Int[blocks], scored samples

    @classmethod
    def of(cls, compiled: CompiledProblem) -> "HoldoutBlocks | None":
        """Divide the recordings into about `BLOCKS` blocks with similar numbers of scored samples.

        Many short recordings are held out whole, neighbouring ones together. Steady-state points are never held out.
        Returns None if there are fewer than `FEWEST` blocks.
        """
        most = min(BLOCKS, MAX_ENTRIES // max(compiled.values.free**2, 1))
        problem = compiled.problem
        known = np.concatenate([_mark_scored(problem, bound) for bound in problem.gathered])
        places = [(a, b) for a, b in _recordings(problem) if known[a:b].any()]
        numbers = np.full(known.size, NEVER, dtype=np.int64)
        if len(places) > most:
            _number_groups(numbers, known, places, most)
        elif places:
            _number_parts(numbers, known, places, max(most // len(places), 1))
        used, sizes = np.unique(numbers[known & (numbers != NEVER)], return_counts=True)
        if used.size < FEWEST:
            return None
        numbers = np.where(numbers == NEVER, NEVER, np.searchsorted(used, numbers))
        return cls(compiled, numbers, sizes)

    def linearise(self, full: Float) -> Iterator[HoldoutBlock]:
        """Return the contribution of each block at the values `full`, fixed ones included."""
        shares = self.sizes / self.sizes.sum()
        samples_of = self._in_time if self.compiled.kernel.line.states else self._anywhere
        for number, share in enumerate(shares):
            sums = self.compiled.sums_over(samples_of(number))
            misfit, equations = sums.cost(full), sums.normal(full)
            yield HoldoutBlock(misfit, equations.gradient.copy(), as_array(equations.matrix), float(share))

    def _in_time(self, number: int) -> Samples:
        """Return the recordings that contain a block, with its targets only: states depend on the samples before."""
        samples = self.compiled.samples
        mine = np.flatnonzero(self.numbers == number)
        pieces = [p for p in samples.pieces if np.any((mine >= p.first) & (mine < p.last))]
        targets = np.full((len(samples.wanted.parts), samples.wanted.count), np.nan)
        targets[:, mine] = samples.wanted.take(mine)
        return Samples(samples.inputs.parts, list(targets), pieces)

    def _anywhere(self, number: int) -> Samples:
        """Return the samples of a block, in the order in which they are visited."""
        samples = self.compiled.samples
        order = np.arange(samples.count, dtype=np.uint32) if samples.order is None else samples.order
        mine: Bool = self.numbers[order] == number
        before = np.concatenate([[0], np.cumsum(mine)])
        pieces = [Piece(int(before[p.first]), int(before[p.last]), p.scores) for p in samples.pieces]
        filled = [piece for piece in pieces if piece.last > piece.first]
        return Samples(samples.inputs.parts, samples.wanted.parts, filled, order[mine])


def _recordings(problem: Problem) -> Iterator[tuple[int, int]]:
    """Return the sample range of each recording in time, over all training data."""
    end = 0
    for bound in problem.gathered:
        starts = bound.starts if problem.graph.states else bound.dataset.starts
        if bound.dataset.time is not None and bound.hold is None:
            yield from ((end + int(a), end + int(b)) for a, b in pairwise([*starts, bound.count]))
        end += bound.count


def _mark_scored(problem: Problem, bound: BoundDataset) -> Bool:
    """Return the samples at which a criterion counts."""
    targets = [problem.target(criterion, bound) for criterion in problem.criteria if criterion.weight > 0]
    return np.asarray(np.isfinite(targets).any(axis=0)) if targets else np.zeros(bound.count, dtype=bool)


def _number_parts(numbers: Int, known: Bool, places: list[tuple[int, int]], parts: int) -> None:
    """Number the parts of each recording, with similar numbers of scored samples, in place."""
    for at, (first, last) in enumerate(places):
        counted = np.cumsum(known[first:last])
        numbers[first:last] = at * parts + np.minimum((counted - 1).clip(0) * parts // counted[-1], parts - 1)


def _number_groups(numbers: Int, known: Bool, places: list[tuple[int, int]], count: int) -> None:
    """Number groups of neighbouring recordings, with similar numbers of scored samples, in place."""
    counted = np.cumsum([np.count_nonzero(known[first:last]) for first, last in places])
    middles = counted - np.diff(counted, prepend=0) / 2
    for (first, last), middle in zip(places, middles, strict=True):
        numbers[first:last] = min(int(middle * count / counted[-1]), count - 1)
