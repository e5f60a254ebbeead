"""Whole processes, from the shell's return key to the end."""

import subprocess
import time
from collections.abc import Sequence

from benchmarks.measure import threads
from benchmarks.table import Table, seconds

__all__ = ["ran", "timed"]


def timed(table: Table, name: str, commands: Sequence[Sequence[str]]) -> None:
    """A row with the shortest and the median time of some commands, or what went wrong with the first that failed."""
    found = []
    for command in commands:
        began = time.perf_counter()
        wrong = ran(command)
        found.append(time.perf_counter() - began)
        if wrong:
            table.add(name, "-", "-", "-", f"missing: {wrong}")
            return
    found.sort()
    table.add(name, seconds(found[0]), seconds(found[len(found) // 2]), str(threads(None)))


def ran(command: Sequence[str]) -> str:
    """Run a command and say what went wrong; empty where nothing did."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return type(error).__name__
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or [f"exit {done.returncode}"])[-1]
