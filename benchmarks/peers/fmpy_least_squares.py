"""FMPy with one instance for all runs, and `scipy.optimize.least_squares` with its defaults."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fmu_problem import PROBLEMS, data_of
from benchmarks.peers import fmpy_equations, fmpy_simulate_fmu, fmpy_steps

__all__ = ["solve"]

Float = NDArray[np.float64]


def solve(path: str, name: str, samples: int, span: float, measured: str, solver: str, loop: bool) -> dict[str, Any]:
    """Calibrate an FMU.

    Args:
        path: the FMU.
        name: its problem.
        samples: number of samples.
        span: their duration in s.
        measured: file with the values to be reproduced.
        solver: `ode1` or `ode4` for model exchange, else `co-simulation`.
        loop: True for a loop over the functions of FMPy's instance, False for `fmpy.simulate_fmu`.
    """
    import fmpy  # noqa: F401, imported before time runs
    from scipy.optimize import least_squares

    problem, data, target = PROBLEMS[name], data_of(name, samples, span), np.load(measured)
    begin = time.perf_counter()
    simulate = _simulator(Path(path), name, data, solver, loop)
    result = least_squares(lambda values: simulate(values) - target, list(problem.parameters.values()))
    duration = time.perf_counter() - begin
    return {"seconds": duration, "cost": 2 * result.cost, "values": result.x.tolist(), "evaluations": result.nfev}


def _simulator(path: Path, name: str, data: dict[str, Float], solver: str, loop: bool) -> Callable[[Float], Float]:
    if not loop:
        interface = "CoSimulation" if solver == "co-simulation" else "ModelExchange"
        return fmpy_simulate_fmu.simulator(path, name, data, interface)
    if solver == "co-simulation":
        return fmpy_steps.loop(path, name, data)
    return fmpy_equations.loop(path, name, data, solver)
