"""What an installation in a fresh environment takes: disk, and time of the first commands."""

import sys
import tempfile
import venv
from pathlib import Path

from benchmarks.measure import ROOT
from benchmarks.processes import run_command, time_commands
from benchmarks.table import Table, megabytes

__all__ = ["fresh_environment"]

EXTRAS = ("", "files")
REPEATS = 7
INSTALLERS = ("pip", "setuptools", "pkg_resources", "_distutils_hack")  # of the environment itself
TIMEOUT = 900.0  # s, which pip may take


def fresh_environment() -> Table:
    """Return the size of an installation with some extras, and the time of its first commands."""
    table = Table("startup: a fresh environment", ("process", "best", "median", "threads", "remark"))
    for extra in EXTRAS:
        with tempfile.TemporaryDirectory() as folder:
            _install(table, f"[{extra}]" if extra else "", Path(folder))
    table.notes = [
        "Installed by pip into a new virtual environment: with compiled Python files, without pip itself.",
        f"The shortest and the median of {REPEATS} runs after a first one.",
    ]
    return table


def _install(table: Table, extra: str, folder: Path) -> None:
    """Add the size of an installation; of the smallest one also the times."""
    name = f'pip install ".{extra}"'
    venv.create(folder, with_pip=True)
    python = [str(folder / ("Scripts/python" if sys.platform == "win32" else "bin/python")), "-I"]
    if problem := run_command([*python, "-m", "pip", "install", "--quiet", f"{ROOT}{extra}"], TIMEOUT):
        table.add(name, "-", "-", "-", f"missing: {problem}")
        return
    packages = next(folder.rglob("site-packages"))
    whole = sum(_size(path) for path in packages.iterdir() if path.name.partition("-")[0] not in INSTALLERS)
    remark = f"{megabytes(whole)}, of which Kennfeld {megabytes(_size(packages / 'kennfeld'))}"
    table.add(name, "-", "-", "-", remark)
    if not extra:
        _time(table, "... import kennfeld", [*python, "-c", "import kennfeld"])
        _time(table, "... import kennfeld; kennfeld.calibrate", [*python, "-c", "import kennfeld; kennfeld.calibrate"])
        _time(table, "... python -m kennfeld --version", [*python, "-m", "kennfeld", "--version"])


def _time(table: Table, name: str, command: list[str]) -> None:
    run_command(command)
    time_commands(table, name, [command] * REPEATS)


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(each.stat().st_size for each in files if each.is_file())
