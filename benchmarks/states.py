"""Topic `states`: an iteration of the exhaust model over ten hours, and a calibration on 44 minutes."""

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.exhaust_data import FORMULAS, NOISE, load_drive, parameters, write_drive
from benchmarks.machine import load
from benchmarks.measure import apart, threads
from benchmarks.scaling import COLUMNS, notes, row
from benchmarks.table import Table, seconds

__all__ = ["calibrate", "measure", "run"]

SAMPLES = 3_600_000
GRIDS = {1: ((14, 10), 10), 3: ((12, 10), 10)}  # 150 values each
REPEATS = 3


def measure(file: str, states: int) -> dict[str, Any]:
    """An iteration, in a process of its own."""
    from benchmarks.iteration import measure_iteration

    grid, points = GRIDS[states]
    return measure_iteration(
        FORMULAS[states], "Temperature", "T", parameters(grid, states, points), lambda n: load_drive(file, n)
    )


def calibrate(file: str) -> dict[str, Any]:
    """The small problem from start to end, in a process of its own."""
    from kennfeld.optimize import calibrate as run_calibration

    result = run_calibration(
        FORMULAS[1], load_drive(file), parameters((12, 12), 1, 10), "Temperature", node="T", smoothness=1e-3
    )
    quality = result.quality[0]
    return {
        "total": result.seconds.total,
        "compile": result.seconds.compile,
        "optimize": result.seconds.optimize,
        "iterations": result.iterations,
        "before": quality.rmse_before,
        "after": quality.rmse_after,
        "cost": result.cost_after,
        "free": result.free_values,
        "status": result.status,
    }


def run() -> list[Table]:
    """Both."""
    with tempfile.TemporaryDirectory() as folder:
        return [_iterations(Path(folder)), _calibration(Path(folder))]


def _iterations(folder: Path) -> Table:
    table = Table(f"states: {SAMPLES} samples of the exhaust model, one recording", ("states", *COLUMNS))
    for states in FORMULAS:
        file = folder / f"drive{states}.npy"
        write_drive(file, SAMPLES, 0.01, states)
        for cores in (1, None):
            outcome = apart("benchmarks.states:measure", cores=cores, file=str(file), states=states)
            table.add(str(states), *row(outcome, cores))
    budget = "Budget: one state in at most 500 ms on one core, three states in at most 1.5 s."
    table.notes = [budget, *notes("States need the samples one after the other, so one recording uses one thread.")]
    return table


def _calibration(folder: Path) -> Table:
    columns = (
        "samples",
        "values",
        "threads",
        "compile",
        "optimise",
        "total",
        "iterations",
        "RMSE before",
        "RMSE after",
    )
    table = Table("states: the exhaust problem calibrated", (*columns, "final cost", "status"))
    file = folder / "exhaust.npy"
    write_drive(file, 26_482, 0.1)
    for cores in (1, None):
        runs = [apart("benchmarks.states:calibrate", cores=cores, file=str(file)) for _ in range(REPEATS)]
        outcome = min(runs, key=lambda run: run.get("total", float("inf")))
        if "error" in outcome:
            table.add("26482", "-", str(threads(cores)), outcome["error"])
            continue
        table.add(
            *("26482", str(outcome["free"]), str(threads(cores))),
            *(seconds(outcome[name]) for name in ("compile", "optimize", "total")),
            *(str(outcome["iterations"]), f"{outcome['before']:.2f} degC", f"{outcome['after']:.3f} degC"),
            *(f"{outcome['cost']:.6g}", outcome["status"]),
        )
    table.notes = [
        f"The noise of the thermometer is {NOISE:g} degC. The shortest of {REPEATS} runs. Load at the end {load()}."
    ]
    return table
