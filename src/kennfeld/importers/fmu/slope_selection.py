"""Choice of the slopes of an FMU: directional derivatives that agree with differences, else differences alone.

An FMU may claim directional derivatives and return wrong ones without an error, for example zeros along parameters. A
column of slopes is therefore compared with central differences at a few points near the start.
"""

from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.finite_differences import NOISE_POINTS, NOISE_SPACING, largest_ratio, noise_of
from kennfeld.importers.fmu.evaluation_code import DIFFERENCES, DIRECTIONAL, SKIPPED

_POINTS = 4  # near the start
_SPREAD = 0.2  # of their distances, relative to the orders of magnitude
_TOLERANCE = 1e-4  # of directional derivatives


def noise_near(evaluate: Callable[[Float], Float], point: Float, magnitudes: Float) -> float:
    """Estimate the noise of a function relative to its results, from points on a line.

    Args:
        evaluate: Float[arguments] -> Float[results].
        point: the start, Float[arguments]; the first one is the time.
        magnitudes: orders of magnitude of the arguments, Float[arguments].
    """
    direction = NOISE_SPACING * magnitudes
    direction[0] = 0.0  # time
    table = np.array([evaluate(point + number * direction) for number in range(NOISE_POINTS)])
    return largest_ratio(noise_of(table), np.max(np.abs(table), axis=0))


def agreeing_columns(
    evaluate: Callable[[Float], tuple[Float, Float]], kinds: Float, point: Float, magnitudes: Float
) -> Sequence[int]:
    """Find the arguments whose directional derivatives agree with differences at all points that can be evaluated.

    Args:
        evaluate: returns results, Float[results], and slopes, Float[results, arguments], computed as `kinds` says.
        kinds: how the slopes along each argument are computed, [arguments]; restored afterwards.
        point: the start, Float[arguments].
        magnitudes: orders of magnitude of the arguments, Float[arguments].
    """
    own = kinds.copy()
    agree, compared = own != SKIPPED, np.zeros(len(own), dtype=bool)
    for number in range(_POINTS):
        spread = np.sin(number * np.arange(1.0, len(point) + 1.0))  # 0 at the first point; no two arguments in step
        near = point + _SPREAD * spread * magnitudes * (own != SKIPPED)
        slopes = []
        for kind in (DIFFERENCES, DIRECTIONAL):
            kinds[:] = np.where(own == SKIPPED, SKIPPED, kind)
            slopes.append(evaluate(near)[1])
        differences, directional = slopes
        kinds[:] = own
        if not np.all(np.isfinite(differences)):
            continue  # outside of the range of the model
        # slopes times magnitudes are changes of the results, which columns with different units share as a scale
        scale = np.max(np.abs(differences) * magnitudes, axis=1, keepdims=True)
        distance = np.abs(directional - differences) * magnitudes
        # a slope below 1e-3 of its row is compared with that, because its difference is mostly rounding error
        close = distance <= _TOLERANCE * np.maximum(np.abs(differences) * magnitudes, 1e-3 * scale)
        agree &= close.all(axis=0)
        # a column that is 0 at all points shows nothing, so that differences stay
        compared |= np.any(differences != 0, axis=0)
    return [int(column) for column in np.flatnonzero(agree & compared)]
