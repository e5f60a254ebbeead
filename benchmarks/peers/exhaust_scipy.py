"""scipy.optimize.least_squares, trust region reflective, on the exhaust problem, with different Jacobians."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.exhaust_problem import problem
from benchmarks.peers.recorder import Recorder

__all__ = ["solve"]

Float = NDArray[np.float64]


def solve(cap: float, jacobian: str, scaled: bool) -> dict[str, Any]:
    """Solve with a Jacobian `differences` or `filtered` (the basis through the lag); `scaled` says x_scale="jac"."""
    from scipy.optimize import least_squares

    given = problem()
    residual = Recorder(given.residual, given.start, cap)
    jacobians: dict[str, str | Callable[[Float], Any]] = {"differences": "2-point", "filtered": given.jacobian}
    given.jacobian(given.start)
    return residual.run(
        lambda: least_squares(
            residual,
            given.start,
            jac=jacobians[jacobian],
            bounds=given.bounds,
            x_scale="jac" if scaled else 1.0,
        )
    )
