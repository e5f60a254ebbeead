"""The measurement as the kernels read it: one row a channel, pieces one after the other."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float

__all__ = ["Chunk", "Piece", "Samples", "shares"]


@dataclass(frozen=True)
class Piece:
    """A range of samples over which the states run on, and the weight of each output in it."""

    first: int
    last: int
    scores: Float  # Float[outputs]


@dataclass(frozen=True)
class Chunk:
    """A part of a piece that one native call works on."""

    number: int
    piece: int
    first: int
    last: int

    @property
    def length(self) -> int:
        """How many samples it has."""
        return self.last - self.first


@dataclass(frozen=True)
class Samples:
    """Inputs and targets of all samples; a target of NaN is not scored."""

    data: Float  # Float[inputs, samples]
    targets: Float  # Float[outputs, samples]
    pieces: tuple[Piece, ...]

    def __post_init__(self) -> None:
        for name in ("data", "targets"):
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=np.float64))

    @property
    def count(self) -> int:
        """How many samples there are."""
        return int(self.targets.shape[1])

    def thinned(self, most: int) -> "Samples":
        """Evenly picked samples of each piece, about `most` in all, weighing as much as all of them.

        Pieces must be without memory.
        """
        if self.count <= most:
            return self
        share = most / self.count
        picked, pieces, at = [], [], 0
        for piece in self.pieces:
            length = piece.last - piece.first
            count = max(1, round(length * share))
            picked.append(np.linspace(piece.first, piece.last - 1, count).astype(np.int64))
            pieces.append(Piece(at, at + count, piece.scores * (length / count)))
            at += count
        chosen = np.concatenate(picked)
        return Samples(self.data[:, chosen], self.targets[:, chosen], tuple(pieces))

    def _last_scored(self, piece: Piece) -> int:
        """One past the last sample of a piece that counts."""
        wanted = self.targets[piece.scores != 0, piece.first : piece.last]
        scored = np.flatnonzero(np.isfinite(wanted).any(axis=0))
        return piece.first + (int(scored[-1]) + 1 if scored.size else 0)

    def chunks(self, length: int) -> list[Chunk]:
        """The pieces up to their last scored sample, cut into chunks of at most `length`.

        What follows cannot matter, and a model may diverge there.
        """
        cuts = []
        for number, piece in enumerate(self.pieces):
            last = self._last_scored(piece)
            cuts += [(number, at, min(at + length, last)) for at in range(piece.first, last, length)]
        return [Chunk(i, number, first, last) for i, (number, first, last) in enumerate(cuts)]


def shares(work: Sequence[int], count: int) -> list[range]:
    """Neighbouring items dealt into at most `count` shares of about equal work; the same for the same input."""
    total = np.cumsum([0, *work])
    edges = np.searchsorted(total, np.linspace(0, total[-1], count + 1)[1:-1])
    cuts = sorted({0, *(int(e) for e in edges), len(work)})
    return [range(a, b) for a, b in pairwise(cuts)] or [range(0)]
