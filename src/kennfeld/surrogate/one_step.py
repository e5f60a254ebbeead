"""Training one step ahead: a sparse Gaussian process from measured past values to the present one."""

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError
from kennfeld.expansion import Expansion
from kennfeld.surrogate.hyperparameters import sparse_hyperparameters
from kennfeld.surrogate.inducing import greedy
from kennfeld.surrogate.recursion import Runs
from kennfeld.surrogate.scaling import Scaling, checked_points
from kennfeld.surrogate.sparse import Sparse

__all__ = ["one_step_expansion", "one_step_lengths", "one_step_residual"]

FIRST_NOISE = 1e-2
CANDIDATES = 5000
LEFT = 1e-6


def one_step_lengths(runs: Runs, centres: int, limits: tuple[float, float], starts: int, seed: int) -> Float:
    """The length scale of each number of a point, in units of its spread, by the highest likelihood."""
    x, y = _free(runs, limits)
    scaling = Scaling.of(x, y)
    target = (y - scaling.level) / scaling.height
    return sparse_hyperparameters(scaling.inward(x), target, centres, starts, seed)[0]


def one_step_expansion(
    runs: Runs, lengths: Float, centres: int, limits: tuple[float, float], seed: int = 0
) -> Expansion:
    """The process with given length scales, in units of spread, and at most so many centres; the noise is estimated."""
    x, y = _free(runs, limits)
    scaling = Scaling.of(x, y)
    inner = scaling.inward(x)
    few = inner
    if len(inner) > CANDIDATES:
        few = inner[np.random.default_rng(seed).choice(len(inner), CANDIDATES, replace=False)]
    z = few[greedy(few, centres, lengths, LEFT)]
    process = Sparse.at(inner, (y - scaling.level) / scaling.height, z, lengths, FIRST_NOISE)
    return scaling.expansion(*process.terms(), lengths)


def one_step_residual(expansion: Expansion, runs: Runs, limits: tuple[float, float]) -> Float:
    """Prediction less measurement at each of the points, Float[samples]."""
    residual: Float = np.clip(expansion(runs.points), *limits) - runs.one_step_target
    return residual


def _free(runs: Runs, limits: tuple[float, float]) -> tuple[Float, Float]:
    """The points whose output no limit holds: at a limit it says little of the function."""
    target = runs.one_step_target
    free = (target > limits[0]) & (target < limits[1])
    if not free.any():
        raise ArgumentError(f"limits={limits} hold the output at every sample; widen them")
    return checked_points(runs.points[free], target[free])
