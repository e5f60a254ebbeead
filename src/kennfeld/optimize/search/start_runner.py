"""Running a single start through the steps of a sequence, or through one step if there is no sequence."""

from collections.abc import Callable, Mapping
from dataclasses import field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.task_runner import RunnerLostError
from kennfeld.base.threads import blas_threads
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.free_axes import breakpoints_by_name, free_axes, key_of, with_fixed_axes, with_labelled
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.fit.fit import FitRun
from kennfeld.optimize.fit.result import Checkpoint, CheckpointSink, Progress, Seconds, StartResult, TraceLine
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.options import Options, Step
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.step_problem import (
    penalty_ratio,
    reduce_problem,
    refine_parameters,
    sequence_problem,
    step_problem,
    with_fixed_limits,
)
from kennfeld.optimize.solver.levenberg_marquardt import STOPPED, SolverResult, Status, Stop
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective

if TYPE_CHECKING:
    from kennfeld.optimize.tuning.smoothness import SmoothnessChoice

SKIPPED = "Stopped on request before it began."
TableValues = Mapping[str, Float]  # by parameter that a search may change


@dataclass(frozen=True, eq=False)
class StartPoint:
    """Point at which a start begins or resumes; `origin` are the values of the start itself."""

    start: int
    values: TableValues
    origin: TableValues
    step: int = 1
    iteration: int = 0

    def skip(self, status: Status = "stopped", message: str = SKIPPED) -> "StartOutcome":
        """Return the outcome of a start that did not run to an end."""
        unknown = float("nan")
        return StartOutcome(StartResult(self.start, status, message, unknown, unknown, 0, 0), self.values)


@dataclass(frozen=True, eq=False)
class StartOutcome:
    """End of a start, with the smoothness factors chosen by its steps, by table and axis of the full grid."""

    row: StartResult
    values: TableValues
    smoothness: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


class StartRunner:
    """Runs starts one after the other through all steps, and reuses compiled problems.

    The result of a start depends on its start point alone, bit for bit, not on the starts before it.

    Args:
        problem: the problem.
        options: options, with the steps of the sequence.
        ready: a compiled run of the whole problem, if there is one.
    """

    def __init__(self, problem: Problem, options: Options, ready: FitRun | None = None) -> None:
        self.problem = sequence_problem(problem, options.steps)
        self.options = options
        self.steps = options.steps or (Step(),)
        self._variants = {i: step_problem(problem, step) for i, step in enumerate(options.steps, 1)} or {1: problem}
        self._runs: dict[int, FitRun] = {}
        self._whole: CompiledProblem | None = None
        if ready is not None:
            self._whole = ready.exact
            if not options.steps and ready.options.continuation == options.continuation:
                self._runs[1] = ready

    def run_start(self, point: StartPoint, progress: Progress, keep: CheckpointSink) -> StartOutcome:
        """Run one start through all its steps; `progress` and `keep` may raise `Stop`.

        With several starts, any other error gives an outcome with the status `failed`.

        Raises:
            InputError: a step leaves nothing to fit.
        """
        state = _StartState(self, point, progress, keep)
        # with several starts, one BLAS thread each: their processes share the cores
        with blas_threads(0 if self.options.starts > 1 else sum(v.size for v in point.values.values())):
            try:
                return state.run()
            except InputError:
                raise
            except (Stop, KeyboardInterrupt) as request:
                return state.finish("stopped", str(request) or STOPPED)
            except RunnerLostError as error:
                return state.finish_without_data(str(error))
            except Exception as error:
                # a single start has no others that could go on: the error is the result
                if self.options.starts == 1:
                    raise
                return state.finish("failed", f"{type(error).__name__}: {error}")

    def cost(self, values: TableValues) -> float:
        """Return the cost of the whole problem."""
        if self._whole is None and self.options.steps:
            self._whole = CompiledProblem(self.problem)
        elif self._whole is None:
            self._whole = self.run(1, self.small(1, values)[0]).exact
        # the whole problem judges, so that starts and steps are compared by one cost
        at = replace(self.problem, parameters=with_values(self.problem.parameters, values))
        objective = LeastSquaresObjective(self._whole.with_start(at))
        return objective.cost(objective.start)

    def small(self, number: int, values: TableValues) -> tuple[Problem, ParameterSet]:
        """Return the problem of a step on its reduced grids, starting at `values`, and its parameters on full grids.

        Only the last step has limits of outputs: the values that are free in an earlier one may be unable to keep them.
        """
        step, variant = self.steps[number - 1], self._variants[number]
        parameters = with_values(variant.parameters, values)
        limits = variant.limits if number == len(self.steps) else ()
        full = with_fixed_limits(replace(variant, parameters=parameters, limits=limits))
        if self.options.steps:
            full = _with_fixed_step_axes(full, step)
        tables = [name for name in full.free_names if parameters[name].axes]
        return reduce_problem(full, {name: step.reduction(parameters[name]) for name in tables}), parameters

    def run(self, number: int, small: Problem) -> FitRun:
        """Return the run of the problem of a step, recompiled only if the compiled one cannot be reused."""
        if number not in self._runs or not _is_reusable(self._runs[number].problem, small):
            self._runs[number] = FitRun(small, self.step_options(number), None, Seconds())
        return self._runs[number].with_start(small)

    def step_options(self, number: int) -> Options:
        """Return the options of one step."""
        step = self.steps[number - 1]
        settings = {name: getattr(step, name) for name in ("max_iterations", "tolerance", "continuation")}
        own = {name: value for name, value in settings.items() if value is not None}
        return replace(self.options, starts=1, steps=(), save_every=0, **own)

    def stage(self, number: int, stage: str) -> str:
        """Return the name of a stage of a step in the trace."""
        return f"{self.steps[number - 1].name or f'step {number}'}: {stage}" if self.options.steps else stage


