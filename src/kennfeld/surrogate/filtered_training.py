"""Training of filtered models: a static function of the inputs and of the same inputs through first-order filters.

The time constants, common to all inputs, minimise the error on held-out blocks of a polynomial of second degree in the
filtered inputs, which is linear in its coefficients: sums of products over each block, computed once, give all
divisions (variable projection, G. H. Golub, V. Pereyra, 1973). The function itself is a sparse Gaussian process. Its
length scales are cut, and its noise is raised, to where the error on held-out blocks is least: the residuals of
recordings are correlated, which the likelihood does not know.
"""

from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.gp_kernel import JITTER, greedy_centres
from kennfeld.surrogate.hyperparameters import sparse_hyperparameters
from kennfeld.surrogate.input_filters import filtered_points
from kennfeld.surrogate.model_selection import LONGEST, WORTH, held_out_blocks
from kennfeld.surrogate.narx_training import LENGTH_STEPS
from kennfeld.surrogate.recursion import Lags, Recording
from kennfeld.surrogate.sparse_gp import Sparse
from kennfeld.surrogate.stopping import Stopped, never
from kennfeld.surrogate.training_data import Scaling
from kennfeld.surrogate.training_points import TrainingPoints
from kennfeld.surrogate.uncertainty import Uncertainty, calibrated

MOST_FILTERS = 4
GRID = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)  # time constants that the search starts from, in samples
EVALUATIONS = 20  # of the search, for each time constant
RIDGE = 1e-3  # of the polynomial, as a share of the samples
MOST_PRODUCTS = 12  # inputs up to which the polynomial has their products
NOISES = (1.0, 30.0, 1000.0)  # factors of the noise that are tried
CENTRES = 60  # of models on held-out blocks
SEARCHED = 10_000  # samples that the time constants are searched on; of more, several are averaged
SAMPLES = 8000  # that the length scales and the final function are trained on
ALL = 1 << 62  # samples: none is left out
COMPARED = 4000  # samples on which the regularisation is chosen
SLOWEST = 0.25  # share of the longest recording


@dataclass(frozen=True, eq=False)
class FilteredModel:
    """The delay of the inputs in samples, the time constants in s, the function, and its error on held-out blocks."""

    delay: int
    time_constants: tuple[float, ...]
    expansion: Expansion
    lengths: Float  # in units of the points' spread
    points: Float  # Float[samples, numbers] that it was trained on
    rmse: float
    uncertainty: Uncertainty


def train_filtered(
    pieces: Sequence[Recording],
    step: float,
    limits: tuple[float, float],
    centres: int,
    starts: int,
    seed: int,
    report: Callable[[str], None] = lambda line: None,
    stopped: Stopped = never,
) -> FilteredModel | None:
    """Return the filtered model; None if the recordings are too short for held-out blocks, or once `stopped`."""
    lags = Lags((1,), ((0, 1),) * pieces[0].u.shape[1])
    # the error that is compared with that of recursions is on blocks like theirs, which may skip samples
    blocks, all_blocks = held_out_blocks(pieces, lags), held_out_blocks(pieces, lags, samples=ALL)
    if len(blocks) < 2 or stopped():
        return None
    delay, time_constants = _time_constants(pieces, step, all_blocks)
    shown = ", ".join(f"{T:.3g}" for T in time_constants)
    filtered = [filtered_points(piece.u, delay, step, time_constants) for piece in pieces]
    x, y, block = _data(pieces, filtered, all_blocks, limits)
    scaling = Scaling.of(x, y)
    target = (y - scaling.level) / scaling.height
    inner = scaling.inward(x)
    points = TrainingPoints.of(inner, target)
    optimum = sparse_hyperparameters(points, "gaussian", centres, starts, seed, LENGTH_STEPS, stopped)
    lengths, noise = optimum.lengths, optimum.noise
    longest, factor = _regularisation(_parts(pieces, filtered, all_blocks), limits, lengths, noise, seed)
    rmse = _held_out(_parts(pieces, filtered, blocks), limits, np.minimum(lengths, longest), factor * noise, seed)
    report(f"inputs filtered over {shown} s, length scales up to {longest:g} spreads: {rmse:.4g} on blocks left out")
    cut = np.minimum(lengths, longest)
    process = _process(x, y, centres, cut, factor * noise, seed)
    expansion = scaling.expansion(*process.terms(), cut)
    uncertainty = _uncertainty(process, expansion, scaling, x, y, block)
    return FilteredModel(delay, time_constants, expansion, cut, x, rmse, uncertainty)


