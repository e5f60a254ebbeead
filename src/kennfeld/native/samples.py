"""Measurement data as the kernels read it: one row per channel, one piece after the other."""

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.addresses import UINT32, readable
from kennfeld.native.column_table import BLOCK, ColumnTable, Order, Row


@dataclass(frozen=True)
class Piece:
    """A range of samples through which the states run, and the weight of each output in it."""

    first: int
    last: int
    scores: Float  # Float[outputs]

    def __post_init__(self) -> None:
        object.__setattr__(self, "scores", readable(self.scores))


@dataclass(frozen=True)
class Chunk:
    """A part of a piece that one native call processes."""

    number: int
    piece: int
    first: int
    last: int

    @property
    def length(self) -> int:
        """Number of samples."""
        return self.last - self.first


class Samples:
    """Inputs and targets of all samples, read without copying; a target of NaN is not scored.

    Args:
        data: rows of the inputs, each one or several arrays that follow each other.
        targets: rows of the targets, one per output, in the unit of the output.
        pieces: ranges of visits without interruption, with their weights.
        order: for models without memory, the samples in the order in which they are visited; others are left out.
            Pieces and chunks then count visits.

    Raises:
        ArgumentError: rows differ in length, or pieces or the order exceed the samples.
    """

    def __init__(
        self, data: Iterable[Row], targets: Iterable[Row], pieces: Sequence[Piece], order: Order | None = None
    ) -> None:
        self.wanted = ColumnTable(targets)
        self.inputs = ColumnTable(data, self.wanted.count)
        self.pieces = tuple(pieces)
        self.order = None if order is None else readable(order, UINT32)
        self._check()
        self.data, self.targets = self.inputs.headed(order), self.wanted.addresses

    def _check(self) -> None:
        order, outputs = self.order, len(self.wanted.parts)
        if order is not None and order.size and int(order.max()) >= self.wanted.count:
            raise ArgumentError(f"the order visits sample {int(order.max())}, but there are {self.wanted.count}")
        for piece in self.pieces:
            if not 0 <= piece.first <= piece.last <= self.count:
                raise ArgumentError(f"piece from {piece.first} to {piece.last} exceeds the {self.count} samples")
            if piece.scores.shape != (outputs,):
                raise ArgumentError(f"scores must have shape ({outputs},), got {piece.scores.shape}")

    @property
    def count(self) -> int:
        """Number of visited samples."""
        return self.wanted.count if self.order is None else self.order.size

    def numbers(self, visits: Int) -> Int | Order:
        """Return the numbers of the samples at some visits, shape (visits,)."""
        return visits if self.order is None else self.order[visits]

    def targets_of(self, visits: Int) -> Float:
        """Return the targets at some visits, shape (outputs, visits)."""
        return self.wanted.take(self.numbers(visits))

    def inputs_of(self, visits: Int) -> Float:
        """Return the inputs at some visits, shape (inputs, visits)."""
        return self.inputs.take(self.numbers(visits))

    def scored(self, piece: Piece) -> Int:
        """Count the scored samples of a piece, shape (outputs,)."""
        counts = np.zeros(len(self.targets), dtype=np.int64)
        for first in range(piece.first, piece.last, BLOCK):
            counts += np.isfinite(self.targets_of(np.arange(first, min(first + BLOCK, piece.last)))).sum(axis=1)
        return counts

    def thinned(self, share: float) -> "Samples":
        """Return about this share of the samples of each piece, evenly spaced, with the total weight of all samples.

        Only for pieces without memory.
        """
        if share >= 1:
            return self
        picked, pieces, at = [], [], 0
        for piece in self.pieces:
            length = piece.last - piece.first
            count = max(1, round(length * share))
            # both ends included; each sample picked stands for length / count of them
            picked.append(np.linspace(piece.first, piece.last - 1, count).astype(np.int64))
            pieces.append(Piece(at, at + count, piece.scores * (length / count)))
            at += count
        samples = self.numbers(np.concatenate(picked))
        return Samples(self.inputs.take(samples), self.wanted.take(samples), pieces)

    def in_fewer_pieces(self, share: float, least: int) -> "Samples":
        """Return about this share of the pieces, evenly spaced, with the total weight of all.

        Of the pieces that score the same outputs with the same weights, at least `least` are taken.
        """
        scored = np.array([self.scored(piece) for piece in self.pieces])
        factors = pick_evenly([piece.scores.tobytes() for piece in self.pieces], scored, share, least)
        result = copy(self)
        result.pieces = tuple(replace(self.pieces[i], scores=self.pieces[i].scores * factors[i]) for i in factors)
        return result

    def reweighted(self, factors: Float) -> "Samples":
        """Return the samples with the weight of each output multiplied by a factor; `factors` has shape (outputs,)."""
        result = copy(self)
        result.pieces = tuple(replace(piece, scores=piece.scores * factors) for piece in self.pieces)
        return result

    def with_inputs(self, rows: Sequence[int]) -> "Samples":
        """Return the samples with these rows of the inputs."""
        return Samples([self.inputs.parts[row] for row in rows], self.wanted.parts, self.pieces, self.order)

    def with_rows(self, rows: Mapping[int, Float]) -> "Samples":
        """Replace some rows of the inputs by other arrays, Float[samples]; the targets remain shared."""
        result = copy(self)
        parts = [rows.get(number, own) for number, own in enumerate(self.inputs.parts)]
        result.inputs = ColumnTable(parts, self.wanted.count)
        result.data = result.inputs.headed(self.order)
        return result

    def _last_scored(self, piece: Piece) -> int:
        """Return the index after the last sample of a piece that counts."""
        # from the end, block by block: mostly the last sample counts
        for last in range(piece.last, piece.first, -BLOCK):
            visits = np.arange(max(last - BLOCK, piece.first), last)
            scored = np.flatnonzero(np.isfinite(self.targets_of(visits)[piece.scores != 0]).any(axis=0))
            if scored.size:
                return int(visits[scored[-1]]) + 1
        return piece.first

    def chunks(self, length: int) -> list[Chunk]:
        """Cut the pieces, up to their last scored sample, into chunks of at most `length`.

        Later samples cannot affect the cost, and a model may diverge there.
        """
        cuts = []
        for number, piece in enumerate(self.pieces):
            last = self._last_scored(piece)
            cuts += [(number, at, min(at + length, last)) for at in range(piece.first, last, length)]
        return [Chunk(i, number, first, last) for i, (number, first, last) in enumerate(cuts)]


