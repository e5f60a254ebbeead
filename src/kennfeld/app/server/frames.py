"""Binary frames of the socket: a JSON head, then arrays of 32-bit floats.

    4 bytes         length of the head, little-endian
    head            JSON in UTF-8, padded with spaces to a multiple of 4 bytes
    4 bytes each    the arrays, one after another; `head["arrays"]` lists name and number of values of each

A frame holds numbers that are drawn. Numbers that are edited travel in the head, as JSON, in full precision.
"""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def pack(head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return a frame.

    Args:
        head: anything that JSON can hold, without non-finite numbers.
        arrays: by name; NaN is a gap in a line.

    >>> frame = pack({"id": 1}, {"x": np.array([1.0, 2.0])})
    >>> len(frame) % 4, frame[4:31].decode()
    (0, '{"id":1,"arrays":[["x",2]]}')
    """
    counts = [[name, int(np.size(values))] for name, values in arrays.items()]
    text = json.dumps({**head, "arrays": counts}, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    # numbers beyond the range of 32 bits become infinite
    with np.errstate(over="ignore"):
        parts = [np.asarray(values, dtype="<f4").tobytes() for values in arrays.values()]
    return b"".join([struct.pack("<I", len(text)), text, *parts])
