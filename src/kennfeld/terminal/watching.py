"""Runs a command in a process of its own and watches it, because its project calls foreign code.

Foreign code may crash its process, never return, or take the whole machine. The command then ends with a message that
names it. It leaves no temporary files, and none of the processes that foreign code has started. Otherwise nothing
differs: the process uses the same terminal, and its exit status is returned.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Hashable, Sequence
from contextlib import suppress
from pathlib import Path
from types import FrameType

from kennfeld.base.errors import Finding
from kennfeld.base.machine_code.call_record import ForeignCall, read_calls, recorded_files
from kennfeld.base.machine_code.crash_report import crash_finding, excess_finding, hang_finding, unloading_finding
from kennfeld.base.process_limits import MOST_PROCESSES, machine_memory
from kennfeld.base.run_processes import RunProcesses, mark_of, marked_environment
from kennfeld.base.watch_folder import FOLDER, WATCHER, is_running, remove_noted
from kennfeld.base.windows_job import WindowsJob
from kennfeld.terminal.command_line import INTERRUPTED, WRONG_INPUT
from kennfeld.terminal.output import print_findings
from kennfeld.terminal.signals import FORWARDED, HANGUP, REQUESTS, held_back, leave_terminal, respected
from kennfeld.terminal.watched_commands import APP
from kennfeld.terminal.watched_process import ENDED, PROCESS

INTERVAL = 0.5  # s between looks at the records of calls
PATIENCE = 10.0  # s from the second request to end until the process is killed, or after its work is done
_MOST_IN_JOB = 512  # processes on Windows, workers included
_MEMORY_SHARE = 0.9  # of the memory of the machine
# `-c` puts the present folder first on the search path, which may hold modules of any name
_COMMAND = "import sys; sys.path[:] = {path!r}; from kennfeld.cli import main; main()"
_CLEAR = "\r\x1b[2K\x1b[?25h"  # removes the line of progress and shows the cursor


def run_watched(arguments: Sequence[str], limit: float) -> int:
    """Run a command line in a process of its own, and return its exit status.

    Args:
        arguments: of the command line.
        limit: how long a call of foreign code may take, in s.
    """
    folder = Path(tempfile.mkdtemp(prefix="kennfeld-"))
    environment = marked_environment()
    processes, job = RunProcesses(mark_of(environment)), _job(arguments)
    try:
        return _WatchedCommand(arguments, folder, environment, processes, job).run(limit)
    finally:
        # first the processes, which write into the folder
        processes.end()
        job.close()
        remove_noted(folder)
        shutil.rmtree(folder, ignore_errors=True)


def _job(arguments: Sequence[str]) -> WindowsJob:
    """Return the job of a command on Windows; that of the app has no limits, nor does it end the browser."""
    if arguments[0] == APP:
        return WindowsJob(breakaway=True)
    return WindowsJob(_MOST_IN_JOB, machine_memory())


class _WatchedCommand:
    def __init__(
        self,
        arguments: Sequence[str],
        folder: Path,
        environment: dict[str, str],
        processes: RunProcesses,
        job: WindowsJob,
    ) -> None:
        self._folder, self._processes = folder, processes
        self._excess = ""
        self._requests = 0  # to end
        self._requested = 0.0  # when the last one came
        self._done = threading.Event()
        environment |= {FOLDER: str(folder), WATCHER: str(os.getpid())}
        command = [sys.executable, "-c", _COMMAND.format(path=sys.path), *arguments]
        # a request in between would end this process without reaching the other one
        with held_back():
            self._process = subprocess.Popen(command, env=environment)
            job.add(self._process.pid)
            for number in respected((signal.SIGINT, *REQUESTS)):
                signal.signal(number, self._forward)
        threading.Thread(target=self._wait, daemon=True).start()

    def run(self, limit: float) -> int:
        """Wait for the end, report what went wrong, and return the exit status."""
        hanging = self._watch(limit)
        status = self._process.returncode
        # work that is done counts, however the process ended after it
        ended = self._folder / ENDED
        if ended.is_file():
            return self._finish(ended.read_text("ascii"), status)
        if self._excess:
            _report(excess_finding(recorded_files(self._folder), self._excess))
        elif hanging:
            _report(hang_finding(hanging, limit))
        elif self._requests:
            return INTERRUPTED
        else:
            # calls of its workers do not explain why the process itself ended
            own = [call for call in read_calls(self._folder) if str(call.process) == self._number()]
            _report(crash_finding(own, recorded_files(self._folder), status))
        return WRONG_INPUT

    def _watch(self, limit: float) -> Sequence[ForeignCall]:
        """Wait for the end; end the process if it hangs, and return the calls in which it does."""
        monitor = _CallMonitor(limit)
        while not self._done.wait(INTERVAL):
            hanging = monitor.overdue(read_calls(self._folder))
            self._excess = self._find_excess()
            given_up = self._requests > 1 and time.monotonic() - self._requested > PATIENCE
            if (
                self._excess
                or hanging
                or given_up
                or monitor.lasts("ending", PATIENCE, (self._folder / ENDED).is_file())
            ):
                # the call may hang in a worker
                for process in {call.process for call in hanging}:
                    with suppress(OSError):
                        os.kill(process, getattr(signal, "SIGKILL", signal.SIGTERM))
                self._process.kill()
                self._processes.end()
                self._done.wait()
                return hanging
        return ()

    def _find_excess(self) -> str:
        """Return what the processes take too much of."""
        if self._processes.surplus() > MOST_PROCESSES:
            return f"more than {MOST_PROCESSES} processes"
        memory = int(_MEMORY_SHARE * machine_memory())
        if memory and self._processes.takes_more_than(memory):
            return f"more than {memory / 1e9:.3g} GB of memory"
        return ""

    def _finish(self, text: str, status: int) -> int:
        """Return the exit status of a process that has done its work."""
        # empty if an exception ended the command
        if not text or int(text) == status:
            return status
        _report(unloading_finding(recorded_files(self._folder), status))
        return int(text)

    def _wait(self) -> None:
        self._process.wait()
        self._done.set()

    def _forward(self, number: int, frame: FrameType | None) -> None:
        if number == HANGUP:
            leave_terminal()
            if self._requests:
                return  # shell and kernel both send it
        self._requests, self._requested = self._requests + 1, time.monotonic()
        if FORWARDED is not None:
            self._process.send_signal(FORWARDED)

    def _number(self) -> str:
        file = self._folder / PROCESS
        return file.read_text("ascii") if file.is_file() else ""


class _CallMonitor:
    """Tells which calls take longer than a limit; time in which the computer or the processes sleep does not count."""

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._seconds: dict[tuple[Hashable, int], float] = {}
        self._looked = time.monotonic()
        self._passed = 0.0
        self._ended: set[int] = set()  # processes, whose numbers others may get

    def overdue(self, calls: Sequence[ForeignCall]) -> list[ForeignCall]:
        """Return the calls of running processes that have lasted for longer than the limit."""
        now = time.monotonic()
        # a longer gap means that the computer was asleep
        self._passed, self._looked = min(now - self._looked, 2 * INTERVAL), now
        self._ended.update(number for number in {call.process for call in calls} if not is_running(number))
        running = [call for call in calls if call.process not in self._ended]
        return [call for call in running if self.lasts(call.slot, self._limit, True, call.number)]

    def lasts(self, name: Hashable, limit: float, condition: bool, number: int = 0) -> bool:
        """Return if a condition has lasted longer than a limit since `number` changed."""
        entry = (name, number)
        # another number is another call, whose time begins anew
        self._seconds = {key: value for key, value in self._seconds.items() if key == entry or key[0] != name}
        # the first look counts 0 s, as the condition may just have come true
        self._seconds[entry] = self._seconds.get(entry, -self._passed) + self._passed if condition else 0.0
        return self._seconds[entry] > limit


def _report(finding: Finding) -> None:
    if sys.stderr.isatty():
        with suppress(OSError):
            sys.stderr.write(_CLEAR)
    print_findings(finding)
