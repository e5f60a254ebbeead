"""A second minimum of the cost beyond a fold of a poorly determined direction.

Along such a direction, with all other values adapted, the residual is linear only as long as its slope does not
vanish. A product of two tables has a slope that does: (p + x)(q + x) is the same if the factors change places, and
half-way between both ends the Jacobian is singular. With the curvature S = 1 / f'H^-1 f of the cost along the
direction, where f is the amount of it in a change, the root of S is the length of the slope. Its values here and a
short way off tell where it vanishes; the other minimum, if any, is about as far beyond it, and a descent from there
finds it. A direction without a fold costs one linearisation, or three if the slope only seems to vanish, at a kink.

If several factors may change places, the poorly determined directions of one minimum do not lead to all others: those
of each minimum are followed in turn.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.symmetric import as_array, as_sparse
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.matrices import part
from kennfeld.optimize.trust.table_changes import WeakDirection
from kennfeld.optimize.trust.weak_directions import solve_singular

MAX_DIRECTIONS = 3  # that are followed from each minimum
MAX_MINIMA = 7  # with the first one, those of three pairs of factors
WAY = (1e-3, 0.1)  # least and most of the size of the values, for the change that shows a fold
DEVIATIONS = 2.0  # this change if it is between both
REACH = 10.0  # times the size of the values: a fold that is farther off is none
VANISHED = 0.25  # of the curvature here: what is left of it at a fold
DESCENT = SolverSettings(max_iterations=50)
EQUAL = 9.0  # variances of noise by which the cost there may be above the cost here
APART = 25.0  # the same for what the linearised cost says of that place


@dataclass(frozen=True)
class SecondMinimum:
    """Values that fit about as well as those at the end of a fit.

    `weight` is the probability of the place, from the costs alone: 1/2 if both are equal.
    """

    direction: WeakDirection  # in which it was found
    change: Float  # Float[values], from the end of the fit to there
    cost: float
    weight: float


def second_minima(
    objective: LeastSquaresObjective,
    limits: LinearLimits,
    values: Float,
    local: Estimate,
    directions: Iterable[WeakDirection],
    surroundings: Callable[[Float], tuple[Estimate, Sequence[WeakDirection]] | None] = lambda values: None,
    allowed: Callable[[Float], bool] = lambda values: True,
) -> Iterator[SecondMinimum]:
    """Yield the second minima beyond folds of poorly determined directions.

    Args:
        objective: the cost that was minimised.
        limits: of its free values.
        values: the end of the fit, Float[values].
        local: the estimate there.
        directions: the poorly determined directions, worst first.
        surroundings: returns the estimate and the poorly determined directions at a second minimum, if there are any.
        allowed: returns True for values that keep the output limits.
    """
    cost, variance = objective.cost(values), local.dispersion
    known: list[Float] = []
    places = [(values, local, list(directions))] if variance > 0 else []
    while places:
        place, around, ways = places.pop(0)
        for direction, end in _ends_beyond_folds(objective, limits, place, around, ways):
            rise, change = (end.cost - cost) / variance, end.values - values
            # the cost of the linearised model there: if it is small, the place belongs to the known minimum
            narrow = local.narrow(change)
            said = float(narrow @ (local.data @ narrow) + narrow @ (local.smoothness @ narrow)) / variance
            new = not any(np.allclose(change, other, rtol=0.1, atol=0.0) for other in known)
            if rise > EQUAL or said < max(APART, APART * rise) or not new or not allowed(end.values):
                continue
            known.append(change)
            # the likelihoods of both places are as exp(-rise / 2) to 1; the exponent is limited to what a double holds
            yield SecondMinimum(direction, change, end.cost, float(1 / (1 + np.exp(np.clip(rise / 2, -700, 700)))))
            if len(known) == MAX_MINIMA:
                return
            # breadth first: the directions of the first minimum before those of others
            beside = surroundings(end.values)
            if beside is not None:
                places.append((end.values, beside[0], list(beside[1])))


def _ends_beyond_folds(
    objective: LeastSquaresObjective,
    limits: LinearLimits,
    values: Float,
    local: Estimate,
    directions: Iterable[WeakDirection],
) -> Iterator[tuple[WeakDirection, SolverResult]]:
    """Yield the end of a descent from beyond the fold of each direction that has one."""
    determined = [each for each in directions if np.isfinite(each.deviation) and not each.exact]
    for direction in determined[:MAX_DIRECTIONS]:
        beyond = _beyond_fold(objective, values, local, direction)
        start = None if beyond is None else project(values + beyond, limits)[0]
        if start is not None and np.isfinite(objective.cost(start)):
            yield direction, levenberg_marquardt(objective, start, limits, DESCENT)


def _beyond_fold(
    objective: LeastSquaresObjective, values: Float, local: Estimate, direction: WeakDirection
) -> Float | None:
    """Return the change that leads as far beyond the nearest fold as it is away; None without."""
    weights = local.narrow(direction.change)
    # f = D w / w'D w measures the amount of the direction w; it is 1 for the change H^-1 f / f'H^-1 f, to which all
    # other values are adapted
    amount = np.maximum(local.data.diagonal(), 0.0) * weights
    amount /= amount @ weights
    reach = local.spectrum.inverse.times(amount)
    curvature = 1 / float(amount @ reach)
    change = local.expand(reach * curvature)
    # values near 0 count as large as a share of the largest one
    sizes = np.maximum(np.abs(values), np.abs(values).max(initial=0.0) * WAY[0])
    size = 1 / float(np.max(np.abs(change) / np.where(sizes > 0, sizes, 1.0)))
    way = min(max(DEVIATIONS * float(np.sqrt(local.dispersion / curvature)), WAY[0] * size), WAY[1] * size)
    fold = _find_fold(
        lambda amounts: _curvature(objective, values + amounts * change, local, amount), curvature, way, REACH * size
    )
    return None if fold is None else 2 * fold * change


def _find_fold(curvature_at: Callable[[float], float], here: float, way: float, reach: float) -> float | None:
    """Return where the root of a curvature changes its sign, as an amount of a change; None if not within reach.

    It is extrapolated from a short way; if this leads too far, it is then interpolated.
    """
    # the root of the curvature falls linearly: 1 here, slope after the way, and 0 at way / (1 - slope)
    slope = float(np.sqrt(curvature_at(way) / here))
    fold = np.divide(way, 1 - slope)
    for _ in range(2):
        # the other minimum is twice as far; false for NaN as well
        if not abs(fold) <= reach / 2:
            return None
        ratio = curvature_at(fold) / here
        if ratio <= VANISHED:
            return float(fold)
        fold = fold / (1 + np.sqrt(ratio))  # the root is negative there
    return None


def _curvature(objective: LeastSquaresObjective, values: Float, local: Estimate, amount: Float) -> float:
    """Return the curvature along a direction elsewhere, with all other values adapted."""
    matrix = objective.normal(values)[1]
    whole = local.reduction.matrix(as_array(matrix) if isinstance(local.data, np.ndarray) else as_sparse(matrix))
    narrow = part(whole, local.seen)
    # a value without effect there has no curvature to adapt by
    if not (narrow.diagonal() > 0).all():
        return float("nan")
    return 1 / float(amount @ solve_singular(narrow, amount))
