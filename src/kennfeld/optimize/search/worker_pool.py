"""Starts in worker processes: the pool that distributes them, and the main loop of a worker."""

import pickle
import queue
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NoReturn

from kennfeld.base.arrays import ignore_floating_errors
from kennfeld.base.errors import InputError
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.optimize.fit.result import Checkpoint, CheckpointSink, Progress, TraceLine
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.start_runner import StartOutcome, StartPoint, StartRunner
from kennfeld.optimize.search.worker_process import ParentConnection, WorkerProcess, connect_to_parent
from kennfeld.optimize.solver.levenberg_marquardt import Stop

READY = "ready"
POLL_INTERVAL = 0.1  # s; Windows does not deliver Ctrl-C during a wait without timeout
COMMAND = "import sys; sys.path[:] = {path!r}; from kennfeld.optimize.search.worker_pool import main; main()"


def run_in_parallel(
    problem: Problem,
    options: Options,
    points: Sequence[StartPoint],
    workers: int,
    progress: Progress,
    keep: CheckpointSink,
) -> list[StartOutcome]:
    """Run starts in worker processes.

    `progress` and `keep` are called in this thread; an exception in them ends all starts, `Stop` at their best values.
    A start whose worker dies has failed.

    Returns:
        The outcomes in the order of completion, without starts that no worker could run.
    """
    if getattr(sys, "frozen", False):  # sys.executable is not a Python interpreter
        return []
    try:
        work = pickle_content((replace(problem), options))  # a copy has no cached properties
    # such as functions of the session: the starts then run in this process
    except (pickle.PicklingError, TypeError, AttributeError):
        return []
    pool = _Pool(work, points, workers, progress, keep)
    try:
        return pool.run()
    finally:
        pool.close()


class _Worker(WorkerProcess):
    """A worker process that puts its messages into an inbox, None once the process has ended."""

    def __init__(self, work: bytes, inbox: "queue.SimpleQueue[tuple[_Worker, Any]]") -> None:
        self.point: StartPoint | None = None
        self.ready = False
        self._inbox = inbox
        super().__init__(COMMAND, work)

    def handle(self, message: Any) -> None:
        self._inbox.put((self, message))

    def run_start(self, point: StartPoint) -> None:
        self.point = point
        self.send(point)


class _WorkerUnusableError(Exception):
    """A worker cannot load the problem."""


class _Pool:
    def __init__(
        self, work: bytes, points: Sequence[StartPoint], workers: int, progress: Progress, keep: CheckpointSink
    ) -> None:
        self.work, self.max_workers = work, workers
        self.progress, self.keep = progress, keep
        self.waiting = list(points)
        self.outcomes: list[StartOutcome] = []
        self.workers: list[_Worker] = []
        self.stopping = False
        self.inbox: queue.SimpleQueue[tuple[_Worker, Any]] = queue.SimpleQueue()

    @property
    def busy(self) -> list[_Worker]:
        return [worker for worker in self.workers if worker.point is not None]

    def run(self) -> list[StartOutcome]:
        """Run all starts; return the outcomes so far if a worker cannot load the problem."""
        try:
            while self.waiting or self.busy:
                try:
                    while len(self.workers) < min(self.max_workers, len(self.waiting) + len(self.busy)):
                        self.workers.append(_Worker(self.work, self.inbox))
                    self._handle_message()
                except Stop:
                    self._stop()
                except KeyboardInterrupt:
                    if self.stopping:
                        raise
                    self._stop()
        except (_WorkerUnusableError, OSError):
            pass
        return self.outcomes

    def close(self) -> None:
        for worker in self.workers:
            worker.close()

    def _handle_message(self) -> None:
        try:
            worker, message = self.inbox.get(timeout=POLL_INTERVAL)
        except queue.Empty:
            return
        if message is None:
            self._remove(worker)
        elif isinstance(message, TraceLine):
            self.progress(message)
        elif isinstance(message, Checkpoint):
            self.keep(message)
        # findings of bad input, the same for all starts
        elif isinstance(message, tuple):
            raise InputError(message)
        else:  # the worker is ready, or has run a start
            self.outcomes += [message] if isinstance(message, StartOutcome) else []
            worker.ready, worker.point = True, None
            if self.waiting:
                worker.run_start(self.waiting.pop(0))

    def _remove(self, worker: _Worker) -> None:
        """Remove a worker whose process has ended; its start has failed.

        One that ended before it was ready is not replaced: the next one may end as well.
        """
        self.workers.remove(worker)
        worker.close()
        if not worker.ready:
            self.max_workers -= 1
            if not self.max_workers:
                raise _WorkerUnusableError
        if worker.point is not None:
            message = f"The worker process of this start ended: {worker.describe_end()}."
            self.outcomes.append(worker.point.skip("failed", message))

    def _stop(self) -> None:
        if self.stopping:
            return
        self.stopping = True
        # those that have not begun are skipped, the running ones end at their best values
        self.outcomes += [point.skip() for point in self.waiting]
        self.waiting = []
        for worker in self.busy:
            worker.stop()


def main() -> None:
    """Run a worker: read a problem and start points from stdin, write accepted steps and outcomes to stdout.

    The process ends when its stdin is closed.
    """
    parent = connect_to_parent()
    with ignore_floating_errors():
        try:
            runner = StartRunner(*parent.read_work())
        except Exception:
            sys.exit(1)  # the main process then runs the starts itself
        parent.listen()
        _run_starts(runner, parent)


def _run_starts(runner: StartRunner, parent: ParentConnection) -> NoReturn:
    def report(line: TraceLine) -> None:
        parent.send(line)
        if parent.stopping.is_set():
            raise Stop

    parent.send(READY)
    while True:
        point = parent.messages.get()
        try:
            parent.send(runner.run_start(point, report, parent.send))
        except InputError as error:
            parent.send(error.findings)
