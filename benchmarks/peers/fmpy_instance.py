"""An instance of FMPy for loops of one's own over its C functions, with all memory allocated once."""

import ctypes
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.fmu_problem import PROBLEMS

__all__ = ["FmpyInstance"]

Float = NDArray[np.float64]


class FmpyInstance:
    """An instance, with the data of its problem.

    Attributes:
        instance: FMPy's object.
        component: what its C functions take first.
        samples: time and inputs of each sample; without inputs, these are empty.
        step: time step in s.
        output: value reference of the output.
        channels: value references of the inputs.
        inputs: memory for the inputs of a sample. Loops set them themselves: a call of Python a sample takes time.
    """

    def __init__(self, path: Path, name: str, data: dict[str, Float], interface: str) -> None:
        from fmpy import extract, instantiate_fmu, read_model_description

        problem, description = PROBLEMS[name], read_model_description(path)
        self.instance = instantiate_fmu(extract(str(path)), description, interface)
        self.component = self.instance.component
        references = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.output = references[problem.output]
        self._parameters = [references[parameter] for parameter in problem.parameters]
        self.channels = (ctypes.c_uint * len(problem.inputs))(*(references[channel] for channel in problem.inputs))
        self.inputs = (ctypes.c_double * len(problem.inputs))()
        times = data["time"].tolist()
        columns = [data[channel].tolist() for channel in problem.inputs]
        rows = list(zip(*columns, strict=True)) if columns else [()] * len(times)
        self.samples = list(zip(times, rows, strict=True))
        self.step = times[1] - times[0]

    def initialize(self, values: Float) -> None:
        """Start anew with some values of the parameters."""
        instance, (_, row) = self.instance, self.samples[0]
        instance.reset()
        instance.setupExperiment(startTime=0.0)
        instance.setReal(self._parameters, values.tolist())
        instance.enterInitializationMode()
        if row:
            instance.setReal(list(self.channels), list(row))
        instance.exitInitializationMode()
