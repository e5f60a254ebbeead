"""A calibration in a process of its own, so that the page stays responsive and a stop is immediate.

The worker is a fresh interpreter that exchanges pickles through pipes, like those of a multistart. It reports every
accepted step, and the values of the best one a few times per second.
"""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import IO, Any

from kennfeld.arrays import Float
from kennfeld.errors import Finding, InputError
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.result import Checkpoint, Result, TraceLine
from kennfeld.optimize.search.worker_pool import STOP, pickle_content
from kennfeld.optimize.solver.levenberg_marquardt import Stop

STEP_INTERVAL = 0.1  # s between reported steps
VALUES_INTERVAL = 0.5  # s between reported values
COMMAND = "import sys; sys.path[:] = {path!r}; from kennfeld.app.session.run_job import main; main()"


@dataclass(frozen=True)
class Ended:
    """The end of a run: its result, or why there is none."""

    result: Result | None
    findings: tuple[Finding, ...] = ()
    reason: str = ""


@dataclass(frozen=True, eq=False)
class BestValues:
    """The values of the best step so far, by parameter."""

    values: Mapping[str, Float] = field(repr=False)


Report = Callable[[TraceLine | BestValues | Ended], None]


class RunJob:
    """A running calibration.

    Args:
        problem: what is calibrated.
        options: how.
        report: called from another thread with each step, with values, and once with the end.
    """

    def __init__(self, problem: Problem, options: Options, report: Report) -> None:
        self._report = report
        session: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            session = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
        command = [sys.executable or "python", "-c", COMMAND.format(path=sys.path)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, **session)
        work = pickle_content((replace(problem), options))  # a copy has no cached properties
        threading.Thread(target=self._receive, args=(work,), daemon=True).start()

    def stop(self) -> None:
        """Stop at the next step; the best values so far are the result."""
        self._write(pickle_content(STOP))

    def kill(self) -> None:
        """End the process at once, without a result."""
        self._process.kill()

    def _write(self, content: bytes) -> None:
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):  # a process that has ended is noticed by `_receive`
            self._process.stdin.write(content)
            self._process.stdin.flush()

    def _receive(self, work: bytes) -> None:
        assert self._process.stdout is not None
        self._write(work)
        message: Any = None
        with suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while not isinstance(message, Ended):
                message = pickle.load(self._process.stdout)
                self._report(message)
        self._process.kill()
        code = self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                stream.close()  # type: ignore[union-attr]
        if not isinstance(message, Ended):
            self._report(Ended(None, reason=f"The process of the run ended unexpectedly (exit status {code})."))


def main() -> None:
    """Run the worker: read a problem and options from stdin, write steps, values and the end to stdout."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    outgoing = os.fdopen(os.dup(1), "wb")
    with suppress(OSError):
        os.dup2(2, 1)  # printed text must not get between the pickles
    problem, options = pickle.load(sys.stdin.buffer)
    JobWorker(problem, options, sys.stdin.buffer, outgoing).run()


class JobWorker:
    def __init__(self, problem: Problem, options: Options, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self._problem, self._options = problem, options
        self._incoming, self._outgoing = incoming, outgoing
        self._stopping = threading.Event()
        self._last_step = self._last_values = 0.0
        self._best = float("inf")

    def run(self) -> None:
        from kennfeld.optimize.search.multistart import run

        threading.Thread(target=self._listen, daemon=True).start()
        try:
            result = run(self._problem, replace(self._options, save_every=1), self._step, keep=self._keep)
            _ = result.trust  # computed here, where nobody waits
            self._send(Ended(result))
        except InputError as error:
            self._send(Ended(None, error.findings))
        except KeyboardInterrupt:
            self._send(Ended(None, reason="Stopped before the first step."))

    def _step(self, line: TraceLine) -> None:
        now = time.monotonic()
        if now - self._last_step >= STEP_INTERVAL:
            self._last_step = now
            self._send(line)
        if self._stopping.is_set():
            raise Stop

    def _keep(self, saved: Checkpoint) -> None:
        now = time.monotonic()
        if saved.cost < self._best and now - self._last_values >= VALUES_INTERVAL:
            self._best, self._last_values = saved.cost, now
            self._send(BestValues(saved.values))

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            if pickle.load(self._incoming) == STOP:
                self._stopping.set()
                pickle.load(self._incoming)
        os._exit(0)  # the app has ended

    def _send(self, content: Any) -> None:
        try:
            self._outgoing.write(pickle_content(content))
            self._outgoing.flush()
        except OSError:
            os._exit(1)
