"""The excess of limited outputs over their bounds, and the multipliers of the limits, at every training sample.

All functions here take the compiled form of a `LimitedProblem` over some samples, those of a partition or all, and
values, the free followed by the fixed ones, Float[values]; they run where the samples are.

Multipliers follow from the values at the end of each earlier descent, sample by sample: m = (excess + m)+. So no
process has to own them. They are kept where they are not 0, and computed again from these values if they are lost.
"""

from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.code_digest import code_digest
from kennfeld.base.content_digest import digest_of
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import SAMPLES_PER_BLOCK
from kennfeld.native.samples import Samples
from kennfeld.optimize.strategies.limited_problem import LimitedProblem
from kennfeld.optimize.sums.compiled import CompiledProblem

FEASIBLE = 1e-6  # of a limit's scale: a violation below it counts as satisfied
NEAR_ACTIVE = 1e-4  # of a limit's scale: distance at which a limit counts as active
MAX_SAMPLES = 400  # at which limits are linearised
MAX_RELATIVE = 1e6  # excess relative to the scale, in sums of squares


class Violation(NamedTuple):
    """The largest excess relative to the scale of its side, and the sum of squares of those above 0."""

    largest: float = -np.inf
    squares: float = 0.0


@dataclass(frozen=True)
class LimitRound:
    """The end of a descent: all values, and the factor by which the penalty grew after it."""

    values: Float
    growth: float


class Update(NamedTuple):
    """The largest excess relative to the scale of its side, and the complementarity gap for a penalty of 1.

    The gap is the sum of multiplier times distance from the side. It bounds the possible decrease of the cost, and is 0
    if only active limits have multipliers.
    """

    largest: float
    gap: float


class Worst(NamedTuple):
    """The number of samples that exceed a side, the largest excess, and where it is."""

    samples: int = 0
    excess: float = -np.inf
    data: int = 0
    sample: int = 0


@dataclass(frozen=True)
class NearActiveSamples:
    """Samples at which a side of a limit is active or nearly so, with the derivatives of the limited node there.

    `side`, `data` and `sample` are indices of the side, the training dataset and its sample. `excess` and `rows` are
    relative to the scale of the side.
    """

    side: Int  # Int[samples]
    data: Int  # Int[samples]
    sample: Int  # Int[samples]
    excess: Float  # Float[samples]
    rows: Float  # Float[samples, values]

    def __getitem__(self, chosen: Int) -> "NearActiveSamples":
        return NearActiveSamples(*(values[chosen] for values in vars(self).values()))

    def joined(self, later: "NearActiveSamples") -> "NearActiveSamples":
        """Return the nearest of two sets of samples, at most `MAX_SAMPLES`, in the order of samples."""
        pairs = zip(vars(self).values(), vars(later).values(), strict=True)
        both = NearActiveSamples(*(np.concatenate(pair) for pair in pairs))
        kept = both[_nearest(both.excess, both.data, both.sample, both.side)]
        return kept[np.lexsort((kept.sample, kept.side, kept.data))]


def _nearest(excess: Float, data: Int, sample: Int, side: Int) -> Int:
    """Return the samples with the largest excess, at most `MAX_SAMPLES`; of equal ones, the first."""
    return np.lexsort((side, sample, data, -excess))[:MAX_SAMPLES]


def _limited(compiled: CompiledProblem) -> LimitedProblem:
    assert isinstance(compiled.problem, LimitedProblem)
    return compiled.problem


def _excess(compiled: CompiledProblem, values: Float) -> Iterator[tuple[int, Float]]:
    """Yield the first visit of a block, and node minus bound of each side there, Float[sides, visits].

    It is < 0 if the limit is satisfied, NaN if it does not apply, infinite if the node is not finite.
    """
    problem = _limited(compiled)
    names = problem.differences[problem.first_side :]
    simulator = problem.once("limited nodes", lambda _: compiled.simulator(names))
    rows = [compiled.kernel.layout.inputs[name] for name in simulator.inputs]
    samples = compiled.samples.with_inputs(rows)
    parameters = compiled.values.unpack(values, problem.parameters)
    for first, last, starts in _blocks(samples, stateful=compiled.stateful):
        visits = np.arange(first, last)
        columns = dict(zip(simulator.inputs, samples.inputs_of(visits), strict=True))
        nodes = simulator.over(columns, visits.size, parameters, starts)
        bounds = samples.targets_of(visits)[problem.first_side :]
        with np.errstate(invalid="ignore", over="ignore"):
            distance = nodes - bounds
        # in this order: a node that is not finite violates, unless the limit does not apply
        distance[~np.isfinite(distance)] = np.inf
        distance[np.isnan(bounds)] = np.nan
        yield first, distance


