"""Sums over the samples of what scores need: products of the columns of candidates with J, with r and with themselves.

They are added up by blocks of the recordings; memory does not grow with the samples.
"""

from collections.abc import Iterable, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from kennfeld.analysis.missing.candidate_columns import CandidateColumns, block_numbers, block_runs
from kennfeld.analysis.missing.candidate_series import SeriesReader, SeriesSource
from kennfeld.analysis.missing.candidate_shares import FamilySums, share_of
from kennfeld.analysis.missing.families import Family
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import blas_threads
from kennfeld.native.carried_products import add_pulls, has_carried_sweeps
from kennfeld.native.losses import LOSS_RULES
from kennfeld.native.samples import Chunk
from kennfeld.native.workspace import Workspace
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.tuning.holdout_blocks import Divisions

__all__ = ["BlockSums", "FamilySums", "block_sums", "family_sums", "merged", "merged_blocks"]


@dataclass
class BlockSums:
    """The sums of the function itself by block, the last one of samples in none.

    Attributes:
        jr: J'Wr, Float[blocks + 1, values].
        cost: r'Wr, Float[blocks + 1].
        counts: scored residuals, Float[blocks + 1].
        weights: sum of W / scale^2; robust losses take some away from outliers.
        slopes: sum of the slopes of the influence, over scale^2: what an effect that is added to all residuals has;
            those of the square are the weights.
        influence: sums of w psi^2, w psi / r and w over all samples, with the weights w of the samples.
    """

    jr: Float
    cost: Float
    counts: Float
    weights: float = 0.0
    slopes: float = 0.0
    influence: Float = field(default_factory=lambda: np.zeros(3))

    @property
    def spread(self) -> float:
        """The sum of the squares of independent residuals as they act on a gain: r'Wr for squares.

        Of a robust loss, outliers add what their influence psi is, not what they cost.
        """
        squares, ratios, weights = self.influence
        return float(squares * weights / ratios) if ratios > 0 else 0.0

    @property
    def mean_effect(self) -> float:
        """The root mean square of an effect at the outputs that lowers the cost by 1."""
        return float(np.sqrt(self.weights)) / self.slopes if self.slopes > 0 else float("inf")

    def merge(self, later: "BlockSums") -> None:
        """Add the sums over other samples."""
        self.jr += later.jr
        self.cost += later.cost
        self.counts += later.counts
        self.weights += later.weights
        self.slopes += later.slopes
        self.influence = self.influence + later.influence


def family_sums(
    compiled: CompiledProblem, families: Sequence[Family], full: Float, divisions: Divisions, blocks: int
) -> list[FamilySums]:
    """Return the sums of families, from one pass over the samples.

    Args:
        compiled: the problem with probes.
        families: the candidates.
        full: the free and the fixed values, Float[values].
        divisions: of the recordings into blocks.
        blocks: number of blocks.
    """
    columns = CandidateColumns.of_all(compiled, families, divisions, blocks)
    series = [each for family in families for each in family.series]
    source = SeriesSource(compiled, series, full) if series else None
    shares: dict[int, _PassShare] = {}

    def visit(share: int, space: Workspace, chunk: Chunk, begins: bool) -> None:
        if share not in shares:
            shares[share] = _PassShare(columns, None if source is None else source.reader())
        shares[share].add(space, chunk, begins)

    totals = [_empty(compiled, family, blocks) for family in families]
    with blas_threads(0):
        compiled.sums.each_tape(full, visit)
        # added in the order of the shares, whichever thread came first
        for share in sorted(shares):
            for total, own in zip(totals, shares[share].parts, strict=True):
                total.merge(own.sums())
    return totals


class _PassShare:
    """The sums of families over one share of the samples."""

    def __init__(self, columns: Sequence[CandidateColumns], series: SeriesReader | None) -> None:
        self.parts = [share_of(own) for own in columns]
        self._counts = [len(own.family.series) for own in columns]
        self._series = series

    def add(self, space: Workspace, chunk: Chunk, begins: bool) -> None:
        scales = None if self._series is None else self._series.read(chunk, begins)
        carried, first = space.carried(), 0
        for part, count in zip(self.parts, self._counts, strict=True):
            # each part carries S over the samples
            space.carry(*carried)
            own = None if scales is None or not count else np.ascontiguousarray(scales[:, first : first + count])
            part.add(space, chunk, begins, own)
            first += count


