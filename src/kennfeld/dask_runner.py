"""Tasks on a Dask cluster: a running scheduler, or worker processes that are started on this machine.

Scheduling is Dask's: a worker that dies loses its tasks to the others, and one that joins gets some. Items prefer the
worker that had them before, by their number, so that each finds what it has kept on its disk.
"""

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from kennfeld.errors import InputError, KennfeldError, Location
from kennfeld.task_runner import RunnerLostError, Task, as_worker

AHEAD = 4  # tasks for each worker that are handed out beforehand
RETRIES = 3  # of a task whose worker died
CONNECT_TIMEOUT = 20.0  # s
POLL_INTERVAL = 0.5  # s
NO_WORKER_TIMEOUT = 60.0  # s
REMEDY = "Install it: pip install kennfeld[cluster]"


@dataclass(frozen=True)
class ClusterAddress:
    """A cluster to join, or the number of processes to start.

    Attributes:
        scheduler: address of a scheduler, or path of the file that it has written; empty to start processes here.
        workers: number of these processes.
        certificates: for TLS, the files of the authority, the certificate and the key.
    """

    scheduler: str = ""
    workers: int = 0
    certificates: tuple[str, str, str] = ("", "", "")


class _Outcome(NamedTuple):
    worker: str
    seconds: float
    result: Any


@dataclass
class WorkerLoad:
    """What one worker has done."""

    tasks: int = 0
    seconds: float = 0.0


def run_item(task: Task, shared: bytes, item: bytes, arguments: bytes) -> _Outcome:
    """Run a task on a worker."""
    began, name = time.perf_counter(), str(import_module("distributed").get_worker().name)
    with as_worker(name):
        result = task(shared, item, arguments)
    return _Outcome(name, time.perf_counter() - began, result)


def keep(content: bytes) -> bytes:
    """Return bytes that many tasks share; a task of its own, so that the scheduler can make them again."""
    return content


