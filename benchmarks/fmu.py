"""Topic `fmu`: parameters of FMUs for model exchange, beside FMPy with `scipy.optimize.least_squares`."""

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fmu_problem import NOISE, PROBLEMS, build, data_of
from benchmarks.machine import load
from benchmarks.measure import apart, installed
from benchmarks.table import Table, seconds

__all__ = ["run", "solve", "write_target"]

CASES = (  # problem, samples, duration in s
    ("vanderpol", 1000, 10.0),
    ("vanderpol", 100_000, 40.0),
    ("lag", 1000, 20.0),
    ("lag", 100_000, 200.0),
)
REPEATS = 5  # of Kennfeld's runs; peers run once
TIMEOUT = 1800.0
AIM = 50.0
COLUMNS = ("FMU", "samples", "solver", "tool", "time", "times Kennfeld", "evaluations", "cost")
PEERS = (("FMPy, simulate_fmu", "ode1", False), ("FMPy, own loop", "ode1", True), ("FMPy, own loop", "ode4", True))


def write_target(path: str, name: str, samples: int, span: float, measured: str, solver: str) -> dict[str, Any]:
    """Write the outputs of an FMU with its true parameters, and noise."""
    import kennfeld as kf

    problem, data = PROBLEMS[name], data_of(name, samples, span)
    true = dict(zip(problem.parameters, problem.true.tolist(), strict=True))
    clean = kf.simulate(kf.fmu(path, solver=solver), data, true)[problem.output].values
    np.save(measured, clean + np.random.default_rng(0).normal(0.0, NOISE, samples))
    return {}


def solve(path: str, name: str, samples: int, span: float, measured: str, solver: str) -> dict[str, Any]:
    """Calibrate an FMU with Kennfeld, from its file on."""
    import kennfeld as kf

    problem, data = PROBLEMS[name], data_of(name, samples, span)
    data["target"] = np.load(measured)
    kf.calibrate("y = a * x", {"x": [0.0, 1.0, 2.0], "m": [0.0, 1.0, 2.0]}, {"a": 0.5}, "m")  # imports, as of the peers
    begin = time.perf_counter()
    model = kf.fmu(path, solver=solver)
    result = kf.calibrate(model, data, {}, "target", node=problem.output, free=list(problem.parameters))
    duration = time.perf_counter() - begin
    values = [float(result.parameters[parameter].values) for parameter in problem.parameters]
    return {
        "seconds": duration,
        "cost": result.cost_after,
        "values": values,
        "evaluations": result.iterations,
        "status": result.status,
    }


def run() -> list[Table]:
    """Kennfeld and the peers on each FMU."""
    table = Table("fmu: calibration of FMUs for model exchange", COLUMNS)
    if shutil.which("gcc") is None:
        table.notes = ["There is no gcc, which compiles the FMUs."]
        return [table]
    with tempfile.TemporaryDirectory() as folder:
        for name, samples, span in CASES:
            path = build(Path(folder), name)
            for solver in ("ode1", "ode4"):
                target = str(Path(folder) / f"{name}_{samples}_{solver}.npy")
                case = {"path": str(path), "name": name, "samples": samples, "span": span, "measured": target}
                apart("benchmarks.fmu:write_target", **case, solver=solver)
                _add_case(table, case, solver)
    table.notes = [
        f"The aim is {AIM:g} times the speed of FMPy at the same or a lower cost.",
        "All start from the description of the FMU and its start values, and use the same step and solver. FMPy keeps "
        "one instance for all runs; scipy.optimize.least_squares has its defaults. FMPy itself has Euler's method "
        "only; its own loop calls the functions of FMPy's instance through ctypes. Imports are not included.",
        "Evaluations: iterations of Kennfeld, calls of the residuals by scipy without those for its Jacobian.",
        f"The shortest of {REPEATS} runs of Kennfeld, one run of the peers. Load at the end {load()}.",
    ]
    return [table]


def _add_case(table: Table, case: dict[str, Any], solver: str) -> None:
    runs = [apart("benchmarks.fmu:solve", **case, solver=solver) for _ in range(REPEATS)]
    own = min(runs, key=lambda outcome: outcome.get("seconds", np.inf))
    _add_row(table, case, solver, "Kennfeld", own, own)
    for tool, method, loop in PEERS:
        if method != solver:
            continue
        if not installed("fmpy", "scipy"):
            table.add(case["name"], str(case["samples"]), solver, tool, "not installed")
            continue
        target = "benchmarks.peers.fmpy_least_squares:solve"
        outcome = apart(target, timeout=TIMEOUT, **case, solver=solver, loop=loop)
        _add_row(table, case, solver, tool, outcome, own)


def _add_row(
    table: Table, case: dict[str, Any], solver: str, tool: str, outcome: dict[str, Any], own: dict[str, Any]
) -> None:
    cells = case["name"], str(case["samples"]), solver, tool
    if "error" in outcome:
        table.add(*cells, outcome["error"])
        return
    ratio = outcome["seconds"] / own["seconds"] if "seconds" in own else float("nan")
    table.add(
        *cells, seconds(outcome["seconds"]), f"{ratio:.3g}", str(outcome["evaluations"]), f"{outcome['cost']:.8g}"
    )
