"""Screening of lags by orthogonal least squares on the residual of a free run.

A lag that a model does not read yet would add terms theta . phi to f. To first order they change the free run by
theta . s, where s is phi run through the linearised recursion,

    s_k = phi_k + sum over output lags l of df/dy_{k-l} s_{k-l}

With the residual e and the derivatives J of the free run by the values that the model has, the sum of squares falls by

    r' C^-1 r,  r = s'e - s'J A^-1 J'e,  C = s's - s'J A^-1 J's + ridge,  A = J'J + hold

which is the error reduction of S. Chen, S. A. Billings, W. Luo: Orthogonal least squares methods and their application
to non-linear system identification, 1989, in free run instead of one step ahead. One pass over the data ranks all lags;
the alternative is to train a model for each.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.narx_training import TrainedValues, TrainingSettings
from kennfeld.surrogate.recursion import FreeRun, Lags, Recording, Runs, run_through, simulate

OUTPUT = -1  # in place of the number of an input
BLOCK = 1 << 21  # numbers of the derivatives held at a time: 16 MB
COLUMNS = 1000  # of the candidates' terms at a time: their products grow with the square
FAR = 100.0  # spans of the target that a run may leave its range by
STRAIGHT, CURVED = 0.1, 10.0  # ridge of linear and quadratic terms, in squares of the output's spread

ChannelLag = tuple[int, int]  # number of an input, or OUTPUT, and the lag in samples


def channel_lags(lags: Lags) -> list[ChannelLag]:
    """Return the coordinates of a point, in their order.

    >>> channel_lags(Lags((1,), ((0, 2),)))
    [(-1, 1), (0, 0), (0, 2)]
    """
    delayed = [(OUTPUT, lags.output), *enumerate(lags.inputs)]
    return [(channel, lag) for channel, own in delayed for lag in own]


def screen_lags(
    model: Expansion, lags: Lags, pieces: Sequence[Recording], pool: Lags, settings: TrainingSettings
) -> dict[ChannelLag, float]:
    """Return how much of the squared residual each lag of `pool` would explain, in squares of the output's spread.

    `model` reads `lags`, which are left out. Each candidate adds its value, its square, and its products with the
    numbers that the model reads. A model that diverges ranks nothing: the result is empty.
    """
    # both sets of points begin at the same sample, so that their rows match
    first = max(lags.longest, pool.longest)
    if not any(len(piece) > first for piece in pieces):
        return {}
    runs, wide = Runs.of(pieces, lags, first), Runs.of(pieces, pool, first)
    run = simulate(model, runs, settings.limits)
    present = channel_lags(lags)
    new = [i for i, candidate in enumerate(channel_lags(pool)) if candidate not in present]
    if not new or not runs.scored.any() or not _is_bounded(run, runs):
        return {}
    values = TrainedValues(model, runs, settings)
    near, candidates = runs.visited(run.y), wide.visited(run.y)
    # terms of a candidate: itself, its square, and a product with each number that the model reads
    some = max(COLUMNS // (2 + near.shape[-1]), 1)
    gains: list[float] = []
    for first in range(0, len(new), some):
        terms = _Terms.of(near, candidates[..., new[first : first + some]])
        matrix, gradient = _normal(values, model, runs, run, terms)
        gains += _gains(matrix, gradient, values.hold, terms.ridge)
    return dict(zip([channel_lags(pool)[i] for i in new], gains, strict=True))


def _is_bounded(run: FreeRun, runs: Runs) -> bool:
    """Return whether the run stays near the range of its target, so that its linearisation means something."""
    low, high = np.nanmin(runs.target), np.nanmax(runs.target)
    reach = FAR * (high - low)
    with np.errstate(invalid="ignore"):
        return bool(((run.y >= low - reach) & (run.y <= high + reach)).all())


@dataclass(frozen=True, eq=False)
class _Terms:
    """Linear and quadratic terms of each candidate, in units of spread."""

    near: Float  # Float[steps, pieces, numbers]: what the model reads
    candidates: Float  # Float[steps, pieces, candidates]

    @classmethod
    def of(cls, near: Float, candidates: Float) -> "_Terms":
        return cls(_scale(near), _scale(candidates))

    @property
    def ridge(self) -> Float:
        """Float[terms] of one candidate."""
        return np.array([STRAIGHT, *[CURVED] * (1 + self.near.shape[-1])])

    def of_steps(self, part: slice) -> Float:
        """Return Float[steps, pieces, candidates * terms]."""
        x, near = self.candidates[part][..., None], self.near[part][..., None, :]
        factors = [np.ones_like(x), x, np.broadcast_to(near, (*x.shape[:3], near.shape[-1]))]
        return (x * np.concatenate(factors, axis=-1)).reshape(*x.shape[:2], -1)


def _scale(values: Float) -> Float:
    spread = values.std((0, 1))
    scaled: Float = (values - values.mean((0, 1))) / np.where(spread > 0, spread, 1.0)
    return scaled


def _normal(values: TrainedValues, model: Expansion, runs: Runs, run: FreeRun, terms: _Terms) -> tuple[Float, Float]:
    """Return the products of [J, s] with itself and with the residual."""
    residual = np.where(runs.scored, run.y - runs.target, 0.0) / values.height
    width = values.first.size + terms.candidates.shape[-1] * terms.ridge.size
    matrix, gradient = np.zeros((width, width)), np.zeros(width)
    for part, rows in _derivatives(values, model, runs, run, terms):
        counted = rows[runs.scored[part]]
        matrix += counted.T @ counted
        gradient += counted.T @ residual[part][runs.scored[part]]
    return matrix, gradient


def _derivatives(
    values: TrainedValues, model: Expansion, runs: Runs, run: FreeRun, terms: _Terms
) -> Iterator[tuple[slice, Float]]:
    """Yield, by block of steps, the derivatives of the free run: Float[steps, pieces, values and terms]."""
    (steps, pieces), own, back = run.y.shape, runs.lags.output, max(runs.lags.output)
    width = values.first.size + terms.candidates.shape[-1] * terms.ridge.size
    block = max(BLOCK // (width * pieces), 1)
    visited, rows = runs.visited(run.y), np.zeros((back, pieces, width))
    for first in range(0, steps, block):
        part = slice(first, min(first + block, steps))
        direct, slopes = values.direct(model, visited[part].reshape(-1, model.inputs), len(own))
        added = [direct.reshape(-1, pieces, values.first.size), terms.of_steps(part)]
        # the last rows of the block before feed the first ones of this
        rows = np.concatenate([rows[-back:], np.concatenate(added, axis=-1)])
        held = run.held[part][:, :, None]
        # an output at a limit does not change with any value
        rows[back:] *= ~held
        run_through(rows, np.where(held, 0.0, slopes.reshape(-1, pieces, len(own))), own)
        yield part, rows[back:]


def _gains(matrix: Float, gradient: Float, hold: Float, ridge: Float) -> list[float]:
    """Return r' C^-1 r of each candidate."""
    size, terms = hold.size, ridge.size
    across = matrix[:size, size:]
    # A^-1 [J's, J'e] for all candidates at once
    solved = np.linalg.solve(matrix[:size, :size] + np.diag(hold), np.column_stack([across, gradient[:size]]))
    rest = gradient[size:] - across.T @ solved[:, -1]
    gains = []
    for first in range(0, rest.size, terms):
        part = slice(first, first + terms)
        block = matrix[size:, size:][part, part] - across[:, part].T @ solved[:, part] + np.diag(ridge)
        gains.append(float(rest[part] @ np.linalg.solve(block, rest[part])))
    return gains
