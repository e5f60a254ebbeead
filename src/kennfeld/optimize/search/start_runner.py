"""One start on its way through the steps of a sequence; without a sequence, through a single step."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import InputError
from kennfeld.free_axes import breakpoints_by_name, free_axes, key_of, with_labelled
from kennfeld.free_axes import with_fixed_axes as axes_standing
from kennfeld.optimize.compiled import CompiledProblem
from kennfeld.optimize.fit import FitRun
from kennfeld.optimize.linear_limits import linear_limits
from kennfeld.optimize.objective import LeastSquaresObjective
from kennfeld.optimize.options import Options, Step
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.result import Checkpoint, CheckpointSink, Progress, Seconds, StartResult, TraceLine
from kennfeld.optimize.search.grid_reduction import penalty_ratio, reduced, refined
from kennfeld.optimize.search.step_problem import sequence_problem, step_problem, with_fixed_limits
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, Status, Stop
from kennfeld.optimize.tuning.automatic_settings import choose_smoothness, with_choice
from kennfeld.optimize.tuning.smoothness import SmoothnessChoice
from kennfeld.parameter_set import ParameterSet
from kennfeld.threads import blas_threads

__all__ = ["STOPPED", "StartOutcome", "StartPoint", "StartRunner", "skipped_start", "with_values"]

STOPPED = "Stopped on request; these are the best values so far."

TableValues = Mapping[str, Float]  # by parameter, those that a search may change


@dataclass(frozen=True, eq=False)
class StartPoint:
    """Where a start begins: its values, the values of the start itself, and how far it had come since then."""

    start: int
    values: TableValues
    origin: TableValues
    step: int = 1
    iteration: int = 0


@dataclass(frozen=True, eq=False)
class StartOutcome:
    """Where a start ended, and the factors that its steps chose, by table and axis of the full grid."""

    row: StartResult
    values: TableValues
    smoothness: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


class StartRunner:
    """Takes starts through the steps, one start after the other; what was compiled for one serves the next.

    The end of a start depends on its begin alone, bit for bit, not on the starts before it.
    """

    def __init__(self, problem: Problem, options: Options, ready: FitRun | None = None) -> None:
        """`ready` is a run of the whole problem that was compiled already."""
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

    def climb(self, begin: StartPoint, progress: Progress, keep: CheckpointSink) -> StartOutcome:
        """The end of one start. `progress` and `keep` may raise `Stop`.

        Raises `InputError` where a step leaves nothing to fit. With several starts, all else that goes wrong is a row
        with the status `failed`.
        """
        climbing = _StartState(self, begin, progress, keep)
        with blas_threads(0 if self.options.starts > 1 else sum(v.size for v in begin.values.values())):
            try:
                return climbing.through()
            except InputError:
                raise
            except (Stop, KeyboardInterrupt):
                return climbing.ended("stopped", STOPPED)
            except Exception as error:
                if self.options.starts == 1:
                    raise
                return climbing.ended("failed", f"{type(error).__name__}: {error}")

    def cost(self, values: TableValues) -> float:
        """The cost of the whole problem."""
        if self._whole is None:
            self._whole = (
                CompiledProblem(self.problem) if self.options.steps else self.run(1, self.small(1, values)[0]).exact
            )
        at = replace(self.problem, parameters=with_values(self.problem.parameters, values))
        objective = LeastSquaresObjective(self._whole.moved(at))
        return objective.cost(objective.start)

    def small(self, number: int, values: TableValues) -> tuple[Problem, ParameterSet]:
        """The problem of a step on its grids, from these values, and the parameters on the full grids.

        Limits of outputs are kept by the last step alone: before that, a part of the values may not be able to.
        """
        step, variant = self.steps[number - 1], self._variants[number]
        parameters = with_values(variant.parameters, values)
        limits = variant.limits if number == len(self.steps) else ()
        full = with_fixed_limits(replace(variant, parameters=parameters, limits=limits))
        if self.options.steps:
            full = _with_axes_standing(full, step)
        tables = [name for name in full.free_names if parameters[name].axes]
        return reduced(full, {name: step.reduction(parameters[name]) for name in tables}), parameters

    def run(self, number: int, small: Problem) -> FitRun:
        """The run of the problem of a step, compiled anew only where that is another one."""
        if number not in self._runs or not _alike(self._runs[number].problem, small):
            self._runs[number] = FitRun(small, _options(self.options, self.steps[number - 1]), None, Seconds())
        return self._runs[number].moved(small)

    def choosing(self, number: int, small: Problem) -> FitRun:
        """A run of the problem of a step on which its smoothness is chosen: without continuation."""
        options = replace(_options(self.options, self.steps[number - 1]), continuation="off")
        return FitRun(small, options, None, Seconds())

    def stage(self, number: int, stage: str) -> str:
        """What the trace calls a stage of a step."""
        if not self.options.steps:
            return stage
        return f"{self.steps[number - 1].name or f'step {number}'}: {stage}"


class _StartState:
    """The running state of one start."""

    def __init__(self, climber: StartRunner, begin: StartPoint, progress: Progress, keep: CheckpointSink) -> None:
        self.climber, self.begin, self.progress, self.keep = climber, begin, progress, keep
        self.values = dict(begin.values)
        self.before = self.reached = float("nan")
        self.step, self.count = begin.step, begin.iteration
        self.iterations = self.evaluations = 0
        self.smoothness: dict[str, dict[str, float]] = {}

    def through(self) -> StartOutcome:
        """Take all steps that are left."""
        self.before = self.climber.cost(self.begin.origin)
        last = len(self.climber.steps)
        end = self._take()
        while end.status not in ("stopped", "failed", "infeasible") and self.step < last:
            self.step += 1
            self._save("", float("inf"), self.values)
            end = self._take()
        early = f"{self.climber.stage(self.step, '')}" if self.step < last else ""
        return self.ended(end.status, f"{early}{end.message}")

    def ended(self, status: Status, message: str) -> StartOutcome:
        """The end of the start, here."""
        after = self.climber.cost(self.values)
        row = StartResult(self.begin.start, status, message, self.before, after, self.iterations, self.evaluations)
        if status != "stopped" and np.isfinite(after):
            self.keep(Checkpoint(self.begin.start, self.step, self.count, "end", self.reached, self.values, row))
        return StartOutcome(row, self.values, self.smoothness)

    def _take(self) -> SolverResult:
        """One step, from the values as they are."""
        small, parameters = self.climber.small(self.step, self.values)
        if small.automatic_names:
            plain = self.climber.choosing(self.step, small)
            choice = self._chosen(plain)
            if choice is not None:
                self._take_over(plain, choice, parameters)
                if choice.fit.status == "stopped":
                    return choice.fit
                small = with_choice(replace(small, parameters=plain.parameters(choice.fit.values)), choice)
        run = self.climber.run(self.step, small)

        def watch(line: TraceLine, values: Float) -> None:
            self.count += 1
            every = self.climber.options.save_every
            if every and self.count % every == 0:
                self._save(line.stage, run.objective.cost(values), _refined(run, values, parameters))

        run.watch = watch
        run.progress = self._report
        end, _ = run.end()
        return self._ended(run, end, parameters)

    def _chosen(self, plain: FitRun) -> SmoothnessChoice | None:
        """The factors of a step; None where its limits contradict each other."""
        plain.progress = self._report
        limits = linear_limits(plain.problem, plain.exact.values)
        start, _ = plain.begin(limits)
        return None if start is None else choose_smoothness(plain, start, limits)

    def _take_over(self, plain: FitRun, choice: SmoothnessChoice, parameters: ParameterSet) -> None:
        """The fit on which factors were chosen, and these as they are on the full grids."""
        self._ended(plain, choice.fit, parameters)
        for name, factors in choice.factors.items():
            full, small = parameters[name], plain.problem.parameters[name]
            scaled = [factor * penalty_ratio(full, small, axis) for axis, factor in enumerate(factors)]
            self.smoothness[name] = dict(zip("xyzw", scaled, strict=False))

    def _ended(self, run: FitRun, end: SolverResult, parameters: ParameterSet) -> SolverResult:
        """Take over where a descent ended."""
        self.values |= _refined(run, end.values, parameters)
        self.reached = end.cost
        self.iterations += end.iterations
        self.evaluations += end.evaluations
        return end

    def _report(self, line: TraceLine) -> None:
        self.progress(replace(line, start=self.begin.start, stage=self.climber.stage(self.step, line.stage)))

    def _save(self, stage: str, cost: float, values: TableValues) -> None:
        self.keep(Checkpoint(self.begin.start, self.step, self.count, stage, cost, {**self.values, **values}))


def skipped_start(begin: StartPoint) -> StartOutcome:
    """The end of a start that never began."""
    nothing = float("nan")
    row = StartResult(begin.start, "stopped", "Stopped on request before it began.", nothing, nothing, 0, 0)
    return StartOutcome(row, begin.values)


def with_values(parameters: ParameterSet, values: TableValues) -> ParameterSet:
    """The set with these values, breakpoints among them."""
    tables = [parameters[name].with_values(given) for name, given in values.items() if name in parameters]
    return with_labelled(parameters.with_parameters(*tables), values)


def _with_axes_standing(problem: Problem, step: Step) -> Problem:
    """The problem of a step with the axes standing still that it reduces, or on which a table is not fitted in it."""
    axes = free_axes(problem.parameters)
    still = [
        key
        for key, axis in axes.items()
        if step.reduces or not all(name in problem.free_names for name, _ in axis.places)
    ]
    return replace(problem, parameters=axes_standing(problem.parameters, still))


def _refined(run: FitRun, values: Float, parameters: ParameterSet) -> dict[str, Float]:
    """The values of a step's parameters on the full grids."""
    packed = run.exact.start.copy()
    packed[: values.size] = values
    small = run.exact.values.unpack(packed, run.problem.parameters)
    found = refined(small.select(run.problem.free_names), parameters)
    moved = breakpoints_by_name(run.exact.values.breakpoints(packed, run.problem.parameters))
    return {name: np.asarray(found[name].values) for name in run.problem.free_names} | moved


def _options(options: Options, step: Step) -> Options:
    """The options of one step."""
    own = {name: getattr(step, name) for name in ("max_iterations", "tolerance", "continuation")}
    given = {name: value for name, value in own.items() if value is not None}
    return replace(options, starts=1, steps=(), save_every=0, **given)


def _alike(one: Problem, other: Problem) -> bool:
    """Whether parameters that stand still have the same values, and tables their factors: what is compiled depends on
    them.
    """
    used = list(one.model.graph.parameters)
    fixed = [name for name in used if name not in one.free_names]
    if any(one.factors(name) != other.factors(name) for name in one.free_names):
        return False
    return all(_same_axes(one, other, name) for name in used) and all(
        np.array_equal(one.parameters[name].values, other.parameters[name].values) for name in fixed
    )


def _same_axes(one: Problem, other: Problem, name: str) -> bool:
    """Whether the axes of a table that stand still are where they were."""
    table, moved = one.parameters[name], other.parameters[name]
    return all(
        key_of(table, i) in one.free_axes or np.array_equal(axis.breakpoints, moved.axes[i].breakpoints)
        for i, axis in enumerate(table.axes)
    )
