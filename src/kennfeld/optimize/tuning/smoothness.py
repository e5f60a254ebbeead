"""Automatic smoothness: choice of the factors with the least predicted error on held-out data.

Each round fits with the current factors, linearises the problem there, finds better factors for the linearised problem
(`prediction_error`), and fits again from there. The new factors are kept if they are better indeed, and a trust region
around the best factors follows the ratio of the actual to the predicted gain. Only the fits evaluate the model, a few
times per round, since each starts near its end. The alternation is the performance-oriented iteration of S. N. Wood,
Generalized Additive Models, 2017, section 6.4, on Gauss-Newton.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from functools import partial

import numpy as np

from kennfeld.base.arrays import Bool, Float, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.native.block_matrix import BlockMatrix, BlockStorage
from kennfeld.native.symmetric import as_sparse
from kennfeld.optimize.fit.fit import CHOICE
from kennfeld.optimize.problem.table_penalties import Restrained, Restraint, Roughness, move_determined, penalty_of
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, SolverSettings, StageReport, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import CompiledProblem, smoothable
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.tuning.holdout_blocks import HoldoutBlock, HoldoutBlocks
from kennfeld.optimize.tuning.prediction_error import (
    HOLDOUT_SHARE,
    Linearised,
    Prediction,
    balanced_factor,
    minimise_prediction,
)

RANGE = 1e7  # largest factor, and reciprocal of the smallest one, relative to the data
MIN_CHANGE = 0.1  # of a logarithm, for another fit
MAX_ROUNDS = 12
PATH = (3, 2, 1, 0, -1)  # powers of ten of the factors tried first, relative to the data
LARGER = range(1, 8)  # powers of ten of the factors, relative to the data, that are tried if GCV is undefined
LIGHT = -2  # power of ten of the factors for the fit whose errors give the number of independent samples
MIN_GAIN = 0.005  # for another round: of n times the logarithm of the criterion, for each value that data determine
POOR, GOOD = 0.25, 0.75  # ratio of actual to predicted gain at which the radius is halved, or doubled
NO_FACTOR = -np.inf  # logarithm of the factor 0, for tables without data
MIN_CORRELATION = 2.0  # samples per independent sample, from which blocks are held out
ACTIVE_TOLERANCE = 1e-9  # relative to the size of a linear row
ROUGH = SolverSettings(max_iterations=40, patience=2)
LOOSE = 15  # iterations of a fit without restraints, which would follow a scale that no data determine without end
NOISE_SHARE, TOLERANCES = 0.05, (1e-5, 1e-3)  # as `fit.default_tolerance`, for fits that a last search follows

Samples = Callable[[Float], float]


@dataclass(frozen=True)
class Round:
    """A fit with certain factors, the criterion there, and the linearised problem that proposes the next factors."""

    logarithms: Float  # of all factors
    fit: SolverResult
    value: float = np.inf  # n times the logarithm of the criterion
    prediction: Prediction | None = None  # the criterion of the linearised problem
    live: Bool = field(default_factory=lambda: np.zeros(0, dtype=bool))  # factors whose tables have data
    middle: Float = field(default_factory=lambda: np.zeros(0))  # live logarithms at equal weight of roughness and data
    freedom: float = 0.0  # effective number of values that the data determine

    @property
    def stopped(self) -> bool:
        """True if the user stopped the fit."""
        return self.fit.status == "stopped"

    @property
    def undefined(self) -> bool:
        """True if the criterion has no value, because too few samples are independent."""
        return self.prediction is not None and not np.isfinite(self.value)

    def propose(self, radius: float) -> tuple[Float, float]:
        """Find the best logarithms of the factors, Float[factors], within a radius, and their predicted gain."""
        if self.prediction is None:
            return self.logarithms, 0.0
        here, spread = self.logarithms[self.live], np.log(RANGE)
        # within the range of factors, and within the trust region
        lower, upper = (np.clip(self.middle + side, here - radius, here + radius) for side in (-spread, spread))
        best = minimise_prediction(self.prediction, here, lower, upper)
        return self._with(best), self.value - self.prediction.at(best).value

    def _with(self, live: Float) -> Float:
        logarithms = self.logarithms.copy()
        logarithms[self.live] = live
        return logarithms


@dataclass(frozen=True)
class SmoothnessChoice:
    """The factors of all tables with an automatic one, one per axis, and the fit with them."""

    factors: Mapping[str, tuple[float, ...]]
    logarithms: Float
    fit: SolverResult
    samples: float
    blocks: int = 0
    holdout_share: float = HOLDOUT_SHARE
    undefined: bool = False  # the factors could not be judged
    restraints: Mapping[str, Restraint] = field(default_factory=dict)

    @property
    def words(self) -> str:
        """A sentence on how the factors were chosen."""
        if self.undefined:
            return (
                "Smoothness could not be chosen, because too few samples are independent: it weighs as much as the "
                "data. Set a factor, or fit fewer values."
            )
        methods = []
        if not self.blocks or self.holdout_share < 1:
            methods.append("generalised cross-validation")
        if self.blocks:
            methods.append(f"{self.blocks} held-out blocks of the recordings")
        return f"Smoothness was chosen by {' and by '.join(methods)}: the factors with the least predicted error."

    @property
    def by_direction(self) -> dict[str, dict[str, float]]:
        """The factors by table and axis."""
        return {name: dict(zip(AXIS_LETTERS, factors, strict=False)) for name, factors in self.factors.items()}


@dataclass(frozen=True)
class _Block:
    """One axis of one table: its roughness with unit factor, and the factor unless it is automatic."""

    name: str
    axis: int
    unit: Roughness
    factor: float | None


@dataclass
class SmoothnessSelection:
    """Chooses the automatic factors of a compiled problem, which has the chosen factors afterwards.

    Args:
        compiled: the compiled problem.
        limits: bounds and linear limits of the free values.
        settings: settings of the solver.
        report: called after every accepted step.
        independent: returns the number of independent samples for some values; by default that of the scored ones.
    """

    compiled: CompiledProblem
    limits: LinearLimits
    settings: SolverSettings
    report: StageReport
    independent: Samples | None

    def __post_init__(self) -> None:
        self.problem = self.compiled.problem
        # a fit has as much noise as values per residual: digits beyond a share of that are not worth iterations
        share = NOISE_SHARE * self.compiled.values.free / max(self.compiled.residuals, 1)
        most = min(ROUGH.max_iterations, self.settings.max_iterations)
        self.settings = replace(ROUGH, max_iterations=most, tolerance=float(np.clip(share, *TOLERANCES)))
        self.restraints: Mapping[str, Restraint] = {}
        self.scored = count_scored(self.compiled)
        self.samples = self.scored  # the same for all rounds, so that these are comparable
        self.holdout: HoldoutBlocks | None = None
        self.holdout_share = HOLDOUT_SHARE
        self.objective = LeastSquaresObjective(self.compiled)
        blocks = list(_blocks(self.compiled))
        self.automatic = [block for block in blocks if block.factor is None]
        self.fixed = [
            # rows of a square: the root of the factor goes into the coefficients
            replace(block.unit, coefficients=block.unit.coefficients * block.factor**0.5)
            for block in blocks
            if block.factor is not None
        ]
        self.rounds = self.iterations = self.evaluations = 0

    def run(self, start: Float, known: SmoothnessChoice | None) -> SmoothnessChoice:
        """Choose the factors, from free values within the limits, Float[values], and from an earlier choice if any."""
        if known is None:
            best = self._search(start)
        else:
            # those of the earlier choice, so that both are compared by one criterion
            self._set_samples(known.samples)
            self.holdout_share = known.holdout_share
            self.restraints = known.restraints  # at each new target, values that the data leave open could move on
            best = self._improve(self._round(known.logarithms, start))
        self._use(best.logarithms)
        cost = self.objective.cost(best.fit.values)
        fit = replace(best.fit, cost=cost, iterations=self.iterations, evaluations=self.evaluations)
        blocks = self.holdout.sizes.size if self.holdout else 0
        factors = self._factors(best.logarithms)
        return SmoothnessChoice(
            factors,
            best.logarithms,
            fit,
            self.samples,
            blocks=blocks,
            holdout_share=self.holdout_share,
            undefined=best.undefined,
            restraints=self.restraints,
        )

    def _set_samples(self, samples: float) -> None:
        """Set the number of independent samples; hold out blocks if the samples are correlated."""
        if self.scored >= MIN_CORRELATION * samples:
            self.holdout = HoldoutBlocks.of(self.compiled)
        self.samples = samples

    def _search(self, start: Float) -> Round:
        """Return the choice from factors with the weight of the data or, if better, from the best of a path.

        The path is for chains of tables, those whose lookups depend on the values of others.
        """
        reference = self._reference(start)
        if self.independent is not None:
            # a lightly smoothed fit: the errors of a smoother one are correlated by the smoothness itself
            self._set_samples(self.independent(self._fit(reference + LIGHT * np.log(10), start).values))
        # restraints come from a fit, so the first one has none
        plain = self._fit(reference, start, LOOSE)
        if plain.cut_short:
            return Round(reference, plain)
        # first towards the start, then towards the start moved by what this restrained fit shows to be determined
        self.restraints = self._restraints(plain.values, move_start=False)
        restrained = self._fit(reference, plain.values)
        self.restraints = self._restraints(restrained.values, move_start=True)
        best = self._improve(self._judge_first(reference, restrained))
        if not best.fit.cut_short and smoothable(self.problem):
            other = self._path(reference, start)
            if other.value < best.value and not other.fit.cut_short:
                other = self._improve(other)
            best = other if other.value < best.value or other.stopped else best
        if not best.undefined or best.stopped:
            return best
        self.restraints = {}  # so few samples move single values far, and what has no roughness goes through them
        return replace(best, fit=plain)

    def _judge_first(self, logarithms: Float, fit: SolverResult) -> Round:
        """Judge the fit with the factors at which the search begins.

        GCV is undefined if hardly more samples are independent than values determined. Held-out blocks then decide
        alone; without them, the search begins with the least larger factors at which GCV is defined.
        """
        first = self._judge(logarithms, fit)
        if not first.undefined or first.prediction is None:
            return first
        if self.holdout:
            self.holdout_share = 1.0
            return self._judge(logarithms, fit)
        for decade in LARGER:
            larger = logarithms + decade * np.log(10)
            if np.isfinite(first.prediction.at(larger[first.live]).value):
                return self._round(larger, fit.values)
        return first

    def _reference(self, start: Float) -> Float:
        """Return the logarithms of the factors with the weight of the data.

        A table may have an effect only once others have moved, as a time constant behind a map of zeros. Tables without
        data at the start are therefore examined again after a fit of the others.
        """
        scales = self._scales(self._data(start)[1])
        logarithms = np.log(scales, out=np.full(scales.size, NO_FACTOR), where=scales > 0)
        if (scales > 0).all() or not (scales > 0).any():
            return logarithms
        again = self._scales(self._data(self._fit(logarithms, start).values)[1])
        return np.log(again, out=logarithms, where=(scales <= 0) & (again > 0))

    def _path(self, reference: Float, start: Float) -> Round:
        """Return the best of fits with decreasing factors in constant proportion, each starting at the previous one.

        With large factors tables are almost straight, which keeps a chain of tables from starting at a fit of noise.
        The fits are compared without held-out blocks, which take longer than a fit, unless only these decide.
        """
        trials: list[Round] = []
        for decade in PATH:
            logarithms = reference + decade * np.log(10)
            trials.append(self._judge(logarithms, self._fit(logarithms, start), hold_out=self.holdout_share == 1))
            # from almost straight tables to bent ones
            start = trials[-1].fit.values
            if trials[-1].fit.cut_short:
                break
        best = trials[-1] if trials[-1].stopped else min(trials, key=lambda trial: trial.value)
        return self._judge(best.logarithms, best.fit) if self.holdout else best

    def _improve(self, best: Round) -> Round:
        radius, last = np.inf, self.rounds + MAX_ROUNDS
        while np.isfinite(best.value) and self.rounds < last and radius > MIN_CHANGE:
            proposal, gain = best.propose(radius)
            if gain < MIN_GAIN * max(best.freedom, 1.0):
                break
            trial = self._round(proposal, best.fit.values)
            if trial.fit.cut_short:
                return trial if trial.stopped else best
            # trust region around the best factors: halved after a poor prediction, widened after a good one at its edge
            moved = np.abs(proposal[best.live] - best.logarithms[best.live]).max()
            ratio = (best.value - trial.value) / gain
            radius = moved / 2 if ratio < POOR else max(radius, 2 * moved) if ratio > GOOD else radius
            best = trial if ratio > 0 else best
        return best

    def _restraints(self, values: Float, *, move_start: bool) -> dict[str, Restraint]:
        """Return the restraints of tables with an automatic factor, after a fit.

        Args:
            values: the free values of the fit.
            move_start: pull towards the start moved by what the data determine, see `move_determined`.
        """
        gradient, matrix = self._data(values)
        weights, offsets = matrix.diagonal(), self.compiled.values.offsets
        # of an error, in units of the cost
        variance = self.compiled.sums.cost(self.compiled.full(values)) / self.samples
        toward = self.objective.start
        if move_start:
            toward = move_determined(toward, values, gradient, matrix)
        restraints = {}
        for name in self.problem.automatic_names:
            table = self.problem.parameters[name]
            part = slice(offsets[name], offsets[name] + table.size)
            at = toward[part].reshape(table.values.shape)
            restraints[name] = Restraint.of(at, values[part], weights[part], variance)
        return restraints

    def _round(self, logarithms: Float, start: Float) -> Round:
        return self._judge(logarithms, self._fit(logarithms, start))

    def _fit(self, logarithms: Float, start: Float, most: int = ROUGH.max_iterations) -> SolverResult:
        """Fit with some factors, in at most that many iterations."""
        self._use(logarithms)
        self.rounds += 1
        report = partial(self.report, f"{CHOICE} {self.rounds}")
        settings = replace(self.settings, max_iterations=min(most, self.settings.max_iterations))
        fit = levenberg_marquardt(self.objective, start, self.limits, settings, report)
        self.iterations += fit.iterations
        self.evaluations += fit.evaluations
        return fit

    def _judge(self, logarithms: Float, fit: SolverResult, *, hold_out: bool = True) -> Round:
        """Evaluate and linearise the criterion at a fit with some factors."""
        self._use(logarithms)
        gradient, matrix = self._data(fit.values)
        scales = self._scales(matrix)
        live = (scales > 0) & np.isfinite(logarithms)
        if not live.any() or fit.cut_short:
            return Round(logarithms, fit)
        holdout = self.holdout if hold_out else None
        parts = tuple(holdout.linearise(self.compiled.full(fit.values))) if holdout else ()
        prediction = self._prediction(fit.values, gradient, matrix, live, parts)
        point = prediction.at(logarithms[live])
        return Round(logarithms, fit, point.value, prediction, live, np.log(scales[live]), point.freedom)

    def _prediction(
        self,
        values: Float,
        gradient: Float,
        matrix: Float | Sparse,
        live: Bool,
        parts: tuple[HoldoutBlock, ...],
    ) -> Prediction:
        """Return the criterion of the problem linearised at these values; values at an active bound are fixed."""
        total = gradient.copy()
        self.compiled.roughness.add(values, total, BlockMatrix(BlockStorage(values.size), np.arange(values.size)))
        limits, full = self.limits, self.compiled.full(values)
        # at a bound and pressed against it by the gradient of data and penalty
        active = ((values >= limits.upper) & (total < 0)) | ((values <= limits.lower) & (total > 0))
        misfit = self.compiled.sums.cost(full)
        free, fixed = limits.movable & ~active, list(self.fixed)
        penalty, pull = self.compiled.roughness, {}
        if isinstance(penalty, Restrained):
            # the parts of a restraint have factors of their own, which are not chosen
            fixed.append(penalty.steps)
            pull = {"pull": penalty.weights, "toward": penalty.toward}
        rows = limits.rows.matrix(np.flatnonzero(limits.rows.touching(values, ACTIVE_TOLERANCE)), values.size)
        fit = Linearised(values, misfit, gradient, matrix, free, rows, self.samples, parts, self.holdout_share, **pull)
        blocks = [block.unit for block, good in zip(self.automatic, live, strict=True) if good]
        return Prediction(fit, blocks, fixed)

    def _data(self, values: Float) -> tuple[Float, Float | Sparse]:
        """Return half the gradient and the Gauss-Newton matrix of the data alone, copies."""
        data = self.compiled.sums.normal(self.compiled.full(values))
        matrix = data.matrix
        return data.gradient.copy(), matrix.copy() if isinstance(matrix, np.ndarray) else as_sparse(matrix)

    def _scales(self, matrix: Float | Sparse) -> Float:
        return np.array([balanced_factor(block.unit, matrix.diagonal()) for block in self.automatic])

    def _factors(self, logarithms: Float) -> dict[str, tuple[float, ...]]:
        """Return the factors of the tables with an automatic one; 0 for axes with too few breakpoints for roughness."""
        by_table = {name: list(self.problem.factors(name)) for name in self.problem.automatic_names}
        for block, logarithm in zip(self.automatic, logarithms, strict=True):
            by_table[block.name][block.axis] = float(np.exp(logarithm))
        return {name: tuple(factors) for name, factors in by_table.items()}

    def _use(self, logarithms: Float) -> None:
        factors = {name: self.problem.factors(name) for name in self.problem.free_names} | self._factors(logarithms)
        self.compiled.roughness = penalty_of(self.problem.parameters, self.compiled.values, factors, self.restraints)


def _blocks(compiled: CompiledProblem) -> Iterator[_Block]:
    """Return all axes with a roughness whose factor is > 0 or automatic."""
    problem = compiled.problem
    for name in problem.free_names:
        factors = problem.factors(name)
        for axis, (automatic, factor) in enumerate(zip(problem.automatic(name), factors, strict=True)):
            unit = [float(other == axis) for other in range(len(factors))]
            roughness = Roughness.of(problem.parameters, compiled.values, {name: unit})
            if len(roughness.columns) and (automatic or factor > 0):
                yield _Block(name, axis, roughness, None if automatic else factor)


def count_scored(compiled: CompiledProblem) -> float:
    """Count the scored samples of all criteria."""
    return float(sum(compiled.each(_count_weighted)))


def _count_weighted(compiled: CompiledProblem) -> float:
    samples = compiled.samples
    return float(sum(samples.scored(piece) @ (piece.scores > 0) for piece in samples.pieces))
