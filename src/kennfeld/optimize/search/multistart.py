"""Calibration from several starts, through the steps of a sequence, and resumed from checkpoints."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Float, ignore_floating_errors
from kennfeld.base.errors import Findings, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import available_cores
from kennfeld.domain.free_axes import breakpoints_by_name
from kennfeld.optimize.fit.fit import FitRun
from kennfeld.optimize.fit.result import Checkpoint, CheckpointSink, Progress, Result, Seconds, TraceLine, single_start
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem, bound_time_constants
from kennfeld.optimize.search.isolated_call import isolated
from kennfeld.optimize.search.problem_digest import problem_digest
from kennfeld.optimize.search.start_runner import StartOutcome, StartPoint, StartRunner, with_values
from kennfeld.optimize.search.starts import distance, draw_start
from kennfeld.optimize.search.step_problem import check_steps, sequence_problem
from kennfeld.optimize.solver.levenberg_marquardt import (
    STOPPED,
    SolverResult,
    Status,
    Stop,
    is_rounding,
)
from kennfeld.optimize.solver.linear_constraints import LinearLimits

COST_TOLERANCE = 1e-9  # relative difference of equal costs, from rounding
SAME_END = 1e-8  # relative difference of the costs of descents that end at the same values, see `SolverSettings`


@isolated
def run(
    problem: Problem,
    options: Options,
    progress: Progress | None = None,
    seconds: Seconds | None = None,
    *,
    keep: CheckpointSink | None = None,
    resumed: Mapping[int, Checkpoint] | None = None,
    begin: Float | None = None,
) -> Result:
    """Calibrate a problem.

    Args:
        problem: the problem.
        options: options of the search.
        progress: called after every accepted step; may raise `Stop`.
        seconds: time spent before, for the account of the time.
        keep: receives every nth accepted parameter set (`options.save_every`), and the end of each start.
        resumed: checkpoints from which to resume, by the number of the start.
        begin: free values at which a single search begins, in place of the start.

    Raises:
        InputError: there is nothing to fit, or a step or a checkpoint does not fit the problem. A search that fails
            later is a `Result` with a status.
    """
    seconds = seconds or Seconds()
    if options.max_seconds is not None:
        progress, options = stop_after(options.max_seconds, progress), replace(options, max_seconds=None)
    with ignore_floating_errors():
        problem = bound_time_constants(problem)
        if problem.unknown_shifts or problem.automatic_names:
            from kennfeld.optimize.tuning.automatic_settings import resolve_automatic

            def search(ready: Problem, begin: Float | None) -> Result:
                return run(ready, options, progress, seconds, keep=keep, resumed=resumed, begin=begin)

            return resolve_automatic(problem, options, progress, seconds.read, search)
        # the plain case needs no copies of the problem and no account of starts
        if options.starts == 1 and not (options.steps or options.save_every or resumed):
            result = FitRun(problem, options, progress, seconds).result(begin=begin)
            return replace(result, starts=(single_start(result),))
        Findings(check_steps(problem, options.steps)).finish()
        return _Multistart(problem, options, progress, keep, resumed or {}).result(seconds)


def stop_after(seconds: float, progress: Progress | None) -> Progress:
    """Return the same progress, but stop the search once a time in s is over."""
    began = time.monotonic()

    def report(line: TraceLine) -> None:
        if progress is not None:
            progress(line)
        if time.monotonic() - began >= seconds:
            raise Stop(f"Stopped after max_seconds = {seconds:g}; these are the best values so far.")

    return report


@dataclass
class _Multistart:
    problem: Problem
    options: Options
    progress: Progress | None
    keep: CheckpointSink | None
    resumed: Mapping[int, Checkpoint]

    def __post_init__(self) -> None:
        self.whole = sequence_problem(self.problem, self.options.steps)
        self.workers = min(self.options.workers or available_cores(), self.options.starts)
        self._cluster = self.options.cluster
        if self.problem.partitions is not None:  # each start uses all workers
            self.workers, self._cluster = 1, None
        self.trace: list[TraceLine] = []
        self.outcomes: dict[int, StartOutcome] = {}
        self.resumed_names: list[str] = []
        self.finished: list[int] = []  # starts that had converged before
        self.without_workers = False  # although several processes were requested
        self.why_stopped = STOPPED
        self.began = time.perf_counter()

    @cached_property
    def digest(self) -> str:
        """The digest of the problem: an end that converged under other bounds, locks or limits is none of this one."""
        return problem_digest(self.whole, self.options)

    def result(self, seconds: Seconds) -> Result:
        # workers and steps compile their own smoothed problems
        separate = self.workers > 1 or self._cluster is not None or bool(self.options.steps)
        options = replace(self.options, continuation="off") if separate else self.options
        ready = FitRun(self.whole, options, None, seconds)
        result = ready.result(lambda start, limits: self._search(ready, start, limits))
        if not self.outcomes:  # the limits contradict each other
            return replace(result, starts=(single_start(result),))
        best = self._best(ready)
        rows = [replace(o.row, distance=distance(o.values, best.values)) for _, o in sorted(self.outcomes.items())]
        trace = sorted(self.trace, key=lambda line: line.start)
        return replace(
            result,
            trace=tuple(trace),
            starts=tuple(rows),
            resumed=tuple(self.resumed_names),
            smoothness={name: dict(factors) for name, factors in best.smoothness.items()},
        )

    def _search(self, ready: FitRun, start: Float, limits: LinearLimits) -> SolverResult:
        """Run all starts and return the best end as values of the whole problem."""
        runner = StartRunner(self.problem, self.options, ready)
        points = list(self._start_points(runner, self._off_saddle(ready, start, limits)))
        if self._cluster is not None and len(points) > 1:
            from kennfeld.optimize.search.cluster_pool import run_on_cluster

            parts = (self._cluster, self.problem, self.options, points)
            self.outcomes |= {o.row.start: o for o in run_on_cluster(*parts, self._report, self._save)}
        elif self.workers > 1 and len(points) > 1:
            from kennfeld.optimize.search.worker_pool import run_in_parallel

            work = (self.problem, self.options, points, self.workers)
            self.outcomes |= {o.row.start: o for o in run_in_parallel(*work, self._report, self._save)}
        # starts that no worker could run, or all of them without workers
        rest = [point for point in points if point.start not in self.outcomes]
        self.without_workers = self.workers > 1 and len(rest) > 1
        self.outcomes |= {o.row.start: o for o in _run_in_turn(runner, rest, self._report, self._save)}
        if not self.trace and all(outcome.row.status == "stopped" for outcome in self.outcomes.values()):
            raise KeyboardInterrupt  # there is nothing to keep yet
        best = self._best(ready)
        # values of a reduced grid, interpolated, may miss limits between grid points
        packed = ready.exact.values.pack(with_values(self.whole.parameters, best.values))[: start.size]
        projected, _ = project(packed, limits)
        values = packed if projected is None else projected
        ready.trace, ready.best = list(self.trace), (best.row.cost_after, values)
        rows = [outcome.row for outcome in self.outcomes.values()]
        effort = (sum(row.iterations for row in rows), sum(row.evaluations for row in rows))
        return SolverResult(values, ready.objective.cost(values), *self._status_and_message(best), *effort)

    def _off_saddle(self, ready: FitRun, start: Float, limits: LinearLimits) -> Mapping[str, Float]:
        """Return the values of the first start if it was moved off a saddle point, else nothing.

        A step that fits a part of the values could not detect a saddle that involves the others.
        """
        projected, _ = project(ready.objective.start, limits)
        if projected is None or np.array_equal(projected, start):
            return {}
        return {name: np.asarray(ready.parameters(start)[name].values) for name in ready.problem.free_names}

    def _start_points(self, runner: StartRunner, first: Mapping[str, Float]) -> Iterator[StartPoint]:
        """Return the points of the starts that are not finished; `first` replaces values of the given start."""
        for number in range(1, self.options.starts + 1):
            drawn = draw_start(self.whole, number, self.options.seed, self.options.spread)
            saved = self.resumed.get(number)
            if saved is None:
                yield StartPoint(number, {**drawn, **first} if number == 1 else drawn, drawn)
                continue
            values = self._saved_values(saved, drawn)
            self.resumed_names.append(saved.name or f"start {number}, iteration {saved.iteration}")
            row, last = saved.ended, len(runner.steps)
            done = False
            if row is not None and row.status == "converged" and saved.problem == self.digest:
                # the saved values may be other ones than those of the end, which their cost tells
                done = abs(runner.cost(values) - row.cost_after) <= COST_TOLERANCE * abs(row.cost_after)
            if row is not None and done and saved.step >= last:
                before = runner.cost(drawn)  # the start itself may be another one
                self.outcomes[number] = StartOutcome(replace(row, cost_before=before), values)
                self.finished.append(number)
            else:
                # a finished step is not repeated: the next one begins at its end
                yield StartPoint(number, values, drawn, min(saved.step + done, last), saved.iteration)

    def _saved_values(self, saved: Checkpoint, drawn: Mapping[str, Float]) -> dict[str, Float]:
        """Return the values of a checkpoint; locked ones are those of the problem."""
        values = {name: saved.values.get(name, own) for name, own in drawn.items()}
        findings = Findings()
        for name, own in drawn.items():
            if values[name].shape != own.shape:
                message = f"{name} has shape {list(values[name].shape)}, but the problem has {list(own.shape)}"
                location = Location(saved.name or f"checkpoint of start {saved.start}")
                findings.error(location, message, "Start again without resuming.")
        findings.finish()
        result = {n: np.where(self.whole.parameters[n].locked, own, values[n]) for n, own in drawn.items()}
        axes = self.whole.free_axes.items()
        own_points = breakpoints_by_name({key: axis.axis.breakpoints for key, axis in axes})
        moved = {n: v for n, v in saved.values.items() if n in own_points and v.shape == own_points[n].shape}
        return result | moved

    def _report(self, line: TraceLine) -> None:
        line = replace(line, seconds=time.perf_counter() - self.began)
        self.trace.append(line)
        if self.progress is not None:
            try:
                self.progress(line)
            except Stop as stop:
                self.why_stopped = str(stop) or STOPPED  # the reason does not reach another process
                raise

    def _save(self, saved: Checkpoint) -> None:
        if self.keep is not None and self.options.save_every:
            self.keep(replace(saved, problem=self.digest))

    def _best(self, ready: FitRun) -> StartOutcome:
        """Return the outcome with the lowest cost; of equal ones the first that converged, preferably the given start.

        Costs that differ by less than a descent can tell, or are all rounding, are equal: their last digits depend on
        the machine.
        """

        def cost(start: int) -> float:
            row = self.outcomes[start].row
            # values that miss limits of outputs may cost less than any that keep them
            usable = np.isfinite(row.cost_after) and row.status != "infeasible"
            return row.cost_after if usable else np.inf

        lowest = min(map(cost, self.outcomes))
        equal = [
            n for n in self.outcomes if cost(n) <= (1 + SAME_END) * lowest or is_rounding(ready.objective, cost(n))
        ]
        return self.outcomes[min(equal, key=lambda n: (self.outcomes[n].row.status != "converged", n))]

    def _status_and_message(self, best: StartOutcome) -> tuple[Status, str]:
        rows = [outcome.row for outcome in self.outcomes.values()]
        stopped = any(row.status == "stopped" for row in rows)
        sentences = [self.why_stopped if stopped else best.row.message]
        if len(rows) > 1:
            failed = [row.message for row in rows if row.status in ("failed", "infeasible")]
            sentences.append(f"Best of {len(rows)} starts: number {best.row.start}.")
            sentences += (
                [f"{len(failed)} of them failed, one with the message: {failed[0].rstrip('.')}."] if failed else []
            )
        if self.without_workers:
            sentences.append("The starts ran sequentially because no worker process could load the problem.")
        sentences += self._describe_resumption()
        return "stopped" if stopped else best.row.status, " ".join(sentences)

    def _describe_resumption(self) -> Iterator[str]:
        """Yield which starts were resumed, which were not repeated, and which began anew."""
        if not self.resumed_names:
            return
        yield f"Resumed from {', '.join(self.resumed_names)}."
        if self.finished:
            yield f"Not repeated, because converged: {_describe_starts(self.finished)}."
        anew = [number for number in range(1, self.options.starts + 1) if number not in self.resumed]
        if anew:
            yield f"Without a checkpoint, begun anew: {_describe_starts(anew)}."


def _describe_starts(numbers: Sequence[int]) -> str:
    return f"start{'s' * (len(numbers) > 1)} {join_names(list(map(str, numbers)))}"


def _run_in_turn(
    runner: StartRunner, points: Sequence[StartPoint], progress: Progress, keep: CheckpointSink
) -> list[StartOutcome]:
    """Run the starts one after the other; none begins after a request to stop."""
    outcomes: list[StartOutcome] = []
    for point in points:
        stopped = bool(outcomes) and outcomes[-1].row.status == "stopped"
        outcomes.append(point.skip() if stopped else runner.run_start(point, progress, keep))
    return outcomes
