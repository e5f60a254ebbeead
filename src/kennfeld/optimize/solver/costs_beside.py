"""The distance from a minimum by costs alone, for values whose derivatives say nothing about it.

In `a^2 * x` the derivative by a vanishes with a itself, and with it the curvature of the model: it promises much, but
for a target of -x the curvature of the residuals holds a at 0. A parabola through the costs at, below and above a value
tells how far the value is from the minimum.
"""

from collections.abc import Callable, Iterable

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.optimize.solver.certificate import Certificate
from kennfeld.optimize.solver.linear_constraints import LinearLimits

SHARES = (1e-4, 1e-2, 1.0)  # distances to both sides, relative to the size of a value
ROUNDING = 1e-12  # of the cost


def certificate_of_costs(
    cost_at: Callable[[Float], float],
    values: Float,
    cost: float,
    sizes: Float,
    numbers: Iterable[int],
    limits: LinearLimits,
) -> Certificate | None:
    """Compute the certificate by parabolas along some values; None if a value is not at a minimum.

    Args:
        cost_at: the cost at other values within the limits.
        values: at which the certificate is wanted, Float[values].
        cost: at these values, > 0.
        sizes: typical size of each value, Float[values].
        numbers: of the values to look along.
        limits: no value beyond them is looked at.
    """

    def rise(number: int, target: float) -> float:
        """Return the rise of the cost if a value moves; infinite if it cannot."""
        beside = values.copy()
        beside[number] = target
        if target == values[number] or not limits.keeps(beside):
            return np.inf
        difference = cost_at(beside) - cost
        return difference if np.isfinite(difference) else np.inf

    decrease = 0.0
    for number in numbers:
        value, bounds = values[number], (limits.lower[number], limits.upper[number])
        for share in SHARES:
            targets = [float(np.clip(value + side * share * sizes[number], *bounds)) for side in (-1, 1)]
            rises = [rise(number, target) for target in targets]
            # lower beside it: not a minimum, whatever larger distances say
            if min(rises) < -ROUNDING * cost:
                return None
            # the shortest distance that shows a rise decides: farther away, the cost may be another curve
            if ROUNDING * cost < min(rises) < np.inf:
                break
        else:
            return None
        decrease += _depth([target - value for target in targets], rises)
    share = float(decrease / cost)
    return Certificate(share**0.5, share)


def _depth(steps: list[float], rises: list[float]) -> float:
    """Return by how much a parabola falls below the middle one of three costs.

    It is 0 if only one side is possible: what cannot be tried promises nothing.

    >>> _depth([-1.0, 3.0], [1.5**2 - 0.5**2, 2.5**2 - 0.5**2])  # (x - 0.5)^2
    0.25
    """
    if not np.isfinite(rises).all():
        return 0.0
    (left, right), (low, high) = steps, rises
    # f(s) = slope s + bend s^2 through (left, low), (0, 0), (right, high); its lowest value is -slope^2 / (4 bend)
    bend = (high / right - low / left) / (right - left)
    slope = low / left - bend * left
    return slope**2 / (4 * bend)
