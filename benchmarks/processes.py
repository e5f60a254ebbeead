"""Whole processes, from the shell's return key to the end."""

import subprocess
import time
from collections.abc import Sequence

from benchmarks.measure import environment_of_users, threads
from benchmarks.table import Table, seconds

__all__ = ["run_command", "time_commands"]


def time_commands(table: Table, name: str, commands: Sequence[Sequence[str]]) -> None:
    """Add a row with the shortest and the median time of some commands, or the problem of the first that failed."""
    durations = []
    for command in commands:
        began = time.perf_counter()
        problem = run_command(command)
        durations.append(time.perf_counter() - began)
        if problem:
            table.add(name, "-", "-", "-", f"missing: {problem}")
            return
    durations.sort()
    table.add(name, seconds(durations[0]), seconds(durations[len(durations) // 2]), str(threads(None)))


def run_command(command: Sequence[str], timeout: float = 120.0) -> str:
    """Run a command and return what went wrong; empty if nothing did."""
    environment = environment_of_users()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False, env=environment)
    except (OSError, subprocess.TimeoutExpired) as error:
        return type(error).__name__
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or [f"exit {done.returncode}"])[-1]