def _blocks(samples: Samples, *, stateful: bool) -> Iterator[tuple[int, int, list[int]]]:
    """Yield ranges of visits, and where states start anew in each; pieces stay whole if the model has states."""
    if not stateful:
        for first in range(0, samples.count, SAMPLES_PER_BLOCK):
            yield first, min(first + SAMPLES_PER_BLOCK, samples.count), [0]
        return
    starts: list[int] = []
    for piece in samples.pieces:
        # whole pieces until a block is large enough
        starts.append(piece.first)
        if piece.last - starts[0] >= SAMPLES_PER_BLOCK or piece.last == samples.count:
            yield starts[0], piece.last, [start - starts[0] for start in starts]
            starts = []


def measure_violation(compiled: CompiledProblem, values: Float) -> Violation:
    """Return how far the limits are exceeded."""
    scales, violation = np.array(_limited(compiled).scales)[:, None], Violation()
    for _, excess in _excess(compiled, values):
        relative = excess / scales
        # limited, so that a diverging node does not overflow the sum
        squares = float(np.nansum(np.square(np.clip(relative, 0.0, MAX_RELATIVE))))
        violation = Violation(max(violation.largest, _largest(relative)), violation.squares + squares)
    return violation


def _largest(relative: Float) -> float:
    return float(np.fmax.reduce(relative, axis=None, initial=-np.inf))


def find_worst(compiled: CompiledProblem, values: Float) -> list[Worst]:
    """Return for each side the sample at which it is exceeded most; of equal ones, the first."""
    problem = _limited(compiled)
    sides = [_MostExceeded(FEASIBLE * scale) for scale in problem.scales]
    for first, excess in _excess(compiled, values):
        for side, far in zip(sides, excess, strict=True):
            side.add(first, far)
    return [side.worst(compiled) for side in sides]


@dataclass
class _MostExceeded:
    """The visits at which one side is exceeded most."""

    tolerance: float
    count: int = 0
    excess: float = -np.inf
    visits: Int = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def add(self, first: int, excess: Float) -> None:
        """Take in the excess from a visit on, Float[visits]."""
        self.count += int(np.count_nonzero(excess > self.tolerance))
        highest = _largest(excess)
        if highest > self.excess:
            self.excess, self.visits = highest, self.visits[:0]
        if highest == self.excess > -np.inf:
            self.visits = np.concatenate([self.visits, first + np.flatnonzero(excess == highest)])

    def worst(self, compiled: CompiledProblem) -> Worst:
        """Return the first of these samples, by its number."""
        if not self.count:
            return Worst()
        data, sample = compiled.locate(self.visits)
        at = np.lexsort((sample, data))[0]
        return Worst(self.count, self.excess, int(data[at]), int(sample[at]))


def find_near_active(compiled: CompiledProblem, values: Float) -> NearActiveSamples:
    """Return the samples at which limits are active, at most the nearest `MAX_SAMPLES`."""
    scales = np.array(_limited(compiled).scales)[:, None]
    none = np.zeros(0, dtype=np.int64)
    blocks: list[tuple[Int, Int, Float]] = [(none, none, np.zeros(0))]
    for first, excess in _excess(compiled, values):
        relative = excess / scales
        near = np.nonzero((relative >= -NEAR_ACTIVE) & np.isfinite(relative))
        blocks.append((near[0], first + near[1], relative[near]))
    side, visits, relative = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    if not visits.size:
        return NearActiveSamples(none, none, none, np.zeros(0), np.zeros((0, compiled.values.free)))
    data, sample = compiled.locate(visits)
    chosen = _nearest(relative, data, sample, side)
    chosen = chosen[np.lexsort((sample[chosen], side[chosen], data[chosen]))]
    rows = _slopes(compiled, values, side[chosen], visits[chosen])
    return NearActiveSamples(side[chosen], data[chosen], sample[chosen], relative[chosen], rows)


