"""Derivatives of the criteria at single samples by every value of the tables, by the compiled derivative."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.call_columns import read_calls, table_values
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native.accumulator import Accumulator
from kennfeld.native.kernel import Kernel
from kennfeld.native.sample_loop import Output
from kennfeld.native.samples import Piece, Samples
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.sums.call_sums import CalledFunctions
from kennfeld.optimize.sums.sums import Sums
from kennfeld.preprocessing.binding import BoundDataset

MEMORY = 4096  # samples over which sensitivities are carried; those before a sample that still act on it


class SampleSlopes:
    """The slopes of all criteria by the values of all tables, free or not; construction compiles them.

    Args:
        problem: the problem.
        parameters: values with the breakpoints that count; other values need no other kernel.
    """

    def __init__(self, problem: Problem, parameters: ParameterSet) -> None:
        carried = {surrogate.name for surrogate in problem.model.surrogates}
        self.tables = tuple(name for name in problem.graph.parameters if name not in carried)
        lowered = lower_lookups(problem.graph, parameters, ())
        values = [value for name in self.tables for value in table_values(parameters[name])]
        called = read_calls(lowered.graph, self.tables, values)
        outputs = [Output(called.graph.names[name]) for name in problem.differences]
        self._kernel = Kernel(replace(lowered, graph=called.graph), outputs, parameters, self.tables)
        self._columns = tuple(called.inputs)
        self._functions = CalledFunctions(called, lowered, parameters, self._kernel.values) if self._columns else None
        self._stateful = bool(self._kernel.line.states) or called.trajectories is not None

    def at(self, bound: BoundDataset, sample: int, parameters: ParameterSet) -> Mapping[str, Float]:
        """Return by table d(criterion) / d(value), Float[criteria, ...] with the shape of the table behind.

        With states, earlier samples of the piece act as well; those more than `MEMORY` samples back are neglected.

        Args:
            bound: a dataset bound to the model.
            sample: number of one of its kept samples.
            parameters: the present values.
        """
        count = min(sample - bound.start_of(sample) + 1, MEMORY) if self._stateful else 1
        columns, outputs = dict(bound.part(sample + 1 - count, sample + 1)), len(self._kernel.outputs)
        columns |= {name: np.zeros(count) for name in self._columns}
        targets = np.full((outputs, count), np.nan)
        # only the last sample is scored; its slope does not depend on the target
        targets[:, -1] = 0.0
        samples = Samples(
            [columns[n] for n in self._kernel.layout.inputs], targets, [Piece(0, count, np.ones(outputs))]
        )
        values, sums_of = self._kernel.values, partial(Accumulator, sparse=False)
        if self._functions is None:
            sums: Sums = sums_of(self._kernel, samples)
        else:
            sums = self._functions.sums(sums_of, self._kernel, samples)
        [rows] = sums.rows_at(values.pack(parameters), np.array([count - 1]))
        slopes = {name: np.zeros((outputs, *parameters[name].values.shape)) for name in self.tables}
        for name, at in values.offsets.items():
            if at < values.free:
                slopes[name] = rows[:, at : at + parameters[name].size].reshape(slopes[name].shape)
        return slopes
