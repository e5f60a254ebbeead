"""Tasks over many items: in this process one after the other, or on a cluster.

A task is a function of a module, so that other processes find it by its name. It is given bytes only: what all tasks
share, its own item, and the arguments of this call. Results arrive in the order of the items, wherever they were
computed, so that what is added up does not depend on the number of workers.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol

from kennfeld.base.errors import InputError, KennfeldError

Task = Callable[[bytes, bytes, bytes], Any]
Receiver = Callable[[bytes], bool]


_worker: ContextVar[str] = ContextVar("worker", default="")
_line: ContextVar["MessageLine | None"] = ContextVar("line", default=None)


def worker_name() -> str:
    """Return the name of the worker that runs the current task; empty in the process that started it."""
    return _worker.get()


@contextmanager
def as_worker(name: str) -> Iterator[None]:
    """Run the block as this worker."""
    token = _worker.set(name)
    try:
        yield
    finally:
        _worker.reset(token)


class MessageLine(Protocol):
    """The connection of a running task to the process that started it."""

    def send(self, message: bytes) -> None:
        """Send a message."""

    def is_stopping(self) -> bool:
        """Return whether the task is asked to end at its next step."""


@contextmanager
def connected(line: MessageLine) -> Iterator[None]:
    """Run the block with a connection to the process that started the task."""
    token = _line.set(line)
    try:
        yield
    finally:
        _line.reset(token)


def message_line() -> MessageLine:
    """Return the connection of the current task."""
    line = _line.get()
    assert line is not None, "the task was not started by map_with_messages"
    return line


class RunnerLostError(KennfeldError):
    """The cluster is gone; the text says which, and why."""


class WorkersDiedError(InputError):
    """Several workers ended, one after the other, while they ran the same task."""


class TaskRunner(Protocol):
    """Runs tasks."""

    def map(self, task: Task, shared: bytes, items: Sequence[bytes], arguments: bytes) -> Iterator[Any]:
        """Yield `task(shared, item, arguments)` for each item, in order.

        Raises:
            RunnerLostError: no worker can be reached any more.
        """

    def map_with_messages(self, task: Task, shared: bytes, items: Sequence[bytes], receive: Receiver) -> Iterator[Any]:
        """Yield `task(shared, item, b"")` for each item, in order, while tasks report through `message_line`.

        `receive` is called in this thread with each message; if it returns True, all tasks are asked to stop.
        """

    def close(self) -> None:
        """End what the runner has started."""


class SerialRunner:
    """Runs tasks in this process, one after the other; only the result that is used is in memory."""

    def map(self, task: Task, shared: bytes, items: Sequence[bytes], arguments: bytes) -> Iterator[Any]:
        """Yield the result of each item, in order."""
        for item in items:
            yield task(shared, item, arguments)

    def map_with_messages(self, task: Task, shared: bytes, items: Sequence[bytes], receive: Receiver) -> Iterator[Any]:
        """Yield the result of each item, in order; messages arrive at once."""
        line = _DirectLine(receive)
        for item in items:
            with connected(line):
                result = task(shared, item, b"")
            yield result

    def close(self) -> None:
        """Do nothing."""


class _DirectLine:
    """A connection within one process."""

    def __init__(self, receive: Receiver) -> None:
        self._receive, self._stopping = receive, False

    def send(self, message: bytes) -> None:
        # in this order, as each message is received
        self._stopping = self._receive(message) or self._stopping

    def is_stopping(self) -> bool:
        return self._stopping
