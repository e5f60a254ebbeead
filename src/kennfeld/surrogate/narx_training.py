"""Training of dynamic surrogates: one step ahead, then for free run, in which the recursion is fed with its own output.

The one-step solution is a sparse Gaussian process from measured past values to the present one. Free-run training is
Levenberg-Marquardt on the residuals of the free run, with exact sensitivities through the recursion:

    dy_k/dp = df/dp (x_k) + sum over output lags l of df/dy_{k-l} dy_{k-l}/dp

The weights are moved in the whitened basis L^-1 k(z, x), in which the square of their change is the roughness of the
change of f (its norm in the reproducing kernel Hilbert space). `TrainingSettings.hold` times that square is added to
the squared residuals: what the data do not determine stays at the one-step solution or, with `toward_plane`, shrinks to
the plane.

Free runs are trained over increasing horizons: after thousands of steps the gradients of a one-step model explode or
vanish, while short runs from measured outputs converge well and give a good start for longer ones. The short runs of a
horizon are simulated in parallel.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.gp_kernel import factor, gaussian_kernel, greedy_centres
from kennfeld.surrogate.hyperparameters import sparse_hyperparameters
from kennfeld.surrogate.recursion import UNLIMITED, FreeRun, Lags, Recording, Runs, input_slopes, run_through, simulate
from kennfeld.surrogate.sparse_gp import Sparse
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.training_data import Scaling, check_points
from kennfeld.surrogate.training_points import TrainingPoints

BLOCK = 1 << 21  # numbers of the Jacobian held at a time: 16 MB
PLANE = 1e-4  # how firmly the plane is held, in shares of `hold`
MOST_DAMPING = 1e10
NEGLIGIBLE = 0.1  # share of the tolerance: a step that promises less is not tried
PATIENCE = 2  # small gains in a row after which training ends
WIDEST = 1.5  # a centre's width changes by at most exp of this

LENGTH_STEPS = 15  # of the search for length scales, which are cut in any case
HORIZONS = (30, 120, 500)  # samples
EARLY_SAMPLES = 10_000  # that are used at most for all horizons but the last

FIRST_NOISE = 1e-2
LEFT = 1e-6


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of free-run training.

    `hold` is the regularisation toward the start, or toward the plane of the expansion; 1 corresponds to about one
    standard deviation of the output. `moves_centres` refines centres and widths as well. Training ends when two
    consecutive steps lower the cost by less than `tolerance`, relatively, or after `iterations`.
    """

    hold: float = 10.0
    toward_plane: bool = True
    moves_centres: bool = False
    limits: tuple[float, float] = UNLIMITED
    iterations: int = 10
    tolerance: float = 1e-3


class TrainedValues:
    """The trained values and their expansion, in units of the training data's spread."""

    def __init__(self, start: Expansion, runs: Runs, settings: TrainingSettings) -> None:
        self.start, self.moves_centres = start, settings.moves_centres
        target = runs.one_step_target
        self.height = float(target.std()) or 1.0
        self.centre, self.spread = runs.points.mean(0), runs.points.std(0)
        self.spread[self.spread <= 0] = 1.0
        self.lengths = start.widths[0] if start.size else np.ones(start.inputs)
        self.root = (
            factor(gaussian_kernel(start.centres, start.centres, self.lengths)) if start.size else np.empty((0, 0))
        )
        # values: offset and slopes of the scaled inputs, whitened weights L'w, then moves and growths of the centres
        plane = [start.offset + float(start.slopes @ self.centre), *(start.slopes * self.spread)]
        moves = np.zeros(2 * start.size * start.inputs if self.moves_centres else 0)
        self.first = np.concatenate([np.array(plane) / self.height, self.root.T @ start.weights / self.height, moves])
        self.hold = settings.hold * np.ones(self.first.size)
        # the plane is nearly free; a little hold keeps the matrix regular if inputs are collinear
        self.hold[: start.inputs + 1] *= PLANE
        self.goal = self.first.copy()
        if settings.toward_plane:
            self.goal[start.inputs + 1 : start.inputs + 1 + start.size] = 0.0

    def expansion(self, values: Float) -> Expansion:
        from scipy.linalg import solve_triangular

        start, d = self.start, self.start.inputs
        # back from units of spread to those of the channels
        slopes = self.height * values[1 : d + 1] / self.spread
        weights = self.height * solve_triangular(self.root, values[d + 1 : d + 1 + start.size], lower=True, trans="T")
        centres, widths = start.centres, start.widths
        if self.moves_centres:
            moves, growths = values[d + 1 + start.size :].reshape(2, start.size, d)
            centres, widths = centres + widths * moves, widths * np.exp(np.clip(growths, -WIDEST, WIDEST))
        return Expansion(self.height * values[0] - float(slopes @ self.centre), slopes, weights, centres, widths)

    def direct(self, expansion: Expansion, x: Float, own: int) -> tuple[Float, Float]:
        """Compute df/dp, in units of height, and df/dx of the first `own` inputs, at points Float[points, inputs]."""
        from scipy.linalg import solve_triangular

        plane = [np.ones((len(x), 1)), (x - self.centre) / self.spread]
        if not self.moves_centres:
            near = gaussian_kernel(x, expansion.centres, self.lengths)
            whitened = solve_triangular(self.root, near.T, lower=True).T
            return np.concatenate([*plane, whitened], axis=1), input_slopes(expansion, x, near, own)
        distance = (x[:, None, :] - expansion.centres) / expansion.widths
        near = np.exp(-0.5 * np.einsum("imd,imd->im", distance, distance))
        columns = [*plane, solve_triangular(self.root, near.T, lower=True).T]
        # df/dz_md = w_m k_m (x_d - z_md) / s_md^2; a move is in widths of the start, a growth is d log s
        steep = (near * (expansion.weights / self.height))[:, :, None] * distance
        columns.append((steep * (self.start.widths / expansion.widths)).reshape(len(x), -1))
        columns.append((steep * distance).reshape(len(x), -1))
        return np.concatenate(columns, axis=1), input_slopes(expansion, x, near, own)


