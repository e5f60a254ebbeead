"""A calibration problem: model, data, parameters and criteria; and its compiled form."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.dataset import Dataset
from kennfeld.graph import OPERATIONS, Builder, Graph
from kennfeld.graph.lowering import Lowered, lower, rewrite
from kennfeld.graph.split import Split, split
from kennfeld.models import Model
from kennfeld.native import Accumulator, Kernel, Output, Piece, Samples, Simulator
from kennfeld.optimize.binding import Bound, bind
from kennfeld.optimize.criterion import Criterion, Pin
from kennfeld.optimize.roughness import Roughness
from kennfeld.parameters import ParameterSet

__all__ = ["Compiled", "Problem"]

MOST_SMOOTHED = 20_000  # samples used while lookups are smoothed
Smoothness = Mapping[str, float | Sequence[float]]


@dataclass(frozen=True)
class Problem:
    """Everything a calibration needs, with nothing computed yet.

    `free` are glob patterns of the parameters to fit. `smoothness` gives a factor for a parameter, or one an axis.
    `channels` names the channel of a model input where the names differ.
    """

    model: Model
    datasets: tuple[Dataset, ...]
    parameters: ParameterSet
    criteria: tuple[Criterion, ...]
    free: tuple[str, ...] = ("*",)
    smoothness: Smoothness = field(default_factory=dict)
    pins: tuple[Pin, ...] = ()
    channels: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def free_names(self) -> tuple[str, ...]:
        """The parameters that the function looks up and a pattern frees."""
        looked_up = self.model.graph.parameters
        return tuple(n for n in looked_up if any(fnmatchcase(n, pattern) for pattern in self.free))

    @cached_property
    def training(self) -> tuple[Bound, ...]:
        """The training data, bound to the model."""
        return tuple(self.bind(data) for data in self.datasets if data.use == "training" and data.weight > 0)

    def bind(self, dataset: Dataset) -> Bound:
        """A dataset as the model reads it."""
        return bind(dataset, self.graph, self.channels)

    @cached_property
    def graph(self) -> Graph:
        """The model's graph with one more node a criterion, named by `difference`: node minus target node."""
        b = Builder.of(self.model.graph)
        names = dict(self.model.graph.names)
        for i, criterion in enumerate(self.criteria):
            node = names[criterion.node]
            other = self.target_node(criterion)
            names[difference(i)] = node if other is None else b.call("sub", node, names[other])
        return b.finish(names, self.model.graph.units, self.model.graph.outputs)

    def target_node(self, criterion: Criterion) -> str | None:
        """The node that a criterion compares with, if it is one."""
        target = criterion.target
        is_channel = target.kind == "channel" or any(target.name in data for data in self.datasets)
        return target.name if target.kind == "node" or (target.kind == "name" and not is_channel) else None

    def target(self, criterion: Criterion, bound: Bound) -> Float:
        """What the difference node shall be at each kept sample; NaN where the sample is not scored."""
        if criterion.target.kind == "number":
            values = np.full(bound.count, criterion.target.value)
        elif self.target_node(criterion) is not None:
            values = np.zeros(bound.count)
        elif criterion.target.name in bound.dataset:
            values = bound.channel(criterion.target.name)
        else:
            values = np.full(bound.count, np.nan)
        return np.where(bound.scored & np.isfinite(values), values, np.nan)

    def factors(self, name: str) -> tuple[float, ...]:
        """Smoothness of each axis of a parameter."""
        given = self.smoothness.get(name, 0.0)
        axes = len(self.parameters[name].axes)
        return tuple(given) if isinstance(given, Sequence) else (float(given),) * axes


def difference(criterion: int) -> str:
    """The node that a criterion scores; a name that no formula text can have."""
    return f"\0{criterion}"


