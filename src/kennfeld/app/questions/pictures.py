"""Small pictures of tables."""

import numpy as np

from kennfeld.base.arrays import Float

MAX_POINTS = 12  # values along an axis


def thumbnail(values: Float, most: int = MAX_POINTS) -> list[list[float]]:
    """Return a coarse picture of a curve or map, a row for each x; empty for other kinds."""
    if values.ndim not in (1, 2):
        return []
    picked = [np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(int)) for n in values.shape]
    few = values[np.ix_(*picked)].reshape(picked[0].size, -1)
    rows: list[list[float]] = few.astype(np.float32).tolist()
    return rows
