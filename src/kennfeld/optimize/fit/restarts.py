"""Searches that go on where a descent is stuck: at a saddle, in saturation, at infinity, on a ridge or at a kink."""

from dataclasses import replace
from functools import partial

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.ends.kinks import values_at_kinks
from kennfeld.optimize.ends.ridges import lower_values
from kennfeld.optimize.ends.runaways import run_away
from kennfeld.optimize.ends.zero_slopes import Departure, departure
from kennfeld.optimize.fit.descent_strategy import DescentSetup, minimise
from kennfeld.optimize.limits.projection import FEASIBLE
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, is_rounding, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits

UNCHANGED = 1e-9  # relative change of the cost by values whose effect is rounding
KINK = 1e-4  # share of the cost that is promised at kinks
MAX_DEPARTURES = 3  # searches that may start again from a point at which values cannot move


def descend(setup: DescentSetup, start: Float, limits: LinearLimits, *, remembers_scale: bool = False) -> SolverResult:
    """Descend from values, Float[values], on the model as it is; see `SolverSettings.remembers_scale`."""
    settings = replace(setup.settings, remembers_scale=remembers_scale)
    return levenberg_marquardt(setup.objective, start, limits, settings, partial(setup.report, "plain"))


def is_lower(later: SolverResult, end: SolverResult) -> bool:
    """Return if a later search ended lower than another one by more than rounding."""
    return later.cost < (1 - UNCHANGED) * end.cost


@dataclass(frozen=True, eq=False)
class Restarts:
    """The searches from one start within limits, each of which takes the end of the one before.

    Args:
        setup: the compiled problem and the options of its search.
        start: where the first search began, Float[values].
        limits: bounds and linear rows of the values.
    """

    setup: DescentSetup
    start: Float
    limits: LinearLimits

    def search(self, values: Float) -> SolverResult:
        """Search for the lowest cost from values, Float[values], also beyond points at which a descent is stuck."""
        end = self._leave_saddles(minimise(self.setup, values, self.limits))
        end = self._return_from_infinity(self._leave_saturation(end))
        return self._leave_kinks(self._leave_ridges(end))

    def _descend(self, values: Float, limits: LinearLimits | None = None) -> SolverResult:
        return descend(self.setup, values, limits or self.limits)

    def _leaves_errors(self, end: SolverResult) -> bool:
        """Return if a descent has converged with errors that another one may lower; rounding it would only shuffle."""
        return (
            end.status == "converged" and not self.setup.is_global and not is_rounding(self.setup.objective, end.cost)
        )

    def _departure(self, end: SolverResult) -> Departure | None:
        return departure(self.setup.objective, self.setup.exact, end.values, self.limits)

    def _leave_saddles(self, end: SolverResult) -> SolverResult:
        """Search again from points at which values cannot move; failed if all searches lead to such points."""
        ends = [end]
        for _ in range(MAX_DEPARTURES):
            if not self._leaves_errors(end):
                break
            off = self._departure(end)
            if off is None:
                break
            ends.append(minimise(self.setup, off.values, self.limits))
            if not is_lower(ends[-1], end):
                break
            end = ends[-1]
        else:
            # the last restart may have ended at a point that is not stuck
            if end.status == "converged" and (off := self._departure(end)) is not None:
                message = (
                    f"The derivatives with respect to {' and '.join(off.stuck)} vanish again after each restart. "
                    "Set another start, or bounds without 0."
                )
                end = replace(end, status="failed", message=message)
        return end.with_effort_of(ends)

    def _leave_saturation(self, end: SolverResult) -> SolverResult:
        """Search again if parameters ran to where they have all but lost their effect.

        A long step may lead an exponent or a rate there while the other values are far from their optimum. The first
        search goes on with these parameters at their start, the second one begins at the start with shorter steps for
        values whose effect shrinks.
        """
        ends = [end]
        if not self._leaves_errors(end):
            return end
        for remembers in (False, True):
            values = self.setup.objective.with_effect(end.values, self.start)
            if np.array_equal(values, end.values):
                break
            values = self.start if remembers else values
            # single values at their start may break a linear row that the others of it have moved along
            if self.limits.violation(values) > max(self.limits.violation(end.values), FEASIBLE):
                continue
            ends.append(descend(self.setup, values, self.limits, remembers_scale=remembers))
            if is_lower(ends[-1], end):
                end = ends[-1]
        return end.with_effort_of(ends)

    def _return_from_infinity(self, end: SolverResult) -> SolverResult:
        """Search again if parameters ran towards infinity: from the best values with one of them at its start."""
        ends = [end]
        if not self._leaves_errors(end):
            return end
        for away in run_away(self.setup.exact, self.setup.objective, self.start, end.values)[:MAX_DEPARTURES]:
            lower, upper = (np.where(away, self.start, side) for side in (self.limits.lower, self.limits.upper))
            # first with the value fixed, by equal bounds, so that the others find their optimum; then all are free
            # again
            ends.append(self._descend(self.start, replace(self.limits, lower=lower, upper=upper)))
            ends.append(self._descend(ends[-1].values))
            if is_lower(ends[-1], end):
                end = ends[-1]
                break
        return end.with_effort_of(ends)

    def _leave_ridges(self, end: SolverResult) -> SolverResult:
        """Search again from lower values along combinations that change nothing to first order."""
        ends = [end]
        for _ in range(MAX_DEPARTURES):
            # ridges are the null space of the Jacobian, which only small problems have at hand
            if not self._leaves_errors(end) or not self.setup.objective.uses_qr:
                break
            lower = lower_values(self.setup.objective, end.values, end.cost, self.limits)
            if lower is None:
                break
            ends.append(self._descend(lower))
            if not is_lower(ends[-1], end):
                break
            end = ends[-1]
        return end.with_effort_of(ends)

    def _leave_kinks(self, end: SolverResult) -> SolverResult:
        """Search again with the values held that are at a kink, then with all of them, as long as that lowers the cost.

        Once the others have moved, the cost may fall to one side: away from the edge of what a root is defined for.
        """
        ends = [end]
        for _ in range(MAX_DEPARTURES):
            beside, descents = self._descend_beside_kinks(end)
            ends += descents
            if beside is end:
                break
            ends.append(self._descend(beside.values))
            if not is_lower(ends[-1], beside):
                end = beside
                break
            end = ends[-1]
        return end.with_effort_of(ends)

    def _descend_beside_kinks(self, end: SolverResult) -> tuple[SolverResult, list[SolverResult]]:
        """Return the end of descents that hold the values at a kink, while they lower the cost, and all of them."""
        ends, fixed = [], np.zeros(self.start.size, dtype=bool)
        # kinks are looked for in the rows of the Jacobian, which only small problems have at hand
        small = self.setup.objective.uses_qr and not self.setup.is_global
        while small and end.certificate is not None and end.certificate.predicted_decrease > KINK:
            # once others have moved, further values may lie at a kink
            more = values_at_kinks(self.setup.objective, end.values, self.start, self.limits) & ~fixed
            if not more.any():
                break
            fixed = fixed | more
            lower, upper = (np.where(fixed, end.values, side) for side in (self.limits.lower, self.limits.upper))
            ends.append(self._descend(end.values, replace(self.limits, lower=lower, upper=upper)))
            if not is_lower(ends[-1], end):
                break
            end = ends[-1]
        return end, ends
