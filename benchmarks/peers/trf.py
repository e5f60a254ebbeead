"""scipy.optimize.least_squares, trust region reflective, with the clock beside it."""

from collections.abc import Callable
from typing import Any

from benchmarks.peers.recorder import Recorder

__all__ = ["run_trf"]


def run_trf(task: Any, cap: float, jacobian: str | Callable[..., Any], scaled: bool, solver: str) -> dict[str, Any]:
    """Solve a problem within its bounds; `scaled` says x_scale="jac", `solver` is scipy's tr_solver."""
    from scipy.optimize import least_squares

    residual = Recorder(task.residual, task.start, cap)
    task.jacobian(task.start)
    return residual.run(
        lambda: least_squares(
            residual,
            task.start,
            jac=jacobian,
            bounds=task.bounds,
            x_scale="jac" if scaled else 1.0,
            tr_solver=solver,
        )
    )
