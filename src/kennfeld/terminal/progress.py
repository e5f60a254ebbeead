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
            complain(_words(line, self._several))
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
