"""The training of a surrogate in a process of its own, so that the session stays responsive and a stop is immediate.

The worker is a fresh interpreter that writes a line of JSON for each line of progress, and one for the end.
"""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from kennfeld.base.errors import ArgumentError, KennfeldError

COMMAND = "import sys; sys.path[:] = {path!r}; from kennfeld.app.session.surrogate_training import main; main()"
MAX_LINES = 200  # of progress that are kept

Message = Mapping[str, Any]


class SurrogateTraining:
    """The running or last training of a session. All methods are called from the thread of the session.

    Args:
        changed: called from another thread when there is something for `pump`.

    Attributes:
        state: idle, running, trained, failed or stopped.
        file: the training file.
        lines: what the training has reported, the newest last.
        seconds: how long it has run.
    """

    def __init__(self, changed: Callable[[], object]) -> None:
        self.state, self.file, self.seconds = "idle", "", 0.0
        self.lines: list[str] = []
        self._changed, self._began = changed, 0.0
        self._process: subprocess.Popen[bytes] | None = None
        self._inbox: queue.SimpleQueue[tuple[object, Message]] = queue.SimpleQueue()

    def start(self, path: Path) -> None:
        """Train what a training file describes. Raises `ArgumentError` if a training is running."""
        if self._process is not None:
            raise ArgumentError(f"the training of {self.file} is in progress; stop it first")
        # a group of its own: Ctrl-C in the terminal ends the app, which ends its worker itself
        session: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            session = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
        command = [sys.executable or "python", "-c", COMMAND.format(path=sys.path), str(path)]
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, **session)
        self.state, self.file, self.lines, self.seconds = "running", path.name, [], 0.0
        self._process, self._began = process, time.monotonic()
        threading.Thread(target=self._receive, args=(process,), daemon=True).start()

    def stop(self) -> None:
        """End a running training at once; the file of the surrogate stays as it was."""
        if self._process is not None:
            self._process.kill()
            self._end("stopped", "stopped")

    def pump(self) -> bool:
        """Handle what the training has reported; return True if it has written its file."""
        written = False
        while not self._inbox.empty():
            process, message = self._inbox.get()
            if process is not self._process:
                continue  # of a training that was stopped
            self.seconds = time.monotonic() - self._began
            if "line" in message:
                self.lines = [*self.lines, str(message["line"])][-MAX_LINES:]
            else:
                written = "written" in message
                self._end("trained" if written else "failed", str(message.get("written") or message["failed"]))
        return written

    def _end(self, state: str, line: str) -> None:
        self.seconds = time.monotonic() - self._began
        self.state, self._process = state, None
        self.lines = [*self.lines, line][-MAX_LINES:]

    def _receive(self, process: subprocess.Popen[bytes]) -> None:
        """Read the reports of a worker; runs in a thread of its own."""
        assert process.stdout is not None
        ended = False
        for text in process.stdout:
            with suppress(ValueError):
                message = json.loads(text)
                # the end is the one message that is not a line of progress
                ended = ended or "line" not in message
                self._put(process, message)
        code = process.wait()
        process.stdout.close()
        if not ended:
            self._put(process, {"failed": f"The process of the training ended unexpectedly (exit status {code})."})

    def _put(self, process: object, message: Message) -> None:
        self._inbox.put((process, message))
        self._changed()


def main() -> None:
    """Run the worker: train what the training file named on the command line describes, and write the surrogate."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    outgoing = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    with suppress(OSError):
        os.dup2(2, 1)  # printed text must not get between the lines

    def send(**message: str) -> None:
        outgoing.write(f"{json.dumps(message)}\n")

    from kennfeld.base.errors import Findings
    from kennfeld.project.fallback import write_surrogate_somewhere
    from kennfeld.project.surrogate_training import read_training

    try:
        training = read_training(sys.argv[1])
        surrogate = training.train(lambda line: send(line=line), warn=lambda finding: send(line=f"Warning: {finding}"))
        findings = Findings()
        write_surrogate_somewhere(surrogate, training.target, findings)
        findings.finish()
    except KennfeldError as error:
        send(failed=str(error))
        return
    send(written=f"Written to {training.target.name}, {surrogate.expansion.size} centres")
