"""Autocorrelation of the errors of a recording."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.trust.persistence import MIN_SAMPLES, LaggedProducts, inflation

MAX_LAGS = 1000


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """Correlation of an error with itself `lags` later, in s, or in samples if the time steps are uneven.

    Uncorrelated errors stay within +- `band` at 19 of 20 lags. `independent` is the number of independent samples that
    determine a mean equally well; see `inflation`.
    """

    lags: Float  # Float[lags], from 0
    values: Float  # Float[lags], from 1
    band: float
    independent: float
    unit: str


def autocorrelation(
    error: Float, starts: Sequence[int] | Int = (0,), step: float | None = None, most: int = MAX_LAGS
) -> Autocorrelation | None:
    """Compute the autocorrelation of an evenly sampled error; None if there are too few samples.

        r(k) = [sum e(i) e(i+k) / pairs(k)] / [sum e(i)^2 / pairs(0)]

    over all pairs of known samples within a piece, after subtraction of the mean. Computed exactly, by blockwise FFT.

    Args:
        error: Float[samples], NaN if unknown.
        starts: first sample of each piece; no pair crosses it.
        step: time between samples in s; None counts lags in samples.
        most: the greatest lag, in samples; at most a quarter of the longest piece is used.

    >>> wave = np.sin(np.arange(4000) * 2 * np.pi / 40)
    >>> autocorrelation(wave, step=0.1).values[[0, 20, 40]].round(2)
    array([ 1., -1.,  1.])
    """
    known = error[np.isfinite(error)]
    lags = count_lags(starts, error.size, most)
    if lags < 1 or not known.size:
        return None
    products = LaggedProducts.of(error, starts, float(known.mean()), lags)
    return of_products(products, known.size, step)


def count_lags(starts: Sequence[int] | Int, samples: int, most: int = MAX_LAGS) -> int:
    """Choose the greatest lag, in samples."""
    edges = [*(int(start) for start in starts), samples]
    return min(most, max((b - a for a, b in pairwise(edges)), default=0) // 4)


def of_products(products: LaggedProducts, count: int, step: float | None) -> Autocorrelation | None:
    """Divide sums of products of `count` known errors by those at lag 0; None if there are too few errors.

    `step` is the time between samples in s; None counts lags in samples.
    """
    sums, pairs = products.sums, products.pairs
    if count < MIN_SAMPLES or not (np.isfinite(sums).all() and sums[0] > 0):
        return None
    # divided by the pairs of each lag: gaps and ends of pieces leave fewer of them
    covariance = np.divide(sums, pairs, out=np.zeros(sums.size), where=pairs > 0)
    values = covariance / covariance[0]
    unit = "samples" if step is None else "s"
    steps = np.arange(sums.size, dtype=np.float64) * (step or 1.0)
    # r(k) of white noise is about normal with the deviation 1 / sqrt(n) (M. S. Bartlett, 1946)
    return Autocorrelation(steps, values, 1.96 / np.sqrt(count), count / inflation(sums, pairs), unit)
