"""FMUs for model exchange, simulated by FMPy."""

import ctypes
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.fmu_problem import PROBLEMS

__all__ = ["loop"]

Float = NDArray[np.float64]
TABLEAUS = {
    "ode1": ((0.0,), ((),), (1.0,)),
    "ode4": ((0.0, 0.5, 0.5, 1.0), ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
}


def loop(path: Path, name: str, data: dict[str, Float], solver: str) -> Callable[[Float], Float]:
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
