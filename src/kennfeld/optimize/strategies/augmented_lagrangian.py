"""Output limits by the method of multipliers.

Minimise f(p) + w sum (c(p) + m)+^2 over the excess c of each limit, scaled; then update m = (c + m)+, and increase the
weight w if the excess falls too slowly. M. Hestenes: Multiplier and gradient methods, 1969; J. Nocedal, S. Wright:
Numerical Optimization, chapter 17.
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

GAP_TOLERANCE = 1e-6  # share of the cost that a better choice of multipliers might still save
MAX_ROUNDS = 40  # updates of the multipliers
SLOW_RATIO = 0.25  # of the excess before a round: what is left above it makes the penalty grow
PENALTY_GROWTH = 10.0
MAX_PENALTY = 1e12  # times the first penalty: beyond, the limits cannot be satisfied

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
    """Minimise the cost within output limits.

    Args:
        outputs: the limits of outputs.
        objective: the cost without them.
        start: free values, Float[values].
        limits: bounds and linear rows.
        settings: of each descent.
        parameters_of: the parameter set of free values.
        report: called with the stage after each accepted step.

    Returns:
        The best values; status `infeasible` if none were found that keep the output limits.
    """
    outputs.reset()
    return AugmentedLagrangian(outputs, objective, limits, settings, parameters_of, report).run(start)


class AugmentedLagrangian:
    """The outer iteration over multipliers and penalty."""

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
        self.results: list[SolverResult] = []

    def run(self, start: Float) -> SolverResult:
        values = start
        excess = self.limits.excess(self.parameters_of(values))
        penalty = first_penalty = self._first_penalty(values, excess)
        penalised = self.limits.penalised(penalty)
        previous_violation = self.limits.largest(excess)
        for number in range(1, MAX_ROUNDS + 1):
            result = levenberg_marquardt(penalised, values, self.linear, self.settings, self._reporter(number))
            self.results.append(result)
            values = result.values
            excess = self.limits.excess(self.parameters_of(values))
            violation = self.limits.largest(excess)
            if result.status in ("stopped", "failed"):
                return self._end(result)
            slow = violation > FEASIBLE and violation > SLOW_RATIO * max(previous_violation, 0.0)
            complementarity_gap = penalty * self.limits.update_multipliers(excess, PENALTY_GROWTH if slow else 1.0)
            if violation <= FEASIBLE and complementarity_gap <= GAP_TOLERANCE * self.objective.cost(values):
                return self._end(result)
            if slow:
                penalty *= PENALTY_GROWTH
                if penalty > MAX_PENALTY * first_penalty:
                    break
                penalised = self.limits.penalised(penalty)
            previous_violation = violation
        return self._end_if_satisfied(result)

    def _first_penalty(self, values: Float, excess: Sequence[Float]) -> float:
        """Return the weight at which cost and excess are equal."""
        total = sum(self.limits.squares(excess))
        cost = self.objective.cost(values)
        return max(cost, 1e-300) / total if total > 0 and np.isfinite(cost) else max(cost, 1.0)

    def _reporter(self, number: int) -> Callable[[Iteration, Float], None]:
        def report(line: Iteration, values: Float) -> None:
            self.report(f"limits {number}", replace(line, cost=self.objective.cost(values)), values)

        return report

    def _end(self, result: SolverResult) -> SolverResult:
        return replace(result, cost=self.objective.cost(result.values)).with_effort_of(self.results)

    def _end_if_satisfied(self, result: SolverResult) -> SolverResult:
        parameters = self.parameters_of(result.values)
        if self.limits.is_satisfied(parameters):
            return self._end(result)
        message = f"The output limits cannot all be satisfied: {self.limits.describe_violations(parameters)}."
        return replace(self._end(result), status="infeasible", message=message)
