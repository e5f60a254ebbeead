"""How well a criterion is met.

Simulation of a calibrated model, and how well it meets its criteria.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Channel, Dataset
from kennfeld.graph import Graph
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native import Simulator
from kennfeld.optimize.problem import Problem, difference
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset

__all__ = ["CONSTANT", "NodeSimulator", "Quality", "Scorer", "r2_text", "spread"]

CONSTANT = "constant target"  # in place of R2, which compares with the target's variance

_BLOCK = 65536  # samples at once, so that memory does not grow with the data

BLOCK = 65536  # samples at once, so that memory does not grow with the data


@dataclass(frozen=True)
class Quality:
    """How well one criterion is met on one dataset, in the unit of its target, before and after.

    `r2_after` is NaN if the target is constant, for then there is no variance to explain.
    """

    criterion: str
    dataset: str
    use: str
    samples: int
    rmse_before: float
    rmse_after: float
    r2_after: float
    max_abs_after: float


def r2_text(r2: float, samples: int, rmse: float) -> str:
    """Return R2 for a table: a number, or why there is none.

    >>> r2_text(0.98765, 20, 0.1), r2_text(float("nan"), 20, 0.1), r2_text(float("nan"), 0, float("nan"))
    ('0.9877', 'constant target', '-')
    """
    if np.isfinite(r2):
        return f"{r2:.4f}"
    return CONSTANT if samples and np.isfinite(rmse) else "-"


def spread(target: Float) -> float:
    """Return the sum of squared distances from the mean, where the target is known; exactly 0 if it is constant.

    Args:
        target: NaN where a sample is not scored; Float[samples].
    """
    count, total = 0, 0.0
    first = next((float(part[0]) for part in _known(target)), 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        for part in _known(target):
            count += part.size
            total += float(np.sum(part - first))
        mean = first + total / max(count, 1)
        return float(sum(np.sum((part - mean) ** 2) for part in _known(target)))


def _known(target: Float) -> Iterator[Float]:
    """The values that are there, block by block."""
    for at in range(0, target.size, _BLOCK):
        part = target[at : at + _BLOCK]
        known = part[np.isfinite(part)]
        if known.size:
            yield known


class NodeSimulator:
    """Named nodes of a graph, compiled; all that are visible unless `names` says which."""

    def __init__(self, graph: Graph, parameters: ParameterSet, names: Sequence[str] | None = None) -> None:
        names = list(graph.names) if names is None else names
        self._names, self._units = names, graph.units
        lowered = lower_lookups(graph, parameters)
        self._remembers = bool(lowered.graph.states)
        self._simulator = Simulator(lowered, [lowered.graph.names[name] for name in names], parameters)

    def values(self, bound: BoundDataset, parameters: ParameterSet) -> Float:
        """Shape (names, samples)."""
        return self.over(bound.columns, bound.count, parameters, bound.starts.tolist())

    def over(self, columns: Mapping[str, Float], count: int, parameters: ParameterSet, starts: Sequence[int]) -> Float:
        """The values over columns of so many samples, whose pieces begin at `starts`; shape (names, samples)."""
        return self._simulator.over(columns, count, parameters, starts)

    def blocks(self, bound: BoundDataset, parameters: ParameterSet) -> Iterator[tuple[slice, Float]]:
        """Samples and their values, shape (names, samples), block by block; a piece with memory is computed at once."""
        columns = bound.columns
        for starts, end in _stretches(bound.starts if self._remembers else range(0, bound.count, BLOCK), bound.count):
            first = starts[0]
            held = {name: values[first:end] for name, values in columns.items()}
            found = self._simulator.over(held, end - first, parameters, [start - first for start in starts])
            for at in range(first, end, BLOCK):
                here = slice(at, min(at + BLOCK, end))
                yield here, found[:, here.start - first : here.stop - first]

    def dataset(self, bound: BoundDataset, parameters: ParameterSet) -> Dataset:
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
        self._nodes = NodeSimulator(
            problem.graph, problem.parameters, [difference(i) for i in range(len(problem.criteria))]
        )
        self._bounds = [problem.bind(dataset) for dataset in problem.datasets]

    def errors(self, bound: BoundDataset, parameters: ParameterSet) -> Float:
        """Model minus target at each sample, shape (criteria, samples); NaN where it is not scored."""
        targets = [self._problem.target(criterion, bound) for criterion in self._problem.criteria]
        return self._nodes.values(bound, parameters) - np.array(targets)

    def quality(self, before: ParameterSet, after: ParameterSet) -> tuple[Quality, ...]:
        """The quality of each criterion on each dataset."""
        return tuple(row for bound in self._bounds for row in self._rows(bound, before, after))

    def _rows(self, bound: BoundDataset, before: ParameterSet, after: ParameterSet) -> list[Quality]:
        criteria = self._problem.criteria
        targets = [self._problem.target(criterion, bound) for criterion in criteria]
        old, new = (self._errors(bound, targets, parameters) for parameters in (before, after))
        parts = zip(criteria, targets, old, new, strict=True)
        return [_quality(criterion.node, bound, target, *errors) for criterion, target, *errors in parts]

    def _errors(self, bound: BoundDataset, targets: Sequence[Float], parameters: ParameterSet) -> list["_Errors"]:
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


def _quality(criterion: str, bound: BoundDataset, target: Float, old: _Errors, new: _Errors) -> Quality:
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
