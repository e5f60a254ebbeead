"""A calibration from several starts, through the steps of a sequence, and on from where it was saved."""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float, silent
from kennfeld.errors import Finding, InputError
from kennfeld.free_axes import breakpoints_by_name
from kennfeld.optimize import fit
from kennfeld.optimize.fit import FitRun
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem, bound_time_constants
from kennfeld.optimize.projection import project
from kennfeld.optimize.result import Checkpoint, CheckpointSink, Progress, Result, Seconds, StartResult, TraceLine
from kennfeld.optimize.search.start_runner import (
    STOPPED,
    StartOutcome,
    StartPoint,
    StartRunner,
    skipped_start,
    with_values,
)
from kennfeld.optimize.search.starts import distance, drawn_start
from kennfeld.optimize.search.step_problem import check_steps, sequence_problem
from kennfeld.optimize.solver.levenberg_marquardt import SolverResult, Status
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.threads import blas_threads

__all__ = ["run"]

SAME = 1e-9  # relative difference of two costs that is rounding


def run(
    problem: Problem,
    options: Options,
    progress: Progress | None = None,
    seconds: Seconds | None = None,
    *,
    keep: CheckpointSink | None = None,
    resumed: Mapping[int, Checkpoint] | None = None,
) -> Result:
    """Calibrate. `progress` hears of every accepted step and may raise `Stop`.

    `keep` gets every nth accepted parameter set, as `options.save_every` says, and where each start ended. `resumed`
    are saved states by the number of their start; those starts go on from there. Raises `InputError` where there is
    nothing to fit, or a step or a saved state does not suit the problem. All that can happen afterwards is a status.
    """
    with silent():
        return _run(problem, options, progress, seconds or Seconds(), keep, resumed)


def _run(
    problem: Problem,
    options: Options,
    progress: Progress | None,
    seconds: Seconds,
    keep: CheckpointSink | None,
    resumed: Mapping[int, Checkpoint] | None,
) -> Result:
    problem = bound_time_constants(problem)
    if problem.unknown_shifts or problem.automatic_names:
        from kennfeld.optimize.tuning.automatic_settings import (
            resolve_automatic,  # only here: many runs have nothing to decide
        )

        return resolve_automatic(
            problem,
            options,
            progress,
            seconds.read,
            lambda ready: run(ready, options, progress, seconds, keep=keep, resumed=resumed),
        )
    if options.starts == 1 and not (options.steps or options.save_every or resumed):
        result = fit.run(problem, options, progress, seconds)
        return replace(result, starts=(_row(result),))
    findings = check_steps(problem, options.steps)
    if findings:
        raise InputError(findings)
    return _Multistart(problem, options, progress, keep, resumed or {}).result(seconds)


def _row(result: Result) -> StartResult:
    """The only start."""
    costs, effort = (result.cost_before, result.cost_after), (result.iterations, result.evaluations)
    return StartResult(1, result.status, result.message, *costs, *effort, distance=0.0)


