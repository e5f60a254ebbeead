"""Long columns of numbers in the little room of a page: whole steps, differences, bytes by significance, deflate.

A browser decodes them by `web/src/report/coded-numbers.ts`.
"""

import base64
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float, Int

MAX_STEPS = 1 << 30  # of the range of a column, so that differences fit into 32 bits
LEVEL = 1  # of compression: the bytes of noise cannot be compressed, and others can at once


def code_numbers(values: Float, step: float, order: int = 1) -> Mapping[str, Any]:
    """Code numbers as text, each within half a step; NaN stays NaN.

    Args:
        values: Float[samples]; infinite values are stored as NaN.
        step: resolution in the unit of the values, >= 0; 0 suits constant columns. It grows if the range has more than
            `MAX_STEPS` steps.
        order: 1 stores differences, 2 differences of differences, which suits time stamps.

    >>> decode_numbers(code_numbers(np.array([1.0, np.nan, 2.52, -3.0]), 0.1))
    array([ 1. ,  nan,  2.5, -3. ])
    """
    known = np.isfinite(values)
    first = float(values[known].min()) if known.any() else 0.0
    last = float(values[known].max()) if known.any() else 0.0
    # divided first: the range of doubles may exceed the largest double
    step = max(step, last / MAX_STEPS - first / MAX_STEPS, np.finfo(float).tiny)
    steps = np.zeros(values.size, dtype=np.int64)
    # halves, since the range of doubles may exceed the largest double
    steps[known] = np.round((values[known] / 2 - first / 2) / (step / 2))
    steps = steps[np.maximum.accumulate(np.where(known, np.arange(values.size), 0))]  # a gap costs no differences
    differences = steps
    for _ in range(order):
        differences = np.diff(differences, prepend=0)
    planes = _planes(differences)
    gaps = {} if known.all() else {"gaps": _packed(np.packbits(~known, bitorder="little"))}
    return {
        "count": values.size,
        "first": first,
        "step": step,
        "order": order,
        "planes": len(planes),
        "data": _packed(planes),
        **gaps,
    }


def _planes(differences: Int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return the bytes of the differences, those of least significance first; small ones of any sign have few bytes."""
    # 0, -1, 1, -2, 2, ... -> 0, 1, 2, 3, 4, ...: two's complement of small negative numbers has all bytes set
    zigzag = (np.abs(differences) * 2 - (differences < 0)).astype(np.uint64)
    most = int(zigzag.max(initial=0))
    count = max(1, -(-most.bit_length() // 8))
    # plane by plane, since the upper bytes are nearly all 0, which deflate then finds in a row
    return np.array([(zigzag >> np.uint64(8 * plane)).astype(np.uint8) for plane in range(count)], dtype=np.uint8)


def _packed(content: np.ndarray[Any, np.dtype[np.uint8]]) -> str:
    return base64.b64encode(zlib.compress(content.tobytes(), LEVEL)).decode("ascii")


def decode_numbers(coded: Mapping[str, Any]) -> Float:
    """Decode the numbers that `code_numbers` stored, Float[samples]."""
    count, planes = coded["count"], coded["planes"]
    raw = np.frombuffer(zlib.decompress(base64.b64decode(coded["data"])), np.uint8).reshape(planes, count)
    zigzag = sum((raw[plane].astype(np.int64) << (8 * plane) for plane in range(planes)), np.zeros(count, np.int64))
    steps = np.where(zigzag % 2 == 1, -(zigzag + 1) // 2, zigzag // 2)
    for _ in range(coded["order"]):
        steps = np.cumsum(steps)
    values: Float = coded["first"] + coded["step"] * steps
    if "gaps" in coded:
        bits = np.frombuffer(zlib.decompress(base64.b64decode(coded["gaps"])), np.uint8)
        values[np.unpackbits(bits, count=count, bitorder="little").astype(bool)] = np.nan
    return values
