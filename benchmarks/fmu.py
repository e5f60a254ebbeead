"""Topic `fmu`: parameters of FMUs, beside FMPy with `scipy.optimize.least_squares`."""

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
    ("vanderpol", 10_000, 20.0),
    ("vanderpol", 100_000, 40.0),
    ("lag", 1000, 20.0),
    ("lag", 10_000, 60.0),
    ("lag", 100_000, 200.0),
)
STEPPED = (*(case for case in CASES if case[1] <= 10_000), ("exhaust", 10_000, 1000.0))  # by co-simulation
REPEATS = 5  # of Kennfeld's runs; peers run once
TIMEOUT = 1800.0
COLUMNS = ("FMU", "samples", "solver", "tool", "time", "times Kennfeld", "evaluations", "cost")
STEPS = "co-simulation"
PEERS = (  # tool, solver, own loop
    ("FMPy, simulate_fmu", "ode1", False),
    ("FMPy, own loop", "ode1", True),
    ("FMPy, own loop", "ode4", True),
    ("FMPy, simulate_fmu", STEPS, False),
    ("FMPy, own loop", STEPS, True),
)
COMMON_NOTES = [
    "All start from the description of the FMU and its start values. FMPy keeps one instance for all runs; "
    "scipy.optimize.least_squares has its defaults. FMPy's own loop calls the functions of its instance through "
    "ctypes. Imports are not included, reading the FMU is.",
    "Evaluations: iterations of Kennfeld, calls of the residuals by scipy without those for its Jacobian.",
    f"The shortest of {REPEATS} runs of Kennfeld, one run of the peers.",
]


def write_target(path: str, name: str, samples: int, span: float, measured: str, solver: str) -> dict[str, Any]:
    """Write the outputs of an FMU with its true parameters, and noise."""
    import kennfeld as kf

    problem, data = PROBLEMS[name], data_of(name, samples, span)
    model = _model(path, solver)
    true = [model.values[name].with_values(values) for name, values in problem.tables_of(problem.true).items()]
    clean = kf.simulate(model, data, kf.ParameterSet(true))[problem.output].values
    np.save(measured, clean + np.random.default_rng(0).normal(0.0, NOISE, samples))
    return {}


def solve(path: str, name: str, samples: int, span: float, measured: str, solver: str) -> dict[str, Any]:
    """Calibrate an FMU with Kennfeld, from its file on."""
    import kennfeld as kf
    from kennfeld.importers.fmu import importing, instance, trajectories  # noqa: F401, imported before time runs

    problem, data = PROBLEMS[name], data_of(name, samples, span)
    data["target"] = np.load(measured)
    kf.calibrate("y = a * x", {"x": [0.0, 1.0, 2.0], "m": [0.0, 1.0, 2.0]}, {"a": 0.5}, "m")  # imports, as of the peers
    begin = time.perf_counter()
    model = _model(path, solver)
    result = kf.calibrate(model, data, {}, "target", node=problem.output, free=list(problem.tables))
    duration = time.perf_counter() - begin
    values = np.concatenate([np.ravel(result.parameters[name].values) for name in problem.tables])
    return {
        "seconds": duration,
        "cost": result.cost_after,
        "values": values.tolist(),
        "evaluations": result.iterations,
        "status": result.status,
    }


def run() -> list[Table]:
    """Kennfeld and the peers on each FMU, for model exchange and for co-simulation."""
    equations = Table("fmu: calibration of FMUs for model exchange", COLUMNS)
    steps = Table("fmu: calibration of FMUs for co-simulation", COLUMNS)
    if shutil.which("gcc") is None:
        equations.notes = ["There is no gcc, which compiles the FMUs."]
        return [equations]
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            _add_case(equations, Path(folder), *case, "ode1")
            _add_case(equations, Path(folder), *case, "ode4")
        for case in STEPPED:
            _add_case(steps, Path(folder), *case, STEPS)
    equations.notes = [
        "The aim is 50 times the speed of FMPy at the same or a lower cost. All use the same step and solver; "
        "simulate_fmu has Euler's method only.",
        *COMMON_NOTES,
        f"Load at the end {load()}.",
    ]
    steps.notes = [
        "The aim is 5 times the speed of FMPy at the same or a lower cost. A step of the FMU is ten of Euler's method "
        "inside. vanderpol has one parameter, lag two, exhaust 34.",
        *COMMON_NOTES,
    ]
    return [equations, steps]


def _model(path: str, solver: str) -> Any:
    import kennfeld as kf

    return kf.fmu(path, interface=STEPS) if solver == STEPS else kf.fmu(path, solver=solver)


def _add_case(table: Table, folder: Path, name: str, samples: int, span: float, solver: str) -> None:
    target = folder / f"{name}_{samples}_{solver}.npy"
    case = {"path": str(build(folder, name)), "name": name, "samples": samples, "span": span}
    case |= {"measured": str(target), "solver": solver}
    written = apart("benchmarks.fmu:write_target", **case)
    if "error" in written:
        table.add(name, str(samples), solver, "Kennfeld", written["error"])
        return
    runs = [apart("benchmarks.fmu:solve", **case) for _ in range(REPEATS)]
    own = min(runs, key=lambda outcome: outcome.get("seconds", np.inf))
    _add_row(table, case, "Kennfeld", own, own)
    for tool, method, loop in PEERS:
        if method != solver:
            continue
        if not installed("fmpy", "scipy"):
            table.add(name, str(samples), solver, tool, "not installed")
            continue
        outcome = apart("benchmarks.peers.fmpy_least_squares:solve", timeout=TIMEOUT, **case, loop=loop)
        _add_row(table, case, tool, outcome, own)


def _add_row(table: Table, case: dict[str, Any], tool: str, outcome: dict[str, Any], own: dict[str, Any]) -> None:
    cells = case["name"], str(case["samples"]), case["solver"], tool
    if "error" in outcome:
        table.add(*cells, outcome["error"])
        return
    ratio = outcome["seconds"] / own["seconds"] if "seconds" in own else float("nan")
    table.add(
        *cells, seconds(outcome["seconds"]), f"{ratio:.3g}", str(outcome["evaluations"]), f"{outcome['cost']:.8g}"
    )
