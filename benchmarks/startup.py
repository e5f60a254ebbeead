"""Topic `startup`: whole processes, from the shell's return key to the end."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.machine import load
from benchmarks.measure import threads
from benchmarks.table import Table, seconds

__all__ = ["run"]

REPEATS = 7


def run() -> list[Table]:
    """Python alone, the import, and the commands."""
    command = Path(sys.executable).with_name("kennfeld" + Path(sys.executable).suffix)
    table = Table("startup: whole processes", ("process", "best", "median", "threads", "remark"))
    python = [sys.executable, "-c"]
    _row(table, "python -c pass", [*python, "pass"])
    _row(table, "import numpy", [*python, "import numpy"])
    _row(table, "import kennfeld", [*python, "import kennfeld"])
    _row(table, "import kennfeld; kennfeld.calibrate", [*python, "import kennfeld; kennfeld.calibrate"])
    _row(table, "kennfeld --help", [str(command), "--help"])
    with tempfile.TemporaryDirectory() as folder:
        for name in ("torque", "exhaust"):
            _demo(table, command, name, Path(folder) / name)
    table.notes = [
        "Budget: import kennfeld and kennfeld --help below 300 ms, kennfeld calibrate on torque and exhaust below 1 s.",
        f"The shortest and the median of {REPEATS} runs from a warm disk. Load at the end {load()}.",
    ]
    return [table]


def _demo(table: Table, command: Path, name: str, folder: Path) -> None:
    """`kennfeld calibrate` on a demo project that `kennfeld demo` wrote."""
    row = f"kennfeld calibrate ({name} demo)"
    written = _ran([str(command), "demo", name, "--dir", str(folder)])
    projects = sorted(folder.rglob("*.toml"))
    if written or not projects:
        table.add(row, "-", "-", "-", f"missing: {written or 'no project file'}")
        return
    _row(table, row, [str(command), "calibrate", str(projects[0])])


def _row(table: Table, name: str, command: Sequence[str]) -> None:
    if wrong := _ran(command):
        table.add(name, "-", "-", "-", f"missing: {wrong}")
        return
    found = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        _ran(command)
        found.append(time.perf_counter() - began)
    found.sort()
    table.add(name, seconds(found[0]), seconds(found[len(found) // 2]), str(threads(None)))


def _ran(command: Sequence[str]) -> str:
    """Run a command and say what went wrong; empty where nothing did."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return type(error).__name__
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or [f"exit {done.returncode}"])[-1]
