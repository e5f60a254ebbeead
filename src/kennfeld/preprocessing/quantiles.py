"""Exact quantiles of columns that lie in several places: the order statistics are found digit by digit.

Doubles sort like integers once the sign is accounted for. Each pass over the data counts 16 of the 64 bits of those
values that agree with a sought order statistic in all bits before; once these values are few, one pass counts all bits
that remain. The result is that of `numpy.quantile` on all values at once, however they are divided; what is sent are
counts.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass

BITS = 16
FEW = 1 << 16  # values whose remaining bits are counted in one pass
_SIGN = np.uint64(1 << 63)

Codes = NDArray[np.uint64]


@dataclass(frozen=True)
class Digits:
    """One pass: values are counted by the `bits` bits above `shift` if the bits above these are one of `prefixes`."""

    shift: int
    bits: int
    prefixes: Codes  # increasing


@dataclass(frozen=True)
class DigitCounts:
    """Numbers of values by prefix and digit: `counts[i]` values have `places[i]` = prefix number * 2^bits + digit."""

    places: Int  # increasing
    counts: Int


Pass = Callable[[Digits], Iterable[DigitCounts]]


def count_digits(columns: Iterable[Float], digits: Digits) -> DigitCounts:
    """Count the digits of the finite values of some columns."""
    places = np.concatenate([np.zeros(0, dtype=np.int64), *(_places(column, digits) for column in columns)])
    return DigitCounts(*np.unique(places, return_counts=True))


def _places(column: Float, digits: Digits) -> Int:
    codes = _codes(column[np.isfinite(column)])
    digit = ((codes >> np.uint64(digits.shift)) & _mask(digits)).astype(np.int64)
    if digits.shift + digits.bits == 64:
        return digit
    prefix = codes >> np.uint64(digits.shift + digits.bits)
    # of values with a prefix that is not sought nothing is counted
    which = np.searchsorted(digits.prefixes, prefix)
    known = which < digits.prefixes.size
    known[known] = digits.prefixes[which[known]] == prefix[known]
    return (which[known] << digits.bits) | digit[known]


def _mask(digits: Digits) -> np.uint64:
    return np.uint64((1 << digits.bits) - 1)


def _codes(values: Float) -> Codes:
    """Return integers that sort like the values."""
    bits = np.ascontiguousarray(values).view(np.uint64)
    # IEEE 754: the bits of negative numbers grow with their magnitude, so all are inverted; a 1 in place of the sign
    # puts the others above them
    return np.where(bits & _SIGN, ~bits, bits | _SIGN)


def _values(codes: Codes) -> Float:
    return np.where(codes & _SIGN, codes ^ _SIGN, ~codes).view(np.float64)


def quantiles(run: Pass, probabilities: Sequence[float] | Float) -> Float:
    """Compute the quantiles of all values, as `numpy.quantile` does; an empty array if there are none.

    Args:
        run: counts the digits of all values, in any number of parts.
        probabilities: from 0 to 1.

    >>> parts = [np.array([4.0, 1.0]), np.array([3.0, np.nan, 2.0])]
    >>> quantiles(lambda digits: [count_digits([part], digits) for part in parts], [0.0, 0.5, 1.0])
    array([1. , 2.5, 4. ])
    """
    digits = Digits(64 - BITS, BITS, np.zeros(1, dtype=np.uint64))
    totals = _totals(run(digits))
    count = int(totals.counts.sum())
    if not count:
        return np.zeros(0)
    # numpy's method "linear": q * (n - 1) lies between the order statistics of two neighbouring ranks
    place = np.asarray(probabilities, dtype=np.float64) * (count - 1)
    below = np.floor(place).astype(np.int64)
    ranks = np.unique(np.concatenate([below, np.minimum(below + 1, count - 1)]))
    statistics = _values(_select(run, digits, totals, ranks))
    low, high = (statistics[np.searchsorted(ranks, rank)] for rank in (below, np.minimum(below + 1, count - 1)))
    share, width = place - below, high - low
    # from the nearer of the two, as numpy interpolates, so that both agree to the last bit
    return np.where(share < 0.5, low + width * share, high - width * (1 - share))


def _select(run: Pass, digits: Digits, totals: DigitCounts, ranks: Int) -> Codes:
    """Return the values of these ranks as integers."""
    owners = np.zeros(ranks.size, dtype=np.int64)  # the prefix of each rank
    remaining = ranks  # the rank among the values with this prefix
    while True:
        smaller = np.concatenate([[0], np.cumsum(totals.counts)])  # values before each place
        before = smaller[np.searchsorted(totals.places, owners << digits.bits)]
        place = np.searchsorted(smaller, before + remaining, side="right") - 1
        remaining = before + remaining - smaller[place]
        digit = totals.places[place].astype(np.uint64) & _mask(digits)
        codes = (digits.prefixes[owners] << np.uint64(digits.bits)) | digit
        if not digits.shift:
            return codes
        prefixes, owners = np.unique(codes, return_inverse=True)
        # the number of a prefix and all bits that remain must fit into the 63 bits of a place
        few = totals.counts[np.unique(place)].sum() <= FEW and prefixes.size < 1 << (63 - digits.shift)
        bits = digits.shift if few else BITS
        digits = Digits(digits.shift - bits, bits, prefixes)
        totals = _totals(run(digits))


def _totals(parts: Iterable[DigitCounts]) -> DigitCounts:
    """Return the counts of all parts."""
    parts, none = list(parts), np.zeros(0, dtype=np.int64)
    unique, which = np.unique(np.concatenate([none, *(part.places for part in parts)]), return_inverse=True)
    totals = np.zeros(unique.size, dtype=np.int64)
    np.add.at(totals, which, np.concatenate([none, *(part.counts for part in parts)]))
    return DigitCounts(unique, totals)
