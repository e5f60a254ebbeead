"""Shows how a descent goes: a live line on a terminal, plain lines elsewhere; on stderr, always."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from kennfeld.optimize import TraceLine
from kennfeld.terminal.output import complain

__all__ = ["Display", "display"]

PAUSE = 0.5  # s between plain lines of one stage


class Display(Protocol):
    """Hears of every accepted step."""

    def __call__(self, line: TraceLine) -> None:
        """Show a step."""


@contextmanager
def display(task: str) -> Iterator[Display]:
    """Show the progress of a task while the block runs."""
    if not sys.stderr.isatty():
        yield _Lines()
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn("line"), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as live:
        yield _Live(live, live.add_task(task, total=None))


class _Lines:
    """A line for each stage, and one now and then."""

    def __init__(self) -> None:
        self._stage = ""
        self._shown = 0.0

    def __call__(self, line: TraceLine) -> None:
        now = time.monotonic()
        if line.stage != self._stage or now - self._shown >= PAUSE:
            self._stage, self._shown = line.stage, now
            complain(_words(line))


class _Live:
    """One line that changes in place."""

    def __init__(self, live: Any, task: Any) -> None:
        self._live, self._task = live, task

    def __call__(self, line: TraceLine) -> None:
        self._live.update(self._task, description=_words(line))


def _words(line: TraceLine) -> str:
    return f"{line.stage:<15} iteration {line.iteration:>3}  cost {line.cost:<10.5g} RMSE {line.rmse:.4g}"
