"""A calibration problem: model, data, parameters and criteria, with nothing compiled yet."""

import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, fields, replace
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import compress
from typing import Any, Literal, TypeVar

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Equality, Limit, Pin, Shape
from kennfeld.domain.criteria import Criterion, Target
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.free_axes import AxisKey, FreeAxis, free_axes, key_of
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.storage import StorageRounding
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.graph.lookup_lowering import LoweredGraph, lower_lookups
from kennfeld.graph.traversal import ancestors_in_time
from kennfeld.models import Model
from kennfeld.optimize.problem.limit_nodes import keeps_pieces
from kennfeld.optimize.problem.partitions import (
    Partition,
    Partitions,
    StoredDatasets,
    join_files,
    shared_content,
    without_values,
)
from kennfeld.optimize.problem.structure import Structure, structure_of
from kennfeld.optimize.problem.table_penalties import Restraint
from kennfeld.preprocessing.binding import BoundDataset, bind_inputs
from kennfeld.preprocessing.bound_parts import BoundPart, divide
from kennfeld.preprocessing.sample_weights import has_weight
from kennfeld.preprocessing.settling import average_window, needs_average

_Scored = tuple[str, str | None, bool]  # a node, that of its target, and whether their difference is averaged
Place = tuple[str, tuple[float, ...]]  # a parameter, and coordinates in it

T = TypeVar("T")  # Python 3.11
Factor = float | Literal["auto"]
Smoothness = Mapping[str, Factor | Sequence[Factor]]


