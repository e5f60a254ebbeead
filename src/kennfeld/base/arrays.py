"""Array types of the whole package; comments and docstrings state shapes, `Float[samples]`."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "ArrayLike",
    "Bool",
    "Complex",
    "Float",
    "Int",
    "Sparse",
    "aligned_zeros",
    "ignore_floating_errors",
    "readonly",
    "runs_of",
]

LINE = 8  # doubles in a cache line

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]
Complex = NDArray[np.complex128]
Sparse = Any  # scipy.sparse.csr_array of float64; scipy has no type annotations


def readonly(values: ArrayLike) -> Float:
    """Return a float64 array of the same shape that nobody can write to: the given one if it is such, else a copy."""
    array = np.asarray(values, dtype=np.float64)
    if array.flags.writeable:
        # the array of the caller stays writable
        if isinstance(values, np.ndarray) and np.may_share_memory(array, values):
            array = array.copy()
        array.setflags(write=False)
    return array


def aligned_zeros(size: int) -> Float:
    """Allocate zeros, Float[size], that begin on a cache line, where loads of whole vectors are fastest."""
    room = np.zeros(size + LINE)
    skip = (-room.ctypes.data // room.itemsize) % LINE
    return room[skip : skip + size]


def runs_of(marked: Bool) -> Int:
    """Return the first element of each run of marked ones, and the one behind its last, Int[runs, 2].

    >>> runs_of(np.array([True, False, True, True])).tolist()
    [[0, 1], [2, 4]]
    """
    return np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]))).reshape(-1, 2)


def ignore_floating_errors() -> np.errstate:
    """Return a context for computations whose results are checked: what is not finite there needs no warning."""
    return np.errstate(over="ignore", invalid="ignore", divide="ignore")
