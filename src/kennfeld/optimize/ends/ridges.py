"""Ridges on which a descent stops: combinations of values that change the outputs to second order only.

If two terms of a sum become alike, as in `a*exp(-b*x) + c*exp(-d*x)` with b = d, their derivatives are multiples of
each other. The Gauss-Newton model then sees neither how a and c may be exchanged nor that b and d should part again.
Such combinations are the null space of J, which turns from point to point: a step along it is followed by shorter ones
along that of the new point, and the cost is looked up.
"""

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.optimize.limits.projection import FEASIBLE
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.trust.information_matrix import Spectrum, echelon, pivots

ALIKE = 1e-4  # singular value of the Jacobian with columns of length 1, relative to the largest
LONG, SHORT = (0.1, 5.0), (1e-3, 0.3)  # steps, in sizes of the values
LONG_STEPS, SHORT_STEPS = 24, 6
LOWER = 1e-6  # share of the cost


def lower_values(objective: LeastSquaresObjective, values: Float, cost: float, limits: LinearLimits) -> Float | None:
    """Return values of a lower cost that differ by combinations without an effect to first order; None without.

    Args:
        objective: a small problem, whose Jacobian is at hand.
        values: the end of a descent, Float[values].
        cost: there.
        limits: bounds and linear rows.
    """
    null = _null_space(objective, values, limits)
    if not len(null):
        return None
    # the same draws for the same end
    random, best, least = np.random.default_rng(0), None, (1 - LOWER) * cost
    # rows may be missed by as much as at the end
    allowed = max(limits.violation(values), FEASIBLE)
    for _ in range(LONG_STEPS):
        # a long step along one combination, then short ones along all of those at the new point
        far = limits.clip(values + float(_draw(random, LONG, 1)[0]) * null[random.integers(len(null))])
        beside = _null_space(objective, far, limits) if np.isfinite(objective.cost(far)) else null[:0]
        for _ in range(SHORT_STEPS if len(beside) else 0):
            trial = limits.clip(far + _draw(random, SHORT, len(beside)) @ beside)
            trial_cost = objective.cost(trial)
            if trial_cost < least and limits.violation(trial) <= allowed:
                best, least = trial, trial_cost
    return best


def _draw(random: np.random.Generator, sizes: tuple[float, float], count: int) -> Float:
    """Return steps of either sign whose sizes are uniform in their logarithm, Float[count]."""
    low, high = np.log(sizes).tolist()
    steps: Float = random.choice([-1.0, 1.0], count) * np.exp(random.uniform(low, high, count))
    return steps


def _null_space(objective: LeastSquaresObjective, values: Float, limits: LinearLimits) -> Float:
    """Return combinations without an effect to first order, each of the size of the values; Float[count, values]."""
    _, jacobian = objective.rows(values)
    lengths = np.linalg.norm(jacobian, axis=0)
    moving = np.flatnonzero(limits.movable & (lengths > 0))
    if moving.size < 2 or not np.all(np.isfinite(lengths)):
        return np.zeros((0, values.size))
    spectrum = Spectrum.of_rows(jacobian[:, moving], ALIKE)
    if not spectrum.null.size:
        return np.zeros((0, values.size))
    null = np.zeros((spectrum.null.shape[1], values.size))
    # each the only one with a part in some value
    null[:, moving] = echelon(spectrum.null, pivots(spectrum.null)).T / spectrum.scale
    size = np.where(values != 0, np.abs(values), 1.0)
    # the value that changes most changes by its own size
    null /= np.max(np.abs(null) / size, axis=1, initial=1e-300)[:, None]
    return null
