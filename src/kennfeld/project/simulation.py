"""Simulation of the function of a project over its datasets: as a whole, or part by part."""

import pickle
from collections.abc import Collection, Iterator
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import map_in_order
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.domain.file_spans import short_names
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.problem.partitions import Part, Partition, Partitions, StoredDatasets, shared_content
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.quality.surrogate_calls import SurrogateCalls
from kennfeld.optimize.search.isolated_call import isolated
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.bound_parts import BoundPart
from kennfeld.preprocessing.skipped_samples import SkippedSamples
from kennfeld.project.initial_calibration import describe_parameter
from kennfeld.project.simulated_channels import complete, renamed_inputs

if TYPE_CHECKING:
    from kennfeld.surrogate.surrogate_file import Surrogate
    from kennfeld.surrogate.surrogate_models import DynamicSurrogate


@isolated
def simulate_problem(problem: Problem, parameters: ParameterSet | None) -> list[Dataset]:
    """Return the named nodes and target channels over every dataset; a target named like a node gets a suffix."""
    values = replace_parameters(problem, parameters)
    compiled = NodeSimulator(problem.model.graph, values)
    return [_simulate_dataset(problem, problem.bind(data), values, compiled) for data in problem.datasets]


def _simulate_dataset(problem: Problem, bound: BoundDataset, values: ParameterSet, compiled: NodeSimulator) -> Dataset:
    """Simulate a whole dataset, and add what is skipped to its findings."""
    simulated, skipped = _simulate_bound(problem, bound, values, compiled), _skipped(problem, bound)
    if skipped is None:
        return simulated
    return replace(simulated, findings=(skipped.finding(Location(f"dataset {bound.dataset.name}")),))


@dataclass(frozen=True)
class Extent:
    """The channels that a simulation has beside nodes and targets.

    Attributes:
        deviation: the predictive deviation of each surrogate.
        complete: the inputs of the function, and the error of each criterion: node minus target.
    """

    deviation: bool = False
    complete: bool = False


NODES_AND_TARGETS = Extent()


@dataclass(frozen=True, eq=False)
class SimulatedPart:
    """The simulation of some samples of a dataset; `piece` counts the pieces before them."""

    data: Dataset
    piece: int


class Simulation:
    """The simulation of all datasets of a problem, computed part by part, so that it need not fit into memory.

    Attributes:
        name: the name of the function.
        units: of all channels, by name.
        samples: number of samples of each dataset, by its name; with data in partitions, of those simulated so far.
        files: the short name of each file, by its path or address.
        skipped: the samples of each dataset that are not simulated, by its name, as far as they are known.
        without_deviation: surrogates whose deviation is asked for and not known.
    """

    def __init__(self, problem: Problem, parameters: ParameterSet | None, *, deviation: bool = False) -> None:
        self._problem, self._values = problem, replace_parameters(problem, parameters)
        self._extent, self.name = Extent(deviation), problem.model.name
        self._compiled = NodeSimulator(problem.model.graph, self._values)
        whole = problem.partitions is None
        self.samples = {data.name: problem.bind(data).shown.count if whole else 0 for data in problem.datasets}
        skipped = (_skipped(problem, problem.bind(data)) for data in problem.datasets if whole)
        self.skipped = {each.dataset: each for each in skipped if each is not None}
        self.files = short_names(list(_paths(problem)))
        units = problem.model.graph.units
        self.units = {name: units.get(name, "") for name in problem.model.graph.names}
        self.without_deviation = [s.name for s in problem.model.surrogates if deviation and s.uncertainty is None]
        if deviation:
            self.units |= {_deviation_name(s): s.units[-1] if s.units else "" for s in _uncertain(problem)}
        for data in problem.datasets:
            for channel in _targets(problem, data, self.units):
                self.units.setdefault(channel.name, channel.unit)

    def completed(self) -> "Simulation":
        """Return the same simulation with the inputs of the function and the errors, which describe themselves.

        They are channels of its parts, and their units are not among `units`.
        """
        other = copy(self)
        other._extent = replace(self._extent, complete=True)
        return other

    def save(self, path: str | Path) -> Path:
        """Write the simulation in the format of the extension: .parquet, .csv, .mf4 or .mat.

        Tables have nodes and targets of all datasets, one after the other. MDF and MATLAB files have one group or
        struct for each recording, with the inputs of the function and the errors, too.

        Raises:
            InputError: the extension is unknown, a package is missing, or the file cannot be written.
        """
        from kennfeld.project.simulation_files import write_simulation

        return write_simulation(self, path, follow=True)

    def parts(self) -> Iterator[SimulatedPart]:
        """Yield the parts of all datasets in order."""
        if self._problem.partitions is not None:
            yield from self._partitions(self._problem.partitions)
            return
        for data in self._problem.datasets:
            yield from map_in_order(self._part, self._problem.parts(self._problem.bind(data)))

    def _part(self, part: BoundPart) -> SimulatedPart:
        data = _simulate_bound(self._problem, part.bound, self._values, self._compiled, self._extent)
        return SimulatedPart(data, part.piece)

    def _partitions(self, partitions: Partitions) -> Iterator[SimulatedPart]:
        """Yield the parts of all partitions, which are simulated by their runner."""
        # a stable sort: partitions of a dataset stay in the order of their samples
        ordered = sorted([*partitions.training, *partitions.test], key=_dataset_of)
        shared = partitions.share((self._problem.skeleton, self._values, self._extent))
        pieces = [0] * len(self._problem.datasets)
        for partition, parts in zip(ordered, partitions.map(simulate_partition, shared, ordered), strict=True):
            number = _dataset_of(partition)
            name = self._problem.datasets[number].name
            for data, continues, skipped in parts:
                # a part that begins within a piece shares its number with the part before
                before = max(pieces[number] - continues, 0)
                self.samples[name] += data.samples
                if skipped is not None:
                    self.skipped[name] = replace(skipped, dataset=name).joined(self.skipped.get(name))
                pieces[number] = before + data.piece_starts.size
                yield SimulatedPart(replace(data, name=name), before)


