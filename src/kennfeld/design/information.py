"""Information of candidates, of the present data and of the use, at several sets of values around a fit."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, ignore_floating_errors
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.candidate_data import CandidateData
from kennfeld.design.coverage import WeightedCoverage
from kennfeld.design.fitted_function import FittedFunction
from kennfeld.domain.criteria import Criterion
from kennfeld.domain.dataset import Dataset
from kennfeld.preprocessing.binding import BoundDataset


@dataclass(frozen=True, eq=False)
class Information:
    """Sums of squared slopes, each at several sets of values.

    Attributes:
        known: of the data of the fit, with what is known without data, Float[draws, free].
        candidates: of each candidate, Float[draws, candidates, free].
        use: mean of a sample of the use, Float[draws, free].
        usable: candidates at which the function has finite values, Bool[candidates].
    """

    known: Float
    candidates: Float
    use: Float
    usable: Bool

    @classmethod
    def of(
        cls,
        fitted: FittedFunction,
        candidates: Sequence[Dataset],
        owners: Sequence[Int],
        count: int,
        use: Sequence[Dataset],
        seed: int = 0,
        *,
        alike: bool = False,
        recorded: bool = False,
        measured: Sequence[Criterion] | None = None,
    ) -> "Information":
        """Evaluate candidates and use together, by one kernel.

        Args:
            fitted: the fit.
            candidates: datasets that contain the candidates.
            owners: for each of them the candidate that a sample belongs to, Int[samples]; -1 for none.
            count: number of candidates.
            use: the operation that matters; samples that are not scored do not count, the others by their weights.
            seed: of the sets of values.
            recorded: the candidates are training data, and keep their targets and weights.
            measured: the criteria whose targets candidates have; by default all.
            alike: training and test data of the use count alike, however many samples they have.

        Raises:
            InputError: no free value has an effect in the operation that matters.
        """
        together = CandidateData(fitted, candidates, use=use, recorded=recorded, measured=measured)
        kinds = [data.use if alike else "" for data in use]
        parts = {kind: count + number for number, kind in enumerate(dict.fromkeys(kinds))}
        groups = [
            *owners,
            *(np.where(data.counting, parts[kind], -1) for data, kind in zip(use, kinds, strict=True)),
        ]
        visits = np.zeros(len(parts))
        for data, kind in zip(together.datasets[len(candidates) :], kinds, strict=True):
            visits[parts[kind] - count] += _total_weight(together.problem.bind(data))
        known, located = list[Float](), list[Float]()
        robust = _slopes(fitted)
        for values in fitted.draws(seed):
            with ignore_floating_errors():
                own = fitted.compiled.sums.normal(fitted.compiled.full(values)).matrix.diagonal().copy()
            squares = together.squares(values, groups, count + len(parts))
            # a draw at which the function fails says nothing; the fit itself comes first
            if not known or (np.isfinite(own).all() and np.isfinite(squares[count:]).all()):
                known.append(robust * np.nan_to_num(own, posinf=0.0) + fitted.prior)
                located.append(squares)
        squares = np.array(located)
        usable: Bool = np.asarray(np.isfinite(squares[:, :count]).all(axis=(0, 2)))
        squares = np.nan_to_num(squares, nan=0.0, posinf=0.0)
        squares[..., fitted.fixed] = 0.0
        mean = (squares[:, count:] / np.where(visits > 0, visits, 1)[:, None]).mean(axis=1)
        if not mean.any():
            message = "no value that may change has an effect in the operation that matters"
            remedy = "Check what locks, bounds and pins hold, and the operation of `use`."
            raise InputError.of(Location("design"), message, remedy)
        return cls(np.array(known), squares[:, :count], mean, usable)

    @property
    def coverage(self) -> WeightedCoverage:
        """The variance of prediction over the use, as a function of the candidates that are measured."""
        return WeightedCoverage(self.known, self.candidates, self.use)


def _slopes(fitted: FittedFunction) -> Float:
    """Return the curvature of each value, which is by psi', relative to that by psi / r of the search, Float[free].

    They differ with a robust loss, whose candidates count by psi'.
    """
    own = fitted.compiled.sums.normal(fitted.compiled.full(fitted.values)).matrix.diagonal()
    return np.divide(fitted.estimate.own, own, out=np.ones_like(own), where=own > 0)


def _total_weight(bound: BoundDataset) -> float:
    """Return the sum of the weights of the samples that count; those that cannot be evaluated do not."""
    name = bound.dataset.weight_channel
    if not name:
        return float(bound.scored.sum())
    return float(np.nan_to_num(bound.channel(name))[bound.scored].sum())
