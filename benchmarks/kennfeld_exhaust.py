"""Kennfeld on the exhaust problem, as functions that `measure.apart` can call."""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.exhaust_problem import MAP, WARMUP
from kennfeld.domain.parameter_set import ParameterSet

__all__ = ["cost_at", "solve"]


def _run(values: list[float] | None = None, **options: Any) -> Any:
    from kennfeld.optimize import Options, calibrate
    from kennfeld.project.demo import exhaust

    start = exhaust.start()
    if values is not None:
        parts = (values[:MAP], values[MAP:])
        changed = [p.with_values(np.reshape(v, p.values.shape)) for p, v in zip(start.parameters, parts, strict=True)]
        start = ParameterSet(changed)
    data = exhaust.training()
    assert data.time is not None
    return calibrate(
        exhaust.FORMULA,
        replace(data, scored=data.time - data.time[0] >= WARMUP),
        start,
        "Temperature",
        node="TemperaturePredict",
        smoothness=exhaust.SMOOTHNESS,
        bounds=exhaust.BOUNDS,
        options=Options(**options),
    )


def cost_at(points: list[list[float]]) -> dict[str, list[float]]:
    """The cost at given values, to compare it with the other tools'."""
    return {"costs": [_run(point, max_iterations=0).cost_before for point in points]}


def solve() -> dict[str, Any]:
    """Calibrate. The trace's seconds count from the end of compiling."""
    result = _run()
    compiled = result.seconds.compile
    values = np.concatenate([p.values.ravel() for p in result.parameters.parameters])
    return {
        "setup": compiled,
        "seconds": result.seconds.optimize,
        "values": values.tolist(),
        "trace": [(line.seconds - compiled, line.cost) for line in result.trace],
        "note": "" if result.converged else result.status,
    }