def train_free_run(
    start: Expansion,
    runs: Runs,
    settings: TrainingSettings,
    report: Callable[[int, float], None] = lambda step, rmse: None,
    stopped: Stopped = never,
) -> Expansion:
    """Return the expansion that meets the output of `runs` best when it runs on its own outputs, from `start` on.

    `report` is called after each step with the RMSE in units of the output, before which `stopped` tells whether to end
    at the best so far. If the start itself diverges, it is
    returned unchanged. All widths of `start` must be one row repeated.
    """
    from scipy.linalg import cho_factor, cho_solve

    values = TrainedValues(start, runs, settings)
    at = values.first
    expansion, run, cost = _evaluate(values, at, runs, settings)
    damping, calm, count = 1e-2, 0, int(runs.scored.sum())
    for step in range(settings.iterations if np.isfinite(cost) else 0):
        if stopped():
            break
        matrix, gradient = _normal(values, expansion, run, runs)
        matrix.flat[:: at.size + 1] += values.hold
        gradient += values.hold * (at - values.goal)
        # Marquardt's scaling; the floor damps values that no sample depends on
        scale = np.diag(matrix) + 1e-9 * np.diag(matrix).max()
        before, growth = cost, 4.0
        while damping < MOST_DAMPING:
            damped = cho_factor(matrix + np.diag(damping * scale), lower=True, overwrite_a=True)
            change = cho_solve(damped, gradient)
            if gradient @ change < NEGLIGIBLE * settings.tolerance * cost:
                break  # even the linear model of the cost falls by less than counts
            trial = at - change
            trial_expansion, trial_run, trial_cost = _evaluate(values, trial, runs, settings)
            if trial_cost < cost:
                at, expansion, run, cost = trial, trial_expansion, trial_run, trial_cost
                damping = max(damping / 5, 1e-12)
                break
            damping *= growth
            growth *= 2.0
        report(step, values.height * float(np.sqrt(_misfit(run, runs, values) / count)))
        calm = 0 if before - cost > settings.tolerance * before else calm + 1
        if calm >= PATIENCE or damping >= MOST_DAMPING:
            break
    return expansion


def _evaluate(
    values: TrainedValues, at: Float, runs: Runs, settings: TrainingSettings
) -> tuple[Expansion, FreeRun, float]:
    expansion = values.expansion(at)
    run = simulate(expansion, runs, settings.limits)
    cost = _misfit(run, runs, values) + float(values.hold @ (at - values.goal) ** 2)
    return expansion, run, cost if np.isfinite(cost) else np.inf


def _misfit(run: FreeRun, runs: Runs, values: TrainedValues) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sum(((run.y - runs.target)[runs.scored] / values.height) ** 2))