@dataclass
class DaskRunner:
    """Runs tasks on a cluster.

    Attributes:
        client: connection to the scheduler.
        cluster: the processes that were started here, if any.
        report: takes a line about what the cluster does.
        loads: what each worker has done.
    """

    client: Any
    cluster: Any = None
    report: Callable[[str], None] = lambda line: None
    loads: dict[str, WorkerLoad] = field(default_factory=dict)
    _numbers: Iterator[int] = field(default_factory=itertools.count)
    _shared: dict[bytes, Any] = field(default_factory=dict)

    @classmethod
    def start(cls, address: ClusterAddress, report: Callable[[str], None] = lambda line: None) -> "DaskRunner":
        """Join a cluster, or start one on this machine.

        Raises:
            InputError: Dask is missing, or the scheduler does not answer.
        """
        try:
            distributed = import_module("distributed")
        except ImportError as error:
            raise InputError.of(Location("[cluster]"), f"dask.distributed is missing ({error})", REMEDY) from error
        cluster = None
        try:
            if address.scheduler:
                client = distributed.Client(timeout=CONNECT_TIMEOUT, **_connection(address))
            else:
                # each process evaluates one partition at a time, which keeps its memory at one partition
                cluster = distributed.LocalCluster(
                    n_workers=address.workers,
                    threads_per_worker=1,
                    processes=True,
                    memory_limit=0,
                    dashboard_address=":0",
                )
                client = distributed.Client(cluster)
        except (OSError, ValueError, TypeError) as error:
            place = Location(f"scheduler {address.scheduler}")
            message = f"does not answer ({error or type(error).__name__})"
            raise InputError.of(place, message, "Check the address, and that the versions of Dask agree.") from error
        runner = cls(client, cluster, report)
        report(f"cluster: {runner.workers} workers at {client.scheduler.address}; dashboard {client.dashboard_link}")
        return runner

    @property
    def workers(self) -> int:
        """Number of workers at present."""
        return len(self._addresses())

    def _addresses(self) -> list[str]:
        return sorted(self.client.scheduler_info(n_workers=-1)["workers"])

    def map(self, task: Task, shared: bytes, items: Sequence[bytes], arguments: bytes) -> Iterator[Any]:
        """Yield the result of each item, in order.

        Raises:
            RunnerLostError: the scheduler is gone, or all workers are, for a minute.
            KennfeldError: a task has failed; the error is that of the task.
        """
        if not items:
            return
        call = next(self._numbers)
        try:
            common = self._keep(shared), self.client.submit(keep, arguments, key=f"arguments-{call}", pure=False)
            yield from self._results(call, task, items, common)
        except KennfeldError:
            raise
        except Exception as error:
            if self.is_connected:
                raise
            raise RunnerLostError(f"the scheduler at {self.client.scheduler.address} is gone") from error

    @property
    def is_connected(self) -> bool:
        """True if the scheduler answers."""
        return bool(self.client.status == "running")

    def _keep(self, shared: bytes) -> Any:
        if shared not in self._shared:
            if len(self._shared) >= AHEAD:
                self._shared.pop(next(iter(self._shared)))
            self._shared[shared] = self.client.submit(keep, shared, key=f"shared-{next(self._numbers)}", pure=False)
        return self._shared[shared]

    def _results(self, call: int, task: Task, items: Sequence[bytes], common: tuple[Any, Any]) -> Iterator[Any]:
        addresses = self._addresses() or [""]
        ahead = max(AHEAD * len(addresses), AHEAD)
        waiting = iter(enumerate(items))
        futures: dict[int, Any] = {}

        def hand_out(count: int) -> None:
            for at, item in itertools.islice(waiting, count):
                place = (
                    {"workers": [addresses[at % len(addresses)]], "allow_other_workers": True} if addresses[0] else {}
                )
                key = f"kennfeld-{call}-{at}"
                more = {"key": key, "pure": False, "retries": RETRIES, **place}
                futures[at] = self.client.submit(run_item, task, common[0], item, common[1], **more)

        try:
            hand_out(ahead)
            for at in range(len(items)):
                outcome = self._wait(futures[at])
                del futures[at]
                hand_out(1)
                load = self.loads.setdefault(outcome.worker, WorkerLoad())
                load.tasks, load.seconds = load.tasks + 1, load.seconds + outcome.seconds
                yield outcome.result
        finally:
            with suppress(Exception):
                self.client.cancel(list(futures.values()), force=True)

    def _wait(self, future: Any) -> _Outcome:
        """Return the outcome of a task; short waits, so that Ctrl-C and a lost scheduler are noticed."""
        alone_since: float | None = None
        while True:
            try:
                outcome: _Outcome = future.result(timeout=POLL_INTERVAL)
                return outcome
            except TimeoutError:
                if future.done():
                    raise
            if not self.is_connected:
                raise RunnerLostError(f"the scheduler at {self.client.scheduler.address} is gone")
            if self.workers:
                alone_since = None
                continue
            alone_since = alone_since or time.monotonic()
            if time.monotonic() - alone_since > NO_WORKER_TIMEOUT:
                raise RunnerLostError(f"the scheduler at {self.client.scheduler.address} has no worker")

    def close(self) -> None:
        """Leave the cluster; end the processes that were started here."""
        for closing in (self.client, self.cluster):
            if closing is not None:
                with suppress(Exception):
                    closing.close()


def _connection(address: ClusterAddress) -> dict[str, Any]:
    """Return the arguments of a client."""
    authority, certificate, key = address.certificates
    more: dict[str, Any] = {}
    if any(address.certificates):
        more["security"] = import_module("distributed.security").Security(
            tls_ca_file=authority or None,
            tls_client_cert=certificate or None,
            tls_client_key=key or None,
            require_encryption=True,
        )
    if "://" not in address.scheduler and Path(address.scheduler).is_file():
        return more | {"scheduler_file": address.scheduler}
    return more | {"address": address.scheduler}
