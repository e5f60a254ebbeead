"""The method of multipliers: descend, look how far limits of outputs are exceeded, press harder there.

M. Hestenes, Multiplier and gradient methods, 1969; J. Nocedal and S. Wright, Numerical Optimization, chapter 17.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.solver.levenberg_marquardt import Iteration, SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.output_limits import FEASIBLE, OutputLimits
from kennfeld.parameter_set import ParameterSet

__all__ = ["descend_within"]

TIGHT = 1e-6  # share of the cost that a better choice of multipliers might still save
ROUNDS = 40  # updates of the multipliers
STUBBORN = 0.25  # share of the excess that may be left after a round before the weight grows
HEAVIER = 10.0
HEAVIEST = 1e12  # times the first weight: beyond, the limits cannot be met

Report = Callable[[str, Iteration, Float], None]


def descend_within(
    outputs: OutputLimits,
    objective: LeastSquaresObjective,
    start: Float,
    limits: LinearLimits,
    settings: SolverSettings,
    parameters_of: Callable[[Float], ParameterSet],
    report: Report,
) -> SolverResult:
    """The best values that keep the limits of outputs, from `start`; `objective` is the cost without them.

    Status `infeasible` where no values were found that keep them.
    """
    outputs.reset()
    return AugmentedLagrangian(outputs, objective, limits, settings, parameters_of, report).run(start)


class AugmentedLagrangian:
    """The outer iteration: descend, look how far the limits are exceeded, press harder there."""

    def __init__(
        self,
        limits: OutputLimits,
        objective: LeastSquaresObjective,
        linear: LinearLimits,
        settings: SolverSettings,
        parameters_of: Callable[[Float], ParameterSet],
        report: Report,
    ) -> None:
        self.limits, self.objective, self.linear, self.settings = limits, objective, linear, settings
        self.parameters_of, self.report = parameters_of, report
        self.iterations = self.evaluations = 0

    def run(self, start: Float) -> SolverResult:
        at = start
        excess = self.limits.excess(self.parameters_of(at))
        weight = first = self._weight(at, excess)
        penalised = self.limits.penalised(weight)
        before = self.limits.largest(excess)
        for number in range(1, ROUNDS + 1):
            found = levenberg_marquardt(penalised, at, self.linear, self.settings, self._told(number))
            self.iterations += found.iterations
            self.evaluations += found.evaluations
            at = found.values
            excess = self.limits.excess(self.parameters_of(at))
            worst = self.limits.largest(excess)
            if found.status in ("stopped", "failed"):
                return self._end(found, at)
            slow = worst > FEASIBLE and worst > STUBBORN * max(before, 0.0)
            heavier = HEAVIER if slow else 1.0
            gap = weight * self.limits.press(excess, heavier)
            if worst <= FEASIBLE and gap <= TIGHT * self.objective.cost(at):
                return self._end(found, at)
            if slow:
                weight *= HEAVIER
                if weight > HEAVIEST * first:
                    break
                penalised = self.limits.penalised(weight)
            before = worst
        return self._infeasible(at, found)

    def _weight(self, at: Float, excess: Sequence[Float]) -> float:
        """A first weight at which the cost and the excess pull alike."""
        total = sum(self.limits.squares(excess))
        cost = self.objective.cost(at)
        return max(cost, 1e-300) / total if total > 0 and np.isfinite(cost) else max(cost, 1.0)

    def _told(self, number: int) -> Callable[[Iteration, Float], None]:
        def tell(line: Iteration, values: Float) -> None:
            self.report(f"limits {number}", replace(line, cost=self.objective.cost(values)), values)

        return tell

    def _end(self, found: SolverResult, at: Float) -> SolverResult:
        cost = self.objective.cost(at)
        return replace(found, values=at, cost=cost, iterations=self.iterations, evaluations=self.evaluations)

    def _infeasible(self, at: Float, found: SolverResult) -> SolverResult:
        if self.limits.kept(self.parameters_of(at)):
            return self._end(found, at)
        message = f"The limits of outputs cannot all be kept: {self.limits.told(self.parameters_of(at))}."
        return replace(self._end(found, at), status="infeasible", message=message)
