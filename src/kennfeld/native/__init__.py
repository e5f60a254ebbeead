"""Graphs compiled to machine code."""

from kennfeld.native.accumulator import Accumulator, Normal
from kennfeld.native.kernel import Kernel, Values
from kennfeld.native.output import Loss, Output
from kennfeld.native.samples import Piece, Samples
from kennfeld.native.simulator import Simulator
from kennfeld.native.triangular import Cholesky, solve_both, solve_lower, solve_upper

__all__ = [
    "Accumulator",
    "Cholesky",
    "Kernel",
    "Loss",
    "Normal",
    "Output",
    "Piece",
    "Samples",
    "Simulator",
    "Values",
    "solve_both",
    "solve_lower",
    "solve_upper",
]