def _paths(problem: Problem) -> Iterator[str]:
    """Yield the path or address of each file of all datasets."""
    if problem.partitions is None:
        yield from (name for data in problem.datasets if data.files is not None for name in data.files.names)
        return
    for partition in (*problem.partitions.training, *problem.partitions.test):
        yield from (part.source.address for part in partition.parts)


def _dataset_of(partition: Partition) -> int:
    return partition.parts[0].dataset


def simulate_partition(shared: bytes, item: bytes, _: bytes) -> list[tuple[Dataset, bool, SkippedSamples | None]]:
    """Simulate each part of a partition; return also if it continues the piece before it, and what it skips."""
    recordings, (skeleton, values, extent) = shared_content(shared)
    parts = pickle.loads(item).parts
    problem = skeleton.over(StoredDatasets(recordings, parts))
    compiled = problem.once("simulator", lambda problem: NodeSimulator(problem.model.graph, values))
    simulated = []
    for data, part in zip(problem.datasets, parts, strict=True):
        nodes = _simulate_bound(problem, problem.bind(data), values, compiled, extent)
        # by the whole file, since a part alone would begin a piece
        starts = _starts_in_file(problem.bind(recordings.file(part)).shown, part)
        continues = 0 not in starts or (data.time is None and not problem.model.graph.states)
        nodes = replace(nodes, piece_starts=np.union1d([0], starts).astype(np.int64))
        simulated.append((nodes, continues, _skipped(problem, problem.bind(data))))
    return simulated


def _starts_in_file(file: BoundDataset, part: Part) -> Int:
    """Return the samples of a part at which pieces of its file begin, among those that are simulated."""
    first, last = np.searchsorted(np.arange(file.dataset.samples)[file.kept], [part.first, part.last])
    return np.asarray(file.starts[slice(*np.searchsorted(file.starts, [first, last]))] - first)


def _simulate_bound(
    problem: Problem,
    bound: BoundDataset,
    values: ParameterSet,
    compiled: NodeSimulator,
    extent: Extent = NODES_AND_TARGETS,
) -> Dataset:
    nodes = compiled.dataset(bound, values)
    if extent.deviation:
        nodes = nodes.with_channels(*_deviations(problem, bound, values))
    shown, data = bound.shown, bound.dataset
    # names of inputs are taken only if inputs are written
    taken = {*nodes, *renamed_inputs(problem)} if extent.complete else nodes
    targets = [replace(c, values=shown.at_kept(c.values)) for c in _targets(problem, data, taken)]
    simulated = complete(problem, shown, nodes, targets) if extent.complete else nodes.with_channels(*targets)
    return replace(
        simulated,
        use=data.use,
        weight=data.weight,
        scored=shown.scored,
        files=None if data.files is None else data.files.picked(shown.kept),
        start_time=data.start_time,
        recorded=None if data.recorded is None else shown.at_kept(data.recorded),
    )


