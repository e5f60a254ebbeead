"""Addresses of arrays for compiled code, with checks of type, layout and size.

Compiled code reads memory at an address without knowing its contents: numbers of another type would be read as doubles,
and a short array would be read beyond its end. All pointers are therefore taken here. Nothing is converted: a converted
copy would be freed before the code runs, and values written to it would be lost. Arrays are converted where the objects
that hold them are made.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError

DOUBLE = np.dtype(np.float64)
INT32 = np.dtype(np.int32)
INT64 = np.dtype(np.int64)
UINT32 = np.dtype(np.uint32)
POINTER = np.dtype(np.uintp)

Array = NDArray[Any]


def address(array: Array, size: int = 0, kind: "np.dtype[Any]" = DOUBLE) -> int:
    """Check an array for compiled code, and return the address of its first element.

    Args:
        array: elements of the type `kind` in native byte order, contiguous in C order, aligned.
        size: minimum number of elements that the code reads or writes.
        kind: element type that the code expects.

    Raises:
        ArgumentError: the array has another type or layout, or fewer elements.
    """
    flags = array.flags
    if array.dtype != kind or not flags.c_contiguous or not flags.aligned or array.size < size:
        needed = f"{f'at least {size}' if size else 'an array of'} contiguous {kind}"
        raise ArgumentError(f"compiled code needs {needed}, got {_described(array)}")
    return array.ctypes.data


def readable(array: Array, kind: "np.dtype[Any]" = DOUBLE) -> Array:
    """Return an array that `address` accepts: the given one if it does, else a copy; for memory that is only read."""
    flags = array.flags
    if array.dtype == kind and flags.c_contiguous and flags.aligned:
        return array
    return np.require(array, kind, ["C", "A"])


def strided(matrix: Float, size: int = 0) -> tuple[int, int]:
    """Check a matrix of doubles, [rows, columns], and return its address and the doubles from one row to the next.

    Args:
        matrix: doubles whose rows may lie apart, each contiguous; see `is_strided`.
        size: minimum number of rows and columns that the code reads or writes.

    Raises:
        ArgumentError: the array has another type or layout, or fewer rows or columns.
    """
    if not is_strided(matrix) or min(matrix.shape) < size:
        needed = f"a matrix of float64, at least {size} x {size}, with contiguous rows"
        raise ArgumentError(f"compiled code needs {needed}, got {_described(matrix)}")
    return matrix.ctypes.data, matrix.strides[0] // matrix.itemsize


def is_strided(matrix: Float) -> bool:
    """Return True if `strided` accepts this matrix."""
    if matrix.dtype != DOUBLE or matrix.ndim != 2 or not matrix.flags.aligned:
        return False
    # along an axis of one element or none, NumPy may state any stride; the code counts rows in whole doubles
    between, within = matrix.strides
    return (within == matrix.itemsize or matrix.shape[1] <= 1) and between % matrix.itemsize == 0


def _described(array: Array) -> str:
    flags = array.flags
    layout = "contiguous" if flags.c_contiguous else "not contiguous"
    order = "" if array.dtype.isnative else " in foreign byte order"
    return f"{array.dtype}{order} of shape {array.shape}, {layout}{'' if flags.aligned else ', not aligned'}"
