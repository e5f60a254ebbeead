"""Training points with a gross error, such as a wild value or an input of another magnitude."""

import numpy as np

from kennfeld.base.arrays import Bool, Float

NEIGHBOURS = 10
GROSS = 12.0  # robust deviations
FAR = 100.0  # ranges of an input over the middle of the rows
MIDDLE = (0.025, 0.975)  # quantiles
MOST_FAR = 2  # rows; more are a state of their own, such as a fuel cut-off
MOST = 0.05  # share of the points; if there are more, the distribution has wide tails
NORMAL = 1.4826  # deviation of a normal distribution in median absolute deviations


def far_inputs(x: Float) -> Bool:
    """Mark the rows of Float[rows, inputs] in which an input is far from all others, Bool[rows].

    >>> np.flatnonzero(far_inputs(np.append(np.arange(50.0), 1e6)[:, None]))
    array([50])
    """
    # observed values: interpolated towards a value of 1e6, a quantile of few rows would be far out itself
    lowest, highest = np.quantile(x, MIDDLE, axis=0, method="closest_observation")
    far = np.abs(x - np.median(x, axis=0)) > FAR * (highest - lowest)
    # an input that is constant nearly everywhere has no range to compare with
    far &= (highest > lowest) & (far.sum(axis=0) <= MOST_FAR)
    return np.asarray(far.any(axis=1), dtype=np.bool_)


def gross_errors(x: Float, y: Float) -> Bool:
    """Mark the rows whose value differs from those of its neighbours by far more than these differ, Bool[rows].

    A value is compared with the median over the nearest points, in robust deviations of these or, if it is larger, of
    all such differences. `x` Float[rows, inputs] is in units of spread.
    """
    from scipy.spatial import cKDTree

    count = min(NEIGHBOURS, len(y) - 1)
    if count < 3:
        return np.zeros(len(y), dtype=bool)
    neighbours = cKDTree(x).query(x, count + 1)[1][:, 1:]  # of equal points, any of them may be the first
    # a point that is still among its own neighbours is replaced by another of them
    beside = np.where(neighbours == np.arange(len(y))[:, None], np.roll(neighbours, 1, axis=1), neighbours)
    middle = np.median(y[beside], axis=1)
    local = NORMAL * np.median(np.abs(y[beside] - middle[:, None]), axis=1)
    difference = np.abs(y - middle)
    general = NORMAL * float(np.median(difference))
    # at least half of the values equal their neighbours' median: the mean of all but the largest differences instead
    if general == 0:
        general = float(np.mean(np.sort(difference)[: int(0.95 * len(y))]))
    gross: Bool = difference > GROSS * np.maximum(local, max(general, 1e-12 * float(np.abs(y).max())))
    return gross if gross.sum() <= max(MOST * len(y), 1) else np.zeros(len(y), dtype=bool)
