"""How large the error of a fit would be on data held back, as a function of its smoothness factors.

Generalised cross-validation of the linearised fit, n D / (n - gamma F)^2, with D the misfit of n samples and F the
values that the data determine, the trace of the influence matrix. Source: P. Craven and G. Wahba, Smoothing noisy data
with spline functions, 1979; gamma above 1 guards small data against following noise (Y.-J. Kim and C. Gu, Smoothing
spline Gaussian regression, 2004). Derivatives by the logarithms of the factors are exact, the second ones too.

Where errors resemble their neighbours, blocks of the data are held back in turn as well: D_b is the misfit of block b
by the linearised fit to all the others, and the mean of log D_b a second estimate of the logarithm of that error.
Logarithms, since the model itself errs more in one block than in another, and the worst would decide alone. The
criterion is then a mean of the two estimates: GCV is precise but for what the correlation time does not tell, and the
blocks tell that but are few. Source of the second: S. N. Wood, On neighbourhood cross validation, 2024.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.native import Cholesky, Factor
from kennfeld.optimize.roughness import Roughness
from kennfeld.optimize.tuning.holdout_blocks import HoldoutBlock

__all__ = ["GAMMA", "HELD_BACK", "Linearised", "Prediction", "minimised"]

GAMMA = 1.2
HELD_BACK = 0.75  # share of the estimate from blocks held back, where there are some
RIDGE = 1e-8  # of the diagonal; what no data determine stays where it is
LEAST_LEFT = 0.01  # share of the samples that a fit must leave undetermined
STEP = 4.0  # most change of a logarithm in one Newton step
FLAT = 0.02  # gain of the criterion below which the search has ended

Solve = Callable[[Float], Float]  # the inverse times a vector, or times each row of a matrix
Misfit = tuple[float, Float, Float]  # its value, slope and curvature


@dataclass(frozen=True)
class Linearised:
    """A fit: misfit(p + d) = misfit + 2 gradient'd + d'matrix d, without roughness; `movable` values may change.

    `rows` are the directions that equalities hold. `samples` is the number of independent samples. `blocks` are parts
    of the data to be held back in turn. `pull` and `toward` are a penalty whatever the factors are.
    """

    values: Float  # Float[values]
    misfit: float
    gradient: Float  # Float[values]
    matrix: Float  # Float[values, values]
    movable: Bool  # Bool[values]
    rows: Float  # Float[equalities, values]
    samples: float
    blocks: tuple[HoldoutBlock, ...] = ()
    pull: Float | float = 0.0  # Float[values], weights of the squares of values - toward
    toward: Float | float = 0.0  # Float[values]


@dataclass(frozen=True)
class Point:
    """n times the logarithm of the criterion at some logarithms of the factors, and its derivatives."""

    value: float
    slope: Float  # Float[blocks]
    curvature: Float  # Float[blocks, blocks]


class Prediction:
    """The criterion; `blocks` are roughnesses with a factor of 1, `given` those with the factor that they keep."""

    def __init__(self, fit: Linearised, blocks: Sequence[Roughness], given: Sequence[Roughness] = ()) -> None:
        touched = np.diag(fit.matrix) > 0
        for block in (*blocks, *given):
            touched[block.columns] = True
        self._fit, self._free = fit, np.flatnonzero(fit.movable & touched)
        self._blocks = [_PenaltyRows(block, fit.movable) for block in blocks]
        self._given = [_PenaltyRows(block, fit.movable) for block in given]
        self._held = fit.rows[(fit.rows[:, self._free] != 0).any(axis=1)][:, self._free]
        self._data = fit.matrix[np.ix_(self._free, self._free)]
        self._cholesky = Cholesky(self._free.size) if fit.blocks else None

    def at(self, logarithms: Float) -> Point:
        """The criterion where these are the logarithms of the factors, one a block."""
        factors = np.exp(logarithms)
        inverse = self._inverse(factors)
        influence = inverse @ self._data
        whole = HoldoutBlock(self._fit.misfit, self._fit.gradient, self._fit.matrix, 1.0)
        misfit, d_misfit, dd_misfit = self._misfit(factors, self._fit.gradient, whole, lambda rows: rows @ inverse)
        freedom, d_freedom, dd_freedom = self._freedom(factors, inverse, influence)
        samples = self._fit.samples
        left = samples - GAMMA * freedom
        if left < LEAST_LEFT * samples:
            return Point(np.inf, d_misfit, dd_misfit)
        value = samples * (np.log(misfit) - 2 * np.log(left / samples))
        slope = samples * (d_misfit / misfit + 2 * GAMMA * d_freedom / left)
        curvature = dd_misfit / misfit - np.outer(d_misfit, d_misfit) / misfit**2
        curvature += 2 * GAMMA * dd_freedom / left + 2 * GAMMA**2 * np.outer(d_freedom, d_freedom) / left**2
        point = Point(float(value), slope, samples * curvature)
        return point if self._cholesky is None else _mean(point, self._held_back(factors, self._cholesky), HELD_BACK)

    def _held_back(self, factors: Float, cholesky: Cholesky) -> Point:
        """The mean logarithm of the misfit of each block by the fit to the others, times the samples."""
        count = len(self._blocks)
        value, slope, curvature = 0.0, np.zeros(count), np.zeros((count, count))
        matrix = self._penalised(factors)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        for block in self._fit.blocks:
            rest = matrix - block.matrix[np.ix_(self._free, self._free)]
            factor = cholesky.factor(rest * scale[:, None] * scale, np.full(scale.size, RIDGE))
            if factor is None:
                return Point(np.inf, slope, curvature)
            solve = _constrained(partial(_solved, factor, scale), self._held)
            misfit, first, second = self._misfit(factors, self._fit.gradient - block.gradient, block, solve)
            value += block.share * np.log(misfit)
            slope += block.share * first / misfit
            curvature += block.share * (second / misfit - np.outer(first, first) / misfit**2)
        samples = self._fit.samples
        return Point(float(samples * value), samples * slope, samples * curvature)

    def freedom(self, logarithms: Float) -> float:
        """How many values the data determine, beside the roughness."""
        return float(np.trace(self._inverse(np.exp(logarithms)) @ self._data))

    def _penalised(self, factors: Float) -> Float:
        """Matrix plus penalty, of the values that may change."""
        matrix = self._fit.matrix.copy()
        for rows, factor in zip(self._blocks, factors, strict=True):
            rows.add(factor, matrix)
        for rows in self._given:
            rows.add(1.0, matrix)
        matrix[np.diag_indices_from(matrix)] += self._fit.pull
        return matrix[np.ix_(self._free, self._free)]

    def _inverse(self, factors: Float) -> Float:
        """The inverse of matrix plus penalty in the directions that may change."""
        matrix = self._penalised(factors)
        scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        matrix *= scale[:, None] * scale
        matrix[np.diag_indices_from(matrix)] += RIDGE
        inverse = np.linalg.inv(matrix) * (scale[:, None] * scale)
        inverse = (inverse + inverse.T) / 2
        if len(self._held):
            across = inverse @ self._held.T
            inverse = inverse - across @ np.linalg.pinv(self._held @ across) @ across.T
        return inverse

    def _misfit(self, factors: Float, fitted: Float, scored: HoldoutBlock, solve: Solve) -> Misfit:
        """The misfit of what is scored by the linearised fit with these factors, and its derivatives.

        `fitted` is the gradient of the data that are fitted, `solve` the inverse of their matrix with the penalty.
        """
        fit, free = self._fit, self._free
        data = self._data if scored.matrix is fit.matrix else scored.matrix[np.ix_(free, free)]
        pull = fitted + fit.pull * (fit.values - fit.toward)
        weighted = [*zip(self._blocks, factors, strict=True), *((rows, 1.0) for rows in self._given)]
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
        """The trace of the influence matrix V H, and its derivatives: those of V are -V P V."""
        count = len(self._blocks)
        traces, squares = np.zeros(count), np.zeros((count, count))
        spread = self._spread(influence @ inverse)
        whole = self._spread(inverse)
        for i, one in enumerate(self._blocks):
            ours, theirs = self._spread(one.of(whole).T), self._spread(one.of(spread).T)
            for j, other in enumerate(self._blocks[: i + 1]):
                product = other.of(theirs)
                squares[i, j] = squares[j, i] = np.sum(other.of(ours) * product)
            traces[i] = np.trace(product)
        slope = -factors * traces
        return float(np.trace(influence)), slope, np.diag(slope) + 2 * np.outer(factors, factors) * squares

    def _spread(self, rows: Float) -> Float:
        """What is known of the free values, over all values."""
        whole = np.zeros((self._fit.values.size, *rows.shape[1:]))
        whole[self._free] = rows
        return whole


def _solved(factor: Factor, scale: Float, rows: Float) -> Float:
    return factor.solve(rows * scale) * scale


def _constrained(solve: Solve, held: Float) -> Solve:
    """The inverse in the directions that equalities leave."""
    if not len(held):
        return solve
    across = solve(held)
    middle = np.linalg.pinv(across @ held.T)

    def within(rows: Float) -> Float:
        found: Float = solve(rows) - rows @ across.T @ middle @ across
        return found

    return within


def _mean(one: Point, other: Point, share: float) -> Point:
    """The mean of two estimates, the other with its share."""
    return Point(
        (1 - share) * one.value + share * other.value,
        (1 - share) * one.slope + share * other.slope,
        (1 - share) * one.curvature + share * other.curvature,
    )


class _PenaltyRows:
    """The second differences of a block in which a movable value takes part."""

    def __init__(self, block: Roughness, movable: Bool) -> None:
        some = movable[block.columns].any(axis=1)
        self.columns, self.coefficients = block.columns[some], block.coefficients[some]

    def of(self, values: Float) -> Float:
        """D v for a vector or for each column of a matrix."""
        shape = (-1, *[1] * (values.ndim - 1))
        first, second, third = (self.coefficients[:, i].reshape(shape) * values[self.columns[:, i]] for i in range(3))
        result: Float = first + second + third
        return result

    def transposed(self, weights: Float, size: int) -> Float:
        """D' w."""
        terms = self.coefficients * weights[:, None]
        return np.bincount(self.columns.ravel(), terms.ravel(), minlength=size).astype(np.float64)

    def add(self, factor: float, matrix: Float) -> None:
        """Add factor D'D."""
        products = factor * self.coefficients[:, :, None] * self.coefficients[:, None, :]
        np.add.at(matrix, (self.columns[:, :, None], self.columns[:, None, :]), products)


