"""How many of the samples are independent: errors in time resemble their neighbours.

A misfit of the model lasts longer than a sample. Counting every sample as new evidence would let tables follow it.

Parts of recordings that are held back in turn, and what each contributes to the linearised problem.

Errors in time resemble their neighbours, so only what is held back in one stretch tells how a fit meets other data. A
fit without a block needs no data again: its matrix is that of all data less that of the block.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.native import Accumulator, Piece, Samples
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.problem import Problem
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset

__all__ = ["BLOCKS", "FEWEST", "NEVER", "HoldoutBlock", "HoldoutBlocks", "independent_samples"]

BLOCKS = 20  # in all, about
FEWEST = 3
NUMBERS = 25_000_000  # that all matrices together may hold, 200 MB
NEVER = -1  # the block of a sample that is not held back


def correlation_time(pieces: Sequence[Float]) -> float:
    """1 + 2 sum of the autocorrelation, in samples, up to the lag where that is largest; NaN is not counted.

    The variance of a mean of n correlated samples is that of n over this many independent ones.

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
    """Scored training samples of all criteria; those of data with time over their correlation time.

    `errors` gives those of a bound dataset, of shape (criteria, kept samples).
    """
    return sum(
        _independent(bound, row)
        for bound in problem.training
        for row, criterion in zip(errors(bound, parameters), problem.criteria, strict=True)
        if criterion.weight > 0
    )


def _independent(bound: BoundDataset, errors: Float) -> float:
    count = float(np.isfinite(errors).sum())
    if bound.dataset.time is None or bound.hold is not None:
        return count
    edges = [*bound.starts.tolist(), errors.size]
    return count / correlation_time([errors[a:b] for a, b in pairwise(edges)])


@dataclass(frozen=True)
class HoldoutBlock:
    """What the samples of a block add: misfit(p + d) = misfit + 2 gradient'd + d'matrix d; `share` of the samples."""

    misfit: float
    gradient: Float  # Float[values]
    matrix: Float  # Float[values, values]
    share: float


@dataclass(frozen=True, eq=False)
class HoldoutBlocks:
    """The block of each sample of a compiled problem, `NEVER` for those that are always fitted."""

    compiled: CompiledProblem
    numbers: Int  # Int[samples], as the data come
    sizes: Int  # Int[blocks], scored samples

    @classmethod
    def of(cls, compiled: CompiledProblem) -> "HoldoutBlocks | None":
        """Each recording cut into stretches of about as many scored samples, about `BLOCKS` in all.

        Many short recordings are held back whole, neighbouring ones together. Steady points are never held back. None
        where that leaves fewer than `FEWEST` blocks.
        """
        most = min(BLOCKS, NUMBERS // max(compiled.values.free**2, 1))
        problem = compiled.problem
        known = np.concatenate([_scored(problem, bound) for bound in problem.gathered])
        places = [(a, b) for a, b in _recordings(problem) if known[a:b].any()]
        numbers = np.full(known.size, NEVER, dtype=np.int64)
        if len(places) > most:
            _grouped(numbers, known, places, most)
        elif places:
            _cut(numbers, known, places, max(most // len(places), 1))
        held = numbers[known & (numbers != NEVER)]
        used, sizes = np.unique(held, return_counts=True)
        if used.size < FEWEST:
            return None
        numbers = np.where(numbers == NEVER, NEVER, np.searchsorted(used, numbers))
        return cls(compiled, numbers, sizes)

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return self.sizes.size

    def linearised(self, full: Float) -> Iterator[HoldoutBlock]:
        """What each block adds at these values, fixed ones included."""
        shares = self.sizes / self.sizes.sum()
        held = self._in_time if self.compiled.kernel.line.states else self._anywhere
        for number, share in enumerate(shares):
            accumulator = Accumulator(self.compiled.kernel, held(number))
            misfit, found = accumulator.cost(full), accumulator.normal(full)
            yield HoldoutBlock(misfit, found.gradient.copy(), found.matrix.copy(), float(share))

    def _in_time(self, number: int) -> Samples:
        """The recordings that a block has a part in, with its targets alone: states come from what went before."""
        samples = self.compiled.samples
        mine = np.flatnonzero(self.numbers == number)
        pieces = [p for p in samples.pieces if np.any((mine >= p.first) & (mine < p.last))]
        targets = np.full((len(samples.wanted.parts), samples.wanted.count), np.nan)
        targets[:, mine] = samples.wanted.take(mine)
        return Samples(samples.inputs.parts, list(targets), pieces)

    def _anywhere(self, number: int) -> Samples:
        """The samples of a block, in the order in which they are visited."""
        samples = self.compiled.samples
        order = np.arange(samples.count, dtype=np.uint32) if samples.order is None else samples.order
        mine: Bool = self.numbers[order] == number
        before = np.concatenate([[0], np.cumsum(mine)])
        pieces = [Piece(int(before[p.first]), int(before[p.last]), p.scores) for p in samples.pieces]
        filled = [piece for piece in pieces if piece.last > piece.first]
        return Samples(samples.inputs.parts, samples.wanted.parts, filled, order[mine])


def _recordings(problem: Problem) -> Iterator[tuple[int, int]]:
    """First and one past the last sample of each recording in time, over all training data."""
    end = 0
    for bound in problem.gathered:
        starts = bound.starts if problem.graph.states else bound.dataset.starts
        if bound.dataset.time is not None and bound.hold is None:
            yield from ((end + int(a), end + int(b)) for a, b in pairwise([*starts, bound.count]))
        end += bound.count


def _scored(problem: Problem, bound: BoundDataset) -> Bool:
    """The samples at which a criterion counts."""
    known = np.zeros(bound.count, dtype=bool)
    for criterion in problem.criteria:
        if criterion.weight > 0:
            known |= np.isfinite(problem.target(criterion, bound))
    return known


def _cut(numbers: Int, known: Bool, places: list[tuple[int, int]], parts: int) -> None:
    """Number the parts of each recording, of about as many scored samples each."""
    for at, (first, last) in enumerate(places):
        counted = np.cumsum(known[first:last])
        numbers[first:last] = at * parts + np.minimum((counted - 1).clip(0) * parts // counted[-1], parts - 1)


def _grouped(numbers: Int, known: Bool, places: list[tuple[int, int]], count: int) -> None:
    """Number the groups of neighbouring recordings, of about as many scored samples each."""
    counted = np.cumsum([np.count_nonzero(known[first:last]) for first, last in places])
    middles = counted - np.diff(counted, prepend=0) / 2
    for (first, last), middle in zip(places, middles, strict=True):
        numbers[first:last] = min(int(middle * count / counted[-1]), count - 1)
