"""Length scales and noise of a Gaussian process, by maximising its likelihood from several starts.

The likelihood is multiplied by a prior exp(-SHORTEST sqrt(inputs) / (2 length)) of each length, in units of spread: of
few points in many inputs, it is highest for lengths at which each point is alone, and the process then fits noise.
"""

from collections.abc import Callable, Iterable

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Kernel
from kennfeld.surrogate.exact_gp import exact_likelihood
from kennfeld.surrogate.gp_kernel import LEFT, Plane, greedy
from kennfeld.surrogate.sparse_gp import sparse_bound
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.training_points import TrainingPoints

LENGTHS = (2e-2, 1e3)  # in units of an input's spread; at the upper end it is without effect beyond the plane
NOISE = (1e-8, 1e3)  # share of the variance of f
SHORTEST = 1.0  # of the prior
FIRST_NOISES = (1e-2, 1e-1)
FACTORS = (1.0, 2.0, 4.0)  # of the lengths of the screening, at which the bound is tried: those of few points are short
SCALES = (0.3, 0.5, 1.0, 2.0)  # of the first lengths, in spreads times the root of the number of inputs
SCREENED = 300  # points that the starts are tried on
SEARCHED = 2000  # points of the sparse search
SEARCHED_CENTRES = 120
ROUNDS = 2  # inducing inputs are chosen again at the lengths just found
FEW = 12  # iterations after which the best search is continued
BEST = 2  # starts that the bound is maximised from

Likelihood = Callable[[Float], tuple[float, Float]]


@dataclass(frozen=True, eq=False)
class Hyperparameters:
    """Length scales Float[inputs] and eta, in units of spread, and the kernel they are for."""

    lengths: Float
    noise: float
    kernel: Kernel

    @classmethod
    def of(cls, values: Float, kernel: Kernel) -> "Hyperparameters":
        """Return those whose logarithms a search has found."""
        return cls(np.exp(values[:-1]), float(np.exp(values[-1])), kernel)

    @property
    def values(self) -> Float:
        """The logarithms of the lengths and, last, of eta."""
        return np.asarray(np.log(np.append(self.lengths, self.noise)), dtype=np.float64)

    @property
    def at_limit(self) -> str:
        """Return "lower" if a length ended at its least value, "upper" if all ended at their greatest, else ""."""
        if np.any(self.lengths <= LENGTHS[0] * 1.001):
            return "lower"
        return "upper" if np.all(self.lengths >= LENGTHS[1] * 0.999) else ""


def exact_hyperparameters(
    points: TrainingPoints,
    kernel: Kernel,
    starts: int,
    seed: int,
    iterations: int = 100,
    stopped: Stopped = never,
    near: Hyperparameters | None = None,
) -> Hyperparameters:
    """Return length scales and eta of the exact process; those `near` are a further start."""
    best = _screen_starts(points, kernel, starts, np.random.default_rng(seed), iterations, stopped, near)
    # with fewer points, the screening was the search over all of them
    if len(points) > SCREENED and not stopped():
        plane = Plane.over(points.x)
        search = [best] if near is None else [best, near.values]
        best = _best_of(lambda values: exact_likelihood(values, points, plane, kernel), search, iterations, stopped)
    return Hyperparameters.of(best, kernel)


def sparse_hyperparameters(
    points: TrainingPoints,
    kernel: Kernel,
    centres: int,
    starts: int,
    seed: int,
    iterations: int = 30,
    stopped: Stopped = never,
    near: Hyperparameters | None = None,
) -> Hyperparameters:
    """Return length scales and eta of the sparse process; those `near`, if there are any, are the only start.

    The bound is maximised from the best of several starts: multiples of the lengths of an exact process of a few
    points, and lengths of the order of the data's spread.
    """
    rng = np.random.default_rng(seed)
    search = [near.values] if near is not None else _first_values(points.x.shape[1], starts, rng)
    if near is None:
        screened = _screen_starts(points, kernel, starts, rng, iterations, stopped)
        search += [screened + np.append(np.full(screened.size - 1, np.log(factor)), 0.0) for factor in FACTORS]
    # lengths are searched on a sample of the points; the noise is refined on all of them by `Sparse.at`
    points = points.draw(SEARCHED, rng)
    plane = Plane.over(points.x, points.weights)
    count = min(centres, SEARCHED_CENTRES)

    def bound_at(values: Float) -> Likelihood:
        # inducing inputs are chosen at the start of a search and stay: the bound is smooth in the lengths only then
        z = points.x[greedy(points.x, count, np.exp(values[:-1]), LEFT, kernel)]
        return lambda changed: sparse_bound(changed, points, z, plane, kernel)

    highest = sorted(search, key=lambda values: -_value(bound_at(values), values))[:BEST]
    ends = [_maximise(bound_at(start), start, FEW, stopped) for start in highest]
    best = max(ends, key=lambda end: end[0])[1]
    for _ in range(ROUNDS):
        if stopped():
            break
        best = _maximise(bound_at(best), best, iterations, stopped)[1]
    return Hyperparameters.of(best, kernel)