def minimised(prediction: Prediction, start: Float, lower: Float, upper: Float, iterations: int = 50) -> Float:
    """The logarithms of the factors, within bounds, at which the criterion is least: Newton's method.

    A factor whose best value is infinite ends at its bound, or where the criterion has become flat.
    """
    at = np.clip(start, lower, upper)
    here = prediction.at(at)
    for _ in range(iterations):
        inner = ~(((at <= lower) & (here.slope > 0)) | ((at >= upper) & (here.slope < 0)))
        if not (inner.any() and np.isfinite(here.value)):
            break
        step = np.zeros(at.size)
        step[inner] = _newton(here.slope[inner], here.curvature[np.ix_(inner, inner)])
        found = _searched(prediction, at, here, step, lower, upper)
        if found is None:
            break
        gain = here.value - found[1].value
        at, here = found
        if gain < FLAT:
            break
    return at


def _newton(slope: Float, curvature: Float) -> Float:
    """A step downhill, of at most STEP in each logarithm."""
    sizes, directions = np.linalg.eigh(curvature)
    bends = np.maximum(np.abs(sizes), 1e-3 * max(float(np.abs(sizes).max()), 1e-12))
    step: Float = -directions @ ((directions.T @ slope) / bends)
    return step * min(1.0, STEP / max(float(np.abs(step).max()), 1e-300))


def _searched(
    prediction: Prediction, at: Float, here: Point, step: Float, lower: Float, upper: Float
) -> tuple[Float, Point] | None:
    """The first of ever shorter steps that lowers the criterion."""
    for halved in range(12):
        there = np.clip(at + step / 2**halved, lower, upper)
        point = prediction.at(there)
        if point.value < here.value - 1e-4 * abs(float(here.slope @ (there - at))):
            return there, point
    return None
