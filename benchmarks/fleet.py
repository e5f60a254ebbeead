"""Topic `fleet`: a calibration over the recordings of hundreds of drives, as whole processes."""

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.fleet_data import FORMATS, USED, write_fleet
from benchmarks.machine import load
from benchmarks.measure import apart, peak
from benchmarks.table import Table, megabytes, seconds

__all__ = ["measure", "run"]

FILES, SAMPLES = 300, 30_000
FEW = 2  # files of the run whose peak is the memory of the program itself
COLUMNS = ("recordings", "command", "total", "read", "compile", "optimise", "others", "peak", "of the data", "cost")


def measure(command: str, project: str) -> dict[str, Any]:
    """Run a command of `kennfeld` on a project, in a process of its own; status and peak memory of the process."""
    from kennfeld import cli

    sys.argv = ["kennfeld", command, project]
    try:
        cli.main()
    except SystemExit as end:
        return {"status": end.code, "peak": peak()}
    return {"status": 0, "peak": peak()}


def run() -> list[Table]:
    """Every format, and few files for comparison."""
    table = Table(f"fleet: {FILES} recordings of {SAMPLES} samples, whole processes", COLUMNS)
    with tempfile.TemporaryDirectory() as folder:
        for number, kind in enumerate(FORMATS):
            own = _measure_format(table, Path(folder) / f"{number}_few", kind, FEW, 0)
            _measure_format(table, Path(folder) / f"{number}_all", kind, FILES, own)
    data = megabytes(FILES * SAMPLES * USED * 8)
    table.notes = [
        f"Budget: at most 15 s on two cores, and at most twice the data beside the memory of the program itself, which "
        f"the run on {FEW} files shows and the last but one column leaves out. The data are {USED} channels in double "
        f"precision: {data}.",
        "Others are the start of the program and what follows the optimisation: trust, quality, report, simulation. "
        f"The second run may find in the cache what the first has kept there. Load at the end {load()}.",
    ]
    return [table]


def _measure_format(table: Table, folder: Path, kind: str, files: int, own: int) -> int:
    """Add a row for each command, and return the peak memory of the first; `own` is that of the program itself."""
    project, peaks = write_fleet(folder, kind, files, SAMPLES), []
    size = sum(path.stat().st_size for path in folder.iterdir())
    commands = ("calibrate", "calibrate", "check") if own else ("calibrate",)
    for number, command in enumerate(commands):
        began = time.perf_counter()
        outcome = apart("benchmarks.fleet:measure", command=command, project=str(project))
        lasted = time.perf_counter() - began
        name = f"{files} {kind}, {megabytes(size)}", f"{command}, again" if number == 1 else command
        if outcome.get("status") != 0:
            table.add(*name, outcome.get("error", f"exit status {outcome.get('status')}"))
            continue
        peaks.append(outcome["peak"])
        share = f"{(outcome['peak'] - own) / (files * SAMPLES * USED * 8):.2f}x" if own else "-"
        times, cost = (
            _phases(project.parent, lasted) if command == "calibrate" else ([seconds(lasted)] + 4 * ["-"], "-")
        )
        table.add(*name, *times, megabytes(outcome["peak"]), share, cost)
    return peaks[0] if peaks else 0


def _phases(folder: Path, lasted: float) -> tuple[list[str], str]:
    """Return the times of a run, and its final cost."""
    result = json.loads((folder / "results" / "result.json").read_text())
    parts = [result["seconds"][name] for name in ("read", "compile", "optimize")]
    return [seconds(each) for each in (lasted, *parts, lasted - sum(parts))], f"{result['cost']['after']:.8g}"
