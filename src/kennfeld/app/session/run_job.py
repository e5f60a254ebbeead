"""A calibration in a process of its own, so that the page stays responsive and a stop is immediate.

The worker reports accepted steps, and the values of the best one, a few times per second.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from kennfeld.arrays import Float
from kennfeld.errors import Finding, InputError
from kennfeld.optimize.options import Options
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.result import Checkpoint, Result, TraceLine
from kennfeld.optimize.search.worker_process import ParentConnection, WorkerProcess, connect_to_parent, pickle_content
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


class RunJob(WorkerProcess):
    """A running calibration.

    Args:
        problem: what is calibrated.
        options: how.
        report: called from another thread with each step, with values, and once with the end.
    """

    def __init__(self, problem: Problem, options: Options, report: Report) -> None:
        self._report = report
        self._ended = False
        super().__init__(COMMAND, pickle_content((replace(problem), options)))  # a copy has no cached properties

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
            code = self.process.returncode
            self._report(Ended(None, reason=f"The process of the run ended unexpectedly (exit status {code})."))


def main() -> None:
    """Run the worker: read a problem and options from stdin, write steps, values and the end to stdout."""
    parent = connect_to_parent()
    JobWorker(*parent.read_work(), parent).run()


class JobWorker:
    def __init__(self, problem: Problem, options: Options, parent: ParentConnection) -> None:
        self._problem, self._options, self._parent = problem, options, parent
        self._last_step = self._last_values = 0.0
        self._best = float("inf")

    def run(self) -> None:
        from kennfeld.optimize.search.multistart import run

        self._parent.listen()
        try:
            result = run(self._problem, replace(self._options, save_every=1), self._step, keep=self._keep)
            _ = result.trust  # computed here, where nobody waits
            self._parent.send(Ended(result))
        except InputError as error:
            self._parent.send(Ended(None, error.findings))
        except KeyboardInterrupt:
            self._parent.send(Ended(None, reason="Stopped before the first step."))

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
