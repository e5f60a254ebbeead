"""Output limits at every sample of the training data, by the method of multipliers.

Minimise f(p) + w sum (c(p) + m)+^2 over the excess c of each limit, scaled; then update m = (c + m)+, and increase the
weight w if the excess falls too slowly. M. Hestenes: Multiplier and gradient methods, 1969; J. Nocedal, S. Wright:
Numerical Optimization, chapter 17.

Each side of a limit is a criterion whose loss is the squared excess. Its target is lowered, sample by sample, by the
multiplier over twice the penalty. No rows are stored, so a limit costs as much as a criterion, over any number of
samples and with states, in one piece or in partitions.
"""

from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from functools import partial

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Findings
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.validation import check_limits
from kennfeld.optimize.solver.levenberg_marquardt import (
    Iteration,
    SolverResult,
    SolverSettings,
    StageReport,
    levenberg_marquardt,
)
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.limit_excess import (
    FEASIBLE,
    LimitRound,
    NearActiveSamples,
    Update,
    Violation,
    Worst,
    find_near_active,
    find_worst,
    lowered_samples,
    measure_violation,
    update_multipliers,
)
from kennfeld.optimize.strategies.limited_problem import LimitedProblem
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

GAP_TOLERANCE = 1e-6  # share of the cost that a better choice of multipliers might still save
MAX_ROUNDS = 40  # updates of the multipliers
SLOW_RATIO = 0.25  # of the excess before a round: what is left above it makes the penalty grow
PENALTY_GROWTH = 10.0
MAX_PENALTY = 1e12  # times the first penalty: beyond, the limits cannot be satisfied


@dataclass
class AugmentedLagrangian:
    """The outer iteration over multipliers and penalty.

    Args:
        outputs: the limits of outputs.
        objective: the cost without them.
        limits: bounds and linear rows.
        settings: of each descent.
        report: called with the stage after each accepted step.
    """

    outputs: "OutputLimits"
    objective: LeastSquaresObjective
    limits: LinearLimits
    settings: SolverSettings
    report: StageReport
    results: list[SolverResult] = field(default_factory=list, init=False)

    def descend(self, start: Float) -> SolverResult:
        """Minimise from a start, Float[values]; status `infeasible` if no values keep the output limits at the end."""
        before = self.outputs.measure(start)
        penalty = first_penalty = self._first_penalty(start, before)
        rounds: tuple[LimitRound, ...] = ()
        values, previous_violation = start, before.largest
        for number in range(1, MAX_ROUNDS + 1):
            report = partial(self._report, f"limits {number}")
            penalised = self.outputs.penalise(penalty, rounds)
            result = levenberg_marquardt(penalised, values, self.limits, self.settings, report)
            self.results.append(result)
            values = result.values
            if result.cut_short:
                return self._end(result)
            violation, gap = self.outputs.update(rounds, values)
            # kept, and the multipliers are those of a minimum: no limit that is slack is still pushed
            if violation <= FEASIBLE and penalty * gap <= GAP_TOLERANCE * self.objective.cost(values):
                return self._end(result)
            # otherwise the multipliers alone converge, and a larger penalty would only make the cost stiffer
            slow = violation > FEASIBLE and violation > SLOW_RATIO * max(previous_violation, 0.0)
            growth = PENALTY_GROWTH if slow else 1.0
            penalty *= growth
            if penalty > MAX_PENALTY * first_penalty:
                break
            rounds = (*rounds, LimitRound(self.outputs.full(values), growth))
            previous_violation = violation
        if self.outputs.is_satisfied(values):
            return self._end(result)
        message = f"The output limits cannot all be satisfied: {self.outputs.describe_violations(values)}."
        return replace(self._end(result), status="infeasible", message=message)

    def _first_penalty(self, values: Float, before: Violation) -> float:
        """Return the weight at which cost and excess are equal."""
        total, cost = before.squares, self.objective.cost(values)
        return max(cost, 1e-300) / total if total > 0 and np.isfinite(cost) else max(cost, 1.0)

    def _report(self, stage: str, line: Iteration, values: Float) -> None:
        self.report(stage, replace(line, cost=self.objective.cost(values)), values)

    def _end(self, result: SolverResult) -> SolverResult:
        return replace(result, cost=self.objective.cost(result.values)).with_effort_of(self.results)