class Compiled:
    """A problem made ready to be evaluated: data-only parts computed, samples sorted, kernel compiled.

    With `smooth_like`, the exact form of the same problem, lookups whose coordinate depends on a free parameter are
    smoothed, and at most `MOST_SMOOTHED` samples of steady-state data are used.
    """

    def __init__(self, problem: Problem, smooth_like: "Compiled | None" = None) -> None:
        self.problem = problem
        parameters, free = problem.parameters, problem.free_names
        lowered = lower(_with_even_step(problem.graph, problem.training), parameters, free if smooth_like else ())
        outputs = [difference(i) for i in range(len(problem.criteria))]
        self._split = split(lowered.graph, outputs, free)
        reduced = Lowered(self._split.graph, lowered.axes, lowered.shapes)
        self.kernel = Kernel(
            reduced,
            [
                Output(reduced.graph.names[name], c.scale, c.loss, c.delta)
                for name, c in zip(outputs, problem.criteria, strict=True)
            ],
            parameters,
            free,
        )
        self.smoothed = sorted(
            {
                axis.number
                for node in reduced.graph.nodes
                if node.op == "interpolate"
                for axis, soft in zip(node.payload.axes, node.payload.smoothed, strict=True)
                if soft
            }
        )
        self.spacings = np.array([(a[-1] - a[0]) / max(a.size - 1, 1) for a in lowered.axes] or [0.0])
        self.samples = self._gather(lowered) if smooth_like is None else self._shared(lowered, smooth_like)
        self.accumulator = Accumulator(self.kernel, self.samples)
        self.values = self.kernel.values
        self.roughness = Roughness.of(parameters, self.values, {name: problem.factors(name) for name in free})
        self.start = self.values.pack(parameters)

    def set_width(self, spacings: float) -> None:
        """Smooth by so many mean breakpoint spacings."""
        self.accumulator.widths[:] = spacings * self.spacings

    def _shared(self, lowered: Lowered, other: "Compiled") -> Samples:
        """The samples of another form of the problem, where its data-only part is the same."""
        mine, theirs = list(self.kernel.layout.inputs), other.kernel.layout.inputs
        if self._split.prepared != other._split.prepared or not theirs.keys() >= set(mine):
            samples = self._gather(lowered)
        elif mine == list(theirs):
            samples = other.samples
        else:
            rows = other.samples.data[[theirs[name] for name in mine]]
            samples = Samples(rows, other.samples.targets, other.samples.pieces)
        return samples if self.kernel.line.states else samples.thinned(MOST_SMOOTHED)

    def _gather(self, lowered: Lowered) -> Samples:
        rows, targets, pieces, at = [], [], [], 0
        for bound in self.problem.training:
            target = np.array([self.problem.target(c, bound) for c in self.problem.criteria])
            data, order = self._data(lowered, bound, target)
            rows.append(data)
            targets.append(target if order is None else target[:, order])
            scores = np.array([c.weight * bound.dataset.weight for c in self.problem.criteria])
            starts = bound.starts if order is None else np.zeros(min(1, order.size), dtype=np.int64)
            edges = [*starts.tolist(), data.shape[1]]
            pieces += [Piece(at + a, at + b, scores) for a, b in pairwise(edges)]
            at += data.shape[1]
        join = (lambda parts: parts[0]) if len(rows) == 1 else (lambda parts: np.concatenate(parts, axis=1))
        return Samples(join(rows), join(targets), tuple(pieces))

    def _data(self, lowered: Lowered, bound: Bound, target: Float) -> tuple[Float, Int | None]:
        """Rows of the kernel's inputs; without states the order in which neighbours lie in the same cells."""
        split = self._split
        data = np.empty((len(self.kernel.layout.inputs), bound.count))
        for name, row in self.kernel.layout.inputs.items():
            if name not in split.columns:
                data[row] = bound.columns[name]
        if split.columns:
            found = {n: r for n, r in self.kernel.layout.inputs.items() if n in split.columns}
            _precompute(lowered, split, found, bound, self.problem.parameters, data)
        if self.kernel.line.states:
            return data, None
        scored = np.isfinite(target).any(axis=0)
        order = self._cell_order(lowered, data, np.asarray(scored))
        for i in range(len(data)):
            data[i, : order.size] = data[i, order]
        return data[:, : order.size], order

    def _cell_order(self, lowered: Lowered, data: Float, scored: Bool) -> Int:
        """The scored samples, sorted by the cells of the positions that the data determine."""
        inputs = self.kernel.layout.inputs
        cells = [
            data[inputs[name]].astype(np.int32)
            for name, at in self._split.columns.items()
            if name in inputs and lowered.graph.nodes[at].op == "position"
        ]
        order = np.lexsort(cells[::-1]) if cells else np.arange(data.shape[1])
        return order[scored[order]] if not scored.all() else order


def _with_even_step(graph: Graph, bounds: Sequence[Bound]) -> Graph:
    """The graph with `dt` a constant where all data have the same even step."""
    steps = {float(step) for bound in bounds if "dt" in bound.columns for step in _extremes(bound.columns["dt"])}
    if len(steps) != 1:
        return graph
    step = steps.pop()

    def resolve(b: Builder, at: int, args: tuple[int, ...]) -> int:
        op, _, payload = graph.nodes[at]
        if op == "input" and payload == "dt":
            return b.const(step)
        return b.call(op, *args) if op in OPERATIONS else b.node(op, args, payload)

    return rewrite(graph, resolve)


def _extremes(values: Float) -> list[float]:
    return [values.min(), values.max()] if values.size else []


BLOCK = 65536  # samples computed at once


def _precompute(
    lowered: Lowered, split: Split, rows: Mapping[str, int], bound: Bound, parameters: ParameterSet, data: Float
) -> None:
    """Fill the rows that hold what depends on the data alone."""
    simulator = Simulator(lowered, [split.columns[name] for name in rows], parameters)
    names = simulator.inputs
    whole = bool(lowered.graph.states)
    length = bound.count if whole else BLOCK
    for first in range(0, bound.count, max(length, 1)):
        last = min(first + length, bound.count)
        block = np.array([bound.columns[name][first:last] for name in names]).reshape(len(names), last - first)
        starts = bound.starts.tolist() if whole else [0]
        found = simulator.run(parameters, block, starts)
        for row, values in zip(rows.values(), found, strict=True):
            data[row, first:last] = values
