"""Predicted error of a linearised fit on held-out data, as a function of its smoothness factors.

The criterion is generalised cross-validation (GCV), n D / (n - gamma F)^2, with D the misfit of n samples and F the
effective number of values that the data determine, the trace of the influence matrix (P. Craven and G. Wahba, Smoothing
noisy data with spline functions, 1979). A gamma above 1 guards small data sets against following noise (Y.-J. Kim and
C. Gu, Smoothing spline Gaussian regression, 2004). First and second derivatives by the logarithms of the factors are
exact.

If errors are correlated in time, blocks of the data are also held out in turn: with D_b the misfit of block b by the
linearised fit to all other blocks, the mean of log D_b is a second estimate of the logarithm of the error (S. N. Wood,
On neighbourhood cross validation, 2024). Logarithms keep a single block with large model errors from dominating. The
criterion is then a weighted mean of both estimates: GCV is precise but relies on the estimated correlation time, the
blocks do not but are few.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.lazy_dataclass import dataclass
from kennfeld.native.cholesky import Cholesky, Factor
from kennfeld.optimize.table_penalties import Roughness
from kennfeld.optimize.tuning.holdout_blocks import HoldoutBlock

GAMMA = 1.2
HOLDOUT_SHARE = 0.75  # of the estimate from held-out blocks in the mean
RIDGE = 1e-8  # of the diagonal; keeps undetermined values where they are
MIN_RESIDUAL_SHARE = 0.01  # of the samples that a fit must leave as residual degrees of freedom
MAX_STEP = 4.0  # change of a logarithm in one Newton step
MIN_GAIN = 0.02  # of the criterion in a step, for the search to continue

Solve = Callable[[Float], Float]  # the inverse times a vector, or times each row of a matrix
Misfit = tuple[float, Float, Float]  # its value, slope and curvature


@dataclass(frozen=True)
class Linearised:
    """A linearised fit: misfit(p + d) = misfit + 2 gradient'd + d'matrix d, without roughness."""

    values: Float  # p, Float[values]
    misfit: float  # cost of the data at p
    gradient: Float  # half the gradient of the misfit, Float[values]
    matrix: Float  # Gauss-Newton matrix of the misfit, Float[values, values]
    movable: Bool  # values that may change, Bool[values]
    rows: Float  # directions fixed by equalities, Float[equalities, values]
    samples: float  # number of independent samples
    blocks: tuple[HoldoutBlock, ...] = ()  # parts of the data to be held out in turn
    # weights and target of a quadratic penalty on p - toward that does not depend on the factors, Float[values]
    pull: Float | float = 0.0
    toward: Float | float = 0.0


@dataclass(frozen=True)
class Point:
    """n times the logarithm of the criterion, with its derivatives by the logarithms of the factors."""

    value: float
    slope: Float  # Float[blocks]
    curvature: Float  # Float[blocks, blocks]


class Prediction:
    """The criterion of a linearised fit.

    Args:
        fit: the linearised fit.
        blocks: roughnesses with unit factor, whose factors are the variables.
        fixed: roughnesses with fixed factors.
    """

    def __init__(self, fit: Linearised, blocks: Sequence[Roughness], fixed: Sequence[Roughness] = ()) -> None:
        touched = np.diag(fit.matrix) > 0
        for block in (*blocks, *fixed):
            touched[block.columns] = True
        self._fit, self._free = fit, np.flatnonzero(fit.movable & touched)
        self._blocks = [_PenaltyRows(block, fit.movable) for block in blocks]
        self._fixed = [_PenaltyRows(block, fit.movable) for block in fixed]
        self._equalities = fit.rows[(fit.rows[:, self._free] != 0).any(axis=1)][:, self._free]
        self._data = fit.matrix[np.ix_(self._free, self._free)]
        self._cholesky = Cholesky(self._free.size) if fit.blocks else None

    def at(self, logarithms: Float) -> Point:
        """Evaluate the criterion at the logarithms of the factors, shape (blocks,)."""
        factors = np.exp(logarithms)
        inverse = self._inverse(factors)
        influence = inverse @ self._data
        whole = HoldoutBlock(self._fit.misfit, self._fit.gradient, self._fit.matrix, 1.0)
        misfit, d_misfit, dd_misfit = self._misfit(factors, self._fit.gradient, whole, lambda rows: rows @ inverse)
        freedom, d_freedom, dd_freedom = self._freedom(factors, inverse, influence)
        samples = self._fit.samples
        residual = samples - GAMMA * freedom
        if residual < MIN_RESIDUAL_SHARE * samples:
            return Point(np.inf, d_misfit, dd_misfit)
        value = samples * (np.log(misfit) - 2 * np.log(residual / samples))
        slope = samples * (d_misfit / misfit + 2 * GAMMA * d_freedom / residual)
        curvature = dd_misfit / misfit - np.outer(d_misfit, d_misfit) / misfit**2
        curvature += 2 * GAMMA * dd_freedom / residual + 2 * GAMMA**2 * np.outer(d_freedom, d_freedom) / residual**2
        point = Point(float(value), slope, samples * curvature)
        if self._cholesky is None:
            return point
        held_out, share = self._held_out(factors, self._cholesky), HOLDOUT_SHARE
        return Point(
            (1 - share) * point.value + share * held_out.value,
            (1 - share) * point.slope + share * held_out.slope,
            (1 - share) * point.curvature + share * held_out.curvature,
        )

    def _held_out(self, factors: Float, cholesky: Cholesky) -> Point:
        """Return the samples times the mean of log D_b, with D_b the misfit of a block by the fit to the others."""
        count = len(self._blocks)
        value, slope, curvature = 0.0, np.zeros(count), np.zeros((count, count))
        matrix = self._add_penalty(factors)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        for block in self._fit.blocks:
            rest = matrix - block.matrix[np.ix_(self._free, self._free)]
            factor = cholesky.factor(rest * scale[:, None] * scale, np.full(scale.size, RIDGE))
            if factor is None:
                return Point(np.inf, slope, curvature)
            solve = _constrained(partial(_solve, factor, scale), self._equalities)
            misfit, first, second = self._misfit(factors, self._fit.gradient - block.gradient, block, solve)
            value += block.share * np.log(misfit)
            slope += block.share * first / misfit
            curvature += block.share * (second / misfit - np.outer(first, first) / misfit**2)
        samples = self._fit.samples
        return Point(float(samples * value), samples * slope, samples * curvature)

    def freedom(self, logarithms: Float) -> float:
        """Return the effective number of values that the data determine."""
        return float(np.trace(self._inverse(np.exp(logarithms)) @ self._data))

    def _add_penalty(self, factors: Float) -> Float:
        """Return matrix plus penalty over the free values."""
        matrix = self._fit.matrix.copy()
        for rows, factor in zip(self._blocks, factors, strict=True):
            rows.add(factor, matrix)
        for rows in self._fixed:
            rows.add(1.0, matrix)
        matrix[np.diag_indices_from(matrix)] += self._fit.pull
        return matrix[np.ix_(self._free, self._free)]

    def _inverse(self, factors: Float) -> Float:
        """Return the inverse of matrix plus penalty in the directions that equalities leave free."""
        matrix = self._add_penalty(factors)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        matrix *= scale[:, None] * scale
        matrix[np.diag_indices_from(matrix)] += RIDGE
        inverse = np.linalg.inv(matrix) * (scale[:, None] * scale)
        inverse = (inverse + inverse.T) / 2
        if len(self._equalities):
            across = inverse @ self._equalities.T
            inverse = inverse - across @ np.linalg.pinv(self._equalities @ across) @ across.T
        return inverse

    def _misfit(self, factors: Float, fitted: Float, scored: HoldoutBlock, solve: Solve) -> Misfit:
        """Return the misfit of the `scored` data by the linearised fit with these factors, and its derivatives.

        `fitted` is the gradient of the fitted data, `solve` multiplies with the inverse V of their matrix plus penalty.
        The fit moves by d = -V (g + sum of f_i P_i p), so that dd/dlog f_i = -f_i V P_i (p + d).
        """
        fit, free = self._fit, self._free
        data = self._data if scored.matrix is fit.matrix else scored.matrix[np.ix_(free, free)]
        pull = fitted + fit.pull * (fit.values - fit.toward)
        weighted = [*zip(self._blocks, factors, strict=True), *((rows, 1.0) for rows in self._fixed)]
        for rows, factor in weighted:
            pull += factor * rows.transposed(rows.of(fit.values), fit.values.size)
        step = -solve(pull[free])
        values = self._spread(step) + fit.values
        gradient = scored.gradient[free] + data @ step
        misfit = max(scored.misfit + float((scored.gradient[free] + gradient) @ step), 1e-12 * scored.misfit, 1e-300)
        pulls = np.array([rows.transposed(rows.of(values), values.size)[free] for rows in self._blocks])
        moves = -factors[:, None] * solve(pulls)
        slope = 2 * moves @ gradient
        back = self._spread(solve(gradient))
        bends = [[rows.of(back) @ rows.of(self._spread(move)) for move in moves] for rows in self._blocks]
        cross = factors[:, None] * np.array(bends)
        return misfit, slope, np.diag(slope) + 2 * moves @ data @ moves.T - 2 * (cross + cross.T)

    def _freedom(self, factors: Float, inverse: Float, influence: Float) -> tuple[float, Float, Float]:
        """Return the trace of the influence matrix V H, and its derivatives, from dV/df_i = -V P_i V."""
        count = len(self._blocks)
        traces, squares = np.zeros(count), np.zeros((count, count))
        spread = self._spread(influence @ inverse)
        whole = self._spread(inverse)
        for i, rows in enumerate(self._blocks):
            by_inverse, by_spread = self._spread(rows.of(whole).T), self._spread(rows.of(spread).T)
            for j, other in enumerate(self._blocks[: i + 1]):
                product = other.of(by_spread)
                squares[i, j] = squares[j, i] = np.sum(other.of(by_inverse) * product)
            traces[i] = np.trace(product)
        slope = -factors * traces
        return float(np.trace(influence)), slope, np.diag(slope) + 2 * np.outer(factors, factors) * squares

    def _spread(self, rows: Float) -> Float:
        """Extend rows of the free values by zeros to all values."""
        extended = np.zeros((self._fit.values.size, *rows.shape[1:]))
        extended[self._free] = rows
        return extended


def _solve(factor: Factor, scale: Float, rows: Float) -> Float:
    return factor.solve(rows * scale) * scale


def _constrained(solve: Solve, equalities: Float) -> Solve:
    """Return the product with the inverse in the directions that equalities leave free."""
    if not len(equalities):
        return solve
    across = solve(equalities)
    middle = np.linalg.pinv(across @ equalities.T)

    return lambda rows: solve(rows) - rows @ across.T @ middle @ across


class _PenaltyRows:
    """The second differences D of a block that involve a movable value; its penalty matrix is P = D'D."""

    def __init__(self, block: Roughness, movable: Bool) -> None:
        some = movable[block.columns].any(axis=1)
        self.columns, self.coefficients = block.columns[some], block.coefficients[some]

    def of(self, values: Float) -> Float:
        """Return D v for a vector or for each column of a matrix."""
        shape = (-1, *[1] * (values.ndim - 1))
        first, second, third = (self.coefficients[:, i].reshape(shape) * values[self.columns[:, i]] for i in range(3))
        return np.asarray(first + second + third)

    def transposed(self, weights: Float, size: int) -> Float:
        """Return D' w."""
        terms = self.coefficients * weights[:, None]
        return np.bincount(self.columns.ravel(), terms.ravel(), minlength=size).astype(np.float64)

    def add(self, factor: float, matrix: Float) -> None:
        """Add factor D'D to a matrix, in place."""
        products = factor * self.coefficients[:, :, None] * self.coefficients[:, None, :]
        np.add.at(matrix, (self.columns[:, :, None], self.columns[:, None, :]), products)


