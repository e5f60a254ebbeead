"""All choices of some of few candidates, so that the best of them is certain."""

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, combinations, combinations_with_replacement, islice
from math import comb

import numpy as np

from kennfeld.base.arrays import Float, Int

MOST_SUBSETS = 20_000  # that are all compared, in well below a second
MOST_NUMBERS = 5_000_000  # that are held for those compared at once
BEST_TIMES = 3  # that a search from random starts ends at its best value before it is believed


def count_subsets(candidates: int, count: int, *, repeats: bool = False) -> int:
    """Return the number of choices of `count` candidates; with `repeats`, each several times."""
    return comb(candidates + count - 1, count) if repeats else comb(candidates, count)


def best_subset(
    candidates: Sequence[int],
    count: int,
    values: Callable[[Int], Float],
    width: int,
    *,
    repeats: bool = False,
) -> tuple[float, list[int]] | None:
    """Return the least value and its choice of candidates; None if there are too many to compare all.

    Args:
        candidates: their numbers.
        count: of candidates in a choice, >= 1.
        values: of some choices, Float[choices], given their candidates, Int[choices, count].
        width: numbers that `values` holds for each choice.
        repeats: allow a candidate several times.

    >>> best_subset([1, 2, 5], 2, lambda chosen: abs(chosen.sum(axis=1) - 6.0), 1)
    (0.0, [1, 5])
    """
    if count_subsets(len(candidates), count, repeats=repeats) > MOST_SUBSETS:
        return None
    best: tuple[float, list[int]] | None = None
    for chosen in _blocks(candidates, count, max(MOST_NUMBERS // max(width, 1), 1), repeats=repeats):
        each = values(chosen)
        at = int(each.argmin())
        if best is None or each[at] < best[0]:
            best = float(each[at]), chosen[at].tolist()
    return best


def _blocks(candidates: Sequence[int], count: int, size: int, *, repeats: bool) -> Iterator[Int]:
    """Yield all choices, Int[choices, count], at most `size` at once."""
    choices = iter((combinations_with_replacement if repeats else combinations)(candidates, count))
    while True:
        block = np.fromiter(chain.from_iterable(islice(choices, size)), dtype=np.int64).reshape(-1, count)
        if not len(block):
            return
        yield block
