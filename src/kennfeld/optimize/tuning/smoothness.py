"""Automatic smoothness: the factors that promise the least error on data held back, chosen in turn with the fit.

Fit with the factors so far; linearise there; find better factors for the linearised problem (`prediction`); fit again
from there, and keep the factors where they are better indeed. How far a round may go from the best factors follows the
share of the promised gain that came true. Only the fit evaluates the model, a few times a round, since it starts near
its end. The alternation is the performance-oriented iteration of S. N. Wood, Generalized Additive Models, 2017,
section 6.4, on Gauss-Newton.

A fit with some smoothness factors, and the factors that the problem linearised there proposes next.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.restraint import Restrained, Restraint, penalty_of
from kennfeld.optimize.roughness import Roughness
from kennfeld.optimize.solver.levenberg_marquardt import Iteration, SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.tuning.holdout_blocks import HoldoutBlocks
from kennfeld.optimize.tuning.prediction_error import Linearised, Prediction, minimised

__all__ = ["RANGE", "Round", "SmoothnessChoice", "select_factors"]

RANGE = 1e7  # most and least factor, relative to the data
NEAR = 0.1  # difference of logarithms that is not worth another fit
RISE = 0.25  # the same for a rise of the level of smoothness

ROUNDS = 12
PATH = (3, 2, 1, 0, -1)  # powers of ten of the factors tried first, relative to the data
LIGHT = -2  # power of ten of the factors whose errors tell how many samples are independent
SETTLED = 0.1  # gain of n times the criterion's logarithm below which another round is not worth it
POOR, GOOD = 0.25, 0.75  # share of the promised gain from which the radius is halved, or doubled
NONE = -np.inf  # the logarithm where no data reach the table: its factor is 0
RESEMBLING = 2.0  # samples to an independent one, from which blocks are held back
FURTHER = 4  # most fits on the way to the smoothest
STRIDE = float(np.log(1e4))  # most rise of the lowest level of smoothness from one of them to the next
ACTIVE = 1e-9  # of the size of a linear row, at which it counts as active
ROUGH = SolverSettings(max_iterations=40, tolerance=1e-5, patience=2)

Report = Callable[[str, Iteration, Float], None]
Samples = Callable[[Float], float]


@dataclass(frozen=True)
class Round:
    """A fit with some factors, and the criterion there.

    `live` are the factors whose tables the data reach, `middle` the logarithms at which these weigh as much as the
    data.
    """

    logarithms: Float
    fit: SolverResult
    value: float = np.inf
    prediction: Prediction | None = None
    live: Bool = field(default_factory=lambda: np.zeros(0, dtype=bool))
    middle: Float = field(default_factory=lambda: np.zeros(0))

    @property
    def cut_short(self) -> bool:
        """Whether the fit did not come to an end."""
        return self.fit.status in ("stopped", "failed")

    @property
    def stopped(self) -> bool:
        """Whether the user stopped the fit."""
        return self.fit.status == "stopped"

    def proposed(self, radius: float) -> tuple[Float, float]:
        """The best factors within a radius, in the problem linearised here, and the gain that they promise."""
        if self.prediction is None:
            return self.logarithms, 0.0
        here, spread = self.logarithms[self.live], np.log(RANGE)
        lower, upper = (np.clip(self.middle + side, here - radius, here + radius) for side in (-spread, spread))
        found = minimised(self.prediction, here, lower, upper)
        return self._with(found), self.value - self.prediction.at(found).value

    def raised(self, allowed: float, stride: float) -> tuple[Float, float]:
        """Raise the lowest factors to the highest common level at which the criterion is allowed, as linearised here.

        Levels are relative to the data: 0 is where roughness and data weigh the same. Factors above the level stay.

        Args:
            allowed: The largest value of the criterion.
            stride: The most by which the lowest level may rise.

        Returns:
            The logarithms of all factors, and the rise of the lowest level.
        """
        if self.prediction is None:
            return self.logarithms, 0.0
        prediction, here = self.prediction, self.logarithms[self.live]
        lowest = float(np.min(here - self.middle))
        low, high = lowest + RISE, min(lowest + stride, np.log(RANGE))

        def is_allowed(level: float) -> bool:
            return prediction.at(np.maximum(here, self.middle + level)).value <= allowed

        if high < low or not is_allowed(low):  # mostly so after one fit
            return self.logarithms, 0.0
        if is_allowed(high):
            low = high
        while high - low > RISE:
            middle = (low + high) / 2
            low, high = (middle, high) if is_allowed(middle) else (low, middle)
        return self._with(np.maximum(here, self.middle + low)), low - lowest

    def _with(self, live: Float) -> Float:
        """All logarithms, with these where the data reach the table."""
        logarithms = self.logarithms.copy()
        logarithms[self.live] = live
        return logarithms


@dataclass(frozen=True)
class SmoothnessChoice:
    """The factors of every table that has an automatic one, one an axis, and the fit with them."""

    factors: Mapping[str, tuple[float, ...]]
    logarithms: Float
    fit: SolverResult
    samples: float
    blocks: int = 0
    restraints: Mapping[str, Restraint] = field(default_factory=dict)

    @property
    def words(self) -> str:
        """By what they were chosen."""
        by = "generalised cross-validation"
        also = f" and by holding back {self.blocks} stretches of the recordings" if self.blocks else ""
        return f"Smoothness was chosen by {by}{also}: the smoothest within one standard error of the best."

    @property
    def by_direction(self) -> dict[str, dict[str, float]]:
        """The factors by the names of the axes."""
        return {name: dict(zip("xyzw", factors, strict=False)) for name, factors in self.factors.items()}


def select_factors(
    compiled: CompiledProblem,
    start: Float,
    limits: LinearLimits,
    settings: SolverSettings,
    report: Report,
    known: SmoothnessChoice | None = None,
    samples: Samples | None = None,
) -> SmoothnessChoice:
    """Choose the automatic factors of a compiled problem, from a start that keeps the limits.

    `known` is an earlier choice to go on from. `samples` gives the number of independent samples, given the values; by
    default every scored one is. The compiled problem has the chosen factors afterwards.
    """
    return SmoothnessSelection(compiled, limits, settings, report, samples).run(start, known)


@dataclass(frozen=True)
class _Block:
    """One axis of one table: its roughness with a factor of 1, and the factor where it is given."""

    name: str
    axis: int
    unit: Roughness
    given: float | None

    @property
    def weighted(self) -> Roughness:
        """The roughness with its given factor."""
        return replace(self.unit, coefficients=self.unit.coefficients * (self.given or 0.0) ** 0.5)

    def scale(self, matrix: Float) -> float:
        """The factor at which roughness and data weigh about the same; 0 where no data reach the table."""
        columns = np.unique(self.unit.columns)
        return float(np.diag(matrix)[columns].sum() / np.sum(self.unit.coefficients**2))


class SmoothnessSelection:
    """The running state of a choice."""

    def __init__(
        self,
        compiled: CompiledProblem,
        limits: LinearLimits,
        settings: SolverSettings,
        report: Report,
        samples: Samples | None,
    ) -> None:
        self.compiled, self.limits, self.report = compiled, limits, report
        self.problem = compiled.problem
        self.settings = replace(ROUGH, max_iterations=min(ROUGH.max_iterations, settings.max_iterations))
        self.independent = samples
        self.restraints: Mapping[str, Restraint] = {}
        self.samples = scored(compiled)  # one number for all rounds, so that they compare
        self.held: HoldoutBlocks | None = None
        self.objective = LeastSquaresObjective(compiled)
        blocks = list(_blocks(compiled))
        self.sought = [block for block in blocks if block.given is None]
        self.given = [block.weighted for block in blocks if block.given is not None]
        self.rounds = self.iterations = self.evaluations = 0

    def run(self, start: Float, known: SmoothnessChoice | None) -> SmoothnessChoice:
        """Choose, from factors already known or anew."""
        if known is None:
            best = self._anew(start)
        else:
            self._count(known.samples)
            self.restraints = known.restraints
            best = self._improved(self._fitted(known.logarithms, start))
        best = self._smoothest(best)
        self._use(best.logarithms)
        cost = self.objective.cost(best.fit.values)
        fit = replace(best.fit, cost=cost, iterations=self.iterations, evaluations=self.evaluations)
        blocks = self.held.count if self.held else 0
        return SmoothnessChoice(
            self._factors(best.logarithms), best.logarithms, fit, self.samples, blocks, self.restraints
        )

    def _count(self, samples: float) -> None:
        """Take so many samples as independent; where these are few, blocks are held back."""
        if scored(self.compiled) >= RESEMBLING * samples:
            self.held = HoldoutBlocks.of(self.compiled)
        self.samples = samples

    def _anew(self, start: Float) -> Round:
        """The better of two: from factors that weigh as much as the data, and from the best of a path."""
        reference = self._reference(start)
        if self.independent is not None:
            # errors of a stiff fit resemble each other because it is stiff
            self._count(self.independent(self._fitted(reference + LIGHT * np.log(10), start).fit.values))
        first = self._fitted(reference, start)
        if first.cut_short:
            return first
        self.restraints = self._restraints(first)
        best = self._improved(self._fitted(reference, first.fit.values))
        if best.cut_short:
            return best
        other = self._path(reference, start)
        if other.value < best.value and not other.cut_short:
            other = self._improved(other)
        return other if other.value < best.value or other.stopped else best

    def _reference(self, start: Float) -> Float:
        """The logarithms of the factors that weigh as much as the data.

        A table may matter only once others have moved, as a time constant does behind a map of zeros: what data do not
        reach at the start is looked at again after a fit of the others.
        """
        scales = self._scales(self._data(start)[1])
        found = np.log(scales, out=np.full(scales.size, NONE), where=scales > 0)
        if (scales > 0).all() or not (scales > 0).any():
            return found
        again = self._scales(self._data(self._fitted(found, start).fit.values)[1])
        return np.log(again, out=found, where=(scales <= 0) & (again > 0))

    def _path(self, reference: Float, start: Float) -> Round:
        """The best of fits with ever smaller factors, in the same proportion to the data, each from the one before.

        Large factors leave few ways to bend, so a chain of tables does not begin in one of the many that fit noise.
        """
        best = None
        for decade in PATH:
            found = self._fitted(reference + decade * np.log(10), start)
            start = found.fit.values
            if best is None or found.value < best.value or found.stopped:
                best = found
            if found.cut_short:
                break
        assert best is not None
        return best

    def _improved(self, best: Round) -> Round:
        """Better and better factors, from those of a fit, until no more is to be gained."""
        radius, last = np.inf, self.rounds + ROUNDS
        while np.isfinite(best.value) and self.rounds < last and radius > NEAR:
            proposal, gain = best.proposed(radius)
            if gain < SETTLED:
                break
            there = self._fitted(proposal, best.fit.values)
            if there.cut_short:
                return there if there.stopped else best
            moved = np.abs(proposal[best.live] - best.logarithms[best.live]).max()
            ratio = (best.value - there.value) / gain
            radius = moved / 2 if ratio < POOR else max(radius, 2 * moved) if ratio > GOOD else radius
            best = there if ratio > 0 else best
        return best

    def _restraints(self, fit: Round) -> dict[str, Restraint]:
        """The restraints of all tables with an automatic factor, by what their values are and matter in a fit."""
        values = fit.fit.values
        matters, offsets = np.diag(self._data(values)[1]), self.compiled.values.offsets
        variance = self.compiled.accumulator.cost(self._full(values)) / self.samples
        restraints = {}
        for name in self.problem.automatic_names:
            table = self.compiled.problem.parameters[name]
            part = slice(offsets[name], offsets[name] + table.size)
            restraints[name] = Restraint.of(table, values[part], matters[part], variance)
        return restraints

    def _smoothest(self, best: Round) -> Round:
        """The smoothest fit whose error is within one standard error of the best.

        The mean square of n normal errors has the relative standard error sqrt(2/n), and sqrt((tau + 1/tau)/n) where
        they decay exponentially with a correlation time of tau samples. Heavier tails do not count: the errors in them
        are about the same in all the fits that are compared.
        """
        count = scored(self.compiled)
        lasting = max(count / self.samples, 1.0)
        allowed = best.value + self.samples * np.log1p(((lasting + 1 / lasting) / count) ** 0.5)
        here, stride = best, STRIDE
        for _ in range(FURTHER):
            if not np.isfinite(here.value):
                break
            proposal, rise = here.raised(allowed, stride)
            if rise == 0:
                break
            there = self._fitted(proposal, here.fit.values)
            if there.cut_short:
                return there if there.stopped else here
            if there.value <= allowed:
                here = there
            else:
                stride = rise / 3
        return here

    def _fitted(self, logarithms: Float, start: Float) -> Round:
        """The fit with some factors, their criterion, and the problem linearised there."""
        self._use(logarithms)
        self.rounds += 1
        report = partial(self.report, f"smoothness {self.rounds}")
        fit = levenberg_marquardt(self.objective, start, self.limits, self.settings, report)
        self.iterations += fit.iterations
        self.evaluations += fit.evaluations
        gradient, matrix = self._data(fit.values)
        scales = self._scales(matrix)
        live = (scales > 0) & np.isfinite(logarithms)
        if not live.any() or fit.status in ("stopped", "failed"):
            return Round(logarithms, fit)
        prediction = self._prediction(fit.values, gradient, matrix, live)
        return Round(logarithms, fit, prediction.at(logarithms[live]).value, prediction, live, np.log(scales[live]))

    def _prediction(self, values: Float, gradient: Float, matrix: Float, live: Bool) -> Prediction:
        """The criterion in the problem linearised at these values; those that a bound holds stay."""
        total = gradient.copy()
        self.compiled.roughness.add(values, total, np.zeros_like(matrix))
        limits = self.limits
        held = ((values >= limits.upper) & (total < 0)) | ((values <= limits.lower) & (total > 0))
        misfit = self.compiled.accumulator.cost(self._full(values))
        pressing, parts = _pressing(limits, values), self.held.linearised(self._full(values)) if self.held else ()
        free, given = limits.movable & ~held, list(self.given)
        penalty, pull = self.compiled.roughness, {}
        if isinstance(penalty, Restrained):
            given.append(penalty.steps)
            pull = {"pull": penalty.weights, "toward": penalty.toward}
        fit = Linearised(values, misfit, gradient, matrix, free, pressing, self.samples, tuple(parts), **pull)
        blocks = [block.unit for block, good in zip(self.sought, live, strict=True) if good]
        return Prediction(fit, blocks, given)

    def _data(self, values: Float) -> tuple[Float, Float]:
        """Half the gradient and the Gauss-Newton matrix of the data alone."""
        data = self.compiled.accumulator.normal(self._full(values))
        return data.gradient.copy(), data.matrix.copy()

    def _scales(self, matrix: Float) -> Float:
        return np.array([block.scale(matrix) for block in self.sought])

    def _full(self, values: Float) -> Float:
        full = self.compiled.start.copy()
        full[: values.size] = values
        return full

    def _factors(self, logarithms: Float) -> dict[str, tuple[float, ...]]:
        """The factors of the tables with an automatic one; 0 where an axis has too few breakpoints to be rough."""
        found = {name: list(self.problem.factors(name)) for name in self.problem.automatic_names}
        for block, logarithm in zip(self.sought, logarithms, strict=True):
            found[block.name][block.axis] = float(np.exp(logarithm))
        return {name: tuple(factors) for name, factors in found.items()}

    def _use(self, logarithms: Float) -> None:
        factors = {name: self.problem.factors(name) for name in self.problem.free_names} | self._factors(logarithms)
        self.compiled.roughness = penalty_of(self.problem.parameters, self.compiled.values, factors, self.restraints)


def _blocks(compiled: CompiledProblem) -> Iterator[_Block]:
    """Every axis that has a roughness, with a factor above 0 or an automatic one."""
    problem = compiled.problem
    for name in problem.free_names:
        factors = problem.factors(name)
        for axis, (automatic, factor) in enumerate(zip(problem.automatic(name), factors, strict=True)):
            unit = [float(other == axis) for other in range(len(factors))]
            roughness = Roughness.of(problem.parameters, compiled.values, {name: unit})
            if len(roughness.columns) and (automatic or factor > 0):
                yield _Block(name, axis, roughness, None if automatic else factor)


def _pressing(limits: LinearLimits, values: Float) -> Float:
    """The linear rows that hold the values where they are, in full."""
    rows = limits.rows
    if not rows.count:
        return np.zeros((0, values.size))
    here, size = rows.times(values), ACTIVE * rows.size(values)
    return rows.matrix(np.flatnonzero((here <= rows.lower + size) | (here >= rows.upper - size)), values.size)


def scored(compiled: CompiledProblem) -> float:
    """How many samples count, over all criteria."""
    samples = compiled.samples
    return float(sum(samples.scored(piece) @ (piece.scores > 0) for piece in samples.pieces))
