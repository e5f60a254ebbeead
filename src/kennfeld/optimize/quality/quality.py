"""Simulation of the nodes of a model, and the errors of its criteria in numbers."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Self

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.sample_statistics import Moments, gather
from kennfeld.domain.dataset import SAMPLES_PER_BLOCK, Channel, Dataset
from kennfeld.domain.file_spans import short_names
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph
from kennfeld.graph.lookup_lowering import LoweredGraph, lower_lookups
from kennfeld.native.simulator import SimulatedSteps, Simulator
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.error_sums import ErrorSums
from kennfeld.optimize.quality.recording_quality import RecordingQuality
from kennfeld.optimize.quality.recording_sums import RecordingSums, ScoredErrors
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.bound_parts import BoundPart

CONSTANT = "constant target"  # in place of R2, which compares with the target's variance


@dataclass(frozen=True)
class Quality:
    """Errors of one criterion on one dataset, in the unit of its target, before and after the calibration.

    Attributes:
        criterion: its node.
        dataset: name of the dataset.
        use: "training" or "test".
        samples: number of scored samples.
        rmse_before: root mean square error with the start values.
        rmse_after: with the calibrated values.
        r2_after: coefficient of determination; NaN if the target is constant, as there is no variance to explain.
        max_abs_after: largest absolute error.

    >>> from kennfeld import calibrate
    >>> result = calibrate("y = k * x", {"x": [1.0, 2.0, 3.0], "m": [2.0, 4.0, 6.0]}, {"k": 0.0}, target="m")
    >>> result.quality[0].criterion, result.quality[0].samples, round(result.quality[0].rmse_before, 3)
    ('y', 3, 4.32)
    """

    criterion: str
    dataset: str
    use: str
    samples: int
    rmse_before: float
    rmse_after: float
    r2_after: float
    max_abs_after: float


@dataclass(frozen=True)
class Scores:
    """The errors of each criterion, by dataset and by file."""

    quality: tuple[Quality, ...]
    recordings: tuple[RecordingQuality, ...]


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

    # differences from the first number: of a constant target they are exactly 0, whatever rounding does to a mean
    first = next((float(block[0]) for block in known()), 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        count = sum(block.size for block in known())
        total = sum(float(np.sum(block - first)) for block in known())
        mean = first + total / max(count, 1)
        return float(sum(np.sum((block - mean) ** 2) for block in known()))


class NodeSimulator:
    """Compiled nodes of a graph: those in `names`, or all visible ones."""

    def __init__(self, graph: Graph, parameters: ParameterSet, names: Sequence[str] | None = None) -> None:
        self._compile(lower_lookups(graph, parameters), parameters, list(graph.names) if names is None else names)

    @classmethod
    def of_lowered(cls, lowered: LoweredGraph, parameters: ParameterSet, names: Sequence[str]) -> Self:
        """Compile nodes of a graph whose lookups are lowered already."""
        result = cls.__new__(cls)
        result._compile(lowered, parameters, names)
        return result

    def _compile(self, lowered: LoweredGraph, parameters: ParameterSet, names: Sequence[str]) -> None:
        self._names, self._units = names, lowered.graph.units
        self._has_states = bool(lowered.graph.states)
        self._simulator = Simulator(lowered, [lowered.graph.names[name] for name in names], parameters)

    def values(self, bound: BoundDataset, parameters: ParameterSet) -> Float:
        """Simulate a bound dataset; returns Float[names, samples]."""
        return self.over(bound.columns, bound.count, parameters, bound.starts.tolist())

    def over(self, columns: Mapping[str, Float], count: int, parameters: ParameterSet, starts: Sequence[int]) -> Float:
        """Simulate columns of `count` samples, whose pieces begin at `starts`; returns Float[names, samples]."""
        return self._simulator.over(columns, count, parameters, starts)

    def steps(self, bound: BoundDataset, parameters: ParameterSet) -> SimulatedSteps:
        """Return a simulation of a bound dataset that goes on where it stopped; see `Simulator.steps`."""
        return self._simulator.steps(bound.columns, bound.count, parameters)

    def at(self, bound: BoundDataset, sample: int, parameters: ParameterSet) -> Float:
        """Return the nodes at one sample of a bound dataset, Float[names]; with states, its piece is simulated."""
        # states follow from the samples of the piece before this one
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
            # the samples over which a point settles are not shown
            values, bound = bound.hold.mean(values), bound.shown
        channels = tuple(Channel(n, v, self._units.get(n, "")) for n, v in zip(self._names, values, strict=True))
        time = None if bound.dataset.time is None else bound.dataset.time[bound.kept]
        # a dataset without samples still has a piece
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

    def errors(self, bound: BoundDataset, parameters: ParameterSet) -> Float:
        """Return model minus target, Float[criteria, samples]; NaN at samples that are not scored."""
        return self._nodes.values(bound, parameters) - self._targets(bound)

    def _targets(self, bound: BoundDataset) -> Float:
        return np.array([self._problem.target(criterion, bound) for criterion in self._problem.criteria])

    def scores(self, before: ParameterSet, after: ParameterSet) -> Scores:
        """Return the errors of each criterion on each dataset and on each file."""
        problem = self._problem
        if problem.partitions is None:
            pairs = list(zip(problem.datasets, self.sums(before, after), strict=True))
        else:
            merged = _merge_by_name(problem.each(_sum_partition, before, after, test=True))
            pairs = [(data, merged[data.name]) for data in problem.datasets if data.name in merged]
        return Scores(
            quality=tuple(
                sums.quality(criterion.node, data)
                for data, part in pairs
                for sums, criterion in zip(part.criteria, problem.criteria, strict=True)
            ),
            recordings=tuple(_recordings(problem, pairs)),
        )

    def sums(self, before: ParameterSet, after: ParameterSet) -> list["_PartSums"]:
        """Return the sums over each dataset."""
        work = partial(self._sum_part, before=before, after=after)
        return [gather(work, self._problem.parts(self._problem.bind(data))) for data in self._problem.datasets]

    def _sum_part(self, part: BoundPart, before: ParameterSet, after: ParameterSet) -> "_PartSums":
        bound = part.bound
        values = [self._nodes.values(bound, parameters) for parameters in (before, after)]
        errors = [_scored_errors(bound, *row) for row in zip(self._targets(bound), *values, strict=True)]
        return _PartSums([_CriterionSums.of(own) for own in errors], RecordingSums.of(part, errors))


def _scored_errors(bound: BoundDataset, target: Float, before: Float, after: Float) -> ScoredErrors:
    scored = np.isfinite(target)
    known = target[scored]
    # numbers of samples are needed only if some are missing
    complete = bound.picked is None and known.size == target.size
    with np.errstate(over="ignore", invalid="ignore"):
        return ScoredErrors(
            samples=None if complete else bound.kept[scored],
            target=known,
            before=before[scored] - known,
            after=after[scored] - known,
        )


def _recordings(problem: Problem, pairs: Sequence[tuple[Dataset, "_PartSums"]]) -> Iterator[RecordingQuality]:
    names = short_names([file.name for _, part in pairs for file in part.recordings.files])
    for data, part in pairs:
        part.recordings.close()
        for number, criterion in enumerate(problem.criteria):
            for file in part.recordings.files:
                yield file.quality(number, criterion.node, data, names[file.name] or None)


def _compile_differences(problem: Problem) -> NodeSimulator:
    return problem.model.once(
        "differences",
        problem.structure,
        lambda: NodeSimulator.of_lowered(problem.lowered, problem.parameters, problem.differences),
    )


def _sum_partition(problem: Problem, before: ParameterSet, after: ParameterSet) -> dict[str, "_PartSums"]:
    """Return the sums over one partition by the name of the dataset."""
    sums = Scorer(problem).sums(before, after)
    return _merge_by_name({data.name: part} for data, part in zip(problem.datasets, sums, strict=True))


def _merge_by_name(parts: Iterable[Mapping[str, "_PartSums"]]) -> dict[str, "_PartSums"]:
    merged: dict[str, _PartSums] = {}
    for name, sums in (item for part in parts for item in part.items()):
        if name in merged:
            merged[name].merge(sums)
        else:
            merged[name] = sums
    return merged


@dataclass
class _CriterionSums:
    """The errors of one criterion before and after, and the moments of its target."""

    before: ErrorSums
    after: ErrorSums
    target: Moments

    @classmethod
    def of(cls, errors: ScoredErrors) -> "_CriterionSums":
        return cls(ErrorSums.of(errors.before), ErrorSums.of(errors.after), Moments.of(errors.target))

    def merge(self, later: "_CriterionSums") -> None:
        self.before.merge(later.before)
        self.after.merge(later.after)
        self.target.merge(later.target)

    def quality(self, criterion: str, data: Dataset) -> Quality:
        variation, after = self.target.squares, self.after
        return Quality(
            criterion=criterion,
            dataset=data.name,
            use=data.use,
            samples=after.count,
            rmse_before=self.before.rmse,
            rmse_after=after.rmse,
            r2_after=1.0 - after.squares / variation if variation > 0 else float("nan"),
            max_abs_after=after.largest if after.count else float("nan"),
        )


@dataclass
class _PartSums:
    criteria: list[_CriterionSums]
    recordings: RecordingSums

    def merge(self, later: "_PartSums") -> None:
        self.recordings.merge(later.recordings)
        for own, other in zip(self.criteria, later.criteria, strict=True):
            own.merge(other)