def _data(
    pieces: Sequence[Recording],
    filtered: Sequence[Float],
    blocks: Sequence[tuple[int, int, int]],
    limits: tuple[float, float],
) -> tuple[Float, Float, Int]:
    """Return points, outputs and the number of the block of the samples that count and are not held by a limit."""
    parts = []
    for i, (piece, points) in enumerate(zip(pieces, filtered, strict=True)):
        used = piece.scored & (piece.y > limits[0]) & (piece.y < limits[1])
        number = np.full(len(piece), -1 - i, dtype=np.int64)  # samples of a piece that is too short for a block
        for at, (of, first, end) in enumerate(blocks):
            if of == i:
                number[first:end] = at
        parts.append((points[used], piece.y[used], number[used]))
    x, y, block = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    every = max(len(y) // SAMPLES, 1)
    return x[::every], y[::every], block[::every]


def _fit(x: Float, y: Float, centres: int, lengths: Float, noise: float, seed: int) -> Expansion:
    return Scaling.of(x, y).expansion(*_process(x, y, centres, lengths, noise, seed).terms(), lengths)


def _process(x: Float, y: Float, centres: int, lengths: Float, noise: float, seed: int) -> Sparse:
    scaling = Scaling.of(x, y)
    inner = scaling.inward(x)
    z = greedy_centres(inner, centres, lengths, seed)
    points = TrainingPoints.of(inner, (y - scaling.level) / scaling.height)
    return Sparse.at(points, z, lengths, noise, refine=False)


def _uncertainty(
    process: Sparse, expansion: Expansion, scaling: Scaling, x: Float, y: Float, block: Int
) -> Uncertainty:
    """Return the uncertainty, scaled to the residuals of the process without the block of each sample."""
    point = process.points.point
    # a point of several rows is in the block of its first row
    first = block[np.unique(point, return_index=True)[1]]
    left_out = process.left_out([np.flatnonzero(first == number) for number in np.unique(first)])
    target = (y - scaling.level) / scaling.height
    # of each row: its distance from the mean of its point, and the residual of that mean
    residual = scaling.height * (target - process.points.y[point] + left_out[point])
    signal = scaling.height * float(np.sqrt(process.variance))
    noise = signal * float(np.sqrt(process.noise))
    return calibrated(Uncertainty(signal, noise, np.full(expansion.size, JITTER)), expansion, x, residual)


def _regularisation(
    parts: Sequence[tuple[Float, Float]], limits: tuple[float, float], lengths: Float, noise: float, seed: int
) -> tuple[float, float]:
    """Return the cut of the length scales and the factor of the noise with the least error on held-out blocks."""
    trials = [(longest, factor) for longest in LONGEST for factor in NOISES]
    return min(
        trials, key=lambda trial: _held_out(parts, limits, np.minimum(lengths, trial[0]), trial[1] * noise, seed)
    )


def _parts(
    pieces: Sequence[Recording], points: Sequence[Float], blocks: Sequence[tuple[int, int, int]]
) -> list[tuple[Float, Float]]:
    """Return points and outputs of the samples that count in each block, thinned evenly."""
    every = max(sum(end - first for _, first, end in blocks) // COMPARED, 1)
    parts = []
    for i, first, end in blocks:
        scored = pieces[i].part(first, end).scored
        parts.append((points[i][first:end][scored][::every], pieces[i].y[first:end][scored][::every]))
    return parts


def _held_out(
    parts: Sequence[tuple[Float, Float]], limits: tuple[float, float], lengths: Float, noise: float, seed: int
) -> float:
    squares, count = 0.0, 0
    for number, (x, y) in enumerate(parts):
        others = [part for other, part in enumerate(parts) if other != number]
        train_x, train_y = (np.concatenate(arrays) for arrays in zip(*others, strict=True))
        used = (train_y > limits[0]) & (train_y < limits[1])
        expansion = _fit(train_x[used], train_y[used], CENTRES, lengths, noise, seed)
        squares += float(np.sum((np.clip(expansion(x), *limits) - y) ** 2))
        count += y.size
    return float(np.sqrt(squares / max(count, 1)))


def _time_constants(
    pieces: Sequence[Recording], step: float, blocks: Sequence[tuple[int, int, int]]
) -> tuple[int, tuple[float, ...]]:
    """Return the delay, 0 or 1 sample, and as many time constants as lower the error on held-out blocks."""
    longest = SLOWEST * max(len(piece) for piece in pieces)
    every = max(sum(map(len, pieces)) // SEARCHED, 1)
    error = _PolynomialError(
        [_averaged(piece, every) for piece in pieces], [(i, a // every, b // every) for i, a, b in blocks]
    )
    longest /= every
    grid = np.log([T for T in GRID if longest > T] or [longest])
    best, least = np.empty(0), np.inf
    for _ in range(MOST_FILTERS):
        # from the best so far, with the one more that lowers the error most
        start = min((np.append(best, further) for further in grid), key=error)
        trial, rmse = _descend(error, start, np.log(longest))
        if not rmse < WORTH * least:
            break
        best, least = trial, rmse
    # an input that is read one sample late permits closed loops
    # averaged samples cannot tell one original sample of delay from none, so that it is taken for free there
    delay = 1 if error(best, 1 if every == 1 else 0) <= least / WORTH else 0
    return delay, tuple(float(f"{step * every * samples:.6g}") for samples in np.sort(np.exp(best)))


def _averaged(piece: Recording, every: int) -> Recording:
    """Return the means over so many samples each."""
    count = len(piece) // every
    used = slice(0, count * every)
    u, y = piece.u[used].reshape(count, every, -1).mean(1), piece.y[used].reshape(count, every).mean(1)
    return Recording(u, y, np.all(piece.scored[used].reshape(count, every), axis=1))


def _descend(error: "_PolynomialError", start: Float, most: float) -> tuple[Float, float]:
    """Return the logarithms of time constants of least error, and the error, by the simplex of Nelder and Mead."""
    from scipy.optimize import minimize

    # edges of a factor of 2, as the arguments are logarithms
    simplex = np.vstack([start, start + 0.7 * np.eye(start.size)])
    options = {"maxfev": EVALUATIONS * start.size, "initial_simplex": simplex, "xatol": 0.05, "fatol": 1e-6}
    # below 0.3 samples a filter passes nearly all of its input: 1 - exp(-1 / 0.3) = 0.96
    result = minimize(lambda x: error(np.clip(x, np.log(0.3), most)), start, method="Nelder-Mead", options=options)
    return np.clip(result.x, np.log(0.3), most), float(result.fun)


class _PolynomialError:
    """The error on held-out blocks of a polynomial of second degree in filtered inputs."""

    def __init__(self, pieces: Sequence[Recording], blocks: Sequence[tuple[int, int, int]]) -> None:
        self._pieces, self._blocks = pieces, blocks

    def __call__(self, logarithms: Float, delay: int = 0) -> float:
        """Return the RMSE for the logarithms of the time constants, in samples."""
        points = [filtered_points(piece.u, delay, 1.0, np.exp(logarithms).tolist()) for piece in self._pieces]
        parts = [(points[i][a:b], self._pieces[i].part(a, b)) for i, a, b in self._blocks]
        whole = np.concatenate([x for x, _ in parts])
        middle, spread = whole.mean(0), whole.std(0)
        inputs = self._pieces[0].u.shape[1]
        sums = [_block_sums(_polynomial((x - middle) / np.where(spread > 0, spread, 1.0), inputs), p) for x, p in parts]
        squares = sum(_error_without(sums, number) for number in range(len(sums)))
        return float(np.sqrt(squares / max(sum(count for *_, count in sums), 1)))


BlockSums = tuple[Float, Float, float, int]  # A'A, A'y, y'y, samples


def _block_sums(terms: Float, piece: Recording) -> BlockSums:
    terms, y = terms[piece.scored], piece.y[piece.scored]
    return terms.T @ terms, terms.T @ y, float(y @ y), y.size


def _error_without(sums: Sequence[BlockSums], number: int) -> float:
    """Return the squared error over one block of the polynomial that is fitted to the others."""
    others = [part for other, part in enumerate(sums) if other != number]
    matrix = np.sum([part[0] for part in others], axis=0)
    right = np.sum([part[1] for part in others], axis=0)
    ridge = np.full(len(right), RIDGE * sum(part[3] for part in others))
    # the offset is not shrunk
    ridge[0] = 0.0
    weights = np.linalg.solve(matrix + np.diag(ridge), right)
    own_matrix, own_right, square, _ = sums[number]
    # |A w - y|^2 = w'A'A w - 2 y'A w + y'y, by the sums alone; rounding may make it negative
    return max(float(weights @ own_matrix @ weights - 2 * own_right @ weights + square), 0.0)


def _polynomial(x: Float, inputs: int) -> Float:
    """Return 1, all numbers, and the squares and products of inputs with the same filter: Float[samples, terms]."""
    columns = [np.ones((len(x), 1)), x]
    # all products of n inputs would be n (n + 1) / 2 terms for each filter
    i, j = np.triu_indices(inputs) if inputs <= MOST_PRODUCTS else (np.arange(inputs), np.arange(inputs))
    columns += [x[:, first + i] * x[:, first + j] for first in range(0, x.shape[1], inputs)]
    return np.concatenate(columns, axis=1)
