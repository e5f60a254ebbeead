"""The points at which a model calls a data-driven model."""

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.domain.dataset import SAMPLES_PER_BLOCK
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.traversal import with_names
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.preprocessing.binding import BoundDataset


class SurrogateCalls:
    """The calls of one surrogate, by its name."""

    def __init__(self, problem: Problem, parameters: ParameterSet, name: str) -> None:
        nodes = problem.graph.nodes
        self.problem, self.parameters = problem, parameters
        self.calls = [n.args for n in nodes if n.op == "lookup" and n.payload == name]
        places = dict.fromkeys(at for args in self.calls for at in args)
        self.inputs = {at: str(nodes[at].payload) for at in places if nodes[at].op == "input"}
        self.computed = {at: f"\0at {at}" for at in places if at not in self.inputs}

    @property
    def first_outputs(self) -> list[float | None]:
        """The output before the first sample in each call of a recursion; None unless it is a constant."""
        nodes, states = self.problem.graph.nodes, self.problem.graph.states
        initial = [nodes[states[nodes[args[0]].payload].init] for args in self.calls]
        return [float(node.payload) if node.op == "const" else None for node in initial]

    @cached_property
    def _nodes(self) -> NodeSimulator | None:
        if not self.computed:
            return None
        grown = with_names(self.problem.graph, self.computed)
        return NodeSimulator(grown, self.parameters, list(self.computed.values()))

    def points(self, bound: BoundDataset) -> Iterator[tuple[Int, Sequence[Float]]]:
        """Yield numbers of kept samples, and the points Float[samples, inputs] of each call, block by block."""
        for here, values in self._blocks(bound):
            coordinates: dict[int, Float] = dict(zip(self.computed, values, strict=True))
            coordinates |= {at: bound.columns[name][here] for at, name in self.inputs.items()}
            at = np.arange(here.start, here.stop)
            # of a point that is held, only the last sample is settled
            counted = slice(None) if bound.hold is None else (at + 1) % bound.hold.samples == 0
            yield at[counted], [np.column_stack([coordinates[a] for a in args])[counted] for args in self.calls]

    def _blocks(self, bound: BoundDataset) -> Iterator[tuple[slice, Float]]:
        if self._nodes is not None:
            yield from self._nodes.blocks(bound, self.parameters)
            return
        for first in range(0, bound.count, SAMPLES_PER_BLOCK):
            here = slice(first, min(first + SAMPLES_PER_BLOCK, bound.count))
            yield here, np.empty((0, here.stop - here.start))
