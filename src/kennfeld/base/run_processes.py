"""The processes of a run, found by a mark in their environment.

Processes that foreign code forks, and programs that it starts, inherit the mark. They keep it in a session of their
own and after their parent has ended, where neither a process group nor a list of children finds them. A program that
is started with another environment is not found. Windows has job objects instead.
"""

import os
import re
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

MARK = "KENNFELD_RUN"  # environment variable: tokens of a process of Kennfeld and of those that started it
_LINUX = sys.platform.startswith("linux")
_PROCESSES = Path("/proc")
_PATTERN = re.compile(rb"(?:^|[\0 ])" + MARK.encode() + rb"=([\w/]*)")
_ROUNDS, _PAUSE = 100, 0.02  # s, until processes that are ended fork no more
_KIB = 1024
_ZOMBIE = b"Z"


class RunProcess(NamedTuple):
    """A process of a run: its number, its mark, empty if it has ended but its parent does not know, and its memory."""

    number: int
    mark: str
    memory: int  # bytes


def marked_environment() -> dict[str, str]:
    """Return the environment for a new process of Kennfeld: this one, and a mark of its own below that of this one."""
    return {**os.environ, MARK: f"{os.environ.get(MARK, '')}/{secrets.token_hex(8)}"}


def mark_of(environment: Mapping[str, str]) -> str:
    """Return the mark of an environment."""
    return environment[MARK]


@contextmanager
def unmarked() -> Iterator[None]:
    """Let programs that the block starts outlive the run, such as the user's browser."""
    mark = os.environ.pop(MARK, None)
    try:
        yield
    finally:
        if mark is not None:
            os.environ[MARK] = mark


class RunProcesses:
    """The processes with a mark, and with marks below it; looking again costs little."""

    def __init__(self, mark: str) -> None:
        self._mark = mark
        self._others: set[int] = set()  # on Linux, a process gets no mark later

    def find(self) -> list[RunProcess]:
        """Return the running processes, and ended ones that their parents do not wait for; none on Windows."""
        if _LINUX:
            return self._listed_by_kernel()
        return [] if os.name == "nt" else self._listed_by_command()

    def surplus(self) -> int:
        """Return the number of processes that Kennfeld did not start itself: each of its own has another mark."""
        processes = self.find()
        return len(processes) - len({process.mark for process in processes if process.mark})

    def takes_more_than(self, memory: int) -> bool:
        """Return whether the processes take more than so many bytes together."""
        processes = self.find()
        if sum(process.memory for process in processes) <= memory:
            return False
        # forks share memory until they write; the exact share takes long to compute
        return not _LINUX or sum(_share(process.number) for process in processes) > memory

    def end(self) -> None:
        """End all of them at once, those included that they start meanwhile."""
        own = os.getpid()
        for _ in range(_ROUNDS):
            self._others.clear()  # the numbers of processes that have ended may be those of others
            running = [process.number for process in self.find() if process.mark and process.number != own]
            for number in running:
                with suppress(OSError):
                    os.kill(number, getattr(signal, "SIGKILL", signal.SIGTERM))
            if not running:
                return
            time.sleep(_PAUSE)

    def _belongs(self, mark: str) -> bool:
        return mark == self._mark or mark.startswith(f"{self._mark}/")

    def _listed_by_kernel(self) -> list[RunProcess]:
        numbers = {int(path.name) for path in _PROCESSES.iterdir() if path.name.isdigit()}
        self._others &= numbers
        processes, ended = [], []
        for number in sorted(numbers - self._others):
            try:
                environment = _environment_of(number)
                match = _PATTERN.search(environment)
                if match and self._belongs(match[1].decode("ascii", "replace")):
                    processes.append(RunProcess(number, match[1].decode(), _resident(number)))
                # kernel threads have no environment either, but they run
                elif not environment and (parent := _parent_of_zombie(number)):
                    ended.append((number, parent))
                else:
                    self._others.add(number)
            except OSError:  # of another user, or it has ended
                self._others.add(number)
        own = {process.number for process in processes}
        return processes + [RunProcess(number, "", 0) for number, parent in ended if parent in own]

    def _listed_by_command(self) -> list[RunProcess]:
        # -E adds the environment of each process
        command = ["ps", "-axwwE", "-o", "pid=,rss=,command="]
        with suppress(OSError, subprocess.SubprocessError):
            listed = subprocess.run(command, capture_output=True, check=False, timeout=5).stdout
            return list(self._parsed(listed))
        return []

    def _parsed(self, listed: bytes) -> Iterator[RunProcess]:
        for line in listed.splitlines():
            fields, match = line.split(None, 2), _PATTERN.search(line)
            if match and len(fields) == 3 and self._belongs(match[1].decode("ascii", "replace")):
                yield RunProcess(int(fields[0]), match[1].decode(), _KIB * int(fields[1]))


def _environment_of(number: int) -> bytes:
    """Return the environment with which the program of a process on Linux was started; empty if it has ended."""
    try:
        return (_PROCESSES / str(number) / "environ").read_bytes()
    except ProcessLookupError:
        return b""


def _resident(number: int) -> int:
    """Return the memory of a process on Linux that it does not share with files, in bytes."""
    with suppress(OSError, ValueError, IndexError):
        pages = (_PROCESSES / str(number) / "statm").read_bytes().split()
        return (int(pages[1]) - int(pages[2])) * os.sysconf("SC_PAGE_SIZE")
    return 0


def _share(number: int) -> int:
    """Return the memory of a process on Linux in bytes, of shared memory its share."""
    with suppress(OSError, ValueError, IndexError):
        lines = (_PROCESSES / str(number) / "smaps_rollup").read_bytes().splitlines()
        return next(_KIB * int(line.split()[1]) for line in lines if line.startswith(b"Pss:"))
    return 0


def _parent_of_zombie(number: int) -> int:
    """Return the parent of a process on Linux that has ended; 0 if it runs."""
    # the name in parentheses may itself contain blanks and parentheses
    fields = (_PROCESSES / str(number) / "stat").read_bytes().rpartition(b")")[2].split()
    return int(fields[1]) if fields[0] == _ZOMBIE else 0