class _StartState:
    def __init__(self, runner: StartRunner, point: StartPoint, progress: Progress, keep: CheckpointSink) -> None:
        self.runner, self.point, self.progress, self.keep = runner, point, progress, keep
        self.values = dict(point.values)
        self.cost_before = self.step_cost = float("nan")
        self.step, self.count = point.step, point.iteration
        self.iterations = self.evaluations = 0
        self.smoothness: dict[str, dict[str, float]] = {}
        self._latest: Callable[[], tuple[float, TableValues]] = lambda: (float("nan"), {})

    def run(self) -> StartOutcome:
        self.cost_before = self.runner.cost(self.point.origin)
        last = len(self.runner.steps)
        end = self._run_step()
        while not end.cut_short and end.status != "infeasible" and self.step < last:
            self.step += 1
            # a start that is resumed from here begins the next step; the cost is unknown there
            self._save("", float("inf"), self.values)
            end = self._run_step()
        stage = self.runner.stage(self.step, "") if self.step < last else ""
        return self.finish(end.status, f"{stage}{end.message}")

    def finish(self, status: Status, message: str) -> StartOutcome:
        after = self.runner.cost(self.values)
        row = StartResult(self.point.start, status, message, self.cost_before, after, self.iterations, self.evaluations)
        # a start that was stopped has not ended, and resumes from its last saved values
        if status != "stopped" and np.isfinite(after):
            self.keep(Checkpoint(self.point.start, self.step, self.count, "end", self.step_cost, self.values, row))
        return StartOutcome(row, self.values, self.smoothness)

    def _best_values(self, run: FitRun, parameters: ParameterSet) -> tuple[float, TableValues]:
        if run.best is None:
            return self.cost_before, {}
        return run.best[0], _values_on_full_grids(run, run.best[1], parameters)

    def finish_without_data(self, message: str) -> StartOutcome:
        """Return the best values so far; their cost cannot be evaluated any more."""
        cost, values = self._latest()
        self.values |= values
        row = StartResult(self.point.start, "stopped", message, self.cost_before, cost, self.count, self.count)
        return StartOutcome(row, self.values, self.smoothness)

    def _run_step(self) -> SolverResult:
        small, parameters = self.runner.small(self.step, self.values)
        if small.automatic_names:
            options = replace(self.runner.step_options(self.step), continuation="off")
            plain = FitRun(small, options, self._report, Seconds())
            choice = self._choose_smoothness(plain, parameters)
            if choice is not None:
                if choice.fit.status == "stopped":
                    return choice.fit
                from kennfeld.optimize.tuning.automatic_settings import with_choice

                small = with_choice(replace(small, parameters=plain.parameters(choice.fit.values)), choice)
        run = self.runner.run(self.step, small)

        def watch(line: TraceLine, values: Float) -> None:
            self.count += 1
            every = self.runner.options.save_every
            if every and self.count % every == 0:
                self._save(line.stage, run.objective.cost(values), _values_on_full_grids(run, values, parameters))

        self._latest = partial(self._best_values, run, parameters)
        run.watch = watch
        run.progress = self._report
        end, _ = run.minimise()
        return self._record_end(run, end, parameters)

    def _choose_smoothness(self, plain: FitRun, parameters: ParameterSet) -> "SmoothnessChoice | None":
        """Choose the factors of a step and record them converted to the full grids; None if its limits contradict."""
        limits = linear_limits(plain.problem, plain.exact.values)
        start, _ = plain.feasible_start(limits)
        if start is None:
            return None
        from kennfeld.optimize.tuning.automatic_settings import choose_smoothness

        choice = choose_smoothness(plain, start, limits)
        self._record_end(plain, choice.fit, parameters)
        for name, factors in choice.factors.items():
            full, small = parameters[name], plain.problem.parameters[name]
            # factors are stated as they are on the full grid
            scaled = [factor * penalty_ratio(full, small, axis) for axis, factor in enumerate(factors)]
            self.smoothness[name] = dict(zip(AXIS_LETTERS, scaled, strict=False))
        return choice

    def _record_end(self, run: FitRun, end: SolverResult, parameters: ParameterSet) -> SolverResult:
        self.values |= _values_on_full_grids(run, end.values, parameters)
        self.step_cost = end.cost
        self.iterations += end.iterations
        self.evaluations += end.evaluations
        return end

    def _report(self, line: TraceLine) -> None:
        self.progress(replace(line, start=self.point.start, stage=self.runner.stage(self.step, line.stage)))

    def _save(self, stage: str, cost: float, values: TableValues) -> None:
        self.keep(Checkpoint(self.point.start, self.step, self.count, stage, cost, {**self.values, **values}))


