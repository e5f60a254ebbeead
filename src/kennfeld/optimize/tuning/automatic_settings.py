"""Automatic settings of a calibration: shifts of channels and smoothness factors, chosen before the search.

If the search smooths lookups, it often ends at better values than the plain fit on which the smoothness was chosen. The
smoothness is then chosen once more there, followed by a plain descent.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from kennfeld.base.arrays import Float
from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.task_runner import RunnerLostError
from kennfeld.base.threads import blas_threads
from kennfeld.optimize.fit.fit import FitRun
from kennfeld.optimize.fit.result import Progress, Result, Seconds, single_start
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.sums.compiled import smoothable
from kennfeld.optimize.tuning.independent_samples import independent_samples
from kennfeld.optimize.tuning.shift_estimation import estimate_shifts
from kennfeld.optimize.tuning.smoothness import SmoothnessChoice, SmoothnessSelection

SAME_END = 1e-4  # relative difference of the costs of two searches that may have ended at the same values

Search = Callable[[Problem, Float | None], Result]


def resolve_automatic(
    problem: Problem, options: Options, progress: Progress | None, read: float, search: Search
) -> Result:
    """Choose the automatic settings of a problem, and search with them.

    Args:
        problem: a problem with automatic shifts or smoothness.
        options: options of the search.
        progress: called after every accepted step.
        read: time in s that reading the data took, for the account of the time.
        search: calibrates a problem without automatic settings; a single search from free values if they are given.
    """
    began = time.perf_counter()
    shifts: dict[str, dict[str, float]] = {}
    sentences = ""
    warnings: tuple[Finding, ...] = ()
    ready = problem
    if problem.unknown_shifts:
        with blas_threads(sum(problem.parameters[name].size for name in problem.free_names)):
            ready, shifts, sentences, warnings = estimate_shifts(problem)
    if ready.automatic_names:
        plain = FitRun(ready, replace(options, continuation="off"), progress, Seconds())
        with blas_threads(plain.exact.values.free):
            result = plain.while_connected(_Smoothing(plain, options, search).result)
    else:
        result = search(ready, None)
    total = time.perf_counter() - began + read
    compiling = result.seconds.compile
    account = Seconds(total, read, compiling, total - read - compiling)
    message = " ".join(part for part in (result.message, sentences) if part)
    warnings = (*warnings, *result.warnings)
    return replace(result, shifts=shifts, message=message, warnings=warnings, seconds=account)


def choose_smoothness(
    run: FitRun, start: Float, limits: LinearLimits, known: SmoothnessChoice | None = None
) -> SmoothnessChoice:
    """Choose the automatic factors of the problem of a run, from a start within the limits, Float[values]."""

    def independent(values: Float) -> float:
        return independent_samples(run.problem, run.parameters(values))

    # steady-state points count as independent
    steady = all(bound.dataset.time is None for bound in run.problem.training)
    samples = None if steady else independent
    return SmoothnessSelection(run.exact, limits, run.options.settings, run.record, samples).run(start, known)


def with_choice(problem: Problem, choice: SmoothnessChoice) -> Problem:
    """Return the problem with the chosen factors."""
    return replace(problem, smoothness={**problem.smoothness, **choice.factors}, restraints=choice.restraints)


@dataclass(frozen=True)
class _Smoothing:
    """A calibration with automatic smoothness; `plain` is the run on whose fits it is chosen."""

    plain: FitRun
    options: Options
    search: Search

    def result(self) -> Result:
        """Return the result of the search, or of a second choice of smoothness and a descent from its end."""
        plain, options = self.plain, self.options
        limits = linear_limits(plain.problem, plain.exact.values)
        start, _ = plain.feasible_start(limits)
        if start is None:  # it cannot be fitted with any factors
            problem = plain.problem
            return self.search(replace(problem, smoothness={n: problem.factors(n) for n in problem.smoothness}), None)
        choice = choose_smoothness(plain, start, limits)
        if choice.fit.status == "stopped":
            stopped = replace(choice.fit, iterations=0, evaluations=0)
            return self._merge(self._run_last(choice, lambda start, limits: stopped), choice)
        begin = None if choice.fit.cut_short or plain.problem.free_axes else choice.fit.values
        result = self.search(with_choice(plain.problem, choice), begin)
        if options.method == "global" or options.steps or plain.problem.limits or result.status == "stopped":
            return self._merge(result, choice)
        end = plain.exact.values.pack(result.parameters)[: start.size]
        # the fit of the choice has ended lower than the search: the smoothness is chosen again from there
        if choice.fit.cost < (1 - SAME_END) * result.cost_after:
            end = choice.fit.values
        elif options.continuation == "off" or not smoothable(plain.problem):
            return self._merge(result, choice)
        try:
            last = choose_smoothness(plain, end, limits, choice)
        except RunnerLostError as error:
            return self._merge(replace(result, status="stopped", message=f"{result.message} {error}."), choice)

        def descend(start: Float, limits: LinearLimits) -> SolverResult:
            report = partial(plain.record, "plain")
            return levenberg_marquardt(plain.objective, last.fit.values, limits, options.settings, report)

        return self._merge(self._run_last(last, descend), last, result)

    def _run_last(self, choice: SmoothnessChoice, search: Callable[[Float, LinearLimits], SolverResult]) -> Result:
        """The result of a last search with the factors of a choice, which the compiled problem has."""
        return self.plain.with_start(with_choice(self.plain.problem, choice)).result(search)

    def _merge(self, result: Result, choice: SmoothnessChoice, before: Result | None = None) -> Result:
        """Add the choice, and the trace and the effort of all searches, to a result."""
        # a last search has the trace of the plain run in its own
        own = [line for line in result.trace if line not in self.plain.trace]
        efforts: list[SolverResult | Result] = [choice.fit, result, *([before] if before else [])]
        search = before or result
        merged = replace(
            result,
            trace=(*self.plain.trace, *(before.trace if before else ()), *own),
            iterations=sum(effort.iterations for effort in efforts),
            evaluations=sum(effort.evaluations for effort in efforts),
            smoothness={**choice.by_direction, **result.smoothness},
            message=f"{result.message} {choice.words}".strip(),
            seconds=search.seconds,
            starts=search.starts,
            resumed=search.resumed,
        )
        return merged if len(merged.starts) > 1 else replace(merged, starts=(single_start(merged),))