@dataclass(frozen=True)
class Problem:
    """Everything a calibration needs.

    Attributes:
        model: the function to calibrate.
        datasets: training and test data.
        parameters: the start, with bounds and locks.
        criteria: nodes and their targets.
        free: glob patterns of the parameters to fit.
        smoothness: by parameter a factor, or one per axis, or "auto" in its place.
        pins: exact values at given coordinates.
        channels: the channel of a model input, if the names differ.
        constraints: ranges of slope or curvature, and sums of values.
        limits: limits of outputs.
        unknown_shifts: by dataset, the channels whose shift is to be estimated.
        restraints: of tables whose smoothness was chosen.
        partitions: the data, if they are evaluated in partitions; `datasets` are then excerpts of them.
        rounding: how the end of the search is rounded to storable values; None if it is not.

    >>> from kennfeld import Project
    >>> problem = Project.read("kennfeld.toml").problem()
    >>> problem.free_size, [data.name for data in problem.datasets]
    (519, ['bench', 'motored', 'fresh'])
    """

    model: Model
    datasets: Sequence[Dataset]
    parameters: ParameterSet
    criteria: tuple[Criterion, ...]
    free: tuple[str, ...] = ("*",)
    smoothness: Smoothness = field(default_factory=dict)
    pins: tuple[Pin, ...] = ()
    channels: Mapping[str, str] = field(default_factory=dict)
    constraints: tuple[Shape | Equality, ...] = ()
    limits: tuple[Limit, ...] = ()
    unknown_shifts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    restraints: Mapping[str, Restraint] = field(default_factory=dict)
    partitions: Partitions | None = None
    rounding: StorageRounding | None = None

    def __getstate__(self) -> dict[str, Any]:
        # without what is computed from these when it is needed, compiled code among it
        return {part.name: getattr(self, part.name) for part in fields(self)}

    @cached_property
    def free_names(self) -> tuple[str, ...]:
        """The parameters that the function uses and a pattern frees.

        Models that the function brings along are never free, layers of neural networks only if they are not locked.
        """
        looked_up = self.model.graph.parameters
        named = (n for n in looked_up if any(fnmatchcase(n, pattern) for pattern in self.free))
        carried = {surrogate.name for surrogate in self.model.surrogates}
        carried |= {n for n in self.model.graph.layers if n in self.parameters and self.parameters[n].locked.all()}
        return tuple(n for n in named if n not in carried)

    @cached_property
    def unscored_names(self) -> tuple[str, ...]:
        """The free parameters that no criterion with a weight depends on: the data say nothing about them."""
        graph, weighted = self.graph, [criterion.weight > 0 for criterion in self.criteria]
        scored = [graph.names[name] for name in compress(self.differences, weighted)]
        # one walk from the criteria, however many parameters there are
        used = {graph.nodes[at].parameter for at in ancestors_in_time(graph, scored)}
        return tuple(name for name in self.free_names if name not in used)

    @property
    def has_goals(self) -> bool:
        """True if an output is brought close to a number, as a loss to 0, instead of to a measurement."""
        scored = [criterion for criterion in self.criteria if criterion.weight > 0 and criterion.loss != "excess"]
        return any(criterion.target.kind == "number" for criterion in scored)

    @property
    def fitted_datasets(self) -> list[Dataset]:
        """The training data with a weight."""
        return [data for data in self.datasets if data.is_fitted]

    @cached_property
    def free_size(self) -> int:
        """Number of values of the free parameters, including locked ones."""
        return sum(self.parameters[name].size for name in self.free_names)

    @cached_property
    def free_axes(self) -> Mapping[AxisKey, FreeAxis]:
        """The axes whose breakpoints are fitted: those marked as free that a free parameter uses."""
        axes = self._movable_axes
        return {key: axis for key, axis in axes.items() if any(name in self.free_names for name, _ in axis.places)}

    @cached_property
    def _movable_axes(self) -> Mapping[AxisKey, FreeAxis]:
        """The axes that are marked as free in any table, used or not."""
        return free_axes(self.parameters)

    @property
    def idle_axes(self) -> list[AxisKey]:
        """Axes of the function's tables that are marked as free, but on which nothing is fitted."""
        used = self.model.graph.parameters
        unfitted = {key: axis for key, axis in self._movable_axes.items() if key not in self.free_axes}
        return [key for key, axis in unfitted.items() if any(name in used for name, _ in axis.places)]

    @property
    def held(self) -> list[Place]:
        """Coordinates at which pins and equalities fix the value of a lookup."""
        terms = [term for c in self.constraints if isinstance(c, Equality) for term in c.terms]
        return [(pin.parameter, pin.at) for pin in self.pins] + [(t.parameter, t.at) for t in terms if t.at is not None]

    @cached_property
    def training(self) -> tuple[BoundDataset, ...]:
        """The training data, bound to the model."""
        return tuple(self.bind(data) for data in self.fitted_datasets)

    @cached_property
    def gathered(self) -> tuple[BoundDataset, ...]:
        """The training data as compiled: for a model without states, dropped points are kept but not scored."""
        return self.training if self.graph.states else tuple(bound.whole for bound in self.training)

    def bind(self, dataset: Dataset) -> BoundDataset:
        """Bind the channels of a dataset to the inputs of the model; a dataset of the problem is bound once."""
        bound = self._bound.get(id(dataset))
        # by identity, which another dataset may have once the first is gone
        if bound is None or bound.dataset is not dataset:
            bound = bind_inputs(dataset, self.graph, self.channels, self.model.step)
            if any(own is dataset for own in self.datasets):
                self._bound[id(dataset)] = bound
        return bound

    def parts(self, bound: BoundDataset) -> list[BoundPart]:
        """Divide a bound dataset into parts that can be evaluated apart from each other; one of the problem, once."""
        parts = self._divided.get(id(bound), [])
        if not parts or parts[0].whole is not bound:
            steady = bound.dataset.time is None and not self.graph.states
            # a condition of a region may have a memory
            parts = divide(bound, anywhere=steady and not any(criterion.regions for criterion in self.criteria))
            if any(own is bound for own in self._bound.values()):
                self._divided[id(bound)] = parts
        return parts

    @cached_property
    def _bound(self) -> dict[int, BoundDataset]:
        """The bound datasets by the identity of the dataset."""
        return {}

    @cached_property
    def _divided(self) -> dict[int, list[BoundPart]]:
        """The parts of bound datasets by the identity of these."""
        return {}

    @cached_property
    def skeleton(self) -> "Problem":
        """The problem without samples, as it is sent to workers; targets are channels or nodes."""
        criteria = tuple(replace(c, target=self.resolved_target(c)) for c in self.criteria)
        datasets = tuple(without_values(data) for data in self.datasets)
        return replace(self, criteria=criteria, datasets=datasets, partitions=None)

    def resolved_target(self, criterion: Criterion) -> Target:
        """Return the target of a criterion, of which a bare name is a channel or a node by these data."""
        target = criterion.target
        if target.kind != "name":
            return target
        return replace(target, kind="channel" if self.target_node(criterion) is None else "node")

    def over(self, datasets: Sequence[Dataset]) -> "Problem":
        """Return the problem of some of its data, with the graph that all of them need."""
        problem = replace(self, datasets=datasets)
        # whether a target is a channel or a node depends on all data, not on these
        problem.__dict__.update(graph=self.graph, structure=self.structure, _made=self._made)
        return problem

    @cached_property
    def _made(self) -> dict[str, Any]:
        return {}

    def once(self, name: str, make: Callable[["Problem"], T]) -> T:
        """Return `make(problem)`, made once for this problem and those `over` some of its data, which share it."""
        if name not in self._made:
            self._made[name] = make(self)
        result: T = self._made[name]
        return result

    def each(self, task: Callable[..., Any], *arguments: Any, test: bool = False) -> Iterator[Any]:
        """Yield `task(problem, *arguments)` for each partition of the training data, in order, then of the test data.

        Without partitions, once for the whole problem. `task` is a function of a module.
        """
        if self.partitions is None:
            yield task(self, *arguments)
            return
        partitions = [*self.partitions.training, *(self.partitions.test if test else ())]
        shared = self.partitions.share(self.skeleton)
        yield from self.partitions.map(run_on_problem, shared, partitions, task, *arguments)

    @property
    def differences(self) -> list[str]:
        """The names of the nodes that the criteria score, see `graph`."""
        return [difference(i) for i in range(len(self.criteria))]

    @cached_property
    def graph(self) -> Graph:
        """The model's graph with another node per criterion, named by `difference`: node minus target node.

        If steady-state points are averaged over the end of their settling, it is the mean of the difference.
        """
        return self.model.once("scored", self._scored, lambda: _scored_graph(self.model.graph, self._scored))

    @cached_property
    def _scored(self) -> tuple[_Scored, ...]:
        """The node of each criterion, that of its target, and whether their difference is averaged."""
        averaging = needs_average(self.model.graph, self.datasets)
        return tuple((c.node, self.target_node(c), averaging and not c.internal) for c in self.criteria)

    @cached_property
    def structure(self) -> Structure | None:
        """All that the code of the graph depends on besides the model; None if more may count. See `Model.once`."""
        parameters = structure_of(self.graph, self.parameters, self._movable_axes)
        return parameters and (self._scored, *parameters)

    @cached_property
    def lowered(self) -> LoweredGraph:
        """The graph with its lookups lowered onto the axes of the parameters, none of them smoothed."""
        return self.model.once("lowered", self.structure, lambda: lower_lookups(self.graph, self.parameters))

    def target_node(self, criterion: Criterion) -> str | None:
        """Return the name of the target of a criterion if it is a node, else None."""
        target = criterion.target
        # a bare name is a channel if any dataset has it
        is_channel = target.kind == "channel" or any(target.name in data for data in self.datasets)
        return target.name if target.kind == "node" or (target.kind == "name" and not is_channel) else None

    def error_unit(self, criterion: Criterion) -> str:
        """Return the unit of the errors of a criterion: of what is measured, which the function may not state."""
        target = criterion.target.name
        recorded = next((data[target].unit for data in self.datasets if target in data), "")
        return recorded or self.model.graph.units.get(criterion.node, "")

    def target(self, criterion: Criterion, bound: BoundDataset) -> Float:
        """Return the target of the difference node, Float[kept samples]; NaN at samples that are not scored."""
        if criterion.target.kind == "number":
            values = np.full(bound.count, criterion.target.value)
        elif self.target_node(criterion) is not None:
            values = np.zeros(bound.count)
        elif criterion.target.name in bound.dataset:
            values = bound.channel(criterion.target.name)
        else:
            values = np.full(bound.count, np.nan)
        # an infinite target counts as missing; a weight of 0 leaves a sample out of errors as well
        counts = bound.scored & ~np.isinf(values) & has_weight(criterion, bound)
        return values if counts.all() else np.where(counts, values, np.nan)

    @property
    def target_sources(self) -> tuple[Any, ...]:
        """All that targets depend on besides the data, the channels and the criteria; it must have a digest."""
        return ()

    def factors(self, name: str) -> tuple[float, ...]:
        """Return the smoothness of each axis of a parameter; 0 if it is automatic and not chosen yet."""
        return tuple(0.0 if factor == "auto" else float(factor) for factor in self._smoothness(name))

    def automatic(self, name: str) -> tuple[bool, ...]:
        """Return for each axis of a parameter if its smoothness is to be chosen."""
        return tuple(factor == "auto" for factor in self._smoothness(name))

    @cached_property
    def automatic_names(self) -> tuple[str, ...]:
        """The free parameters with an axis whose smoothness is to be chosen."""
        return tuple(name for name in self.free_names if any(self.automatic(name)))

    def _smoothness(self, name: str) -> Sequence[Factor]:
        factors = self.smoothness.get(name, 0.0)
        single = isinstance(factors, str) or not isinstance(factors, Sequence)
        return (factors,) * len(self.parameters[name].axes) if single else factors  # type: ignore[return-value]


