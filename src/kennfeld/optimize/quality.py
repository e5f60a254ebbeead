"""Simulation of the nodes of a model, and the errors of its criteria in numbers."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kennfeld.arrays import Float
from kennfeld.dataset import Channel, Dataset
from kennfeld.graph import Graph
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.native.simulator import Simulator
from kennfeld.optimize.problem import Problem
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset

CONSTANT = "constant target"  # in place of R2, which compares with the target's variance
SAMPLES_PER_BLOCK = 65536  # memory does not grow with the data


@dataclass(frozen=True)
class Quality:
    """Errors of one criterion on one dataset, in the unit of its target, before and after the calibration.

    `r2_after` is NaN if the target is constant: there is no variance to explain.
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
    """Return R2 as text for a table, or the reason why it is undefined.

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

    def known() -> Iterator[Float]:
        blocks = (target[at : at + SAMPLES_PER_BLOCK] for at in range(0, target.size, SAMPLES_PER_BLOCK))
        return (block[np.isfinite(block)] for block in blocks if np.isfinite(block).any())

    first = next((float(block[0]) for block in known()), 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        count = sum(block.size for block in known())
        total = sum(float(np.sum(block - first)) for block in known())
        mean = first + total / max(count, 1)
        return float(sum(np.sum((block - mean) ** 2) for block in known()))


class NodeSimulator:
    """Compiled nodes of a graph: those in `names`, or all visible ones."""

    def __init__(self, graph: Graph, parameters: ParameterSet, names: Sequence[str] | None = None) -> None:
        names = list(graph.names) if names is None else names
        self._names, self._units = names, graph.units
        lowered = lower_lookups(graph, parameters)
        self._has_states = bool(lowered.graph.states)
        self._simulator = Simulator(lowered, [lowered.graph.names[name] for name in names], parameters)

    def values(self, bound: BoundDataset, parameters: ParameterSet) -> Float:
        """Simulate a bound dataset; returns Float[names, samples]."""
        return self.over(bound.columns, bound.count, parameters, bound.starts.tolist())

    def over(self, columns: Mapping[str, Float], count: int, parameters: ParameterSet, starts: Sequence[int]) -> Float:
        """Simulate columns of `count` samples, whose pieces begin at `starts`; returns Float[names, samples]."""
        return self._simulator.over(columns, count, parameters, starts)

    def at(self, bound: BoundDataset, sample: int, parameters: ParameterSet) -> Float:
        """Return the nodes at one sample of a bound dataset, Float[names]; with states, its piece is simulated."""
        first = bound.start_of(sample) if self._has_states else sample
        return self._simulator.last(bound.part(first, sample + 1), sample + 1 - first, parameters)

    def blocks(self, bound: BoundDataset, parameters: ParameterSet) -> Iterator[tuple[slice, Float]]:
        """Yield samples and Float[names, samples], block by block; with states, a piece is simulated at once."""
        columns = bound.columns
        pieces = bound.starts.tolist() if self._has_states else range(0, bound.count, SAMPLES_PER_BLOCK)
        for starts, end in _group_pieces(pieces, bound.count):
            first = starts[0]
            inputs = {name: values[first:end] for name, values in columns.items()}
            values = self._simulator.over(inputs, end - first, parameters, [start - first for start in starts])
            for at in range(first, end, SAMPLES_PER_BLOCK):
                here = slice(at, min(at + SAMPLES_PER_BLOCK, end))
                yield here, values[:, here.start - first : here.stop - first]

    def dataset(self, bound: BoundDataset, parameters: ParameterSet) -> Dataset:
        """Return the nodes as channels of a dataset; one value per point if points are held until they settle."""
        values = self.values(bound, parameters)
        if bound.hold is not None:
            values, bound = bound.hold.mean(values), bound.shown
        channels = tuple(Channel(n, v, self._units.get(n, "")) for n, v in zip(self._names, values, strict=True))
        time = None if bound.dataset.time is None else bound.dataset.time[bound.kept]
        starts = bound.starts if bound.count else np.zeros(1, dtype=np.int64)
        return Dataset(bound.dataset.name, channels, time, starts)


def _group_pieces(starts: Iterable[int], count: int) -> Iterator[tuple[list[int], int]]:
    """Yield the starts of neighbouring pieces that are together at least a block, and their end."""
    group: list[int] = []
    for start, end in pairwise([*starts, count]):
        group.append(start)
        if end - group[0] >= SAMPLES_PER_BLOCK or end == count:
            yield group, end
            group = []


class Scorer:
    """Scores parameter sets on all datasets of a problem, training and test."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._nodes = problem.once("differences", _compile_differences)
        self._bounds: list[BoundDataset] | None = None

    def errors(self, bound: BoundDataset, parameters: ParameterSet) -> Float:
        """Return model minus target, Float[criteria, samples]; NaN at samples that are not scored."""
        targets = [self._problem.target(criterion, bound) for criterion in self._problem.criteria]
        return self._nodes.values(bound, parameters) - np.array(targets)

    def quality(self, before: ParameterSet, after: ParameterSet) -> tuple[Quality, ...]:
        """Return the quality of each criterion on each dataset."""
        if self._problem.partitions is None:
            sums = self.sums(before, after)
        else:
            parts = self._problem.each(sum_quality, before, after, test=True)
            sums = merge_sums(row for part in parts for row in part)
        places = {data.name: at for at, data in enumerate(self._problem.datasets)}
        return tuple(row.quality for row in sorted(sums, key=lambda row: (places[row.dataset], row.number)))

    def sums(self, before: ParameterSet, after: ParameterSet) -> list["QualitySums"]:
        """Return the sums over the errors of each criterion on each dataset."""
        if self._bounds is None:
            self._bounds = [self._problem.bind(dataset) for dataset in self._problem.datasets]
        rows = []
        for bound in self._bounds:
            targets = [self._problem.target(criterion, bound) for criterion in self._problem.criteria]
            old, new = (self._sum_errors(bound, targets, parameters) for parameters in (before, after))
            for i, criterion in enumerate(self._problem.criteria):
                names = i, criterion.node, bound.dataset.name, bound.dataset.use
                rows.append(QualitySums(*names, old[i], new[i], Moments.of(targets[i])))
        return rows

    def _sum_errors(self, bound: BoundDataset, targets: Sequence[Float], parameters: ParameterSet) -> list["ErrorSums"]:
        sums = [ErrorSums() for _ in targets]
        for samples, values in self._nodes.blocks(bound, parameters):
            for errors, target, value in zip(sums, targets, values, strict=True):
                errors.add(value, target[samples])
        return sums


