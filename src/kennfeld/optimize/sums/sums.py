"""The seam between the search and the evaluation of a model: the sums over all samples that a calibration needs.

`native.Accumulator` is the implementation. Another one may evaluate an external model, or distribute the samples: it is
given to `CompiledProblem`, and everything above knows this protocol only.
"""

from collections.abc import Callable
from typing import Protocol

from kennfeld.base.arrays import Float, Int
from kennfeld.native.kernel import Kernel
from kennfeld.native.samples import Chunk, Samples
from kennfeld.native.symmetric import SymmetricMatrix
from kennfeld.native.workspace import Workspace

# of a share of the samples: its number, the workspace with the tape of a chunk, the chunk, and if a piece begins there
TapeVisitor = Callable[[int, Workspace, Chunk, bool], None]


class NormalEquations(Protocol):
    """Half the gradient J'Wr and the Gauss-Newton matrix J'WJ of the sum of losses; valid until the next call."""

    @property
    def gradient(self) -> Float:
        """J'Wr, Float[free]."""

    @property
    def matrix(self) -> SymmetricMatrix:
        """J'WJ, [free, free]."""


class Sums(Protocol):
    """Cost and derivatives of a model, summed over samples.

    `values` are the free values, followed by the fixed ones. With r the residuals and W the weights of the scored
    samples, J is the Jacobian of r with respect to the free values.
    """

    widths: Float  # Float[axes]: standard deviations of the smoothing of lookups, in the unit of the axis

    @property
    def stateful(self) -> bool:
        """True if samples that are not scored affect later ones, through states of the model."""

    def prepare(self) -> None:
        """Do before the first iteration what `normal` would otherwise do in it, such as compiling."""

    def cost(self, values: Float) -> float:
        """Return the sum of weighted losses at Float[values]; not finite if the model's output is not."""

    def normal(self, values: Float) -> NormalEquations:
        """Return half the gradient, Float[free], and the Gauss-Newton matrix [free, free]."""

    def residual(self, values: Float) -> Float:
        """Return W^1/2 r, Float[visits * outputs]; 0 if not scored."""

    def rows(self, values: Float) -> tuple[Float, Float]:
        """Return W^1/2 r, Float[visits * outputs], and W^1/2 J, Float[visits * outputs, free]; 0 if not scored."""

    def rows_at(self, values: Float, visits: Int) -> Float:
        """Return the rows of the Jacobian at increasing visits as in `rows`, Float[visits, outputs, free]."""

    def squares(self, values: Float, groups: Int, count: int) -> Float:
        """Sum the squares of the rows of the Jacobian over groups of visits, Float[count, free].

        `groups` assigns each visit to a group from 0 to `count` - 1, or to none by -1.
        """

    def touched(self, values: Float, owners: Int | None = None) -> Int:
        """Count for each free value the scored samples whose step depends on it, Int[free].

        `owners` assigns visits to scored ones, by non-decreasing numbers, -1 for none: a scored sample then counts once
        for all samples assigned to it.
        """

    def each_tape(self, values: Float, work: TapeVisitor) -> None:
        """Linearise all samples and call `work` for each chunk; see `Accumulator.each_tape`."""


SumsFactory = Callable[[Kernel, Samples], Sums]
