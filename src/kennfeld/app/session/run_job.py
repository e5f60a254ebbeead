"""A calibration in a process of its own, so that the page stays responsive and a stop is immediate.

The worker reports accepted steps, and the values of the best one, a few times per second.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field, replace
from typing import Any

from kennfeld.analysis.extrapolation import Extrapolation
from kennfeld.analysis.validation_result import CrossValidation, Kind
from kennfeld.app.session.run_checkpoints import INTERVAL, RunCheckpoints
from kennfeld.base.arrays import Float
from kennfeld.base.dask_runner import ClusterAddress, DaskRunner
from kennfeld.base.errors import Finding, InputError, KennfeldError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.optimize.fit.result import Checkpoint, Result, TraceLine
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.worker_process import ParentConnection, WorkerProcess, connect_to_parent
from kennfeld.optimize.solver.levenberg_marquardt import Stop

STEP_INTERVAL = 0.1  # s between reported steps
VALUES_INTERVAL = 0.5  # s between reported values
COMMAND = "import sys; sys.path[:] = {path!r}; from kennfeld.app.session.run_job import main; main()"


@dataclass(frozen=True)
class Validation:
    """Settings of a cross-validation: number of folds, and how they are formed."""

    folds: int
    kind: Kind = "auto"


@dataclass(frozen=True)
class RunTask:
    """The work of the process of a run.

    Attributes:
        problem: what is calibrated.
        options: how.
        checkpoints: where the run is kept.
        resumed: checkpoints from which it resumes, by the number of the start.
        validation: cross-validate instead of calibrating.
        cluster: where partitions are evaluated, or starts and folds if there are none; None for this process.
    """

    problem: Problem
    options: Options
    checkpoints: RunCheckpoints | None = None
    resumed: Mapping[int, Checkpoint] = field(default_factory=dict)
    validation: Validation | None = None
    cluster: ClusterAddress | None = None


@dataclass(frozen=True)
class Ended:
    """The end of a run: its result or its cross-validation, or why there is none.

    `extrapolation` is the use of surrogates outside their training data, over all samples.
    """

    result: Result | None
    findings: tuple[Finding, ...] = ()
    reason: str = ""
    validation: CrossValidation | None = None
    extrapolation: tuple[Extrapolation, ...] = ()


@dataclass(frozen=True, eq=False)
class BestValues:
    """The values of the best step so far, by parameter."""

    values: Mapping[str, Float] = field(repr=False)


Report = Callable[[TraceLine | BestValues | Ended], None]


class RunJob(WorkerProcess):
    """A running calibration.

    Args:
        task: what is calibrated, and how.
        report: called from another thread with each step, with values, and once with the end.

    Attributes:
        validates: True for a cross-validation, which changes no values.
    """

    def __init__(self, task: RunTask, report: Report) -> None:
        self._report = report
        self._ended = False
        self.validates = task.validation is not None
        plain = replace(task, problem=replace(task.problem))  # a copy has no cached properties
        super().__init__(COMMAND, pickle_content(plain))

    def handle(self, message: Any) -> None:
        if message is None:
            self._close()
            return
        self._report(message)
        if isinstance(message, Ended):
            self._ended = True
            self.kill()

    def _close(self) -> None:
        self.close()
        if not self._ended:
            reason = f"The process of the run ended unexpectedly: {self.describe_end()}."
            self._report(Ended(None, reason=reason))


def main() -> None:
    """Run the worker: read a problem and options from stdin, write steps, values and the end to stdout."""
    parent = connect_to_parent()
    JobWorker(parent.read_work(), parent).run()


class JobWorker:
    def __init__(self, task: RunTask, parent: ParentConnection) -> None:
        self._task, self._parent = task, parent
        self._last_step = self._last_values = self._last_save = 0.0
        self._best = float("inf")
        self._saves = task.checkpoints.saves() if task.checkpoints else None

    def run(self) -> None:
        self._parent.listen()
        self._parent.send(self._end())

    def _end(self) -> Ended:
        validation = self._task.validation
        try:
            with self._joined_cluster():
                return self._calibrate() if validation is None else self._validate(validation)
        except InputError as error:
            return Ended(None, error.findings)
        except KennfeldError as error:
            return Ended(None, reason=f"{error}.")
        except KeyboardInterrupt:
            return Ended(None, reason="Stopped before the first step.")

    @contextmanager
    def _joined_cluster(self) -> Iterator[None]:
        """Evaluate partitions on the cluster of the task, which is left at the end."""
        task = self._task
        if task.cluster is None:
            yield
            return
        runner = DaskRunner.start(task.cluster)
        try:
            if task.problem.partitions is None:
                self._task = replace(task, options=replace(task.options, cluster=runner))
            else:
                partitions = replace(task.problem.partitions, runner=runner)
                self._task = replace(task, problem=replace(task.problem, partitions=partitions))
            yield
        finally:
            runner.close()

    def _calibrate(self) -> Ended:
        from kennfeld.analysis.extrapolation import find_extrapolation
        from kennfeld.optimize.search.multistart import run
        from kennfeld.optimize.tuning.shift_estimation import apply_shifts

        task = self._task
        if self._saves is not None and not task.resumed:
            self._saves.begin()
        # `_keep` sees every step, and decides itself which ones are sent and written
        options = replace(task.options, save_every=1)
        result = run(task.problem, options, self._step, keep=self._keep, resumed=task.resumed)
        _ = result.trust  # computed here, where nobody waits
        problem = apply_shifts(task.problem, result.shifts)
        return Ended(result, extrapolation=find_extrapolation(problem, result.parameters))

    def _validate(self, validation: Validation) -> Ended:
        from kennfeld.analysis.cross_validation import cross_validate

        task, options = self._task, replace(self._task.options, save_every=0)
        folds = cross_validate(
            task.problem, folds=validation.folds, kind=validation.kind, options=options, progress=self._step
        )
        return Ended(None, validation=folds)

    def _step(self, line: TraceLine) -> None:
        now = time.monotonic()
        if now - self._last_step >= STEP_INTERVAL:
            self._last_step = now
            self._parent.send(line)
        if self._parent.stopping.is_set():
            raise Stop

    def _keep(self, saved: Checkpoint) -> None:
        now = time.monotonic()
        if saved.cost < self._best and now - self._last_values >= VALUES_INTERVAL:
            self._best, self._last_values = saved.cost, now
            self._parent.send(BestValues(saved.values))
        self._save(saved, now)

    def _save(self, saved: Checkpoint, now: float) -> None:
        """Write a checkpoint if it is due."""
        if self._saves is None or self._task.checkpoints is None:
            return
        every = self._task.checkpoints.every
        due = saved.iteration % every == 0 if every else now - self._last_save >= INTERVAL
        if due or saved.ended is not None:
            self._last_save = now
            self._saves.keep(saved, self._task.problem.parameters)