def _first_values(inputs: int, starts: int, rng: np.random.Generator) -> list[Float]:
    """Return starts of a search: equal lengths of several scales, and `starts` - 1 that are drawn around the middle."""
    # distances grow with the root of the number of inputs, and with them the lengths at which points are neighbours
    root = 0.5 * np.log(max(inputs, 2))
    equal = [
        np.append(np.full(inputs, root + np.log(scale)), np.log(noise)) for scale in SCALES for noise in FIRST_NOISES
    ]
    middle = np.append(np.full(inputs, root), np.log(FIRST_NOISES[0]))
    return equal + [middle + rng.normal(0.0, [*([1.0] * inputs), 2.0]) for _ in range(max(starts, 1) - 1)]


def _screen_starts(
    points: TrainingPoints,
    kernel: Kernel,
    starts: int,
    rng: np.random.Generator,
    iterations: int,
    stopped: Stopped,
    near: Hyperparameters | None = None,
) -> Float:
    """Return the best of several searches for the highest exact likelihood of a few points."""
    points = points.draw(SCREENED, rng)
    plane = Plane.over(points.x)

    def likelihood(values: Float) -> tuple[float, Float]:
        return exact_likelihood(values, points, plane, kernel)

    if near is not None:
        return _maximise(likelihood, near.values, iterations, stopped)[1]
    first = _first_values(points.x.shape[1], starts, rng)
    first.sort(key=lambda values: -_value(likelihood, values))
    return _best_of(likelihood, first[: max(starts, BEST)], iterations, stopped)


def _best_of(likelihood: Likelihood, starts: Iterable[Float], iterations: int, stopped: Stopped) -> Float:
    """Return the position of the highest likelihood, by a short search from each start and a long one from the best."""
    ends: list[tuple[float, Float]] = []
    for start in starts:
        if not ends or not stopped():
            ends.append(_maximise(likelihood, start, min(FEW, iterations), stopped))
    return _maximise(likelihood, max(ends, key=lambda end: end[0])[1], iterations, stopped)[1]


def _value(likelihood: Likelihood, values: Float) -> float:
    try:
        return likelihood(_clip(values))[0]
    except np.linalg.LinAlgError:
        return -np.inf


def _bounds(count: int) -> list[tuple[float, float]]:
    lengths, noise = (tuple(np.log(pair).tolist()) for pair in (LENGTHS, NOISE))
    return [lengths] * (count - 1) + [noise]


def _clip(values: Float) -> Float:
    clipped: Float = np.clip(values, *np.transpose(_bounds(values.size)))
    return clipped


def _maximise(likelihood: Likelihood, start: Float, iterations: int, stopped: Stopped) -> tuple[float, Float]:
    """Return the highest product of likelihood and prior, and its position."""
    from scipy.optimize import minimize

    shortest = 0.5 * SHORTEST * np.sqrt(start.size - 1)

    def negative(values: Float) -> tuple[float, Float]:
        try:
            value, slope = likelihood(values)
        except np.linalg.LinAlgError:
            # finite, so that the line search can interpolate a shorter step
            return 1e25, np.zeros(values.size)
        prior = shortest * np.exp(-values[:-1])
        return float(prior.sum()) - value, -slope - np.append(prior, 0.0)

    def check(_: Float) -> None:
        if stopped():
            raise StopIteration  # by which scipy ends at the best so far

    options = {"maxiter": iterations, "ftol": 1e-7, "maxfun": 2 * iterations}
    best = minimize(
        negative,
        _clip(start),
        jac=True,
        bounds=_bounds(start.size),
        method="L-BFGS-B",
        options=options,
        callback=check,
    )
    return -float(best.fun), np.asarray(best.x, dtype=np.float64)
