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
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.storage import StorageRounding
from kennfeld.graph.external_function import changing_results
from kennfeld.optimize.ends.end_warnings import (
    EndWarnings,
    describe_close_breakpoints,
    describe_uninformed,
)
from kennfeld.optimize.ends.wide_differences import descend_by_differences, misleading_values
from kennfeld.optimize.ends.zero_slopes import departure
from kennfeld.optimize.fit.descent_strategy import DescentSetup, enforce_output_limits
from kennfeld.optimize.fit.end_checks import (
    REACHED,
    check_derivatives,
    check_outliers,
    check_underflow,
    with_derivative_fault,
    with_offsets,
    with_rejections,
    within_limits,
)
from kennfeld.optimize.fit.faint_values import FaintValues
from kennfeld.optimize.fit.restarts import Restarts, descend, is_lower
from kennfeld.optimize.fit.result import Progress, Result, Seconds, TraceLine
from kennfeld.optimize.fit.separate_parts import SeparatePart, separate_parts
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.limits.projection import missed_limits, project
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.validation import check_fittable
from kennfeld.optimize.quality.quality import Quality, Scorer
from kennfeld.optimize.rounding.rounded_values import rounded_values
from kennfeld.optimize.solver.certificate import Certificate
from kennfeld.optimize.solver.levenberg_marquardt import (
    Iteration,
    SolverResult,
    SolverSettings,
    certificate_at,
)
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.optimize.strategies.smoothing_continuation import Continuation
from kennfeld.optimize.sums.compiled import CompiledProblem, smoothable
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.trust.assessment import TrustAssessment

NOISE_SHARE, MAX_TOLERANCE = 0.05, 3e-5  # see `default_tolerance`
MAX_SIGNIFICANT = 1e-3  # see `significant_decrease`
REJOIN = "Start the cluster, and run the command again."
KEPT = "The result has the best values so far; their errors are unknown."
CHOICE = "smoothness"  # begins the names of stages in which factors are chosen

Search = Callable[[Float, LinearLimits], SolverResult]


def default_tolerance(compiled: CompiledProblem, objective: LeastSquaresObjective) -> float:
    """Derive the relative change of the cost at which a descent ends, as the data can distinguish it.

    Noise in n residuals raises the cost of p fitted values by p/n, relatively, on average. A step that changes it by
    1/20 of that moves the values by less than a quarter of their standard deviations. Small problems, whose digits are
    kept by a QR factorisation, end at 1e-8, as do those with a number as a target, which has no noise.
    """
    if objective.uses_qr or compiled.problem.has_goals:
        return SolverSettings.tolerance
    return float(np.clip(_noise_share(compiled), SolverSettings.tolerance, MAX_TOLERANCE))


def significant_decrease(compiled: CompiledProblem, objective: LeastSquaresObjective) -> float:
    """Return the share of the cost that the slopes at kinks of lookups have to promise before a search goes on.

    At a kink the slopes of one side promise a decrease that the other side takes back. Below the share of
    `default_tolerance`, which is much larger than any tolerance where values are many, the data could not even tell a
    decrease that is real. It is 0 where the slopes are believed: without kinks, and in problems without noise or with
    few values.
    """
    if objective.uses_qr or compiled.problem.has_goals or not smoothable(compiled.problem):
        return 0.0
    return min(_noise_share(compiled), MAX_SIGNIFICANT)


