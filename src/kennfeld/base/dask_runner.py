"""Tasks on a Dask cluster: a running scheduler, or worker processes that are started on this machine.

Scheduling is Dask's: a worker that dies loses its tasks to the others, and one that joins gets some. Items prefer the
worker that had them before, by their number, so that each finds what it has kept on its disk.
"""

import itertools
import json
import logging
import ssl
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import field
from importlib import import_module
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple

from kennfeld.base.consent_gate import require_address
from kennfeld.base.errors import Finding, InputError, KennfeldError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.optional_packages import optional_package
from kennfeld.base.task_runner import Receiver, RunnerLostError, Task, WorkersDiedError, as_worker, connected

AHEAD = 4  # tasks for each worker that are handed out beforehand
SHORT_TASK = 0.05  # s; shorter ones run several at a time
MEMORY = 0.9  # share of earlier tasks in the mean duration
INLINE = 32_768  # bytes of arguments; longer ones are sent to each worker once, not with each task
RETRIES = 3  # of a task whose worker died
CONNECT_TIMEOUT = 20.0  # s
POLL_INTERVAL = 0.5  # s
LOSS_CHECKS = 10  # in this interval
NO_WORKER_TIMEOUT = 60.0  # s
TLS_KEYS = ("tls_authority", "tls_certificate", "tls_key")


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
    processor: float
    results: list[Any]


@dataclass
class WorkerLoad:
    """The work of one worker: number of items, and the elapsed and the processor time that they took, in s."""

    tasks: int = 0
    seconds: float = 0.0
    processor: float = 0.0


def run_items(task: Task, shared: bytes, items: Sequence[bytes], arguments: bytes) -> _Outcome:
    """Run a task for some items on a worker."""
    began, processor, name = (
        time.perf_counter(),
        time.process_time(),
        str(import_module("distributed").get_worker().name),
    )
    with as_worker(name):
        results = [task(shared, item, arguments) for item in items]
    return _Outcome(name, time.perf_counter() - began, time.process_time() - processor, results)


def run_reporting(task: Task, shared: bytes, item: bytes, topic: str) -> Any:
    """Run a task on a worker that sends messages under a topic."""
    worker = import_module("distributed").get_worker()
    with as_worker(str(worker.name)), connected(_WorkerLine(worker, topic)):
        return task(shared, item, b"")


class _WorkerLine:
    """The connection of a task to the client: events of Dask one way, an event that is set the other way."""

    def __init__(self, worker: Any, topic: str) -> None:
        self._worker, self._topic = worker, topic
        self._stop = import_module("distributed").Event(topic)

    def send(self, message: bytes) -> None:
        self._worker.log_event(self._topic, message)

    def is_stopping(self) -> bool:
        return bool(self._stop.is_set())


def keep(content: bytes) -> bytes:
    """Return bytes that many tasks share; a task of its own, so that the scheduler can make them again."""
    return content


