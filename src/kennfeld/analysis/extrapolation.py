"""Use of data-driven models outside the range of their training data."""

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import finite_or_none
from kennfeld.base.sample_statistics import merge_all
from kennfeld.domain.dataset import Dataset, Use
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.problem.partitions import StoredDatasets, shared_content
from kennfeld.optimize.problem.problem import Problem, partitions_of
from kennfeld.optimize.quality.surrogate_calls import SurrogateCalls
from kennfeld.preprocessing.binding import BoundDataset

if TYPE_CHECKING:
    from kennfeld.surrogate.surrogate_file import Surrogate
    from kennfeld.surrogate.validity import Validity


@dataclass(frozen=True)
class Farthest:
    """The sample at which a surrogate is farthest outside its validity range; sample and piece count from 1.

    `input` is the one farthest beyond an end of the training data, in lengths of the validity range, with its `value`
    and that `end`. It is empty if each input is within its range but their combination is far from the training data.
    """

    sample: int
    piece: int
    time: float | None
    input: str = ""
    value: float = np.nan
    end: float = np.nan

    @property
    def sentence(self) -> str:
        """The reason as a clause: `throttle is 15.2, above 15`."""
        if not self.input:
            return "each input is within its range, but their combination is far from the training data"
        if not np.isfinite(self.value):
            return f"{self.input} is not finite"
        value, end = _apart(self.value, self.end)
        return f"{self.input} is {value}, {'above' if self.value > self.end else 'below'} {end}"


@dataclass(frozen=True)
class Extrapolation:
    """The samples of a dataset at which a surrogate is evaluated outside its validity range.

    `outside` is None if it has no validity range, `worst` is None if it stays inside; `several` is True if the dataset
    has more than one piece. Points held until the model has settled count once, in their settled state.

    >>> worst = Farthest(616, 1, 12.3, "throttle", 15.2, 15.0)
    >>> print(Extrapolation("engine", "set values", "training", 1500, 132, worst))  # doctest: +NORMALIZE_WHITESPACE
    engine is used outside its training data at 132 of 1500 samples of set values (8.8 %),
    worst at 12.3 s, where throttle is 15.2, above 15
    """

    name: str
    dataset: str
    use: Use
    samples: int
    outside: int | None
    worst: Farthest | None = None
    several: bool = False

    @property
    def share(self) -> float:
        """Share of the samples; 0 if unknown."""
        return (self.outside or 0) / max(self.samples, 1)

    @property
    def place(self) -> str:
        """Location of the worst sample: `12.3 s`, `0.5 s of piece 2`, `sample 17`; empty if it stays inside."""
        if self.worst is None:
            return ""
        if self.worst.time is None:
            return f"sample {self.worst.sample}"
        return f"{self.worst.time:.6g} s" + f" of piece {self.worst.piece}" * self.several

    def __str__(self) -> str:
        if self.outside is None:
            return f"{self.name} has no validity range"
        if self.worst is None:
            return f"{self.name} stays within its training data over {self.samples} samples of {self.dataset}"
        counted = f"at {self.outside} of {self.samples} samples of {self.dataset} ({_percent(self.share)})"
        worst = f"worst at {self.place}, where {self.worst.sentence}"
        return f"{self.name} is used outside its training data {counted}, {worst}"

    def as_json(self) -> dict[str, Any]:
        """Return a row of `surrogates` in `result.json`; numbers that are not finite are None."""
        worst = self.worst and {
            **{name: finite_or_none(value) for name, value in vars(self.worst).items()},
            "sentence": self.worst.sentence,
        }
        rest = {name: getattr(self, name) for name in ("dataset", "use", "samples", "outside")}
        return {"name": self.name, **rest, "worst": worst}


