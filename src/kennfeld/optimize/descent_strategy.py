"""The order in which searches are tried for one start: smoothed, direct, global, and with free breakpoints.

Chains of piecewise-linear lookups have kinks at which a descent stops early, so descents on smoothed lookups compete
with a direct one. A short smoothing schedule is always tried; a long one only if both ends differ.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.solver.levenberg_marquardt import Iteration, SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.augmented_lagrangian import descend_within
from kennfeld.optimize.strategies.breakpoint_placement import BreakpointPlacement, coarse
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.optimize.strategies.smoothing_continuation import LONG_SCHEDULE, SHORT_SCHEDULE, Continuation
from kennfeld.parameter_set import ParameterSet

EARLY_STOP_TOLERANCE = 1e-5  # relative change of the cost that ends a descent if another one may end lower
KINK_COST_DIFFERENCE = 3e-3  # relative difference of two ends from which kinks matter


class Report(Protocol):
    """Called after each accepted step; `compiled` is the problem that `values` belong to, if not the exact one."""

    def __call__(self, stage: str, line: Iteration, values: Float, compiled: CompiledProblem | None = None) -> None: ...


@dataclass(frozen=True)
class DescentSetup:
    """A compiled problem and the options of its search."""

    problem: Problem
    exact: CompiledProblem
    objective: LeastSquaresObjective  # of `exact`
    continuation: Continuation | None  # None if no lookup is smoothed
    outputs: OutputLimits | None  # None if no output is limited
    options: Options
    parameters_of: Callable[[Float], ParameterSet]
    report: Report


def minimise(setup: DescentSetup, start: Float, limits: LinearLimits) -> SolverResult:
    """Return the end of the lowest cost, with the effort of all searches; output limits apply to a global search only.

    Args:
        setup: the compiled problem.
        start: free values that keep `limits`, Float[values].
        limits: bounds and linear rows of the free values.
    """
    options, continuation = setup.options, setup.continuation
    if options.method == "global":
        return _global_then_local(setup, start, limits)
    settings = coarse(options.settings) if setup.problem.free_axes else options.settings
    ends: list[SolverResult] = []
    if continuation is not None:
        ends.append(continuation.descend(SHORT_SCHEDULE, start, limits, settings, setup.report))
    if not ends or ends[-1].status != "stopped":
        ends += _direct_descent(setup, start, limits, settings, ends)
    if continuation is not None and _costs_differ(ends):
        ends.append(continuation.descend(LONG_SCHEDULE, start, limits, settings, setup.report))
    if setup.problem.free_axes and ends[-1].status not in ("stopped", "failed"):
        placement = BreakpointPlacement(setup.problem, setup.exact, smoothed=options.continuation != "off")
        ends.append(placement.descend(_best_of(ends).values, limits, options.settings, setup.report))
    return _best_of(ends)


def enforce_output_limits(setup: DescentSetup, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
    """Continue from the end of a search, or else from the start, until the output limits hold.

    The status is `infeasible` if no values are found that keep them.
    """
    outputs = setup.outputs
    if outputs is None or end.status in ("stopped", "failed") or outputs.is_satisfied(setup.parameters_of(end.values)):
        return end
    ends = [end]
    for values in (end.values, start):
        ends.append(
            descend_within(
                outputs, setup.objective, values, limits, setup.options.settings, setup.parameters_of, setup.report
            )
        )
        if ends[-1].status != "infeasible":
            break
    best = ends[-1] if ends[-1].status != "infeasible" else ends[1]
    return best.with_effort_of(ends)


def _direct_descent(
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


def _global_then_local(setup: DescentSetup, start: Float, limits: LinearLimits) -> SolverResult:
    """Search without gradients, and descend from its end."""
    from kennfeld.optimize.strategies.global_search import (
        FeasibilityFirstCost,
        GlobalSettings,
        global_search,
        polish,
    )

    settings, report = setup.options.settings, setup.report
    search = GlobalSettings(setup.options.max_evaluations, setup.options.seed)
    if setup.outputs is not None:
        feasible_first = FeasibilityFirstCost(setup.objective, setup.outputs, setup.parameters_of)
        result = feasible_first.search(start, limits, search, partial(report, "global"))
        return feasible_first.polish(result, limits, settings, report)
    result = global_search(setup.objective, start, limits, search, partial(report, "global"))
    return polish(setup.objective, result, limits, settings, partial(report, "polish"))


def _costs_differ(ends: Sequence[SolverResult]) -> bool:
    """Return if all descents ran to their end, and these differ by more than kinks of no consequence."""
    if any(end.status in ("stopped", "failed") for end in ends):
        return False
    costs = [end.cost for end in ends]
    return max(costs) - min(costs) > KINK_COST_DIFFERENCE * min(costs)


def _best_of(ends: Sequence[SolverResult]) -> SolverResult:
    best = min(ends, key=lambda end: end.cost if np.isfinite(end.cost) else np.inf)
    if ends[-1].status == "stopped":
        best = replace(best, status=ends[-1].status, message=ends[-1].message)
    elif best.status == "failed":
        other = next((end for end in ends if end.status != "failed"), best)
        best = replace(best, status=other.status, message=other.message)
    return best.with_effort_of(ends)
