"""Projects whose function is an FMU or a Python file with faults, and commands on them in processes of their own."""

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from tests.importers.fmu import lag_fmu, tank_fmu

PLANT = """[model]
file = "lag.fmu"
timeout = 5
[[dataset]]
files = ["bench.csv"]
[[criterion]]
node = "y"
target = "wanted"
[calibration]
free = ["tau", "k"]
[optimizer]
max_iterations = 2
"""
TANK = """[model]
file = "tank.fmu"
timeout = 5
[[dataset]]
files = ["bench.csv"]
[channels]
flow = "u"
mode = "u"
open = "u"
[[criterion]]
node = "y"
target = "wanted"
[calibration]
free = ["gain"]
"""
PYTHON = """[model]
file = "torque.kf"
timeout = 5
[functions]
table = "table.py:table"
[[dataset]]
files = ["bench.csv"]
[[criterion]]
node = "y"
target = "wanted"
[parameters.K]
initial = 1.0
"""
SAMPLES = 100  # every 0.1 s


class Outcome(NamedTuple):
    """Exit status and output of a command."""

    status: int
    out: str
    err: str


def write_data(folder: Path) -> None:
    """Write samples of u and wanted."""
    rows = [f"{0.1 * number:.1f},{1 + number % 7},{2 + number % 5}" for number in range(SAMPLES)]
    (folder / "bench.csv").write_text("\n".join(["time,u,wanted", *rows, ""]))


def write_fmu_project(folder: Path, *options: str) -> Path:
    """Write a project whose function is an FMU, built with these options of the compiler; return its file."""
    write_data(folder)
    lag_fmu.build(folder, 2, *options)
    (folder / "lag.so").unlink()
    (folder / "kennfeld.toml").write_text(PLANT)
    return folder / "kennfeld.toml"


def write_tank_project(folder: Path, version: int, *options: str) -> Path:
    """Write a project whose function is an FMU for co-simulation; return its file."""
    write_data(folder)
    tank_fmu.build(folder, version, *options)
    (folder / "tank.so").unlink()
    (folder / "kennfeld.toml").write_text(TANK)
    return folder / "kennfeld.toml"


def write_python_project(folder: Path, body: str, before: str = "") -> Path:
    """Write a project that calls `table(u)` of a Python file, with a body that is not translated; return its file."""
    write_data(folder)
    lines = "".join(f"    {line}\n" for line in body.splitlines())
    (folder / "table.py").write_text(f"import os\n{before}\n\ndef table(x):\n{lines}    return {{0: 2 * x}}[0]\n")
    (folder / "torque.kf").write_text("y = K * table(u)\n")
    (folder / "kennfeld.toml").write_text(PYTHON)
    return folder / "kennfeld.toml"


def environment(folder: Path) -> dict[str, str]:
    """Return the environment of a command that keeps temporary files and what it remembers in a folder."""
    for name in ("temporary", "home"):
        (folder / name).mkdir(exist_ok=True)
    return {**os.environ, "TMPDIR": str(folder / "temporary"), "HOME": str(folder / "home")}


def run_command(project: Path, command: str, *options: str) -> Outcome:
    """Run a command on a project as a user does."""
    line = [sys.executable, "-m", "kennfeld", command, "--trust", str(project), *options]
    done = subprocess.run(line, env=environment(project.parent), capture_output=True, text=True, check=False)
    return Outcome(done.returncode, done.stdout, done.stderr)
