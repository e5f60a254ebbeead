"""Intervals of single values in which the cost stays the same, such as those of a threshold between two samples."""

from collections.abc import Callable, Iterable

import numpy as np

from kennfeld.base.arrays import Float

SAME = 1e-10  # relative difference of the cost that is rounding
FIRST = 2.0**-24  # share of the distance to a bound at which the cost is compared first
HALVINGS = 20
MAX_VALUES = 8  # whose intervals are looked for

Intervals = Float  # Float[2, values]: the lower and the upper end; NaN if unknown


def flat_intervals(cost: Callable[[Float], float], values: Float, which: Iterable[int], bounds: Float) -> Intervals:
    """Find the interval around some values in which each alone leaves the cost as it is.

    It is NaN for a value that has no effect anywhere within its bounds, and for those after the first few.

    Args:
        cost: of all values.
        values: the end of a search; shape (values,).
        which: numbers of the values.
        bounds: finite lower and upper bounds; shape (2, values).
    """
    intervals = np.full((2, values.size), np.nan)
    here = cost(values)
    for number in [*which][:MAX_VALUES]:

        def is_same(value: float, number: int = number) -> bool:
            changed = values.copy()
            changed[number] = value
            return bool(abs(cost(changed) - here) <= SAME * abs(here))

        ends = [_end(is_same, float(values[number]), float(bound)) for bound in bounds[:, number]]
        # up to both bounds: the value has no effect at all
        if np.isfinite(ends).all() and ends != bounds[:, number].tolist():
            intervals[:, number] = ends
    return intervals


def _end(is_same: Callable[[float], bool], value: float, bound: float) -> float:
    """Return how far a value can move towards a bound."""
    span, share = bound - value, FIRST
    if span == 0 or not np.isfinite(span):
        return bound
    # doubles until the cost differs; an interval that is small beside the bounds takes few evaluations
    while share < 1 and is_same(value + share * span):
        share *= 2
    if share >= 1 and is_same(bound):
        return bound
    # bisection between the last share with the same cost and the first with another
    near, far = (0.0 if share == FIRST else share / 2), min(share, 1.0)
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if is_same(value + middle * span) else (near, middle)
    return value + near * span
