"""Long data made short enough to draw, without losing what can be seen."""

from collections.abc import Sequence

import numpy as np

from kennfeld.arrays import Float, Int

__all__ = ["Envelope", "histogram", "some"]


class Envelope:
    """Groups neighbouring samples so that a trace has at most `most` points: the least and the greatest of each group.

    >>> groups = Envelope(8, most=4)
    >>> groups.trace(np.array([0.0, 5, 1, 2, 3, 3, 9, -1]))
    array([ 0.,  5., -1.,  9.])
    """

    def __init__(self, count: int, most: int) -> None:
        self.whole = count <= most
        size = 1 if self.whole else -(-count // max(most // 2, 1))
        self.firsts = np.arange(0, count, size)

    def trace(self, values: Float) -> Float:
        """The values themselves, or least and greatest of each group in turn; NaN where a group has none."""
        if self.whole:
            return values
        pair: Float = np.stack([np.fmin.reduceat(values, self.firsts), np.fmax.reduceat(values, self.firsts)], axis=1)
        return pair.ravel()

    def places(self, x: Float) -> Float:
        """Where the points of a trace lie: the first sample of each group, twice."""
        return x if self.whole else np.repeat(x[self.firsts], 2)


def some(count: int, most: int, always: Sequence[int] = ()) -> Int:
    """At most so many of `count` samples, drawn at random but the same each time, in order; `always` are among them."""
    if count <= most:
        return np.arange(count)
    drawn = np.random.default_rng(0).choice(count, most, replace=False)
    return np.unique(np.concatenate([drawn, np.asarray(always, dtype=np.int64)]))


def histogram(values: Float, ends: tuple[float, float], bins: int) -> Int:
    """How many values lie in each of the even bins between `ends`; those beyond count in the first and the last."""
    inside = np.clip(values[np.isfinite(values)], *ends)
    return np.histogram(inside, bins, ends)[0].astype(np.int64)