def minimise_prediction(
    prediction: Prediction, start: Float, lower: Float, upper: Float, iterations: int = 50
) -> Float:
    """Return the logarithms of the factors, within bounds, that minimise the criterion, by Newton's method.

    A factor whose best value is infinite ends at its bound, or at the point from which the criterion is flat.
    """
    values = np.clip(start, lower, upper)
    point = prediction.at(values)
    for _ in range(iterations):
        inner = ~(((values <= lower) & (point.slope > 0)) | ((values >= upper) & (point.slope < 0)))
        if not (inner.any() and np.isfinite(point.value)):
            break
        step = np.zeros(values.size)
        step[inner] = _newton_step(point.slope[inner], point.curvature[np.ix_(inner, inner)])
        accepted = _line_search(prediction, values, point, step, lower, upper)
        if accepted is None:
            break
        gain = point.value - accepted[1].value
        values, point = accepted
        if gain < MIN_GAIN:
            break
    return values


def _newton_step(slope: Float, curvature: Float) -> Float:
    """Return a descent step of at most MAX_STEP in each logarithm; negative curvatures count by their magnitude."""
    sizes, directions = np.linalg.eigh(curvature)
    bends = np.maximum(np.abs(sizes), 1e-3 * max(float(np.abs(sizes).max()), 1e-12))
    step: Float = -directions @ ((directions.T @ slope) / bends)
    return step * min(1.0, MAX_STEP / max(float(np.abs(step).max()), 1e-300))


def _line_search(
    prediction: Prediction, values: Float, point: Point, step: Float, lower: Float, upper: Float
) -> tuple[Float, Point] | None:
    """Halve the step until it lowers the criterion; None if none does."""
    for halvings in range(12):
        trial = np.clip(values + step / 2**halvings, lower, upper)
        trial_point = prediction.at(trial)
        if trial_point.value < point.value - 1e-4 * abs(float(point.slope @ (trial - values))):
            return trial, trial_point
    return None
