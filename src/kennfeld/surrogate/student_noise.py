"""Student's distribution of noise, whose tails are wide, beside the normal one."""

import numpy as np

from kennfeld.base.arrays import Float

FREEDOM = 4.0  # degrees of freedom
LOG_CONSTANT = -0.980829253  # log of the density at 0, for a scale of 1: log(3 / 8)
ITERATIONS = 30
TRIMMED = 0.1  # share of the rows at either end that do not count


def student_scale(residual: Float) -> float:
    """Estimate the scale of highest likelihood of residuals Float[rows] about 0, by expectation and maximisation.

    K. L. Lange, R. J. A. Little, J. M. G. Taylor: Robust statistical modeling using the t distribution, 1989.

    >>> round(student_scale(np.array([-1.0, 1.0, -1.0, 1.0])), 6)
    1.0
    """
    square = residual**2
    variance = float(np.median(square)) or float(np.mean(square))
    for _ in range(ITERATIONS if variance > 0 else 0):
        # the weight of each residual, (nu + 1) / (nu + (r / sigma)^2), then the weighted mean of the squares
        variance = float(np.mean((FREEDOM + 1) / (FREEDOM + square / variance) * square))
    return float(np.sqrt(variance))


def student_gain(normal: Float, student: Float) -> float:
    """Compute the log-likelihood per row that Student noise gains over normal noise, a trimmed mean.

    Each has the scale that is likeliest for its own residuals Float[rows]; a few rows at either end do not count.
    """
    deviation, scale = float(np.sqrt(np.mean(normal**2))), student_scale(student)
    if deviation == 0 or scale == 0:
        return 0.0
    ordinary = -0.5 * np.log(2 * np.pi) - np.log(deviation) - 0.5 * (normal / deviation) ** 2
    wide = LOG_CONSTANT - np.log(scale) - 0.5 * (FREEDOM + 1) * np.log1p((student / scale) ** 2 / FREEDOM)
    # trimmed: a single wild value gains so much that it would decide alone
    gain = np.sort(wide - ordinary)
    cut = int(TRIMMED * gain.size)
    return float(gain[cut : gain.size - cut].mean())