def _scored_graph(graph: Graph, scored: Iterable[_Scored]) -> Graph:
    b, names = GraphBuilder.of(graph), dict(graph.names)
    for i, (node, other, averaged) in enumerate(scored):
        at = names[node] if other is None else b.call("sub", names[node], names[other])
        names[difference(i)] = average_window(b, at) if averaged else at
    return b.finish(names, graph.units, graph.outputs)


def run_on_problem(shared: bytes, item: bytes, arguments: bytes) -> Any:
    """Run a function of a problem on one partition; see `Problem.each`."""
    recordings, skeleton = shared_content(shared)
    task, *rest = pickle.loads(arguments)
    return task(skeleton.over(StoredDatasets(recordings, pickle.loads(item).parts)), *rest)


def partitions_of(problem: Problem, dataset: int) -> list[Partition]:
    """Return the partitions of one dataset, by number, for what needs its pieces as a whole.

    A recording of a function and limits without memory, whose partitions are cut anywhere, is one partition.
    """
    assert problem.partitions is not None
    both = (*problem.partitions.training, *problem.partitions.test)
    own = [partition for partition in both if partition.parts[0].dataset == dataset]
    cut_anywhere = problem.datasets[dataset].time is not None and not keeps_pieces(problem.model, problem.limits)
    return join_files(own) if cut_anywhere else own