def find_extrapolation(problem: Problem, parameters: ParameterSet) -> tuple[Extrapolation, ...]:
    """Find where the surrogates of a model are used outside their validity range, by surrogate and dataset.

    Args:
        problem: the problem.
        parameters: all that the model looks up, including the expansions of its surrogates, as in a `Result`.

    Returns:
        A row per surrogate and dataset; a sample with several calls counts once.

    >>> from kennfeld import Project
    >>> problem = Project.read("kennfeld.toml").problem()
    >>> find_extrapolation(problem, problem.parameters)  # the torque model calls no surrogate
    ()
    """
    return tuple(
        _row(data, surrogate, uses)
        for number, surrogate in enumerate(problem.model.surrogates)
        for data, uses in zip(problem.datasets, _search(problem, parameters, number), strict=True)
    )


def _row(data: Dataset, surrogate: "Surrogate", uses: "_Uses") -> Extrapolation:
    several = data.time is not None and uses.pieces > 1
    outside = None if surrogate.validity is None else uses.outside
    return Extrapolation(surrogate.name, data.name, data.use, uses.samples, outside, uses.worst, several)


def _search(problem: Problem, parameters: ParameterSet, number: int) -> "Iterator[_Uses]":
    """Yield the uses of one surrogate, by number, over each dataset."""
    if problem.partitions is None:
        calls = _Calls(problem, parameters, problem.model.surrogates[number])
        yield from (calls.over(problem.bind(data)) for data in problem.datasets)
        return
    shared = problem.partitions.share((problem.skeleton, parameters))
    for dataset in range(len(problem.datasets)):
        recordings = partitions_of(problem, dataset)
        yield merge_all(problem.partitions.map(search_partition, shared, recordings, number)) or _Uses()


def search_partition(shared: bytes, item: bytes, arguments: bytes) -> "_Uses":
    """Return the uses of a surrogate over one partition."""
    recordings, (skeleton, parameters) = shared_content(shared)
    (number,) = pickle.loads(arguments)
    surrogate = skeleton.model.surrogates[number]
    calls = skeleton.once(f"calls of {surrogate.name}", lambda problem: _Calls(problem, parameters, surrogate))
    problem = skeleton.over(StoredDatasets(recordings, pickle.loads(item).parts))
    uses: _Uses | None = merge_all(calls.over(problem.bind(data)) for data in problem.datasets)
    assert uses is not None
    return uses


@dataclass
class _Uses:
    """The uses of a surrogate over some samples; `size` counts also those that are not kept."""

    samples: int = 0
    size: int = 0
    pieces: int = 0
    outside: int = 0
    score: tuple[float, float] = (0.0, 0.0)  # of the farthest
    worst: Farthest | None = None

    def merge(self, later: "_Uses") -> None:
        """Take in the uses over the following samples."""
        # of equal scores the first stays, whatever the parts
        if later.worst is not None and (self.worst is None or later.score > self.score):
            number, piece = self.size + later.worst.sample, self.pieces + later.worst.piece
            self.worst, self.score = replace(later.worst, sample=number, piece=piece), later.score
        self.samples += later.samples
        self.size += later.size
        self.pieces += later.pieces
        self.outside += later.outside


class _Calls:
    """The calls of one surrogate, and where they leave its validity range."""

    def __init__(self, problem: Problem, parameters: ParameterSet, surrogate: "Surrogate") -> None:
        self.surrogate, self.calls = surrogate, SurrogateCalls(problem, parameters, surrogate.name)

    def over(self, bound: BoundDataset) -> "_Uses":
        """Return the uses of the surrogate over a dataset or a part of it."""
        uses = _Uses(bound.shown.count, bound.dataset.samples, bound.shown.starts.size)
        if self.surrogate.validity is None:
            return uses
        search = _FarthestPoint(self.surrogate.validity)
        for at, points in self.calls.points(bound):
            search.add(at, points)
        uses.outside, uses.score, uses.worst = search.outside, search.score, self._farthest(bound, search)
        return uses

    def _farthest(self, bound: BoundDataset, search: "_FarthestPoint") -> Farthest | None:
        if not search.outside:
            return None
        # `at` numbers kept samples, the row numbers all
        sample, time = int(bound.kept[search.at]), bound.dataset.time
        piece = int(np.searchsorted(bound.starts, search.at, "right")) if bound.hold is None else 1
        stamp = None if time is None else float(time[sample])
        validity, point = search.validity, search.point
        beyond = _beyond(validity, point)
        d = int(beyond.argmax())
        if not beyond[d] > 0:
            return Farthest(sample + 1, piece, stamp)
        end = validity.least[d] if point[d] < validity.least[d] else validity.most[d]
        name, lag = surrogate_coordinates(self.surrogate)[d]
        label = f"{name} {count_noun(lag, 'sample')} before" if lag else name
        return Farthest(sample + 1, piece, stamp, label, float(point[d]), float(end))


