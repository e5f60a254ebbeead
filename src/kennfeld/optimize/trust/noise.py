"""How much the measurements scatter about the fitted model.

Samples of one criterion in datasets of one weight form a group; each group has a noise of its own, since weights may
say how good data are, or merely how much they matter. Under robust losses the moments of psi, half the slope of the
loss, take the place of those of the residual (P. J. Huber: Robust Regression, Annals of Statistics 1, 1973): a value's
variance is E[psi^2] / E[psi']^2 times that of a unit noise.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float
from kennfeld.native import Samples
from kennfeld.optimize.criterion import Criterion
from kennfeld.optimize.data.binding import Bound

__all__ = ["LEAST", "Group", "groups", "persistence", "rescored"]

LEAST = 1.0  # degrees of freedom that a group needs to speak for itself


@dataclass(frozen=True)
class Group:
    """The residuals of one criterion over the datasets of one weight, in units of the criterion's scale."""

    criterion: int
    score: float  # weight of criterion times weight of dataset
    count: int
    squares: float  # sum of psi^2
    weight: float  # mean of psi / residual, what the matrix of the fit was weighted with
    slope: float  # mean of psi'
    persistence: float  # samples for each one that is independent of those before

    def variance(self, effective: float) -> float:
        """Variance of psi, after a fit that used up so many degrees of freedom; NaN where nothing is left of them."""
        left = self.count - effective
        return self.squares / left if left >= LEAST else float("nan")


def groups(criteria: Sequence[Criterion], bounds: Sequence[Bound], errors: Sequence[Float]) -> list[Group]:
    """The groups of the training data; `errors` are model minus target, (criteria, samples), NaN where not scored."""
    found = []
    for i, criterion in enumerate(criteria):
        for weight in dict.fromkeys(bound.dataset.weight for bound in bounds):
            members = [(b, e[i]) for b, e in zip(bounds, errors, strict=True) if b.dataset.weight == weight]
            if criterion.weight > 0:
                found.append(_group(i, criterion, weight, members))
    return [group for group in found if group.count]


def _group(number: int, criterion: Criterion, weight: float, members: Sequence[tuple[Bound, Float]]) -> Group:
    whole = np.concatenate([e[np.isfinite(e)] for _, e in members]) / criterion.scale
    weights, slopes = _influence(whole, criterion)
    lasting = [persistence(e[a:b]) for bound, e in members if bound.dataset.time is not None for a, b in _pieces(bound)]
    return Group(
        criterion=number,
        score=criterion.weight * weight,
        count=whole.size,
        squares=float(np.sum((whole * weights) ** 2)),
        weight=float(np.mean(weights)) if whole.size else 1.0,
        slope=max(float(np.mean(slopes)), 1e-3) if whole.size else 1.0,
        persistence=_mean(lasting),
    )


def _influence(r: Float, criterion: Criterion) -> tuple[Float, Float]:
    """Psi / r and psi' of each residual."""
    delta = criterion.delta
    match criterion.loss:
        case "square":
            return np.ones(r.size), np.ones(r.size)
        case "huber":
            inside = np.abs(r) <= delta
            return np.where(inside, 1.0, delta / np.maximum(np.abs(r), delta)), inside.astype(np.float64)
        case "soft_l1":
            root = np.sqrt(1 + (r / delta) ** 2)
            return 1 / root, root**-3
        case "excess":
            above = (r > 0).astype(np.float64)
            return above, above


def _pieces(bound: Bound) -> Iterator[tuple[int, int]]:
    return pairwise([*bound.starts.tolist(), bound.count])


def _mean(lasting: Sequence[tuple[float, int]]) -> float:
    total = sum(count for _, count in lasting)
    return sum(length * count for length, count in lasting) / total if total else 1.0


def persistence(residual: Float) -> tuple[float, int]:
    """Samples for each independent one in a recording, 1 + 2 sum of its autocorrelation; and how many are scored.

    The sum ends where the autocorrelation is lost in its own scatter, 2 / sqrt(samples).
    """
    known = np.isfinite(residual)
    count = int(known.sum())
    if count < 8:
        return 1.0, count
    centred = np.where(known, residual - residual[known].mean(), 0.0)
    room = 2 ** int(np.ceil(np.log2(2 * centred.size)))
    turned = np.fft.rfft(centred, room)
    products = np.fft.irfft(np.abs(turned) ** 2, room)[: centred.size // 2]
    if products[0] <= 0:
        return 1.0, count
    correlation = products[1:] / products[0]
    lost = np.flatnonzero(correlation < 2 / np.sqrt(count))
    end = int(lost[0]) if lost.size else correlation.size
    return float(1 + 2 * correlation[:end].sum()), count


def rescored(samples: Samples, scores: dict[tuple[int, float], float]) -> Samples:
    """The samples with other weights: by criterion and the weight they had, 0 for those not named."""
    pieces = [
        replace(piece, scores=np.array([scores.get((c, float(s)), 0.0) for c, s in enumerate(piece.scores)]))
        for piece in samples.pieces
    ]
    made = copy(samples)
    made.pieces = tuple(pieces)
    return made
