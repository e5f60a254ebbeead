"""Ctrl-C, SIGTERM and SIGHUP: the first ends the descent at the best values so far, the second ends the program."""

import os
import signal
import threading
from contextlib import suppress
from types import FrameType, TracebackType
from typing import Any, Self

from kennfeld.optimize import Progress, Stop, TraceLine
from kennfeld.terminal.signals import HANGUP, REQUESTS, leave_terminal

__all__ = ["EXIT_STATUS", "Interrupt"]

EXIT_STATUS = 130


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