def _compile_differences(problem: Problem) -> NodeSimulator:
    return NodeSimulator(problem.graph, problem.parameters, problem.differences)


def sum_quality(problem: Problem, before: ParameterSet, after: ParameterSet) -> list["QualitySums"]:
    """Return the sums over the errors of a problem, such as one of a single partition."""
    return merge_sums(Scorer(problem).sums(before, after))


def merge_sums(rows: Iterable["QualitySums"]) -> list["QualitySums"]:
    """Return one row for each criterion and dataset, in the order of their first rows."""
    merged: dict[tuple[str, int], QualitySums] = {}
    for row in rows:
        key = row.dataset, row.number
        merged[key] = merged[key].with_more(row) if key in merged else row
    return list(merged.values())


@dataclass
class ErrorSums:
    """Sums over the errors of a criterion."""

    count: int = 0
    squares: float = 0.0
    largest: float = 0.0

    def add(self, values: Float, target: Float) -> None:
        """Add samples; those without a target do not count."""
        scored = np.isfinite(target)
        with np.errstate(over="ignore", invalid="ignore"):
            error = values[scored] - target[scored]
            self.count += error.size
            self.squares += float(np.sum(error**2))
            self.largest = float(np.abs(error).max(initial=self.largest))

    def with_more(self, other: "ErrorSums") -> "ErrorSums":
        """Return the sums over the samples of both."""
        largest = float(np.maximum(self.largest, other.largest))  # NaN if either is
        return ErrorSums(self.count + other.count, self.squares + other.squares, largest)

    @property
    def rmse(self) -> float:
        """The root of the mean square; NaN without samples."""
        return float(np.sqrt(self.squares / self.count)) if self.count else float("nan")


@dataclass(frozen=True)
class Moments:
    """Count, mean, and sum of squared distances from the mean."""

    count: int
    mean: float
    squares: float

    @classmethod
    def of(cls, target: Float) -> "Moments":
        """Return the moments of a target where it is known."""
        known = target[np.isfinite(target)]
        first = float(known[0]) if known.size else 0.0
        mean = first + float(np.mean(known - first)) if known.size else 0.0
        return cls(known.size, mean, spread(target))

    def with_more(self, other: "Moments") -> "Moments":
        """Return the moments of both (T. F. Chan et al.: Algorithms for computing the sample variance, 1983)."""
        count, distance = self.count + other.count, other.mean - self.mean
        if not count:
            return self
        share = other.count / count
        squares = self.squares + other.squares + distance**2 * self.count * share
        return Moments(count, self.mean + distance * share, squares)


class QualitySums(NamedTuple):
    """Sums from which the quality of a criterion, by number, on a dataset follows."""

    number: int
    criterion: str
    dataset: str
    use: str
    before: ErrorSums
    after: ErrorSums
    target: Moments

    def with_more(self, other: "QualitySums") -> "QualitySums":
        """Return the sums over the samples of both."""
        errors = self.before.with_more(other.before), self.after.with_more(other.after)
        return QualitySums(*self[:4], *errors, self.target.with_more(other.target))

    @property
    def quality(self) -> Quality:
        """The quality."""
        after, variation = self.after, self.target.squares
        return Quality(
            criterion=self.criterion,
            dataset=self.dataset,
            use=self.use,
            samples=after.count,
            rmse_before=self.before.rmse,
            rmse_after=after.rmse,
            r2_after=1.0 - after.squares / variation if variation > 0 else float("nan"),
            max_abs_after=after.largest if after.count else float("nan"),
        )
