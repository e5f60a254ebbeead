"""Training for free run: the numbers of an expansion are moved until the recursion, fed with itself, meets the output.

Levenberg-Marquardt on the residuals of the free run, with exact sensitivities through the recursion:

    dy_k/dp = df/dp (x_k) + sum over output lags l of df/dy_{k-l} dy_{k-l}/dp

The weights are moved in the whitened basis L^-1 k(z, x), in which the square of their change is the roughness of the
change of f (its norm in the space of the kernel). `Settings.hold` times that square is added to the squared residuals:
what the data do not ask for stays as the one-step solution has it, or, with `toward_plane`, becomes the plane.

Training for free run over longer and longer stretches.

A model that was trained one step ahead may run far off within thousands of steps, and the error there says little about
where to go: its slopes grow and fade with the length of the run. Over short stretches from measured outputs the way is
plain, and each longer stretch begins near its end. Stretches run side by side, so short ones are quick as well.

Training one step ahead: a sparse Gaussian process from measured past values to the present one.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError
from kennfeld.rbf import Expansion
from kennfeld.surrogate.gp_kernel import bells, factor, greedy
from kennfeld.surrogate.hyperparameters import sparse_hyperparameters
from kennfeld.surrogate.recursion import UNLIMITED, FreeRun, Lags, Recording, Runs, simulate
from kennfeld.surrogate.sparse_gp import Sparse
from kennfeld.surrogate.training_data import Scaling, checked_points

__all__ = [
    "HORIZONS",
    "TrainingSettings",
    "free_run_rmse",
    "horizon_ranges",
    "one_step_expansion",
    "one_step_lengths",
    "train_free_run",
    "train_over_horizons",
]

BLOCK = 1 << 21  # numbers of the Jacobian held at a time: 16 MB
PLANE = 1e-4  # how firmly the plane is held, in shares of `hold`
MOST_DAMPING = 1e10
PATIENCE = 2  # small gains in a row after which training ends
WIDEST = 1.5  # a centre's width changes by at most exp of this

HORIZONS = (30, 120, 500)  # samples

FIRST_NOISE = 1e-2
CANDIDATES = 5000
LEFT = 1e-6


@dataclass(frozen=True)
class TrainingSettings:
    """How training for free run is done.

    `hold` ties the expansion to where it began, or to its plane; 1 is about one standard deviation of the output.
    `moves_centres` refines centres and widths as well. Training ends when two steps in a row lower the cost by
    less than `tolerance`, relatively, or after `iterations`.
    """

    hold: float = 10.0
    toward_plane: bool = True
    moves_centres: bool = False
    limits: tuple[float, float] = UNLIMITED
    iterations: int = 10
    tolerance: float = 1e-3


class _Values:
    """The numbers that training moves, and the expansion they stand for; in units of the training data's spread."""

    def __init__(self, start: Expansion, runs: Runs, settings: TrainingSettings) -> None:
        self.start, self.moves_centres = start, settings.moves_centres
        target = runs.one_step_target
        self.height = float(target.std()) or 1.0
        self.centre, self.spread = runs.points.mean(0), runs.points.std(0)
        self.spread[self.spread <= 0] = 1.0
        self.lengths = start.widths[0] if start.size else np.ones(start.inputs)
        self.root = factor(bells(start.centres, start.centres, self.lengths)) if start.size else np.empty((0, 0))
        plane = [start.offset + float(start.slopes @ self.centre), *(start.slopes * self.spread)]
        moved = np.zeros(2 * start.size * start.inputs if self.moves_centres else 0)
        self.first = np.concatenate([np.array(plane) / self.height, self.root.T @ start.weights / self.height, moved])
        self.hold = settings.hold * np.ones(self.first.size)
        self.hold[: start.inputs + 1] *= PLANE
        self.goal = self.first.copy()
        if settings.toward_plane:
            self.goal[start.inputs + 1 : start.inputs + 1 + start.size] = 0.0

    def expansion(self, values: Float) -> Expansion:
        from scipy.linalg import solve_triangular

        start, d = self.start, self.start.inputs
        slopes = self.height * values[1 : d + 1] / self.spread
        weights = self.height * solve_triangular(self.root, values[d + 1 : d + 1 + start.size], lower=True, trans="T")
        centres, widths = start.centres, start.widths
        if self.moves_centres:
            moved, wider = values[d + 1 + start.size :].reshape(2, start.size, d)
            centres, widths = centres + widths * moved, widths * np.exp(np.clip(wider, -WIDEST, WIDEST))
        return Expansion(self.height * values[0] - float(slopes @ self.centre), slopes, weights, centres, widths)

    def direct(self, expansion: Expansion, x: Float, own: int) -> tuple[Float, Float]:
        """df/dp, in units of height, and df/dx of the first `own` inputs, at points Float[points, inputs]."""
        from scipy.linalg import solve_triangular

        plane = [np.ones((len(x), 1)), (x - self.centre) / self.spread]
        if not self.moves_centres:
            near = bells(x, expansion.centres, self.lengths)
            whitened = solve_triangular(self.root, near.T, lower=True).T
            return np.concatenate([*plane, whitened], axis=1), _slopes(expansion, x, near, own)
        distance = (x[:, None, :] - expansion.centres) / expansion.widths
        near = np.exp(-0.5 * np.einsum("imd,imd->im", distance, distance))
        columns = [*plane, solve_triangular(self.root, near.T, lower=True).T]
        steep = (near * (expansion.weights / self.height))[:, :, None] * distance
        columns.append((steep * (self.start.widths / expansion.widths)).reshape(len(x), -1))
        columns.append((steep * distance).reshape(len(x), -1))
        return np.concatenate(columns, axis=1), _slopes(expansion, x, near, own)


