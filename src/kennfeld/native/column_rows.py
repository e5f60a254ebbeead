"""Rows of the Jacobian for columns that the kernel does not know, carried over the samples of a tape.

A column enters a step as one of the kernel's own does, with the slopes of that column times a number for each sample.
What the states make of it follows from the tape, see `jacobian_sweeps`.
"""

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float, aligned_zeros
from kennfeld.native.addresses import INT32, INT64, address
from kennfeld.native.kernel import Kernel
from kennfeld.native.tape_reader import VECTOR
from kennfeld.native.workspace import Workspace


class ColumnRows:
    """The sensitivities of the states by further columns.

    Args:
        kernel: of the tape.
        columns: number of columns.
    """

    def __init__(self, kernel: Kernel, columns: int) -> None:
        self._kernel, self._columns = kernel, columns
        self._width = -(-columns // VECTOR) * VECTOR
        n = kernel.pattern.carried
        self._depth = sum(kernel.pattern.latencies)
        # a vector at the end of the last row may reach beyond it
        self._sensitivities = aligned_zeros((self._depth + 1) * self._width)
        self._next, self._turn = aligned_zeros((n + 1) * self._width), np.zeros(max(n, 1), dtype=np.int64)

    def begin(self, first: Float) -> None:
        """Start a piece; `first` are the slopes of the first values of the states, Float[carried, columns]."""
        self._sensitivities[:] = 0.0
        self._turn[:] = 0
        repeated = np.repeat(first, self._kernel.pattern.latencies, axis=0)
        self._sensitivities[: self._depth * self._width].reshape(-1, self._width)[:, : self._columns] = repeated

    def over(self, space: Workspace, first: int, index: NDArray[np.int32], slope: Float) -> Float:
        """Return the rows of samples of the tape, times the root of the weights, and carry the sensitivities over them.

        Args:
            space: holds the tape.
            first: the first of the samples on the tape; they follow each other.
            index: column of each entry, Int32[samples, entries].
            slope: slopes of outputs, then of states, Float[samples, entries, rows].

        Returns:
            Float[samples * outputs, columns].
        """
        length, room = index.shape
        outputs, last = len(self._kernel.outputs), first + length
        rows = aligned_zeros(length * outputs * self._width + VECTOR)
        count = np.full(length, room, dtype=np.int32)
        tape = [address(array[first:last]) for array in (space.weight, space.c, space.a)]
        carried = (address(self._sensitivities), self._width, address(self._turn, kind=INT64), address(self._next))
        entries = (address(index, kind=INT32), address(slope), address(count, kind=INT32), room)
        self._kernel.sweeps.rows(length, *tape, *carried, *entries, address(rows), self._width)
        return rows[: length * outputs * self._width].reshape(length * outputs, self._width)[:, : self._columns]
