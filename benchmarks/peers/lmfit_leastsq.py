"""lmfit.minimize with MINPACK's leastsq: finite differences, bounds by a change of variables, the pin by vary=False."""

from typing import Any

import numpy as np

from benchmarks.peers.recorder import Recorder
from benchmarks.torque_problem import problem

__all__ = ["solve"]


def solve(cap: float) -> dict[str, Any]:
    """Solve with lmfit's defaults but for the number of evaluations."""
    import lmfit

    given = problem()
    parameters = lmfit.Parameters()
    lower, upper = np.full(given.total, -np.inf), np.full(given.total, np.inf)
    lower[given.kept], upper[given.kept] = given.bounds
    for number, value in enumerate(given.whole(given.start)):
        free = number != given.pinned
        parameters.add(f"p{number}", value=value, vary=free, min=lower[number], max=upper[number])
    recorder = Recorder(given.residual, given.start, cap)

    def residual(found: lmfit.Parameters) -> Any:
        values = np.fromiter((p.value for p in found.values()), dtype=float, count=given.total)
        return recorder(values[given.kept])

    return recorder.run(lambda: lmfit.minimize(residual, parameters, method="leastsq", max_nfev=10**9))
