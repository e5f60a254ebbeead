"""SIGTERM and SIGHUP (SIGBREAK on Windows) act like Ctrl-C."""

import os
import signal
import sys
from contextlib import suppress
from types import FrameType

HANGUP: int | None = getattr(signal, "SIGHUP", None)  # the terminal has gone; not on Windows
REQUESTS = tuple(
    number for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if (number := getattr(signal, name, None)) is not None
)
STDOUT, STDERR = 1, 2


def end_like_ctrl_c() -> None:
    """Let these signals raise `KeyboardInterrupt` in this process; ignored ones stay ignored."""
    for number in REQUESTS:
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if number == HANGUP:
        leave_terminal()
    raise KeyboardInterrupt


def leave_terminal() -> None:
    """Redirect stdout and stderr to the null device if their terminal has gone, as every write would fail."""
    for stream, number in ((sys.__stdout__, STDOUT), (sys.__stderr__, STDERR)):
        with suppress(OSError, ValueError):
            if stream is not None and stream.fileno() == number and _gone(number):
                null_device = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null_device, number)
                os.close(null_device)


def _gone(number: int) -> bool:
    try:
        os.write(number, b"")
    except OSError:
        return True
    return False
