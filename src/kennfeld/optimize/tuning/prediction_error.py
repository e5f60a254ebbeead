"""Predicted error of a linearised fit on held-out data, as a function of its smoothness factors.

The criterion is generalised cross-validation (GCV), n D / (n - gamma F)^2, with D the misfit of n samples and F the
effective number of values that the data determine, the trace of the influence matrix (P. Craven and G. Wahba, Smoothing
noisy data with spline functions, 1979). A gamma above 1 guards small data sets against following noise (Y.-J. Kim and
C. Gu, Smoothing spline Gaussian regression, 2004). First and second derivatives by the logarithms of the factors are
exact. With data at many grid points, the trace is estimated from random signs (M. F. Hutchinson, A stochastic estimator
of the trace of the influence matrix for Laplacian smoothing splines, 1989), the same ones for all factors, so that its
derivatives are those of the estimate. With H = C C' the matrix of the data and V the inverse of that with the penalty,
the signs u give u'C'V C u: the eigenvalues of this symmetric matrix are between 0 and 1, so that the variance of the
estimate is at most 2 F divided by the number of probes. Signs on both sides of V H, which has the same trace, give a
variance without limit, and another one in other units of the values.

If errors are correlated in time, blocks of the data are also held out in turn: with D_b the misfit of block b by the
linearised fit to all other blocks, the mean of log D_b is a second estimate of the logarithm of the error (S. N. Wood,
On neighbourhood cross validation, 2024). Logarithms keep a single block with large model errors from dominating. The
criterion is then a weighted mean of both estimates: GCV is precise but relies on the estimated correlation time, the
blocks do not but are few. If errors last so long that fewer samples are independent than values determined, GCV is
undefined, and the blocks decide alone. As they tell a factor vaguely, and the least of a vague criterion is often
extreme, the logarithm of each factor is also assumed to be normally distributed around that of equal weight of
roughness and data.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.native.cholesky import Cholesky, Factor
from kennfeld.native.symmetric import scaled
from kennfeld.optimize.problem.table_penalties import Roughness
from kennfeld.optimize.tuning.holdout_blocks import HoldoutBlock

GAMMA = 1.2
SPREAD = 0.5 * float(np.log(10))  # standard deviation of the logarithm of a factor, if blocks are held out
HOLDOUT_SHARE = 0.75  # of the estimate from held-out blocks in the mean
RIDGE = 1e-8  # of the diagonal; keeps undetermined values where they are
LITTLE_RIDGE = 1e-10  # the same, for the factor of the data's matrix
MIN_RESIDUAL_SHARE = 0.01  # of the samples that a fit must leave as residual degrees of freedom
MAX_STEP = 4.0  # change of a logarithm in one Newton step
MIN_GAIN = 0.002  # for a further step: of the criterion, for each value that the data determine
MAX_UNIT_PROBES = 256  # values with data up to which the trace is exact
RANDOM_PROBES = 64
MAX_EXPLICIT = 1024  # values up to which the inverse is computed as a whole

Solve = Callable[[Float], Float]  # the inverse times a vector, or times each row of a matrix
Misfit = tuple[float, Float, Float]  # its value, slope and curvature


@dataclass(frozen=True)
class Linearised:
    """A linearised fit: misfit(p + d) = misfit + 2 gradient'd + d'matrix d, without roughness."""

    values: Float  # p, Float[values]
    misfit: float  # cost of the data at p
    gradient: Float  # half the gradient of the misfit, Float[values]
    matrix: Float | Sparse  # Gauss-Newton matrix of the misfit, Float[values, values]
    movable: Bool  # values that may change, Bool[values]
    rows: Float  # directions fixed by equalities, Float[equalities, values]
    samples: float  # number of independent samples
    blocks: tuple[HoldoutBlock, ...] = ()  # parts of the data to be held out in turn
    holdout_share: float = HOLDOUT_SHARE  # of the estimate from these blocks in the mean
    # weights and target of a quadratic penalty on p - toward that does not depend on the factors, Float[values]
    pull: Float | float = 0.0
    toward: Float | float = 0.0


@dataclass(frozen=True)
class Point:
    """n times the logarithm of the criterion, with its derivatives by the logarithms of the factors."""

    value: float
    slope: Float  # Float[blocks]
    curvature: Float  # Float[blocks, blocks]
    freedom: float = 0.0  # F


def balanced_factor(block: Roughness, diagonal: Float) -> float:
    """Compute the factor at which roughness and data have about equal weight; 0 for a table without data.

    Args:
        block: roughness with unit factor.
        diagonal: that of the Gauss-Newton matrix of the data, Float[values].
    """
    return float(diagonal[np.unique(block.columns)].sum() / np.sum(block.coefficients**2))


class Prediction:
    """The criterion of a linearised fit.

    Args:
        fit: the linearised fit.
        blocks: roughnesses with unit factor, whose factors are the variables.
        fixed: roughnesses with fixed factors.
    """

    def __init__(self, fit: Linearised, blocks: Sequence[Roughness], fixed: Sequence[Roughness] = ()) -> None:
        diagonal = fit.matrix.diagonal()
        self._balanced = np.log([max(balanced_factor(block, diagonal), 1e-300) for block in blocks])
        # values that neither data nor roughness touch would make the matrix singular
        touched = diagonal > 0
        for block in (*blocks, *fixed):
            touched[block.columns] = True
        self._fit, self._free = fit, np.flatnonzero(fit.movable & touched)
        self._blocks = [_Penalty(block, fit.values, self._free) for block in blocks]
        self._fixed = [_Penalty(block, fit.values, self._free) for block in fixed]
        self._equalities = fit.rows[(fit.rows[:, self._free] != 0).any(axis=1)][:, self._free]
        self._data = _part(fit.matrix, self._free)
        self._cholesky = Cholesky(self._free.size)
        self._probes = _probes(self._data)
        size = self._free.size
        # the whole inverse takes `size` solves, the probes theirs, and once more for each block
        self._explicit = size <= MAX_EXPLICIT and len(self._probes) * (1 + len(blocks)) >= size

    def at(self, logarithms: Float) -> Point:
        """Evaluate the criterion at the logarithms of the factors, shape (blocks,)."""
        factors = np.exp(logarithms)
        matrix = self._add_penalty(factors)
        solve = self._inverse(matrix)
        if solve is None:
            return self._undefined
        gcv = self._gcv(factors, solve)
        if not self._fit.blocks:
            return gcv
        share = self._fit.holdout_share
        # n log D_b and n log GCV are -2 log L up to constants, as is the distribution of the factors
        terms = [(share, self._held_out(factors, matrix)), (1.0, self._typical(logarithms))]
        if share < 1:
            terms.append((1 - share, gcv))
        return _sum(terms, gcv.freedom)

    def _gcv(self, factors: Float, solve: Solve) -> Point:
        """Return the logarithm of GCV times the samples; infinite if hardly a sample is left as residual."""
        freedom, d_freedom, dd_freedom = self._freedom(factors, solve)
        whole = HoldoutBlock(self._fit.misfit, self._fit.gradient, self._data, 1.0)
        misfit, d_misfit, dd_misfit = self._misfit(factors, self._fit.gradient, whole, solve)
        samples = self._fit.samples
        residual = samples - GAMMA * freedom
        if residual < MIN_RESIDUAL_SHARE * samples:
            return Point(np.inf, d_misfit, dd_misfit, freedom)
        # n log(n D / (n - gamma F)^2) but for a constant, and its derivatives by the product rule
        value = samples * (np.log(misfit) - 2 * np.log(residual / samples))
        slope = samples * (d_misfit / misfit + 2 * GAMMA * d_freedom / residual)
        curvature = dd_misfit / misfit - np.outer(d_misfit, d_misfit) / misfit**2
        curvature += 2 * GAMMA * dd_freedom / residual + 2 * GAMMA**2 * np.outer(d_freedom, d_freedom) / residual**2
        return Point(float(value), slope, samples * curvature, freedom)

    def _typical(self, logarithms: Float) -> Point:
        """Return twice the negative logarithm of the normal distribution of the factors' logarithms."""
        away = (logarithms - self._balanced) / SPREAD
        return Point(float(away @ away), 2 * away / SPREAD, 2 * np.eye(away.size) / SPREAD**2)

    @property
    def _undefined(self) -> Point:
        count = len(self._blocks)
        return Point(np.inf, np.zeros(count), np.zeros((count, count)))

    def _held_out(self, factors: Float, matrix: Float | Sparse) -> Point:
        """Return the samples times the mean of log D_b, with D_b the misfit of a block by the fit to the others."""
        count = len(self._blocks)
        value, slope, curvature = 0.0, np.zeros(count), np.zeros((count, count))
        for block in self._fit.blocks:
            own = block.matrix[np.ix_(self._free, self._free)]
            # the fit to the others needs no data again: matrix and gradient without those of the block
            solve = self._inverse(matrix - own)
            if solve is None:
                return self._undefined
            scored = HoldoutBlock(block.misfit, block.gradient, own, block.share)
            misfit, first, second = self._misfit(factors, self._fit.gradient - block.gradient, scored, solve)
            value += block.share * np.log(misfit)
            slope += block.share * first / misfit
            curvature += block.share * (second / misfit - np.outer(first, first) / misfit**2)
        samples = self._fit.samples
        return Point(float(samples * value), samples * slope, samples * curvature)

    def freedom(self, logarithms: Float) -> float:
        """Compute the effective number of values that the data determine, at logarithms of factors, Float[blocks]."""
        solve = self._inverse(self._add_penalty(np.exp(logarithms)))
        return float("nan") if solve is None else self._freedom(np.exp(logarithms), solve)[0]

    def _add_penalty(self, factors: Float) -> Float | Sparse:
        """Return matrix plus penalty over the free values."""
        matrix = self._data.copy()
        for penalty, factor in self._weighted(factors):
            matrix = penalty.add(factor, matrix)
        pull = np.broadcast_to(self._fit.pull, self._fit.values.shape)[self._free]
        return _with_diagonal(matrix, pull)

    def _weighted(self, factors: Float) -> Iterator[tuple["_Penalty", float]]:
        """Yield all penalties with their factors."""
        yield from zip(self._blocks, factors.tolist(), strict=True)
        yield from ((penalty, 1.0) for penalty in self._fixed)

    def _inverse(self, matrix: Float | Sparse) -> Solve | None:
        """Return the product with the inverse of a matrix in the directions that equalities leave free.

        None if the matrix is not positive definite. The product is valid until the next call.
        """
        scale = 1 / np.sqrt(np.maximum(matrix.diagonal(), 1e-300))
        factor = self._cholesky.factor(scaled(matrix, scale), np.full(scale.size, RIDGE))
        return None if factor is None else _constrained(partial(_solve, factor, scale), self._equalities)

    def _misfit(self, factors: Float, fitted: Float, scored: HoldoutBlock, solve: Solve) -> Misfit:
        """Return the misfit of the `scored` data by the linearised fit with these factors, and its derivatives.

        The matrix of the `scored` data is that of the free values, Float[free, free]. `fitted` is the gradient of the
        fitted data, `solve` multiplies with the inverse V of their matrix plus penalty. The fit moves by
        d = -V (g + sum of f_i P_i p), so that dd/dlog f_i = -f_i V P_i (p + d).
        """
        free = self._free
        pull = fitted[free] + self._penalty_slope(factors)
        step = -solve(pull)
        gradient = scored.gradient[free] + scored.matrix @ step
        # misfit + 2 g'd + d'H d = misfit + (g + (g + H d))'d; above 0, as its logarithm is taken
        misfit = max(scored.misfit + float((scored.gradient[free] + gradient) @ step), 1e-12 * scored.misfit, 1e-300)
        ends = np.stack([step, solve(gradient)], axis=1)
        pulls, back = np.array([penalty.times(ends).T for penalty in self._blocks]).transpose(1, 0, 2)
        moves = -factors[:, None] * solve(pulls + [penalty.slope for penalty in self._blocks])
        # with m_i = dd/dlog f_i and the gradient q = g + H d: slope_i = 2 m_i'q, and curvature_ij =
        # delta_ij slope_i + 2 m_i'H m_j - 2 (f_i q'V P_i m_j + f_j q'V P_j m_i)
        slope = 2 * moves @ gradient
        cross = factors[:, None] * (back @ moves.T)
        return misfit, slope, np.diag(slope) + 2 * moves @ (scored.matrix @ moves.T) - 2 * (cross + cross.T)

    def _penalty_slope(self, factors: Float) -> Float:
        """Return half the gradient of the penalty by the free values, at the values of the fit."""
        fit = self._fit
        slope: Float = (fit.pull * (fit.values - fit.toward) + np.zeros(fit.values.size))[self._free]
        for penalty, factor in self._weighted(factors):
            slope += factor * penalty.slope
        return slope

    def _freedom(self, factors: Float, solve: Solve) -> tuple[float, Float, Float]:
        """Return the trace of the influence matrix V H, and its derivatives, from dV/df_i = -V P_i V."""
        trace, traces, squares = (self._traces if self._explicit else self._probed_traces)(solve)
        slope = -factors * traces
        # d2 tr(V H) / df_i df_j = tr(V P_i V P_j V H) + tr(V P_j V P_i V H)
        bends = np.outer(factors, factors) * (squares + squares.T)
        return trace, slope, np.diag(slope) + bends

    def _traces(self, solve: Solve) -> tuple[float, Float, Float]:
        """Return the traces of V H, of P_i V H V and of P_i V P_j V H V; each P is a block over few values."""
        inverse = solve(np.eye(self._free.size))
        influence = inverse @ self._data
        # V H V, of which each trace needs the part over the values of a block
        spread = influence @ inverse
        blocks = [(penalty.own, penalty.dense) for penalty in self._blocks]
        traces = [np.sum(matrix * spread[np.ix_(own, own)]) for own, matrix in blocks]
        squares = [
            [np.sum((matrix @ inverse[np.ix_(own, its)]) * (spread[np.ix_(own, its)] @ other)) for its, other in blocks]
            for own, matrix in blocks
        ]
        return float(np.trace(influence)), np.array(traces), np.array(squares)

    def _probed_traces(self, solve: Solve) -> tuple[float, Float, Float]:
        """Return the same traces, as the sums of w'V w, of w'V P_i V w and so on over the probes w, which are rows."""
        inner = solve(self._probes).T
        pulled = [penalty.times(inner) for penalty in self._blocks]
        traces = [np.sum(inner * each) for each in pulled]
        squares = []
        for each in pulled:
            back = solve(each.T).T
            squares.append([np.sum(other * back) for other in pulled])
        return float(np.sum(inner.T * self._probes)), np.array(traces), np.array(squares)


