"""Scatter plots and histograms, of a size that can be drawn."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int

MAX_POINTS = 6000
MAX_LIT = 1500  # selected samples that are drawn in addition
BINS = 60


def thin(count: int, values: Float, most: int = MAX_POINTS) -> Int:
    """Choose samples to draw, Int[samples]: evenly spread, and those with the largest magnitudes.

    Args:
        count: number of samples.
        values: Float[count]; the outliers of a plot are those of the errors.
        most: number of samples to keep.
    """
    if count <= most:
        return np.arange(count)
    spread = np.linspace(0, count - 1, most - most // 10).astype(np.int64)
    size = np.where(np.isfinite(values), np.abs(values), -1.0)
    # a tenth of the points: an even choice alone would miss single wild values
    outliers = np.argpartition(size, -most // 10)[-most // 10 :]
    return np.union1d(spread, outliers)


def drawn_samples(errors: Float, shown: Bool | None = None, lit: Bool | None = None, most: int = MAX_POINTS) -> Int:
    """Choose samples to draw, Int[samples], as `thin` does, and enough of those that are lit to see where they are.

    Args:
        errors: Float[samples]; the largest are drawn.
        shown: the samples that may be drawn, Bool[samples]; None for all.
        lit: Bool[samples].
        most: number of samples to keep, besides lit ones.
    """
    allowed = np.arange(errors.size) if shown is None else np.flatnonzero(shown)
    drawn = allowed[thin(allowed.size, errors[allowed], most)]
    if lit is None:
        return drawn
    more = allowed[lit[allowed]]
    return np.union1d(drawn, more[thin(more.size, errors[more], MAX_LIT)])


def common_bins(parts: Sequence[Float], bins: int = BINS) -> Float:
    """Choose bin edges Float[bins + 1] for sets of values, symmetric about 0; outliers count in the end bins."""
    known = np.concatenate([part[np.isfinite(part)] for part in parts]) if parts else np.zeros(0)
    if not known.size:
        return np.linspace(-1.0, 1.0, bins + 1)
    # the quantile is 0 if nearly all errors are, at a limit for instance
    reach = float(np.quantile(np.abs(known), 0.998)) or float(np.abs(known).max()) or 1.0
    return np.linspace(-reach, reach, bins + 1)


def beyond(values: Float, edges: Float) -> Int:
    """Count values Float[samples] below the first and above the last edge, which are in the end bins; Int[2]."""
    return np.array([np.count_nonzero(values < edges[0]), np.count_nonzero(values > edges[-1])], dtype=np.int64)


def histogram(values: Float, edges: Float) -> Int:
    """Count values Float[samples] by bin, Int[bins]; those beyond the ends count in the first and the last bin."""
    known = values[np.isfinite(values)]
    counts, _ = np.histogram(np.clip(known, edges[0], edges[-1]), edges)
    return counts.astype(np.int64)
