"""Long work beside the session, such as a search, in a process of its own: watched, stopped, its last outcome kept."""

import queue
import time
from collections.abc import Callable
from dataclasses import field
from typing import Any, Generic, Protocol, TypeVar

from kennfeld.base.errors import ArgumentError, Finding, InputError, KennfeldError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.optimize.search.worker_process import WorkerProcess, connect_to_parent

COMMAND = "import sys; sys.path[:] = {path!r}; from kennfeld.app.session.side_work import main; main()"

Outcome = TypeVar("Outcome")  # Python 3.11


@dataclass(frozen=True)
class WorkStep:
    """The step of the work, in words, with the number of parts that are done; 0 parts if it is not known."""

    text: str = ""
    done: int = 0
    parts: int = 0


@dataclass(frozen=True, eq=False)
class PartialOutcome:
    """An outcome before the work has ended."""

    outcome: Any


@dataclass(frozen=True, eq=False)
class WorkEnd:
    """The end of the work: its outcome, or why there is none."""

    outcome: Any = None
    findings: tuple[Finding, ...] = ()
    reason: str = ""


Report = WorkStep | PartialOutcome | WorkEnd
Tell = Callable[[WorkStep | PartialOutcome], None]


class SideTask(Protocol):
    """The work of the process; it is pickled, and so is what it tells and returns."""

    def run(self, tell: Tell) -> Any:
        """Do the work."""


class _TaskProcess(WorkerProcess):
    def __init__(self, task: SideTask, put: Callable[["_TaskProcess", Report], None]) -> None:
        self._put, self._ended = put, False
        super().__init__(COMMAND, pickle_content(task))

    def handle(self, message: Any) -> None:
        if message is None:
            self.close()
            if not self._ended:
                self._put(self, WorkEnd(reason=f"The process ended unexpectedly: {self.describe_end()}."))
            return
        self._put(self, message)
        if isinstance(message, WorkEnd):
            self._ended = True
            self.kill()


@dataclass
class SideWork(Generic[Outcome]):
    """The running or last work of its kind. All methods are called from the thread of the session.

    Attributes:
        changed: called from another thread when there is something for `pump`.
        state: idle, running, ended, failed or stopped.
        step: what it does.
        reason: why it failed.
        seconds: how long it has run.
        outcome: the last one, also a part of one; that of earlier work stays until there is another one.
        subject: what the outcome is about, as it was given at the start.
    """

    changed: Callable[[], object]
    state: str = "idle"
    step: WorkStep = field(default_factory=WorkStep)
    reason: str = ""
    seconds: float = 0.0
    outcome: Outcome | None = None
    subject: Any = None
    _began: float = 0.0
    _next: Any = None  # the subject of the running work
    _worker: _TaskProcess | None = None
    _inbox: "queue.SimpleQueue[tuple[object, Report]]" = field(default_factory=queue.SimpleQueue)

    def start(self, task: SideTask, subject: Any) -> None:
        """Start work. Raises `ArgumentError` if some is running."""
        if self._worker is not None:
            raise ArgumentError("this is being computed already; stop it first")
        self.state, self.step, self.reason, self.seconds = "running", WorkStep("starting"), "", 0.0
        self._began, self._next = time.monotonic(), subject
        self._worker = _TaskProcess(task, self._put)

    def stop(self) -> None:
        """End running work at once; what it has reported so far is kept."""
        if self._worker is None:
            return
        self.pump()  # messages that wait in the inbox were sent before
        if self._worker is not None:
            self._worker.kill()
            self._end("stopped")

    def pump(self) -> None:
        """Handle the messages of the work."""
        while not self._inbox.empty():
            worker, message = self._inbox.get()
            if worker is not self._worker:
                continue  # of work that was stopped
            self.seconds = time.monotonic() - self._began
            if isinstance(message, WorkStep):
                self.step = message
            elif message.outcome is not None:
                self.outcome, self.subject = message.outcome, self._next
            if isinstance(message, WorkEnd):
                self.reason = message.reason or " ".join(map(str, message.findings))
                self._end("failed" if self.reason else "ended")

    def _end(self, state: str) -> None:
        self.seconds = time.monotonic() - self._began
        self.state, self.step, self._worker = state, WorkStep(), None

    def _put(self, worker: object, message: Report) -> None:
        self._inbox.put((worker, message))
        self.changed()


def main() -> None:
    """Run the worker: do the work that stdin has, and write steps, partial outcomes and the end to stdout."""
    parent = connect_to_parent()
    task: SideTask = parent.read_work()
    parent.listen()
    try:
        end = WorkEnd(task.run(parent.send))
    except InputError as error:
        end = WorkEnd(findings=error.findings)
    except KennfeldError as error:
        end = WorkEnd(reason=f"{error}.")
    parent.send(end)
