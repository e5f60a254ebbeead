"""Candidate measurements evaluated by the fitted function: what each would tell about every value.

A candidate needs the inputs of the function only. Its targets are those that would be measured; a sum of squared slopes
does not depend on them.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Float, Int, ignore_floating_errors
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.native.symmetric import as_array
from kennfeld.optimize.sums.compiled import CompiledProblem


class CandidateData:
    """Slopes of the criteria over candidate samples, by one compiled kernel for all of them.

    Args:
        fitted: the fitted function.
        datasets: inputs of the candidates; samples that are not scored lead up to others.
        criteria: what would be measured there; by default all criteria of the problem.
        use: further datasets, whose samples have the weights of their `weight_channel`.
        recorded: the candidates are training data, and keep their targets and weights.
    """

    def __init__(
        self,
        fitted: FittedFunction,
        datasets: Sequence[Dataset],
        criteria: Sequence[Criterion] | None = None,
        use: Sequence[Dataset] = (),
        *,
        recorded: bool = False,
    ) -> None:
        own = fitted.problem.criteria
        measured = tuple(_plain(criterion) for criterion in (own if criteria is None else criteria))
        channels = {c.target.name for c in own if fitted.problem.target_node(c) is None and c.target.kind != "number"}
        channels |= {c.target.name for c in measured if c.target.kind == "channel"}
        # a channel that the function reads must be among the candidates
        channels -= {fitted.problem.channels.get(name, name) for name in fitted.problem.model.graph.inputs}
        self._fitted = fitted
        weight, names = fitted.weight, sorted(channels)
        plain = (_with_targets(replace(data, weight_channel=""), names, weight) for data in datasets)
        located = (replace(data, use="training") for data in datasets) if recorded else plain
        self.datasets = (*located, *(_with_targets(data, names) for data in use))
        self.problem = fitted.problem.over(self.datasets)
        self._same = measured == own and not any(data.weight_channel for data in self.datasets)
        if not self._same:
            self.problem = replace(self.problem, criteria=measured)

    @cached_property
    def _compiled(self) -> CompiledProblem:
        # the kernel of the fit serves if nothing but the data differs
        return self._fitted.compiled.over(self.problem) if self._same else CompiledProblem(self.problem)

    @cached_property
    def _visited(self) -> tuple[Int, Int]:
        """The number of the dataset and that of the sample at each visit, each Int[visits]."""
        return self._compiled.locate(np.arange(self._compiled.samples.count))

    def squares(self, values: Float, groups: Sequence[Int], count: int) -> Float:
        """Sum the squares of the weighted slopes by group at some values.

        Args:
            values: the free values, Float[free].
            groups: for each dataset the group of every sample, Int[samples]; -1 for none.
            count: number of groups.

        Returns:
            Float[count, free]; NaN in groups in which the function has no finite value.
        """
        data, samples = self._visited
        by_visit = np.full(data.size, -1, dtype=np.int64)
        for number, owners in enumerate(groups):
            mine = data == number
            by_visit[mine] = owners[samples[mine]]
        with ignore_floating_errors():
            return self._compiled.sums.squares(self._compiled.full(values), by_visit, count)

    def rows(self, values: Float) -> tuple[Float, Int, Int]:
        """Return the weighted slopes of all scored samples, in the order of the samples.

        Returns:
            Float[scored, outputs, free], the number of the dataset and of the sample of each, Int[scored]; points that
            are held until a function has settled are scored once.
        """
        with ignore_floating_errors():
            slopes = self._compiled.sums.rows(self._compiled.full(values))[1]
        data, samples = self._visited
        outputs = len(self.problem.criteria)
        slopes = slopes.reshape(data.size, outputs, values.size)
        scored = np.zeros(data.size, dtype=bool)
        for piece in self._compiled.samples.pieces:
            visits = np.arange(piece.first, piece.last)
            scored[visits] = np.isfinite(self._compiled.samples.targets_of(visits)).any(axis=0)
        order = np.flatnonzero(scored)
        order = order[np.lexsort((samples[order], data[order]))]
        return slopes[order], data[order], samples[order]

    def curvature(self, values: Float) -> Float:
        """Return the Gauss-Newton matrix of all candidates, Float[free, free]."""
        with ignore_floating_errors():
            return as_array(self._compiled.sums.normal(self._compiled.full(values)).matrix).copy()

    def scatter(self, values: Float, curvature: Float) -> Float:
        """Return the variance of the gradient by the noise of all candidates, Float[free, free].

        Args:
            values: the free values, Float[free].
            curvature: that of all candidates.
        """
        if self._fitted.estimate.noise is None:
            return np.asarray(self._fitted.estimate.dispersion * curvature)
        weights = dict.fromkeys(data.weight for data in self.datasets)
        return np.asarray(np.sum([self._scatter_of(weight, values) for weight in weights], axis=0))

    def _scatter_of(self, weight: float, values: Float) -> Float:
        """Return the variance of the gradient by the noise of the candidates of one weight, Float[free, free]."""
        shares = self._fitted.noise_shares(self._fitted.problem.criteria, weight)
        scaled = [replace(c, weight=c.weight * share) for c, share in zip(self.problem.criteria, shares, strict=True)]
        own = self.problem.over([data for data in self.datasets if data.weight == weight])
        compiled = CompiledProblem(replace(own, criteria=tuple(scaled)))
        with ignore_floating_errors():
            return as_array(compiled.sums.normal(compiled.full(values)).matrix).copy()


def _plain(criterion: Criterion) -> Criterion:
    """Return a criterion without what depends on residuals, or on channels that candidates do not have."""
    return replace(criterion, loss="square", weight_channel="", regions=())


def _with_targets(data: Dataset, channels: Sequence[str], weight: float = 1.0) -> Dataset:
    """Return a dataset with targets of 0, which count at every sample that is scored."""
    zeros = np.zeros(data.samples)
    others = tuple(channel for channel in data.channels if channel.name not in channels)
    targets = tuple(Channel(name, zeros) for name in channels)
    return replace(data, channels=(*others, *targets), weight=weight, use="training")
