"""Calls with models that run machine code of others, such as that of FMUs, in a process of their own.

A crash of such code ends the process in which it happens. Commands run in a process that another one watches; in Python
that would be the session of the user, so that `calibrate` and `simulate` run elsewhere with such models. The process
stays for further calls, because it takes longer to start and to load a model than most calls take.

Warnings, log messages and progress reach the caller as if the call ran here.
"""

import atexit
import logging
import os
import pickle
import queue
import shutil
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import wraps
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

from kennfeld.base.errors import Finding, InputError, repeat_warnings
from kennfeld.base.machine_code.call_record import read_calls, recorded_files
from kennfeld.base.machine_code.crash_report import crash_finding
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.base.watch_folder import FOLDER, remove_noted, watch_folder
from kennfeld.graph.external_function import ExternalFunction, has_gates
from kennfeld.models import Model
from kennfeld.optimize.fit.result import Progress, TraceLine
from kennfeld.optimize.search.worker_process import ParentConnection, WorkerProcess, connect_to_parent
from kennfeld.optimize.solver.levenberg_marquardt import Stop

COMMAND = "import sys; sys.path[:] = {path!r}; from kennfeld.optimize.search.isolated_call import main; main()"
_POLL_INTERVAL = 0.1  # s; Windows does not deliver Ctrl-C during a wait without timeout
_MOST_PROCESSES = 2  # calls at once, from threads of the caller; others wait
_PROGRESS = "progress"

_Arguments = ParamSpec("_Arguments")
_Outcome = TypeVar("_Outcome")


class _Request(NamedTuple):
    """A call of a function of a module, in a folder; `reports` if the caller wants to know the progress."""

    module: str
    name: str
    arguments: Mapping[str, Any]
    folder: str
    reports: bool


class _End(NamedTuple):
    """End of a call: its outcome, or what it raised, and the warnings that it issued."""

    outcome: Any
    error: BaseException | None
    warnings: tuple[Warning | str, ...]


class _NotSentError(Exception):
    """The other process cannot read the request, such as a class of the user's script, or send the outcome."""


