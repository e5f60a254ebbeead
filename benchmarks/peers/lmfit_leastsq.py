"""lmfit.minimize with MINPACK's leastsq: finite differences, bounds by a change of variables, the pin by vary=False."""

from typing import Any

import numpy as np

from benchmarks.peers.recorder import Recorder
from benchmarks.torque_problem import problem

__all__ = ["solve"]


def solve(cap: float) -> dict[str, Any]:
    """Solve with lmfit's defaults but for the number of evaluations."""
    import lmfit

    task = problem()
    parameters = lmfit.Parameters()
    lower, upper = np.full(task.total, -np.inf), np.full(task.total, np.inf)
    lower[task.kept], upper[task.kept] = task.bounds
    for number, value in enumerate(task.whole(task.start)):
        free = number != task.pinned
        parameters.add(f"p{number}", value=value, vary=free, min=lower[number], max=upper[number])
    recorder = Recorder(task.residual, task.start, cap)

    def residual(current: lmfit.Parameters) -> Any:
        values = np.fromiter((p.value for p in current.values()), dtype=float, count=task.total)
        return recorder(values[task.kept])

    return recorder.run(lambda: lmfit.minimize(residual, parameters, method="leastsq", max_nfev=10**9))
