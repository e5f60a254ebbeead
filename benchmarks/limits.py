"""Topic `limits`: what limits of slopes cost on the torque problem."""

from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart, threads
from benchmarks.table import Table, seconds

__all__ = ["run", "solve"]

REPEATS = 5
SIDES = (44, 56)  # percentiles of the slopes of the fit without limits, which become their limits


def solve(limited: bool) -> dict[str, Any]:
    """One calibration of a process of its own, with or without limits."""
    from kennfeld.constraints import Pin, Shape
    from kennfeld.criteria import Criterion
    from kennfeld.models.formula import formula
    from kennfeld.optimize import Options, Problem, run
    from kennfeld.project.demo import torque

    def fitted(constraints: tuple[Shape, ...]) -> Any:
        start = torque.start()
        problem = Problem(
            formula(torque.FORMULA, parameters=list(start)),
            (torque.bench(),),
            start,
            (Criterion("TorquePredict", "Torque"),),
            smoothness=torque.SMOOTHNESS,
            pins=(Pin("CurveEtaDeltaSpark", (0.0,), 1.0),),
            constraints=constraints,
        )
        return run(problem, Options(continuation="off"))

    free = fitted(())
    shapes, count = [], 0
    for name, axis in (("MapOptTorque", 1), ("MapDragTorque", 0)):
        table = free.parameters[name]
        gaps = np.diff(table.index_axes[axis].breakpoints)
        slopes = np.diff(table.values, axis=axis) / (gaps if axis else gaps[:, None])
        shapes.append(Shape(name, axis, "slope", *np.percentile(slopes, SIDES)))
        count += slopes.size
    result = fitted(tuple(shapes) if limited else ())
    return {
        "limits": count if limited else 0,
        "active": result.trace[-1].active,
        "iterations": result.iterations,
        "evaluations": result.evaluations,
        "total": result.seconds.total,
        "optimize": result.seconds.optimize,
        "cost": result.cost_after,
    }


def run() -> list[Table]:
    """Without limits, and with some four hundred of which a third are active at the end."""
    columns = ("limits", "active at the end", "threads", "iterations", "evaluations", "optimize", "whole", "cost")
    table = Table("limits: 519 values of the torque problem, slopes of two maps limited", columns)
    fastest = {}
    for limited in (False, True):
        runs = [apart("benchmarks.limits:solve", cores=1, limited=limited) for _ in range(REPEATS)]
        best = fastest[limited] = min(runs, key=lambda outcome: outcome["total"])
        table.add(
            *(str(best["limits"]), str(best["active"]), str(threads(1))),
            *(str(best["iterations"]), str(best["evaluations"])),
            *(seconds(best["optimize"]), seconds(best["total"]), f"{best['cost']:.6g}"),
        )
    ratio = fastest[True]["total"] / fastest[False]["total"]
    table.notes = [
        f"Budget: below 3 times the run without limits; it took {ratio:.1f} times that.",
        f"The shortest of {REPEATS} runs, the second fit of its process. Load at the end {load()}.",
    ]
    return [table]
