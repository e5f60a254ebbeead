"""Evaluation of all criteria part by part, before and after a calibration; parts may be on other machines."""

import pickle
from collections.abc import Callable, Iterator, Sequence
from itertools import accumulate
from threading import Lock
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries, Evaluator
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.base.sample_statistics import Mergeable, gather, merge_all
from kennfeld.domain.dataset import SAMPLES_PER_BLOCK, Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.problem.partitions import StoredDatasets, shared_content
from kennfeld.optimize.problem.problem import Problem, partitions_of
from kennfeld.optimize.quality.lookup_coverage import Lookup, Lookups, coordinates
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.bound_parts import BoundPart

NODES_AT_ONCE = 8  # so that those of a long piece need little memory

_Statistic = TypeVar("_Statistic", bound=Mergeable)  # Python 3.11
_Arguments = ParamSpec("_Arguments")


@dataclass(frozen=True)
class PartExtent:
    """The size of a part: its kept samples, all its samples, its pieces, the longest of them, and scored samples.

    `scored` is by criterion.
    """

    count: int
    samples: int
    pieces: int
    longest: int
    scored: tuple[int, ...]


@dataclass(frozen=True)
class PartPlace:
    """The numbers of kept samples, of all samples, of pieces and of scored samples of a dataset before a part.

    `continues` tells that the part begins within piece number `piece`.
    """

    first: int = 0
    begin: int = 0
    piece: int = 0
    continues: bool = False
    scored: tuple[int, ...] = ()

    def after(self, extent: PartExtent, *, joined: bool) -> "PartPlace":
        """Return the place behind a part; `joined` parts are one piece."""
        return PartPlace(
            first=self.first + extent.count,
            begin=self.begin + extent.samples,
            piece=0 if joined else self.piece + extent.pieces,
            continues=joined and self.first + extent.count > 0,
            scored=tuple(np.add(self.scored or 0, extent.scored).tolist()),
        )


@dataclass(frozen=True, eq=False)
class DatasetExtent:
    """The size of a dataset, of which this process may hold an excerpt.

    Attributes:
        dataset: its name, its use and its weight.
        places: of its parts.
        end: the place behind them.
        longest: samples of its longest piece.
    """

    dataset: Dataset
    places: tuple[PartPlace, ...]
    end: PartPlace
    longest: int

    @classmethod
    def of(cls, dataset: Dataset, extents: Sequence[PartExtent], *, joined: bool) -> "DatasetExtent":
        """Return the extent of a dataset from those of its parts; `joined` parts are one piece."""
        start = PartPlace(scored=(0,) * len(extents[0].scored))
        *places, end = accumulate(extents, lambda place, extent: place.after(extent, joined=joined), initial=start)
        return cls(dataset, tuple(places), end, max(extent.longest for extent in extents))

    @property
    def name(self) -> str:
        """Name of the dataset."""
        return self.dataset.name

    @property
    def is_timed(self) -> bool:
        """True if its samples have a time."""
        return self.dataset.time is not None

    @property
    def samples(self) -> int:
        """Number of all samples."""
        return self.end.begin

    @property
    def count(self) -> int:
        """Number of kept samples, at which the function is evaluated."""
        return self.end.first


@dataclass(frozen=True, eq=False)
class EvaluatedPart:
    """The criteria over a part of a dataset before and after the calibration.

    Threads evaluate parts, so that nothing here is a cached property: until Python 3.12, its lock is that of all parts.

    Attributes:
        bound: the part.
        samples: number of all its samples, also of those that are not kept.
        before: the criteria before the calibration.
        after: the criteria after the calibration.
        coordinates: of the lookups after the calibration, Float[coordinates, kept samples].
    """

    bound: BoundDataset
    samples: int
    before: tuple[CriterionSeries, ...]
    after: tuple[CriterionSeries, ...]
    coordinates: Float

    @property
    def extent(self) -> PartExtent:
        """The size of the part."""
        lengths = np.diff(self.bound.starts, append=self.bound.count)
        scored = tuple(int(np.count_nonzero(series.scored)) for series in self.after)
        return PartExtent(self.bound.count, self.samples, lengths.size, int(lengths.max(initial=0)), scored)


class PartEvaluator:
    """Evaluates all criteria part by part, before and after a calibration; a dataset that is small is kept."""

    def __init__(self, problem: Problem, before: ParameterSet, after: ParameterSet) -> None:
        self.problem, self.sets, self.parameters = problem, (before, after), after
        self.criteria = Evaluator(problem, coordinates(problem))
        for parameters in self.sets:
            self.criteria.prepare(parameters)  # compiled before threads need it
        self.lookups = Lookups(problem, after)
        self._kept: dict[int, EvaluatedPart] = {}
        self._nodes: dict[tuple[str, ...], NodeSimulator] = {}
        self._compiling = Lock()

    def nodes(self, evaluated: EvaluatedPart, names: Sequence[str]) -> Iterator[tuple[str, Float]]:
        """Yield named nodes of the function over a part after the calibration, Float[kept samples]; a few at a time."""
        for at in range(0, len(names), NODES_AT_ONCE):
            group = tuple(names[at : at + NODES_AT_ONCE])
            # threads evaluate parts: one of them compiles, the others wait for it
            with self._compiling:
                if group not in self._nodes:
                    self._nodes[group] = NodeSimulator(self.problem.model.graph, self.parameters, group)
            yield from zip(group, self._nodes[group].values(evaluated.bound, self.parameters), strict=True)

    def over(self, part: BoundPart) -> EvaluatedPart:
        """Evaluate the criteria over a part; a dataset that is one part is evaluated once."""
        # parts of a large dataset are evaluated anew in each pass, so that memory does not grow with the data
        if part.last - part.first < part.whole.count or part.whole.count > SAMPLES_PER_BLOCK:
            return self.evaluate(part)
        if id(part.whole) not in self._kept:
            self._kept[id(part.whole)] = self.evaluate(part)
        return self._kept[id(part.whole)]

    def evaluate(self, part: BoundPart) -> EvaluatedPart:
        """Evaluate the criteria over a part, which is not kept."""
        start, end = self.sets
        after = self.criteria.over(part.bound, end)
        before = after.series if start is end else self.criteria.over(part.bound, start).series
        return EvaluatedPart(part.bound, part.end - part.begin, before, after.series, after.extra)

    def locate(self, evaluated: EvaluatedPart) -> list[Lookup]:
        """Return the lookups over a part after the calibration."""
        return self.lookups.over(evaluated.bound, evaluated.coordinates)


