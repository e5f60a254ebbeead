"""Simulation of all criteria of a problem on all its datasets."""

from collections.abc import Iterator, Mapping
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.traversal import with_names
from kennfeld.optimize.problem.problem import Problem, difference
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.preprocessing.binding import BoundDataset


@dataclass(frozen=True, eq=False)
class CriterionSeries:
    """One criterion over the kept samples of one dataset; `measured` is NaN at samples that are not scored."""

    criterion: int
    bound: BoundDataset
    unit: str
    model: Float  # Float[samples]
    measured: Float  # Float[samples]

    @cached_property
    def error(self) -> Float:
        """Model minus measurement, in `unit`, NaN if not scored; Float[kept samples]."""
        return self.model - self.measured

    @cached_property
    def scored(self) -> Bool:
        """The scored samples, Bool[kept samples]."""
        return np.isfinite(self.measured)

    @property
    def time(self) -> Float | None:
        """Time of the kept samples in s, Float[kept samples]; None for steady-state points."""
        time, picked = self.bound.dataset.time, self.bound.picked
        return time if time is None or picked is None else time[picked]

    @property
    def piece(self) -> Int:
        """Piece of each kept sample, counted from 0; Int[kept samples]."""
        begins = np.zeros(self.bound.count, dtype=np.int64)
        begins[self.bound.starts] = 1
        return np.cumsum(begins) - 1


class Evaluator:
    """Simulates the criteria of a problem; compiled once for all parameter sets over the same axes.

    `extra` names additional nodes of the problem's graph, by number; `values` holds them after each call of `series`,
    for each dataset Float[extra, samples].
    """

    def __init__(self, problem: Problem, extra: Mapping[int, str] | None = None) -> None:
        self._problem, self._extra, self.values = problem, dict(extra or {}), list[Float]()
        self._graph = with_names(problem.graph, self._extra)
        self._against_node = [problem.target_node(criterion) is not None for criterion in problem.criteria]
        self._names = [difference(i) for i in range(len(problem.criteria))]
        # the nodes behind the differences, in the order in which `_series` takes them
        self._names += [c.node for c, node in zip(problem.criteria, self._against_node, strict=True) if node]
        self._names += self._extra.values()
        self._nodes: list[tuple[ParameterSet, NodeSimulator]] = []

    def series(self, parameters: ParameterSet) -> tuple[CriterionSeries, ...]:
        """Return every criterion on every dataset that scores it, dataset by dataset."""
        parts = [self.over(self._problem.bind(dataset), parameters) for dataset in self._problem.datasets]
        self.values = [part.extra for part in parts]
        return tuple(series for part in parts for series in part.series if series.scored.any())

    def prepare(self, parameters: ParameterSet) -> NodeSimulator:
        """Return the compiled nodes for the axes of these parameters."""
        # compiled code holds the breakpoints, so that other values on the same axes share it
        for known, nodes in self._nodes:
            if _same_axes(known, parameters):
                return nodes
        nodes = NodeSimulator(self._graph, parameters, self._names)
        self._nodes.append((parameters, nodes))
        return nodes

    def over(self, bound: BoundDataset, parameters: ParameterSet) -> "EvaluatedCriteria":
        """Return every criterion over a dataset or a part of one, also those that it does not score."""
        values = self.prepare(parameters).values(bound, parameters)
        series = tuple(self._series(bound, values))
        return EvaluatedCriteria(series, values[len(self._names) - len(self._extra) :])

    def _series(self, bound: BoundDataset, values: Float) -> Iterator[CriterionSeries]:
        own = iter(values[len(self._problem.criteria) :])
        for i, criterion in enumerate(self._problem.criteria):
            target = self._problem.target(criterion, bound)
            model = next(own) if self._against_node[i] else values[i]
            # a target that is a node is model minus the scored difference
            measured = model - (values[i] - target) if self._against_node[i] else target
            channel = criterion.target.name
            unit = bound.dataset[channel].unit if channel in bound.dataset else ""
            yield CriterionSeries(
                i, bound, unit or self._problem.model.graph.units.get(criterion.node, ""), model, measured
            )


@dataclass(frozen=True, eq=False)
class EvaluatedCriteria:
    """The criteria over some samples, and further nodes, Float[extra, samples]."""

    series: tuple[CriterionSeries, ...]
    extra: Float


def _same_axes(first: ParameterSet, second: ParameterSet) -> bool:
    """Return True if two sets hold the same tables over the same breakpoints."""
    return list(first) == list(second) and all(
        first[name].has_grid_of(second[name]) and first[name].extrapolation == second[name].extrapolation
        for name in first
    )
