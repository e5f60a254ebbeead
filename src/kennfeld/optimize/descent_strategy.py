"""The order in which searches are tried for one start: smoothed, direct, global, and with free breakpoints.

Chains of piecewise-linear lookups have kinks at which a descent stops early, so descents on smoothed lookups compete
with a direct one. A short smoothing schedule is always tried; a long one only if both ends differ.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.options import Options
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.breakpoint_placement import BreakpointPlacement, ProblemReport, coarsen
from kennfeld.optimize.strategies.output_limits import AugmentedLagrangian, OutputLimits
from kennfeld.optimize.strategies.smoothing_continuation import LONG_SCHEDULE, SHORT_SCHEDULE, Continuation

EARLY_STOP_TOLERANCE = 1e-5  # relative change of the cost that ends a descent if another one may end lower
KINK_COST_DIFFERENCE = 3e-3  # relative difference of two ends from which kinks matter


@dataclass(frozen=True)
class DescentSetup:
    """A compiled problem and the options of its search."""

    exact: CompiledProblem
    objective: LeastSquaresObjective  # of `exact`
    continuation: Continuation | None  # None if no lookup is smoothed
    outputs: OutputLimits | None  # None if no output is limited
    options: Options
    report: ProblemReport


def minimise(setup: DescentSetup, start: Float, limits: LinearLimits) -> SolverResult:
    """Return the end of the lowest cost, with the effort of all searches; output limits apply to a global search only.

    Args:
        setup: the compiled problem.
        start: free values that keep `limits`, Float[values].
        limits: bounds and linear rows of the free values.
    """
    options, continuation = setup.options, setup.continuation
    if options.method == "global":
        return _search_globally(setup, start, limits)
    moving_axes = bool(setup.exact.problem.free_axes)
    settings = coarsen(options.settings) if moving_axes else options.settings
    ends: list[SolverResult] = []
    if continuation is not None:
        ends.append(continuation.descend(SHORT_SCHEDULE, start, limits, settings, setup.report))
    if not ends or ends[-1].status != "stopped":
        ends += _descend_directly(setup, start, limits, settings, ends)
    if continuation is not None and _costs_differ(ends):
        ends.append(continuation.descend(LONG_SCHEDULE, start, limits, settings, setup.report))
    if moving_axes and not ends[-1].cut_short:
        placement = BreakpointPlacement(setup.exact, smoothed=options.continuation != "off")
        ends.append(placement.descend(_best_of(ends).values, limits, options.settings, setup.report))
    return _best_of(ends)


def enforce_output_limits(setup: DescentSetup, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
    """Continue from the end of a search, or else from the start, until the output limits hold.

    The status is `infeasible` if no values are found that keep them.
    """
    outputs = setup.outputs
    if outputs is None or end.cut_short or outputs.is_satisfied(end.values):
        return end
    ends = [end]
    for values in (end.values, start):
        search = AugmentedLagrangian(outputs, setup.objective, limits, setup.options.settings, setup.report)
        ends.append(search.descend(values))
        if ends[-1].status != "infeasible":
            return ends[-1].with_effort_of(ends)
    return ends[1].with_effort_of(ends)


def _descend_directly(
    setup: DescentSetup, start: Float, limits: LinearLimits, settings: SolverSettings, earlier: Sequence[SolverResult]
) -> list[SolverResult]:
    """Descend on the exact model; after a smoothed descent, to the very end only if this one comes lower."""
    report = partial(setup.report, "plain")
    if not earlier:
        return [levenberg_marquardt(setup.objective, start, limits, settings, report)]
    early_stop = replace(settings, tolerance=max(settings.tolerance, EARLY_STOP_TOLERANCE), patience=2)
    ends = [levenberg_marquardt(setup.objective, start, limits, early_stop, report)]
    if ends[0].status == "converged" and not ends[0].cost > earlier[-1].cost:
        ends.append(levenberg_marquardt(setup.objective, ends[0].values, limits, settings, report))
    return ends


def _search_globally(setup: DescentSetup, start: Float, limits: LinearLimits) -> SolverResult:
    from kennfeld.optimize.strategies import global_search as strategy

    settings, report = setup.options.settings, setup.report
    search = strategy.GlobalSettings(setup.options.max_evaluations, setup.options.seed)
    if setup.outputs is not None:
        feasible_first = strategy.FeasibilityFirstCost(setup.objective, setup.outputs)
        result = feasible_first.search(start, limits, search, partial(report, "global"))
        return feasible_first.polish(result, limits, settings, report)
    result = strategy.global_search(setup.objective, start, limits, search, partial(report, "global"))
    return strategy.polish(setup.objective, result, limits, settings, partial(report, "polish"))


def _costs_differ(ends: Sequence[SolverResult]) -> bool:
    """Return if all descents ran to their end, and these differ by more than kinks of no consequence."""
    costs = [end.cost for end in ends if not end.cut_short]
    return len(costs) == len(ends) and max(costs) - min(costs) > KINK_COST_DIFFERENCE * min(costs)


def _best_of(ends: Sequence[SolverResult]) -> SolverResult:
    best = min(ends, key=lambda end: end.cost if np.isfinite(end.cost) else np.inf)
    if ends[-1].status == "stopped":
        best = replace(best, status=ends[-1].status, message=ends[-1].message)
    elif best.status == "failed":
        other = next((end for end in ends if end.status != "failed"), best)
        best = replace(best, status=other.status, message=other.message)
    return best.with_effort_of(ends)
