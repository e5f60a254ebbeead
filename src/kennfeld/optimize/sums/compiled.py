"""The compiled form of a calibration problem: kernel, samples and roughness."""

import pickle
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float, Int
from kennfeld.base.code_digest import code_digest
from kennfeld.base.content_digest import digest_of
from kennfeld.domain.free_axes import AxisKey
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph
from kennfeld.graph.call_columns import CalledColumns, read_calls, unlocked_values
from kennfeld.graph.external_function import is_sequential, living_functions
from kennfeld.graph.lookup_lowering import LoweredGraph, lower_lookups
from kennfeld.graph.partition import GraphPartition, partition_graph
from kennfeld.graph.traversal import dependents
from kennfeld.native.accumulator import Accumulator
from kennfeld.native.kernel import Kernel
from kennfeld.native.sample_loop import Output
from kennfeld.native.samples import Piece, Samples, chain_samples, join_samples
from kennfeld.native.simulator import Simulator
from kennfeld.optimize.problem.data_form import DataForm, with_step
from kennfeld.optimize.problem.partitions import (
    Part,
    Partition,
    Partitions,
    Recordings,
    StoredDatasets,
    shared_content,
)
from kennfeld.optimize.problem.picked_recordings import count_recordings, pick_recordings
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.structure import Structure
from kennfeld.optimize.problem.table_penalties import Penalty, penalty_of
from kennfeld.optimize.sums.call_sums import CalledFunctions
from kennfeld.optimize.sums.kept_columns import ColumnStorage, RecentColumns, StoredColumns
from kennfeld.optimize.sums.partitioned_sums import PartitionedSums
from kennfeld.optimize.sums.rejected_trials import RejectedTrials
from kennfeld.optimize.sums.remembered_sums import RememberedSums
from kennfeld.optimize.sums.sums import Sums, SumsFactory
from kennfeld.preprocessing.prepared_files import touch
from kennfeld.preprocessing.recording_sources import version_of
from kennfeld.preprocessing.sample_weights import SampleWeights
from kennfeld.preprocessing.samples import SampleAssembly, TrainingSource
from kennfeld.preprocessing.settling import group_points, restart_states, sample_ages
from kennfeld.preprocessing.stored_samples import StoredSamples, in_visiting_order, read_samples, sample_columns

# searches are compared on part of the samples: without memory on this many, or on so many per value if that is more,
SEARCH_SAMPLES, SAMPLES_PER_VALUE = 20_000, 20
# with memory on at least this many pieces, of about this many samples
SEARCH_PIECES, SEARCH_PIECE_SAMPLES = 10, 300_000

Selection = tuple[Callable[..., Samples], tuple[Any, ...]]  # a function of a module, and its further arguments


def smoothable(problem: Problem) -> bool:
    """Return True if the coordinate of a lookup that the criteria need depends on a free parameter.

    Functions that keep memory run through whole trajectories at each evaluation, which several descents would repeat.
    """
    graph = problem.graph
    moving = dependents(graph, lambda node: node.parameter in problem.free_names, through_states=False)
    if not any(node.op == "lookup" and not moving.isdisjoint(node.args) for node in graph.nodes):
        return False  # whatever the criteria need
    lowered = lower_lookups(graph, problem.parameters, problem.free_names)
    needed = partition_graph(lowered.graph, problem.differences, (*problem.free_names, *problem.free_axes)).graph
    if any(is_sequential(node) for node in needed.nodes):
        return False
    return any(any(node.payload.smoothed) for node in needed.nodes if node.op == "interpolate")


class _Code(NamedTuple):
    """A lowered graph, its part that depends on free values, and the kernel and the samples of that part."""

    lowered: LoweredGraph
    split: GraphPartition
    called: CalledColumns
    kernel: Kernel
    assembly: SampleAssembly


def _structure_of_code(problem: Problem, form: DataForm) -> Structure:
    """Return what the code depends on besides `Problem.structure`."""
    losses = tuple((c.scale, c.loss, c.delta) for c in problem.criteria)
    return _fitted(problem), losses, form.restarts, form.step, tuple(form.weighting.inputs.items())


def _fitted(problem: Problem) -> tuple[str | AxisKey, ...]:
    return (*problem.free_names, *problem.free_axes)


