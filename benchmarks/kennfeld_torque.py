"""Kennfeld on the torque problem, as functions that `measure.apart` can call."""

from typing import Any

from benchmarks.torque_problem import PIN, TorqueProblem, problem
from kennfeld.domain.parameter_set import ParameterSet

__all__ = ["cost_at", "solve"]


def _parameters(task: TorqueProblem, values: Any) -> ParameterSet:
    changed = [task.parameters[n].with_values(task.part(values, n)) for n in task.offsets]
    return task.parameters.with_parameters(*changed)


def cost_at(points: list[list[float]]) -> dict[str, list[float]]:
    """The cost at given values, to compare it with the other tools'."""
    task = problem()
    return {"costs": [_run(_parameters(task, task.whole(point)), max_iterations=0).cost_before for point in points]}


def _run(start: ParameterSet, seed: int = 0, **options: Any) -> Any:
    from kennfeld.domain.constraints import Pin
    from kennfeld.optimize import Options, calibrate
    from kennfeld.project.demo import torque

    return calibrate(
        torque.FORMULA,
        torque.bench(seed),
        start,
        "Torque",
        node="TorquePredict",
        smoothness=torque.SMOOTHNESS,
        pins=[Pin(*PIN)],
        options=Options(**options),
    )


def solve(continuation: str, seed: int = 0) -> dict[str, Any]:
    """Calibrate. The trace's seconds count from the end of compiling; stages on a smoothed model are left out."""
    task = problem(seed)
    result = _run(task.parameters, seed, continuation=continuation)
    compiled = result.seconds.compile
    exact = [line for line in result.trace if not line.stage.startswith("smooth")]
    return {
        "setup": compiled,
        "seconds": result.seconds.optimize,
        "values": task.flat(result.parameters)[task.kept].tolist(),
        "trace": [(line.seconds - compiled, line.cost) for line in exact],
        "note": "" if result.converged else result.status,
        "evaluations": result.evaluations,
    }
