"""FMUs for co-simulation, simulated by FMPy."""

import ctypes
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.fmu_problem import PROBLEMS

__all__ = ["loop"]

Float = NDArray[np.float64]


def loop(path: Path, name: str, data: dict[str, Float]) -> Callable[[Float], Float]:
    """Simulate by the C functions of FMPy's instance, with all memory allocated once."""
    from fmpy import extract, instantiate_fmu, read_model_description

    problem = PROBLEMS[name]
    description = read_model_description(path)
    instance = instantiate_fmu(extract(str(path)), description, "CoSimulation")
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    parameters = [references[parameter] for parameter in problem.parameters]
    channels = (ctypes.c_uint * len(problem.inputs))(*(references[channel] for channel in problem.inputs))
    columns = [data[channel].tolist() for channel in problem.inputs]
    rows = list(zip(*columns, strict=True)) if columns else [()] * len(data["time"])
    times = data["time"].tolist()
    step = times[1] - times[0]
    values_of_inputs = (ctypes.c_double * len(channels))()
    output, value = (ctypes.c_uint * 1)(references[problem.output]), (ctypes.c_double * 1)()
    component = instance.component
    set_real, get_real, do_step = instance.fmi2SetReal, instance.fmi2GetReal, instance.fmi2DoStep

    def initialize(values: Float) -> None:
        instance.reset()
        instance.setupExperiment(startTime=0.0)
        instance.setReal(parameters, values.tolist())
        instance.enterInitializationMode()
        if rows[0]:
            instance.setReal(list(channels), list(rows[0]))
        instance.exitInitializationMode()

    def simulate(values: Float) -> Float:
        initialize(values)
        outputs = np.empty(len(times))
        for number, (t, row) in enumerate(zip(times, rows, strict=True)):
            get_real(component, output, 1, value)
            outputs[number] = value[0]
            if row:
                values_of_inputs[:] = row
                set_real(component, channels, len(row), values_of_inputs)
            do_step(component, t, step, 0)
        return outputs

    return simulate
