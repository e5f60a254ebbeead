"""Exact quantiles of columns that lie in several places: the order statistics are found digit by digit.

Doubles sort like integers once the sign is accounted for. Four passes over the data each count 16 of the 64 bits of
those values that agree with a sought order statistic in all bits before. The result is that of `numpy.quantile` on all
values at once, however they are divided; what is sent are counts.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from kennfeld.arrays import Float, Int
from kennfeld.lazy_dataclass import dataclass

BITS = 16
_DIGITS = 1 << BITS
_SIGN = np.uint64(1 << 63)

Codes = NDArray[np.uint64]


@dataclass(frozen=True)
class Digits:
    """One pass: values are counted by the `BITS` bits above `shift` if the bits above these are one of `prefixes`."""

    shift: int
    prefixes: Codes  # increasing


@dataclass(frozen=True)
class DigitCounts:
    """Numbers of values by prefix and digit: `counts[i]` values have `places[i]` = prefix number * 2^16 + digit."""

    places: Int
    counts: Int


Pass = Callable[[Digits], Iterable[DigitCounts]]


def count_digits(columns: Iterable[Float], digits: Digits) -> DigitCounts:
    """Count the digits of the finite values of some columns."""
    places = np.concatenate([np.zeros(0, dtype=np.int64), *(_places(column, digits) for column in columns)])
    return DigitCounts(*np.unique(places, return_counts=True))


def _places(column: Float, digits: Digits) -> Int:
    codes = _codes(column[np.isfinite(column)])
    digit = ((codes >> np.uint64(digits.shift)) & np.uint64(_DIGITS - 1)).astype(np.int64)
    if digits.shift + BITS == 64:
        return digit
    prefix = codes >> np.uint64(digits.shift + BITS)
    which = np.searchsorted(digits.prefixes, prefix)
    known = which < digits.prefixes.size
    known[known] = digits.prefixes[which[known]] == prefix[known]
    return which[known] * _DIGITS + digit[known]


def _codes(values: Float) -> Codes:
    """Return integers that sort like the values."""
    bits = np.ascontiguousarray(values).view(np.uint64)
    return np.where(bits & _SIGN, ~bits, bits | _SIGN)


def _values(codes: Codes) -> Float:
    return np.where(codes & _SIGN, codes ^ _SIGN, ~codes).view(np.float64)


def quantiles(run: Pass, probabilities: Sequence[float] | Float) -> Float:
    """Return the quantiles of all values, as `numpy.quantile` does; an empty array if there are none.

    Args:
        run: counts the digits of all values, in any number of parts.
        probabilities: from 0 to 1.

    >>> parts = [np.array([4.0, 1.0]), np.array([3.0, np.nan, 2.0])]
    >>> quantiles(lambda digits: [count_digits([part], digits) for part in parts], [0.0, 0.5, 1.0])
    array([1. , 2.5, 4. ])
    """
    digits = Digits(64 - BITS, np.zeros(1, dtype=np.uint64))
    totals = _totals(run(digits), 1)
    count = int(totals.sum())
    if not count:
        return np.zeros(0)
    place = np.asarray(probabilities, dtype=np.float64) * (count - 1)
    below = np.floor(place).astype(np.int64)
    ranks = np.unique(np.concatenate([below, np.minimum(below + 1, count - 1)]))
    statistics = _values(_select(run, digits, totals, ranks))
    low, high = (statistics[np.searchsorted(ranks, rank)] for rank in (below, np.minimum(below + 1, count - 1)))
    share, width = place - below, high - low
    return np.where(share < 0.5, low + width * share, high - width * (1 - share))


def _select(run: Pass, digits: Digits, totals: Int, ranks: Int) -> Codes:
    """Return the values of these ranks as integers."""
    owners = np.zeros(ranks.size, dtype=np.int64)  # the prefix of each rank
    remaining = ranks.copy()  # the rank among the values with this prefix
    while True:
        ends = np.cumsum(totals, axis=1)
        digit = np.array([np.searchsorted(ends[o], r, side="right") for o, r in zip(owners, remaining, strict=True)])
        remaining -= np.where(digit > 0, ends[owners, digit - 1], 0)
        codes = (digits.prefixes[owners] << np.uint64(BITS)) | digit.astype(np.uint64)
        if not digits.shift:
            return codes
        prefixes, owners = np.unique(codes, return_inverse=True)
        digits = Digits(digits.shift - BITS, prefixes)
        totals = _totals(run(digits), prefixes.size)


def _totals(parts: Iterable[DigitCounts], prefixes: int) -> Int:
    """Return the counts of all parts, Int[prefixes, digits]."""
    totals = np.zeros(prefixes * _DIGITS, dtype=np.int64)
    for part in parts:
        totals[part.places] += part.counts
    return totals.reshape(prefixes, _DIGITS)
