"""Topic `limits`: what limits of slopes cost on the torque problem, a run and a single step."""

from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart, repeated, threads
from benchmarks.table import Table, seconds

__all__ = ["run", "solve", "step"]

REPEATS = 5
SIDES = (44, 56)  # percentiles of the slopes of the fit without limits, which become their limits
DAMPING = 1e-4
VIOLATED = (0, 15, 60, 150)  # limits that the free step of a single program violates


def solve(limited: bool) -> dict[str, Any]:
    """One calibration of a process of its own, with or without limits."""
    from kennfeld.domain.constraints import Pin, Shape
    from kennfeld.domain.criteria import Criterion
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
        lower, upper = np.percentile(slopes, SIDES)
        shapes.append(Shape(name, axis, "slope", lower=lower, upper=upper))
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


def step(violated: int) -> dict[str, Any]:
    """One damped step after eight iterations, whose slopes along a map's axis are limited to half their change.

    The factor and the quadratic program with the active limits of the same one before, as in a descent.
    """
    from kennfeld.domain.criteria import Criterion
    from kennfeld.models.formula import formula
    from kennfeld.optimize import Problem
    from kennfeld.optimize.solver.gauss_newton_model import GaussNewtonModel
    from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
    from kennfeld.optimize.solver.linear_constraints import LinearLimits, LinearRows
    from kennfeld.optimize.solver.quadratic_program import QuadraticProgram
    from kennfeld.optimize.sums.compiled import CompiledProblem
    from kennfeld.optimize.sums.objective import LeastSquaresObjective
    from kennfeld.project.demo import torque

    start = torque.start()
    model = formula(torque.FORMULA, parameters=list(start))
    criteria = (Criterion("TorquePredict", "Torque"),)
    compiled = CompiledProblem(Problem(model, (torque.bench(),), start, criteria, smoothness=torque.SMOOTHNESS))
    objective = LeastSquaresObjective(compiled)
    size = objective.start.size
    free = LinearLimits.none(size)
    at = levenberg_marquardt(objective, objective.start, free, SolverSettings(max_iterations=8)).values
    linearised = GaussNewtonModel(objective, at, np.arange(size))

    damped = linearised.damped_factor(DAMPING)
    assert damped is not None
    shape, first = start["MapOptTorque"].values.shape, compiled.values.offsets["MapOptTorque"]
    numbers = first + np.arange(shape[0] * shape[1]).reshape(shape)
    pairs = np.stack([numbers[:, :-1].ravel(), numbers[:, 1:].ravel()], axis=1)
    changes, here = (np.diff(values[pairs], axis=1).ravel() for values in (damped.step, at))
    limited = np.argsort(-np.abs(changes))[:violated]
    lower, upper = np.full(len(pairs), -np.inf), np.full(len(pairs), np.inf)
    for side, falls in ((lower, True), (upper, False)):
        which = limited[(changes[limited] < 0) == falls]
        side[which] = here[which] + 0.5 * changes[which]
    rows = LinearRows(pairs, np.tile([-1.0, 1.0], (len(pairs), 1)), lower, upper)
    program = QuadraticProgram(LinearLimits(free.lower, free.upper, rows))
    active = program.solve(damped.factor, damped.step, at).active
    return {
        "active": int(np.count_nonzero(active)),
        "program": repeated(lambda: program.solve(damped.factor, damped.step, at, active), most=2000)["best"],
        "factor": repeated(lambda: linearised.damped_factor(DAMPING), most=1000)["best"],
    }


def run() -> list[Table]:
    """A run without limits, and with some four hundred of which a third are active at the end; then single steps."""
    return [_runs(), _steps()]


def _steps() -> Table:
    columns = ("violated by the free step", "active", "threads", "factor and free step", "quadratic program")
    table = Table("limits: a step for 519 values", columns)
    for violated in VIOLATED:
        best = apart("benchmarks.limits:step", cores=1, violated=violated)
        durations = (seconds(best["factor"]), seconds(best["program"]))
        table.add(str(violated), str(best["active"]), str(threads(1)), *durations)
    table.notes = [f"Budget: 0.1 ms with ten active limits, in addition to the factor. Load at the end {load()}."]
    return table


def _runs() -> Table:
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
    return table
