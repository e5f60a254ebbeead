"""Topic `onnx`: networks with a map before and a curve after them, beside ONNX Runtime and scipy over it."""

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart, installed, repeated
from benchmarks.onnx_problem import AFTER, BEFORE, FORMULA, LOAD, NOISE, SPEED, START, data_of, write_network
from benchmarks.table import Table, seconds

__all__ = ["evaluate", "run", "solve", "write_target"]

WIDTHS = (16, 64)
SAMPLES = 10_000
FITTED = 2000  # of them, for the calibrations
REPEATS = 3
TIMEOUT = 900.0
SAME = 1e-9  # relative difference of the costs at the start
BUDGET = "Budget, 64x64: compile in at most 1 s, at most 5 us a sample with derivatives on one core."
PEERS = {
    "scipy over ONNX Runtime, its differences": False,
    "scipy over ONNX Runtime, chain rule by hand": True,
}


def _start() -> Any:
    import kennfeld as kf

    before = kf.Map("Before", kf.Axis(SPEED, "n"), kf.Axis(LOAD, "load"), START["Before"])
    return kf.ParameterSet([before, kf.Curve("After", AFTER, START["After"])])


def _model(path: str) -> Any:
    import kennfeld as kf

    return kf.formula(FORMULA, parameters=["Before", "After"], functions={"net": path})


def write_target(path: str, measured: str) -> dict[str, Any]:
    """Write what the true map and curve give, with noise."""
    import kennfeld as kf

    start = _start()
    true = start.with_parameters(
        start["Before"].with_values(BEFORE), start["After"].with_values(np.tanh(AFTER) + 0.1 * AFTER)
    )
    clean = kf.simulate(_model(path), data_of(SAMPLES), true)["y"].values
    np.save(measured, clean + np.random.default_rng(1).normal(0.0, NOISE, SAMPLES))
    return {}


def evaluate(path: str, measured: str) -> dict[str, Any]:
    """Durations of reading and compiling, of the cost, and of gradient and Gauss-Newton matrix."""
    os.environ["KENNFELD_CACHE"] = ""
    from kennfeld.optimize.problem.setup import ProblemSetup
    from kennfeld.optimize.sums.compiled import CompiledProblem
    from kennfeld.optimize.sums.objective import LeastSquaresObjective

    data = {**data_of(SAMPLES), "target": np.load(measured)}
    CompiledProblem(ProblemSetup("y = a * n + T", data, {"a": 0.5}, "target", node="y").problem())  # imports
    began = time.perf_counter()
    problem = ProblemSetup(_model(path), data, _start(), "target", node="y").problem()
    objective = LeastSquaresObjective(CompiledProblem(problem))
    compiled = time.perf_counter() - began
    values, calls = objective.start, iter(range(1_000_000))
    change = 1e-6 * np.random.default_rng(0).normal(size=values.size)

    def elsewhere() -> Any:  # another point at each call, so that nothing is kept
        return values + next(calls) * change

    works = {"cost": lambda: objective.cost(elsewhere()), "normal": lambda: objective.normal(elsewhere())}
    return {"compile": compiled, **{name: repeated(work, lasting=2.0)["best"] for name, work in works.items()}}


def solve(path: str, measured: str) -> dict[str, Any]:
    """Calibrate with Kennfeld, from the files on."""
    import kennfeld as kf

    data = {name: column[:FITTED] for name, column in {**data_of(SAMPLES), "target": np.load(measured)}.items()}
    kf.calibrate("y = a * n", {"n": [0.0, 1.0, 2.0], "m": [0.0, 1.0, 2.0]}, {"a": 0.5}, "m")  # imports, as of the peers
    began = time.perf_counter()
    result = kf.calibrate(_model(path), data, _start(), "target", node="y")
    duration = time.perf_counter() - began
    return {
        "seconds": duration,
        "cost": result.cost_after,
        "evaluations": result.evaluations,
        "start": result.cost_before,
    }


