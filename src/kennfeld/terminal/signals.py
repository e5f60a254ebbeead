"""SIGTERM and SIGHUP (SIGBREAK on Windows) act like Ctrl-C.

A process that another one watches gets these through it: a terminal sends Ctrl-C to both, `kill` to one of them, and
each must count once. Windows has no such signal; there a console sends Ctrl-C to both, and each obeys its own.
"""

import os
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

HANGUP: int | None = getattr(signal, "SIGHUP", None)  # the terminal has gone; not on Windows
REQUESTS = tuple(
    number for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if (number := getattr(signal, name, None)) is not None
)
FORWARDED: int | None = getattr(signal, "SIGUSR1", None)  # what a watching process sends in their place
STDOUT, STDERR = 1, 2

_watched: list[bool] = []  # not empty if requests arrive as FORWARDED


def end_like_ctrl_c() -> None:
    """Let these signals raise `KeyboardInterrupt` in this process; ignored ones stay ignored."""
    for number in REQUESTS:
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _interrupt)


def requests() -> tuple[int, ...]:
    """Return the signals that ask this process to end, Ctrl-C included, without those that are ignored."""
    if _watched and FORWARDED is not None:
        return (FORWARDED,)
    return (signal.SIGINT, *respected(REQUESTS))  # nohup: SIGHUP


def respected(numbers: Iterable[int]) -> list[int]:
    """Return those signals that are not ignored."""
    return [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]


@contextmanager
def held_back() -> Iterator[None]:
    """Let requests wait until the end of the block; processes that are started in it begin with them held back."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, *REQUESTS))
    try:
        yield
    finally:
        _let_through()


def obey_forwarded() -> None:
    """Let requests count in this process only if the process that watches it forwards them."""
    if FORWARDED is None:
        end_like_ctrl_c()
        return
    _watched.append(True)
    for number in respected((signal.SIGINT, *REQUESTS)):
        signal.signal(number, _leave_to_watcher)
    # handlers first: requests that were held back since the start arrive as soon as they are let through
    signal.signal(FORWARDED, _take_forwarded)
    _let_through()


def _let_through() -> None:
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, *REQUESTS))


def _leave_to_watcher(number: int, frame: FrameType | None) -> None:
    """Do nothing, unlike an ignored signal, which processes that this one starts would ignore as well."""


def _take_forwarded(number: int, frame: FrameType | None) -> None:
    """Act as on SIGTERM, for which a server may have a handler of its own."""
    own = signal.getsignal(signal.SIGTERM)
    if callable(own) and own is not _leave_to_watcher:
        own(signal.SIGTERM, frame)
    else:
        _interrupt(number, frame)


def _interrupt(number: int, frame: FrameType | None) -> None:
    if number in (HANGUP, FORWARDED):
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
        # writes nothing, but fails if the terminal has gone
        os.write(number, b"")
    except OSError:
        return True
    return False