def _slopes(expansion: Expansion, x: Float, near: Float, own: int) -> Float:
    """df/dx of the first `own` inputs at points whose bells are known: Float[points, own]."""
    steep = expansion.weights[:, None] / expansion.widths[:, :own] ** 2
    pulled: Float = near @ (steep * expansion.centres[:, :own]) - x[:, :own] * (near @ steep)
    return expansion.slopes[:own] + pulled


def train_free_run(
    start: Expansion,
    runs: Runs,
    settings: TrainingSettings,
    report: Callable[[int, float], None] = lambda step, rmse: None,
) -> Expansion:
    """The expansion that meets the output of `runs` best when it runs on its own outputs, from `start` on.

    `report` is called after each step with the RMSE in units of the output. Where the start itself runs away, it is
    returned as it is. All widths of `start` must be one row repeated.
    """
    values = _Values(start, runs, settings)
    at = values.first
    expansion, run, cost = _evaluate(values, at, runs, settings)
    damping, calm, count = 1e-2, 0, int(runs.scored.sum())
    for step in range(settings.iterations if np.isfinite(cost) else 0):
        matrix, gradient = _normal(values, expansion, run, runs)
        matrix.flat[:: at.size + 1] += values.hold
        gradient += values.hold * (at - values.goal)
        scale = np.diag(matrix) + 1e-9 * np.diag(matrix).max()
        before = cost
        while damping < MOST_DAMPING:
            trial = at - _solved(matrix, damping * scale, gradient)
            tried, tried_run, tried_cost = _evaluate(values, trial, runs, settings)
            if tried_cost < cost:
                at, expansion, run, cost = trial, tried, tried_run, tried_cost
                damping = max(damping / 5, 1e-12)
                break
            damping *= 4
        report(step, values.height * float(np.sqrt(_misfit(run, runs, values) / count)))
        calm = 0 if before - cost > settings.tolerance * before else calm + 1
        if calm >= PATIENCE or damping >= MOST_DAMPING:
            break
    return expansion


def _solved(matrix: Float, damping: Float, gradient: Float) -> Float:
    from scipy.linalg import cho_factor, cho_solve

    damped = matrix + np.diag(damping)
    step: Float = cho_solve(cho_factor(damped, lower=True, overwrite_a=True), gradient)
    return step


def _evaluate(values: _Values, at: Float, runs: Runs, settings: TrainingSettings) -> tuple[Expansion, FreeRun, float]:
    expansion = values.expansion(at)
    run = simulate(expansion, runs, settings.limits)
    cost = _misfit(run, runs, values) + float(values.hold @ (at - values.goal) ** 2)
    return expansion, run, cost if np.isfinite(cost) else np.inf


def _misfit(run: FreeRun, runs: Runs, values: _Values) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.sum(((run.y - runs.target)[runs.scored] / values.height) ** 2))


def _normal(values: _Values, expansion: Expansion, run: FreeRun, runs: Runs) -> tuple[Float, Float]:
    """J'J and J'r of the free run, block by block of its steps; the last rows of a block begin the next."""
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
        rows[back:][run.held[part]] = 0.0
        slopes = slopes.reshape(-1, pieces, len(lags), 1)
        slopes[run.held[part]] = 0.0
        for k, steep in enumerate(slopes, back):
            for i, lag in enumerate(lags):
                rows[k] += steep[:, i] * rows[k - lag]
        counted = rows[back:][runs.scored[part]]
        matrix += counted.T @ counted
        gradient += counted.T @ residual[part][runs.scored[part]]
    return matrix, gradient


def free_run_rmse(expansion: Expansion, runs: Runs, limits: tuple[float, float] = UNLIMITED) -> float:
    """RMSE of the free run in units of the output; infinite where it runs away."""
    with np.errstate(over="ignore", invalid="ignore"):
        residual = (simulate(expansion, runs, limits).y - runs.target)[runs.scored]
        rmse = float(np.sqrt(np.mean(residual**2)))
    return rmse if np.isfinite(rmse) else np.inf


def split_recordings(pieces: Sequence[Recording], lags: Lags, horizon: int) -> list[Recording]:
    """The pieces in stretches of about `horizon` samples, which share the lags at their ends."""
    return [piece.part(*span) for piece in pieces for span in horizon_ranges(0, len(piece), lags, horizon)]


def horizon_ranges(first: int, end: int, lags: Lags, horizon: int) -> Iterator[tuple[int, int]]:
    """First and end of each stretch."""
    parts = max(round((end - first) / max(horizon, 5 * lags.longest)), 1)
    edges = np.linspace(first, end, parts + 1).astype(int).tolist()
    yield from ((max(a - lags.longest, first), b) for a, b in pairwise(edges))


def train_over_horizons(
    start: Expansion,
    pieces: Sequence[Recording],
    lags: Lags,
    settings: TrainingSettings,
    report: Callable[[int, int, float], None] = lambda horizon, step, rmse: None,
) -> Expansion:
    """The expansion that meets the output best in free runs of the longest horizon; see `train_free_run`."""
    longest = max(len(piece) for piece in pieces)
    expansion = start
    for horizon in [h for h in HORIZONS if h < longest] or [longest]:
        runs = Runs.of(split_recordings(pieces, lags, horizon), lags)

        def heard(step: int, rmse: float, horizon: int = horizon) -> None:
            report(horizon, step, rmse)

        expansion = train_free_run(expansion, runs, settings, heard)
    return expansion


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