def _sum(terms: Sequence[tuple[float, Point]], freedom: float) -> Point:
    """Return the weighted sum of estimates."""
    return Point(
        sum(weight * point.value for weight, point in terms),
        np.sum([weight * point.slope for weight, point in terms], axis=0),
        np.sum([weight * point.curvature for weight, point in terms], axis=0),
        freedom,
    )


def _solve(factor: Factor, scale: Float, rows: Float) -> Float:
    return factor.solve(rows * scale) * scale


def _constrained(solve: Solve, equalities: Float) -> Solve:
    """Return the product with the inverse in the directions that equalities leave free."""
    if not len(equalities):
        return solve
    # V - V A' (A V A')^+ A V, with the equalities as rows A; the pseudo-inverse allows dependent ones
    across = solve(equalities)
    middle = np.linalg.pinv(across @ equalities.T)

    return lambda rows: solve(rows) - rows @ across.T @ middle @ across


class _Penalty:
    """The penalty z'P z with unit factor over the free values z, linearised at those of a fit.

    Args:
        block: roughness with unit factor, rows D of three values each; P = D'D.
        values: values of the fit, Float[values].
        free: numbers of the free ones.
    """

    def __init__(self, block: Roughness, values: Float, free: Int) -> None:
        place = np.full(values.size, -1, dtype=np.int64)
        place[free] = np.arange(free.size)
        columns = place[block.columns]
        # rows of fixed values alone do not change; the fixed values of others have the coefficient 0
        some = (columns >= 0).any(axis=1)
        self._columns = columns[some].clip(0)
        self._coefficients = np.where(columns[some] >= 0, block.coefficients[some], 0.0)
        self._rows = Roughness(free.size, self._columns, self._coefficients)
        self.slope = block.slope(values)[free]  # P z, with what fixed values add

    def add(self, factor: float, matrix: Float | Sparse) -> Float | Sparse:
        """Add factor P to a matrix; an array is changed in place."""
        rows, columns, entries = self._rows.nonzeros
        if isinstance(matrix, np.ndarray):
            matrix[rows, columns] += factor * entries
            return matrix
        from scipy.sparse import csr_array

        return matrix + csr_array((factor * entries, (rows, columns)), shape=matrix.shape)

    def times(self, vectors: Float) -> Float:
        """Return P times the columns of an array, Float[free, columns]."""
        terms = list(zip(self._columns.T, self._coefficients.T[:, :, None], strict=True))
        differences = np.sum([coefficients * vectors[column] for column, coefficients in terms], axis=0)
        product = np.zeros(vectors.shape)
        for column, coefficients in terms:
            np.add.at(product, column, coefficients * differences)
        return product

    @cached_property
    def own(self) -> Int:
        """The values in P."""
        return np.unique(self._rows.nonzeros[0])

    @cached_property
    def dense(self) -> Float:
        """P over its own values."""
        rows, columns, entries = self._rows.nonzeros
        matrix = np.zeros((self.own.size, self.own.size))
        matrix[np.searchsorted(self.own, rows), np.searchsorted(self.own, columns)] = entries
        return matrix


