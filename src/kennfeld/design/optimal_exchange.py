"""Exact D- and I-optimal designs of linear models, by exchange with rank-one updates.

With the rows x of the chosen points, M = X'X and d_ij = x_i' M^-1 x_j, putting candidate j in the place of point i
multiplies det M by

    (1 + d_jj) (1 - d_ii) + d_ij^2                                   (V. Fedorov: Theory of Optimal Experiments, 1972)

and changes trace(M^-1 W), the mean variance of prediction with the moments W, by

    -[(1 - d_ii) w_jj + 2 d_ij w_ij - (1 + d_jj) w_ii] / that factor,   w_ij = x_i' M^-1 W M^-1 x_j

Both are known for all pairs from two products with the candidates, which each exchange updates.
"""

from typing import Literal

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.design.subsets import BEST_TIMES, best_subset

Criterion = Literal["D", "I"]
STARTS = 10
MOST_STARTS = 100  # of a small problem whose best design was found less than three times
SMALL = 3000  # points times candidates of such a problem
EXCHANGES = 1000  # in one descent; each lowers the criterion
LEAST_GAIN = 1e-9
REFRESH = 50  # exchanges after which M^-1 is computed anew, before rounding adds up
RANK_TOLERANCE = 1e-10
PLACE = Location("design")


@dataclass(frozen=True, eq=False)
class ExactDesign:
    """Candidates chosen for a linear model.

    Attributes:
        chosen: their numbers, rising; a number may occur several times.
        log_det: logarithm of det X'X.
        variance: mean variance of prediction over all candidates, in units of the noise.
    """

    chosen: tuple[int, ...]
    log_det: float
    variance: float


def exchange(
    rows: Float, count: int, criterion: Criterion = "D", *, repeats: bool = True, seed: int = 0, starts: int = STARTS
) -> ExactDesign:
    """Choose points for a linear model: the best of all choices, or of descents from several random starts.

    Args:
        rows: the model at each candidate, Float[candidates, coefficients].
        count: number of points.
        criterion: `D` maximises det X'X, `I` minimises the mean variance of prediction over the candidates.
        repeats: allow a candidate several times.
        seed: of the starts.
        starts: number of descents.

    Raises:
        InputError: fewer points or candidates than the model has coefficients, or candidates that do not determine it.
    """
    _require_enough(rows, count, repeats=repeats)
    # in the coordinates of an orthonormal basis no column is small beside the others
    basis, triangle = np.linalg.qr(rows)
    shift = 2 * float(np.log(np.abs(np.diagonal(triangle))).sum())
    best = best_subset(
        range(len(rows)), count, lambda each: _values(basis, each, criterion), count * basis.shape[1], repeats=repeats
    )
    chosen = sorted(_searched(basis, count, criterion, seed, starts, repeats=repeats) if best is None else best[1])
    moment = basis[chosen].T @ basis[chosen]
    log_det = float(np.linalg.slogdet(moment)[1])
    variance = float(np.einsum("ij,jk,ik->i", basis, np.linalg.inv(moment), basis).mean())
    return ExactDesign(tuple(chosen), log_det + shift, variance)


def _values(basis: Float, chosen: Int, criterion: Criterion) -> Float:
    """Return the criterion, which is least at the best, for several choices of points, Int[choices, points]."""
    rows = basis[chosen]
    moments = rows.transpose(0, 2, 1) @ rows
    # of all points together M is the unit matrix: an eigenvalue of rounding is one of a singular M
    regular = np.linalg.eigvalsh(moments)[:, 0] > RANK_TOLERANCE
    values = np.full(len(chosen), np.inf)
    if criterion == "D":
        values[regular] = -np.linalg.slogdet(moments[regular])[1]
    else:
        inverses = np.linalg.inv(moments[regular])
        values[regular] = np.trace(inverses @ (basis.T @ basis / len(basis)), axis1=1, axis2=2)
    return values


def _searched(basis: Float, count: int, criterion: Criterion, seed: int, starts: int, *, repeats: bool) -> list[int]:
    """Return the best of several descents; of a small problem, until three of them ended at the best."""
    random, best, value, times = np.random.default_rng(seed), list[int](), np.inf, 0
    most = max(starts, MOST_STARTS) if count * len(basis) <= SMALL else starts
    for number in range(most):
        if number >= starts and times >= BEST_TIMES:
            break
        chosen = _start(basis, count, random, repeats=repeats)
        own = _descend(basis, chosen, criterion, repeats=repeats)
        if not best or own < value - LEAST_GAIN * abs(value):
            best, value, times = chosen, own, 1
        elif own <= value + LEAST_GAIN * abs(value):
            times += 1
    return best


