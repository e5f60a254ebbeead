"""Length scales and noise of a Gaussian process, by maximising its likelihood from several starts."""

from collections.abc import Callable

import numpy as np

from kennfeld.arrays import Float
from kennfeld.surrogate.exact_gp import exact_likelihood
from kennfeld.surrogate.gp_kernel import Plane, greedy
from kennfeld.surrogate.sparse_gp import sparse_bound
from kennfeld.surrogate.stopping import Stopped, never

LENGTHS = (2e-2, 1e3)  # in units of an input's spread; at the upper end it is without effect beyond the plane
NOISE = (1e-8, 1e3)  # share of the variance of f
FIRST_NOISE = 1e-2
SCREENED = 300  # points that the starts are tried on
SEARCHED = 2000  # points of the sparse search
SEARCHED_CENTRES = 120
ROUNDS = 2  # inducing inputs are chosen again at the lengths just found

Likelihood = Callable[[Float], tuple[float, Float]]


def exact_hyperparameters(
    x: Float, y: Float, starts: int, seed: int, iterations: int = 100, stopped: Stopped = never
) -> tuple[Float, float]:
    """Return length scales Float[inputs] and eta of the exact process, all in units of spread."""
    best = _screen_starts(x, y, starts, np.random.default_rng(seed), iterations, stopped)
    if len(y) > SCREENED and not stopped():
        plane = Plane.over(x)
        best = _maximise(lambda values: exact_likelihood(values, x, y, plane), best, iterations, stopped)[1]
    return np.exp(best[:-1]), float(np.exp(best[-1]))


def sparse_hyperparameters(
    x: Float, y: Float, centres: int, starts: int, seed: int, iterations: int = 30, stopped: Stopped = never
) -> tuple[Float, float]:
    """Return length scales and eta of the sparse process: the exact ones of a subset, improved on the bound."""
    rng = np.random.default_rng(seed)
    best = _screen_starts(x, y, starts, rng, iterations, stopped)
    x, y = _draw(x, y, SEARCHED, rng)
    plane = Plane.over(x)
    for _ in range(ROUNDS):
        if stopped():
            break
        z = x[greedy(x, min(centres, SEARCHED_CENTRES), np.exp(best[:-1]))]
        best = _maximise(lambda values, z=z: sparse_bound(values, x, y, z, plane), best, iterations, stopped)[1]  # type: ignore[misc]
    return np.exp(best[:-1]), float(np.exp(best[-1]))


def _draw(x: Float, y: Float, most: int, rng: np.random.Generator) -> tuple[Float, Float]:
    part = np.arange(len(y)) if len(y) <= most else np.sort(rng.choice(len(y), most, replace=False))
    return x[part], y[part]


def _screen_starts(
    x: Float, y: Float, starts: int, rng: np.random.Generator, iterations: int, stopped: Stopped
) -> Float:
    """Return the best result of several searches for the highest exact likelihood of a few points.

    The first begins at middling smoothness, the others at points that are drawn around it.
    """
    x, y = _draw(x, y, SCREENED, rng)
    plane, inputs = Plane.over(x), x.shape[1]
    middle = np.append(np.full(inputs, 0.5 * np.log(max(inputs, 2))), np.log(FIRST_NOISE))
    others = [middle + rng.normal(0.0, [*([1.0] * inputs), 2.0]) for _ in range(max(starts, 1) - 1)]
    ends = [
        _maximise(lambda values: exact_likelihood(values, x, y, plane), start, iterations, stopped)
        for number, start in enumerate((middle, *others))
        if number == 0 or not stopped()
    ]
    return max(ends, key=lambda end: end[0])[1]


def _maximise(likelihood: Likelihood, start: Float, iterations: int, stopped: Stopped) -> tuple[float, Float]:
    """Return the highest likelihood and its position."""
    from scipy.optimize import minimize

    def negative(values: Float) -> tuple[float, Float]:
        try:
            value, slope = likelihood(values)
        except np.linalg.LinAlgError:
            return 1e25, np.zeros(values.size)
        return -value, -slope

    def check(_: Float) -> None:
        if stopped():
            raise StopIteration  # by which scipy ends at the best so far

    bounds = [tuple(np.log(LENGTHS))] * (start.size - 1) + [tuple(np.log(NOISE))]
    clipped = np.clip(start, *np.transpose(bounds))
    options = {"maxiter": iterations, "ftol": 1e-7, "maxfun": 2 * iterations}
    best = minimize(negative, clipped, jac=True, bounds=bounds, method="L-BFGS-B", options=options, callback=check)
    return -float(best.fun), np.asarray(best.x, dtype=np.float64)
