"""Variance of the errors of a criterion as a power of the weights of its samples: v w^-g.

With g = 1, weights state the accuracy of the samples; with g = 0, all samples are equally accurate, and weights merely
state their importance. The power is that of the largest likelihood of normal errors (A. C. Harvey: Estimating
regression models with multiplicative heteroscedasticity, Econometrica 44, 1976),

    log L(g) = g / 2 sum log w - n / 2 log sum w^g r^2

or the least one that the data do not distinguish from it: with it, the values have the largest deviations.
"""

from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float

EXPONENTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # g
INDISTINCT = 0.5  # difference of log-likelihoods at one standard deviation of g


class Variance(NamedTuple):
    """The variance v w^-g of an error with the weight w."""

    unit: float  # v
    exponent: float = 1.0  # g

    def at(self, weight: float) -> float:
        """Return the variance of a sample."""
        return float(self.unit * weight**-self.exponent)


def sum_squares(errors: Float, weights: Float) -> Float:
    """Sum w^g r^2 over errors r and weights w, Float[samples] each, for each exponent; Float[exponents].

    >>> sum_squares(np.array([1.0, 2.0]), np.array([1.0, 16.0])).tolist()
    [5.0, 9.0, 17.0, 33.0, 65.0]
    """
    squares = np.square(errors)
    return np.array([weights**exponent @ squares for exponent in EXPONENTS])


def likely_exponent(squares: Float, logarithms: float, freedom: float) -> int:
    """Find the number of the least exponent that the errors do not distinguish from the most likely one.

    Args:
        squares: sum w^g r^2 for each exponent, Float[exponents].
        logarithms: sum log w.
        freedom: number of independent errors, the n of both sums.

    >>> weights, errors = np.array([0.01, 1.0, 100.0] * 20), np.array([1.0, -1.0] * 30)
    >>> EXPONENTS[likely_exponent(sum_squares(errors, weights), float(np.log(weights).sum()), 60)]
    0.0
    >>> EXPONENTS[likely_exponent(sum_squares(errors / np.sqrt(weights), weights), float(np.log(weights).sum()), 60)]
    1.0
    """
    if not np.all(squares > 0) or not np.all(np.isfinite(squares)):
        return len(EXPONENTS) - 1
    likelihood = np.array(EXPONENTS) / 2 * logarithms - freedom / 2 * np.log(squares)
    # the first one within reach of the maximum, since exponents rise
    return int(np.argmax(likelihood >= likelihood.max() - INDISTINCT))
