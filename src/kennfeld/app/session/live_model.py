"""A problem compiled once and evaluated for any values of its parameters, as fast as they are dragged."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from kennfeld.app.session.lookup_index import LookupIndex
from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.problem.problem import Problem, difference
from kennfeld.optimize.quality.lookup_coverage import Lookups, moving_parameters, unmoved_tables
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.sums.sample_slopes import SampleSlopes
from kennfeld.preprocessing.binding import BoundDataset


@dataclass(frozen=True)
class LiveScore:
    """Errors of one criterion over the datasets of one use, in the unit of its target.

    Attributes:
        criterion: number of the criterion.
        use: training or test.
        samples: number of scored samples.
        rmse: NaN without samples.
        mean: mean error, model minus measurement.
        largest: largest absolute error.
    """

    criterion: int
    use: str
    samples: int
    rmse: float
    mean: float
    largest: float


class LiveDataset:
    """One dataset of the problem, as it is drawn: samples over positions.

    Attributes:
        bound: the dataset bound to the model; the samples are those that the model runs on.
        position: place of each sample on the axis of the plots, Float[samples]: time in s, piece after piece, or the
            number of a steady-state point.
        targets: Float[criteria, samples]; NaN at samples that are not scored.
    """

    def __init__(self, problem: Problem, dataset_number: int) -> None:
        self.number = dataset_number
        self.bound: BoundDataset = problem.bind(problem.datasets[dataset_number])
        self._shown = self.bound.shown
        self.targets: Float = np.array([problem.target(criterion, self.bound) for criterion in problem.criteria])
        self.position, self.offsets = _positions(self._shown)

    @property
    def name(self) -> str:
        """Name of the dataset."""
        return self.bound.dataset.name

    @property
    def use(self) -> str:
        """Training or test."""
        return self.bound.dataset.use

    @property
    def count(self) -> int:
        """Number of samples that are drawn."""
        return self._shown.count

    @property
    def timed(self) -> bool:
        """True if the samples have time stamps."""
        return self._shown.dataset.time is not None

    @property
    def starts(self) -> Int:
        """First sample of each piece."""
        return self._shown.starts

    def channel(self, name: str) -> Float:
        """Return a channel of the dataset over the samples, Float[samples], in its own unit."""
        return self._shown.channel(name)

    def at_samples(self, values: Float) -> Float:
        """Return values of all samples of the dataset, at those that are drawn."""
        return self._shown.at_kept(values)

    def last_simulated(self, sample: int) -> int:
        """Return the last simulated sample that a drawn sample stands for."""
        hold = self.bound.hold
        return sample if hold is None else (sample + 1) * hold.samples - 1

    def at_sample(self, sample: int, simulate: Callable[[BoundDataset, int], Float]) -> Float:
        """Return what `simulate` returns for a simulated sample; for a held point the mean over its window."""
        last, hold = self.last_simulated(sample), self.bound.hold
        window = 1 if hold is None else hold.window
        mean: Float = np.mean([simulate(self.bound, at) for at in range(last + 1 - window, last + 1)], axis=0)
        return mean

    def as_shown(self, values: Float) -> Float:
        """Reduce Float[..., simulated samples] to what is drawn, Float[..., samples]: one value per point if held."""
        hold = self.bound.hold
        return values if hold is None else hold.mean(np.atleast_2d(values)).reshape(*values.shape[:-1], -1)

    def at_ends(self, values: Float) -> Float:
        """Return Float[..., simulated samples] at the last sample of each held point, Float[..., samples]."""
        hold = self.bound.hold
        return values if hold is None else values[..., hold.samples - 1 :: hold.samples]


def _axes(parameters: ParameterSet) -> tuple[object, ...]:
    """Return all breakpoints, which compiled code holds as constants."""
    return tuple(
        (table.extrapolation, *(axis.breakpoints.tobytes() for axis in table.axes)) for table in parameters.parameters
    )


def _positions(bound: BoundDataset) -> tuple[Float, Float]:
    """Return the position of each sample, and how far each piece is shifted."""
    time = bound.dataset.time
    if time is None:
        return np.arange(bound.count, dtype=np.float64), np.zeros(max(bound.starts.size, 1))
    time = time[bound.kept]
    ends = np.append(bound.starts[1:], time.size)
    offsets, end = np.zeros(bound.starts.size), None
    for i, (first, last) in enumerate(zip(bound.starts, ends, strict=True)):
        # time starts again with this piece: it is drawn behind the last one, a mean step apart
        if end is not None and time[first] <= end:
            offsets[i] = end - time[first] + (time[last - 1] - time[first]) / max(last - first, 1)
        end = time[last - 1] + offsets[i]
    return time + np.repeat(offsets, ends - bound.starts), offsets


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The model over all data for one set of values.

    Attributes:
        parameters: the values.
        errors: model minus target by dataset, Float[criteria, samples]; NaN at samples that are not scored.
        outputs: the nodes that the criteria score, by dataset, Float[criteria, samples].
        uses: training or test, by dataset.
    """

    parameters: ParameterSet
    errors: tuple[Float, ...]
    outputs: tuple[Float, ...]
    uses: tuple[str, ...]

    def measured(self, dataset: int, criterion: int) -> Float:
        """Return what a criterion compares its node with, which may be another node; NaN where it is not scored."""
        measured: Float = self.outputs[dataset][criterion] - self.errors[dataset][criterion]
        return measured

    @cached_property
    def scores(self) -> tuple[LiveScore, ...]:
        """A score for each criterion and use that has samples."""
        criteria = range(self.errors[0].shape[0]) if self.errors else ()
        return tuple(
            score(
                number, use, [errors[number] for errors, own in zip(self.errors, self.uses, strict=True) if own == use]
            )
            for number in criteria
            for use in ("training", "test")
            if use in self.uses
        )


