"""Topic `exhaust`: a model with a state, many solvers, the same cost function and the same start."""

import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.exhaust_problem import ExhaustProblem, problem
from benchmarks.machine import load
from benchmarks.measure import installed
from benchmarks.processes import timed
from benchmarks.race import HIGHER, REPEATS, Entrant, agreement, cells, reached, scaled_and_not, solved
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
    given = problem()
    modules = {"benchmarks.kennfeld_exhaust"} | ({"benchmarks.peers.exhaust_jax"} if installed("jax") else set())
    agreed = agreement(given, modules)
    found = {e.name: solved(e, given, given.test_rmse, cap) for e in ENTRANTS if installed(*e.packages)}
    return [_table(found, given, agreed, cap), _processes()]


def _table(found: dict[str, dict[str, Any]], given: ExhaustProblem, agreed: str, cap: float) -> Table:
    ended = {name: one for name, one in found.items() if "error" not in one}
    best = min(one["cost"] for one in ended.values())
    columns = ("solver", "set-up", "solve", "median of", "to 0.1%", "threads", "cost", "RMSE, other drive", "remark")
    title = f"exhaust: {given.drive.measured.size} samples with a state, {given.start.size} free values"
    table = Table(title, columns)
    for entrant in ENTRANTS:
        one = found.get(entrant.name)
        if one is None or "error" in one:
            table.add(entrant.name, *["-"] * 7, "missing" if one is None else one["error"])
        else:
            table.add(entrant.name, *cells(one, best, [best * (1 + HIGHER)], UNIT))
    table.notes = [
        agreed,
        f"To 0.1%: until the cost is that close to the best of all, {best:.6g}. {_ratios(ended, best)}",
        f"The noise of the thermometer is {NOISE:g} {UNIT}. A solver that ends more than {HIGHER:.1%} above the best "
        "stops higher.",
        "Variable projection uses that the model is linear in the map; the others do not. Its bounds hold for the time "
        "constants alone.",
        "Set-up is compiling; imports, and what depends on the data alone, are in neither column. Solve is the "
        f"shortest of up to {REPEATS} runs, each in a process of its own, on one thread or on all, whichever was "
        f"faster; a peer is stopped after {cap:g} s. Load at the end {load()}.",
    ]
    return table


def _ratios(ended: dict[str, dict[str, Any]], best: float) -> str:
    """How many times the peers' times are those of Kennfeld, compiling included and not."""
    times = {name: time for name, one in ended.items() if (time := reached(one, best * (1 + HIGHER))) is not None}
    own = times.get("Kennfeld")
    if own is None:
        return "Kennfeld does not get there."
    whole = own + ended["Kennfeld"]["setup"]
    listed = [
        f"{name} in {times[name] / own:.1f} times that ({(times[name] + ended[name].get('setup', 0.0)) / whole:.1f} "
        "with set-up)"
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
        timed(
            table,
            "kennfeld demo exhaust",
            [[*command, "demo", "exhaust", "--dir", str(work / str(i))] for i in range(PROCESSES)],
        )
        project = str(work / "0" / "kennfeld.toml")
        timed(table, "kennfeld calibrate (exhaust demo)", [[*command, "calibrate", project]] * PROCESSES)
        timed(table, "kennfeld check (exhaust demo)", [[*command, "check", project]] * PROCESSES)
    table.notes = [
        "Budget: below 1 s. The demo simulates two drives and writes them before it calibrates.",
        f"The shortest and the median of {PROCESSES} runs. Load at the end {load()}.",
    ]
    return table
