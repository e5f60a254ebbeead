"""One fit of a calibration problem: from the start, through the search, to the checked result."""

import time
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.task_runner import RunnerLostError
from kennfeld.base.threads import blas_threads
from kennfeld.domain.criteria import ROBUST_LOSSES
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.ends.doubtful_ends import describe_offsets, describe_outlier
from kennfeld.optimize.ends.end_warnings import (
    EndWarnings,
    describe_close_breakpoints,
    describe_uninformed,
    scored_nodes,
    targeted_nodes,
)
from kennfeld.optimize.ends.kinks import values_at_kinks
from kennfeld.optimize.ends.ridges import lower_values
from kennfeld.optimize.ends.runaways import run_away
from kennfeld.optimize.ends.wide_differences import descend_by_differences, misleading_values
from kennfeld.optimize.ends.zero_slopes import departure
from kennfeld.optimize.fit.descent_strategy import DescentSetup, enforce_output_limits, minimise
from kennfeld.optimize.fit.result import Progress, Result, Seconds, TraceLine
from kennfeld.optimize.fit.separate_parts import SeparatePart, separate_parts
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.limits.projection import FEASIBLE, leaves_room, missed_limits, project
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.validation import check_fittable
from kennfeld.optimize.quality.quality import Quality, Scorer
from kennfeld.optimize.solver.certificate import Certificate
from kennfeld.optimize.solver.levenberg_marquardt import (
    Iteration,
    SolverResult,
    SolverSettings,
    certificate_at,
    levenberg_marquardt,
)
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.optimize.strategies.smoothing_continuation import Continuation
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.trust.assessment import TrustAssessment

UNCHANGED = 1e-9  # relative change of the cost by values whose effect is rounding
ROUNDING = 1e-20  # the same, relative to the cost at the start, for a fit without residuals
NOISE_SHARE, MAX_TOLERANCE = 0.05, 3e-5  # see `default_tolerance`
KINK = 1e-4  # share of the cost that is promised at kinks
NOISE = 1.5  # ratio of costs up to which the lower one may be due to noise
MAX_DEPARTURES = 3  # searches that may start again from a point at which values cannot move
MAX_LISTED = 5
UNDERFLOW = 1e-290  # a cost below has lost digits
REJOIN = "Start the cluster, and run the command again."
KEPT = "The result has the best values so far; their errors are unknown."
CHOICE = "smoothness"  # begins the names of stages in which factors are chosen
REACHED = 1e-10  # share of the cost at the start below which a fit is as good as exact
UNDERFLOW_MESSAGE = "The weighted squares of the errors underflow. Use larger weights, a smaller scale or other units."

Search = Callable[[Float, LinearLimits], SolverResult]


def default_tolerance(compiled: CompiledProblem, objective: LeastSquaresObjective) -> float:
    """Return the relative change of the cost at which a descent ends, as the data can distinguish it.

    Noise in n residuals raises the cost of p fitted values by p/n, relatively, on average. A step that changes it by
    1/20 of that moves the values by less than a quarter of their standard deviations. Small problems, whose digits are
    kept by a QR factorisation, end at 1e-8, as do those with a number as a target, which has no noise.
    """
    if objective.uses_qr or compiled.problem.has_goals:
        return SolverSettings.tolerance
    share = NOISE_SHARE * compiled.values.free / max(compiled.residuals, 1)
    return float(np.clip(share, SolverSettings.tolerance, MAX_TOLERANCE))