def _require_enough(rows: Float, count: int, *, repeats: bool) -> None:
    candidates, size = rows.shape
    if count < size:
        message = f"{count} points cannot determine the {size} coefficients of the model"
        raise InputError.of(PLACE, message, f"Ask for at least {size} points, or choose a simpler model.")
    if not repeats and candidates < count:
        message = f"there are {candidates} candidates for {count} points"
        raise InputError.of(PLACE, message, "Name more candidates, or ask for fewer points.")
    singular = np.linalg.svd(rows, compute_uv=False)
    rank = int(np.sum(singular > RANK_TOLERANCE * singular[0]))
    if rank < size:
        message = f"the candidates determine {rank} of the {size} coefficients of the model"
        raise InputError.of(PLACE, message, "Use more levels of each channel, or a simpler model.")


def _start(basis: Float, count: int, random: np.random.Generator, *, repeats: bool) -> list[int]:
    """Return random points, completed so that M is regular: each of the first `size` adds most to the others."""
    candidates, size = basis.shape
    pool = random.choice(candidates, min(candidates, max(4 * size, 50)), replace=False)
    rest, chosen = basis[pool].copy(), list[int]()
    for _ in range(size):
        lengths = np.einsum("ij,ij->i", rest, rest)
        at = int(lengths.argmax())
        if lengths[at] < RANK_TOLERANCE**2:
            return _start_of_all(basis, count, random, repeats=repeats)
        chosen.append(int(pool[at]))
        direction = rest[at] / np.sqrt(lengths[at])
        rest -= np.outer(rest @ direction, direction)
    return _completed(chosen, candidates, count, random, repeats=repeats)


def _start_of_all(basis: Float, count: int, random: np.random.Generator, *, repeats: bool) -> list[int]:
    """Return the same from all candidates, if a random part of them does not determine the model."""
    from scipy.linalg import qr

    order = qr(basis.T, mode="r", pivoting=True)[1]
    return _completed(order[: basis.shape[1]].tolist(), len(basis), count, random, repeats=repeats)


def _completed(
    chosen: list[int], candidates: int, count: int, random: np.random.Generator, *, repeats: bool
) -> list[int]:
    more = count - len(chosen)
    others = np.arange(candidates) if repeats else np.setdiff1d(np.arange(candidates), chosen)
    return [*chosen, *random.choice(others, more, replace=repeats).tolist()]


def _descend(basis: Float, chosen: list[int], criterion: Criterion, *, repeats: bool) -> float:
    """Exchange points, in place, while the criterion falls; return it: -log det M, or the mean variance."""
    moments = basis.T @ basis / len(basis)
    inverse: Float = np.zeros((0, 0))
    for number in range(EXCHANGES):
        if number % REFRESH == 0:
            inverse = np.asarray(np.linalg.inv(basis[chosen].T @ basis[chosen]), dtype=np.float64)
        reach = basis @ inverse  # M^-1 x of all candidates
        own = basis[chosen]
        cross = own @ reach.T  # d_ij, Float[points, candidates]
        each = np.einsum("ij,ij->i", reach, basis)  # d_jj
        mine = each[chosen]
        factor = (1 + each[None]) * (1 - mine[:, None]) + cross**2
        if criterion == "D":
            gain = factor - 1
            least = LEAST_GAIN
        else:
            weighted = reach @ moments
            w_each = np.einsum("ij,ij->i", weighted, reach)
            w_cross = reach[chosen] @ weighted.T
            change = (
                (1 - mine[:, None]) * w_each[None] + 2 * cross * w_cross - (1 + each[None]) * w_each[chosen][:, None]
            )
            # an exchange that makes M singular has no finite variance
            gain = np.where(factor > RANK_TOLERANCE, change / np.maximum(factor, RANK_TOLERANCE), -np.inf)
            least = LEAST_GAIN * float(np.trace(inverse @ moments))
        if not repeats:
            gain[:, chosen] = -np.inf
        at, other = divmod(int(gain.argmax()), len(basis))
        if gain[at, other] <= least:
            break
        inverse = _exchanged(inverse, basis[chosen[at]], basis[other])
        chosen[at] = other
    moment = basis[chosen].T @ basis[chosen]
    if criterion == "D":
        return -float(np.linalg.slogdet(moment)[1])
    return float(np.trace(np.linalg.solve(moment, moments)))


def _exchanged(inverse: Float, old: Float, new: Float) -> Float:
    """Return M^-1 after a row is replaced by another (J. Sherman, W. Morrison, Ann. Math. Stat. 21, 1950)."""
    reach = inverse @ new
    inverse = inverse - np.outer(reach, reach) / (1 + new @ reach)
    reach = inverse @ old
    return np.asarray(inverse + np.outer(reach, reach) / (1 - old @ reach))
