"""Processes that serve the app or run a calibration, forked from one that has loaded what they need.

A new interpreter takes more than a second for that. A forked process is as independent as a new one: it has its own
memory, working directory and home, and can be killed. Where forking is not safe, each is a new interpreter.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

FORKS = sys.platform == "linux"
COMMAND = "import sys; sys.path[:] = {path!r}; from tests.app import app_processes; app_processes.{call}"
LIMIT = 1_000_000  # bytes of a request


class ForkedProcess:
    """A process that another one has forked, with the part of `subprocess.Popen` that is used of it."""

    def __init__(self, source: "ForkingProcess", command: Sequence[str]) -> None:
        """Run a command `python -c code arguments` without a new interpreter."""
        theirs_in, stdin = os.pipe()
        stdout, theirs_out = os.pipe()
        self.pid = source.ask({"arguments": command[2:]}, theirs_in, theirs_out)
        os.close(theirs_in)
        os.close(theirs_out)
        self.stdin, self.stdout = os.fdopen(stdin, "wb"), os.fdopen(stdout, "rb")
        self.returncode: int | None = None
        self._source = source

    def kill(self) -> None:
        with suppress(ProcessLookupError):  # it has ended
            self._send(signal.SIGKILL)

    def terminate(self) -> None:
        with suppress(ProcessLookupError):
            self._send(signal.SIGTERM)

    def poll(self) -> int | None:
        with suppress(ProcessLookupError):
            self._send(0)
            return self.returncode
        return self.wait()

    def wait(self) -> int:
        if self.returncode is None:
            try:
                self.returncode = os.waitstatus_to_exitcode(self._source.ask({"wait": self.pid}))
            except OSError:  # the source was closed at the end of all tests, and has ended this process
                self.returncode = -signal.SIGKILL
        return self.returncode

    def _send(self, number: int) -> None:
        if self.returncode is None:  # else the number may be that of another process
            os.kill(self.pid, number)


class ForkingProcess:
    """A process that has loaded the app, and forks. It ends, with what it has forked, if the connection is closed."""

    def __init__(self, *, fresh: bool) -> None:
        """Start a new interpreter, or fork this process, which has loaded the app and has one thread."""
        self._lock, self._process = threading.Lock(), None
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        if fresh:
            command = COMMAND.format(path=sys.path, call=f"load_and_fork({other.fileno()})")
            self._process = subprocess.Popen([sys.executable, "-c", command], pass_fds=[other.fileno()])
        elif not os.fork():
            self._socket.close()
            fork_on_request(other)
            os._exit(0)
        other.close()

    def ask(self, request: dict[str, Any], *descriptors: int) -> int:
        with self._lock:
            socket.send_fds(self._socket, [json.dumps(request).encode()], descriptors)
            answer = self._socket.recv(LIMIT)
        if not answer:
            raise ConnectionError("the process that forks has ended")
        return int(answer)

    def close(self) -> None:
        self._socket.close()
        if self._process is not None:
            self._process.wait()


@cache
def forking_process() -> ForkingProcess:
    """Return the process that forks for this one, started once."""
    return ForkingProcess(fresh=True)


def end_forking_process() -> None:
    if forking_process.cache_info().currsize:
        forking_process().close()
        forking_process.cache_clear()


class ForkingSubprocess:
    """Replaces the module `subprocess` where workers are started by `python -c`."""

    PIPE, DEVNULL = subprocess.PIPE, subprocess.DEVNULL

    def __init__(self, source: ForkingProcess) -> None:
        self._source = source

    def Popen(self, command: Sequence[str], stdin: int = PIPE, **_: object) -> ForkedProcess:
        process = ForkedProcess(self._source, command)
        if stdin == subprocess.DEVNULL:
            process.stdin.close()
        return process


def fork_workers(monkeypatch: pytest.MonkeyPatch, source: ForkingProcess) -> None:
    """Start the processes of calibrations and trainings without new interpreters."""
    for module in ("kennfeld.optimize.search.worker_process", "kennfeld.app.session.surrogate_training"):
        monkeypatch.setattr(f"{module}.subprocess", ForkingSubprocess(source))


def fork_own_workers() -> None:
    """Let a forked server start its workers so; called while it has one thread."""
    fork_workers(pytest.MonkeyPatch(), ForkingProcess(fresh=False))


AppProcess = ForkedProcess | subprocess.Popen[bytes]


@contextmanager
def app_process(
    project: Path | None, folder: Path, home: Path, prelude: str = "", *, fresh: bool = False
) -> Iterator[tuple[str, AppProcess]]:
    """Start the app; yields the line that it prints, and its process.

    Args:
        project: the project file; None shows the start page.
        folder: working directory.
        home: folder of the user.
        prelude: a statement that the process runs first.
        fresh: start a new interpreter, as a user does.
    """
    settings = {"project": project and str(project), "folder": str(folder), "home": str(home), "prelude": prelude}
    command = [sys.executable, "-c", COMMAND.format(path=sys.path, call=f"run_app(**{settings!r})")]
    process: AppProcess
    if FORKS and not fresh:
        process = ForkedProcess(forking_process(), command)
    else:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        yield process.stdout.readline().decode(), process
    finally:
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()


def run_app(project: str | None, folder: str, home: str, prelude: str) -> None:
    """Run the app in this process."""
    from kennfeld.app.launch import launch

    os.environ.update(HOME=home, USERPROFILE=home)
    os.chdir(folder)
    exec(prelude)
    launch(Path(project) if project else None, 0, browser=False)


def load_and_fork(descriptor: int) -> None:
    load_app()
    fork_on_request(socket.socket(fileno=descriptor))


def fork_on_request(connection: socket.socket) -> None:
    """Fork a process for each request, or wait for the end of one, until the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the tests, which close the connection
    running: set[int] = set()
    while True:
        content, descriptors, _, _ = socket.recv_fds(connection, LIMIT, 2)
        if not content:
            break
        request = json.loads(content)
        if "wait" in request:
            _, answer = os.waitpid(request["wait"], 0)
            running.discard(request["wait"])
        elif answer := os.fork():
            running.add(answer)
        else:
            connection.close()
            run_forked(request["arguments"], *descriptors)
        for each in descriptors:
            os.close(each)
        connection.send(str(answer).encode())
    for pid in running:
        os.kill(pid, signal.SIGKILL)


