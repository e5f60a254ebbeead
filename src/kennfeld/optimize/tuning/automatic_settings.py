"""What a calibration decides from the data before it begins: shifts of channels, and smoothness.

The search itself then has numbers only. Where it smooths lookups, its end is often a better one than the plain fit had
on which the smoothness was chosen; so that is chosen once more there, and a plain descent follows.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from kennfeld.arrays import Float
from kennfeld.optimize.fit import FitRun
from kennfeld.optimize.linear_limits import linear_limits
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.result import Progress, Result, Seconds, StartResult
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, levenberg_marquardt
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.tuning.holdout_blocks import independent_samples
from kennfeld.optimize.tuning.shift_estimation import with_shifts_found
from kennfeld.optimize.tuning.smoothness import SmoothnessChoice, select_factors
from kennfeld.threads import blas_threads

__all__ = ["choose_smoothness", "resolve_automatic", "with_choice"]

Search = Callable[[Problem], Result]


def resolve_automatic(
    problem: Problem, options: Options, progress: Progress | None, read: float, search: Search
) -> Result:
    """Decide what the problem leaves open, and search with that; `search` calibrates a problem of numbers.

    `read` is how long reading took, in s, for the account of the time.
    """
    began = time.perf_counter()
    shifts: dict[str, dict[str, float]] = {}
    said = ""
    ready = problem
    if problem.unknown_shifts:
        with blas_threads(sum(problem.parameters[name].size for name in problem.free_names)):
            ready, shifts, said = with_shifts_found(problem)
    result = _smoothed(ready, options, progress, search) if ready.automatic_names else search(ready)
    total = time.perf_counter() - began + read
    compiling = result.seconds.compile
    spent = Seconds(total, read, compiling, total - read - compiling)
    message = " ".join(part for part in (result.message, said) if part)
    return replace(result, shifts=shifts, message=message, seconds=spent)


def choose_smoothness(
    run: FitRun, start: Float, limits: LinearLimits, known: SmoothnessChoice | None = None
) -> SmoothnessChoice:
    """The automatic factors of a run's problem, chosen from a start that keeps the limits."""

    def independent(values: Float) -> float:
        return independent_samples(run.problem, run.scorer.errors, run.parameters(values))

    steady = all(bound.dataset.time is None for bound in run.problem.training)
    return select_factors(
        run.exact, start, limits, run.options.settings, run._report, known, None if steady else independent
    )


def with_choice(problem: Problem, choice: SmoothnessChoice) -> Problem:
    """The problem with the factors chosen."""
    return replace(problem, smoothness={**problem.smoothness, **choice.factors}, restraints=choice.restraints)


def _smoothed(problem: Problem, options: Options, progress: Progress | None, search: Search) -> Result:
    plain = FitRun(problem, replace(options, continuation="off"), progress, Seconds())
    with blas_threads(plain.exact.values.free):
        return _Smoothing(plain, options, search).result()


@dataclass(frozen=True)
class _Smoothing:
    """A calibration with automatic smoothness; `plain` is the run on whose fits it is chosen."""

    plain: FitRun
    options: Options
    search: Search

    def result(self) -> Result:
        """The end of the search, of a search from there, or of the fit on which smoothness was chosen."""
        plain, options = self.plain, self.options
        limits = linear_limits(plain.problem, plain.exact.values)
        start, _ = plain.begin(limits)
        if start is None:
            return self.search(_with_none(plain.problem))
        choice = choose_smoothness(plain, start, limits)
        if choice.fit.status == "stopped":
            stopped = replace(choice.fit, iterations=0, evaluations=0)
            return self._together(self._ended(choice, lambda start, limits: stopped), choice)
        found = self.search(with_choice(plain.problem, choice))
        if options.method == "global" or options.steps or plain.problem.limits or found.status == "stopped":
            return self._together(found, choice)
        end = plain.exact.values.pack(found.parameters)[: start.size]
        if choice.fit.cost < found.cost_after:
            end = choice.fit.values
        elif options.continuation == "off":
            return self._together(found, choice)
        last = choose_smoothness(plain, end, limits, choice)
        return self._together(self._polished(last), last, found)

    def _polished(self, choice: SmoothnessChoice) -> Result:
        """The descent with the factors chosen last, from the fit on which they were chosen."""
        settings = self.options.settings

        def descend(start: Float, limits: LinearLimits) -> SolverResult:
            report = partial(self.plain._report, "plain")
            return levenberg_marquardt(self.plain.objective, choice.fit.values, limits, settings, report)

        return self._ended(choice, descend)

    def _ended(self, choice: SmoothnessChoice, search: Callable[[Float, LinearLimits], SolverResult]) -> Result:
        """The result of a last search with the factors of a choice, which the compiled problem has."""
        return self.plain.moved(with_choice(self.plain.problem, choice)).result(search)

    def _together(self, result: Result, choice: SmoothnessChoice, before: Result | None = None) -> Result:
        """A result with what was chosen, and with trace and effort of all searches."""
        own = [line for line in result.trace if line not in self.plain.trace]
        trace = (*self.plain.trace, *(() if before is None else before.trace), *own)
        iterations = choice.fit.iterations + result.iterations + (0 if before is None else before.iterations)
        evaluations = choice.fit.evaluations + result.evaluations + (0 if before is None else before.evaluations)
        made = replace(
            result,
            trace=trace,
            iterations=iterations,
            evaluations=evaluations,
            smoothness={**choice.by_direction, **result.smoothness},
            message=f"{result.message} {choice.words}".strip(),
            seconds=result.seconds if before is None else before.seconds,
            starts=result.starts if before is None else before.starts,
            resumed=result.resumed if before is None else before.resumed,
        )
        return made if len(made.starts) > 1 else replace(made, starts=(_row(made),))


def _row(result: Result) -> StartResult:
    """The only start."""
    costs, effort = (result.cost_before, result.cost_after), (result.iterations, result.evaluations)
    return StartResult(1, result.status, result.message, *costs, *effort, distance=0.0)


def _with_none(problem: Problem) -> Problem:
    """The problem without automatic smoothness, for a start that cannot be fitted."""
    return replace(problem, smoothness={name: problem.factors(name) for name in problem.smoothness})
