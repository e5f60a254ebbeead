"""FMUs for model exchange, simulated by a loop over the C functions of FMPy's instance."""

import ctypes
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.fmu_problem import PROBLEMS
from benchmarks.peers.fmpy_instance import FmpyInstance

__all__ = ["loop"]

Float = NDArray[np.float64]
TABLEAUS = {
    "ode1": ((0.0,), ((),), (1.0,)),
    "ode4": ((0.0, 0.5, 0.5, 1.0), ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
}


def loop(path: Path, name: str, data: dict[str, Float], solver: str) -> Callable[[Float], Float]:
    """Return a function that simulates with a solver of `TABLEAUS`."""
    own = FmpyInstance(path, name, data, "ModelExchange")
    instance, component, step = own.instance, own.component, own.step
    size = len(PROBLEMS[name].states)
    states, slopes = ((ctypes.c_double * size)() for _ in range(2))
    set_time, set_states = instance.fmi2SetTime, instance.fmi2SetContinuousStates
    get_derivatives = instance.fmi2GetDerivatives
    nodes, coefficients, weights = TABLEAUS[solver]

    def initialize(values: Float) -> list[float]:
        own.initialize(values)
        instance.newDiscreteStates()
        instance.enterContinuousTimeMode()
        instance.fmi2GetContinuousStates(component, states, size)
        return list(states)

    channels, inputs, set_real = own.channels, own.inputs, own.instance.fmi2SetReal

    def simulate(values: Float) -> Float:
        x, output = initialize(values), np.empty(len(own.samples))
        for number, (t, row) in enumerate(own.samples):
            output[number] = x[0]
            if row:
                inputs[:] = row
                set_real(component, channels, len(row), inputs)
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
