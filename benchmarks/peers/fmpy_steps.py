"""FMUs for co-simulation, simulated by a loop over the C functions of FMPy's instance."""

import ctypes
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.fmpy_instance import FmpyInstance

__all__ = ["loop"]

Float = NDArray[np.float64]


def loop(path: Path, name: str, data: dict[str, Float]) -> Callable[[Float], Float]:
    """Return a function that simulates, step by step."""
    own = FmpyInstance(path, name, data, "CoSimulation")
    component, step = own.component, own.step
    output, value = (ctypes.c_uint * 1)(own.output), (ctypes.c_double * 1)()
    get_real, do_step = own.instance.fmi2GetReal, own.instance.fmi2DoStep

    channels, inputs, set_real = own.channels, own.inputs, own.instance.fmi2SetReal

    def simulate(values: Float) -> Float:
        own.initialize(values)
        outputs = np.empty(len(own.samples))
        for number, (t, row) in enumerate(own.samples):
            get_real(component, output, 1, value)
            outputs[number] = value[0]
            if row:
                inputs[:] = row
                set_real(component, channels, len(row), inputs)
            do_step(component, t, step, 0)
        return outputs

    return simulate
