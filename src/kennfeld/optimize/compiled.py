"""The compiled form of a calibration problem: kernel, samples and roughness."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np

from kennfeld.arrays import Float
from kennfeld.free_axes import AxisKey
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.graph.lookup_lowering import LoweredGraph, lower_lookups
from kennfeld.graph.partition import partition_graph
from kennfeld.graph.traversal import rewrite
from kennfeld.native.accumulator import Accumulator
from kennfeld.native.kernel import Kernel
from kennfeld.native.sample_loop import Output
from kennfeld.native.samples import Piece, Samples
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.remembered_sums import RememberedSums
from kennfeld.optimize.sums import Sums, SumsFactory
from kennfeld.optimize.table_penalties import Penalty, penalty_of
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.sample_weights import SampleWeights
from kennfeld.preprocessing.samples import TrainingSource, assemble_samples
from kennfeld.preprocessing.settling import group_points, restart_states, sample_ages

SEARCH_SAMPLES, SAMPLES_PER_VALUE = 20_000, 20  # of steady-state data, of which more are used to compare searches


def smoothable(problem: Problem) -> bool:
    """Return True if the coordinate of a lookup that the criteria need depends on a free parameter."""
    lowered = lower_lookups(problem.graph, problem.parameters, problem.free_names)
    needed = partition_graph(lowered.graph, problem.differences, (*problem.free_names, *problem.free_axes)).graph
    return any(any(node.payload.smoothed) for node in needed.nodes if node.op == "interpolate")


class RejectedTrials:
    """Counts trial values whose cost is not finite, and stores the first few."""

    MAX_STORED = 8

    def __init__(self) -> None:
        self.count = 0
        self.first: list[Float] = []

    def add(self, values: Float) -> None:
        self.count += 1
        if len(self.first) < self.MAX_STORED:
            self.first.append(values.copy())

    def clear(self) -> None:
        self.count, self.first = 0, []


class CompiledProblem:
    """A problem ready for evaluation: data-only parts computed, samples sorted, kernel compiled.

    With `smooth_like`, the exact form of the same problem, lookups whose coordinate depends on a free parameter are
    smoothed, over the samples of its `thinned` form.

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
        self, problem: Problem, smooth_like: "CompiledProblem | None" = None, sums_of: SumsFactory | None = None
    ) -> None:
        self.problem = problem
        self.rejected: RejectedTrials = RejectedTrials() if smooth_like is None else smooth_like.rejected
        parameters, free = problem.parameters, problem.free_names
        self.weighting = SampleWeights.of(problem.criteria, problem.training)
        self._restarts = any(bound.hold is not None for bound in problem.training)
        self._step = _even_step(problem.training)
        fitted: tuple[str | AxisKey, ...] = (*free, *problem.free_axes)
        weighted = self.weighting.extend(problem.graph)
        graph = _with_step(restart_states(weighted) if self._restarts else weighted, self._step)
        self._lowered = lower_lookups(graph, parameters, free if smooth_like else ())
        scored = [*problem.differences, *self.weighting.inputs.values()]
        self._split = partition_graph(self._lowered.graph, scored, fitted)
        reduced = LoweredGraph(self._split.graph, self._lowered.axes, self._lowered.shapes)
        self.kernel = Kernel(reduced, self._kernel_outputs(reduced.graph), parameters, fitted)
        self.spacings = np.array([(a[-1] - a[0]) / max(a.size - 1, 1) for a in self._lowered.axes] or [0.0])
        self._sums_of: SumsFactory = smooth_like._sums_of if smooth_like else sums_of or Accumulator
        self.values = self.kernel.values
        self.samples = self._gathered() if smooth_like is None else self._shared(smooth_like)
        self.sums = self.sums_over(self.samples)
        factors = {name: problem.factors(name) for name in free}
        self.roughness: Penalty = penalty_of(parameters, self.values, factors, problem.restraints)
        self.start = self.values.pack(parameters)

    def _kernel_outputs(self, graph: Graph) -> list[Output]:
        names = graph.names
        weights = {i: names[name] for i, name in self.weighting.inputs.items()}
        return [
            Output(names[name], c.scale, c.loss, c.delta, weights.get(i))
            for i, (name, c) in enumerate(zip(self.problem.differences, self.problem.criteria, strict=True))
        ]

    def sums_over(self, samples: Samples) -> Sums:
        """Return the sums of the compiled model over other samples."""
        return RememberedSums(self._sums_of(self.kernel, samples), samples)

    def full(self, values: Float) -> Float:
        """Return the free values, Float[free], followed by the fixed ones."""
        return np.concatenate([values, self.start[values.size :]])

    def parameters(self, values: Float) -> ParameterSet:
        """Return the parameter set with these free values, Float[free]."""
        return self.values.unpack(self.full(values), self.problem.parameters)

    @property
    def weights(self) -> float:
        """Sum of weight / scale^2 over all scored samples; the cost divided by it is a mean square."""
        scales = np.array([output.scale for output in self.kernel.outputs])
        parts = [self._counts(piece) @ (piece.scores / scales**2) for piece in self.samples.pieces]
        return float(sum(parts)) or 1.0

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

    def reweight(self, factors: Float) -> "CompiledProblem":
        """Multiply the weight of each criterion by a factor; nothing is compiled again."""
        other = copy(self)
        other.samples = self.samples.reweighted(factors)
        other.sums = self.sums_over(other.samples)
        return other

    def reread_targets(self) -> None:
        """Read targets again that were changed in place; problems made by `reweight` share them."""
        self.samples.wanted.reread()

    def thinned(self) -> "CompiledProblem":
        """Return the same over a fixed part of the samples if these are many and have no memory, else itself."""
        samples = self._thinned(self.samples)
        if samples is self.samples:
            return self
        other = copy(self)
        other.samples, other.sums = samples, self.sums_over(samples)
        return other

    @property
    def residuals(self) -> int:
        """Number of scored samples, over all criteria."""
        return sum(int(self.samples.scored(piece).sum()) for piece in self.samples.pieces)

    def set_width(self, spacings: float) -> None:
        """Set the width of the smoothing in mean breakpoint spacings."""
        self.sums.widths[:] = spacings * self.spacings

    def with_start(self, problem: Problem) -> "CompiledProblem":
        """Return the same for other values of the free parameters; the fixed ones must be unchanged."""
        other = copy(self)
        other.problem, other.start = problem, self.values.pack(problem.parameters)
        return other

    def over(self, problem: Problem) -> "CompiledProblem":
        """Return the same for a problem that differs in datasets and start only; compiled again if the step changes."""
        if _even_step(problem.training) != self._step:
            return CompiledProblem(problem, sums_of=self._sums_of)
        other = self.with_start(problem)
        other.weighting = SampleWeights.of(problem.criteria, problem.training)
        other.samples = other._gathered()
        other.sums = other.sums_over(other.samples)
        return other

    def _gathered(self) -> Samples:
        problem = self.problem
        sources = []
        for bound in problem.gathered:
            further = self.weighting.columns(bound) | (sample_ages(bound.hold, bound.count) if self._restarts else {})
            starts = bound.starts if bound.hold is None else group_points(bound.starts)
            whole = replace(bound, clock={**bound.clock, **further}, starts=starts)
            targets = [
                partial(self.weighting.target, i, bound, partial(problem.target, c, bound))
                for i, c in enumerate(problem.criteria)
            ]
            scores = np.array([c.weight * bound.dataset.weight for c in problem.criteria])
            sources.append(TrainingSource(whole, targets, scores))
        return assemble_samples(sources, self._lowered, self._split, self.kernel, problem.parameters)

    def _shared(self, other: "CompiledProblem") -> Samples:
        """Return the samples of another form of the problem if its data-only part is the same."""
        mine, theirs = list(self.kernel.layout.inputs), other.kernel.layout.inputs
        if self._split.prepared != other._split.prepared or not theirs.keys() >= set(mine):
            samples = self._gathered()
        elif mine == list(theirs):
            samples = other.samples
        else:
            samples = other.samples.with_inputs([theirs[name] for name in mine])
        return self._thinned(samples)

    def _thinned(self, samples: Samples) -> Samples:
        most = max(SEARCH_SAMPLES, SAMPLES_PER_VALUE * self.values.free)
        return samples if self.kernel.line.states else samples.thinned(most)


def _even_step(bounds: Sequence[BoundDataset]) -> float | None:
    """Return the time step if it is the same everywhere, else None."""
    clocks = [bound.clock["dt"] for bound in bounds if "dt" in bound.clock and bound.clock["dt"].size]
    steps = {float(step) for dt in clocks for step in (dt.min(), dt.max())}
    return steps.pop() if len(steps) == 1 else None


def _with_step(graph: Graph, step: float | None) -> Graph:
    """Replace `dt` by a constant if it is known."""
    if step is None:
        return graph

    def resolve(b: GraphBuilder, at: int, args: tuple[int, ...]) -> int:
        node = graph.nodes[at]
        return b.const(step) if node.op == "input" and node.payload == "dt" else b.rebuild(node, args)

    return rewrite(graph, resolve)