Task = Callable[Concatenate[PartEvaluator, EvaluatedPart, PartPlace, _Arguments], _Statistic]


class PartPasses:
    """Passes over the parts of each dataset, before and after a calibration: in this process, or over partitions.

    What a task returns for each part is merged in the order of the samples, so that it does not depend on who computes
    it. A recording in partitions that are cut anywhere is evaluated as a whole, as its errors are correlated in time.
    """

    def __init__(self, problem: Problem, before: ParameterSet, after: ParameterSet) -> None:
        self.problem, self.evaluator = problem, PartEvaluator(problem, before, after)
        self._shared = b""
        if problem.partitions is not None:
            self._shared = problem.partitions.share((problem.skeleton, before, after))
        self._counts: dict[int, list[int]] = {}  # of the parts of each partition, by dataset

    def extent(self, dataset: int, extents: Sequence[PartExtent]) -> DatasetExtent:
        """Return the extent of a dataset, by number, from those of its parts."""
        data = self.problem.datasets[dataset]
        return DatasetExtent.of(data, extents, joined=data.time is None and not self.problem.graph.states)

    def first(self, dataset: int, task: "Task[_Arguments, _Statistic]", *arguments: Any) -> _Statistic | None:
        """Return the merged results of a task over a dataset whose places are not known yet; None without parts."""
        return self._gather(dataset, task, None, arguments)

    def over(self, extent: DatasetExtent, task: "Task[_Arguments, _Statistic]", *arguments: Any) -> _Statistic:
        """Return the merged results of a task over a dataset of known extent."""
        number = next(i for i, data in enumerate(self.problem.datasets) if data is extent.dataset)
        result = self._gather(number, task, extent.places, arguments)
        assert result is not None
        return result

    def _gather(
        self,
        dataset: int,
        task: Callable[..., _Statistic],
        places: Sequence[PartPlace] | None,
        arguments: Sequence[Any],
    ) -> _Statistic | None:
        if self.problem.partitions is not None:
            return self._gather_partitions(dataset, task, places, arguments)
        parts = self.problem.parts(self.problem.bind(self.problem.datasets[dataset]))
        return _gather_parts(self.evaluator.over, parts, self.evaluator, task, places, arguments)

    def _gather_partitions(
        self,
        dataset: int,
        task: Callable[..., _Statistic],
        places: Sequence[PartPlace] | None,
        arguments: Sequence[Any],
    ) -> _Statistic | None:
        partitions = self.problem.partitions
        assert partitions is not None
        own = partitions_of(self.problem, dataset)
        remaining = iter(places or ())
        # in the first pass the numbers of parts are not known yet, nor are the places
        counts = self._counts.get(dataset, [0] * len(own))
        items = [
            pickle_content((partition, [next(remaining) for _ in range(count)] if places else None))
            for partition, count in zip(own, counts, strict=True)
        ]
        results = partitions.runner.map(run_part_task, self._shared, items, pickle_content((task, *arguments)))
        # filled while results come in, in the order of the partitions
        known = self._counts[dataset] = []

        def statistics() -> Iterator[_Statistic]:
            for statistic, count in results:
                known.append(count)
                yield statistic

        return merge_all(statistics())


def _gather_parts(
    evaluate: Callable[[BoundPart], EvaluatedPart],
    parts: Sequence[BoundPart],
    evaluator: PartEvaluator,
    task: Callable[..., _Statistic],
    places: Sequence[PartPlace] | None,
    arguments: Sequence[Any],
) -> _Statistic:
    def work(pair: tuple[BoundPart, PartPlace]) -> _Statistic:
        part, place = pair
        return task(evaluator, evaluate(part), place, *arguments)

    return gather(work, list(zip(parts, places or [PartPlace()] * len(parts), strict=True)))


def run_part_task(shared: bytes, item: bytes, arguments: bytes) -> Any:
    """Return the merged results of a task over the parts of one partition, and their number."""
    recordings, (skeleton, before, after) = shared_content(shared)
    partition, places = pickle.loads(item)
    task, *rest = pickle.loads(arguments)
    evaluator = skeleton.once("part evaluator", lambda problem: PartEvaluator(problem, before, after))
    problem = skeleton.over(StoredDatasets(recordings, partition.parts))
    parts = [part for data in problem.datasets for part in problem.parts(problem.bind(data))]
    return _gather_parts(evaluator.evaluate, parts, evaluator, task, places, rest), len(parts)
