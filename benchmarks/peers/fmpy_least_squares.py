"""FMPy with one instance for all runs, and `scipy.optimize.least_squares` with its defaults."""

import ctypes
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.fmu_problem import PROBLEMS, data_of

__all__ = ["solve"]

Float = NDArray[np.float64]
TABLEAUS = {
    "ode1": ((0.0,), ((),), (1.0,)),
    "ode4": ((0.0, 0.5, 0.5, 1.0), ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
}


def solve(path: str, name: str, samples: int, span: float, measured: str, solver: str, loop: bool) -> dict[str, Any]:
    """Calibrate an FMU.

    Args:
        path: the FMU.
        name: its problem.
        samples: number of samples.
        span: their duration in s.
        measured: file with the values to be reproduced.
        solver: `ode1` or `ode4`.
        loop: True for a loop over the functions of FMPy's instance, False for `fmpy.simulate_fmu`.
    """
    from scipy.optimize import least_squares

    problem, data, target = PROBLEMS[name], data_of(name, samples, span), np.load(measured)
    begin = time.perf_counter()
    simulate = (_loop if loop else _simulate_fmu)(Path(path), name, data, solver)
    result = least_squares(lambda values: simulate(values) - target, list(problem.parameters.values()))
    duration = time.perf_counter() - begin
    return {"seconds": duration, "cost": 2 * result.cost, "values": result.x.tolist(), "evaluations": result.nfev}


def _simulate_fmu(path: Path, name: str, data: dict[str, Float], solver: str) -> Callable[[Float], Float]:
    from fmpy import extract, instantiate_fmu, read_model_description, simulate_fmu

    assert solver == "ode1"  # the only fixed-step solver of FMPy
    problem, times = PROBLEMS[name], data["time"]
    description, folder = read_model_description(path), extract(str(path))
    instance = instantiate_fmu(folder, description, "ModelExchange")
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
            fmi_type="ModelExchange",
            solver="Euler",
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


def _loop(path: Path, name: str, data: dict[str, Float], solver: str) -> Callable[[Float], Float]:
    """Simulate by the C functions of FMPy's instance, with all memory allocated once."""
    from fmpy import extract, instantiate_fmu, read_model_description

    problem = PROBLEMS[name]
    description = read_model_description(path)
    instance = instantiate_fmu(extract(str(path)), description, "ModelExchange")
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    parameters = [references[parameter] for parameter in problem.parameters]
    channels = (ctypes.c_uint * len(problem.inputs))(*(references[channel] for channel in problem.inputs))
    columns = [data[channel].tolist() for channel in problem.inputs]
    rows = list(zip(*columns, strict=True)) if columns else [()] * len(data["time"])
    times = data["time"].tolist()
    size, step = len(problem.states), times[1] - times[0]
    states, slopes = ((ctypes.c_double * size)() for _ in range(2))
    values_of_inputs = (ctypes.c_double * len(channels))()
    component = instance.component
    set_time, set_states = instance.fmi2SetTime, instance.fmi2SetContinuousStates
    get_derivatives, set_real = instance.fmi2GetDerivatives, instance.fmi2SetReal
    nodes, coefficients, weights = TABLEAUS[solver]

    def initialize(values: Float) -> list[float]:
        instance.reset()
        instance.setupExperiment(startTime=0.0)
        instance.setReal(parameters, values.tolist())
        instance.enterInitializationMode()
        if rows[0]:
            instance.setReal(list(channels), list(rows[0]))
        instance.exitInitializationMode()
        instance.newDiscreteStates()
        instance.enterContinuousTimeMode()
        instance.fmi2GetContinuousStates(component, states, size)
        return list(states)

    def simulate(values: Float) -> Float:
        x, output = initialize(values), np.empty(len(times))
        for number, (t, row) in enumerate(zip(times, rows, strict=True)):
            output[number] = x[0]
            if row:
                values_of_inputs[:] = row
                set_real(component, channels, len(row), values_of_inputs)
            stages: list[list[float]] = []
            for node, shares in zip(nodes, coefficients, strict=True):
                set_time(component, t + node * step)
                states[:] = [a + step * sum(s * k[i] for s, k in zip(shares, stages)) for i, a in enumerate(x)]  # noqa: B905
                set_states(component, states, size)
                get_derivatives(component, slopes, size)
                stages.append(slopes[:])
            x = [a + step * sum(w * k[i] for w, k in zip(weights, stages)) for i, a in enumerate(x)]  # noqa: B905
        return output

    return simulate
