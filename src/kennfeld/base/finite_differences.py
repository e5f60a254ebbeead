"""Derivatives by differences, with steps that suit the noise of a function.

A function that solves equations by iteration is not exact to the last digit. The best step depends on its noise
(More and Wild, SIAM J. Sci. Comput. 33 (2011) 1292).
"""

import math
from typing import Final

import numpy as np

from kennfeld.base.arrays import Float

EPSILON: Final = float(np.finfo(float).eps)
NOISE_SPACING: Final = 1e-7  # relative distance of the points from which noise is estimated
_LEVELS: Final = range(4, 7)  # of the table of differences
NOISE_POINTS: Final = max(_LEVELS) + 1


def difference_step(noise: float) -> float:
    """Return the relative step of central differences that balances noise and curvature.

    >>> round(difference_step(0.0) / (2**-52) ** (1 / 3), 2)
    1.44
    """
    # minimises noise / h + h^2 / 6, the errors of noise and curvature relative to the derivatives
    return min(math.cbrt(3 * max(noise, EPSILON)), 0.05)


def noise_of(table: Float) -> Float:
    """Return the standard deviation of the noise of each result, Float[results].

    Args:
        table: results at evenly spaced points on a short line, Float[NOISE_POINTS, results].

    >>> smooth = np.sin(1 + 1e-7 * np.arange(NOISE_POINTS))[:, None]
    >>> noisy = smooth + 1e-3 * np.array([[1, 0, 0, 1, 0, 1, 1]]).T
    >>> bool(noise_of(smooth)[0] < 1e-15 < 1e-4 < noise_of(noisy)[0])
    True
    """
    differences, estimates = table, []
    for level in range(1, NOISE_POINTS):
        differences = np.diff(differences, axis=0)
        if level in _LEVELS:
            # differences of order k have (2k)! / (k!)^2 times the variance of the noise (More and Wild, 2011)
            weight = math.factorial(level) ** 2 / math.factorial(2 * level)
            estimates.append(np.sqrt(weight * np.mean(differences**2, axis=0)))
    # a level may still contain curvature, which only adds to it
    noise: Float = np.min(estimates, axis=0)
    return noise


def largest_ratio(noise: Float, size: Float) -> float:
    """Return the largest noise relative to the size of its result, both Float[results]; sizes of 0 do not count."""
    ratios = noise[size > 0] / size[size > 0]
    return float(ratios[np.isfinite(ratios)].max(initial=0.0))


def three_point_slope(start: Float, first: Float, second: Float, a: Float | float, b: Float | float) -> Float:
    """Estimate the slope at x of a function from its results at x, x + a and x + b, Float[results] each.

    >>> x, a, b = 1.0, 1e-3, 2e-3
    >>> bool(abs(three_point_slope(*(np.array((x + d) ** 2) for d in (0, a, b)), a, b) - 2 * x) < 1e-12)
    True
    """
    # of the parabola through the three results
    slope: Float = (b * (first - start) / a - a * (second - start) / b) / (b - a)
    return slope
