"""Starts in several processes: the side that calculates them. See `workers.py`.

Starts in several processes: the side that hands them out.

Workers are fresh interpreters that speak pickles through their pipes, not `multiprocessing` processes: these would run
the user's script again on systems without `fork`, unless it is guarded. A worker that loses its pipe ends itself, so
none outlives a calibration that is killed. Ctrl-C reaches this process alone, which tells the workers.
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

from kennfeld.arrays import silent
from kennfeld.errors import InputError
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.result import Checkpoint, CheckpointSink, Progress, StartResult, TraceLine
from kennfeld.optimize.search.start_runner import StartOutcome, StartPoint, StartRunner, skipped_start
from kennfeld.optimize.solver.levenberg_marquardt import Stop

__all__ = ["climb_in_parallel"]

READY, STOP = "ready", "stop"
PAUSE = 0.1  # s between looks at Ctrl-C: where a wait has no end, Windows does not deliver it
COMMAND = "import sys; sys.path[:] = {path!r}; from kennfeld.optimize.search.worker_pool import main; main()"


def climb_in_parallel(
    problem: Problem,
    options: Options,
    begins: Sequence[StartPoint],
    workers: int,
    progress: Progress,
    keep: CheckpointSink,
) -> list[StartOutcome]:
    """The ends of the starts, in the order in which they came; without those that no worker could take.

    `progress` and `keep` are called in this thread; what they raise ends all starts, `Stop` at their best values. A
    start whose worker dies has failed.
    """
    if getattr(sys, "frozen", False):  # the program is no interpreter
        return []
    try:
        work = pickled((replace(problem), options))  # a copy is without what was computed from it
    except (pickle.PicklingError, TypeError, AttributeError):
        return []
    pool = _Pool(work, begins, workers, progress, keep)
    try:
        return pool.ends()
    finally:
        pool.close()


def pickled(content: Any) -> bytes:
    """The content as a pickle; a model's read-only mappings are allowed, which pickle alone does not know."""
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL)
    pickler.dispatch_table = copyreg.dispatch_table | {MappingProxyType: _plain}
    pickler.dump(content)
    return stream.getvalue()


def _plain(proxy: Mapping[Any, Any]) -> tuple[Callable[..., Any], tuple[dict[Any, Any]]]:
    return _read_only, (dict(proxy),)


def _read_only(mapping: dict[Any, Any]) -> Mapping[Any, Any]:
    return MappingProxyType(mapping)


class _Worker:
    """One process, and the thread that hears it; what it says goes to an inbox, None once it has gone."""

    def __init__(self, work: bytes, inbox: "queue.SimpleQueue[tuple[_Worker, Any]]") -> None:
        apart: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
        command = [sys.executable or "python", "-c", COMMAND.format(path=sys.path)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, **apart)
        self.begin: StartPoint | None = None
        self.ready = False
        self._thread = threading.Thread(target=self._hear, args=(work, inbox), daemon=True)
        self._thread.start()

    def _hear(self, work: bytes, inbox: "queue.SimpleQueue[tuple[_Worker, Any]]") -> None:
        assert self.process.stdout is not None
        self._write(work)
        with suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while True:
                inbox.put((self, pickle.load(self.process.stdout)))
        inbox.put((self, None))

    def _write(self, content: bytes) -> None:
        """A worker that has gone is noticed by its silence."""
        assert self.process.stdin is not None
        with suppress(OSError, ValueError):
            self.process.stdin.write(content)
            self.process.stdin.flush()

    def take(self, begin: StartPoint) -> None:
        """Hand it a start."""
        self.begin = begin
        self._write(pickled(begin))

    def stop(self) -> None:
        """End its descent at its next step."""
        self._write(pickled(STOP))

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self.process.kill()
        self.process.wait()
        self._thread.join()
        for stream in (self.process.stdin, self.process.stdout):
            with suppress(OSError):
                stream.close()  # type: ignore[union-attr]


class _Gone(Exception):  # noqa: N818
    """A worker cannot take the problem."""


