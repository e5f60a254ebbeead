"""Sparse matrices of MATLAB files, written out."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.matlab.tree import DamageError

__all__ = ["MOST_DENSE", "dense"]

MOST_DENSE = 4_000_000  # values of all sparse matrices of a file, their zeros included


def dense(
    shape: tuple[int, ...], rows: NDArray[Any], starts: NDArray[Any], values: NDArray[Any]
) -> NDArray[np.float64]:
    """The matrix of which `starts` says for each column, and for the end, where its `rows` and `values` begin.

    `DamageError` where they do not fit. There may be more rows and values than are in use.

    >>> dense((2, 2), np.array([0, 1]), np.array([0, 0, 2]), np.array([3.0, 4.0])).tolist()
    [[0.0, 3.0], [0.0, 4.0]]
    """
    if len(shape) != 2 or any(given.dtype.kind not in "ui" for given in (rows, starts)):
        raise DamageError("a sparse matrix is of an unknown form")
    rows, starts = rows.astype(np.int64), starts.astype(np.int64)
    if starts.size != shape[1] + 1 or starts[0] != 0 or np.any(np.diff(starts) < 0):
        raise DamageError("the columns of a sparse matrix make no sense")
    used = int(starts[-1])
    if used > min(rows.size, values.size) or np.any((rows[:used] < 0) | (rows[:used] >= shape[0])):
        raise DamageError("the rows of a sparse matrix make no sense")
    full = np.zeros(shape)
    full[rows[:used], np.repeat(np.arange(shape[1]), np.diff(starts))] = values[:used]
    return full
