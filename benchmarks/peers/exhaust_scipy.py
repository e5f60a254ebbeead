"""scipy.optimize.least_squares, trust region reflective, on the exhaust problem, with different Jacobians."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.exhaust_problem import problem
from benchmarks.peers.trf import run_trf

__all__ = ["solve"]


def solve(cap: float, jacobian: str, scaled: bool) -> dict[str, Any]:
    """Solve with a Jacobian `differences` or `filtered` (the basis through the lag); `scaled` says x_scale="jac"."""
    task = problem()
    jacobians: dict[str, str | Callable[[NDArray[np.float64]], Any]] = {
        "differences": "2-point",
        "filtered": task.jacobian,
    }
    return run_trf(task, cap, jacobians[jacobian], scaled, "exact")
