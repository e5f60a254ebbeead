"""Topic `scaling`: an iteration of the torque model over the number of points and of values."""

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.machine import load
from benchmarks.measure import apart, threads
from benchmarks.table import Table, megabytes, seconds
from benchmarks.torque_data import load_points, parameters, write_points

__all__ = ["measure", "run"]

CASES = (
    *((points, 520) for points in (2812, 10_000, 100_000, 1_000_000, 3_000_000)),
    *((1_000_000, values) for values in (100, 1000, 2000)),
)
BUDGET = "Budget: 1 000 000 points in at most 200 ms on one core, and memory of at most twice the data."


def measure(file: str, values: int) -> dict[str, Any]:
    """One row, in a process of its own."""
    from benchmarks.iteration import measured
    from kennfeld.dataset import Dataset
    from kennfeld.project.demo import torque

    def data(count: int) -> Dataset:
        points = load_points(file)
        return points if not count else Dataset.of("few", {c: points[c].values[:count] for c in points})

    return measured(torque.FORMULA, "Torque", "TorquePredict", parameters(values), data)


def run() -> list[Table]:
    """All sizes, on one core and on all."""
    columns = (
        "points",
        "values",
        "threads",
        "prepare",
        "cost",
        "normal",
        "iteration",
        "median",
        "memory",
        "of the data",
    )
    table = Table("scaling: cost, gradient and Gauss-Newton matrix of the torque model", (*columns, "final cost"))
    entries = 0
    with tempfile.TemporaryDirectory() as folder:
        for points, values in CASES:
            file = Path(folder) / f"{points}.npy"
            if not file.exists():
                write_points(file, points)
            for cores in (1, None):
                found = apart("benchmarks.scaling:measure", cores=cores, file=str(file), values=values)
                entries = found.get("entries", entries)
                table.add(f"{points}", *row(found, cores))
    table.notes = [BUDGET, *notes(f"A row has {entries} entries.")]
    return [table]


def row(found: dict[str, Any], cores: int | None) -> list[str]:
    """The cells after the first."""
    if "error" in found:
        return ["-", str(threads(cores)), found["error"]]
    return [
        str(found["free"]),
        str(threads(cores)),
        *(seconds(found[name]) for name in ("prepare", "cost", "normal", "iteration", "median")),
        megabytes(found["peak"]),
        f"{found['peak'] / found['bytes']:.2f} x {megabytes(found['bytes'])}",
        f"{found['value']:.6g}",
    ]


def notes(more: str) -> list[str]:
    """What the columns of `row` mean."""
    return [
        "Iteration is cost plus normal (gradient and Gauss-Newton matrix), the shortest of several; median is of the "
        f"same runs. Prepare is compiling and sorting, once. {more}",
        "Memory is the peak above that of the imports and of the compiler, the data themselves included. "
        f"Load at the end {load()}.",
    ]