class _Pool:
    """Workers, and the starts that they are given."""

    def __init__(
        self, work: bytes, begins: Sequence[StartPoint], workers: int, progress: Progress, keep: CheckpointSink
    ) -> None:
        self.work, self.most = work, workers
        self.progress, self.keep = progress, keep
        self.waiting = list(begins)
        self.found: list[StartOutcome] = []
        self.workers: list[_Worker] = []
        self.stopping = False
        self.inbox: queue.SimpleQueue[tuple[_Worker, Any]] = queue.SimpleQueue()

    @property
    def busy(self) -> list[_Worker]:
        """The workers that have a start."""
        return [worker for worker in self.workers if worker.begin is not None]

    def ends(self) -> list[StartOutcome]:
        """The ends of all starts, or of those that came to one before a worker turned out to be unable."""
        try:
            while self.waiting or self.busy:
                try:
                    self._hire()
                    self._hear()
                except Stop:
                    self._stop()
                except KeyboardInterrupt:
                    if self.stopping:
                        raise
                    self._stop()
        except (_Gone, OSError):
            pass
        return self.found

    def close(self) -> None:
        """End all workers."""
        for worker in self.workers:
            worker.close()

    def _hire(self) -> None:
        while len(self.workers) < min(self.most, len(self.waiting) + len(self.busy)):
            self.workers.append(_Worker(self.work, self.inbox))

    def _hear(self) -> None:
        """Deal with the next message, if there is one soon."""
        try:
            worker, said = self.inbox.get(timeout=PAUSE)
        except queue.Empty:
            return
        if said is None:
            self._bury(worker)
        elif isinstance(said, TraceLine):
            self.progress(said)
        elif isinstance(said, Checkpoint):
            self.keep(said)
        elif isinstance(said, tuple):
            raise InputError(said)
        else:
            self._continue(worker, said)

    def _continue(self, worker: _Worker, said: Any) -> None:
        """Give a worker that is ready, or at the end of a start, the next one."""
        if isinstance(said, StartOutcome):
            self.found.append(said)
        worker.ready, worker.begin = True, None
        if self.waiting:
            worker.take(self.waiting.pop(0))

    def _bury(self, worker: _Worker) -> None:
        """A worker has gone, and its start with it."""
        self.workers.remove(worker)
        worker.close()
        if not worker.ready:
            raise _Gone
        if worker.begin is not None:
            begin, nothing = worker.begin, float("nan")
            message = f"The process of this start ended with the exit status {worker.process.returncode}."
            self.found.append(
                StartOutcome(StartResult(begin.start, "failed", message, nothing, nothing, 0, 0), begin.values)
            )

    def _stop(self) -> None:
        """End the starts under way at their best values; the others never begin. A second request ends all at once."""
        if self.stopping:
            return
        self.stopping = True
        self.found += [skipped_start(begin) for begin in self.waiting]
        self.waiting = []
        for worker in self.busy:
            worker.stop()


def main() -> None:
    """Read a problem from stdin, then starts; write each accepted step and each end to stdout.

    The process ends with its stdin.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    outgoing = os.fdopen(os.dup(1), "wb")
    with suppress(OSError):
        os.dup2(2, 1)  # what anybody prints must not get between the pickles
    with silent():
        try:
            problem, options = pickle.load(sys.stdin.buffer)
            climber = StartRunner(problem, options)
        except Exception:
            sys.exit(1)  # the other side does the work itself then
        _Working(climber, sys.stdin.buffer, outgoing).serve()


class _Working:
    """A worker at work."""

    def __init__(self, climber: StartRunner, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self.climber, self.incoming, self.outgoing = climber, incoming, outgoing
        self.begins: queue.SimpleQueue[StartPoint] = queue.SimpleQueue()
        self.stopping = threading.Event()

    def serve(self) -> None:
        """Climb until nobody listens any more."""
        threading.Thread(target=self._listen, daemon=True).start()
        self._say(READY)
        while True:
            begin = self.begins.get()
            try:
                self._say(self.climber.climb(begin, self._report, self._say))
            except InputError as error:
                self._say(error.findings)

    def _listen(self) -> None:
        try:
            while True:
                said = pickle.load(self.incoming)
                if said == STOP:
                    self.stopping.set()
                else:
                    self.begins.put(said)
        finally:
            os._exit(0)

    def _report(self, line: TraceLine) -> None:
        self._say(line)
        if self.stopping.is_set():
            raise Stop

    def _say(self, content: Any) -> None:
        try:
            self.outgoing.write(pickled(content))
            self.outgoing.flush()
        except OSError:
            os._exit(1)