def run_forked(arguments: list[str], stdin: int, stdout: int) -> None:
    """Run code in a process that was just forked, and end it."""
    status = 1
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number, descriptor in enumerate((stdin, stdout)):
            os.dup2(descriptor, number)
            os.close(descriptor)
        sys.argv = ["-c", *arguments[1:]]
        exec(arguments[0], {"__name__": "__main__"})
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        with suppress(OSError):
            sys.stdout.flush()
        os._exit(status)


def load_app() -> None:
    """Load what the app and its workers need, by serving a project and running a small one."""
    from kennfeld import calibrate
    from kennfeld.app.questions import QUESTIONS
    from kennfeld.app.server.serving import serve
    from kennfeld.app.workspace import AppWorkspace
    from kennfeld.base.errors import KennfeldError
    from kennfeld.project.demo import write

    for module in ("design_work", "run_job", "side_work", "surrogate_training", "term_search"):
        import_module(f"kennfeld.app.session.{module}")
    with tempfile.TemporaryDirectory() as folder:
        os.environ.update(HOME=folder, USERPROFILE=folder)
        workspace = AppWorkspace(write("torque", Path(folder) / "torque"))
        workspace.snapshot(workspace.latest)
        for question in QUESTIONS:
            with suppress(KennfeldError, LookupError):  # most need arguments; their modules are loaded
                workspace.answer(question, {})
        with suppress(KeyboardInterrupt):
            serve(workspace, 0, lambda _: None, prepare=lambda: os.kill(os.getpid(), signal.SIGINT))
    _ = calibrate("y = a * x", {"x": [1.0, 2.0, 3.0], "z": [1.0, 2.0, 4.0]}, {"a": 0.0}, target="z").trust
