"""Topic `constrained`: random fits of tables within linear limits, beside Clarabel by CVXPY."""

import time
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart, installed
from benchmarks.table import Table, seconds

__all__ = ["run", "solve"]

FITS = 500
NARROW = 5  # every so many, bounds may contradict the limits of slopes
TOLERANCE = 1e-6  # of the sum of squares of the data, in which costs agree
HOLDS = 1e-9  # of the largest value, to which limits hold


def run() -> list[Table]:
    """Compare costs and status over all fits."""
    columns = ("fits", "equal cost", "equal status", "infeasible", "largest violation", "time", "CVXPY")
    table = Table("constrained: curves and maps within bounds and limits of slopes and curvature", columns)
    if not installed("cvxpy"):
        table.notes = ["Skipped: cvxpy is missing."]
        return [table]
    end = apart("benchmarks.constrained:solve", cores=1, timeout=3600.0)
    counts = (str(end[name]) for name in ("fits", "equal_cost", "equal_status", "infeasible"))
    table.add(*counts, f"{end['violation']:.1g}", seconds(end["seconds"]), seconds(end["peer_seconds"]))
    table.notes = [
        f"Costs are equal within {TOLERANCE:g} of the sum of squares of the data. The status is equal if both are "
        f"feasible or both are not. Kennfeld compiles each model, which is in its time. Load at the end {load()}.",
        *end["different"],
    ]
    return [table]


def solve(fits: int = FITS) -> dict[str, Any]:
    """Fit all draws with both, in a process of its own."""
    from tests.optimize.constrained_fits import curve_fit, map_fit

    random = np.random.default_rng(31)
    counts = {"fits": fits, "equal_cost": 0, "equal_status": 0, "infeasible": 0}
    violation, spent, peer, different = 0.0, 0.0, 0.0, []
    for number in range(fits):
        fit = (curve_fit, map_fit)[number % 2](random)
        if number % NARROW == 0:
            lower = float(random.uniform(-1, 1))
            width = float(random.uniform(0, 1))
            fit = replace(fit, table=fit.table.changed(lower=lower, upper=lower + width))
        began = time.process_time()
        result = fit.result
        spent += time.process_time() - began
        began = time.process_time()
        least = fit.least_cost
        peer += time.process_time() - began
        feasible = least is not None and bool(np.isfinite(least))
        same_status = result.status == ("converged" if feasible else "infeasible")
        squares = float(np.sum(fit.data["z"] ** 2))
        same_cost = not feasible or abs(result.cost_after - least) <= TOLERANCE * squares
        counts["equal_status"] += same_status
        counts["equal_cost"] += same_cost
        counts["infeasible"] += not feasible
        if feasible:
            violation = max(violation, fit.violation(result.parameters))
        if not (same_status and same_cost):
            different.append(f"Fit {number}: {result.status}, cost {result.cost_after:.9g}; CVXPY {least}.")
    return counts | {"violation": violation, "seconds": spent, "peer_seconds": peer, "different": different}
