"""The order in which searches are tried for one start: smoothed, direct, global, and with free breakpoints.

Chains of piecewise-linear lookups have kinks at which a descent stops early, so descents on smoothed lookups compete
with a direct one. A short smoothing schedule is always tried; a long one only if both ends differ. Each of them ends
early, and uses a part of the samples if there are many; only the best is continued to its end, on all samples. A single
descent of a model with memory begins with such a part, too.
`python -m benchmarks continuation` compares these choices with others.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.breakpoint_placement import BreakpointPlacement, ProblemReport, coarsen
from kennfeld.optimize.strategies.output_limits import AugmentedLagrangian, OutputLimits
from kennfeld.optimize.strategies.smoothing_continuation import (
    LONG_SCHEDULE,
    SHORT_SCHEDULE,
    Continuation,
    SmoothingSchedule,
)
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective


@dataclass(frozen=True)
class SearchPlan:
    """The descents that are compared for one start if lookups can be smoothed.

    Over the 34 problems of `python -m benchmarks continuation`, no long schedule ends 30 % higher on average, no
    direct descent in addition 7 % more, and ends compared at 1e-4 take 5 % longer for the same costs.

    Args:
        short: the schedule that is tried first.
        long: tried if kinks matter, unless it is None; ends at a width at which `short` was at least as good.
        direct: whether a descent without smoothing is tried.
        again: the schedules with which the best end is smoothed and sharpened again: both of the first two, the others
            as long as that gains enough.
        tolerance: relative change of the cost that ends a descent while others may end lower.
        patience: number of such changes in a row.
        kink_difference: relative difference of two ends from which kinks matter.
        gain: relative decrease of the cost that is enough.
        doubtful_promise: share of the cost that the slopes may promise at an end that is only compared. A kink promises
            some thousandths, for which a descent would start again twice, and the best end is continued anyway.
        valley_difference: relative difference of two ends that lie in different valleys.
    """

    short: SmoothingSchedule = SHORT_SCHEDULE
    long: SmoothingSchedule | None = LONG_SCHEDULE
    direct: bool = True
    again: tuple[SmoothingSchedule, ...] = (SHORT_SCHEDULE, LONG_SCHEDULE, SHORT_SCHEDULE, SHORT_SCHEDULE)
    tolerance: float = 1e-3
    patience: int = 2
    kink_difference: float = 3e-3
    gain: float = 1e-3
    doubtful_promise: float = 0.1
    valley_difference: float = 2e-2

    def early(self, settings: SolverSettings) -> SolverSettings:
        """Return the settings of descents that are compared."""
        tolerance = max(settings.tolerance, self.tolerance)
        return replace(settings, tolerance=tolerance, patience=self.patience, doubtful_promise=self.doubtful_promise)


@dataclass(frozen=True)
class DescentSetup:
    """A compiled problem and the options of its search."""

    exact: CompiledProblem
    objective: LeastSquaresObjective  # of `exact`
    thinned: CompiledProblem  # over the part of the samples with which a single descent begins, or `exact`
    continuation: Continuation | None  # None if no lookup is smoothed
    outputs: OutputLimits | None  # None if no output is limited
    options: Options
    report: ProblemReport
    plan: SearchPlan = SearchPlan()
    significant: float = 0.0  # see `fit.significant_decrease`

    @property
    def settings(self) -> SolverSettings:
        """The settings of one descent."""
        return replace(self.options.settings, doubtful_promise=self.significant)

    @property
    def is_global(self) -> bool:
        """True for a search that does not begin at the start."""
        return self.options.method == "global"


def minimise(setup: DescentSetup, start: Float, limits: LinearLimits) -> SolverResult:
    """Return the end of the lowest cost, with the effort of all searches; output limits apply to a global search only.

    Args:
        setup: the compiled problem.
        start: free values that keep `limits`, Float[values].
        limits: bounds and linear rows of the free values.
    """
    options = setup.options
    if options.method == "global":
        return _search_globally(setup, start, limits)
    moving_axes = bool(setup.exact.problem.free_axes)
    settings = coarsen(setup.settings) if moving_axes else setup.settings
    if setup.continuation is None:
        ends = [_descend(setup, start, limits, settings)]
    else:
        ends = [_compare_descents(setup, setup.continuation, start, limits, settings)]
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
        # the start is tried only if the limits cannot be reached from the end of the search
        if ends[-1].status != "infeasible":
            return ends[-1].with_effort_of(ends)
    # of two infeasible ends, the one that began at the end of the search
    return ends[1].with_effort_of(ends)


def _descend(setup: DescentSetup, start: Float, limits: LinearLimits, settings: SolverSettings) -> SolverResult:
    """Descend on the model as it is, with many samples first on a part of them."""
    report = partial(setup.report, "plain")
    if setup.thinned is setup.exact:
        return levenberg_marquardt(setup.objective, start, limits, settings, report)
    part = LeastSquaresObjective(setup.thinned)
    end = levenberg_marquardt(part, start, limits, setup.plan.early(settings), report)
    return _continue_on_all_samples(setup, [end], start, limits, settings)


def _compare_descents(
    setup: DescentSetup, continuation: Continuation, start: Float, limits: LinearLimits, settings: SolverSettings
) -> SolverResult:
    """Descend on smoothed lookups and directly, and continue the better one to its end."""
    plan = setup.plan
    early = plan.early(settings)
    end, costs = continuation.descend(plan.short, start, limits, early, setup.report)
    ends = [end]
    if plan.direct and end.status != "stopped":
        ends.append(continuation.descend_directly(start, limits, early, setup.report))
    if plan.long is not None and _costs_differ(ends, plan.kink_difference):
        ends.append(continuation.descend(plan.long, start, limits, early, setup.report, costs)[0])
    end = _continue_on_all_samples(setup, ends, start, limits, settings)
    # at a smooth minimum the undamped step promises nothing; at a kink, the slopes of one side still promise a
    # decrease, of which another search among the same kinks finds about as much. It says nothing of other valleys.
    enough = 0.0 if _costs_differ(ends, plan.valley_difference) else setup.significant
    promise = np.inf if end.certificate is None else end.certificate.predicted_decrease
    done = promise <= max(settings.tolerance, enough) or end.cost == 0 or end.status != "converged"
    return end if done else _cross_kinks(setup, continuation, end, limits, settings)


def _cross_kinks(
    setup: DescentSetup, continuation: Continuation, end: SolverResult, limits: LinearLimits, settings: SolverSettings
) -> SolverResult:
    """Smooth and sharpen the model again from an end: its kinks may hold it above the floor of its valley.

    Goes on while that pays, for at most about as many steps as the search has taken until then.
    """
    plan, best, iterations = setup.plan, end, 0
    for number, schedule in enumerate(plan.again):
        near, _ = continuation.descend(schedule, best.values, limits, plan.early(settings), setup.report)
        before = best.cost
        # that of `near` may be the cost of a smoothed model, or of a part of the samples
        last, effort = near.moved(near.values, setup.objective.cost(near.values)), [near]
        if near.status != "stopped" and last.cost <= (1 + plan.kink_difference) * before:
            final = partial(setup.report, "final")
            last = levenberg_marquardt(setup.objective, near.values, limits, settings, final)
            effort.append(last)
        iterations += sum(each.iterations for each in effort)
        best = (last if last.cost < before else best).with_effort_of([best, *effort])
        if last.status == "stopped":
            return replace(best, status=last.status, message=last.message)
        gained = best.cost < (1 - plan.gain) * before
        # the second schedule is tried even if the first has gained nothing
        if last.status != "converged" or iterations >= end.iterations or (number > 0 and not gained):
            break
    return best


def _continue_on_all_samples(
    setup: DescentSetup, ends: Sequence[SolverResult], start: Float, limits: LinearLimits, settings: SolverSettings
) -> SolverResult:
    """Continue the best of several descents, or else the start, to its end."""
    best = _best_on_all_samples(setup, ends, start)
    if best.status == "stopped":
        return best.with_effort_of(ends)
    last = levenberg_marquardt(setup.objective, best.values, limits, settings, partial(setup.report, "final"))
    return last.with_effort_of([*ends, last])


def _best_on_all_samples(setup: DescentSetup, ends: Sequence[SolverResult], start: Float) -> SolverResult:
    """Return the last end with the values of the best one, or with the start if no end has a lower cost."""
    # costs of the ends are those of smoothed lookups or of a part of the samples; on the whole, the start may be lower
    first = setup.objective.cost(start)
    for end in sorted(ends, key=_finite_cost):
        cost = setup.objective.cost(end.values)
        if cost < first or not np.isfinite(first):
            return ends[-1].moved(end.values, cost)
    return ends[-1].moved(start, first)


def _search_globally(setup: DescentSetup, start: Float, limits: LinearLimits) -> SolverResult:
    from kennfeld.optimize.strategies import global_search as strategy

    settings, report = setup.options.settings, setup.report
    search = strategy.GlobalSettings(setup.options.max_evaluations, setup.options.seed)
    limits = _without_idle_values(setup, start, limits)
    if setup.outputs is not None:
        feasible_first = strategy.FeasibilityFirstCost(setup.objective, setup.outputs)
        result = feasible_first.search(start, limits, search, partial(report, "global"))
        return feasible_first.polish(result, limits, settings, report)
    result = strategy.global_search(setup.objective, start, limits, search, partial(report, "global"))
    return strategy.polish(setup.objective, result, limits, settings, partial(report, "polish"))


def _without_idle_values(setup: DescentSetup, start: Float, limits: LinearLimits) -> LinearLimits:
    """Return limits that keep the values at the start on which neither the cost nor a limit depends.

    A search would end at arbitrary ones: its best point differs from the start in all values.
    """
    problem, layout = setup.exact.problem, setup.exact.kernel.layout
    if setup.outputs is not None:
        return limits
    linked = np.zeros(start.size, dtype=bool)
    linked[limits.rows.columns[limits.rows.coefficients != 0]] = True
    idle = np.zeros(start.size, dtype=bool)
    for name in problem.unscored_names:
        own = slice(layout.offsets[name], layout.offsets[name] + problem.parameters[name].size)
        idle[own] = not any(problem.factors(name)) and not linked[own].any()
    return replace(limits, lower=np.where(idle, start, limits.lower), upper=np.where(idle, start, limits.upper))


def _costs_differ(ends: Sequence[SolverResult], difference: float) -> bool:
    """Return if all descents ran to their end, and these differ by more than kinks of no consequence."""
    costs = [end.cost for end in ends if not end.cut_short]
    return len(costs) == len(ends) and max(costs) - min(costs) > difference * min(costs)


def _best_of(ends: Sequence[SolverResult]) -> SolverResult:
    best = min(ends, key=_finite_cost)
    if ends[-1].status == "stopped":
        best = replace(best, status=ends[-1].status, message=ends[-1].message)
    elif best.status == "failed":
        # the lowest cost counts, however its search ended: it takes the status of another search that did not fail
        other = next((end for end in ends if end.status != "failed"), best)
        best = replace(best, status=other.status, message=other.message)
    return best.with_effort_of(ends)


def _finite_cost(end: SolverResult) -> float:
    """Return the cost of an end, infinite if it is not a number."""
    return end.cost if np.isfinite(end.cost) else np.inf