def _skipped(problem: Problem, bound: BoundDataset) -> SkippedSamples | None:
    return SkippedSamples.of(bound, problem.channels, restarts=bool(problem.graph.states))


def _uncertain(problem: Problem) -> "list[Surrogate]":
    """Return the surrogates of a model whose predictions have a known deviation."""
    return [surrogate for surrogate in problem.model.surrogates if surrogate.uncertainty is not None]


def _deviation_name(surrogate: "Surrogate") -> str:
    return f"{surrogate.name} (deviation)"


def _deviations(problem: Problem, bound: BoundDataset, values: ParameterSet) -> Iterator[Channel]:
    """Yield the predictive deviation of each surrogate, the largest of its calls at a sample."""
    for surrogate in _uncertain(problem):
        column = _largest_deviation(surrogate, SurrogateCalls(problem, values, surrogate.name), bound)
        yield Channel(_deviation_name(surrogate), column, surrogate.units[-1] if surrogate.units else "")


def _largest_deviation(surrogate: "Surrogate", calls: SurrogateCalls, bound: BoundDataset) -> Float:
    """Return the largest deviation of all calls at each sample, Float[samples]."""
    from kennfeld.surrogate.surrogate_models import DynamicSurrogate, StaticSurrogate

    blocks = (points for _, points in calls.points(bound))  # Float[samples, inputs] of each call
    if isinstance(surrogate, DynamicSurrogate):
        # a call that begins at another output than the surrogate's own has it from a measurement
        measured = (first != surrogate.start for first in calls.first_outputs)
        runs = [
            _recursion_deviation(surrogate, np.concatenate(parts), bound, measured=known)
            for parts, known in zip(zip(*blocks, strict=True), measured, strict=False)
        ]
        return np.max(runs, axis=0) if runs else np.empty(0)
    deviation_at = surrogate.deviation if isinstance(surrogate, StaticSurrogate) else surrogate.deviation_at
    parts = [np.max([deviation_at(x) for x in points], axis=0) for points in blocks]
    return np.concatenate(parts) if parts else np.empty(0)


def _recursion_deviation(surrogate: "DynamicSurrogate", points: Float, bound: BoundDataset, *, measured: bool) -> Float:
    """Return the deviation of one call, Float[samples]; its errors begin anew with each piece.

    `measured` states whether the outputs before a piece are.
    """
    if bound.hold is not None:  # a point stays in its settled state as long as it is held
        settled: Float = surrogate.deviation_along(points[None], measured=measured, repeats=bound.hold.samples)[-1]
        return settled
    pieces = np.split(points, bound.starts[bound.starts > 0])
    return np.concatenate([surrogate.deviation_along(piece[:, None], measured=measured)[:, 0] for piece in pieces])


def _targets(problem: Problem, data: Dataset, nodes: Collection[str]) -> list[Channel]:
    """Return the target channels of a dataset, renamed if a node has their name."""
    names = dict.fromkeys(c.target.name for c in problem.criteria if c.target.kind == "channel")
    return [
        Channel(f"{name} (target)" if name in nodes else name, data[name].values, data[name].unit)
        for name in names
        if name in data
    ]


def replace_parameters(problem: Problem, parameters: ParameterSet | None) -> ParameterSet:
    """Replace parameters of a problem by those of the same name, which must have the same number of axes.

    What the format of their file cannot state, such as extrapolation, stays as it is in the problem.

    Raises:
        InputError: one does not fit the function.
    """
    if parameters is None:
        return problem.parameters
    needed = problem.model.graph.parameters
    errors = [
        Finding(
            Location("parameters"),
            f"{name} is {describe_parameter(parameters[name])}, but the function looks it up with {count} coordinates",
        )
        for name, count in needed.items()
        if name in parameters and parameters[name].coordinates != count
    ]
    if errors:
        raise InputError(errors)
    try:
        return problem.parameters.merged(parameters.completed(problem.parameters))
    except ArgumentError as error:
        raise InputError.of(Location("parameters"), str(error)) from None
