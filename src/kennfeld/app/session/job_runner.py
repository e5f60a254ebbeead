"""The calibration or cross-validation in progress: its start, its reports, its end."""

import queue
import time
from collections.abc import Callable, Iterator

from kennfeld.app.session.run_job import BestValues, Ended, RunJob, RunTask
from kennfeld.app.session.runs import Job
from kennfeld.optimize.fit.result import TraceLine


class JobRunner:
    """Runs one calibration or cross-validation at a time, in a process of its own.

    Args:
        changed: called from another thread when the job has reported something, for `ended` to handle.

    Attributes:
        job: the running or last one, as it is shown.
        running: its process; None if it has ended.
    """

    def __init__(self, changed: Callable[[], object]) -> None:
        self._changed = changed
        self.job = Job()
        self.running: RunJob | None = None
        self._inbox: queue.SimpleQueue[TraceLine | BestValues | Ended] = queue.SimpleQueue()

    @property
    def is_calibrating(self) -> bool:
        """True while a calibration runs, at whose end its values become the present ones."""
        return self.running is not None and not self.job.validates

    def start(self, task: RunTask, part: str) -> None:
        """Start a job; `part` are the values that it fits, in words, empty if all."""
        validates = task.validation is not None
        self.job = Job("running", "compiling", time.monotonic(), problem=task.problem, validates=validates, part=part)
        self.running = RunJob(task, self._put)

    def stop(self) -> None:
        """Stop at the best values."""
        if self.running is not None and self.job.state == "running":
            self.job.state = "stopping"
            self.running.stop()

    def kill(self) -> None:
        """End the process without a result."""
        if self.running is not None:
            self.running.kill()

    def _put(self, message: TraceLine | BestValues | Ended) -> None:
        """Keep a report; called from the thread of the job."""
        self._inbox.put(message)
        self._changed()

    def ended(self) -> Iterator[Ended]:
        """Take over the reports of steps and values, and yield that of the end."""
        while not self._inbox.empty():
            message = self._inbox.get()
            job = self.job
            job.seconds = time.monotonic() - job.began
            if isinstance(message, TraceLine):
                job.trace.append(message)
                job.message = message.stage
            elif isinstance(message, BestValues):
                job.preview = message.values
            else:
                self.running = None
                yield message
