"""Simulation of a calibrated model, and how well it meets its criteria."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Channel, Dataset
from kennfeld.graph import Graph
from kennfeld.graph.lowering import lower
from kennfeld.native import Simulator
from kennfeld.optimize.data.binding import Bound
from kennfeld.optimize.problem import Problem, difference
from kennfeld.optimize.quality import Quality, spread
from kennfeld.parameters import ParameterSet

__all__ = ["Nodes", "Scorer"]

BLOCK = 65536  # samples at once, so that memory does not grow with the data


class Nodes:
    """Named nodes of a graph, compiled; all that are visible unless `names` says which."""

    def __init__(self, graph: Graph, parameters: ParameterSet, names: Sequence[str] | None = None) -> None:
        names = list(graph.names) if names is None else names
        self._names, self._units = names, graph.units
        lowered = lower(graph, parameters)
        self._remembers = bool(lowered.graph.states)
        self._simulator = Simulator(lowered, [lowered.graph.names[name] for name in names], parameters)

    def values(self, bound: Bound, parameters: ParameterSet) -> Float:
        """Shape (names, samples)."""
        return self.over(bound.columns, bound.count, parameters, bound.starts.tolist())

    def over(self, columns: Mapping[str, Float], count: int, parameters: ParameterSet, starts: Sequence[int]) -> Float:
        """The values over columns of so many samples, whose pieces begin at `starts`; shape (names, samples)."""
        return self._simulator.over(columns, count, parameters, starts)

    def blocks(self, bound: Bound, parameters: ParameterSet) -> Iterator[tuple[slice, Float]]:
        """Samples and their values, shape (names, samples), block by block; a piece with memory is computed at once."""
        columns = bound.columns
        for starts, end in _stretches(bound.starts if self._remembers else range(0, bound.count, BLOCK), bound.count):
            first = starts[0]
            held = {name: values[first:end] for name, values in columns.items()}
            found = self._simulator.over(held, end - first, parameters, [start - first for start in starts])
            for at in range(first, end, BLOCK):
                here = slice(at, min(at + BLOCK, end))
                yield here, found[:, here.start - first : here.stop - first]

    def dataset(self, bound: Bound, parameters: ParameterSet) -> Dataset:
        """The nodes as channels, over the samples of a bound dataset; one value a point where points are held."""
        values = self.values(bound, parameters)
        if bound.hold is not None:
            values, bound = bound.hold.mean(values), bound.shown
        channels = tuple(Channel(n, v, self._units.get(n, "")) for n, v in zip(self._names, values, strict=True))
        time = None if bound.dataset.time is None else bound.dataset.time[bound.kept]
        starts = bound.starts if bound.count else np.zeros(1, dtype=np.int64)
        return Dataset(bound.dataset.name, channels, time, starts)


def _stretches(starts: Iterable[int], count: int) -> Iterator[tuple[list[int], int]]:
    """Neighbouring pieces, together at least a block: where they start, and the end of the last."""
    held: list[int] = []
    for start, end in pairwise([*(int(start) for start in starts), count]):
        held.append(start)
        if end - held[0] >= BLOCK or end == count:
            yield held, end
            held = []


class Scorer:
    """Scores parameter sets on all datasets of a problem, training and test."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._nodes = Nodes(problem.graph, problem.parameters, [difference(i) for i in range(len(problem.criteria))])
        self._bounds = [problem.bind(dataset) for dataset in problem.datasets]

    def errors(self, bound: Bound, parameters: ParameterSet) -> Float:
        """Model minus target at each sample, shape (criteria, samples); NaN where it is not scored."""
        targets = [self._problem.target(criterion, bound) for criterion in self._problem.criteria]
        return self._nodes.values(bound, parameters) - np.array(targets)

    def quality(self, before: ParameterSet, after: ParameterSet) -> tuple[Quality, ...]:
        """The quality of each criterion on each dataset."""
        return tuple(row for bound in self._bounds for row in self._rows(bound, before, after))

    def _rows(self, bound: Bound, before: ParameterSet, after: ParameterSet) -> list[Quality]:
        criteria = self._problem.criteria
        targets = [self._problem.target(criterion, bound) for criterion in criteria]
        old, new = (self._errors(bound, targets, parameters) for parameters in (before, after))
        parts = zip(criteria, targets, old, new, strict=True)
        return [_quality(criterion.node, bound, target, *errors) for criterion, target, *errors in parts]

    def _errors(self, bound: Bound, targets: Sequence[Float], parameters: ParameterSet) -> list["_Errors"]:
        """The errors of each criterion, model minus target, where it is scored."""
        found = [_Errors() for _ in targets]
        for samples, values in self._nodes.blocks(bound, parameters):
            for errors, target, value in zip(found, targets, values, strict=True):
                errors.add(value, target[samples])
        return found


@dataclass
class _Errors:
    """What is known of the errors added so far."""

    count: int = 0
    squares: float = 0.0
    largest: float = 0.0

    def add(self, values: Float, target: Float) -> None:
        """Take the errors at more samples, where the target is known."""
        scored = np.isfinite(target)
        with np.errstate(over="ignore", invalid="ignore"):
            error = values[scored] - target[scored]
            self.count += error.size
            self.squares += float(np.sum(error**2))
            self.largest = float(np.abs(error).max(initial=self.largest))


def _quality(criterion: str, bound: Bound, target: Float, old: _Errors, new: _Errors) -> Quality:
    variation = spread(target)
    return Quality(
        criterion=criterion,
        dataset=bound.dataset.name,
        use=bound.dataset.use,
        samples=new.count,
        rmse_before=_rmse(old),
        rmse_after=_rmse(new),
        r2_after=1.0 - new.squares / variation if variation > 0 else float("nan"),
        max_abs_after=new.largest if new.count else float("nan"),
    )


def _rmse(errors: _Errors) -> float:
    return float(np.sqrt(errors.squares / errors.count)) if errors.count else float("nan")
