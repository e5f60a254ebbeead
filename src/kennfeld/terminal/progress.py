"""Progress of reading and of a search on stderr, and its interruption.

Progress is a live line on a terminal and plain lines elsewhere. Of Ctrl-C, SIGTERM and SIGHUP, the first ends the
search at the best values so far and the second ends the program.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import Any, Self

from kennfeld.optimize.fit.result import Progress, TraceLine
from kennfeld.optimize.solver.levenberg_marquardt import Stop
from kennfeld.terminal.command_line import INTERRUPTED
from kennfeld.terminal.output import is_quiet, print_progress
from kennfeld.terminal.signals import FORWARDED, HANGUP, leave_terminal, requests

LINE_INTERVAL = 0.5  # s between plain lines of one stage
READING_INTERVAL = 2.0  # s between plain lines while files are read


@contextmanager
def display(task: str, starts: int = 1) -> Iterator[Progress]:
    """Show the progress of a task while the block runs; each line names its start if there are several."""
    if is_quiet() or not sys.stderr.isatty():
        yield _Lines(starts)
        return
    from rich import progress
    from rich.console import Console

    columns = progress.SpinnerColumn("line"), progress.TextColumn("{task.description}", markup=False)
    clock = progress.TimeElapsedColumn()
    with progress.Progress(*columns, clock, console=Console(stderr=True), transient=True) as live:
        number = live.add_task(task, total=None)
        yield lambda line: live.update(number, description=_format(line, starts > 1))


class _Lines:
    """A line for each new stage, or for each of several starts; then at most one per `LINE_INTERVAL`."""

    def __init__(self, starts: int) -> None:
        self._several = starts > 1
        self._stages: dict[int, str] = {}
        self._shown = 0.0

    def __call__(self, line: TraceLine) -> None:
        now = time.monotonic()
        before = self._stages.get(line.start)
        # several starts alternate, so that nearly every line would be a new stage
        new = before is None or (before != line.stage and not self._several)
        if new or now - self._shown >= LINE_INTERVAL:
            self._shown = now
            print_progress(_format(line, self._several))
        self._stages[line.start] = line.stage


def _format(line: TraceLine, several: bool) -> str:
    start = f"start {line.start:>2}  " if several else ""
    return f"{start}{line.stage:<15} iteration {line.iteration:>3}  cost {line.cost:<10.5g} RMSE {line.rmse:.4g}"


class ReadingProgress:
    """Shows how many files of a dataset have been read, once that takes longer than `READING_INTERVAL`."""

    def __init__(self) -> None:
        self._shown, self._width = time.monotonic(), 0

    def __call__(self, done: int, total: int) -> None:
        """Show the progress; the last call removes it from a terminal."""
        live = sys.stderr.isatty() and not is_quiet()
        if live and self._width and done == total:
            sys.stderr.write(f"\r{' ' * self._width}\r")
            self._width = 0
        elif done < total and time.monotonic() - self._shown >= (LINE_INTERVAL if live else READING_INTERVAL):
            self._shown, line = time.monotonic(), f"reading: {done} of {total} files"
            if live:
                self._width = len(line)
                sys.stderr.write(f"\r{line}")
                sys.stderr.flush()
            else:
                print_progress(line)


class Interrupt:
    """Within its block, Ctrl-C, SIGTERM and SIGHUP stop the search at its next step instead of ending the process.

    Until the first step has been reported, they raise `KeyboardInterrupt`, as there is nothing to keep.
    """

    def __init__(self) -> None:
        self.pressed = False
        self._searching = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        # Python sets handlers in the main thread only
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._press) for number in requests()}
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def watch(self, progress: Progress) -> Progress:
        """Return the same progress, but raising `Stop` after a signal."""

        def watched(line: TraceLine) -> None:
            self._searching = True
            progress(line)
            if self.pressed:
                raise Stop

        return watched

    def stopped(self) -> bool:
        """Return whether there was a signal; from the first call on there is something to keep."""
        self._searching = True
        return self.pressed

    def _press(self, number: int, frame: FrameType | None) -> None:
        if number in (HANGUP, FORWARDED):
            leave_terminal()
        if number == HANGUP and self.pressed:
            return  # shell and kernel both send it as a terminal closes; nobody presses twice there
        if self.pressed:
            raise SystemExit(INTERRUPTED)
        self.pressed = True
        if not self._searching:
            raise KeyboardInterrupt
        if is_quiet():
            return
        # not print: the signal may interrupt one
        with suppress(OSError):
            os.write(2, b"\nStopping at the best values so far. Press Ctrl-C again to exit without results.\n")