def pick_evenly(weights: Sequence[bytes], scored: Int, share: float, least: int) -> dict[int, Float]:
    """Return about this share of many pieces, evenly spaced, each with factors of its weights.

    Of the pieces that score the same outputs with the same weights, at least `least` are taken, and their factors keep
    the total weight. Pieces without a scored sample are left out.

    Args:
        weights: of each piece, equal for equal weights of the outputs.
        scored: scored samples of each piece, Int[pieces, outputs].
        share: of the pieces.
        least: pieces of a group.

    Returns:
        By the number of the piece, in increasing order, Float[outputs].
    """
    groups: dict[bytes, list[int]] = {}
    for number in np.flatnonzero(scored.any(axis=1)).tolist():
        # a piece without a target of an output cannot stand for one that has it
        groups.setdefault(weights[number] + (scored[number] > 0).tobytes(), []).append(number)
    factors: dict[int, Float] = {}
    for group in groups.values():
        count = min(max(least, round(len(group) * share)), len(group))
        picked = [group[i] for i in np.linspace(0, len(group) - 1, count).round().astype(np.int64)]
        # by scored samples, not by pieces, whose lengths differ
        own = scored[group].sum(axis=0) / np.maximum(scored[picked].sum(axis=0), 1)
        factors |= dict.fromkeys(picked, own)
    return dict(sorted(factors.items()))


def chain_samples(parts: Sequence[Samples]) -> Samples:
    """Return the samples of several parts that are visited as stored, one after the other, without copying them."""
    if len(parts) == 1:
        return parts[0]
    inputs = [[array for row in rows for array in row] for rows in zip(*(p.inputs.parts for p in parts), strict=True)]
    wanted = [[array for row in rows for array in row] for rows in zip(*(p.wanted.parts for p in parts), strict=True)]
    return Samples(inputs, wanted, _renumbered((part.count, part.pieces) for part in parts))


def _renumbered(parts: Iterable[tuple[int, Sequence[Piece]]]) -> list[Piece]:
    """Return the pieces of parts that follow each other, each given as its number of samples and its pieces."""
    pieces, end = [], 0
    for count, own in parts:
        pieces += [replace(piece, first=piece.first + end, last=piece.last + end) for piece in own]
        end += count
    return pieces


def join_samples(parts: Iterable[tuple[Float, Float, Sequence[Piece]]]) -> Samples:
    """Return the samples of several parts, one after the other.

    Args:
        parts: inputs and targets, shapes (inputs, samples) and (outputs, samples), and the pieces of each part.
    """
    inputs, targets, pieces = zip(*parts, strict=True)
    own = _renumbered((wanted.shape[1], each) for wanted, each in zip(targets, pieces, strict=True))
    return Samples(np.concatenate(inputs, axis=1), np.concatenate(targets, axis=1), own)


def shares(work: Sequence[int], count: int) -> list[range]:
    """Deal consecutive items into at most `count` shares of about equal work, deterministically."""
    total = np.cumsum([0, *work])
    # cut where the running sum of the work passes each equal part of the total
    edges = np.searchsorted(total, np.linspace(0, total[-1], count + 1)[1:-1])
    cuts = sorted({0, *(int(e) for e in edges), len(work)})
    return [range(a, b) for a, b in pairwise(cuts)] or [range(0)]
