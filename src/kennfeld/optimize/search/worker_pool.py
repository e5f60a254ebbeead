"""Starts in worker processes: the pool that distributes them, and the main loop of a worker.

Workers are fresh interpreters that exchange pickles through pipes, not `multiprocessing` processes: these would run the
user's script again on systems without `fork`, unless it is guarded. A worker that loses its pipe exits, so none
outlives a calibration that is killed. Ctrl-C reaches the main process only, which forwards it to the workers.
"""

import copyreg
import io
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from types import MappingProxyType
from typing import IO, Any

from kennfeld.arrays import ignore_floating_errors
from kennfeld.errors import InputError
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.result import Checkpoint, CheckpointSink, Progress, TraceLine
from kennfeld.optimize.search.start_runner import StartOutcome, StartPoint, StartRunner
from kennfeld.optimize.solver.levenberg_marquardt import Stop

READY, STOP = "ready", "stop"
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
    except (pickle.PicklingError, TypeError, AttributeError):
        return []
    pool = _Pool(work, points, workers, progress, keep)
    try:
        return pool.run()
    finally:
        pool.close()


def pickle_content(content: Any) -> bytes:
    """Pickle content that may contain the read-only mappings of a model."""
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL)
    pickler.dispatch_table = copyreg.dispatch_table | {MappingProxyType: _reduce_proxy}
    pickler.dump(content)
    return stream.getvalue()


def _reduce_proxy(proxy: Mapping[Any, Any]) -> tuple[Callable[..., Any], tuple[dict[Any, Any]]]:
    return _read_only, (dict(proxy),)


def _read_only(mapping: dict[Any, Any]) -> Mapping[Any, Any]:
    return MappingProxyType(mapping)  # the type itself cannot be pickled


class _Worker:
    """A worker process, and the thread that puts its messages into an inbox; None once the process has ended."""

    def __init__(self, work: bytes, inbox: "queue.SimpleQueue[tuple[_Worker, Any]]") -> None:
        session: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            session = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
        command = [sys.executable or "python", "-c", COMMAND.format(path=sys.path)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, **session)
        self.point: StartPoint | None = None
        self.ready = False
        self._thread = threading.Thread(target=self._receive, args=(work, inbox), daemon=True)
        self._thread.start()

    def _receive(self, work: bytes, inbox: "queue.SimpleQueue[tuple[_Worker, Any]]") -> None:
        assert self.process.stdout is not None
        self._write(work)
        with suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while True:
                inbox.put((self, pickle.load(self.process.stdout)))
        inbox.put((self, None))

    def _write(self, content: bytes) -> None:
        assert self.process.stdin is not None
        with suppress(OSError, ValueError):  # a process that has ended is noticed by `_receive`
            self.process.stdin.write(content)
            self.process.stdin.flush()

    def run_start(self, point: StartPoint) -> None:
        self.point = point
        self._write(pickle_content(point))

    def stop(self) -> None:
        """Stop the start at its next step."""
        self._write(pickle_content(STOP))

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self._thread.join()
        for stream in (self.process.stdin, self.process.stdout):
            with suppress(OSError):
                stream.close()  # type: ignore[union-attr]


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
        elif isinstance(message, tuple):
            raise InputError(message)
        else:  # the worker is ready, or has run a start
            self.outcomes += [message] if isinstance(message, StartOutcome) else []
            worker.ready, worker.point = True, None
            if self.waiting:
                worker.run_start(self.waiting.pop(0))

    def _remove(self, worker: _Worker) -> None:
        """Remove a worker whose process has ended; its start has failed."""
        self.workers.remove(worker)
        worker.close()
        if not worker.ready:
            raise _WorkerUnusableError
        if worker.point is not None:
            message = f"The worker process of this start ended with exit status {worker.process.returncode}."
            self.outcomes.append(worker.point.skip("failed", message))

    def _stop(self) -> None:
        if self.stopping:
            return
        self.stopping = True
        self.outcomes += [point.skip() for point in self.waiting]
        self.waiting = []
        for worker in self.busy:
            worker.stop()


def main() -> None:
    """Run a worker: read a problem and start points from stdin, write accepted steps and outcomes to stdout.

    The process ends when its stdin is closed.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    outgoing = os.fdopen(os.dup(1), "wb")
    with suppress(OSError):
        os.dup2(2, 1)  # printed text must not get between the pickles
    with ignore_floating_errors():
        try:
            problem, options = pickle.load(sys.stdin.buffer)
            runner = StartRunner(problem, options)
        except Exception:
            sys.exit(1)  # the main process then runs the starts itself
        _WorkerLoop(runner, sys.stdin.buffer, outgoing).run()


class _WorkerLoop:
    def __init__(self, runner: StartRunner, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self.runner, self.incoming, self.outgoing = runner, incoming, outgoing
        self.points: queue.SimpleQueue[StartPoint] = queue.SimpleQueue()
        self.stopping = threading.Event()

    def run(self) -> None:
        """Run starts until the pipe is closed, which ends the process."""
        threading.Thread(target=self._listen, daemon=True).start()
        self._send(READY)
        while True:
            point = self.points.get()
            try:
                self._send(self.runner.run_start(point, self._report, self._send))
            except InputError as error:
                self._send(error.findings)

    def _listen(self) -> None:
        try:
            while True:
                message = pickle.load(self.incoming)
                if message == STOP:
                    self.stopping.set()
                else:
                    self.points.put(message)
        finally:
            os._exit(0)

    def _report(self, line: TraceLine) -> None:
        self._send(line)
        if self.stopping.is_set():
            raise Stop

    def _send(self, content: Any) -> None:
        try:
            self.outgoing.write(pickle_content(content))
            self.outgoing.flush()
        except OSError:
            os._exit(1)