def run() -> list[Table]:
    """Both networks: a pass over the samples, and a calibration."""
    passes = Table(
        f"onnx: a pass over {SAMPLES} samples on one core",
        ("network", "tool", "result", "compile", "time a sample"),
    )
    fits = Table(
        f"onnx: calibration of a map before and a curve after a network, {FITTED} samples, {BEFORE.size + AFTER.size} "
        "free values",
        ("network", "tool", "time", "times Kennfeld", "evaluations", "cost"),
    )
    if not installed("onnx"):
        passes.notes = ["The package onnx, which writes the networks, is not installed."]
        return [passes]
    with tempfile.TemporaryDirectory() as folder:
        for width in WIDTHS:
            path = str(write_network(Path(folder) / f"{width}.onnx", width))
            measured = str(Path(folder) / f"{width}.npy")
            apart("benchmarks.onnx_networks:write_target", path=path, measured=measured)
            _add_passes(passes, f"{width}x{width}", path, measured)
            _add_fits(fits, f"{width}x{width}", path, measured)
    passes.notes = [
        BUDGET,
        "Networks of 2 inputs, two hidden layers of tanh and one output, in double precision. Kennfeld's passes "
        "include the lookups before and after the network. Its derivatives are the gradient and the Gauss-Newton "
        "matrix by all free values; compile includes reading the file and sorting the samples. The differences of "
        "ONNX Runtime are central ones along both inputs of the network only.",
        f"The shortest of {REPEATS} processes, each of several passes. Load at the end {load()}.",
    ]
    fits.notes = [
        "All start from the same values, at which their costs agree to nine digits. scipy.optimize.least_squares has "
        "its defaults with x_scale = 'jac'. By hand: one central difference along the input of the network, all other "
        "derivatives written out in numpy. Imports are not included; reading and compiling are.",
        f"All cores; the shortest of {REPEATS} runs of Kennfeld, one run of the peers. Load at the end {load()}.",
    ]
    return [passes, fits]


def _add_passes(table: Table, network: str, path: str, measured: str) -> None:
    own = _fastest("benchmarks.onnx_networks:evaluate", 1, path=path, measured=measured)
    rows = [("Kennfeld", own, "compile", (("cost", "outputs and cost"), ("normal", "with derivatives")))]
    if installed("onnxruntime"):
        target = "benchmarks.peers.onnxruntime_least_squares:evaluate"
        peer = _fastest(target, 1, path=path, samples=SAMPLES)
        rows.append(("ONNX Runtime", peer, "", (("outputs", "outputs"), ("slopes", "outputs and differences"))))
    else:
        table.add(network, "ONNX Runtime", "not installed")
    for tool, outcome, compiled, results in rows:
        for key, result in results:
            if "error" in outcome:
                table.add(network, tool, result, outcome["error"])
                continue
            spent = seconds(outcome[compiled]) if compiled else "-"
            table.add(network, tool, result, spent, f"{outcome[key] / SAMPLES * 1e6:.3g} us")


def _fastest(target: str, cores: int | None, **arguments: Any) -> dict[str, Any]:
    """Return the least of each number over several processes."""
    runs = [apart(target, cores=cores, **arguments) for _ in range(REPEATS)]
    failed = [outcome for outcome in runs if "error" in outcome]
    return failed[0] if failed else {key: min(outcome[key] for outcome in runs) for key in runs[0]}


def _add_fits(table: Table, network: str, path: str, measured: str) -> None:
    own = _fastest("benchmarks.onnx_networks:solve", None, path=path, measured=measured)
    outcomes = {"Kennfeld": own}
    for tool, chain in PEERS.items():
        if not installed("onnxruntime", "scipy"):
            outcomes[tool] = {"error": "not installed"}
            continue
        target = "benchmarks.peers.onnxruntime_least_squares:solve"
        case = {"path": path, "samples": SAMPLES, "fitted": FITTED, "measured": measured, "chain": chain}
        outcomes[tool] = apart(target, timeout=TIMEOUT, **case)
    for tool, outcome in outcomes.items():
        if "error" in outcome:
            table.add(network, tool, outcome["error"])
            continue
        assert abs(outcome["start"] - own["start"]) <= SAME * own["start"], (tool, outcome["start"], own["start"])
        ratio = outcome["seconds"] / own["seconds"]
        cost = f"{outcome['cost']:.8g}"
        table.add(network, tool, seconds(outcome["seconds"]), f"{ratio:.3g}", str(outcome["evaluations"]), cost)
