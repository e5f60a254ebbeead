"""Candidate measurements evaluated by the fitted function: what each would tell about every value.

A candidate needs the inputs of the function only. Its targets are those that would be measured; a sum of squared slopes
does not depend on them.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Float, Int, ignore_floating_errors
from kennfeld.design.candidate_weights import CandidateWeights
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
        measured: those of the criteria whose targets the candidates have; by default all of them.
    """

    def __init__(
        self,
        fitted: FittedFunction,
        datasets: Sequence[Dataset],
        criteria: Sequence[Criterion] | None = None,
        use: Sequence[Dataset] = (),
        *,
        recorded: bool = False,
        measured: Sequence[Criterion] | None = None,
    ) -> None:
        own = fitted.problem.criteria
        scored = tuple(own if criteria is None else criteria)
        channels = {c.target.name for c in own if fitted.problem.target_node(c) is None and c.target.kind != "number"}
        channels |= {c.target.name for c in scored if c.target.kind == "channel"}
        # a channel that the function reads must be among the candidates
        channels -= {fitted.problem.channels.get(name, name) for name in fitted.problem.model.graph.inputs}
        self._fitted, self._criteria = fitted, scored
        # a node that is measured in addition counts like the first one
        numbers = [own.index(criterion if criterion in own else scored[0]) for criterion in scored]
        self._weights = [CandidateWeights(fitted, number, channels, recorded=recorded) for number in numbers]
        names, kept = sorted(channels), [replace(data, use="training") for data in datasets]
        known = {criterion.target.name for criterion in (scored if measured is None else measured)}
        located = kept if recorded else [_with_targets(data, names, fitted.weight, known) for data in datasets]
        self._factors = [[each.factors(data) for each in self._weights] for data in located]
        self._candidates = [replace(data, weight_channel="") for data in located]
        weighted = [_with_weights(*pair) for pair in zip(self._candidates, self._factors, strict=True)]
        self.datasets = (*weighted, *(_with_targets(data, names) for data in use))
        self.problem = fitted.problem.over(self.datasets)
        criteria = tuple(self._plain(at, c) for at, c in enumerate(scored))
        self._same = criteria == own and not any(data.weight_channel for data in self.datasets)
        # the kernel of a fit with weights reads them
        self._same &= not fitted.compiled.weighting.inputs
        # whether a bare name is a channel depends on the data of the fit, which may have it where candidates do not
        resolved = (replace(c, target=fitted.problem.resolved_target(c)) for c in criteria)
        self.problem = replace(self.problem, criteria=tuple(resolved))

    def _plain(self, number: int, criterion: Criterion) -> Criterion:
        """Return a criterion without what depends on residuals, and with the weights of the candidates."""
        own = self._weights[number]
        named = any(factors[number] is not None for factors in self._factors)
        return replace(
            criterion,
            loss="square",
            weight=criterion.weight * own.mean * own.slope,
            weight_channel=_weight_channel(number) if named else "",
            regions=(),
        )

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

    @cached_property
    def shares(self) -> list[Float]:
        """Variance of the gradient per curvature of each candidate, by dataset, each Float[outputs, samples]."""
        return [
            np.array(
                [
                    own.shares(c.weight * data.weight, own.mean * (np.ones(data.samples) if f is None else f))
                    for own, c, f in zip(self._weights, self._criteria, factors, strict=True)
                ]
            )
            for data, factors in zip(self._candidates, self._factors, strict=True)
        ]

    def scatter(self, values: Float, curvature: Float) -> Float:
        """Return the variance of the gradient by the noise of all candidates, Float[free, free].

        Args:
            values: the free values, Float[free].
            curvature: that of all candidates.
        """
        if self._fitted.estimate.noise is None:
            return np.asarray(self._fitted.estimate.dispersion * curvature)
        # the share of a sample multiplies its weight
        weighted = []
        for data, factors, shares in zip(self._candidates, self._factors, self.shares, strict=True):
            own = [share if f is None else share * f for share, f in zip(shares, factors, strict=True)]
            weighted.append(_with_weights(data, own))
        criteria = [replace(c, weight_channel=_weight_channel(at)) for at, c in enumerate(self.problem.criteria)]
        compiled = CompiledProblem(replace(self.problem.over(weighted), criteria=tuple(criteria)))
        with ignore_floating_errors():
            return as_array(compiled.sums.normal(compiled.full(values)).matrix).copy()


def _weight_channel(number: int) -> str:
    """Return the channel of the weights for a criterion, which no channel of a user is called."""
    return f"\0weight of {number}"


def _with_weights(data: Dataset, weights: Sequence[Float | None]) -> Dataset:
    """Return a dataset with the weights of its samples for each criterion, Float[samples] each."""
    further = [Channel(_weight_channel(at), own) for at, own in enumerate(weights) if own is not None]
    return replace(data, channels=(*data.channels, *further)) if further else data


def _with_targets(
    data: Dataset, channels: Sequence[str], weight: float = 1.0, known: Collection[str] | None = None
) -> Dataset:
    """Return a dataset with targets of 0, which count at every sample that is scored, those that are known."""
    zeros = np.zeros(data.samples)
    others = tuple(channel for channel in data.channels if channel.name not in channels)
    targets = tuple(Channel(name, zeros) for name in channels if known is None or name in known)
    return replace(data, channels=(*others, *targets), weight=weight, use="training")
