"""Run a calibration problem from start to result.

Breakpoints as values to be fitted: which axes move, and what they keep while they do.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.errors import Finding, InputError
from kennfeld.free_axes import AxisKey, FreeAxis
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.linear_limits import linear_limits, touching_pairs
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.projection import FEASIBLE, missed_limits, project
from kennfeld.optimize.quality import Quality, Scorer
from kennfeld.optimize.result import Progress, Result, Seconds, TraceLine
from kennfeld.optimize.sensitivity import without_vanished
from kennfeld.optimize.solver.levenberg_marquardt import Iteration, SolverResult, SolverSettings, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.strategies.augmented_lagrangian import descend_within
from kennfeld.optimize.strategies.breakpoint_placement import BreakpointPlacement, coarse
from kennfeld.optimize.strategies.output_limits import OutputLimits
from kennfeld.optimize.strategies.smoothing_continuation import LONG_SCHEDULE, SHORT_SCHEDULE, Continuation
from kennfeld.optimize.trust.assessment import TrustAssessment
from kennfeld.optimize.validation import check_shared_axes
from kennfeld.optimize.worsening import admissible_share, worsened
from kennfeld.optimize.zero_slopes import departure
from kennfeld.parameter_set import ParameterSet
from kennfeld.threads import blas_threads

__all__ = ["FitRun", "run"]

ROUGH = 1e-5  # relative change of the cost that ends a descent while another is lower
UNCHANGED = 1e-9  # relative change of the cost by values whose effect is rounding
ROUNDING = 1e-20  # the same, relative to the cost at the start, for a fit without residuals
NOISE = 1.5  # ratio of costs up to which the lower one may be due to noise
SADDLES = 3  # descents that may begin anew where values cannot move
KINK_COST_DIFFERENCE = 3e-3  # relative difference of two ends from which creases matter

Search = Callable[[Float, LinearLimits], SolverResult]


def told(axes: Mapping[AxisKey, FreeAxis], parameters: ParameterSet) -> str:
    """Sentences on breakpoints that ended as close as they may: fewer would do as well."""
    parts = []
    for key, before in axes.items():
        table, which = before.places[0]
        points, least = parameters[table].axes[which].breakpoints, before.axis.least_distance
        close = touching_pairs(points, least)
        if close.size and not np.array_equal(points, before.axis.breakpoints):
            pairs = ", ".join(f"{points[i]:g} and {points[i + 1]:g}" for i in close[:5])
            parts.append(f"Breakpoints of {key} ended at their least distance: {pairs}; fewer may do.")
    return " ".join(parts)


def run(problem: Problem, options: Options, progress: Progress | None = None, seconds: Seconds | None = None) -> Result:
    """Calibrate. `progress` hears of every accepted step and may raise `Stop`.

    Raises `InputError` where the problem has nothing to fit. All that can happen afterwards is a status of the result.
    """
    running = FitRun(problem, options, progress, seconds or Seconds())
    with blas_threads(running.exact.values.free):
        return running.result()


class FitRun:
    """The running state of a calibration."""

    def __init__(self, problem: Problem, options: Options, progress: Progress | None, seconds: Seconds) -> None:
        _require(problem, options)
        self.problem, self.options, self.progress = problem, options, progress
        self.watch: Callable[[TraceLine, Float], None] | None = None  # hears of the values as well
        self.began = time.perf_counter()
        self.exact = CompiledProblem(problem)
        self.objective = LeastSquaresObjective(self.exact)
        smoothed = options.continuation != "off" and options.method != "global"
        self.continuation = Continuation.of(problem, self.exact) if smoothed else None
        self.read = seconds.read
        self.compile = time.perf_counter() - self.began
        self.trace: list[TraceLine] = []
        self.weights = self.exact.weights

    @property
    def scored(self) -> set[str]:
        """The nodes of the criteria that count."""
        return {criterion.node for criterion in self.problem.criteria if criterion.weight > 0}

    @cached_property
    def scorer(self) -> Scorer:
        """What scores its start and its end."""
        return Scorer(self.problem)

    @cached_property
    def outputs(self) -> OutputLimits | None:
        """The limits of outputs, where there are any."""
        return OutputLimits(self.problem) if self.problem.limits else None

    def moved(self, problem: Problem) -> "FitRun":
        """The same run from other values of its free parameters; nothing is compiled again."""
        other = copy(self)
        for made_for_one_start in ("scorer", "outputs"):
            other.__dict__.pop(made_for_one_start, None)
        other.problem, other.exact = problem, self.exact.moved(problem)
        other.objective = LeastSquaresObjective(other.exact)
        other.continuation = self.continuation and self.continuation.moved(other.exact)
        other.trace = []
        return other

    def begin(self, limits: LinearLimits) -> tuple[Float | None, str]:
        """The start moved into the limits, and off a saddle; None where that is impossible. And a remark on it."""
        kept, remark = project(self.objective.start, limits)
        if kept is None or self.options.method == "global" or self.objective.cost(kept) == 0:
            return kept, remark
        off = departure(self.exact, kept, limits)
        return (kept, remark) if off is None else (off.values, " ".join(filter(None, (remark, str(off)))))

    def end(self, search: Search | None = None) -> tuple[SolverResult, str]:
        """Where the search ends that begins at `begin`, and a remark on that start."""
        self.exact.rejected.clear()
        given = self.objective.start
        limits = linear_limits(self.problem, self.exact.values)
        start, remark = self.begin(limits)
        if start is None:
            return SolverResult(given, self.objective.cost(given), "infeasible", remark, 0, 1), ""
        if search is not None:
            return self._within(search(start, limits), limits), remark
        end = self._limited(self._off_saddles(self._descend(start, limits), limits), start, limits)
        end = self._faint_restored(end, start, limits)
        kept, usual = project(given, limits)
        if kept is not None and not np.array_equal(kept, start) and not end.cost < self.objective.cost(kept):
            end, remark = replace(end, values=kept, cost=self.objective.cost(kept)), usual
        return self._within(self._with_reasons(self._with_slopes(end, limits)), limits), remark

    def _with_slopes(self, end: SolverResult, limits: LinearLimits) -> SolverResult:
        """The end, which has failed if no free value has a slope there although errors are left.

        Values that all lie on bounds may be the best ones.
        """
        if end.status != "converged" or end.cost == 0 or self.options.method == "global":
            return end
        sloped = self.objective.sloped(end.values)
        within = (limits.lower < end.values) & (end.values < limits.upper)
        if sloped is None or (sloped & limits.movable).any() or not within.any():
            return end
        message = (
            "All slopes are zero: the outputs do not change with any free value here. Start from other values, "
            'within the range in which they matter, or search with method = "global".'
        )
        return replace(end, status="failed", message=message)

    def _within(self, end: SolverResult, limits: LinearLimits) -> SolverResult:
        """The end, moved onto the limits if it misses one; only values that keep all of them have converged."""
        missed = missed_limits(end.values, limits)
        if not missed or not np.isfinite(end.cost):
            return end
        values, _ = project(end.values, limits)
        if values is None:
            return replace(end, status="failed", message=f"{end.message} Limits are not met: {missed}.")
        moved = replace(end, values=values, cost=self.objective.cost(values))
        if end.status != "converged" or moved.cost <= end.cost + self.options.tolerance * abs(end.cost):
            return moved
        message = "The values found missed their limits and were moved to the nearest ones that keep them: they are "
        return replace(moved, status="failed", message=f"{message}not the best. Missed: {missed}.")

    def _off_saddles(self, end: SolverResult, limits: LinearLimits) -> SolverResult:
        """The end of descents from an end at which values cannot move; it has failed if they all lead to such ends."""
        ends = [end]
        for _ in range(SADDLES):
            if end.status != "converged" or end.cost == 0 or self.options.method == "global":
                break
            off = departure(self.exact, end.values, limits)
            if off is None:
                break
            ends.append(self._descend(off.values, limits))
            if not ends[-1].cost < (1 - UNCHANGED) * end.cost:
                break
            end = ends[-1]
        else:
            if end.status == "converged" and (off := departure(self.exact, end.values, limits)) is not None:
                names = " and ".join(off.stuck)
                message = f"The slopes of {names} vanish again and again. Give them another start, or bounds without 0."
                end = replace(end, status="failed", message=message)
        return _with_effort(end, ends)

    def result(self, search: Search | None = None) -> Result:
        """The result of the run, or of another search of the same problem."""
        scorer = self.scorer
        _ = search or self.outputs
        self.compile = time.perf_counter() - self.began
        before = self.objective.cost(self.objective.start)
        limits = linear_limits(self.problem, self.exact.values)
        end, remark = self.end(search)
        parameters = self.parameters(end.values)
        informed = self._informed(end)
        axes = self.problem.free_axes
        values = sum(p.size for p in self.problem.parameters.parameters) + sum(len(a.axis) for a in axes.values())
        optimize = time.perf_counter() - self.began - self.compile
        quality = scorer.quality(self.problem.parameters, parameters)
        end = without_vanished(end, before, quality, self.scored)
        return Result(
            status=end.status,
            message=" ".join(part for part in (end.message, remark, _unseen(informed), told(axes, parameters)) if part),
            parameters=parameters,
            start=self.problem.parameters,
            quality=quality,
            trace=tuple(self.trace),
            iterations=end.iterations,
            evaluations=end.evaluations,
            cost_before=before,
            cost_after=end.cost,
            free_values=int(limits.movable.sum()),
            fixed_values=values - int(limits.movable.sum()),
            seconds=Seconds(self.read + time.perf_counter() - self.began, self.read, self.compile, optimize),
            inspection=self._inspection(end, informed),
            warnings=self._warnings(end, limits, quality),
        )

    def _warnings(self, end: SolverResult, limits: LinearLimits, quality: Sequence[Quality]) -> tuple[Finding, ...]:
        """What to know of the errors that the fit ends with, if they are larger than at the start."""
        if end.status in ("infeasible", "failed"):
            return ()
        before, after = (
            self.objective.cost(values) - self.exact.roughness.cost(values)
            for values in (self.objective.start, end.values)
        )
        outweighed = after > before
        smooth = outweighed and self.exact.roughness.cost(self.objective.start) > 0
        share = admissible_share(self.exact, limits, end.values, before) if smooth else None
        return tuple(worsened(quality, self.scored, outweighed=outweighed, share=share))

    def _descend(self, start: Float, limits: LinearLimits) -> SolverResult:
        """The end of the lowest cost: of the plain descent and, where there are creases, of continuations.

        Where the short continuation and the plain descent end at about the same cost, creases do not matter; else the
        long one is worth its time.
        """
        if self.options.method == "global":
            return self._searched(start, limits)
        settings = coarse(self.options.settings) if self.problem.free_axes else self.options.settings
        ends: list[SolverResult] = []
        if self.continuation is not None:
            ends.append(self.continuation.descend(SHORT_SCHEDULE, start, limits, settings, self._report))
        if not ends or ends[-1].status != "stopped":
            ends += self._plain(start, limits, settings, ends)
        if self.continuation is not None and _differ(ends):
            ends.append(self.continuation.descend(LONG_SCHEDULE, start, limits, settings, self._report))
        if self.problem.free_axes and ends[-1].status not in ("stopped", "failed"):
            placing = BreakpointPlacement(self.problem, self.exact, smoothed=self.options.continuation != "off")
            ends.append(placing.descend(_lowest(ends).values, limits, self.options.settings, self._report))
        return _lowest(ends)

    def _searched(self, start: Float, limits: LinearLimits) -> SolverResult:
        """The end of a search without gradients, and of a descent from there."""
        from kennfeld.optimize.strategies.global_search import (
            FeasibilityFirstCost,
            GlobalSettings,
            global_search,
            polish,
        )

        search = GlobalSettings(self.options.max_evaluations, self.options.seed)
        if self.outputs is not None:
            first = FeasibilityFirstCost(self.objective, self.outputs, self.parameters)
            found = first.search(start, limits, search, partial(self._report, "global"))
            return first.polished(found, limits, self.options.settings, self._report)
        found = global_search(self.objective, start, limits, search, partial(self._report, "global"))
        return polish(self.objective, found, limits, self.options.settings, partial(self._report, "polish"))

    def _plain(
        self, start: Float, limits: LinearLimits, settings: SolverSettings, before: Sequence[SolverResult]
    ) -> list[SolverResult]:
        """The plain descent; where another one came before, it goes on to its very end only if it came lower."""
        report = partial(self._report, "plain")
        if not before:
            return [levenberg_marquardt(self.objective, start, limits, settings, report)]
        rough = replace(settings, tolerance=max(settings.tolerance, ROUGH), patience=2)
        ends = [levenberg_marquardt(self.objective, start, limits, rough, report)]
        if ends[0].status == "converged" and not ends[0].cost > before[-1].cost:
            ends.append(levenberg_marquardt(self.objective, ends[0].values, limits, settings, report))
        return ends

    def _limited(self, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
        """The end moved to where the limits of outputs hold; from there, else from the start."""
        outputs = self.outputs
        if outputs is None or end.status in ("stopped", "failed") or outputs.kept(self.parameters(end.values)):
            return end
        ends = [end]
        for at in (end.values, start):
            ends.append(
                descend_within(
                    outputs, self.objective, at, limits, self.options.settings, self.parameters, self._report
                )
            )
            if ends[-1].status != "infeasible":
                break
        best = ends[-1] if ends[-1].status != "infeasible" else ends[1]
        return _with_effort(best, ends)

    def _faint_restored(self, end: SolverResult, start: Float, limits: LinearLimits) -> SolverResult:
        """The end with the start of the values whose effect is mere rounding there.

        They may have moved while it was more than that: an initial state while a time constant was larger.
        """
        if not np.isfinite(end.cost):
            return end
        faint = self.objective.faint(end.values) & (end.values != start)
        if not faint.any():
            return end
        values = np.where(faint, start, end.values)
        cost = self.objective.cost(values)
        rounding = UNCHANGED * end.cost + ROUNDING * self.objective.cost(start)
        if cost <= end.cost + rounding and self._keeps_as_well(values, end, limits):
            return replace(end, values=values, cost=cost)
        sloped = self.objective.sloped(end.values)  # smoothness may hold the others
        faint = faint & sloped if sloped is not None else np.zeros_like(faint)
        values = np.where(faint, start, end.values)
        if end.status != "converged" or not faint.any() or not self._keeps_as_well(values, end, limits):
            return end
        return self._descended_without(faint, end, values, limits)

    def _keeps_as_well(self, values: Float, end: SolverResult, limits: LinearLimits) -> bool:
        """Whether values keep the limits as well as an end does."""
        return limits.violation(values) <= max(limits.violation(end.values), FEASIBLE)

    def _descended_without(self, faint: Bool, end: SolverResult, values: Float, limits: LinearLimits) -> SolverResult:
        """The end of a descent from values of which the faint ones stay; another one if they do matter.

        A faint value that had moved far follows the noise of some samples, which costs a little to undo.
        """
        again = levenberg_marquardt(
            self.objective, values, limits, self.options.settings, partial(self._report, "plain")
        )
        kept = np.array_equal(again.values[faint], values[faint])
        if self.outputs is not None and not self.outputs.kept(self.parameters(again.values)):
            return end
        return _with_effort(again, [end, again]) if kept and again.cost <= NOISE * end.cost else end

    def _with_reasons(self, end: SolverResult) -> SolverResult:
        """The end with a sentence on the trial values that were rejected on the way."""
        rejected = self.exact.rejected
        if not rejected.count:
            return end
        from kennfeld.optimize.rejected_steps import RejectionReasons, told

        if not np.isfinite(end.cost):
            reason = RejectionReasons(self.problem).of(self.parameters(end.values))
            return replace(end, message=f"{end.message} At these values {reason}.")
        return replace(end, message=f"{end.message} {told(self.problem, rejected, self.parameters)}")

    def parameters(self, values: Float) -> ParameterSet:
        """The set with these free values."""
        full = self.exact.start.copy()
        full[: values.size] = values
        return self.exact.values.unpack(full, self.problem.parameters)

    def _report(self, stage: str, line: Iteration, values: Float, compiled: CompiledProblem | None = None) -> None:
        cost = line.cost - (compiled or self.exact).roughness.cost(values)
        entry = TraceLine(
            iteration=line.iteration,
            start=1,
            stage=stage,
            cost=line.cost,
            rmse=float(np.sqrt(max(cost, 0.0) / self.weights)),
            step=line.step,
            damping=line.damping,
            active=line.active,
            seconds=time.perf_counter() - self.began,
        )
        self.trace.append(entry)
        if self.watch is not None and compiled in (None, self.exact):  # dense axes have values of their own
            self.watch(entry, values)
        if self.progress is not None:
            self.progress(entry)

    def _inspection(self, end: SolverResult, informed: Mapping[str, Bool]) -> TrustAssessment | None:
        """What tells the trust in the values, where there is anything to trust."""
        if end.status == "infeasible" or not informed:
            return None
        given = (self.problem, end.values, informed, self.exact, self.scorer)
        return TrustAssessment(*given, outputs=lambda: self.outputs, status=end.status)

    def _informed(self, end: SolverResult) -> Mapping[str, Bool]:
        """For each free parameter, the values that the cost depends on, at the end or on the way there."""
        if not np.isfinite(end.cost):
            return {}
        if self.objective.small:
            _, jacobian = self.objective.rows(end.values)
            seen = (jacobian != 0).any(axis=0)
        else:
            seen = np.diag(self.objective.normal(end.values)[1]) > 0
        parameters, offsets = self.problem.parameters, self.exact.values.offsets
        seen |= end.values != self.objective.start
        return {
            name: np.asarray(seen[offsets[name] : offsets[name] + parameters[name].size]).reshape(
                parameters[name].values.shape
            )
            for name in self.problem.free_names
        }


def _differ(ends: Sequence[SolverResult]) -> bool:
    """Whether all descents ran to their end, and these are not about equal."""
    if any(end.status in ("stopped", "failed") for end in ends):
        return False
    costs = [end.cost for end in ends]
    return max(costs) - min(costs) > KINK_COST_DIFFERENCE * min(costs)


def _lowest(ends: Sequence[SolverResult]) -> SolverResult:
    """The best of several descents, with the effort of all."""
    best = min(ends, key=lambda end: end.cost if np.isfinite(end.cost) else np.inf)
    if ends[-1].status == "stopped":
        best = replace(best, status=ends[-1].status, message=ends[-1].message)
    elif best.status == "failed":
        other = next((end for end in ends if end.status != "failed"), best)
        best = replace(best, status=other.status, message=other.message)
    return _with_effort(best, ends)


def _with_effort(best: SolverResult, ends: Sequence[SolverResult]) -> SolverResult:
    """An end with the iterations and evaluations of all."""
    effort = {name: sum(getattr(end, name) for end in ends) for name in ("iterations", "evaluations")}
    return replace(best, **effort)


def _require(problem: Problem, options: Options) -> None:
    """Findings that leave nothing to fit."""
    findings = []
    if not problem.criteria:
        findings.append(Finding("criteria", "there is none", "Name a node and its target."))
    if not problem.free_names:
        findings.append(
            Finding("parameters", f"free = {list(problem.free)} matches no parameter that the function uses")
        )
    findings += check_shared_axes(problem.free_axes, problem.free_names)
    if not any(bound.count for bound in problem.training):
        findings.append(Finding("datasets", "no training data are left", "Use at least one dataset for training."))
    else:
        findings += [
            Finding(f"criterion on {c.node}", f"no sample of the training data has its target {c.target}")
            for c in problem.criteria
            if not any(np.isfinite(problem.target(c, bound)).any() for bound in problem.training)
        ]
    if options.method == "global":
        from kennfeld.optimize.validation import unbounded

        findings += unbounded(problem)
    if findings:
        raise InputError(findings)


def _unseen(informed: Mapping[str, Bool]) -> str:
    """A sentence on values that nothing informs."""
    counts = {name: int((~seen).sum()) for name, seen in informed.items() if not seen.all()}
    if not counts:
        return ""
    listed = ", ".join(f"{count} of {name}" for name, count in counts.items())
    return f"No data and no smoothness inform {listed}; these values keep their start."
