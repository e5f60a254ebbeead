"""Values whose effect has become rounding at the end of a search, although they had moved on the way there."""

from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.fit.descent_strategy import DescentSetup
from kennfeld.optimize.fit.restarts import UNCHANGED, descend
from kennfeld.optimize.limits.projection import FEASIBLE
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult
from kennfeld.optimize.solver.linear_constraints import LinearLimits

ROUNDING = 1e-20  # as UNCHANGED, relative to the cost at the start, for a fit without residuals
NOISE = 1.5  # ratio of costs up to which the lower one may be due to noise


@dataclass(frozen=True, eq=False)
class FaintValues:
    """Resets faint values to their start; arguments as of `Restarts`."""

    setup: DescentSetup
    start: Float
    limits: LinearLimits

    def restored(self, end: SolverResult) -> SolverResult:
        """Reset values to their start if their effect at the end is mere rounding.

        They may have moved while it was larger: an initial state while a time constant was longer.
        """
        if not np.isfinite(end.cost):
            return end
        faint = self.setup.objective.faint(end.values) & (end.values != self.start)
        if not faint.any():
            return end
        values = self._reset_within_outputs(faint, end)
        cost = self.setup.objective.cost(values)
        # of an exact fit the cost is rounding itself, which any reset would exceed relatively
        rounding = UNCHANGED * end.cost + ROUNDING * self.setup.objective.cost(self.start)
        # the end may miss a limit by rounding; the reset must not make that worse
        allowed = max(self.limits.violation(end.values), FEASIBLE)
        if cost <= end.cost + rounding and self.limits.violation(values) <= allowed:
            effective = self.setup.objective.with_effect(end.values, self.start)
            # values that have an effect at their start were led away from it; others had none in the first place
            lost = faint & ~self.setup.objective.faint(values) & (effective == self.start)
            return self._with_lost_values(end.moved(values, cost), lost)
        sloped = self.setup.objective.sloped(end.values)  # smoothness may determine the others
        faint = faint & sloped if sloped is not None else np.zeros_like(faint)
        values = np.where(faint, self.start, end.values)
        if end.status != "converged" or not faint.any() or not self.limits.violation(values) <= allowed:
            return end
        return self._descend_without(faint, end, values)

    def _reset_within_outputs(self, faint: Bool, end: SolverResult) -> Float:
        """Return the end with faint values at their start, unless limits of outputs keep a parameter from there."""
        values, outputs = np.where(faint, self.start, end.values), self.setup.outputs
        if outputs is None or outputs.is_satisfied(values) or not outputs.is_satisfied(end.values):
            return values
        values = end.values
        # all resets together violate a limit, which some of them alone may keep
        for name in self.setup.exact.problem.free_names:
            own = np.zeros_like(faint)
            self._columns(own, name)[:] = True
            reset = np.where(faint & own, self.start, values)
            if outputs.is_satisfied(reset):
                values = reset
        return values

    def _with_lost_values(self, end: SolverResult, lost: Bool) -> SolverResult:
        """Mark an end as failed if values with an effect at their start have lost it, and were set back for that."""
        if end.status != "converged" or not lost.any():
            return end
        names = [name for name in self.setup.exact.problem.free_names if self._columns(lost, name).any()]
        message = (
            f"The search leads {' and '.join(names)} to where {'they have' if len(names) > 1 else 'it has'} no effect. "
            "Set bounds, or another start."
        )
        return replace(end, status="failed", message=message)

    def _columns(self, each: Bool, name: str) -> Bool:
        first = self.setup.exact.values.offsets[name]
        return each[first : first + self.setup.exact.problem.parameters[name].size]

    def _descend_without(self, faint: Bool, end: SolverResult, values: Float) -> SolverResult:
        """Descend from `values`; return the old end if the faint values matter after all.

        A faint value that had moved far follows the noise of some samples, which costs a little to undo.
        """
        again = descend(self.setup, values, self.limits)
        unmoved = np.array_equal(again.values[faint], values[faint])
        if self.setup.outputs is not None and not self.setup.outputs.is_satisfied(again.values):
            return end
        return again.with_effort_of([end, again]) if unmoved and again.cost <= NOISE * end.cost else end
