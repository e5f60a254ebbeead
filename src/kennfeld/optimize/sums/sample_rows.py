"""`SampleRows`: the inputs of a model at its samples, for simulations of what calls need."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.native.column_table import Order, Row
from kennfeld.native.samples import Samples
from kennfeld.native.simulator import Simulator


@dataclass(frozen=True)
class SampleRows:
    """The inputs of a model at samples, in the order in which they are visited.

    Attributes:
        rows: inputs by name.
        count: number of visited samples.
        starts: visits at which pieces begin.
        order: numbers of the visited samples; None if they are stored in this order.
    """

    rows: Mapping[str, Row]
    count: int
    starts: Sequence[int]
    order: Order | None

    @classmethod
    def of(cls, samples: Samples, inputs: Mapping[str, int], needed: Collection[str]) -> "SampleRows":
        """Return some inputs of samples.

        Without memory, they are copied in the order of the visits, in which lookups are several times as fast.

        Args:
            samples: the samples.
            inputs: the row of each input.
            needed: names of the inputs.
        """
        if samples.order is None:
            starts = [piece.first for piece in samples.pieces]
            rows: dict[str, Row] = {name: samples.inputs.parts[inputs[name]] for name in needed}
            # a simulation begins at the first sample, whether or not a piece does
            return cls(rows, samples.count, starts if starts[:1] == [0] else [0, *starts], None)
        rows = {name: samples.inputs.row(inputs[name], samples.order) for name in needed}
        return cls(rows, samples.count, [0], samples.order)

    def write(self, column: Float, values: Float | float) -> None:
        """Write values of the visits, Float[visits], into a column of all samples; or a number into all of it."""
        column[slice(None) if self.order is None or np.isscalar(values) else self.order] = values

    def simulate(
        self, simulator: Simulator, parameters: ParameterSet, widths: Float | None = None, *, threads: bool = False
    ) -> Float:
        """Return the values of the nodes of a simulation, Float[nodes, samples]."""
        return simulator.over(self.rows, self.count, parameters, self.starts, widths, threads=threads)
