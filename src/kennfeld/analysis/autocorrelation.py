"""How long errors remember: their correlation with themselves some time later."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.optimize.trust.persistence import inflation, lagged_products

__all__ = ["Autocorrelation", "autocorrelation"]

MOST_LAGS = 1000


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """Correlation of an error with itself `lags` later, in s, or in samples where the time steps are uneven.

    Errors without memory stay within plus and minus `band` at 19 of 20 lags. `independent` is how many independent
    samples would tell as much about a mean; see `inflation`.
    """

    lags: Float  # Float[lags], from 0
    values: Float  # Float[lags], from 1
    band: float
    independent: float
    unit: str


def autocorrelation(
    error: Float, starts: Sequence[int] | Int = (0,), step: float | None = None, most: int = MOST_LAGS
) -> Autocorrelation | None:
    """The autocorrelation of an error that is sampled evenly; None where there is too little to tell.

        r(k) = [sum e(i) e(i+k) / pairs(k)] / [sum e(i)^2 / pairs(0)]

    over all pairs within a piece of which both are known, the mean taken off before. Blockwise by FFT, exactly.

    Args:
        error: shape (samples,), NaN where unknown.
        starts: the first sample of each piece; no pair crosses it.
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