def _compile(problem: Problem, form: DataForm, *, smoothed: bool) -> _Code:
    parameters, free, fitted, weighting = problem.parameters, problem.free_names, _fitted(problem), form.weighting
    # order: weights and restarts are part of the graph before lookups are lowered and data-only parts cut off
    weighted = weighting.extend(problem.graph)
    graph = with_step(restart_states(weighted) if form.restarts else weighted, form.step)
    shared = graph is problem.graph and not smoothed
    lowered = problem.lowered if shared else lower_lookups(graph, parameters, free if smoothed else ())
    split = partition_graph(lowered.graph, [*problem.differences, *weighting.inputs.values()], fitted)
    values = (value for name in free for value in unlocked_values(parameters[name]))
    called = read_calls(split.graph, fitted, values)
    reduced = LoweredGraph(called.graph, lowered.axes, lowered.shapes)
    kernel = Kernel(reduced, _outputs(problem, weighting, reduced.graph), parameters, fitted)
    return _Code(lowered, split, called, kernel, SampleAssembly(lowered, split, kernel, parameters))


def _outputs(problem: Problem, weighting: SampleWeights, graph: Graph) -> list[Output]:
    names = graph.names
    weights = {i: names[name] for i, name in weighting.inputs.items()}
    return [
        Output(names[name], c.scale, c.loss, c.delta, weights.get(i))
        for i, (name, c) in enumerate(zip(problem.differences, problem.criteria, strict=True))
    ]