@dataclass
class DaskRunner:
    """Runs tasks on a cluster.

    Attributes:
        client: connection to the scheduler.
        address: of the scheduler.
        cluster: the processes that were started here, if any.
        report: takes a line about what the cluster does.
        loads: what each worker has done.
    """

    client: Any
    address: str
    cluster: Any = None
    report: Callable[[str], None] = lambda line: None
    loads: dict[str, WorkerLoad] = field(default_factory=dict)
    _numbers: Iterator[int] = field(default_factory=itertools.count)
    _shared: dict[bytes, Any] = field(default_factory=dict)
    _seconds: dict[tuple[str, int], float] = field(default_factory=dict)  # of one item, by task and number of items

    @classmethod
    def start(cls, address: ClusterAddress, report: Callable[[str], None] = lambda line: None) -> "DaskRunner":
        """Join a cluster, or start one on this machine.

        Raises:
            InputError: Dask is missing, or the scheduler does not answer.
        """
        with optional_package(Location("[cluster]"), "cluster"):
            distributed = import_module("distributed")
        _require_files(address)
        cluster = None
        if address.scheduler:
            require_address("scheduler", scheduler_address(address))
        try:
            if address.scheduler:
                client = _connect(distributed, timeout=CONNECT_TIMEOUT, **_connection(address))
            else:
                # each process evaluates one partition at a time, which keeps its memory at one partition
                cluster = distributed.LocalCluster(
                    n_workers=address.workers,
                    silence_logs=logging.ERROR,
                    threads_per_worker=1,
                    processes=True,
                    # 0 is no limit, and port 0 any that is free
                    memory_limit=0,
                    dashboard_address=":0",
                )
                client = _connect(distributed, address=cluster)
            runner = cls(client, client.scheduler.address, cluster, report)
            line = f"cluster: {runner.workers} workers at {runner.address}; dashboard {client.dashboard_link}"
        except InputError:
            raise
        except Exception as error:  # of any kind, from something that is not a scheduler
            place = Location(f"scheduler {address.scheduler}")
            raise InputError.of(place, *_explain(error)) from error
        report(line)
        return runner

    @property
    def workers(self) -> int:
        """Number of workers at present."""
        return len(self._addresses())

    def _addresses(self) -> list[str]:
        # -1 is all; versions from 2025.4 to 2026.6 list only five by default
        return sorted(self.client.scheduler_info(n_workers=-1)["workers"])

    def map(self, task: Task, shared: bytes, items: Sequence[bytes], arguments: bytes) -> Iterator[Any]:
        """Yield the result of each item, in order.

        Raises:
            RunnerLostError: the scheduler is gone, or all workers are, for a minute.
            KennfeldError: a task has failed; the error is that of the task.
        """
        if not items:
            return
        # in keys with the client: of a key that it knows, a scheduler returns what it has, whoever submits it
        call = next(self._numbers)
        try:
            own: Any = arguments
            if len(arguments) > INLINE:
                own = self.client.submit(keep, arguments, key=f"arguments-{self.client.id}-{call}", pure=False)
            common = self._keep(shared), own
            yield from self._results(call, task, items, common)
        except KennfeldError:
            raise
        except Exception as error:
            if not self._is_lost():
                raise
            raise RunnerLostError(f"the scheduler at {self.address} is gone") from error

    def map_with_messages(self, task: Task, shared: bytes, items: Sequence[bytes], receive: Receiver) -> Iterator[Any]:
        """Yield the result of each item, in order; see `TaskRunner.map_with_messages`.

        Raises:
            RunnerLostError: the scheduler is gone, or all workers are, for a minute.
        """
        call = next(self._numbers)
        topic, inbox = f"kennfeld-{self.client.id}-{call}", SimpleQueue[bytes]()
        stop = import_module("distributed").Event(topic, client=self.client)

        def deliver() -> None:
            while not inbox.empty():
                if receive(inbox.get()):
                    stop.set()

        # an event is a time and a message; it arrives in a thread of Dask, but is received in this one
        self.client.subscribe_topic(topic, lambda event: inbox.put(event[1]))
        common, futures = self._keep(shared), list[Any]()
        try:
            for at, item in enumerate(items):
                more = {"key": f"{topic}-{at}", "pure": False, "retries": RETRIES}
                futures.append(self.client.submit(run_reporting, task, common, item, topic, **more))
            for future in futures:
                result = self._wait(future, deliver)
                # once more, for messages between the last look and the result
                deliver()
                yield result
        finally:
            with suppress(Exception):
                self.client.cancel(futures, force=True)
                self.client.unsubscribe_topic(topic)

    @property
    def is_connected(self) -> bool:
        """True if the scheduler answers."""
        return bool(self.client.status == "running")

    def _is_lost(self) -> bool:
        """Return whether the scheduler is gone; the client notices that shortly after its first failure."""
        for _ in range(LOSS_CHECKS):
            if not self.is_connected:
                return True
            time.sleep(POLL_INTERVAL / LOSS_CHECKS)
        return False

    def _keep(self, shared: bytes) -> Any:
        if shared not in self._shared:
            if len(self._shared) >= AHEAD:
                # the oldest one, which the workers may then forget
                self._shared.pop(next(iter(self._shared)))
            self._shared[shared] = self.client.submit(
                keep, shared, key=f"shared-{self.client.id}-{next(self._numbers)}", pure=False
            )
        return self._shared[shared]

    def _results(self, call: int, task: Task, items: Sequence[bytes], common: tuple[Any, Any]) -> Iterator[Any]:
        addresses = self._addresses() or [""]
        kind = task.__name__, len(items)
        size = _bundle_size(self._seconds.get(kind, SHORT_TASK), len(items), len(addresses))
        bundles = [items[first : first + size] for first in range(0, len(items), size)]
        waiting = iter(enumerate(bundles))
        futures: dict[int, Any] = {}

        def hand_out(count: int) -> None:
            for at, bundle in itertools.islice(waiting, count):
                more = {"key": f"kennfeld-{self.client.id}-{call}-{at}", "pure": False, "retries": RETRIES}
                more |= _preference(addresses[at % len(addresses)])
                futures[at] = self.client.submit(run_items, task, common[0], bundle, common[1], **more)

        try:
            # enough for all workers to be busy while the results are taken in order
            hand_out(AHEAD * len(addresses))
            for at in range(len(bundles)):
                outcome: _Outcome = self._wait(futures[at])
                # Dask frees a result that nobody refers to
                del futures[at]
                hand_out(1)
                self._count(kind, outcome)
                yield from outcome.results
        finally:
            if futures:
                with suppress(Exception):
                    self.client.cancel(list(futures.values()), force=True)

    def _count(self, kind: tuple[str, int], outcome: _Outcome) -> None:
        load, count = self.loads.setdefault(outcome.worker, WorkerLoad()), len(outcome.results)
        load.tasks, load.seconds = load.tasks + count, load.seconds + outcome.seconds
        load.processor += outcome.processor
        mean = outcome.seconds / count
        # an exponential mean, as the load of the workers changes
        self._seconds[kind] = MEMORY * self._seconds.get(kind, mean) + (1 - MEMORY) * mean

    def _wait(self, future: Any, meanwhile: Callable[[], None] = lambda: None) -> Any:
        """Return the result of a task; short waits, so that Ctrl-C and a lost scheduler are noticed.

        Raises:
            RunnerLostError: the scheduler is gone, or all workers are, for a minute.
            WorkersDiedError: all workers that ran the task have died.
        """
        distributed, alone_since = import_module("distributed"), time.monotonic()
        while not future.done():
            try:
                meanwhile()
                distributed.wait(future, timeout=POLL_INTERVAL)
            except TimeoutError:
                if not self.is_connected:
                    raise RunnerLostError(f"the scheduler at {self.address} is gone") from None
                if self.workers:
                    alone_since = time.monotonic()
                elif time.monotonic() - alone_since > NO_WORKER_TIMEOUT:
                    raise RunnerLostError(f"the scheduler at {self.address} has no worker") from None
        try:
            return future.result()
        except distributed.KilledWorker:
            message = f"{RETRIES + 1} workers ended, one after the other, while they ran the same task"
            remedy = "Look for a crash or a lack of memory in their output."
            raise WorkersDiedError([Finding(Location("[cluster]"), message, remedy)]) from None

    def close(self) -> None:
        """Leave the cluster; end the processes that were started here. Report what each worker has done."""
        for name, load in sorted(self.loads.items()):
            self.report(f"worker {name}: {load.tasks} tasks in {load.seconds:.1f} s")
        for closing in (self.client, self.cluster):
            if closing is not None:
                with suppress(Exception):
                    closing.close()