def _slopes(compiled: CompiledProblem, values: Float, side: Int, visits: Int) -> Float:
    """Return the derivatives of limited nodes at some visits, relative to the scales; Float[visits, values]."""
    problem, samples = _limited(compiled), compiled.samples
    first, scales = problem.first_side, np.array(problem.scales)
    rows = [np.full(samples.wanted.count, np.nan)] * first
    for i, (limit, scale) in enumerate(zip(problem.sides, scales, strict=True)):
        row = np.full(samples.wanted.count, np.nan)
        row[samples.numbers(visits[side == i])] = limit.bound - scale  # so far above, the loss is the square
        rows.append(row)
    # rows have the root of the weight, 1 / scale
    scores = np.concatenate([np.zeros(first), scales**-2])
    pieces = [replace(piece, scores=scores) for piece in samples.pieces]
    alone = compiled.sums_over(Samples(samples.inputs.parts, rows, pieces, samples.order))
    ordered = np.unique(visits)
    return alone.rows_at(values, ordered)[np.searchsorted(ordered, visits), first + side]


class _Sparse(NamedTuple):
    """Multipliers of one side that are not 0."""

    visits: Int
    values: Float


def lowered_samples(compiled: CompiledProblem, rounds: Sequence[LimitRound], factors: Float) -> Samples:
    """Return the samples with the bounds lowered by the multipliers, and the weight of each criterion times a factor.

    Args:
        compiled: the limited problem over some samples.
        rounds: the descents that ended.
        factors: Float[criteria].
    """
    samples, first = compiled.samples, _limited(compiled).first_side
    rows = list(samples.wanted.parts)
    for number, multipliers in enumerate(_multipliers(compiled, rounds), first):
        if multipliers.visits.size:
            row = np.concatenate(rows[number])
            row[samples.numbers(multipliers.visits)] -= multipliers.values
            rows[number] = [row]
    return Samples(samples.inputs.parts, rows, samples.pieces, samples.order).reweighted(factors)


def update_multipliers(compiled: CompiledProblem, rounds: Sequence[LimitRound], values: Float) -> Update:
    """Compute the multipliers after a further descent, which ended at `values`, and keep them."""
    update, multipliers = _updated(compiled, rounds, values)
    compiled.keep(_key(rounds, values), [column for each in multipliers for column in each])
    return update


def _multipliers(compiled: CompiledProblem, rounds: Sequence[LimitRound]) -> list[_Sparse]:
    """Return the multipliers of each side over twice the penalty: by so much its bound is lowered."""
    if not rounds:
        return [_Sparse(np.zeros(0, dtype=np.int64), np.zeros(0)) for _ in _limited(compiled).sides]
    *earlier, last = rounds
    key = _key(earlier, last.values)
    columns = compiled.recall(key)
    if columns is None:
        columns = [column for each in _updated(compiled, earlier, last.values)[1] for column in each]
        compiled.keep(key, columns)
    # a larger penalty reaches the same force 2 w m with a smaller m
    return [_Sparse(*pair) for pair in zip(columns[::2], (m / last.growth for m in columns[1::2]), strict=True)]


def _updated(compiled: CompiledProblem, rounds: Sequence[LimitRound], values: Float) -> tuple[Update, list[_Sparse]]:
    scales = np.array(_limited(compiled).scales)[:, None]
    earlier, largest, gap = _multipliers(compiled, rounds), -np.inf, 0.0
    blocks: list[list[_Sparse]] = [[_Sparse(np.zeros(0, dtype=np.int64), np.zeros(0))] for _ in earlier]
    for first, excess in _excess(compiled, values):
        largest = max(largest, _largest(excess / scales))
        applies = ~np.isnan(excess)
        known = np.where(applies, excess, 0.0)
        # m = (c + m)+; NaN where the limit does not apply counts as 0
        new = np.where(applies, np.maximum(known + _dense(earlier, first, excess.shape[1]), 0.0), 0.0)
        # for a penalty of 1, the multiplier is 2 (c + m)+ / scale^2
        gap += float(np.sum(2 * new * np.abs(known) / scales**2))
        for block, row in zip(blocks, new, strict=True):
            at = np.flatnonzero(row)
            block.append(_Sparse(first + at, row[at]))
    return Update(largest, gap), [_Sparse(*map(np.concatenate, zip(*block, strict=True))) for block in blocks]


def _dense(multipliers: Sequence[_Sparse], first: int, count: int) -> Float:
    """Return the multipliers from a visit on, Float[sides, visits]."""
    dense = np.zeros((len(multipliers), count))
    for row, sparse in zip(dense, multipliers, strict=True):
        here = slice(*np.searchsorted(sparse.visits, [first, first + count]))
        row[sparse.visits[here] - first] = sparse.values[here]
    return dense


def _key(rounds: Sequence[LimitRound], values: Float) -> str:
    return digest_of("multipliers", tuple(rounds), values, code_digest())
