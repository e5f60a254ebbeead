"""FMUs, simulated by `fmpy.simulate_fmu`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.fmu_problem import PROBLEMS

__all__ = ["simulator"]

Float = NDArray[np.float64]


def simulator(path: Path, name: str, data: dict[str, Float], interface: str) -> Callable[[Float], Float]:
    """Return a function that simulates with `interface` "ModelExchange" or "CoSimulation"."""
    from fmpy import extract, instantiate_fmu, read_model_description, simulate_fmu

    problem, times = PROBLEMS[name], data["time"]
    description, folder = read_model_description(path), extract(str(path))
    instance = instantiate_fmu(folder, description, interface)
    inputs = None
    if problem.inputs:
        kinds = [("time", np.float64), *((channel, np.float64) for channel in problem.inputs)]
        inputs = np.array(list(zip(*data.values(), strict=True)), dtype=kinds)
    step = times[1] - times[0]

    def simulate(values: Float) -> Float:
        instance.reset()
        result = simulate_fmu(
            folder,
            model_description=description,
            fmu_instance=instance,
            fmi_type=interface,
            solver="Euler",  # its only fixed-step solver, for model exchange
            step_size=step,
            output_interval=step,
            start_time=0.0,
            stop_time=times[-1],
            start_values=dict(zip(problem.parameters, values, strict=True)),
            input=inputs,
            output=[problem.output],
            validate=False,
        )
        return np.asarray(result[problem.output])

    return simulate
