"""A search without gradients within limits of outputs: what keeps them comes first, whatever it costs.

Of two points that keep the limits the cheaper is better, of two that do not the one that exceeds them less, and what
keeps them is better than what does not (K. Deb, An efficient constraint handling method for genetic algorithms, 2000).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.limits.limits import Limits
from kennfeld.optimize.limits.multipliers import descend_within
from kennfeld.optimize.limits.output_limits import FEASIBLE, OutputLimits
from kennfeld.optimize.objective import SumOfSquares
from kennfeld.optimize.search.global_search import GlobalSettings, Report, global_search
from kennfeld.optimize.solver.gauss_newton import Descent, Iteration, Settings
from kennfeld.parameters import ParameterSet

__all__ = ["FeasibleFirst"]

ABOVE = 1e200  # any cost


class FeasibleFirst:
    """The cost of a problem with limits of outputs, for a search that compares costs."""

    def __init__(
        self, objective: SumOfSquares, outputs: OutputLimits, parameters_of: Callable[[Float], ParameterSet]
    ) -> None:
        self._objective, self._outputs, self._parameters_of = objective, outputs, parameters_of

    def cost(self, values: Float) -> float:
        """The cost where the limits hold, else a number above any cost that grows with what exceeds them."""
        cost = self._objective.cost(values)
        if not np.isfinite(cost):
            return cost
        excess = self._outputs.excess(self._parameters_of(values))
        return cost if self._outputs.largest(excess) <= FEASIBLE else ABOVE * sum(self._outputs.squares(excess))

    def search(self, start: Float, limits: Limits, settings: GlobalSettings, report: Report) -> Descent:
        """The lowest cost that keeps the limits; where nothing does, what exceeds them least."""

        def told(line: Iteration, values: Float) -> None:
            report(replace(line, cost=self._objective.cost(values)), values)

        found = global_search(self, start, limits, settings, told)
        return replace(found, cost=self._objective.cost(found.values)) if found.cost >= ABOVE else found

    def polished(
        self, found: Descent, limits: Limits, settings: Settings, report: Callable[[str, Iteration, Float], None]
    ) -> Descent:
        """The better of the end of a search and a descent from there, both within the limits of outputs."""
        if found.status in ("stopped", "failed") or not self._outputs.kept(self._parameters_of(found.values)):
            return found
        end = descend_within(
            self._outputs, self._objective, found.values, limits, settings, self._parameters_of, report
        )
        effort = {name: getattr(found, name) + getattr(end, name) for name in ("iterations", "evaluations")}
        lower = end.cost < found.cost and self._outputs.kept(self._parameters_of(end.values))
        best = replace(found, values=end.values, cost=end.cost) if lower else found
        if end.status == "stopped":
            best = replace(best, status=end.status, message=end.message)
        return replace(best, **effort)
