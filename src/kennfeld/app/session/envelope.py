"""Minimum and maximum of a channel by pixel, fast enough to follow a zoom."""

from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Float, Int

BLOCK = 64  # samples whose extremes are computed in advance


class PixelEnvelope:
    """The extremes of a channel, so that a drawn line loses no peak.

    Args:
        values: Float[samples]; NaN is a gap.

    >>> envelope = PixelEnvelope(np.array([1.0, 5.0, 2.0, 3.0]))
    >>> envelope.extremes(np.array([0, 2, 4]))
    (array([1., 2.]), array([5., 3.]))
    """

    def __init__(self, values: Float) -> None:
        self.values = values

    @cached_property
    def _blocks(self) -> tuple[Float, Float]:
        """Minimum and maximum of each block, of which a zoomed-out pixel spans many; zooming in does without them."""
        starts = np.arange(0, self.values.size, BLOCK)
        return np.fmin.reduceat(self.values, starts), np.fmax.reduceat(self.values, starts)

    def extremes(self, edges: Int) -> tuple[Float, Float]:
        """Find the minimum and the maximum of the samples from each edge up to the next.

        Args:
            edges: sample numbers, not decreasing; Int[pixels + 1]. With many samples a pixel they are rounded to blocks
                of 64, which is less than a pixel.

        Returns:
            Float[pixels] each; NaN for a pixel without a sample that is a number.
        """
        coarse = bool(edges[-1] - edges[0] >= max(2 * BLOCK * (edges.size - 1), 1))
        lowest, highest = self._blocks if coarse else (self.values, self.values)
        if coarse:
            # the last edge up, so that the last samples are not lost
            edges = np.append(edges[:-1] // BLOCK, -(-edges[-1] // BLOCK))
        starts, ends = edges[:-1], edges[1:]
        low, high = np.full(starts.size, np.nan), np.full(starts.size, np.nan)
        # reduceat returns the value at its start for an empty range, so that such pixels stay NaN
        used = np.flatnonzero(ends > starts)
        if used.size:
            stop = ends[used[-1]]
            low[used] = np.fmin.reduceat(lowest[:stop], starts[used])
            high[used] = np.fmax.reduceat(highest[:stop], starts[used])
        return low, high
