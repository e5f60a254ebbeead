"""Topic `startup`: whole processes, from the shell's return key to the end."""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.installation import fresh_environment
from benchmarks.machine import load
from benchmarks.processes import run_command, time_commands
from benchmarks.table import Table

__all__ = ["run"]

REPEATS = 7
CENTRES = 500


def run() -> list[Table]:
    """Python alone, the import, and the commands; then a fresh environment."""
    command = Path(sys.executable).with_name("kennfeld" + Path(sys.executable).suffix)
    table = Table("startup: whole processes", ("process", "best", "median", "threads", "remark"))
    python = [sys.executable, "-c"]
    _row(table, "python -c pass", [*python, "pass"])
    _row(table, "import numpy", [*python, "import numpy"])
    _row(table, "import kennfeld", [*python, "import kennfeld"])
    _row(table, "import kennfeld; kennfeld.calibrate", [*python, "import kennfeld; kennfeld.calibrate"])
    _row(table, "kennfeld --help", [str(command), "--help"])
    _row(table, "kennfeld calibrate --help", [str(command), "calibrate", "--help"])
    with tempfile.TemporaryDirectory() as folder:
        for name in ("torque", "exhaust", "idle"):
            _demo(table, command, name, Path(folder) / name)
        if (Path(folder) / "idle" / "engine.json").is_file():
            _fill_up(Path(folder) / "idle" / "engine.json")
            _row(table, f"... its plant filled up to {CENTRES} centres", _calibrate(command, Path(folder) / "idle"))
    table.notes = [
        "Budget: import kennfeld and kennfeld --help below 300 ms, kennfeld calibrate on each demo below 1 s.",
        "The plant is filled up with bells of weight 0, which cost the same time and change nothing.",
        f"The shortest and the median of {REPEATS} runs from a warm disk. Load at the end {load()}.",
    ]
    return [table, fresh_environment()]


def _demo(table: Table, command: Path, name: str, folder: Path) -> None:
    """`kennfeld calibrate` on a demo project that `kennfeld demo` wrote."""
    row = f"kennfeld calibrate ({name} demo)"
    written = run_command([str(command), "demo", name, "--dir", str(folder)])
    if written:
        table.add(row, "-", "-", "-", f"missing: {written}")
        return
    _row(table, row, _calibrate(command, folder))
    for other in ("info", "check", "simulate", "report"):
        _row(table, f"kennfeld {other} ({name} demo)", [str(command), other, str(folder / "kennfeld.toml")])


def _calibrate(command: Path, folder: Path) -> list[str]:
    return [str(command), "calibrate", str(folder / "kennfeld.toml")]


def _fill_up(file: Path) -> None:
    """Give the stored plant bells of weight 0 until it has `CENTRES`."""
    from kennfeld import Expansion
    from kennfeld.surrogate import read_surrogate, write_surrogate

    plant = read_surrogate(file)
    own = plant.expansion
    more = np.arange(CENTRES - own.size) % own.size
    filled = Expansion(
        own.offset,
        own.slopes,
        np.concatenate([own.weights, np.zeros(more.size)]),
        *(np.concatenate([table, table[more]]) for table in (own.centres, own.widths)),
    )
    write_surrogate(replace(plant, expansion=filled), file)


def _row(table: Table, name: str, command: Sequence[str]) -> None:
    """Once to warm the disk, then with the clock."""
    if problem := run_command(command):
        table.add(name, "-", "-", "-", f"missing: {problem}")
    else:
        time_commands(table, name, [command] * REPEATS)