class OutputLimits:
    """The output limits of a problem: their violation, and the penalised cost for a descent.

    `sides` are those with a finite bound. Methods take the free values, Float[values].
    """

    def __init__(self, problem: Problem) -> None:
        Findings(check_limits(problem)).finish()
        limited = LimitedProblem.of(problem)
        self.sides, self._first_side = limited.sides, limited.first_side
        self._names = [data.name for data in limited.fitted_datasets]
        self._penalised = CompiledProblem(limited)

    def full(self, values: Float) -> Float:
        """Return the free values, followed by the fixed ones."""
        return self._penalised.full(values)

    def measure(self, values: Float) -> Violation:
        """Return how far the limits are exceeded."""
        parts = [*self._penalised.each(measure_violation, self.full(values))]
        return Violation(max(part.largest for part in parts), sum(part.squares for part in parts))

    def is_satisfied(self, values: Float) -> bool:
        """Return True if no limit is exceeded."""
        return self.measure(values).largest <= FEASIBLE

    def describe_violations(self, values: Float) -> str:
        """Return a clause for each limit that is exceeded, with the number of samples and the worst one."""
        clauses = []
        for side, worst in zip(self.sides, self._worst(values), strict=True):
            if worst.samples:
                place = f"sample {worst.sample + 1} of {self._names[worst.data]}"
                clauses.append(f"{side} is exceeded at {worst.samples} samples, most by {worst.excess:.4g} at {place}")
        return "; ".join(clauses)

    def _worst(self, values: Float) -> list[Worst]:
        total = [Worst() for _ in self.sides]
        for places, parts in zip(self._places(), self._penalised.each(find_worst, self.full(values)), strict=True):
            for i, part in enumerate(parts):
                count, worst = total[i].samples + part.samples, total[i]
                if part.excess > worst.excess:
                    # a part of a recording counts its samples from its own beginning
                    data, first = places[part.data]
                    worst = part._replace(data=data, sample=first + part.sample)
                total[i] = worst._replace(samples=count)
        return total

    def near_active(self, values: Float) -> NearActiveSamples | None:
        """Return the samples at which limits are active, at most the nearest `MAX_SAMPLES`; None if there are none."""
        total: NearActiveSamples | None = None
        for places, part in zip(self._places(), self._penalised.each(find_near_active, self.full(values)), strict=True):
            if part.side.size:
                data, first = np.array(places)[part.data].T
                placed = replace(part, data=data, sample=first + part.sample)
                total = placed if total is None else total.joined(placed)
        return total

    def _places(self) -> Iterator[list[tuple[int, int]]]:
        """Yield for each partition the number of the dataset of each part, and that of its first sample there."""
        partitions = self._penalised.problem.partitions
        if partitions is None:
            yield [(number, 0) for number in range(len(self._names))]
            return
        for places in partitions.places:
            yield [(self._names.index(name), first) for name, first in places]

    def penalise(self, weight: float, rounds: Sequence[LimitRound]) -> LeastSquaresObjective:
        """Return the cost plus `weight` times the squared violations relative to their scales.

        Bounds are lowered by the multipliers after these rounds.
        """
        factors = np.repeat([1.0, weight], [self._first_side, len(self.sides)])
        return LeastSquaresObjective(self._penalised.over_selection(lowered_samples, tuple(rounds), factors))

    def update(self, rounds: Sequence[LimitRound], values: Float) -> Update:
        """Update the multipliers after a further round that ended at these values."""
        parts = [*self._penalised.each(update_multipliers, tuple(rounds), self.full(values))]
        return Update(max(part.largest for part in parts), sum(part.gap for part in parts))