class CompiledProblem:
    """A problem ready for evaluation: data-only parts computed, samples sorted, kernel compiled.

    With `smooth_like`, the exact form of the same problem, lookups whose coordinate depends on a free parameter are
    smoothed, over the samples of its `thinned` form.

    With data in partitions, each is prepared where it is evaluated; `samples` are then those of the excerpts.

    Attributes:
        problem: the problem.
        kernel: its compiled functions.
        samples: its training data.
        sums: evaluates cost and derivatives over the samples, by the implementation `sums_of`, by default native code.
        roughness: the penalty on the free values.
        values: layout of the free and the fixed values.
        start: all of them at the start, Float[values].
        rejected: trial values at which the model failed.
    """

    def __init__(
        self,
        problem: Problem,
        smooth_like: "CompiledProblem | None" = None,
        sums_of: SumsFactory | None = None,
        form: DataForm | None = None,
    ) -> None:
        self.problem = problem
        self.rejected: RejectedTrials = RejectedTrials() if smooth_like is None else smooth_like.rejected
        parameters, free = problem.parameters, problem.free_names
        self.form = form or DataForm.of(problem)
        self.weighting = self.form.weighting
        code = problem.model.once(
            "code" if smooth_like is None else "smoothed code",
            problem.structure and (problem.structure, _structure_of_code(problem, self.form)),
            lambda: _compile(problem, self.form, smoothed=smooth_like is not None),
        )
        self._lowered, self._split, self._called, self.kernel, self._assembly = code
        self.spacings = np.array([(a[-1] - a[0]) / max(a.size - 1, 1) for a in self._lowered.axes] or [0.0])
        self._sums_of: SumsFactory = smooth_like._sums_of if smooth_like else sums_of or Accumulator
        self._smooth_like = smooth_like
        self._selections: tuple[Selection, ...] = ()
        self._storage: ColumnStorage = RecentColumns()
        # with memory, searches are compared over whole recordings, in partitions of their own
        if smooth_like is not None and self.stateful and problem.partitions is not None:
            self.problem = replace(problem, partitions=smooth_like.search_partitions)
        self.values = self.kernel.values
        factors = {name: problem.factors(name) for name in free}
        self.roughness: Penalty = penalty_of(parameters, self.values, factors, problem.restraints)
        self.start = self.values.pack(parameters)
        self._stored: list[tuple[StoredSamples, Part]] = []  # of one partition

    @cached_property
    def _functions(self) -> CalledFunctions:
        return CalledFunctions(self._called, self._lowered, self.problem.parameters, self.values)

    @property
    def stateful(self) -> bool:
        """True if samples are visited in the order of time, because the model has states or calls that have them."""
        return bool(self.kernel.line.states) or self._called.trajectories is not None

    @cached_property
    def samples(self) -> Samples:
        """The training data as the kernel reads them."""
        if self._smooth_like is None:
            return self._gathered()
        if self._is_thinned and self.problem.partitions is not None:
            return self._thinned_partitions
        return self._thin(self._shared(self._smooth_like))

    @cached_property
    def _thinned_partitions(self) -> Samples:
        """Part of the samples of all partitions; kept for other starts."""
        assert self.problem.partitions is not None
        return join_samples(self.each(_thinned_samples, self._search_share(self.problem.partitions.samples)))

    @property
    def _is_thinned(self) -> bool:
        return self._smooth_like is not None and not self.stateful

    @cached_property
    def sums(self) -> Sums:
        """Cost and derivatives over the training data."""
        if self.problem.partitions is None or self._is_thinned:
            return self.sums_over(self.samples)
        return self._sums_over_partitions(self.each)

    @property
    def sample_count(self) -> int:
        """Number of training samples; with partitions, including those that are not evaluated."""
        partitions = self.problem.partitions
        return self.samples.count if partitions is None or self._is_thinned else partitions.samples

    def each(self, task: Callable[..., Any], *arguments: Any) -> Iterator[Any]:
        """Yield `task(compiled, *arguments)` for each partition of the training data, in order.

        Without partitions, once for all data. `task` is a function of a module; the compiled problem that it is given
        has the samples and the datasets of one partition.
        """
        partitions = self.problem.partitions
        if partitions is None:
            yield task(self, *arguments)
            return
        # the latest selection runs innermost: it is made from what the earlier ones have selected
        for select, selection in reversed(self._selections):
            task, arguments = _run_on_selection, (select, selection, task, *arguments)
        yield from partitions.map(run_on_compiled, self._shared_form, partitions.training, task, *arguments)

    @cached_property
    def _shared_form(self) -> bytes:
        assert self.problem.partitions is not None
        content = self.problem.skeleton, self.form, self._smooth_like is not None
        return self.problem.partitions.share(content)

    @cached_property
    def data_key(self) -> str:
        """A digest of all that the samples of given data depend on."""
        problem, tables = self.problem, {*self._lowered.shapes}
        fixed = {n: problem.parameters[n].values for n in sorted(tables) if n not in problem.free_names}
        graphs = self._split.prepared, self._split.graph, self._lowered.axes, dict(self._lowered.shapes)
        layout = tuple(self.kernel.layout.inputs), self.weighting.inputs, self.form.restarts, self.form.step
        texts = problem.criteria, dict(problem.channels), problem.model.step, living_functions(problem.graph.nodes)
        return digest_of(graphs, layout, fixed, texts, problem.target_sources, code_digest())

    def over_partition(self, recordings: Recordings, partition: Partition) -> "CompiledProblem":
        """Return the same over one partition, whose samples are kept on disk and mapped into memory."""
        other = copy(self)
        other.problem = self.problem.over(StoredDatasets(recordings, partition.parts))
        stored = [self._part_samples(recordings, part) for part in partition.parts]
        # set, not computed: the property of the copy would gather all data
        other.samples = chain_samples([part.samples for part in stored])
        other._stored = list(zip(stored, partition.parts, strict=True))
        other.__dict__.pop("sums", None)  # a selection of the samples has sums of its own
        keys = [digest_of(self._part_key(recordings, part)) for part in partition.parts]
        other._storage = StoredColumns(recordings.files, digest_of(keys))
        return other

    def _part_samples(self, recordings: Recordings, part: Part) -> StoredSamples:
        """Return the samples of one part, which are laid out when it is first used: one at a time is in memory."""
        path = self._part_path(recordings, part)
        scores = np.array([c.weight * recordings.recipes[part.dataset].entry.weight for c in self.problem.criteria])
        # of recordings that stand for others in a search
        scores *= part.factors or 1.0
        stored = read_samples(path, len(self.kernel.layout.inputs), scores)
        if stored is None:
            other = copy(self)
            other.problem = self.problem.over(StoredDatasets(recordings, [part]))
            laid_out = in_visiting_order(other._gathered())
            kept = recordings.files.keep(path, sample_columns(laid_out), {})
            stored = read_samples(path, len(self.kernel.layout.inputs), scores) if kept else None
            # if the disk cannot keep them, they stay in memory
            stored = stored or laid_out.weighted(part.factors)
        touch(path)
        return stored

    def _part_path(self, recordings: Recordings, part: Part) -> Path:
        return recordings.files.path(digest_of(*self._part_key(recordings, part)))

    def _part_key(self, recordings: Recordings, part: Part) -> tuple[Any, ...]:
        own = part.first, part.last, part.shift, part.margin, recordings.recipes[part.dataset].key
        return self.data_key, part.source.address, version_of(part.source), own

    def discard_part(self, recordings: Recordings, part: Part) -> None:
        """Remove the samples of one part from the disk, if they are there."""
        with suppress(OSError):
            self._part_path(recordings, part).unlink(missing_ok=True)

    def discard_samples(self) -> None:
        """Remove the samples of all partitions from the disks, for shifts of channels that are not used again."""
        partitions = self.problem.partitions
        if partitions is not None:
            for _ in partitions.map(discard_partition, self._shared_form, partitions.training):
                pass

    def sample_numbers(self) -> Int:
        """Return the number of the sample at each visit, as the data come, Int[visits]."""
        if not self._stored:
            order = self.samples.order
            return np.arange(self.samples.count) if order is None else order.astype(np.int64)
        numbers, end = [], 0
        for stored, part in self._stored:
            own = np.arange(stored.samples.count) if stored.order is None else stored.order
            numbers.append(own.astype(np.int64) + end)
            # an order may leave samples out, but numbers count all of the part
            end += stored.samples.count if stored.order is None else part.last - part.first
        return np.concatenate(numbers)

    def sums_over(self, samples: Samples) -> Sums:
        """Return the sums of the compiled model over other samples."""
        if not self._called.batches and self._called.trajectories is None:
            sums = self._sums_of(self.kernel, samples)
        else:
            sums = self._functions.sums(self._sums_of, self.kernel, samples)
        return RememberedSums(sums, samples.count, samples.wanted)

    def sums_with(self, select: Callable[..., Samples], *arguments: Any) -> Sums:
        """Return the sums over another selection of the samples; see `over_selection`."""
        return self.over_selection(select, *arguments).sums

    def over_selection(self, select: Callable[..., Samples], *arguments: Any) -> "CompiledProblem":
        """Return the same over `select(compiled, *arguments)`, the samples in another selection or with other weights.

        `select` is a function of a module; with partitions, it is called for each of them.
        """
        other = copy(self)
        if self.problem.partitions is None:
            other.samples = select(self, *arguments)
            other.sums = other.sums_over(other.samples)
        else:
            other._selections = (*self._selections, (select, arguments))
            other.sums = other._sums_over_partitions(other.each)
        return other

    def _sums_over_partitions(self, each: Callable[..., Iterator[Any]]) -> Sums:
        sums = PartitionedSums(each, len(self._lowered.axes), stateful=self.stateful)
        return RememberedSums(sums, self.sample_count)

    def simulator(self, names: Sequence[str]) -> Simulator:
        """Return the compiled simulation of nodes that criteria score; it reads the inputs of the samples."""
        reduced = LoweredGraph(self._split.graph, self._lowered.axes, self._lowered.shapes)
        return Simulator(reduced, [reduced.graph.names[name] for name in names], self.problem.parameters)

    def recall(self, key: str) -> list[NDArray[Any]] | None:
        """Return the columns that were kept under a key; None if there are none any more."""
        return self._storage.read(key)

    def keep(self, key: str, columns: Sequence[NDArray[Any]]) -> None:
        """Keep columns that belong to the samples: over a partition on disk, else the latest ones in memory."""
        self._storage.write(key, columns)

    def locate(self, visits: Int) -> tuple[Int, Int]:
        """Return for some visits the number of the training dataset and that of the sample in it, each Int[visits]."""
        samples = self.sample_numbers()[visits]
        bounds = self.problem.gathered
        ends = np.cumsum([bound.count for bound in bounds])
        data = np.searchsorted(ends, samples, side="right")
        numbers = np.empty_like(samples)
        for number in np.unique(data).tolist():
            mine = data == number
            numbers[mine] = bounds[number].kept[samples[mine] - (ends[number] - bounds[number].count)]
        return data, numbers

    def full(self, values: Float) -> Float:
        """Return the free values, Float[free], followed by the fixed ones."""
        return np.concatenate([values, self.start[values.size :]])

    def parameters(self, values: Float) -> ParameterSet:
        """Return the parameter set with these free values, Float[free]."""
        return self.values.unpack(self.full(values), self.problem.parameters)

    @property
    def weights(self) -> float:
        """Sum of weight / scale^2 over all scored samples; the cost divided by it is a mean square."""
        return float(sum(self.each(_partial_weights))) or 1.0

    def own_weights(self) -> float:
        """Return this sum over the own samples."""
        scales = np.array([output.scale for output in self.kernel.outputs])
        return float(sum(self._counts(piece) @ (piece.scores / scales**2) for piece in self.samples.pieces))

    def _counts(self, piece: Piece) -> Float:
        """Return the sum of sample weights that each output scores in a piece."""
        counts = self.samples.scored(piece).astype(np.float64)
        if self.weighting.inputs:
            visits = np.arange(piece.first, piece.last)
            scored = np.isfinite(self.samples.targets_of(visits))
            inputs = self.samples.inputs_of(visits)
            for i, name in self.weighting.inputs.items():
                counts[i] = inputs[self.kernel.layout.inputs[name]][scored[i]].sum()
        return counts

    def thinned(self) -> "CompiledProblem":
        """Return the same over a fixed part of the samples if these are many, else itself.

        For models with memory these are whole pieces, over partitions whole recordings.
        """
        other, partitions = copy(self), self.problem.partitions
        if partitions is None:
            other.samples = self._thin(self.samples)
            if other.samples is self.samples:
                return self
        elif self.stateful:
            if self.search_partitions is partitions:
                return self
            other.problem = replace(self.problem, partitions=self.search_partitions)
            other.sums = other._sums_over_partitions(other.each)
            return other
        elif self._search_share(self.sample_count) >= 1:
            return self
        else:
            other.samples, other.problem = self._thinned_partitions, replace(self.problem, partitions=None)
        other.sums = self.sums_over(other.samples)
        return other

    @cached_property
    def search_partitions(self) -> Partitions | None:
        """The partitions with which searches of models with memory are compared: some recordings if these are many.

        Recordings are picked as pieces are without partitions. They follow from the files alone.
        """
        partitions = self.problem.partitions
        if partitions is None or partitions.samples < 2 * SEARCH_PIECE_SAMPLES:
            return partitions
        share = SEARCH_PIECE_SAMPLES / partitions.samples
        return pick_recordings(partitions, self.each(count_recordings), share, SEARCH_PIECES)

    def _thin(self, samples: Samples) -> Samples:
        """Return the samples with which searches are compared."""
        if not self.stateful:
            return samples.thinned(self._search_share(samples.count))
        if samples.count < 2 * SEARCH_PIECE_SAMPLES or len(samples.pieces) < 2 * SEARCH_PIECES:
            return samples
        fewer = samples.in_fewer_pieces(SEARCH_PIECE_SAMPLES / samples.count, SEARCH_PIECES)
        # more than half of the samples would save little
        return fewer if 2 * sum(piece.last - piece.first for piece in fewer.pieces) <= samples.count else samples

    @property
    def residuals(self) -> int:
        """Number of scored samples, over all criteria."""
        return sum(self.each(_count_residuals))

    def set_width(self, spacings: float) -> None:
        """Set the width of the smoothing in mean breakpoint spacings."""
        self.sums.widths[:] = spacings * self.spacings

    def with_start(self, problem: Problem) -> "CompiledProblem":
        """Return the same for other values of the free parameters; the fixed ones must be unchanged."""
        other, own = copy(self), self.problem.partitions  # those with which searches are compared, or all
        other.problem = problem if problem.partitions is own else replace(problem, partitions=own)
        other.start = self.values.pack(problem.parameters)
        return other

    def over(self, problem: Problem) -> "CompiledProblem":
        """Return the same for a problem that differs in datasets and start only; compiled again if the step changes."""
        form = DataForm.of(problem)
        if form.step != self.form.step:
            return CompiledProblem(problem, sums_of=self._sums_of, form=form)
        if problem.partitions is not None:
            _ = self._shared_form  # kept for all copies, so that no process compiles again
        other = self.with_start(problem)
        other.problem, other.weighting = problem, form.weighting
        if problem.partitions is not None:
            # cached for the data of before
            for name in ("samples", "sums", "_thinned_partitions", "search_partitions"):
                other.__dict__.pop(name, None)
            return other
        other.samples = other._gathered()
        other.sums = other.sums_over(other.samples)
        return other

    def _gathered(self) -> Samples:
        problem = self.problem
        sources = []
        for bound in problem.gathered:
            ages = sample_ages(bound.hold, bound.count) if self.form.restarts else {}
            further = self.weighting.columns(bound) | ages
            starts = group_points(bound.starts) if self.form.restarts and bound.hold is not None else bound.starts
            # room for the columns of calls, which are computed for each evaluation
            further |= {name: np.zeros(bound.count) for name in self._called.inputs}
            whole = replace(bound, clock={**bound.clock, **further}, starts=starts)
            targets = [
                partial(self.weighting.target, i, bound, partial(problem.target, c, bound))
                for i, c in enumerate(problem.criteria)
            ]
            scores = np.array([c.weight * bound.dataset.weight for c in problem.criteria])
            sources.append(TrainingSource(whole, targets, scores))
        return self._assembly.samples(sources, problem.parameters, in_time=self.stateful)

    def _shared(self, other: "CompiledProblem") -> Samples:
        """Return the samples of another form of the problem if its data-only part is the same."""
        mine, theirs = list(self.kernel.layout.inputs), other.kernel.layout.inputs
        if self._split.prepared != other._split.prepared or not theirs.keys() >= set(mine):
            samples = self._gathered()
        elif mine == list(theirs):
            samples = other.samples
        else:
            samples = other.samples.with_inputs([theirs[name] for name in mine])
        return samples

    def _search_share(self, samples: int) -> float:
        """Return the share of the samples with which searches of models without memory are compared."""
        return max(SEARCH_SAMPLES, SAMPLES_PER_VALUE * self.values.free) / max(samples, 1)


