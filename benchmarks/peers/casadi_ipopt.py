"""CasADi with IPOPT: the exact Hessian of the cost, bounds, and the pin by elimination."""

import time
from typing import Any

import numpy as np

from benchmarks.torque_problem import NAMES, TorqueProblem, problem

__all__ = ["cost_at", "solve"]


def _cost(task: TorqueProblem, free: Any) -> Any:
    """The cost as a CasADi expression."""
    import casadi as ca
    from scipy import sparse

    def constant(matrix: Any) -> Any:
        return ca.DM(sparse.csc_matrix(matrix))

    at = task.pinned
    values = ca.vertcat(free[:at], 1.0, free[at:])
    part = {n: values[task.offsets[n] : task.offsets[n] + task.sizes[n]] for n in NAMES}
    points = task.training
    best, spark, drag = (ca.mtimes(constant(points.maps[n].matrix), part[n]) for n in points.maps)
    delta, axis, eta = spark - points.ignition, task.eta_axis, part["CurveEtaDeltaSpark"]
    efficiency = eta[0]
    for i in range(axis.size - 1):
        share = ca.fmin(ca.fmax((delta - axis[i]) / (axis[i + 1] - axis[i]), 0.0), 1.0)
        efficiency = efficiency + (eta[i + 1] - eta[i]) * share
    data = best * efficiency - drag - points.torque
    return ca.sumsqr(data) + ca.sumsqr(ca.mtimes(constant(task.roughness), values))


def cost_at(points: list[list[float]]) -> dict[str, list[float]]:
    """The cost at given values, to compare it with the other tools'."""
    import casadi as ca

    free = ca.MX.sym("free", len(points[0]))
    f = ca.Function("cost", [free], [_cost(problem(), free)])
    return {"costs": [float(f(np.array(point))) for point in points]}


def solve(cap: float) -> dict[str, Any]:
    """Solve with IPOPT's defaults. The trace's times are spread evenly over the iterations."""
    import casadi as ca

    task = problem()
    began = time.perf_counter()
    free = ca.MX.sym("free", task.start.size)
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    options = {"expand": True, "ipopt.max_wall_time": cap, "ipopt.max_iter": 3000, **quiet}
    solver = ca.nlpsol("solver", "ipopt", {"x": free, "f": _cost(task, free)}, options)
    ready = time.perf_counter()
    lower, upper = task.bounds
    solution = solver(x0=task.start, lbx=lower, ubx=upper)
    seconds = time.perf_counter() - ready
    stats = solver.stats()
    costs = stats["iterations"]["obj"]
    status = stats["return_status"]
    return {
        "setup": ready - began,
        "seconds": seconds,
        "values": np.clip(np.array(solution["x"]).ravel(), lower, upper).tolist(),
        "trace": [(seconds * i / max(len(costs) - 1, 1), cost) for i, cost in enumerate(costs)],
        "note": {"Solve_Succeeded": "", "Maximum_WallTime_Exceeded": "out of time"}.get(status, status),
    }
