"""Processes that serve the app, forked from one that has loaded it: a new interpreter takes more than a second for that.

A forked process is as independent as a new one. It has its own memory, working directory and home, and can be killed.
Where nothing can be forked safely, each is a new interpreter.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any, Protocol

COMMAND = "import sys; sys.path[:] = {path!r}; from tests.app import app_processes; app_processes.{call}"
LIMIT = 65536  # bytes of a request


class AppProcess(Protocol):
    """A process that serves the app."""

    pid: int

    def kill(self) -> None: ...
    def terminate(self) -> None: ...
    def wait(self) -> int: ...


class ForkedProcess:
    """A process that another one has forked, which can wait for its end."""

    def __init__(self, source: "ForkingProcess", pid: int) -> None:
        self.pid, self._source, self._status = pid, source, None

    def kill(self) -> None:
        self._send(signal.SIGKILL)

    def terminate(self) -> None:
        self._send(signal.SIGTERM)

    def wait(self) -> int:
        if self._status is None:
            self._status = self._source.ask({"wait": self.pid})
        return self._status

    def _send(self, number: signal.Signals) -> None:
        if self._status is None:  # else the number may be that of another process
            os.kill(self.pid, number)


class ForkingProcess:
    """A process that has loaded the app, and forks. It ends, and what it has forked, if the connection to it is closed."""

    def __init__(self) -> None:
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = COMMAND.format(path=sys.path, call=f"fork_on_request({other.fileno()})")
        self._process = subprocess.Popen([sys.executable, "-c", command], pass_fds=[other.fileno()])
        other.close()

    def start(self, **settings: str | None) -> tuple[AppProcess, IO[str]]:
        reader, writer = os.pipe()
        pid = self.ask(settings, writer)
        os.close(writer)
        return ForkedProcess(self, pid), os.fdopen(reader, encoding="utf-8")

    def ask(self, request: dict[str, Any], *descriptors: int) -> int:
        socket.send_fds(self._socket, [json.dumps(request).encode()], descriptors)
        answer = self._socket.recv(LIMIT)
        assert answer, "the process that forks those of the app has ended"
        return int(answer)

    def close(self) -> None:
        self._socket.close()
        self._process.wait()


@cache
def forking_process() -> ForkingProcess:
    """Return the process that forks for this one, started once."""
    return ForkingProcess()


def end_forking_process() -> None:
    if forking_process.cache_info().currsize:
        forking_process().close()
        forking_process.cache_clear()


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
    if fresh or sys.platform != "linux":
        command = [sys.executable, "-c", COMMAND.format(path=sys.path, call=f"run_app(**{settings!r})")]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, encoding="utf-8")
        output = process.stdout
        assert output is not None
    else:
        process, output = forking_process().start(**settings)
    try:
        yield output.readline(), process
    finally:
        process.kill()
        process.wait()
        output.close()


def run_app(project: str | None, folder: str, home: str, prelude: str) -> None:
    """Run the app in this process."""
    from kennfeld.app.launch import launch

    os.environ.update(HOME=home, USERPROFILE=home)
    os.chdir(folder)
    exec(prelude)
    launch(project and Path(project), 0, browser=False)


def fork_on_request(descriptor: int) -> None:
    """Fork a process for each request, or wait for the end of one, until the connection is closed."""
    load_app()
    connection = socket.socket(fileno=descriptor)
    running: set[int] = set()
    while True:
        content, descriptors, _, _ = socket.recv_fds(connection, LIMIT, 1)
        if not content:
            break
        request = json.loads(content)
        if "wait" in request:
            _, answer = os.waitpid(request["wait"], 0)
            running.discard(request["wait"])
        elif answer := os.fork():
            os.close(*descriptors)
            running.add(answer)
        else:
            connection.close()
            run_forked(request, *descriptors)
        connection.send(str(answer).encode())
    for pid in running:
        os.kill(pid, signal.SIGKILL)


def run_forked(settings: dict[str, Any], output: int) -> None:
    """Run the app in a process that was just forked, and end it."""
    status = 1
    try:
        os.dup2(output, sys.stdout.fileno())
        os.close(output)
        run_app(**settings)
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(status)


def load_app() -> None:
    """Load what the app needs to serve projects of each kind, by serving them."""
    from kennfeld.app.questions import QUESTIONS
    from kennfeld.app.server.server import serve
    from kennfeld.app.workspace import AppWorkspace
    from kennfeld.errors import KennfeldError
    from kennfeld.project.demo import write

    with tempfile.TemporaryDirectory() as folder:
        os.environ.update(HOME=folder, USERPROFILE=folder)
        for demo in ("torque", "exhaust"):
            workspace = AppWorkspace(write(demo, Path(folder) / demo))
            workspace.snapshot()
            for question in QUESTIONS:
                with suppress(KennfeldError, LookupError):  # most need arguments; their modules are loaded
                    workspace.answer(question, {})
        with suppress(KeyboardInterrupt):
            serve(workspace, 0, lambda _: signal.raise_signal(signal.SIGINT))