def _empty(compiled: CompiledProblem, family: Family, blocks: int) -> FamilySums:
    columns = sum(family.hats) * len(family.factors)
    squares = [[np.zeros((blocks + 1, hats, hats)) for hats in family.hats] for _ in family.factors]
    return FamilySums(np.zeros((compiled.values.free, columns)), squares, np.zeros((blocks + 1, columns)))


def block_sums(compiled: CompiledProblem, full: Float, divisions: Divisions, blocks: int) -> BlockSums:
    """Return the sums of the function itself; see `family_sums`."""
    numbers = block_numbers(compiled, divisions, blocks)
    free, scales = compiled.values.free, np.array([output.scale for output in compiled.kernel.outputs])
    parts: dict[int, BlockSums] = {}

    def visit(share: int, space: Workspace, chunk: Chunk, begins: bool) -> None:
        part = parts.setdefault(
            share, BlockSums(np.zeros((blocks + 1, free)), np.zeros(blocks + 1), np.zeros(blocks + 1))
        )
        own = numbers[chunk.first : chunk.last]
        weight = space.weight[: chunk.length]
        residual = np.where(weight != 0, space.residual[: chunk.length], 0.0)
        part.cost += np.bincount(own, (weight * residual**2).sum(axis=1), minlength=blocks + 1)
        ratios, slopes = _influences(compiled, residual)
        plain = np.where(ratios > 0, weight / np.where(ratios > 0, ratios, 1.0), 0.0)
        part.weights += float((weight / scales**2).sum())
        part.slopes += float((plain * slopes / scales**2).sum())
        part.influence += np.array([(weight * ratios * residual**2).sum(), weight.sum(), plain.sum()])
        part.counts += np.bincount(own, (weight != 0).sum(axis=1), minlength=blocks + 1)
        if space.kernel.pattern.carried:
            if begins:
                space.begin_sensitivities(chunk.first, add_start=False)
            _add_carried(space, chunk, own, part.jr)
            return
        pull = np.einsum("ko,keo->ke", weight * residual, space.slope[: chunk.length, :, : weight.shape[1]])
        used = np.arange(space.index.shape[1]) < space.count[: chunk.length, None]
        flat = own[:, None] * free + space.index[: chunk.length]
        part.jr += np.bincount(flat[used], pull[used], minlength=(blocks + 1) * free).reshape(blocks + 1, free)

    compiled.sums.each_tape(full, visit)
    total = BlockSums(np.zeros((blocks + 1, free)), np.zeros(blocks + 1), np.zeros(blocks + 1))
    for share in sorted(parts):
        total.merge(parts[share])
    return total


def _influences(compiled: CompiledProblem, residual: Float) -> tuple[Float, Float]:
    """Return psi / r and psi' of scaled residuals, Float[samples, outputs] each; both are 1 for the square."""
    ratios, slopes = np.ones(residual.shape), np.ones(residual.shape)
    for at, output in enumerate(compiled.kernel.outputs):
        if output.loss != "square":
            ratios[:, at], slopes[:, at] = LOSS_RULES[output.loss].influence(residual[:, at], output.delta)
    return ratios, slopes


def _add_carried(space: Workspace, chunk: Chunk, blocks: NDArray[np.int32], jr: Float) -> None:
    """Add J'Wr of a chunk with memory by block, Float[blocks + 1, values]."""
    if has_carried_sweeps(space.kernel):
        for first, last in block_runs(blocks):
            add_pulls(space, first, last, jr[blocks[first]])
        return
    rooted, rows = space.rows(chunk)
    pulled = np.nan_to_num(rooted)[:, None] * rows
    places = np.repeat(blocks, space.weight.shape[1])
    for block in np.unique(places):
        jr[block] += pulled[places == block].sum(axis=0)


def merged(parts: Iterable[list[FamilySums]]) -> list[FamilySums]:
    """Return the sums of families over all partitions, added in their order."""
    totals, *others = parts
    for other in others:
        for total, own in zip(totals, other, strict=True):
            total.merge(own)
    return totals


def merged_blocks(parts: Sequence[BlockSums]) -> BlockSums:
    """Return the sums of all partitions, added in their order."""
    first, *others = parts
    for other in others:
        first.merge(other)
    return first