def difference(criterion: int) -> str:
    """Return the name of the node that a criterion scores; no formula text can contain it."""
    return f"\0{criterion}"


def moving_axis(problem: Problem, shape: Shape) -> AxisKey | None:
    """Return the axis along which a shape is limited if its breakpoints are fitted."""
    table = problem.parameters[shape.parameter]
    key = key_of(table, shape.axis) if 0 <= shape.axis < len(table.axes) else None
    return key if key in problem.free_axes else None


def time_constants(graph: Graph) -> list[int]:
    """Return the nodes T in `if(T < 0, nan, share)`, the form by which a lag rejects a negative time constant."""
    nodes, constants = graph.nodes, []
    for op, args, _ in nodes:
        if op == "select" and nodes[args[0]].op == "lt" and nodes[args[1]].op == "const":
            left, right = nodes[args[0]].args
            if nodes[right].op == "const" and nodes[right].payload == 0.0 and np.isnan(nodes[args[1]].payload):
                constants.append(left)
    return list(dict.fromkeys(constants))


def bound_time_constants(problem: Problem) -> Problem:
    """Set a lower bound of 0 for free parameters that are used as time constants only.

    Without it, all steps of a fit that lowers a time constant towards 0 would be rejected. Locked values, and
    parameters that may only be negative, keep their bounds.
    """
    graph = problem.model.graph
    lags = set(time_constants(graph))
    # a parameter that is also used otherwise may be negative there
    elsewhere = {n.payload for at, n in enumerate(graph.nodes) if n.op == "lookup" and at not in lags}
    names = {graph.nodes[at].payload for at in lags if graph.nodes[at].op == "lookup"} - elsewhere
    changed = []
    for parameter in (problem.parameters[n] for n in problem.free_names if n in names and n in problem.parameters):
        lower, upper = (np.broadcast_to(side, parameter.values.shape) for side in (parameter.lower, parameter.upper))
        raised = np.where(parameter.locked, lower, np.maximum(lower, 0.0))
        # a parameter that may only be negative would have no value left
        if not np.array_equal(raised, lower) and np.all(raised <= upper):
            changed.append(parameter.with_bounds(raised, upper))
    return replace(problem, parameters=problem.parameters.with_parameters(*changed)) if changed else problem
