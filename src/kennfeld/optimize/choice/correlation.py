"""How many of the samples are independent: errors in time resemble their neighbours.

A misfit of the model lasts longer than a sample. Counting every sample as new evidence would let tables follow it.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.data.binding import Bound
from kennfeld.optimize.problem import Problem
from kennfeld.parameters import ParameterSet

__all__ = ["correlation_time", "independent_samples"]


def correlation_time(pieces: Sequence[Float]) -> float:
    """1 + 2 sum of the autocorrelation, in samples, up to the lag where that is largest; NaN is not counted.

    The variance of a mean of n correlated samples is that of n over this many independent ones.

    >>> correlation_time([np.array([1.0, -1.0] * 50)])
    1.0
    >>> bool(correlation_time([np.repeat(np.random.default_rng(0).normal(size=2000), 10)]) > 8)
    True
    """
    longest = max((piece.size for piece in pieces), default=0)
    sums = np.zeros(max(longest, 1))
    for piece in pieces:
        known = np.nan_to_num(piece)
        spectrum = np.fft.rfft(known, 2 * max(piece.size, 1))
        sums[: piece.size] += np.fft.irfft(np.abs(spectrum) ** 2, 2 * max(piece.size, 1))[: piece.size]
    if not sums[0] > 0:
        return 1.0
    shares = sums[1 : longest // 2] / sums[0]
    return float(1 + 2 * np.max(np.cumsum(shares), initial=0.0))


def independent_samples(
    problem: Problem, errors: Callable[[Bound, ParameterSet], Float], parameters: ParameterSet
) -> float:
    """Scored training samples of all criteria; those of data with time over their correlation time.

    `errors` gives those of a bound dataset, of shape (criteria, kept samples).
    """
    return sum(
        _independent(bound, row)
        for bound in problem.training
        for row, criterion in zip(errors(bound, parameters), problem.criteria, strict=True)
        if criterion.weight > 0
    )


def _independent(bound: Bound, errors: Float) -> float:
    count = float(np.isfinite(errors).sum())
    if bound.dataset.time is None or bound.hold is not None:
        return count
    edges = [*bound.starts.tolist(), errors.size]
    return count / correlation_time([errors[a:b] for a, b in pairwise(edges)])