def _part(matrix: Float | Sparse, which: Int) -> Float | Sparse:
    return matrix[np.ix_(which, which)] if isinstance(matrix, np.ndarray) else matrix[which][:, which]


def _with_diagonal(matrix: Float | Sparse, diagonal: Float) -> Float | Sparse:
    """Add a diagonal; an array is changed in place."""
    if isinstance(matrix, np.ndarray):
        matrix[np.diag_indices_from(matrix)] += diagonal
        return matrix
    from scipy.sparse import diags_array

    return (matrix + diags_array(diagonal)).tocsr()


def _probes(data: Float | Sparse) -> Float:
    """Return rows w whose sum of w w' is the data's matrix H, up to a share `LITTLE_RIDGE`, or an estimate of it.

    They are the rows of U C', with C C' = H and the rows of U unit vectors or random signs. With H + ridge = L L', C'
    is computed as the inverse of L times H, which has nothing in the directions without data.
    """
    seen = np.flatnonzero(data.diagonal() > 0)
    own = _part(data, seen)
    scale = 1 / np.sqrt(own.diagonal())
    factor = Cholesky(seen.size).factor(scaled(own, scale), np.full(seen.size, LITTLE_RIDGE))
    few = seen.size <= MAX_UNIT_PROBES
    probes = np.zeros((seen.size if few else RANDOM_PROBES, data.shape[0]))
    if factor is None:  # not finite
        return np.full(probes.shape, np.nan)
    signs = np.zeros((len(probes), factor.inverse.size))
    # unit vectors give the trace itself, random signs an estimate of it
    signs[:, : seen.size] = np.eye(seen.size) if few else _random_signs(seen.size)
    # rows w = U L^-1 H, in units of the diagonal of H
    probes[:, seen] = (scale * factor.solve_upper(signs)) @ own
    return probes


