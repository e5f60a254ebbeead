"""Autocorrelation of the errors of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.optimize.trust.persistence import inflation, lagged_products

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
    edges = [*(int(start) for start in starts), error.size]
    known = np.isfinite(error)
    count = int(known.sum())
    longest = max((b - a for a, b in pairwise(edges)), default=0)
    lags = min(most, longest // 4)
    if lags < 1 or count < 8:
        return None
    centred = np.where(known, error, 0.0)
    centred[known] -= centred[known].mean()
    sums, pairs = np.zeros((2, lags + 1))
    for a, b in pairwise(edges):
        sums += lagged_products(centred[a:b], lags)
        if count == error.size:
            pairs += np.maximum(b - a - np.arange(lags + 1), 0)
        else:
            pairs += np.round(lagged_products(known[a:b].astype(np.float64), lags))
    if not (np.isfinite(sums).all() and sums[0] > 0):
        return None
    covariance = np.divide(sums, pairs, out=np.zeros(lags + 1), where=pairs > 0)
    values = covariance / covariance[0]
    unit = "samples" if step is None else "s"
    steps = np.arange(lags + 1, dtype=np.float64) * (step or 1.0)
    return Autocorrelation(steps, values, 1.96 / np.sqrt(count), count / inflation(sums, pairs), unit)
