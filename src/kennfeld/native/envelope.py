"""Envelope of the Cholesky factor of a symmetric matrix: each row from its first non-zero to the diagonal.

The order of the rows determines its size. Rows with the most neighbours come last, the others in reverse Cuthill-McKee
order (E. Cuthill, J. McKee: Reducing the bandwidth of sparse symmetric matrices, 1969; reversed as proposed by A.
George, 1971). Rows are grouped in blocks, as in `cholesky`.
"""

from collections.abc import Iterable, Iterator
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Bool, Int, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.addresses import INT64, address

BLOCK = 8
BUSY = (np.inf, 4.0, 2.0)  # times the median number of neighbours from which a value comes last; the best is taken


@dataclass(frozen=True)
class Envelope:
    """An order of the rows, and the part of the lower triangle that is stored.

    Row i of the ordered matrix is row `order[i]` of the original one. Block row b is stored from block column
    `first[b]` on, column by column: column k begins at `start[b] + BLOCK * k`.
    """

    order: Int  # Int[size]
    first: Int  # Int[blocks]

    @classmethod
    def full(cls, size: int) -> "Envelope":
        """Return the envelope of the whole triangle in the original order."""
        return cls(np.arange(size), np.zeros(-(-size // BLOCK), dtype=np.int64))

    @classmethod
    def of(cls, pattern: Bool) -> "Envelope":
        """Find a small envelope of a symmetric pattern, Bool[size, size]."""
        orders = [
            np.concatenate([rest[_by_levels(pattern[rest][:, rest] if last.size else pattern)], last])
            for rest, last in split_busy(np.count_nonzero(pattern, axis=1))
        ]
        return cls._smallest(orders or [np.arange(len(pattern))], *np.nonzero(pattern))

    @classmethod
    def of_pairs(cls, size: int, rows: Int, columns: Int) -> "Envelope":
        """Find a small envelope of a symmetric matrix with non-zeros at rows and columns, Int[pairs], on one side."""
        from scipy.sparse import csr_array

        both = (np.concatenate([rows, columns]), np.concatenate([columns, rows]))
        pattern = csr_array((np.ones(both[0].size, dtype=np.int8), both), shape=(size, size))
        return cls._smallest(sparse_orders(pattern), rows, columns)

    @classmethod
    def ordered(cls, pattern: Bool, order: Int) -> "Envelope":
        """Compute the envelope of a symmetric pattern, Bool[size, size], in a given order, Int[size]."""
        return cls._smallest([order], *np.nonzero(pattern))

    @classmethod
    def _smallest(cls, orders: Iterable[Int], rows: Int, columns: Int) -> "Envelope":
        """Return the smallest envelope of the non-zeros at pairs of rows and columns among several orders."""
        envelopes = (cls(order, first_blocks(places_of(order), rows, columns, BLOCK)) for order in orders)
        return min(envelopes, key=lambda envelope: envelope.work)

    def grouped(self, count: int) -> "Envelope":
        """Return the envelope in which so many block rows begin together, at a multiple of their number."""
        least = np.minimum.reduceat(self.first, np.arange(0, self.blocks, count)) // count * count
        return Envelope(self.order, np.repeat(least, count)[: self.blocks])

    @property
    def size(self) -> int:
        """Number of rows of the matrix."""
        return self.order.size

    @property
    def blocks(self) -> int:
        """Number of block rows."""
        return self.first.size

    @property
    def work(self) -> float:
        """Cost of a factorisation, up to a factor."""
        # each of the w blocks of a block row is reduced by those left of it: w^2 / 2 products of blocks
        return float(np.sum(np.square(np.arange(1.0, self.blocks + 1) - self.first)))

    @cached_property
    def addresses(self) -> tuple[int, int]:
        """The addresses of `start` and `first` for compiled code."""
        return address(self.start, self.blocks + 1, INT64), address(self.first, self.blocks, INT64)

    @cached_property
    def place(self) -> Int:
        """The row of each original row in the order, Int[size]."""
        return places_of(self.order)

    @cached_property
    def start(self) -> Int:
        """Offset of each block row minus its first column, Int[blocks + 1]; the last element is the total length."""
        lengths = BLOCK * BLOCK * (np.arange(1, self.blocks + 1) - self.first)
        ends = np.cumsum(lengths)
        # so that column k is at start + BLOCK k although the columns before the first one are not stored
        return np.append(ends - lengths - BLOCK * BLOCK * self.first, lengths.sum())


def places_of(order: Int) -> Int:
    """Invert an order: return the position of each row in it, Int[size]."""
    place = np.empty(order.size, dtype=np.int64)
    place[order] = np.arange(order.size)
    return place


def first_blocks(place: Int, rows: Int, columns: Int, block: int) -> Int:
    """Find the first block column with a non-zero in each block row of the lower triangle, its own at the latest.

    Args:
        place: the position of each row in the order, Int[size].
        rows: those of the non-zeros, on either side of the diagonal, Int[pairs].
        columns: those of the non-zeros, Int[pairs].
        block: rows of a block.
    """
    first = np.arange(-(-place.size // block))
    down, across = place[rows] // block, place[columns] // block
    # either side of the diagonal counts for the lower one
    np.minimum.at(first, np.maximum(down, across), np.minimum(down, across))
    return first


def sparse_orders(pattern: Sparse) -> Iterator[Int]:
    """Yield orders, Int[size], of many rows with a small envelope, given a symmetric matrix with the same non-zeros."""
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    for rest, last in split_busy(np.diff(pattern.indptr)):
        kept = pattern[rest][:, rest] if last.size else pattern
        inner = reverse_cuthill_mckee(kept, symmetric_mode=True)
        yield np.concatenate([rest[inner], last])


def split_busy(degree: Int) -> Iterator[tuple[Int, Int]]:
    """Divide values by their number of neighbours, Int[size]: most of them, and fewer or more that come last."""
    seen = set()
    for busy in BUSY:
        last = degree > busy * np.median(degree)
        count = int(last.sum())
        # two limits that single out as many values give the same order
        if count not in seen and count < degree.size:
            seen.add(count)
            yield np.flatnonzero(~last), np.flatnonzero(last)


def _by_levels(pattern: Bool) -> Int:
    """Return the reverse Cuthill-McKee order: each connected component from a peripheral row, level by level."""
    degree = np.count_nonzero(pattern, axis=1)
    unordered = np.ones(degree.size, dtype=bool)
    parts = []
    for seed in np.argsort(degree, kind="stable"):
        if unordered[seed]:
            # the farthest row from a seed is peripheral: levels from there are many and narrow
            part = _levels(pattern, degree, _levels(pattern, degree, seed)[-1])
            unordered[part] = False
            parts.append(part)
    return np.concatenate([np.zeros(0, dtype=np.int64), *parts])[::-1]


def _levels(pattern: Bool, degree: Int, seed: int) -> Int:
    """Return the rows connected to a seed, by distance, then by their first neighbour closer to it, then by degree."""
    unseen = np.ones(degree.size, dtype=bool)
    unseen[seed] = False
    level = np.array([seed])
    levels = []
    while level.size:
        levels.append(level)
        touched = pattern[level] & unseen
        following = np.flatnonzero(touched.any(axis=0))
        parent = touched[:, following].argmax(axis=0)
        # the last key of `lexsort` sorts first
        level = following[np.lexsort((degree[following], parent))]
        unseen[level] = False
    return np.concatenate(levels)