def _random_signs(size: int) -> Float:
    signs = np.array([-1.0, 1.0]) / RANDOM_PROBES**0.5
    return np.asarray(np.random.default_rng(0).choice(signs, size=(RANDOM_PROBES, size)))


def minimise_prediction(
    prediction: Prediction, start: Float, lower: Float, upper: Float, iterations: int = 50
) -> Float:
    """Minimise the criterion over the logarithms of the factors, Float[blocks], within bounds, by Newton's method.

    A factor whose best value is infinite ends at its bound, or at the point from which the criterion is flat.
    """
    values = np.clip(start, lower, upper)
    point = prediction.at(values)
    for _ in range(iterations):
        # factors at a bound stay there while the criterion falls outwards
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
        if gain < MIN_GAIN * max(point.freedom, 1.0):
            break
    return values


def _newton_step(slope: Float, curvature: Float) -> Float:
    """Return a descent step of at most MAX_STEP in each logarithm; negative curvatures count by their magnitude."""
    sizes, directions = np.linalg.eigh(curvature)
    # a flat direction gets a long step, which MAX_STEP limits
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
        # condition of Armijo: a decrease by a share of what the slope promises
        if trial_point.value < point.value - 1e-4 * abs(float(point.slope @ (trial - values))):
            return trial, trial_point
    return None
