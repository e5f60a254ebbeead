"""Statistics of numbers that arrive in parts: each can be merged with that of other parts.

Parts may therefore be processed by several threads or machines, and none has to be kept.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import field
from functools import reduce
from typing import Protocol, Self, TypeVar

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import map_in_order

_KEY_BITS = 14  # numbers with the same sign, exponent and first two bits of the mantissa share a key
_INNER_BITS = 14  # numbers of one key with the same next bits of the mantissa share an inner key
_KEYS, _INNER_KEYS = 1 << _KEY_BITS, 1 << _INNER_BITS
MOST_NEAR = 1 << 20  # numbers that a search keeps

_Part = TypeVar("_Part")  # Python 3.11
_Statistic = TypeVar("_Statistic", bound="Mergeable")


class Mergeable(Protocol):
    """A statistic that can take in the one of later numbers."""

    def merge(self, later: Self) -> None:
        """Take in the statistic of later numbers."""


def gather(work: Callable[[_Part], _Statistic], parts: Sequence[_Part]) -> _Statistic:
    """Return the merged statistics of all parts, computed by threads; there must be a part."""
    result = merge_all(map_in_order(work, parts))
    assert result is not None
    return result


def merge_all(statistics: Iterable[_Statistic]) -> _Statistic | None:
    """Return the merged statistics of parts, in their order; None without parts."""

    def merge(statistic: _Statistic, later: _Statistic) -> _Statistic:
        statistic.merge(later)
        return statistic

    remaining = iter(statistics)
    first = next(remaining, None)
    return None if first is None else reduce(merge, remaining, first)


@dataclass
class Moments:
    """Count, mean and sum of squared distances from the mean; the latter is exactly 0 if all numbers are equal.

    Source: T. F. Chan, G. H. Golub, R. J. LeVeque: Algorithms for Computing the Sample Variance, The American
    Statistician 37, 1983. All sums are relative to the first number.

    >>> moments = Moments.of(np.array([1.0, 2.0]))
    >>> moments.merge(Moments.of(np.array([6.0])))
    >>> moments.count, moments.mean, moments.squares
    (3, 3.0, 14.0)
    """

    count: int = 0
    origin: float = 0.0
    total: float = 0.0
    squares: float = 0.0

    @classmethod
    def of(cls, values: Float) -> "Moments":
        """Return the moments of numbers, Float[samples]."""
        if not values.size:
            return cls()
        with np.errstate(over="ignore", invalid="ignore"):
            origin = float(values[0])
            total = float(np.sum(values - origin))
            squares = float(np.sum((values - (origin + total / values.size)) ** 2))
        return cls(values.size, origin, total, squares)

    @property
    def mean(self) -> float:
        """The mean; NaN without numbers."""
        return self.origin + self.total / self.count if self.count else float("nan")

    @property
    def deviation(self) -> float:
        """The standard deviation of all numbers; NaN without numbers."""
        return float(np.sqrt(self.squares / self.count)) if self.count else float("nan")

    def merge(self, later: "Moments") -> None:
        """Take in the moments of later numbers."""
        if not self.count or not later.count:
            if later.count:
                self.__dict__.update(vars(later))
            return
        with np.errstate(over="ignore", invalid="ignore"):
            shift = later.origin - self.origin
            # d, the distance of the means; the squares are those of both parts + d^2 n1 n2 / (n1 + n2)
            apart = shift + later.total / later.count - self.total / self.count
            self.squares += later.squares + apart**2 * (self.count * later.count / (self.count + later.count))
            self.total += later.total + later.count * shift
        self.count += later.count


@dataclass
class Ranks:
    """Numbers counted by their size, from which `search` begins to look for quantiles; NaN is not counted."""

    counts: Int = field(default_factory=lambda: np.zeros(_KEYS, dtype=np.int64))  # Int[keys]

    @classmethod
    def of(cls, values: Float) -> "Ranks":
        """Return the counts of numbers, Float[samples]."""
        return cls(np.bincount(_first_bits(_known(values), _KEY_BITS), minlength=_KEYS)[_RISING])

    @property
    def sizes(self) -> "Ranks":
        """The counts of the absolute numbers."""
        negative, positive = np.split(self.counts, 2)
        # the keys of -x and x lie at the same distance from the middle
        return Ranks(np.concatenate([np.zeros_like(negative), positive + negative[::-1]]))

    def merge(self, later: "Ranks") -> None:
        """Take in the counts of other numbers."""
        self.counts += later.counts

    def search(self, shares: Iterable[float]) -> "QuantileSearch":
        """Return a search for the quantiles of these shares, in a second pass over the same numbers."""
        count = int(self.counts.sum())
        ends = np.cumsum(self.counts)
        wanted = np.zeros(_KEYS, dtype=bool)
        for share in shares if count else ():
            low, high, _ = _position(share, count)
            # the key of a rank is the first up to which more numbers are counted
            wanted[np.searchsorted(ends, [low, high], side="right")] = True
        counted = int(self.counts[wanted].sum()) > MOST_NEAR
        return QuantileSearch(count, ends - self.counts, wanted, _InnerCounts.of(wanted) if counted else None)


@dataclass
class _InnerCounts:
    """Numbers of the wanted keys counted by their next bits, in place of themselves if they are too many."""

    firsts: Int  # the first bits of numbers of each wanted key
    counts: Int  # Int[wanted keys, inner keys]

    @classmethod
    def of(cls, wanted: "np.ndarray[tuple[int], np.dtype[np.bool_]]", values: Float | None = None) -> "_InnerCounts":
        firsts = _RISING[wanted]
        counts = np.zeros((firsts.size, _INNER_KEYS), dtype=np.int64)
        if values is not None:
            bits, rows = _first_bits(values, _KEY_BITS + _INNER_BITS), np.zeros(_KEYS, dtype=np.int64)
            rows[firsts] = np.arange(firsts.size)
            inner = rows.take(bits >> _INNER_BITS) * _INNER_KEYS + (bits & (_INNER_KEYS - 1))
            counts = np.bincount(inner, minlength=counts.size).reshape(counts.shape)
        return cls(firsts, counts)

    def number(self, row: int, rank: int) -> float:
        """Return the number of a rank among those of a wanted key, with the bits of the mantissa that are known."""
        first = int(self.firsts[row])
        inner = np.arange(_INNER_KEYS)[:: 1 if first < _KEYS // 2 else -1]  # in the order of the numbers, see `_RISING`
        at = np.searchsorted(np.cumsum(self.counts[row][inner]), rank, side="right")
        bits = (first << _INNER_BITS | int(inner[at])) << (64 - _KEY_BITS - _INNER_BITS)
        return float(np.uint64(bits).view(np.float64))


@dataclass
class QuantileSearch:
    """Collects the numbers near some quantiles; see `Ranks`.

    If they are more than `MOST_NEAR`, they are counted instead, and a quantile is exact to 1.6e-5 of its size.

    >>> numbers = np.arange(101.0)
    >>> search = Ranks.of(numbers).search([0.5, 0.95])
    >>> search.merge(search.part(numbers))
    >>> search.quantile(0.95)
    95.0
    """

    count: int
    before: Int  # Int[keys]: how many numbers have a smaller key
    wanted: "np.ndarray[tuple[int], np.dtype[np.bool_]]"  # by key
    _inner: _InnerCounts | None = None
    _near: list[Float] = field(default_factory=list)

    def part(self, values: Float) -> "QuantileSearch":
        """Return the same search over some of the numbers, Float[any]."""
        known, wanted = _known(values), np.empty_like(self.wanted)
        wanted[_RISING] = self.wanted
        near = known[wanted.take(_first_bits(known, _KEY_BITS))]
        if self._inner is not None:
            return QuantileSearch(self.count, self.before, self.wanted, _InnerCounts.of(self.wanted, near))
        return QuantileSearch(self.count, self.before, self.wanted, None, [near])

    def merge(self, later: "QuantileSearch") -> None:
        """Take in the same search over other numbers."""
        self._near += later._near
        if self._inner is not None and later._inner is not None:
            self._inner.counts += later._inner.counts

    def quantile(self, share: float) -> float:
        """Return a quantile that was asked for, as `numpy.quantile` does; NaN without numbers."""
        if not self.count:
            return float("nan")
        low, high, fraction = _position(share, self.count)
        a, b = self._numbers((low, high))
        with np.errstate(invalid="ignore"):
            step = np.float64(b) - a
            # from the nearer end, as numpy does, so that both ends are exact
            return float(b - step * (1 - fraction) if fraction >= 0.5 else a + step * fraction)

    def _numbers(self, ranks: Iterable[int]) -> list[float]:
        """Return the numbers of some ranks."""
        keys = np.flatnonzero(self.wanted)
        rows = [(i, int(rank - self.before[keys[i]])) for rank, i in self._places(ranks, keys)]
        if self._inner is not None:
            return [self._inner.number(i, rank) for i, rank in rows]
        counts = np.diff(np.append(self.before, self.count))[keys]
        firsts = np.cumsum(counts) - counts  # of the numbers of each key among those near
        places = [int(firsts[i]) + rank for i, rank in rows]
        # kept as it is partitioned, for the next quantile
        self._near = [np.partition(np.concatenate([*self._near, np.empty(0)]), places)]
        numbers: list[float] = self._near[0][places].tolist()
        return numbers

    def _places(self, ranks: Iterable[int], keys: Int) -> list[tuple[int, int]]:
        """Return each rank with the index of its key."""
        return [(rank, int(np.searchsorted(self.before[keys], rank, side="right")) - 1) for rank in ranks]


def _position(share: float, count: int) -> tuple[int, int, float]:
    """Return the two ranks between which a quantile lies, from 0, and where between them."""
    at = share * (count - 1)
    low = int(np.floor(at))
    return low, min(low + 1, count - 1), at - low


def _known(values: Float) -> Float:
    """Return the numbers that are not NaN."""
    missing = np.isnan(values)
    return values[~missing] if missing.any() else values


def _first_bits(values: Float, count: int) -> Int:
    """Return the first bits of each number: sign, exponent, and the beginning of the mantissa."""
    # the shift copies the sign into all higher bits, which the mask removes
    bits = np.ascontiguousarray(values, dtype=np.float64).view(np.int64) >> (64 - count)
    bits &= (1 << count) - 1
    return bits


# the first bits of numbers by their key, in the order of the numbers: those of negative ones fall
_RISING = np.concatenate([np.arange(_KEYS - 1, _KEYS // 2 - 1, -1), np.arange(_KEYS // 2)])
