"""scipy.optimize.least_squares, trust region reflective: bounds, and the pin by elimination."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.trf import run_trf
from benchmarks.torque_problem import problem

__all__ = ["solve"]


def solve(cap: float, jacobian: str, scaled: bool, seed: int = 0) -> dict[str, Any]:
    """Solve with a Jacobian `differences`, `dense` or `sparse` (with lsmr); `scaled` says x_scale="jac"."""
    task = problem(seed)
    jacobians: dict[str, str | Callable[[NDArray[np.float64]], Any]] = {
        "differences": "2-point",
        "dense": lambda values: task.jacobian(values).toarray(),
        "sparse": task.jacobian,
    }
    return run_trf(task, cap, jacobians[jacobian], scaled, "lsmr" if jacobian == "sparse" else "exact")