class _Multistart:
    """The running state of a calibration from several starts."""

    def __init__(
        self,
        problem: Problem,
        options: Options,
        progress: Progress | None,
        keep: CheckpointSink | None,
        resumed: Mapping[int, Checkpoint],
    ) -> None:
        self.problem, self.options, self.progress, self.keep = problem, options, progress, keep
        self.resumed = resumed
        self.whole = sequence_problem(problem, options.steps)
        self.workers = min(options.workers or _cores(), options.starts)
        self.trace: list[TraceLine] = []
        self.climbs: dict[int, StartOutcome] = {}
        self.went_on: list[str] = []
        self.alone = False  # although several processes were wanted
        self.began = time.perf_counter()

    def result(self, seconds: Seconds) -> Result:
        elsewhere = self.workers > 1 or bool(self.options.steps)
        options = replace(self.options, continuation="off") if elsewhere else self.options
        ready = FitRun(self.whole, options, None, seconds)
        with blas_threads(ready.exact.values.free):
            result = ready.result(lambda start, limits: self._search(ready, start, limits))
        if not self.climbs:  # the limits contradict each other
            return replace(result, starts=(_row(result),))
        best = self._best()
        rows = [replace(c.row, distance=distance(c.values, best.values)) for _, c in sorted(self.climbs.items())]
        trace = sorted(self.trace, key=lambda line: line.start)
        return replace(
            result,
            trace=tuple(trace),
            starts=tuple(rows),
            resumed=tuple(self.went_on),
            smoothness={name: dict(factors) for name, factors in best.smoothness.items()},
        )

    def _search(self, ready: FitRun, start: Float, limits: LinearLimits) -> SolverResult:
        """The best end of all starts, as values of the whole problem."""
        climber = StartRunner(self.problem, self.options, ready)
        begins = list(self._begins(climber, self._off_saddle(ready, start, limits)))
        if self.workers > 1 and len(begins) > 1:
            from kennfeld.optimize.search.worker_pool import climb_in_parallel

            work = (self.problem, self.options, begins, self.workers)
            self.climbs |= {c.row.start: c for c in climb_in_parallel(*work, self._report, self._save)}
        left = [begin for begin in begins if begin.start not in self.climbs]
        self.alone = self.workers > 1 and len(left) > 1
        self.climbs |= {c.row.start: c for c in _climb_in_turn(climber, left, self._report, self._save)}
        if not self.trace and all(climb.row.status == "stopped" for climb in self.climbs.values()):
            raise KeyboardInterrupt  # there is nothing to keep yet
        best = self._best()
        packed = ready.exact.values.pack(with_values(self.whole.parameters, best.values))[: start.size]
        held, _ = project(packed, limits)
        values = packed if held is None else held
        return SolverResult(values, ready.objective.cost(values), *self._words(best), *self._effort())

    def _off_saddle(self, ready: FitRun, start: Float, limits: LinearLimits) -> Mapping[str, Float]:
        """The values of the first start where the given ones could not move; empty where they can.

        A step that fits a part of the values would not see what the others could do to them.
        """
        given, _ = project(ready.objective.start, limits)
        if given is None or np.array_equal(given, start):
            return {}
        parameters = ready.parameters(start)
        return {name: np.asarray(parameters[name].values) for name in ready.problem.free_names}

    def _begins(self, climber: StartRunner, first: Mapping[str, Float]) -> Iterator[StartPoint]:
        """Where the starts begin that have not come to their end yet; `first` replaces values of the given start."""
        for number in range(1, self.options.starts + 1):
            drawn = drawn_start(self.whole, number, self.options.seed, self.options.spread)
            saved = self.resumed.get(number)
            if saved is None:
                yield StartPoint(number, {**drawn, **first} if number == 1 else drawn, drawn)
                continue
            values = self._saved_values(saved, drawn)
            self.went_on.append(saved.name or f"start {number}, iteration {saved.iteration}")
            row, last = saved.ended, len(climber.steps)
            done = row is not None and row.status == "converged" and _same(climber.cost(values), row.cost_after)
            if row is not None and done and saved.step >= last:
                self.climbs[number] = StartOutcome(row, values)
            else:
                yield StartPoint(number, values, drawn, min(saved.step + done, last), saved.iteration)

    def _saved_values(self, saved: Checkpoint, drawn: Mapping[str, Float]) -> dict[str, Float]:
        """The values to go on from; locked ones are those of the problem."""
        found, findings = {}, []
        for name, own in drawn.items():
            values = saved.values.get(name, own)
            if values.shape != own.shape:
                what = f"{name} has values of shape {list(values.shape)}; the problem asks for {list(own.shape)}"
                findings.append(
                    Finding(saved.name or f"saved start {saved.start}", what, "Start anew, without resuming.")
                )
                continue
            found[name] = np.where(self.whole.parameters[name].locked, own, values)
        if findings:
            raise InputError(findings)
        axes = self.whole.free_axes.items()
        own_points = breakpoints_by_name({key: axis.axis.breakpoints for key, axis in axes})
        moved = {n: v for n, v in saved.values.items() if n in own_points and v.shape == own_points[n].shape}
        return found | moved

    def _report(self, line: TraceLine) -> None:
        line = replace(line, seconds=time.perf_counter() - self.began)
        self.trace.append(line)
        if self.progress is not None:
            self.progress(line)

    def _save(self, saved: Checkpoint) -> None:
        if self.keep is not None and self.options.save_every:
            self.keep(saved)

    def _best(self) -> StartOutcome:
        """The end of the lowest cost; of equal ones the first."""
        return min((climb for _, climb in sorted(self.climbs.items())), key=_rank)

    def _words(self, best: StartOutcome) -> tuple[Status, str]:
        """Status and message of all starts together."""
        rows = [climb.row for climb in self.climbs.values()]
        stopped = any(row.status == "stopped" for row in rows)
        said = [STOPPED if stopped else best.row.message]
        if len(rows) > 1:
            failed = sum(row.status in ("failed", "infeasible") for row in rows)
            said.append(f"Best of {len(rows)} starts: number {best.row.start}.")
            said += [f"{failed} of them failed."] if failed else []
        said += ["The starts ran one after the other: no other process could take the problem."] if self.alone else []
        said += [f"Resumed from {', '.join(self.went_on)}."] if self.went_on else []
        return "stopped" if stopped else best.row.status, " ".join(said)

    def _effort(self) -> tuple[int, int]:
        """Accepted steps and evaluations of all starts."""
        rows = [climb.row for climb in self.climbs.values()]
        return sum(row.iterations for row in rows), sum(row.evaluations for row in rows)


def _climb_in_turn(
    climber: StartRunner, begins: Sequence[StartPoint], progress: Progress, keep: CheckpointSink
) -> list[StartOutcome]:
    """The ends of all starts, one after the other; none begins after a request to stop."""
    ends: list[StartOutcome] = []
    for begin in begins:
        stopped = bool(ends) and ends[-1].row.status == "stopped"
        ends.append(skipped_start(begin) if stopped else climber.climb(begin, progress, keep))
    return ends


def _rank(climb: StartOutcome) -> float:
    cost = climb.row.cost_after
    return cost if np.isfinite(cost) and climb.row.status != "infeasible" else np.inf


def _same(one: float, other: float) -> bool:
    return abs(one - other) <= SAME * abs(other)


def _cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
