"""Array types shared by the whole house; shapes are named in comments, `Float[samples]`."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ArrayLike", "Bool", "Float", "Int", "readonly"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]


def readonly(values: ArrayLike) -> Float:
    """A float64 array that nobody can write to; copies only what is not already one."""
    array = np.asarray(values, dtype=np.float64)
    if array.flags.writeable:
        array = array.copy() if array is values or array.base is not None else array
        array.setflags(write=False)
    return array