class _FarthestPoint:
    """Counts the samples outside, and finds the farthest: beyond an end, or else by the distance of the validity."""

    def __init__(self, validity: "Validity") -> None:
        self.validity, self.outside = validity, 0
        self.at, self.point, self.score = 0, np.empty(0), (0.0, 0.0)

    def add(self, at: Int, calls: Sequence[Float]) -> None:
        """Add samples by number, and the points Float[samples, inputs] of each call."""
        outside = np.zeros(at.size, dtype=bool)
        for points in calls:
            distance = self.validity.distance(points)
            beyond = distance > self.validity.threshold
            outside |= beyond
            if beyond.any():
                self._keep(at[beyond], points[beyond], distance[beyond])
        self.outside += int(np.count_nonzero(outside))

    def _keep(self, at: Int, points: Float, distance: Float) -> None:
        excess = _beyond(self.validity, points).max(axis=-1)
        # sorted by excess, then distance; of equal ones the earliest sample
        i = int(np.lexsort((-at, distance, excess))[-1])
        score = float(excess[i]), float(distance[i])
        if score > self.score:
            self.at, self.point, self.score = int(at[i]), points[i], score


def _beyond(validity: "Validity", points: Float) -> Float:
    """Return the distance of each coordinate beyond the training data, in lengths: Float[..., inputs]."""
    with np.errstate(invalid="ignore", over="ignore"):
        past = np.maximum(validity.least - points, points - validity.most) / validity.lengths
    # a missing input is the worst of all
    return np.where(np.isnan(past), np.inf, np.maximum(past, 0.0))


def surrogate_coordinates(surrogate: "Surrogate") -> list[tuple[str, int]]:
    """Return the channel and the lag, in samples, of each coordinate of a surrogate."""
    from kennfeld.surrogate.filtered_surrogate import FilteredSurrogate
    from kennfeld.surrogate.surrogate_models import DynamicSurrogate

    if isinstance(surrogate, FilteredSurrogate):
        filters = [f" filtered over {T:.4g} s" for T in surrogate.time_constants]
        return [(f"{name}{text}", surrogate.delay) for text in ("", *filters) for name in surrogate.inputs]
    if not isinstance(surrogate, DynamicSurrogate):
        return [(name, 0) for name in surrogate.inputs]
    delayed = [(surrogate.output, surrogate.output_lags), *zip(surrogate.inputs, surrogate.lags, strict=True)]
    return [(name, lag) for name, lags in delayed for lag in lags]


def _apart(value: float, end: float) -> tuple[str, str]:
    """Format two numbers with as few digits as distinguish them, at least 4.

    >>> _apart(15.2, 15.0), _apart(15.00001, 15.0)
    (('15.2', '15'), ('15.00001', '15'))
    """
    for digits in range(4, 17):
        shown = f"{value:.{digits}g}", f"{end:.{digits}g}"
        if shown[0] != shown[1]:
            return shown
    return repr(value), repr(end)


def _percent(share: float) -> str:
    """Format a share in percent; 100 % and 0 % only if exact.

    >>> _percent(0.088), _percent(1e-6), _percent(0.9999), _percent(1.0)
    ('8.8 %', '0.0001 %', '99.9 %', '100 %')
    """
    value = 100 * share if share == 1 else min(100 * share, 99.9)
    return f"{value:.{3 if value >= 99 else 2}g} %"
