"""Number of independent samples: as many as would tell the mean of the errors of a model as precisely.

Errors in time are correlated, and counting every sample as independent would let tables follow them.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.problem.partitions import dataset_numbers
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.optimize.trust.persistence import MAX_LAGS, lagged_products


@dataclass
class CorrelationSums:
    """Sums of products of errors by their distance in samples, from 0, over pieces of at most `longest` samples."""

    sums: Float  # Float[lags]
    longest: int

    @classmethod
    def of(cls, pieces: Sequence[Float]) -> "CorrelationSums":
        """Return the sums over pieces, Float[samples] each; NaN is ignored."""
        longest = max((piece.size for piece in pieces), default=0)
        sums = np.zeros(max(min(longest, MAX_LAGS + 1), 1))
        for piece in pieces:
            lags = min(piece.size, sums.size)
            if lags:
                sums[:lags] += lagged_products(np.nan_to_num(piece), lags - 1)
        return cls(sums, longest)

    def merge(self, later: "CorrelationSums") -> None:
        """Take in the sums over other pieces."""
        sums = np.zeros(max(self.sums.size, later.sums.size))
        for own in (self.sums, later.sums):
            sums[: own.size] += own
        self.sums, self.longest = sums, max(self.longest, later.longest)

    @property
    def time(self) -> float:
        """The correlation time: 1 + 2 sum of the autocorrelation in samples, up to the lag where it is largest.

        The variance of a mean of n correlated samples is that of n / (this number) independent ones.

        >>> CorrelationSums.of([np.repeat(np.random.default_rng(0).normal(size=2000), 10)]).time > 8
        True
        """
        if not self.sums[0] > 0:
            return 1.0
        # products at lags beyond half of a piece are few, and their sum is noise
        shares = self.sums[1 : self.longest // 2] / self.sums[0]
        return float(1 + 2 * np.max(np.cumsum(shares), initial=0.0))


@dataclass
class _Errors:
    """The errors of one criterion over a dataset: how many are known, and their autocorrelation in time."""

    count: float
    correlation: CorrelationSums | None = None

    def merge(self, later: "_Errors") -> None:
        self.count += later.count
        if self.correlation is not None and later.correlation is not None:
            self.correlation.merge(later.correlation)

    @property
    def independent(self) -> float:
        return self.count if self.correlation is None else self.count / self.correlation.time


def independent_samples(problem: Problem, parameters: ParameterSet) -> float:
    """Return the effective number of scored training samples of all criteria.

    Samples of data with time are divided by their correlation time. Of data in partitions, pairs of samples are those
    within one.
    """
    merged: dict[int, list[_Errors]] = {}
    for number, rows in (pair for part in problem.each(_survey_errors, parameters) for pair in part):
        if number not in merged:
            merged[number] = rows
            continue
        for own, later in zip(merged[number], rows, strict=True):
            own.merge(later)
    return sum(row.independent for rows in merged.values() for row in rows)


def _survey_errors(problem: Problem, parameters: ParameterSet) -> list[tuple[int, list[_Errors]]]:
    """Return the errors of each training dataset, with its number among all datasets."""
    scorer, surveys = Scorer(problem), []
    for number, data in zip(dataset_numbers(problem.datasets), problem.datasets, strict=True):
        if not data.is_fitted:
            continue
        bound, rows = problem.bind(data), []
        in_time = data.time is not None and bound.hold is None
        pieces = list(pairwise([*bound.starts.tolist(), bound.count]))
        for row, criterion in zip(scorer.errors(bound, parameters), problem.criteria, strict=True):
            if criterion.weight > 0:
                known = float(np.isfinite(row).sum())
                rows.append(_Errors(known, CorrelationSums.of([row[a:b] for a, b in pieces]) if in_time else None))
        surveys.append((number, rows))
    return surveys