def isolated(work: Callable[_Arguments, _Outcome]) -> Callable[_Arguments, _Outcome]:
    """Run a function with an argument `model` or `problem` in another process if it runs machine code of others.

    Its argument `progress`, if it has one, is called here. What cannot be pickled, such as functions of the session,
    cannot be sent to another process: such a call runs here, without protection.
    """
    taken = signature(work)
    name = next(name for name in taken.parameters if name in ("model", "problem"))
    place = [*taken.parameters].index(name)

    @wraps(work)
    def call(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> _Outcome:
        if not _needs_process(arguments[place] if place < len(arguments) else named.get(name)):
            return work(*arguments, **named)
        values = taken.bind(*arguments, **named).arguments
        progress: Progress | None = values.pop(_PROGRESS, None)
        request = _Request(work.__module__, work.__qualname__, values, str(Path.cwd()), progress is not None)
        try:
            content = pickle_content(request)
        except (pickle.PicklingError, TypeError, AttributeError):
            return work(*arguments, **named)
        try:
            outcome: _Outcome = _processes.run(content, progress, _PROGRESS in taken.parameters)
        except _NotSentError:
            return work(*arguments, **named)
        return outcome

    return call


def _needs_process(source: Any) -> bool:
    model = getattr(source, "model", source)
    # a watched process, and each that it starts, is isolated already; a gate is known here only
    if not isinstance(model, Model) or watch_folder() is not None or has_gates() or getattr(sys, "frozen", False):
        return False
    functions: set[ExternalFunction] = {n.payload.function for n in model.graph.nodes if n.op == "external"}
    # a function of this session cannot be found again in another process
    return any(f.native for f in functions) and all(f.file for f in functions) and bool(sys.executable)


class _IsolatedProcess(WorkerProcess):
    """A process that makes one call after the other; its folder holds records of calls of foreign code."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="kennfeld-"))
        self.owner, self.is_idle = os.getpid(), True
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        # the records of calls must outlive the process that writes them
        super().__init__(COMMAND, pickle_content(None), {FOLDER: str(self.folder)})

    def handle(self, message: Any) -> None:
        self._inbox.put(message)

    def run(self, content: bytes, progress: Progress | None, stoppable: bool) -> Any:
        """Make a call, and return its outcome.

        Args:
            content: the call, pickled.
            progress: called with each accepted step; an exception in it stops the call.
            stoppable: True if the call ends at a sensible point after the first Ctrl-C.
        """
        self.is_idle = False
        # as bytes, so that the other process can report what it cannot read
        self.send(content)
        error: BaseException | None = None  # of `progress`, raised once the call has ended
        while True:
            try:
                message = self._next()
                if isinstance(message, TraceLine) and progress is not None and error is None:
                    progress(message)
            except Stop:
                self.stop()
            except KeyboardInterrupt:
                if not stoppable:
                    raise
                # the second one ends the process
                stoppable = False
                self.stop()
            except Exception as raised:
                error = raised
                self.stop()
            else:
                if message is None:
                    raise InputError([self._crash()])
                if isinstance(message, logging.LogRecord):
                    _log(message)
                if isinstance(message, _End):
                    self.is_idle = True
                    repeat_warnings(message.warnings)
                    if error or message.error:
                        raise error or message.error  # type: ignore[misc]
                    return message.outcome

    def close(self) -> None:
        """End the process, and remove what it left behind."""
        super().close()
        remove_noted(self.folder)
        shutil.rmtree(self.folder, ignore_errors=True)

    def _next(self) -> Any:
        while True:
            with suppress(queue.Empty):
                return self._inbox.get(timeout=_POLL_INTERVAL)

    def _crash(self) -> Finding:
        self.process.wait()
        calls = [call for call in read_calls(self.folder) if call.process == self.process.pid]
        return crash_finding(calls, recorded_files(self.folder), self.process.returncode)


class _Processes:
    """The processes of this one that wait for their next calls."""

    def __init__(self) -> None:
        self._idle: list[_IsolatedProcess] = []
        self._room = threading.BoundedSemaphore(_MOST_PROCESSES)
        atexit.register(self.close)

    def run(self, content: bytes, progress: Progress | None, stoppable: bool) -> Any:
        """Make a call in a process that is idle, or in a new one."""
        with self._room:
            process = self._take()
            try:
                return process.run(content, progress, stoppable)
            finally:
                # one that still works, as after Ctrl-C, has no use for the next call
                if process.is_idle:
                    self._idle.append(process)
                else:
                    process.close()

    def close(self) -> None:
        """End all of them."""
        while self._idle:
            process = self._idle.pop()
            if process.owner == os.getpid():
                process.close()

    def _take(self) -> _IsolatedProcess:
        with suppress(IndexError):
            while True:
                process = self._idle.pop()
                # after a fork, those of the parent are not ours; others may have ended meanwhile
                if process.owner == os.getpid() and process.process.poll() is None:
                    return process
        return _IsolatedProcess()


_processes = _Processes()


def _log(record: logging.LogRecord) -> None:
    logger = logging.getLogger(record.name)
    if logger.isEnabledFor(record.levelno):
        logger.handle(record)


def main() -> None:
    """Make the calls that the process that started this one sends, until it closes the pipe."""
    connection = connect_to_parent()
    # there is none: the calls follow, each with its own
    connection.read_work()
    logger = logging.getLogger("kennfeld")
    logger.addHandler(_PipeHandler(connection))
    # printed here as well, a message would appear twice in the terminal
    logger.propagate = False
    connection.listen()
    while True:
        content = connection.messages.get()
        connection.stopping.clear()
        try:
            call = pickle.loads(content)
        except Exception as error:  # whatever the loading of a class of the caller raises
            connection.send(_End(None, _NotSentError(str(error)), ()))
            continue
        end = _make(call, connection)
        try:
            connection.send(end)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            connection.send(_End(None, _NotSentError(str(error)), ()))


def _make(call: _Request, connection: ParentConnection) -> _End:
    work: Callable[..., Any] = getattr(import_module(call.module), call.name)
    named = dict(call.arguments)
    if _PROGRESS in signature(work).parameters:
        named[_PROGRESS] = lambda line: _report(connection, line if call.reports else None)
    with suppress(OSError):  # files of models have whole paths
        os.chdir(call.folder)
    outcome, error = None, None
    # all of them: the filters of the caller decide there what is shown
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always")
        try:
            outcome = work(**named)
        except Exception as raised:
            error = raised
    return _End(outcome, error, tuple(each.message for each in issued))


def _report(connection: ParentConnection, line: TraceLine | None) -> None:
    if line is not None:
        connection.send(line)
    if connection.stopping.is_set():
        raise Stop


class _PipeHandler(logging.Handler):
    """Sends log messages to the process that started this one."""

    def __init__(self, connection: ParentConnection) -> None:
        super().__init__()
        self._connection = connection

    def emit(self, record: logging.LogRecord) -> None:
        # arguments and tracebacks may not be picklable; the text is what counts
        record.msg, record.args, record.exc_info = record.getMessage(), None, None
        self._connection.send(record)