def score(criterion: int, use: str, errors: Sequence[Float]) -> LiveScore:
    """Score errors, Float[samples] by dataset; NaN is not scored."""
    known = [finite_values(part) for part in errors]
    count = sum(part.size for part in known)
    if not count:
        return LiveScore(criterion, use, 0, np.nan, np.nan, np.nan)
    squares = sum(float(np.einsum("i,i", part, part)) for part in known)  # without the threads of BLAS
    total = sum(float(part.sum()) for part in known)
    largest = max(float(np.abs(part).max(initial=0.0)) for part in known)
    return LiveScore(criterion, use, count, float(np.sqrt(squares / count)), total / count, largest)


def finite_values(values: Float) -> Float:
    """Return the finite values; without a copy if all are."""
    known = np.isfinite(values)
    return values if known.all() else values[known]


class LiveModel:
    """A problem whose parts that no value changes are computed once.

    Attributes:
        recordings: the datasets, as they are drawn.
        unmoved: tables that are looked up at the same places whatever the values are.
        indexes: their lookups, filled when they are asked for.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.recordings = [LiveDataset(problem, number) for number in range(len(problem.datasets))]
        self._differences = [difference(number) for number in range(len(problem.criteria))]
        self._outputs = [criterion.node for criterion in problem.criteria]
        self._compiled: dict[tuple[object, ...], NodeSimulator] = {}
        self._slopes: dict[tuple[object, ...], SampleSlopes] = {}  # of the last breakpoints
        self._lookups: tuple[tuple[object, ...], Lookups] | None = None  # the last ones, with their breakpoints
        self.unmoved, self._moving = unmoved_tables(problem.graph), moving_parameters(problem.graph)
        self.indexes: dict[tuple[object, ...], LookupIndex] = {}  # of these tables

    def evaluate(self, parameters: ParameterSet) -> Evaluation:
        """Simulate all datasets; compiled code is used again unless breakpoints have changed."""
        simulator, criteria = self._simulator((*self._differences, *self._outputs), parameters), len(self._differences)
        errors, outputs = [], []
        for recording in self.recordings:
            values = simulator.values(recording.bound, parameters)
            # target nodes are subtracted in the graph, measured targets here
            # the graph averages differences, the last one of a held point is scored
            errors.append(recording.at_ends(values[:criteria] - recording.targets))
            outputs.append(recording.as_shown(values[criteria:]))
        return Evaluation(parameters, tuple(errors), tuple(outputs), tuple(each.use for each in self.recordings))

    def nodes(self, recording: LiveDataset, names: Sequence[str], parameters: ParameterSet) -> Float:
        """Simulate named nodes of the function over the samples of a dataset, Float[names, samples]."""
        simulator = self._simulator(tuple(names), parameters)
        return recording.as_shown(simulator.values(recording.bound, parameters))

    def nodes_at(self, recording: LiveDataset, names: Sequence[str], sample: int, parameters: ParameterSet) -> Float:
        """Simulate named nodes of the function at one sample of a dataset, Float[names]."""
        simulator = self._simulator(tuple(names), parameters)
        return recording.at_sample(sample, lambda bound, at: simulator.at(bound, at, parameters))

    def slopes_at(self, recording: LiveDataset, sample: int, parameters: ParameterSet) -> Mapping[str, Float]:
        """Compute by table the slopes of all criteria at one sample of a dataset, see `SampleSlopes.at`."""
        key = _axes(parameters)
        if key not in self._slopes:
            self._slopes = {key: SampleSlopes(self.problem, parameters)}
        return self._slopes[key].at(recording.bound, recording.last_simulated(sample), parameters)

    def unit(self, criterion: int) -> str:
        """Return the unit of the errors of a criterion."""
        return self.problem.error_unit(self.problem.criteria[criterion])

    def moves_lookups(self, before: ParameterSet, after: ParameterSet) -> bool:
        """Return True if tables may be looked up at other places, or between other breakpoints, than before."""
        return any(
            not table.has_grid_of(before[table.name])
            or (table.name in self._moving and not np.array_equal(table.values, before[table.name].values))
            for table in after.parameters
        )

    def lookups(self, parameters: ParameterSet) -> Lookups:
        """Return where the function looks up its tables; code is compiled again only if breakpoints have changed."""
        key = _axes(parameters)
        known = self._lookups
        lookups = (
            known[1].at(parameters) if known is not None and known[0] == key else Lookups(self.problem, parameters)
        )
        self._lookups = key, lookups
        return lookups

    def _simulator(self, names: tuple[str, ...], parameters: ParameterSet) -> NodeSimulator:
        key = (names, _axes(parameters))
        if key not in self._compiled:
            if len(self._compiled) >= 24:
                self._compiled.pop(next(iter(self._compiled)))
            self._compiled[key] = NodeSimulator(self.problem.graph, parameters, list(names))
        return self._compiled[key]
