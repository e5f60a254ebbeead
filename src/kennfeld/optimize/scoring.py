"""Simulation of a calibrated model, and how well it meets its criteria."""

from collections.abc import Sequence

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Channel, Dataset
from kennfeld.graph import Graph
from kennfeld.graph.lowering import lower
from kennfeld.native import Simulator
from kennfeld.optimize.binding import Bound
from kennfeld.optimize.problem import Problem, difference
from kennfeld.optimize.result import Quality
from kennfeld.parameters import ParameterSet

__all__ = ["Nodes", "Scorer"]


class Nodes:
    """Named nodes of a graph, compiled; all that are visible unless `names` says which."""

    def __init__(self, graph: Graph, parameters: ParameterSet, names: Sequence[str] | None = None) -> None:
        names = list(graph.names) if names is None else names
        self._names, self._units = names, graph.units
        lowered = lower(graph, parameters)
        self._simulator = Simulator(lowered, [lowered.graph.names[name] for name in names], parameters)

    def values(self, bound: Bound, parameters: ParameterSet) -> Float:
        """Shape (names, samples)."""
        rows = [bound.columns[name] for name in self._simulator.inputs]
        data = np.array(rows).reshape(len(rows), bound.count)
        return self._simulator.run(parameters, data, bound.starts.tolist())

    def dataset(self, bound: Bound, parameters: ParameterSet) -> Dataset:
        """The nodes as channels, over the samples of a bound dataset; one value a point where points are held."""
        values = self.values(bound, parameters)
        if bound.hold is not None:
            values, bound = bound.hold.mean(values), bound.shown
        channels = tuple(Channel(n, v, self._units.get(n, "")) for n, v in zip(self._names, values, strict=True))
        time = None if bound.dataset.time is None else bound.dataset.time[bound.kept]
        starts = bound.starts if bound.count else np.zeros(1, dtype=np.int64)
        return Dataset(bound.dataset.name, channels, time, starts)


class Scorer:
    """Scores parameter sets on all datasets of a problem, training and test."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._names = [difference(i) for i in range(len(problem.criteria))]
        self._nodes = Nodes(problem.graph, problem.parameters, self._names)
        self._bounds = [problem.bind(dataset) for dataset in problem.datasets]

    def errors(self, parameters: ParameterSet) -> list[Float]:
        """Model minus target, one array of shape (criteria, samples) a dataset; NaN where not scored."""
        problem = self._problem
        return [
            self._nodes.values(bound, parameters) - np.array([problem.target(c, bound) for c in problem.criteria])
            for bound in self._bounds
        ]

    def quality(self, before: ParameterSet, after: ParameterSet) -> tuple[Quality, ...]:
        """The quality of each criterion on each dataset."""
        problem = self._problem
        pairs = zip(self._bounds, self.errors(before), self.errors(after), strict=True)
        return tuple(
            _quality(criterion.node, bound, old[i], new[i], problem.target(criterion, bound))
            for bound, old, new in pairs
            for i, criterion in enumerate(problem.criteria)
        )


def _quality(node: str, bound: Bound, old: Float, new: Float, target: Float) -> Quality:
    scored = np.isfinite(target)
    count = int(scored.sum())
    error = new[scored]
    with np.errstate(over="ignore", invalid="ignore"):
        spread = float(np.sum((target[scored] - target[scored].mean()) ** 2)) if count else 0.0
        rest = float(np.sum(error**2))
    return Quality(
        criterion=node,
        dataset=bound.dataset.name,
        use=bound.dataset.use,
        samples=count,
        rmse_before=_rmse(old[scored]),
        rmse_after=_rmse(error),
        r2_after=1.0 - rest / spread if spread > 0 else float("nan"),
        max_abs_after=float(np.abs(error).max()) if count else float("nan"),
    )


def _rmse(error: Float) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")
