"""Numbers of Arrow columns. Arrow's own conversions from and to NumPy would load pandas: 40 MB and 0.3 s."""

from typing import Any

import numpy as np

from kennfeld.base.arrays import Float


def numbers_of(column: Any) -> Float:
    """Convert a column to numbers, Float[rows]; missing values are NaN.

    Args:
        column: an Arrow chunked array of a type that can be cast to doubles.
    """
    import pyarrow as pa

    # a cast loads the functions of Arrow, which takes 0.1 s, also where it changes nothing
    doubles = column.type == pa.float64()
    chunks = [view_of(_filled(chunk if doubles else chunk.cast(pa.float64(), safe=False))) for chunk in column.chunks]
    return chunks[0] if len(chunks) == 1 else np.concatenate([np.zeros(0), *chunks])


def view_of(array: Any) -> Float:
    """Return an Arrow array of doubles without missing values as a read-only view, Float[rows]."""
    values = array.buffers()[1]
    return np.frombuffer(values or b"", np.float64, len(array), 8 * array.offset)


def array_of(values: Float) -> Any:
    """Return numbers, Float[any], as an Arrow array of doubles; NaN remains NaN."""
    import pyarrow as pa

    return pa.Array.from_buffers(pa.float64(), values.size, [None, pa.py_buffer(np.ascontiguousarray(values))])


def _filled(array: Any) -> Any:
    import pyarrow as pa

    return array.fill_null(pa.scalar(float("nan"), pa.float64())) if array.null_count else array
