"""A worker process, and its connection to the process that started it.

Workers are fresh interpreters that exchange pickles through pipes, not `multiprocessing` processes: these would run the
user's script again on systems without `fork`, unless it is guarded. A worker that loses its pipe exits, so none
outlives a process that is killed. Ctrl-C reaches the main process only, which forwards it to the workers.
"""

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import IO, Any

from kennfeld.base.machine_code.crash_report import describe_end
from kennfeld.base.portable_pickle import pickle_content
from kennfeld.base.process_limits import MOST_PROCESSES, limit_foreign_code, machine_memory
from kennfeld.base.run_processes import RunProcesses, mark_of, marked_environment
from kennfeld.base.windows_job import WindowsJob

STOP = "stop"


class WorkerProcess:
    """A worker process, and the thread that receives its messages.

    Args:
        command: Python code that runs the worker; `{path}` in it stands for `sys.path`.
        work: what the worker reads first, pickled.
        variables: additional variables of its environment.
    """

    def __init__(self, command: str, work: bytes, variables: Mapping[str, str] | None = None) -> None:
        # a session of its own, so that Ctrl-C in the terminal does not reach the worker
        session: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            session = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
        arguments = [sys.executable or "python", "-c", command.format(path=sys.path)]
        environment = {**marked_environment(), **(variables or {})}
        self._processes, self._job = RunProcesses(mark_of(environment)), WindowsJob(MOST_PROCESSES, machine_memory())
        self.process = subprocess.Popen(
            arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, **session
        )
        self._job.add(self.process.pid)
        self._thread = threading.Thread(target=self._receive, args=(work,), daemon=True)
        self._thread.start()

    def handle(self, message: Any) -> None:
        """Take a message, None once the process has ended; called in the thread of this worker."""
        raise NotImplementedError

    def send(self, content: Any) -> None:
        self._write(pickle_content(content))

    def stop(self) -> None:
        """Stop the work at its next step."""
        self.send(STOP)

    def kill(self) -> None:
        """End the process at once."""
        self.process.kill()

    def describe_end(self) -> str:
        """Return how the process ended, once it has."""
        return describe_end(self.process.pid, self.process.returncode)

    def close(self) -> None:
        """End the process and those that foreign code has started in it, and close its pipes."""
        self.process.kill()
        self.process.wait()
        self._processes.end()
        self._job.close()
        if self._thread is not threading.current_thread():
            self._thread.join()
        for stream in (self.process.stdin, self.process.stdout):
            with suppress(OSError):
                stream.close()  # type: ignore[union-attr]

    def _receive(self, work: bytes) -> None:
        assert self.process.stdout is not None
        # in this thread: a large problem fills the pipe until the worker reads it
        self._write(work)
        with suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while True:
                self.handle(pickle.load(self.process.stdout))
        self.handle(None)

    def _write(self, content: bytes) -> None:
        assert self.process.stdin is not None
        with suppress(OSError, ValueError):  # a process that has ended is noticed by `_receive`
            self.process.stdin.write(content)
            self.process.stdin.flush()


class ParentConnection:
    """The pipes of a worker process to the process that started it; the worker exits if they are closed.

    `messages` and `stopping` are filled once the worker listens.
    """

    def __init__(self, incoming: IO[bytes], outgoing: IO[bytes]) -> None:
        self._incoming, self._outgoing = incoming, outgoing
        self.messages: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.stopping = threading.Event()
        self._sending = threading.Lock()  # threads log while another one reports progress

    def read_work(self) -> Any:
        """Return what the worker has to do: the content with which its process was started."""
        return pickle.load(self._incoming)

    def listen(self) -> None:
        """Receive messages in another thread."""
        threading.Thread(target=self._receive, daemon=True).start()

    def send(self, content: Any) -> None:
        pickled = pickle_content(content)
        try:
            with self._sending:
                self._outgoing.write(pickled)
                self._outgoing.flush()
        except OSError:
            os._exit(1)

    def _receive(self) -> None:
        try:
            while True:
                message = pickle.load(self._incoming)
                if message == STOP:
                    self.stopping.set()
                else:
                    self.messages.put(message)
        finally:
            # at once, without waiting for a start that is still running
            os._exit(0)


def connect_to_parent() -> ParentConnection:
    """Return the connection through stdin and stdout; from now on stdout is stderr, and Ctrl-C is ignored.

    Foreign code is limited as well.
    """
    limit_foreign_code()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    outgoing = os.fdopen(os.dup(1), "wb")
    with suppress(OSError):
        os.dup2(2, 1)  # printed text must not get between the pickles
    return ParentConnection(sys.stdin.buffer, outgoing)
