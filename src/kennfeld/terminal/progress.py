"""Shows how a descent goes: a live line on a terminal, plain lines elsewhere; on stderr, always.

Ctrl-C, SIGTERM and SIGHUP: the first ends the descent at the best values so far, the second ends the program.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import Any, Protocol, Self

from kennfeld.optimize import Progress, Stop, TraceLine
from kennfeld.terminal.output import print_findings
from kennfeld.terminal.signals import HANGUP, REQUESTS, leave_terminal

__all__ = ["Interrupt", "display"]

PAUSE = 0.5  # s between plain lines of one stage

EXIT_STATUS = 130


class Display(Protocol):
    """Hears of every accepted step."""

    def __call__(self, line: TraceLine) -> None:
        """Show a step."""


@contextmanager
def display(task: str, starts: int = 1) -> Iterator[Display]:
    """Show the progress of a task while the block runs; of several starts, each line says of which."""
    if not sys.stderr.isatty():
        yield _Lines(starts)
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn("line"), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as live:
        yield _Live(live, live.add_task(task, total=None), starts)


class _Lines:
    """A line for each stage, and one now and then; of several starts a line for each, and one now and then."""

    def __init__(self, starts: int) -> None:
        self._several = starts > 1
        self._stages: dict[int, str] = {}
        self._shown = 0.0

    def __call__(self, line: TraceLine) -> None:
        now = time.monotonic()
        before = self._stages.get(line.start)
        new = before is None or (before != line.stage and not self._several)
        if new or now - self._shown >= PAUSE:
            self._shown = now
            print_findings(_words(line, self._several))
        self._stages[line.start] = line.stage


class _Live:
    """One line that changes in place."""

    def __init__(self, live: Any, task: Any, starts: int) -> None:
        self._live, self._task, self._several = live, task, starts > 1

    def __call__(self, line: TraceLine) -> None:
        self._live.update(self._task, description=_words(line, self._several))


def _words(line: TraceLine, several: bool) -> str:
    start = f"start {line.start:>2}  " if several else ""
    return f"{start}{line.stage:<15} iteration {line.iteration:>3}  cost {line.cost:<10.5g} RMSE {line.rmse:.4g}"


class Interrupt:
    """Within its block, Ctrl-C is noted and the descent told to stop at its next step. So are SIGTERM and SIGHUP.

    Until the first step has been reported, Ctrl-C raises `KeyboardInterrupt` as ever: a descent under way catches it,
    and before that there is nothing to keep.
    """

    def __init__(self) -> None:
        self.pressed = False
        self._descending = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, *REQUESTS):
                if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores SIGHUP
                    self._before[number] = signal.signal(number, self._press)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def watch(self, progress: Progress) -> Progress:
        """The same progress, which stops the descent once Ctrl-C was pressed."""

        def watched(line: TraceLine) -> None:
            self._descending = True
            progress(line)
            if self.pressed:
                raise Stop

        return watched

    def _press(self, number: int, frame: FrameType | None) -> None:
        if number == HANGUP:
            leave_terminal()
            if self.pressed:
                return  # shell and kernel both send it as a terminal closes; nobody presses twice there
        if self.pressed:
            raise SystemExit(EXIT_STATUS)
        self.pressed = True
        if not self._descending:
            raise KeyboardInterrupt
        # not print: the signal may have come in the midst of one
        with suppress(OSError):
            os.write(2, b"\nStopping at the best values so far; Ctrl-C again gives up.\n")