def _normal(values: TrainedValues, expansion: Expansion, run: FreeRun, runs: Runs) -> tuple[Float, Float]:
    """Return J'J and J'r of the free run, block by block of its steps; the last rows of a block begin the next."""
    lags, size = runs.lags.output, values.first.size
    steps, pieces = run.y.shape
    back = max(lags)
    visited = runs.visited(run.y)
    residual = np.where(runs.scored, run.y - runs.target, 0.0) / values.height
    matrix, gradient = np.zeros((size, size)), np.zeros(size)
    block = max(BLOCK // (size * pieces), 1)
    rows = np.zeros((back, pieces, size))
    for first in range(0, steps, block):
        part = slice(first, min(first + block, steps))
        direct, slopes = values.direct(expansion, visited[part].reshape(-1, expansion.inputs), len(lags))
        rows = np.concatenate([rows[-back:], direct.reshape(-1, pieces, size)])
        # an output at a limit does not change with any value, nor with the outputs before
        rows[back:][run.held[part]] = 0.0
        run_through(rows, np.where(run.held[part][:, :, None], 0.0, slopes.reshape(-1, pieces, len(lags))), lags)
        counted = rows[back:][runs.scored[part]]
        matrix += counted.T @ counted
        gradient += counted.T @ residual[part][runs.scored[part]]
    return matrix, gradient


def free_run_rmse(expansion: Expansion, runs: Runs, limits: tuple[float, float] = UNLIMITED) -> float:
    """Return the RMSE of the free run in units of the output; infinite if it diverges."""
    with np.errstate(over="ignore", invalid="ignore"):
        residual = (simulate(expansion, runs, limits).y - runs.target)[runs.scored]
        rmse = float(np.sqrt(np.mean(residual**2)))
    return rmse if np.isfinite(rmse) else np.inf


def cut_recordings(pieces: Sequence[Recording], lags: Lags, horizon: int) -> list[Recording]:
    """Return the pieces in stretches of about `horizon` samples, which share the lags at their ends."""
    return [piece.part(*span) for piece in pieces for span in horizon_ranges(0, len(piece), lags, horizon)]


def horizon_ranges(first: int, end: int, lags: Lags, horizon: int) -> Iterator[tuple[int, int]]:
    """Return first and end of each stretch."""
    # a stretch is about five times what it repeats of the one before, or longer
    parts = max(round((end - first) / max(horizon, 5 * lags.longest)), 1)
    edges = np.linspace(first, end, parts + 1).astype(int).tolist()
    # each begins earlier by the longest lag: the samples at a cut are predicted as well
    yield from ((max(a - lags.longest, first), b) for a, b in pairwise(edges))


def train_over_horizons(
    start: Expansion,
    pieces: Sequence[Recording],
    lags: Lags,
    settings: TrainingSettings,
    report: Callable[[int, int, float], None] = lambda horizon, step, rmse: None,
    stopped: Stopped = never,
) -> Expansion:
    """Return the expansion that meets the output best in free runs of the longest horizon; see `train_free_run`."""
    longest = max(len(piece) for piece in pieces)
    expansion, horizons = start, [h for h in HORIZONS if h < longest] or [longest]
    for horizon in horizons:
        if stopped():
            break
        stretches = cut_recordings(pieces, lags, horizon)
        if horizon != horizons[-1]:  # only a start for longer runs
            stretches = stretches[:: max(sum(map(len, stretches)) // EARLY_SAMPLES, 1)]
        runs = Runs.of(stretches, lags)
        expansion = train_free_run(expansion, runs, settings, partial(report, horizon), stopped)
    return expansion


def one_step_lengths(
    runs: Runs, centres: int, limits: tuple[float, float], starts: int, seed: int, stopped: Stopped = never
) -> Float:
    """Search the length scale of each number of a point, in units of its spread, by the highest likelihood."""
    x, y = _within_limits(runs, limits)
    scaling = Scaling.of(x, y)
    target = (y - scaling.level) / scaling.height
    points = TrainingPoints.of(scaling.inward(x), target)
    return sparse_hyperparameters(points, "gaussian", centres, starts, seed, LENGTH_STEPS, stopped).lengths


def one_step_expansion(
    runs: Runs, lengths: Float, centres: int, limits: tuple[float, float], seed: int = 0
) -> Expansion:
    """Fit the process with given length scales, in units of spread, and a limited number of centres."""
    x, y = _within_limits(runs, limits)
    scaling = Scaling.of(x, y)
    inner = scaling.inward(x)
    z = greedy_centres(inner, centres, lengths, seed, LEFT)
    points = TrainingPoints.of(inner, (y - scaling.level) / scaling.height)
    process = Sparse.at(points, z, lengths, FIRST_NOISE)
    return scaling.expansion(*process.terms(), lengths)


def _within_limits(runs: Runs, limits: tuple[float, float]) -> tuple[Float, Float]:
    """Return the points whose output is not at a limit, where it carries little information on the function."""
    target = runs.one_step_target
    free = (target > limits[0]) & (target < limits[1])
    if not free.any():
        raise ArgumentError(f"limits={limits} hold the output at every sample; widen them")
    return check_points(runs.points[free], target[free])
