"""A fitted function as designs see it: its curvatures, plausible values around it, and how long it remembers."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.traversal import with_names
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.problem import Problem, time_constants
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.information_matrix import ConstraintElimination
from kennfeld.optimize.trust.matrices import whole
from kennfeld.optimize.trust.trust import Trust

DRAWS = 4  # sets of values around the fit over which information is averaged
MOST_DRAWN = 3000  # values up to which their covariance is factorised
SPREAD = 0.05  # share of the values of a table at either end that do not count for its spread
LAG_SHARE = 0.9  # quantile of a time constant over the samples that a warm-up is made for
LEAST_NOISE = 1e-200
WHOLE = 5.0  # s, from which a warm-up is rounded up
LAGS = 3.0  # time constants after which a start has decayed, to 5 %


@dataclass(frozen=True, eq=False)
class FittedFunction:
    """The end of a fit, with all that a design reads of it.

    Attributes:
        problem: the problem that was fitted, at the values of the fit.
        trust: the uncertainty of these values.
        estimate: the curvatures around them.
        converged: True if the search ended at a minimum.
        unknown: values that only further data have, such as the offset of a recording to come, Bool[free].
    """

    problem: Problem
    trust: Trust
    estimate: Estimate
    converged: bool
    unknown: Bool

    @classmethod
    def of(cls, result: Result, unknown: Mapping[str, Bool] | None = None) -> "FittedFunction":
        """Return the end of a fit in this process.

        Args:
            result: the result of the fit.
            unknown: by parameter the values that only further data have; the fit held them.

        Raises:
            InputError: nothing is known around the end.
        """
        trust = result.trust
        problem = getattr(result.inspection, "problem", None)
        if trust.estimate is None or problem is None or not np.isfinite(trust.estimate.dispersion):
            message = f"the fit ended with status {result.status}, and the uncertainty of its values is unknown"
            remedy = "Fit the function first; see the message of calibrate."
            if trust.estimate is not None and problem is not None:
                message = (
                    "the noise of the data is unknown, as there are not more samples than values that they determine"
                )
                remedy = 'Measure a few points that fill the ranges first: method = "sobol" in [design].'
            raise InputError.of(Location("design"), message, remedy)
        mask = np.zeros(trust.estimate.reduction.size, dtype=bool)
        for name, where in (unknown or {}).items():
            first = trust.columns.get(name, mask.size)
            mask[first : first + where.size] = where
        estimate = _released(trust.estimate, mask)
        mask &= trust.estimate.reduction.fixed
        return cls(replace(problem, parameters=result.parameters), trust, estimate, result.converged, mask)

    @cached_property
    def compiled(self) -> CompiledProblem:
        """The compiled problem, with the fitted values as its start."""
        return CompiledProblem(self.problem)

    @cached_property
    def values(self) -> Float:
        """The fitted values, Float[free]."""
        return self.compiled.start[: self.compiled.values.free].copy()

    @property
    def noise(self) -> float:
        """Variance of the values per inverse curvature of the cost, as in `Estimate.dispersion`."""
        # data without noise leave a variance of rounding, or none at all
        return max(self.estimate.dispersion, LEAST_NOISE)

    @cached_property
    def weight(self) -> float:
        """The weight that further data will have: that of the datasets with most training samples."""
        samples: dict[float, int] = {}
        for data in self.problem.fitted_datasets:
            samples[data.weight] = samples.get(data.weight, 0) + int(np.count_nonzero(data.counting))
        return max(samples, key=lambda weight: samples[weight]) if samples else 1.0

    @cached_property
    def spread(self) -> Float:
        """Size that a change of each value may have before anything is known of it, Float[free].

        It is the range of the values that the data determine in the same table, without the outer 5 %, or the size of
        the table if that range is 0.
        """
        spread = np.ones(self.values.size)
        own = self.estimate.own
        for first, size in self.blocks.values():
            part = slice(first, first + size)
            values, known = self.values[part], own[part] > 0
            values = values[known] if known.any() else values
            ends = np.quantile(values, [SPREAD, 1 - SPREAD]) if values.size > 1 else np.zeros(2)
            largest = float(np.abs(values).max(initial=0.0))
            spread[part] = float(np.ptp(ends)) or largest or 1.0
        return spread

    @cached_property
    def blocks(self) -> dict[str, tuple[int, int]]:
        """By parameter the first of its free values, and their number; axes with free breakpoints by their name."""
        layout = self.compiled.values
        starts = {name: at for name, at in layout.offsets.items() if at < layout.free}
        starts |= {str(key): at for key, at in layout.moving.items() if at < layout.free}
        ordered = sorted(starts.items(), key=lambda pair: pair[1])
        ends = [*(at for _, at in ordered[1:]), layout.free]
        return {name: (at, end - at) for (name, at), end in zip(ordered, ends, strict=True)}

    @cached_property
    def prior(self) -> Float:
        """Curvature along each value that is known without data, from its spread and from smoothness, Float[free]."""
        return self.ridge + self._diagonal(whole(self.estimate.smoothness).diagonal())

    @property
    def ridge(self) -> Float:
        """Curvature that a standard deviation of the spread corresponds to, Float[free]."""
        return self.noise / self.spread**2

    def _diagonal(self, seen: Float) -> Float:
        """Return a diagonal over the values of the estimate, over all values, Float[free]."""
        diagonal = np.zeros(self.values.size)
        diagonal[self.estimate.reduction.independent[self.estimate.seen]] = seen
        return diagonal

    @cached_property
    def curvature(self) -> Float:
        """Curvature of data and smoothness over the independent values, Float[independent, independent]."""
        estimate = self.estimate
        known = np.flatnonzero(estimate.seen)
        curvature = np.zeros((estimate.seen.size,) * 2)
        curvature[np.ix_(known, known)] = whole(estimate.data) + whole(estimate.smoothness)
        return curvature

    def draws(self, seed: int = 0, count: int = DRAWS) -> list[Float]:
        """Return the fitted values, and `count` sets drawn from their covariance within the bounds.

        The information of a sample is that of the grid points around it, which move with the values where tables feed
        each other or time constants.
        """
        reduction, size = self.estimate.reduction, self.estimate.seen.size
        if size > MOST_DRAWN or not size:
            return [self.values]
        limits = linear_limits(self.problem, self.compiled.values)
        units = self.spread[reduction.independent]
        # with the spread as prior, values without data do not leave the range of their table
        scaled = self.curvature * np.outer(units, units) / self.noise + np.eye(size)
        # x = L'^-1 z has the covariance (L L')^-1
        factor = np.linalg.cholesky(scaled)
        normal = np.random.default_rng(seed).standard_normal((size, count))
        changes = units[:, None] * np.linalg.solve(factor.T, normal)
        drawn = self.values + reduction.expand(changes.T)
        return [self.values, *np.clip(drawn, limits.lower, limits.upper)]

    @cached_property
    def fixed(self) -> Bool:
        """Mask of the values that locks, bounds or pins hold, Bool[free]."""
        return self.estimate.reduction.fixed

    def warmup(self) -> float:
        """Return the time in s after which a recording does not depend on how it began, by the fitted time constants.

        It is three times the largest of the time constants, each at its 90 % quantile over the training samples; 0 for
        a function without lags.
        """
        graph = self.problem.model.graph
        lags = time_constants(graph)
        if not lags:
            return 0.0
        names = {at: f"\0lag {number}" for number, at in enumerate(lags)}
        simulator = NodeSimulator(with_names(graph, names), self.problem.parameters, list(names.values()))
        longest = 0.0
        for bound in self.problem.training:
            if bound.count:
                values = np.abs(simulator.values(bound, self.problem.parameters))
                longest = max(longest, float(np.nanquantile(values, LAG_SHARE, axis=1).max()))
        # a number that can be driven: whole seconds of a long one
        warmup = LAGS * longest
        return float(np.ceil(warmup)) if warmup > WHOLE else warmup


def _released(estimate: Estimate, unknown: Bool) -> Estimate:
    """Return an estimate in which values move that the fit held; nothing is known of them, Bool[free]."""
    before = estimate.reduction
    more = np.setdiff1d(np.flatnonzero(unknown & before.fixed), before.dependent)
    if not more.size:
        return estimate
    independent = np.sort(np.concatenate([before.independent, more]))
    places = np.searchsorted(independent, before.independent)
    follow, seen = np.zeros((before.dependent.size, independent.size)), np.zeros(independent.size, dtype=bool)
    follow[:, places], seen[places] = before.follow, estimate.seen
    reduction = ConstraintElimination(before.size, independent, before.dependent, follow)
    return replace(estimate, reduction=reduction, seen=seen)