def _noise_share(compiled: CompiledProblem) -> float:
    return NOISE_SHARE * compiled.values.free / max(compiled.residuals, 1)


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
        self.significant = 0.0 if options.tolerance else significant_decrease(self.exact, self.objective)
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
        for cached in ("scorer", "outputs", "limits"):  # they depend on the start
            other.__dict__.pop(cached, None)
        other.problem, other.exact = problem, self.exact.with_start(problem)
        other.objective = LeastSquaresObjective(other.exact)
        other.thinned = other.exact if self.thinned is self.exact else self.thinned.with_start(problem)
        other.continuation = self.continuation and self.continuation.with_start(other.exact)
        other.trace, other.best, other._misled = [], None, None
        return other

    def result(self, search: Search | None = None, begin: Float | None = None) -> Result:
        """Run `minimise` with the same arguments, and assess its end."""
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
        movable = int(self.limits.movable.sum())
        elapsed = time.perf_counter() - self.began
        unrounded = "" if self.problem.rounding is None else " The values are not rounded to storage."
        return Result(
            status="stopped",
            message=message + unrounded,
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
            seconds=Seconds(self.read + elapsed, self.read, self.compile, elapsed - self.compile),
        )

    def _result(self, search: Search | None, begin: Float | None) -> Result:
        scorer = self.scorer
        if search is None:
            _ = self.outputs  # compiled here, so that its time counts as such
        self.compile = time.perf_counter() - self.began
        before = self.objective.cost(self.objective.start)
        limits = self.limits
        end, remark = self.minimise(search, begin)
        fitted = self.parameters(end.values)
        informed = self._informed(end)
        axes, free_values = self.problem.free_axes, int(limits.movable.sum())
        values = sum(p.size for p in self.problem.parameters.parameters) + sum(len(a.axis) for a in axes.values())
        optimize = time.perf_counter() - self.began - self.compile
        scores = scorer.scores(self.problem.parameters, fitted)
        end = check_underflow(self.problem, with_offsets(self.exact, end), before, scores.quality)
        end = check_outliers(self.problem, self.objective, end, scores.quality)
        certificate = self._certificate(end, limits)
        sentences = (
            end.message,
            remark,
            describe_uninformed(informed, self.problem.parameters),
            describe_close_breakpoints(self.problem, fitted),
        )
        result = Result(
            status=end.status,
            message=" ".join(filter(None, sentences)),
            parameters=fitted,
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
            warnings=self._warnings(end, fitted, limits, scores.quality, certificate),
            certificate=certificate,
        )
        rounding = self.problem.rounding
        if rounding is None or end.status == "infeasible" or not np.isfinite(end.cost):
            return result
        return self._rounded(result, rounding, limits, end.values)

    def _rounded(self, result: Result, rounding: StorageRounding, limits: LinearLimits, fit: Float) -> Result:
        """Return a result with storable values, and their errors."""
        keeps_outputs = (lambda values: True) if self.outputs is None else self.outputs.is_satisfied
        rounded = rounded_values(self.exact, rounding, limits, fit, result.quality, keeps_outputs)
        return replace(
            result,
            parameters=rounded.parameters,
            quality=rounded.scores.quality,
            recordings=rounded.scores.recordings,
            cost_after=self.objective.cost(rounded.values),
            seconds=replace(result.seconds, total=self.read + time.perf_counter() - self.began),
            warnings=(*result.warnings, *rounded.warnings),
            rounding=rounded.outcome,
        )

    def minimise(self, search: Search | None = None, begin: Float | None = None) -> tuple[SolverResult, str]:
        """Search from the feasible start.

        Args:
            search: in place of the usual strategy.
            begin: values within the limits at which a single descent begins, in place of the start, Float[values].

        Returns:
            The end, and a remark on the start.
        """
        self.exact.rejected.clear()
        initial = self.objective.start
        limits = self.limits
        tolerance = self.options.settings.tolerance
        start, remark = self.feasible_start(limits)
        if start is None:
            return SolverResult(initial, self.objective.cost(initial), "infeasible", remark, 0, 1), ""
        if search is not None:
            return within_limits(search(start, limits), limits, self.objective, tolerance), remark
        setup, single = self._setup, self.continuation is None and self.options.method != "global"
        first = start if begin is None or not single else begin
        end = self._finish_parts(Restarts(setup, start, limits).search(first), start, limits)
        end = enforce_output_limits(setup, end, start, limits)
        end = self._follow_simulations(FaintValues(setup, start, limits).restored(end), start, limits)
        projected, other_remark = project(initial, limits)
        if projected is not None and not np.array_equal(projected, start):
            cost = self.objective.cost(projected)
            if not end.cost < cost:  # the departure from a saddle did not pay
                end, remark = end.moved(projected, cost), other_remark
        # checks come last, as restored faint values or the projected start may have taken the place of the end
        end = with_derivative_fault(setup, check_derivatives(setup, end, limits))
        end = within_limits(with_rejections(setup, end), limits, self.objective, tolerance)
        return self._confirm(end, limits), remark

    def feasible_start(self, limits: LinearLimits) -> tuple[Float | None, str]:
        """Project the start onto the limits, None if they cannot be satisfied, and off a saddle; with a remark."""
        start, remark = project(self.objective.start, limits)
        if start is None or self.options.method == "global" or self.objective.cost(start) == 0:
            return start, remark
        # a global search does not begin at the start, and a cost of 0 cannot be lowered
        off = departure(self.objective, self.exact, start, limits)
        return (start, remark) if off is None else (off.values, " ".join(filter(None, (remark, str(off)))))

    @cached_property
    def scorer(self) -> Scorer:
        return Scorer(self.problem)

    @cached_property
    def limits(self) -> LinearLimits:
        """Bounds and linear rows of the free values."""
        return linear_limits(self.problem, self.exact.values)

    @cached_property
    def outputs(self) -> OutputLimits | None:
        return OutputLimits(self.problem) if self.problem.limits else None

    def parameters(self, values: Float) -> ParameterSet:
        """Return the parameter set with these free values, Float[values]."""
        return self.exact.parameters(values)

    def record(self, stage: str, line: Iteration, values: Float, compiled: CompiledProblem | None = None) -> None:
        """Add an accepted step to the trace and report it; `compiled` is the problem of the values if not `exact`."""
        if self._whole is not None:
            self._whole.record("part", replace(line, cost=self._whole.objective.cost(values)), values)
            return
        # the RMSE is that of the errors alone: the cost without the penalty on roughness, over the sum of the weights
        cost = line.cost - (compiled or self.exact).roughness.cost(values)
        rmse = float(np.sqrt(max(cost, 0.0) / self.weights))
        seconds = time.perf_counter() - self.began
        entry = TraceLine(stage=stage, start=1, rmse=rmse, seconds=seconds, **vars(line))
        self.trace.append(entry)
        if compiled in (None, self.exact):
            # costs of smoothed or thinned stages do not compare: as infinite ones, they give way to any of the whole
            # problem
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
        # stages that are compared with each other run over a part of the samples; `final` continues the best of them
        # over all
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
            significant=self.significant,
        )

    def _finish_parts(self, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
        """Search again for the values of parts of the problem whose cost is too small to be seen beside the rest.

        If the parts have all values, the search has converged where all of them have.
        """
        if end.status not in ("converged", "failed") or self.options.method == "global" or not np.isfinite(end.cost):
            return end
        ends, rest = [end], limits.movable
        for part in separate_parts(self.problem, self.exact.values, limits):
            run, values = self._over_part(part), ends[-1].values
            # values of other parts stay where the search has led them
            rest, begin = rest & ~part.values, np.where(part.values, start, values)
            if not run._is_finished(values, begin, own := part.limits(limits, values)):
                again = Restarts(run._setup, begin, own).search(values)
                ends.append(again.moved(again.values, self.objective.cost(again.values)))
        # a failure may lie in the values that belong to no part
        if len(ends) == 1 or (end.status == "failed" and rest.any()):
            return end
        last = next((each for each in ends[1:] if each.status != "converged"), ends[-1])
        return last.moved(ends[-1].values, ends[-1].cost).with_effort_of(ends)

    def _over_part(self, part: SeparatePart) -> "FitRun":
        """Return the run over a part of the problem, which reports the cost of the whole."""
        other = copy(self)
        other.exact = other.thinned = part.compiled(self.exact)
        other.objective, other.continuation = LeastSquaresObjective(other.exact), None
        other._whole, other._misled, other.significant = self, None, 0.0
        other.__dict__.pop("limits", None)
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

    def _confirm(self, end: SolverResult, limits: LinearLimits) -> SolverResult:
        """Go on from values that were moved after the descent that led there."""
        # `SolverResult.moved` drops the certificate, so that values without one were moved
        certified = end.certificate is not None or self.outputs is not None or self.options.method == "global"
        if end.status != "converged" or certified or end.cost == 0:
            return end
        again = descend(self._setup, end.values, limits)
        kept = is_lower(again, end) and not missed_limits(again.values, limits)
        return again.with_effort_of([end, again]) if kept else end

    def _certificate(self, end: SolverResult, limits: LinearLimits) -> Certificate | None:
        """Return the certificate of the last descent, or that of values that were moved after it."""
        if end.status == "infeasible" or not np.isfinite(end.cost):
            return None
        certificate = end.certificate or certificate_at(self.objective, end.values, limits)
        if certificate is not None and self.options.method != "global":
            for part in separate_parts(self.problem, self.exact.values, limits):
                objective = LeastSquaresObjective(part.compiled(self.exact))
                # the decrease that a small part promises is invisible beside the cost of the whole
                certificate = certificate.together(
                    certificate_at(objective, end.values, part.limits(limits, end.values))
                )
        excess = 0.0 if self.outputs is None else max(self.outputs.measure(end.values).largest, 0.0)
        return certificate and certificate._replace(limits=max(limits.violation(end.values), excess))

    def _warnings(
        self,
        end: SolverResult,
        fitted: ParameterSet,
        limits: LinearLimits,
        quality: Sequence[Quality],
        certificate: Certificate | None,
    ) -> tuple[Finding, ...]:
        changing = changing_results(self.problem.graph.nodes)
        if end.status in ("infeasible", "failed"):
            return changing
        warnings = EndWarnings(self.exact, self.objective, limits, self.options, end, self.outputs)
        sloped = self.options.method != "global" and not self._is_solved(end, self.objective.start)
        misleading = self._misleading(end.values, limits) if sloped else None
        return changing + warnings.find(fitted, quality, certificate if end.status == "converged" else None, misleading)

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
