"""Tasks over many items: in this process one after the other, or on a cluster.

A task is a function of a module, so that other processes find it by its name. It is given bytes only: what all tasks
share, its own item, and the arguments of this call. Results arrive in the order of the items, wherever they were
computed, so that what is added up does not depend on the number of workers.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Protocol

Task = Callable[[bytes, bytes, bytes], Any]


_worker: ContextVar[str] = ContextVar("worker", default="")


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


class RunnerLostError(Exception):
    """The cluster is gone; the text says which, and why."""


class TaskRunner(Protocol):
    """Runs tasks."""

    def map(self, task: Task, shared: bytes, items: Sequence[bytes], arguments: bytes) -> Iterator[Any]:
        """Yield `task(shared, item, arguments)` for each item, in order.

        Raises:
            RunnerLostError: no worker can be reached any more.
        """

    def close(self) -> None:
        """End what the runner has started."""


class SerialRunner:
    """Runs tasks in this process, one after the other; only the result that is used is in memory."""

    def map(self, task: Task, shared: bytes, items: Sequence[bytes], arguments: bytes) -> Iterator[Any]:
        """Yield the result of each item, in order."""
        for item in items:
            yield task(shared, item, arguments)

    def close(self) -> None:
        """Do nothing."""
