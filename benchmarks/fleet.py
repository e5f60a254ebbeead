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
            for files in (FEW, FILES):
                _measure_format(table, Path(folder) / f"{number}_{files}", kind, files)
    data = megabytes(FILES * SAMPLES * USED * 8)
    table.notes = [
        f"Budget: at most 15 s on two cores, and at most twice the data beside the memory of the program itself, which "
        f"the run on {FEW} files shows. The data are {USED} channels in double precision: {data}.",
        "Others is what follows the optimisation: trust, quality, report and simulation. The second run may find in "
        f"the cache what the first has kept there. Load at the end {load()}.",
    ]
    return [table]


def _measure_format(table: Table, folder: Path, kind: str, files: int) -> None:
    project = write_fleet(folder, kind, files, SAMPLES)
    size = sum(path.stat().st_size for path in folder.iterdir())
    name = f"{files} {kind}, {megabytes(size)}"
    commands = ("calibrate", "calibrate", "check") if files == FILES else ("calibrate",)
    for number, command in enumerate(commands):
        began = time.perf_counter()
        outcome = apart("benchmarks.fleet:measure", command=command, project=str(project))
        lasted = time.perf_counter() - began
        _row(table, name, f"{command}, again" if number == 1 else command, project.parent, lasted, outcome)


def _row(table: Table, name: str, command: str, folder: Path, lasted: float, outcome: dict[str, Any]) -> None:
    if outcome.get("status") != 0:
        table.add(name, command, outcome.get("error", f"exit status {outcome.get('status')}"))
        return
    data = int(name.partition(" ")[0]) * SAMPLES * USED * 8
    memory = megabytes(outcome["peak"]), f"{outcome['peak'] / data:.2g}x"
    if command == "check":
        table.add(name, command, seconds(lasted), "-", "-", "-", "-", *memory)
        return
    result = json.loads((folder / "results" / "result.json").read_text())
    parts = {name: result["seconds"][name] for name in ("read", "compile", "optimize")}
    others = lasted - sum(parts.values())
    table.add(
        name, command, *map(seconds, (lasted, *parts.values(), others)), *memory, f"{result['cost']['after']:.8g}"
    )