def with_values(parameters: ParameterSet, values: TableValues) -> ParameterSet:
    """Return the parameters with these values and breakpoints."""
    tables = [parameters[name].with_values(array) for name, array in values.items() if name in parameters]
    return with_labelled(parameters.with_parameters(*tables), values)


def _with_fixed_step_axes(problem: Problem, step: Step) -> Problem:
    """Fix the axes that the step reduces, or on which it does not fit all tables."""
    free, axes = problem.free_names, free_axes(problem.parameters)
    fixed = [key for key, axis in axes.items() if step.reduces or not all(name in free for name, _ in axis.places)]
    return replace(problem, parameters=with_fixed_axes(problem.parameters, fixed))


def _values_on_full_grids(run: FitRun, values: Float, parameters: ParameterSet) -> dict[str, Float]:
    """Return the values of the parameters of a step, and its breakpoints."""
    small = run.parameters(values).select(run.problem.free_names)
    full = refine_parameters(small, parameters)
    moved = breakpoints_by_name(run.exact.values.breakpoints(run.exact.full(values), run.problem.parameters))
    return {name: np.asarray(full[name].values) for name in run.problem.free_names} | moved


def _is_reusable(compiled: Problem, problem: Problem) -> bool:
    """Return True if both have the fixed values, fixed axes and smoothness factors on which compiled code depends."""
    for name in compiled.model.graph.parameters:
        table, other = compiled.parameters[name], problem.parameters[name]
        if name not in compiled.free_names and not np.array_equal(table.values, other.values):
            return False
        for i, axis in enumerate(table.axes):
            moving = key_of(table, i) in compiled.free_axes
            if not moving and not np.array_equal(axis.breakpoints, other.axes[i].breakpoints):
                return False
    return all(compiled.factors(name) == problem.factors(name) for name in compiled.free_names)
