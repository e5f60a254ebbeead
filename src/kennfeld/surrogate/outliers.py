"""Training points with a gross error, such as a wild value or an input of another magnitude."""

import numpy as np

from kennfeld.arrays import Bool, Float

NEIGHBOURS = 10
GROSS = 12.0  # robust deviations
FAR = 100.0  # robust deviations of an input
MOST = 0.05  # share of the points; if there are more, the distribution has wide tails
NORMAL = 1.4826  # deviation of a normal distribution in median absolute deviations


def far_inputs(x: Float) -> Bool:
    """Return the rows of Float[rows, inputs] in which an input is far from all others, Bool[rows].

    >>> far_inputs(np.array([[1.0], [2.0], [3.0], [4.0], [1e6]]))
    array([False, False, False, False,  True])
    """
    distance = np.abs(x - np.median(x, axis=0))
    deviation = NORMAL * np.median(distance, axis=0)
    far: Bool = np.any((deviation > 0) & (distance > FAR * deviation), axis=1)
    return far if far.sum() <= max(MOST * len(x), 1) else np.zeros(len(x), dtype=bool)


def gross_errors(x: Float, y: Float) -> Bool:
    """Return the rows whose value differs from those of its neighbours by far more than these differ, Bool[rows].

    A value is compared with the median over the nearest points, in robust deviations of these or, if it is larger, of
    all such differences. `x` Float[rows, inputs] is in units of spread.
    """
    from scipy.spatial import cKDTree

    count = min(NEIGHBOURS, len(y) - 1)
    if count < 3:
        return np.zeros(len(y), dtype=bool)
    neighbours = cKDTree(x).query(x, count + 1)[1][:, 1:]  # of equal points, any of them may be the first
    beside = np.where(neighbours == np.arange(len(y))[:, None], np.roll(neighbours, 1, axis=1), neighbours)
    middle = np.median(y[beside], axis=1)
    local = NORMAL * np.median(np.abs(y[beside] - middle[:, None]), axis=1)
    difference = np.abs(y - middle)
    general = NORMAL * float(np.median(difference))
    if general == 0:
        general = float(np.mean(np.sort(difference)[: int(0.95 * len(y))]))
    gross: Bool = difference > GROSS * np.maximum(local, max(general, 1e-12 * float(np.abs(y).max())))
    return gross if gross.sum() <= max(MOST * len(y), 1) else np.zeros(len(y), dtype=bool)
