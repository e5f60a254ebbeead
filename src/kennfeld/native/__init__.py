"""Compilation of graphs to machine code: simulation, cost, gradient, Gauss-Newton matrix and linear algebra."""

from typing import TYPE_CHECKING

from kennfeld.base.lazy_names import lazy_names
from kennfeld.domain.criteria import Loss
from kennfeld.graph.value_layout import ValueLayout

if TYPE_CHECKING:
    from kennfeld.native.accumulator import Accumulator, Normal
    from kennfeld.native.cholesky import Cholesky, Factor
    from kennfeld.native.gram import Gram
    from kennfeld.native.kernel import Kernel
    from kennfeld.native.sample_loop import Output
    from kennfeld.native.samples import Piece, Samples
    from kennfeld.native.simulator import Simulator

__all__ = [
    "Accumulator",
    "Cholesky",
    "Factor",
    "Gram",
    "Kernel",
    "Loss",
    "Normal",
    "Output",
    "Piece",
    "Samples",
    "Simulator",
    "ValueLayout",
]

__getattr__ = lazy_names(
    __name__,
    {
        "accumulator": "Accumulator Normal",
        "cholesky": "Cholesky Factor",
        "gram": "Gram",
        "kernel": "Kernel",
        "sample_loop": "Output",
        "samples": "Piece Samples",
        "simulator": "Simulator",
    },
)
