"""Choice of the slopes of an FMU: directional derivatives that agree with differences, else differences alone.

An FMU may claim directional derivatives and return wrong ones without an error, for example zeros along parameters. A
column of slopes is therefore compared with central differences at a few points near the start.

The step of differences depends on the noise of the function (More and Wild, SIAM J. Sci. Comput. 33 (2011) 1292): an
FMU that solves equations by iteration is not exact to the last digit.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.arrays import Float
from kennfeld.models.fmu.evaluation_code import DIFFERENCES, DIRECTIONAL, SKIPPED

_POINTS = 4  # near the start
_SPREAD = 0.2  # of their distances, relative to the orders of magnitude
_TOLERANCE = 1e-4  # of directional derivatives
_SPACING = 1e-7  # of the points from which noise is estimated
_EPSILON = float(np.finfo(float).eps)
_LEVELS = range(4, 7)  # of the table of differences


def difference_step(noise: float) -> float:
    """Return the relative step of central differences that balances noise and curvature."""
    return min(math.cbrt(3 * max(noise, _EPSILON)), 0.05)


def relative_noise(evaluate: Callable[[Float], Float], point: Float, magnitudes: Float) -> float:
    """Return the noise of a function relative to its results, from differences of high order along a line."""
    direction = _SPACING * magnitudes
    direction[0] = 0.0  # time
    table = np.array([evaluate(point + number * direction) for number in range(max(_LEVELS) + 1)])
    size = np.max(np.abs(table), axis=0)
    differences, estimates = table, []
    for level in range(1, max(_LEVELS) + 1):
        differences = np.diff(differences, axis=0)
        if level in _LEVELS:
            weight = math.factorial(level) ** 2 / math.factorial(2 * level)
            estimates.append(np.sqrt(weight * np.mean(differences**2, axis=0)))
    relative = np.min(estimates, axis=0)[size > 0] / size[size > 0]
    usable = relative[np.isfinite(relative)]
    return float(usable.max(initial=0.0))


def agreeing_columns(
    evaluate: Callable[[Float], tuple[Float, Float]], kinds: Float, point: Float, magnitudes: Float
) -> Sequence[int]:
    """Return the arguments whose directional derivatives agree with differences at all points that can be evaluated.

    Args:
        evaluate: returns results and slopes, which are computed as `kinds` says.
        kinds: how the slopes along each argument are computed; restored afterwards.
        point: the start.
        magnitudes: orders of magnitude of the arguments.
    """
    rng = np.random.default_rng(0)
    own = kinds.copy()
    agree, compared = own != SKIPPED, np.zeros(len(own), dtype=bool)
    for number in range(_POINTS):
        near = point + (number > 0) * _SPREAD * magnitudes * rng.uniform(-1.0, 1.0, len(point)) * (own != SKIPPED)
        slopes = []
        for kind in (DIFFERENCES, DIRECTIONAL):
            kinds[:] = np.where(own == SKIPPED, SKIPPED, kind)
            slopes.append(evaluate(near)[1])
        differences, directional = slopes
        kinds[:] = own
        if not np.all(np.isfinite(differences)):
            continue  # outside of the range of the model
        scale = np.max(np.abs(differences) * magnitudes, axis=1, keepdims=True)
        distance = np.abs(directional - differences) * magnitudes
        close = distance <= _TOLERANCE * np.maximum(np.abs(differences) * magnitudes, 1e-3 * scale)
        agree &= close.all(axis=0)
        compared |= np.any(differences != 0, axis=0)
    return [int(column) for column in np.flatnonzero(agree & compared)]
