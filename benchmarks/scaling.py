"""Topic `scaling`: an iteration of the torque model over the number of points and of values."""

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.machine import load
from benchmarks.measure import apart, threads
from benchmarks.table import Table, megabytes, seconds
from benchmarks.torque_data import load_points, parameters, write_points

__all__ = ["COLUMNS", "measure", "notes", "row", "run"]

CASES = (
    *((points, 520) for points in (2812, 10_000, 100_000, 1_000_000, 3_000_000)),
    *((1_000_000, values) for values in (100, 1000, 2000)),
)
COLUMNS = (
    *("values", "threads", "prepare", "cost", "normal", "iteration", "median", "memory", "of the data"),
    "final cost",
)
BUDGET = "Budget: 1 000 000 points in at most 200 ms on one core, and memory of at most twice the data."


def measure(file: str, values: int) -> dict[str, Any]:
    """One row, in a process of its own."""
    from benchmarks.iteration import measure_iteration
    from kennfeld.domain.dataset import Dataset
    from kennfeld.project.demo import torque

    def data(count: int) -> Dataset:
        points = load_points(file)
        return points if not count else Dataset.of("few", {c: points[c].values[:count] for c in points})

    return measure_iteration(torque.FORMULA, "Torque", "TorquePredict", parameters(values), data)


def run() -> list[Table]:
    """All sizes, on one core and on all."""
    table = Table("scaling: cost, gradient and Gauss-Newton matrix of the torque model", ("points", *COLUMNS))
    entries = 0
    with tempfile.TemporaryDirectory() as folder:
        for points, values in CASES:
            file = Path(folder) / f"{points}.npy"
            if not file.exists():
                write_points(file, points)
            for cores in (1, None):
                outcome = apart("benchmarks.scaling:measure", cores=cores, file=str(file), values=values)
                entries = outcome.get("entries", entries)
                table.add(f"{points}", *row(outcome, cores))
    table.notes = [BUDGET, *notes(f"A row has {entries} entries.")]
    return [table]


def row(outcome: dict[str, Any], cores: int | None) -> list[str]:
    """The cells after the first."""
    if "error" in outcome:
        return ["-", str(threads(cores)), outcome["error"]]
    return [
        str(outcome["free"]),
        str(threads(cores)),
        *(seconds(outcome[name]) for name in ("prepare", "cost", "normal", "iteration", "median")),
        megabytes(outcome["peak"]),
        f"{outcome['peak'] / outcome['bytes']:.2f} x {megabytes(outcome['bytes'])}",
        f"{outcome['value']:.6g}",
    ]


def notes(more: str) -> list[str]:
    """Explain the columns of `row`."""
    return [
        "Iteration is cost plus normal (gradient and Gauss-Newton matrix), the shortest of several; median is of the "
        f"same runs. Prepare is compiling and sorting, once. {more}",
        "Memory is the peak above that of the imports and of the compiler, the data themselves included. "
        f"Load at the end {load()}.",
    ]