def _bundle_size(seconds: float, items: int, workers: int) -> int:
    """Return how many items run as one task, because one alone takes less time than its way to a worker.

    What is computed is the same, and added in the same order.

    >>> _bundle_size(0.2, 100, 4), _bundle_size(0.01, 100, 4), _bundle_size(0.0001, 100, 4)
    (1, 5, 13)
    """
    # but at least two tasks for each worker, as far as there are items
    return max(1, min(round(SHORT_TASK / max(seconds, 1e-9)), -(-items // (2 * workers))))


def _preference(worker: str) -> dict[str, Any]:
    return {"workers": [worker], "allow_other_workers": True} if worker else {}


def _connect(distributed: Any, **connection: Any) -> Any:
    """Return a client; one that fails is closed, which would block the next one if garbage collection did it."""
    client = distributed.Client.__new__(distributed.Client)
    try:
        client.__init__(**connection)
    except BaseException:
        with suppress(Exception):
            client.close()
        raise
    return client


def _require_files(address: ClusterAddress) -> None:
    """Raise `InputError` with all certificate files that do not exist."""
    named = [(key, name) for key, name in zip(TLS_KEYS, address.certificates, strict=True) if name]
    findings = [
        Finding(Location("[cluster]", path=key), f"file {name} not found", "Name an existing file.")
        for key, name in named
        if not Path(name).is_file()
    ]
    if findings:
        raise InputError(findings)


def _explain(error: Exception) -> tuple[str, str]:
    """Return why a scheduler cannot be joined, and the remedy."""
    text = str(error) or type(error).__name__
    if "ssl_context" in text:
        return "requires certificates", f"Write {', '.join(TLS_KEYS)} in [cluster]."
    if "encryption required" in text:
        return "has no TLS, but certificates are named", f'Write scheduler = "tls://...", or remove {TLS_KEYS[0]}.'
    if isinstance(error, ssl.SSLError) or "SSL" in text or "TLS" in text:
        remedy = "Check that all certificates are signed by the authority, and that the key belongs to the certificate."
        return f"TLS certificates do not match ({text})", remedy
    if isinstance(error, LookupError | AttributeError | AssertionError):
        return f"does not answer like a scheduler of Dask ({error!r:.80})", "Check the address."
    return f"does not answer ({text})", "Check the address, tls:// if it uses TLS, and that the versions of Dask agree."


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
    return more | {"address": scheduler_address(address)}


def scheduler_address(address: ClusterAddress) -> str:
    """Return the address of a scheduler, also if it is in a file that the scheduler has written.

    Raises:
        InputError: the file has no address.
    """
    if "://" in address.scheduler or not Path(address.scheduler).is_file():
        return address.scheduler
    try:
        content = json.loads(Path(address.scheduler).read_text(encoding="utf-8"))["address"]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        content = None
    if not isinstance(content, str):
        message = "is not a file that a scheduler has written"
        raise InputError.of(Location(f"scheduler {address.scheduler}"), message, "Write the address of the scheduler.")
    return content