class FitRun:
    """A compiled problem, its searches and their trace.

    Args:
        problem: model, data, parameters and criteria.
        options: how to search.
        progress: called after every accepted step; may raise `Stop`.
        seconds: time spent on reading, to be included in the result.

    Raises:
        InputError: the problem has nothing to fit. Whatever happens later is a status of the result.
    """

    def __init__(self, problem: Problem, options: Options, progress: Progress | None, seconds: Seconds) -> None:
        check_fittable(problem, globally=options.method == "global").finish()
        self.problem, self.progress = problem, progress
        self.watch: Callable[[TraceLine, Float], None] | None = None  # as `progress`, with the values
        self.began = time.perf_counter()
        self.exact = CompiledProblem(problem)
        self.objective = LeastSquaresObjective(self.exact)
        tolerance = options.tolerance or default_tolerance(self.exact, self.objective)
        self.options = replace(options, tolerance=tolerance)
        smoothed = options.continuation != "off" and options.method != "global"
        self.continuation = Continuation.of(self.exact) if smoothed else None
        single = self.continuation is None and options.method != "global" and self.exact.sums.stateful
        self.thinned = self.exact.thinned() if single else self.exact
        self.read = seconds.read
        self.compile = time.perf_counter() - self.began
        self.trace: list[TraceLine] = []
        self.best: tuple[float, Float] | None = None  # cost and values of the best accepted step
        self.weights = self.exact.weights
        self._misled: tuple[Float, Int] | None = None  # the last values, and those of them whose slopes mislead
        self._whole: FitRun | None = None  # of a run over a part of its problem

    def with_start(self, problem: Problem) -> "FitRun":
        """Return the same run from other values of its free parameters; nothing is compiled again."""
        other = copy(self)
        for cached in ("scorer", "outputs"):  # they depend on the start
            other.__dict__.pop(cached, None)
        other.problem, other.exact = problem, self.exact.with_start(problem)
        other.objective = LeastSquaresObjective(other.exact)
        other.thinned = other.exact if self.thinned is self.exact else self.thinned.with_start(problem)
        other.continuation = self.continuation and self.continuation.with_start(other.exact)
        other.trace, other.best, other._misled = [], None, None
        return other

    def result(self, search: Search | None = None, begin: Float | None = None) -> Result:
        """Run `minimise` and assess its end."""
        with blas_threads(self.exact.values.free):
            return self.while_connected(lambda: self._result(search, begin))

    def while_connected(self, compute: Callable[[], Result]) -> Result:
        """Return `compute()`, or the best values so far if the data cannot be evaluated any more."""
        try:
            return compute()
        except RunnerLostError as error:
            if self.best is None:
                raise InputError.of(Location("[cluster]"), f"{error}, before the first step", REJOIN) from error
            return self._result_without_data(*self.best, f"{error}. {KEPT}")

    def _result_without_data(self, cost: float, values: Float, message: str) -> Result:
        """Return the best values of a search whose data cannot be evaluated any more; their errors are unknown."""
        movable = int(linear_limits(self.problem, self.exact.values).movable.sum())
        spent = time.perf_counter() - self.began
        return Result(
            status="stopped",
            message=message,
            parameters=self.parameters(values),
            start=self.problem.parameters,
            quality=(),
            trace=tuple(self.trace),
            iterations=len(self.trace),
            evaluations=len(self.trace),
            cost_before=self.trace[0].cost if self.trace else float("nan"),
            cost_after=cost,
            free_values=movable,
            fixed_values=self.exact.start.size - movable,
            seconds=Seconds(self.read + spent, self.read, self.compile, spent - self.compile),
        )

    def _result(self, search: Search | None, begin: Float | None) -> Result:
        scorer = self.scorer
        if search is None:
            _ = self.outputs  # compiled here, so that its time counts as such
        self.compile = time.perf_counter() - self.began
        before = self.objective.cost(self.objective.start)
        limits = linear_limits(self.problem, self.exact.values)
        end, remark = self.minimise(search, begin)
        parameters = self.parameters(end.values)
        informed = self._informed(end)
        axes, free_values = self.problem.free_axes, int(limits.movable.sum())
        values = sum(p.size for p in self.problem.parameters.parameters) + sum(len(a.axis) for a in axes.values())
        optimize = time.perf_counter() - self.began - self.compile
        scores = scorer.scores(self.problem.parameters, parameters)
        end = self._with_offsets(end)
        end = self._check_outliers(self._check_underflow(end, before, scores.quality), scores.quality)
        certificate = self._certificate(end, limits)
        sentences = (
            end.message,
            remark,
            describe_uninformed(informed),
            describe_close_breakpoints(self.problem, parameters),
        )
        return Result(
            status=end.status,
            message=" ".join(filter(None, sentences)),
            parameters=parameters,
            start=self.problem.parameters,
            quality=scores.quality,
            recordings=scores.recordings,
            trace=tuple(self.trace),
            iterations=end.iterations,
            evaluations=end.evaluations,
            cost_before=before,
            cost_after=end.cost,
            free_values=free_values,
            fixed_values=values - free_values,
            seconds=Seconds(self.read + time.perf_counter() - self.began, self.read, self.compile, optimize),
            inspection=self._assessment(end, informed),
            warnings=self._warnings(end, limits, scores.quality, certificate),
            certificate=certificate,
        )

    def minimise(self, search: Search | None = None, begin: Float | None = None) -> tuple[SolverResult, str]:
        """Search from the feasible start.

        Args:
            search: in place of the usual strategy.
            begin: values within the limits at which a single descent begins, in place of the start.

        Returns:
            The end, and a remark on the start.
        """
        self.exact.rejected.clear()
        initial = self.objective.start
        limits = linear_limits(self.problem, self.exact.values)
        start, remark = self.feasible_start(limits)
        if start is None:
            return SolverResult(initial, self.objective.cost(initial), "infeasible", remark, 0, 1), ""
        if search is not None:
            return self._within_limits(search(start, limits), limits), remark
        single = self.continuation is None and self.options.method != "global"
        first = start if begin is None or not single else begin
        end = self._finish_parts(self._search(first, start, limits), start, limits)
        end = enforce_output_limits(self._setup, end, start, limits)
        end = self._follow_simulations(self._restore_faint_values(end, start, limits), start, limits)
        projected, other_remark = project(initial, limits)
        if projected is not None and not np.array_equal(projected, start):
            cost = self.objective.cost(projected)
            if not end.cost < cost:  # the departure from a saddle did not pay
                end, remark = end.moved(projected, cost), other_remark
        end = self._with_derivative_fault(self._check_derivatives(end, limits))
        end = self._within_limits(self._with_rejections(end), limits)
        return self._confirm(end, limits), remark

    def _search(self, values: Float, start: Float, limits: LinearLimits) -> SolverResult:
        """Search for the lowest cost from some values, also beyond points at which a descent is stuck."""
        end = self._leave_saddles(minimise(self._setup, values, limits), limits)
        end = self._return_from_infinity(self._leave_saturation(end, start, limits), start, limits)
        return self._leave_kinks(self._leave_ridges(end, limits), start, limits)

    def feasible_start(self, limits: LinearLimits) -> tuple[Float | None, str]:
        """Project the start onto the limits, None if they cannot be satisfied, and off a saddle; with a remark."""
        start, remark = project(self.objective.start, limits)
        if start is None or self.options.method == "global" or self.objective.cost(start) == 0:
            return start, remark
        off = departure(self.exact, start, limits)
        return (start, remark) if off is None else (off.values, " ".join(filter(None, (remark, str(off)))))

    @cached_property
    def scorer(self) -> Scorer:
        return Scorer(self.problem)

    @cached_property
    def outputs(self) -> OutputLimits | None:
        return OutputLimits(self.problem) if self.problem.limits else None

    def parameters(self, values: Float) -> ParameterSet:
        """Return the parameter set with these free values."""
        return self.exact.parameters(values)

    def record(self, stage: str, line: Iteration, values: Float, compiled: CompiledProblem | None = None) -> None:
        """Add an accepted step to the trace and report it; `compiled` is the problem of the values if not `exact`."""
        if self._whole is not None:
            self._whole.record("part", replace(line, cost=self._whole.objective.cost(values)), values)
            return
        cost = line.cost - (compiled or self.exact).roughness.cost(values)
        rmse = float(np.sqrt(max(cost, 0.0) / self.weights))
        seconds = time.perf_counter() - self.began
        entry = TraceLine(stage=stage, start=1, rmse=rmse, seconds=seconds, **vars(line))
        self.trace.append(entry)
        if compiled in (None, self.exact):
            own = line.cost if self._is_whole(stage) else np.inf
            # costs with different smoothness factors do not compare
            if self.best is None or own <= self.best[0] or stage.startswith(CHOICE):
                self.best = own, values.copy()
        if self.watch is not None and compiled in (None, self.exact):  # dense axes have values of their own
            self.watch(entry, values)
        if self.progress is not None:
            self.progress(entry)

    def _is_whole(self, stage: str) -> bool:
        """Return if the cost of a stage is that of the exact model over all samples."""
        thinned = self.thinned is not self.exact if self.continuation is None else self.continuation.thinned
        compared = thinned and stage in ("exact", "plain")
        return not (compared or (stage.startswith("smooth") and not stage.startswith(CHOICE)))

    @property
    def _setup(self) -> DescentSetup:
        return DescentSetup(
            self.exact,
            self.objective,
            self.thinned,
            self.continuation,
            self.outputs,
            self.options,
            report=self.record,
        )

    def _leave_saddles(self, end: SolverResult, limits: LinearLimits) -> SolverResult:
        """Search again from points at which values cannot move; failed if all searches lead to such points."""
        ends = [end]
        for _ in range(MAX_DEPARTURES):
            if end.status != "converged" or end.cost == 0 or self.options.method == "global":
                break
            off = departure(self.exact, end.values, limits)
            if off is None:
                break
            ends.append(minimise(self._setup, off.values, limits))
            if not ends[-1].cost < (1 - UNCHANGED) * end.cost:
                break
            end = ends[-1]
        else:
            if end.status == "converged" and (off := departure(self.exact, end.values, limits)) is not None:
                message = (
                    f"The derivatives with respect to {' and '.join(off.stuck)} vanish again after each restart. "
                    "Set another start, or bounds without 0."
                )
                end = replace(end, status="failed", message=message)
        return end.with_effort_of(ends)

    def _descend(self, start: Float, limits: LinearLimits, *, remembers_scale: bool = False) -> SolverResult:
        """Descend from other values on the model as it is; see `SolverSettings.remembers_scale`."""
        settings = replace(self.options.settings, remembers_scale=remembers_scale)
        return levenberg_marquardt(self.objective, start, limits, settings, partial(self.record, "plain"))

    def _leave_saturation(self, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
        """Search again if parameters ran to where they have all but lost their effect.

        A long step may lead an exponent or a rate there while the other values are far from their optimum. The first
        search goes on with these parameters at their start, the second one begins at the start with shorter steps for
        values whose effect shrinks.
        """
        if end.status != "converged" or end.cost == 0 or self.options.method == "global":
            return end
        ends = [end]
        for remembers in (False, True):
            values = self.objective.with_effect(end.values, start)
            if np.array_equal(values, end.values):
                break
            values = start if remembers else values
            if limits.violation(values) > max(limits.violation(end.values), FEASIBLE):
                continue
            ends.append(self._descend(values, limits, remembers_scale=remembers))
            if ends[-1].cost < (1 - UNCHANGED) * end.cost:
                end = ends[-1]
        return end.with_effort_of(ends)

    def _return_from_infinity(self, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
        """Search again if parameters ran towards infinity: from the best values with one of them at its start."""
        ends = [end]
        if end.status != "converged" or not end.cost > 0 or self.options.method == "global":
            return end
        for held in run_away(self.exact, self.objective, start, end.values)[:MAX_DEPARTURES]:
            lower, upper = (np.where(held, start, side) for side in (limits.lower, limits.upper))
            ends.append(self._descend(start, replace(limits, lower=lower, upper=upper)))
            ends.append(self._descend(ends[-1].values, limits))
            if ends[-1].cost < (1 - UNCHANGED) * end.cost:
                end = ends[-1]
                break
        return end.with_effort_of(ends)

    def _leave_ridges(self, end: SolverResult, limits: LinearLimits) -> SolverResult:
        """Search again from lower values along combinations that change nothing to first order."""
        ends = [end]
        for _ in range(MAX_DEPARTURES):
            small = self.objective.uses_qr and self.options.method != "global"
            if end.status != "converged" or not small or not end.cost > 0:
                break
            lower = lower_values(self.objective, end.values, end.cost, limits)
            if lower is None:
                break
            ends.append(self._descend(lower, limits))
            if not ends[-1].cost < (1 - UNCHANGED) * end.cost:
                break
            end = ends[-1]
        return end.with_effort_of(ends)

    def _leave_kinks(self, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
        """Search again with the values held that are at a kink, then with all of them, as long as that lowers the cost.

        Once the others have moved, the cost may fall to one side: away from the edge of what a root is defined for.
        """
        ends = [end]
        for _ in range(MAX_DEPARTURES):
            beside, descents = self._descend_beside_kinks(end, start, limits)
            ends += descents
            if beside is end:
                break
            ends.append(self._descend(beside.values, limits))
            if not ends[-1].cost < (1 - UNCHANGED) * beside.cost:
                end = beside
                break
            end = ends[-1]
        return end.with_effort_of(ends)

    def _descend_beside_kinks(
        self, end: SolverResult, start: Float, limits: LinearLimits
    ) -> tuple[SolverResult, list[SolverResult]]:
        """Return the end of descents that hold the values at a kink, while they lower the cost, and all of them."""
        ends, held = [], np.zeros(start.size, dtype=bool)
        small = self.objective.uses_qr and self.options.method != "global"
        while small and end.certificate is not None and end.certificate.predicted_decrease > KINK:
            more = values_at_kinks(self.objective, end.values, start, limits) & ~held
            if not more.any():
                break
            held = held | more
            lower, upper = (np.where(held, end.values, side) for side in (limits.lower, limits.upper))
            ends.append(self._descend(end.values, replace(limits, lower=lower, upper=upper)))
            if not ends[-1].cost < (1 - UNCHANGED) * end.cost:
                break
            end = ends[-1]
        return end, ends

    def _finish_parts(self, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
        """Search again for the values of parts of the problem whose cost is too small to be seen beside the rest.

        If the parts have all values, the search has converged where all of them have.
        """
        if end.status not in ("converged", "failed") or self.options.method == "global" or not np.isfinite(end.cost):
            return end
        ends, rest = [end], limits.movable
        for part in separate_parts(self.problem, self.exact.values, limits):
            run, values = self._over_part(part), ends[-1].values
            rest, begin = rest & ~part.values, np.where(part.values, start, values)
            if not run._is_finished(values, begin, own := part.limits(limits, values)):
                again = run._search(values, begin, own)
                ends.append(again.moved(again.values, self.objective.cost(again.values)))
        if len(ends) == 1 or (end.status == "failed" and rest.any()):
            return end
        last = next((each for each in ends[1:] if each.status != "converged"), ends[-1])
        return last.moved(ends[-1].values, ends[-1].cost).with_effort_of(ends)

    def _over_part(self, part: SeparatePart) -> "FitRun":
        """Return the run over a part of the problem, which reports the cost of the whole."""
        other = copy(self)
        other.exact = other.thinned = part.compiled(self.exact)
        other.objective, other.continuation = LeastSquaresObjective(other.exact), None
        other._whole, other._misled = self, None
        return other

    def _is_finished(self, values: Float, start: Float, limits: LinearLimits) -> bool:
        """Return if the undamped step promises nothing, and not because values have lost their effect."""
        if not np.array_equal(self.objective.with_effect(values, start), values):
            return False
        certificate = certificate_at(self.objective, values, limits)
        return certificate is None or certificate.predicted_decrease <= self.options.settings.tolerance

    def _follow_simulations(self, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
        """Search on along differences of whole simulations if the slopes of called functions mislead."""
        if end.status != "converged" or self.options.method == "global":
            return end
        if not self._misleading(end.values, limits).size or self._is_solved(end, start):
            return end
        report = partial(self.record, "differences")
        return descend_by_differences(self.exact, end, limits, self.outputs, self.options.settings, report)

    def _misleading(self, values: Float, limits: LinearLimits) -> Int:
        """Return the `misleading_values`, kept for the next call: they cost a simulation for each value."""
        if self._misled is None or not np.array_equal(self._misled[0], values):
            self._misled = values.copy(), misleading_values(self.objective, self.exact, values, limits)
        return self._misled[1]

    def _restore_faint_values(self, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
        """Reset values to their start if their effect at the end is mere rounding.

        They may have moved while it was larger: an initial state while a time constant was longer.
        """
        if not np.isfinite(end.cost):
            return end
        faint = self.objective.faint(end.values) & (end.values != start)
        if not faint.any():
            return end
        values = self._reset_within_outputs(faint, start, end)
        cost = self.objective.cost(values)
        rounding = UNCHANGED * end.cost + ROUNDING * self.objective.cost(start)
        allowed = max(limits.violation(end.values), FEASIBLE)
        if cost <= end.cost + rounding and limits.violation(values) <= allowed:
            lost = faint & ~self.objective.faint(values) & (self.objective.with_effect(end.values, start) == start)
            return self._with_lost_values(end.moved(values, cost), lost)
        sloped = self.objective.sloped(end.values)  # smoothness may determine the others
        faint = faint & sloped if sloped is not None else np.zeros_like(faint)
        values = np.where(faint, start, end.values)
        if end.status != "converged" or not faint.any() or not limits.violation(values) <= allowed:
            return end
        return self._descend_without(faint, end, values, limits)

    def _reset_within_outputs(self, faint: Bool, start: Float, end: SolverResult) -> Float:
        """Return the end with faint values at their start, unless limits of outputs keep a parameter from there."""
        values = np.where(faint, start, end.values)
        if self.outputs is None or self.outputs.is_satisfied(values) or not self.outputs.is_satisfied(end.values):
            return values
        values = end.values
        for name in self.problem.free_names:
            own = np.zeros_like(faint)
            self._columns(own, name)[:] = True
            reset = np.where(faint & own, start, values)
            if self.outputs.is_satisfied(reset):
                values = reset
        return values

    def _with_lost_values(self, end: SolverResult, lost: Bool) -> SolverResult:
        """Mark an end as failed if values with an effect at their start have lost it, and were set back for that."""
        if end.status != "converged" or not lost.any():
            return end
        names = [name for name in self.problem.free_names if self._columns(lost, name).any()]
        message = (
            f"The search leads {' and '.join(names)} to where {'they have' if len(names) > 1 else 'it has'} no effect. "
            "Set bounds, or another start."
        )
        return replace(end, status="failed", message=message)

    def _columns(self, each: Bool, name: str) -> Bool:
        first = self.exact.values.offsets[name]
        return each[first : first + self.problem.parameters[name].size]

    def _confirm(self, end: SolverResult, limits: LinearLimits) -> SolverResult:
        """Go on from values that were moved after the descent that led there."""
        certified = end.certificate is not None or self.outputs is not None or self.options.method == "global"
        if end.status != "converged" or certified or end.cost == 0:
            return end
        again = self._descend(end.values, limits)
        kept = again.cost < (1 - UNCHANGED) * end.cost and not missed_limits(again.values, limits)
        return again.with_effort_of([end, again]) if kept else end

    def _certificate(self, end: SolverResult, limits: LinearLimits) -> Certificate | None:
        """Return the certificate of the last descent, or that of values that were moved after it."""
        if end.status == "infeasible" or not np.isfinite(end.cost):
            return None
        certificate = end.certificate or certificate_at(self.objective, end.values, limits)
        if certificate is not None and self.options.method != "global":
            for part in separate_parts(self.problem, self.exact.values, limits):
                objective = LeastSquaresObjective(part.compiled(self.exact))
                certificate = certificate.together(
                    certificate_at(objective, end.values, part.limits(limits, end.values))
                )
        excess = 0.0 if self.outputs is None else max(self.outputs.measure(end.values).largest, 0.0)
        return certificate and certificate._replace(limits=max(limits.violation(end.values), excess))

    def _descend_without(self, faint: Bool, end: SolverResult, values: Float, limits: LinearLimits) -> SolverResult:
        """Descend from `values`; return the old end if the faint values matter after all.

        A faint value that had moved far follows the noise of some samples, which costs a little to undo.
        """
        again = self._descend(values, limits)
        unmoved = np.array_equal(again.values[faint], values[faint])
        if self.outputs is not None and not self.outputs.is_satisfied(again.values):
            return end
        return again.with_effort_of([end, again]) if unmoved and again.cost <= NOISE * end.cost else end

    def _check_derivatives(self, end: SolverResult, limits: LinearLimits) -> SolverResult:
        """Mark the end as failed if no free value has a derivative there although errors remain.

        Values that are all at bounds, or determined by the limits, may be the best ones.
        """
        if end.status != "converged" or end.cost == 0 or self.options.method == "global":
            return end
        sloped = self.objective.sloped(end.values)
        within = (limits.lower < end.values) & (end.values < limits.upper)
        if sloped is None or (sloped & limits.movable).any() or not leaves_room(end.values, limits, within):
            return end
        message = (
            "All derivatives are zero: no free value changes the outputs here. Start from values in the range in which "
            'they have an effect, or search with method = "global".'
        )
        return replace(end, status="failed", message=message)

    def _check_underflow(self, end: SolverResult, before: float, quality: Sequence[Quality]) -> SolverResult:
        """Mark the end as failed if errors remain whose squares underflow, so that the search did not see them."""
        training = [row for row in quality if row.use == "training" and row.criterion in targeted_nodes(self.problem)]
        hidden = REACHED * before <= end.cost < UNDERFLOW and any(row.max_abs_after > 0 for row in training)
        if end.status != "converged" or not hidden:
            return end
        return replace(end, status="failed", message=UNDERFLOW_MESSAGE)

    def _with_offsets(self, end: SolverResult) -> SolverResult:
        """Add a sentence on inputs that vary little about a large number, which makes a descent slow."""
        if end.status != "max_iterations" or self.problem.partitions is not None:
            return end
        rows, parts = self.exact.kernel.layout.inputs, self.exact.samples.inputs.parts
        inputs = {name: parts[row] for name, row in rows.items() if name in self.problem.model.graph.inputs}
        return replace(end, message=f"{end.message} {describe_offsets(inputs)}".rstrip())

    def _check_outliers(self, end: SolverResult, quality: Sequence[Quality]) -> SolverResult:
        """Mark the end as failed if a robust loss of one sample hides those of the others."""
        robust = {criterion.node for criterion in self.problem.criteria if criterion.loss in ROBUST_LOSSES}
        robust &= scored_nodes(self.problem)
        if end.status != "converged" or not robust or self.problem.partitions is not None:
            return end
        message = describe_outlier(np.square(self.objective.residual(end.values)), quality, robust)
        return replace(end, status="failed", message=message) if message else end

    def _with_derivative_fault(self, end: SolverResult) -> SolverResult:
        """Add a sentence on the node and the sample whose derivative made the search fail."""
        if end.status != "failed" or not np.isfinite(end.cost) or self.objective.sloped(end.values) is not None:
            return end
        from kennfeld.optimize.quality.derivative_faults import describe_derivative_fault

        fault = describe_derivative_fault(self.problem, self.parameters(end.values))
        return replace(end, message=f"{end.message} {fault}".rstrip())

    def _with_rejections(self, end: SolverResult) -> SolverResult:
        """Add a sentence on the trial values that were rejected."""
        rejected = self.exact.rejected
        if not rejected.count:
            return end
        from kennfeld.optimize.quality.rejected_steps import RejectionReasons, describe_rejections

        if np.isfinite(end.cost):
            sentence = describe_rejections(self.problem, rejected, self.parameters)
        else:
            sentence = f"At these values {RejectionReasons(self.problem).of(self.parameters(end.values))}."
        return replace(end, message=f"{end.message} {sentence}")

    def _within_limits(self, end: SolverResult, limits: LinearLimits) -> SolverResult:
        """Move the end onto the limits if it violates one; only values that keep all of them have converged."""
        violated = missed_limits(end.values, limits)
        if not violated or not np.isfinite(end.cost):
            return end
        values, _ = project(end.values, limits)
        if values is None:
            return replace(end, status="failed", message=f"{end.message} Violated limits: {violated}.")
        projected = end.moved(values, self.objective.cost(values))
        if end.status != "converged" or projected.cost <= end.cost + self.options.settings.tolerance * abs(end.cost):
            return projected
        message = (
            "The search ended outside its limits; the result is the nearest values that keep them, not the best ones. "
            f"Violated: {violated}."
        )
        return replace(projected, status="failed", message=message)

    def _warnings(
        self, end: SolverResult, limits: LinearLimits, quality: Sequence[Quality], certificate: Certificate | None
    ) -> tuple[Finding, ...]:
        if end.status in ("infeasible", "failed"):
            return ()
        warnings = EndWarnings(self.exact, self.objective, limits, self.options, end, self.outputs)
        sloped = self.options.method != "global" and not self._is_solved(end, self.objective.start)
        misleading = self._misleading(end.values, limits) if sloped else None
        return warnings.find(quality, certificate if end.status == "converged" else None, misleading)

    def _is_solved(self, end: SolverResult, start: Float) -> bool:
        """Return if the errors at the end are rounding, compared with those at the start."""
        return bool(end.cost <= REACHED * self.objective.cost(start))

    def _assessment(self, end: SolverResult, informed: Mapping[str, Bool]) -> TrustAssessment | None:
        if end.status == "infeasible" or not informed:
            return None
        run = (self.exact, self.scorer, lambda: self.outputs, end.status)
        return TrustAssessment(self.problem, end.values, informed, *run)

    def _informed(self, end: SolverResult) -> Mapping[str, Bool]:
        """Mark for each free parameter the values on which the cost depends, at the end or on the way there."""
        if not np.isfinite(end.cost):
            return {}
        informed = self.objective.informed(end.values) | (end.values != self.objective.start)
        parameters, offsets = self.problem.parameters, self.exact.values.offsets
        return {
            name: informed[offsets[name] :][: parameters[name].size].reshape(parameters[name].values.shape)
            for name in self.problem.free_names
        }