def run_on_compiled(shared: bytes, item: bytes, arguments: bytes) -> Any:
    """Run a function of a compiled problem on one partition; see `CompiledProblem.each`."""
    recordings, _ = shared_content(shared)
    task, *rest = pickle.loads(arguments)
    # a lock, since threads of a worker would compile the same problem side by side
    with _compiling:
        compiled = _compiled_once(shared)
    return task(compiled.over_partition(recordings, pickle.loads(item)), *rest)


def discard_partition(shared: bytes, item: bytes, _: bytes) -> None:
    """Remove the samples of one partition from the disk; see `CompiledProblem.discard_samples`."""
    recordings, _content = shared_content(shared)
    with _compiling:
        compiled = _compiled_once(shared)
    for part in pickle.loads(item).parts:
        compiled.discard_part(recordings, part)


_compiling = threading.Lock()


@lru_cache(maxsize=4)
def _compiled_once(shared: bytes) -> CompiledProblem:
    """Return the compiled problem without data."""
    _, (skeleton, form, smoothed) = shared_content(shared)
    exact = CompiledProblem(skeleton, form=form)
    return CompiledProblem(skeleton, smooth_like=exact, form=form) if smoothed else exact


def _run_on_selection(
    compiled: CompiledProblem,
    select: Callable[..., Samples],
    selection: Sequence[Any],
    task: Callable[..., Any],
    *rest: Any,
) -> Any:
    other = copy(compiled)
    other.samples = select(compiled, *selection)
    other.sums = other.sums_over(other.samples)
    return task(other, *rest)


def _partial_weights(compiled: CompiledProblem) -> float:
    return compiled.own_weights()


def _count_residuals(compiled: CompiledProblem) -> int:
    return sum(int(compiled.samples.scored(piece).sum()) for piece in compiled.samples.pieces)


def _thinned_samples(compiled: CompiledProblem, share: float) -> tuple[Float, Float, tuple[Piece, ...]]:
    """Return inputs and targets of some samples, shapes (inputs, samples) and (outputs, samples), and their pieces."""
    samples = compiled.samples.thinned(share)
    visits = np.arange(samples.count)
    return samples.inputs_of(visits), samples.targets_of(visits), samples.pieces
