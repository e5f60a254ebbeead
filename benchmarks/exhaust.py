"""Topic `exhaust`: a model with a state, many solvers, the same cost function and the same start."""

import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.exhaust_problem import ExhaustProblem, problem
from benchmarks.machine import load
from benchmarks.measure import installed
from benchmarks.processes import time_commands
from benchmarks.race import HIGHER, REPEATS, Entrant, cells, compare_costs, run_entrant, scaled_and_not, times_to_cost
from benchmarks.table import Table, seconds
from kennfeld.project.demo.exhaust import NOISE, UNIT

__all__ = ["run"]

PROCESSES = 7


ENTRANTS = (
    Entrant("Kennfeld", "benchmarks.kennfeld_exhaust:solve"),
    *scaled_and_not("variable projection", "exhaust_projection", ("scipy",)),
    *scaled_and_not("scipy TRF, Jacobian by filtering the basis", "exhaust_scipy", ("scipy",), jacobian="filtered"),
    *scaled_and_not("scipy TRF, JAX jit(jacfwd(scan))", "exhaust_jax", ("scipy", "jax")),
    *scaled_and_not("scipy TRF, finite differences", "exhaust_scipy", ("scipy",), jacobian="differences"),
)


def run(cap: float = 60.0) -> list[Table]:
    """Check that the cost functions agree, then let everyone solve, the peers for at most `cap` s each."""
    task = problem()
    modules = {"benchmarks.kennfeld_exhaust"} | ({"benchmarks.peers.exhaust_jax"} if installed("jax") else set())
    agreement = compare_costs(task, modules)
    outcomes = {e.name: run_entrant(e, task, task.test_rmse, cap) for e in ENTRANTS if installed(*e.packages)}
    return [_table(outcomes, task, agreement, cap), _processes()]


def _table(outcomes: dict[str, dict[str, Any]], task: ExhaustProblem, agreement: str, cap: float) -> Table:
    completed = {name: outcome for name, outcome in outcomes.items() if "error" not in outcome}
    best = min(outcome["cost"] for outcome in completed.values())
    columns = ("solver", "set-up", "solve", "median of", "to 0.1%", "threads", "cost", "RMSE, other drive", "remark")
    title = f"exhaust: {task.drive.measured.size} samples with a state, {task.start.size} free values"
    table = Table(title, columns)
    for entrant in ENTRANTS:
        outcome = outcomes.get(entrant.name)
        if outcome is None or "error" in outcome:
            table.add(entrant.name, *["-"] * 7, "missing" if outcome is None else outcome["error"])
        else:
            table.add(entrant.name, *cells(outcome, best, [best * (1 + HIGHER)], UNIT))
    table.notes = [
        agreement,
        f"To 0.1%: until the cost is that close to the best of all, {best:.6g}. {_ratios(completed, best)}",
        f"The noise of the thermometer is {NOISE:g} {UNIT}. A solver that ends more than {HIGHER:.1%} above the best "
        "stops higher.",
        "Variable projection uses that the model is linear in the map; the others do not. Its bounds hold for the time "
        "constants alone.",
        "Set-up is compiling; imports, and what depends on the data alone, are in neither column. Solve is the "
        f"shortest of up to {REPEATS} runs, each in a process of its own, on one thread or on all, whichever was "
        f"faster; a peer is stopped after {cap:g} s. Load at the end {load()}.",
    ]
    return table


def _ratios(completed: dict[str, dict[str, Any]], best: float) -> str:
    """Compare the peers' times with those of Kennfeld, compiling included and not."""
    times = times_to_cost(completed, best * (1 + HIGHER))
    own = times.get("Kennfeld")
    if own is None:
        return "Kennfeld does not get there."
    whole = {name: time + completed[name].get("setup", 0.0) for name, time in times.items()}
    listed = [
        f"{name} in {times[name] / own:.1f} times that ({whole[name] / whole['Kennfeld']:.1f} with set-up)"
        for name in sorted(times, key=lambda name: times[name])
        if name != "Kennfeld"
    ]
    return f"Kennfeld gets there in {seconds(own)}; {', '.join(listed) or 'no peer does'}."


def _processes() -> Table:
    """Whole processes: the demo, and a calibration of the project that it wrote."""
    table = Table("exhaust: whole processes", ("process", "best", "median", "threads", "remark"))
    command = [sys.executable, "-m", "kennfeld"]
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        time_commands(
            table,
            "kennfeld demo exhaust",
            [[*command, "demo", "exhaust", "--dir", str(work / str(i))] for i in range(PROCESSES)],
        )
        project = str(work / "0" / "kennfeld.toml")
        time_commands(table, "kennfeld calibrate (exhaust demo)", [[*command, "calibrate", project]] * PROCESSES)
        time_commands(table, "kennfeld check (exhaust demo)", [[*command, "check", project]] * PROCESSES)
    table.notes = [
        "Budget: below 1 s. The demo simulates two drives and writes them before it calibrates.",
        f"The shortest and the median of {PROCESSES} runs. Load at the end {load()}.",
    ]
    return table
