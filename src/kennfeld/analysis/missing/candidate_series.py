"""The series of lags and delays at the samples: what they change at their nodes.

With memory, they are simulated from one chunk of samples to the next, beside the tape. Without, the samples are visited
in another order than that of time, and the series of all samples are stored.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from kennfeld.analysis.missing.families import Series, with_series
from kennfeld.base.arrays import Float, Int
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.native.samples import Chunk
from kennfeld.native.simulator import SimulatedSteps
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.preprocessing.binding import BoundDataset, bind_inputs


class SeriesReader(Protocol):
    """Reads the series of the chunks of one share, one after the other."""

    def read(self, chunk: Chunk, begins: bool) -> Float:
        """Return the series of a chunk, which may be the first of a piece; Float[samples, series]."""


class SeriesSource:
    """The series of some candidates over all samples.

    Args:
        compiled: the problem with probes.
        series: the candidates.
        full: the free and the fixed values, Float[values].
    """

    def __init__(self, compiled: CompiledProblem, series: Sequence[Series], full: Float) -> None:
        problem = compiled.problem
        self._parameters = compiled.values.unpack(full, problem.parameters)
        # the probes are 0 and 1 there, so that the nodes are those of the function
        graph = with_series(problem.graph, series)
        self._simulator = NodeSimulator(graph, self._parameters, [each.name for each in series])
        # bound again, as the function itself may have read no steps
        self._bound = [
            (bound, bind_inputs(bound.dataset, graph, problem.channels, problem.model.step))
            for bound in problem.gathered
        ]
        self._stored: SeriesReader | None = None
        if not goes_along(compiled):
            parts = [_simulated(self._simulator, bound, timed, self._parameters) for bound, timed in self._bound]
            self._stored = _StoredSeries(np.concatenate(parts, axis=1), compiled.sample_numbers())

    def reader(self) -> SeriesReader:
        """Return a reader for one share."""
        if self._stored is not None:
            return self._stored
        steps = [self._simulator.steps(timed, self._parameters) for _, timed in self._bound]
        return _SimulatedSeries(steps, [timed.count for _, timed in self._bound])


def goes_along(compiled: CompiledProblem) -> bool:
    """Return True if series are simulated beside the tape: with memory, unless the function calls others."""
    nodes = compiled.problem.graph.nodes
    return bool(compiled.kernel.pattern.carried) and not any(node.op == "external" for node in nodes)


class _StoredSeries:
    def __init__(self, values: Float, numbers: Int) -> None:
        self._values, self._numbers = values, numbers  # Float[series, samples], and the sample of each visit

    def read(self, chunk: Chunk, begins: bool) -> Float:
        return np.ascontiguousarray(self._values[:, self._numbers[chunk.first : chunk.last]].T)


class _SimulatedSeries:
    def __init__(self, steps: Sequence[SimulatedSteps], counts: Sequence[int]) -> None:
        self._steps, self._ends = steps, np.cumsum([0, *counts])

    def read(self, chunk: Chunk, begins: bool) -> Float:
        number = int(np.searchsorted(self._ends, chunk.first, side="right")) - 1
        steps, first = self._steps[number], chunk.first - int(self._ends[number])
        if begins:
            steps.start(first)
        return np.ascontiguousarray(np.nan_to_num(steps.over(first, first + chunk.length).T))


def _simulated(simulator: NodeSimulator, bound: BoundDataset, timed: BoundDataset, parameters: ParameterSet) -> Float:
    """Return series at the samples of a bound dataset, 0 where the function has no inputs; Float[series, samples]."""
    values = simulator.values(timed, parameters)
    whole = np.zeros((len(values), bound.dataset.samples))
    whole[:, timed.kept] = np.nan_to_num(values)
    return whole if bound.picked is None else whole[:, bound.kept]
