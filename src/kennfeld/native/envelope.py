"""Which part of a symmetric matrix its Cholesky factor fills: rows from their first non-zero to the diagonal.

The order of the rows decides how much that is. Values that most others touch come last, the rest level by level from
one end of their graph to the other (E. Cuthill, J. McKee: Reducing the bandwidth of sparse symmetric matrices, 1969,
reversed as A. George found better). Rows are taken in blocks, as `cholesky` works on them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kennfeld.arrays import Bool, Int

__all__ = ["BLOCK", "BUSY", "Envelope"]

BLOCK = 8
BUSY = (np.inf, 4.0, 2.0)  # times the median number of neighbours from which a value comes last; the best is taken


@dataclass(frozen=True)
class Envelope:
    """An order of the rows, and the part of the lower triangle that is kept.

    Row i of the ordered matrix is row `order[i]` of the given one. Block row b is kept from block column `first[b]` on,
    and stored column by column: column k begins at `start[b] + BLOCK * k`.
    """

    order: Int  # Int[size]
    first: Int  # Int[blocks]

    @classmethod
    def full(cls, size: int) -> "Envelope":
        """The whole triangle in the given order."""
        return cls(np.arange(size), np.zeros(-(-size // BLOCK), dtype=np.int64))

    @classmethod
    def of(cls, pattern: Bool) -> "Envelope":
        """A small envelope of a symmetric pattern."""
        found = [cls.ordered(pattern, order) for order in _orders(pattern)]
        return min(found, key=lambda envelope: envelope.work)

    @classmethod
    def ordered(cls, pattern: Bool, order: Int) -> "Envelope":
        """The envelope of a symmetric pattern in a given order."""
        ordered = pattern[np.ix_(order, order)]
        np.fill_diagonal(ordered, True)
        columns = ordered.argmax(axis=1) // BLOCK
        return cls(order, np.minimum.reduceat(columns, np.arange(0, order.size, BLOCK)))

    @property
    def size(self) -> int:
        """How many rows the matrix has."""
        return self.order.size

    @property
    def blocks(self) -> int:
        """How many block rows it has."""
        return self.first.size

    @property
    def work(self) -> float:
        """What a factorisation costs, up to a factor."""
        return float(np.sum(np.square(np.arange(1.0, self.blocks + 1) - self.first)))

    @cached_property
    def start(self) -> Int:
        """Where each block row begins, less its first column; one more element tells the length of all."""
        lengths = BLOCK * BLOCK * (np.arange(1, self.blocks + 1) - self.first)
        ends = np.cumsum(lengths)
        return np.append(ends - lengths - BLOCK * BLOCK * self.first, lengths.sum())


def _orders(pattern: Bool) -> list[Int]:
    """Orders worth trying, with fewer or more values put last."""
    degree = np.count_nonzero(pattern, axis=1)
    orders, seen = [], set()
    for busy in BUSY:
        last = degree > busy * np.median(degree)
        count = int(last.sum())
        if count not in seen and count < degree.size:
            seen.add(count)
            rest = np.flatnonzero(~last)
            orders.append(np.concatenate([rest[_by_levels(pattern[np.ix_(rest, rest)])], np.flatnonzero(last)]))
    return orders or [np.arange(degree.size)]


def _by_levels(pattern: Bool) -> Int:
    """Reverse Cuthill-McKee: each connected part from a row at its rim, neighbours after neighbours."""
    degree = np.count_nonzero(pattern, axis=1)
    left = np.ones(degree.size, dtype=bool)
    parts = []
    for seed in np.argsort(degree, kind="stable"):
        if left[seed]:
            part = _levels(pattern, degree, _levels(pattern, degree, seed)[-1])
            left[part] = False
            parts.append(part)
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])[::-1]


def _levels(pattern: Bool, degree: Int, seed: int) -> Int:
    """The rows connected to a seed, by distance, then by their first neighbour nearer to it, then by degree."""
    unseen = np.ones(degree.size, dtype=bool)
    unseen[seed] = False
    level = np.array([seed])
    levels = []
    while level.size:
        levels.append(level)
        touched = pattern[level] & unseen
        following = np.flatnonzero(touched.any(axis=0))
        parent = touched[:, following].argmax(axis=0)
        level = following[np.lexsort((degree[following], parent))]
        unseen[level] = False
    return np.concatenate(levels)
