"""scipy.optimize.least_squares, trust region reflective: bounds, and the pin by elimination."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.recorder import Recorder
from benchmarks.torque_problem import problem

__all__ = ["solve"]


def solve(cap: float, jacobian: str, scaled: bool, seed: int = 0) -> dict[str, Any]:
    """Solve with a Jacobian `differences`, `dense` or `sparse` (with lsmr); `scaled` says x_scale="jac"."""
    from scipy.optimize import least_squares

    given = problem(seed)
    residual = Recorder(given.residual, given.start, cap)
    jacobians: dict[str, str | Callable[[NDArray[np.float64]], Any]] = {
        "differences": "2-point",
        "dense": lambda values: given.jacobian(values).toarray(),
        "sparse": given.jacobian,
    }
    given.jacobian(given.start)
    return residual.run(
        lambda: least_squares(
            residual,
            given.start,
            jac=jacobians[jacobian],
            bounds=given.bounds,
            x_scale="jac" if scaled else 1.0,
            tr_solver="lsmr" if jacobian == "sparse" else "exact",
        )
    )
