"""Functions that keep memory of a trajectory, and the same in formula text."""

import ctypes
import threading

from kennfeld.graph.external_function import ExternalFunction
from kennfeld.models.model_function import FunctionInput, FunctionOutput, ModelFunction
from tests.native.external_functions import POINTERS, Callback

TEXT = """\
before = prev(lagged, 0)
lagged = if(t > 0, before + dt / T * (k * prev(driven) - before), 0)
twice = 2 * lagged + driven
"""  # the same, of `driven`


class _Memory(threading.local):
    time = float("inf")
    y = u = 0.0


_memory = _Memory()


class Trajectory(Callback):
    """A callback that keeps memory in each thread."""

    trajectories = 64


def lag(*_: object) -> Trajectory:
    """Arguments time, u, k and T; y follows k u with the time constant T, and 2 y + u. Each thread has its memory."""

    @ctypes.CFUNCTYPE(None, *POINTERS)
    def call(x, y, slopes):
        time, u, k, constant = x[0], x[1], x[2], x[3]
        if time < _memory.time:
            _memory.y = 0.0
        elif time > _memory.time:
            _memory.y += (time - _memory.time) / constant * (k * _memory.u - _memory.y)
        _memory.time, _memory.u = time, u
        y[0], y[1] = _memory.y, 2 * _memory.y + u
        if slopes:
            for number in range(8):
                slopes[number] = float("nan")

    return Trajectory(call)


LAG = ExternalFunction("lag", 4, 2, "tests.optimize.trajectory_functions:lag", sequential=True)


def _write(builder, arguments):
    [u] = arguments
    return builder.external(LAG, builder.input("t"), u, builder.lookup("k"), builder.lookup("T"))


def lag_function() -> ModelFunction:
    """Return the lag as a function of u, with the parameters k and T."""
    return ModelFunction("lag", (FunctionInput("u"),), (FunctionOutput("y"), FunctionOutput("twice")), _write)


def reset_lag(*_: object) -> Trajectory:
    """Arguments time, u, k, T and limit; the lag, which starts again from 1 at the first sample above the limit."""

    @ctypes.CFUNCTYPE(None, *POINTERS)
    def call(x, y, slopes):
        time, u, k, constant, limit = (x[i] for i in range(5))
        if time < _memory.time:
            _memory.y = 0.0
        elif time > _memory.time:
            rate = 1 / constant if constant else float("inf")  # as in C
            _memory.y += (time - _memory.time) * rate * (k * _memory.u - _memory.y)
            _memory.y = 1.0 if _memory.y > limit else _memory.y
        _memory.time, _memory.u = time, u
        y[0] = _memory.y
        if slopes:
            for number in range(5):
                slopes[number] = float("nan")

    return Trajectory(call)


RESET = ExternalFunction("reset", 5, 1, "tests.optimize.trajectory_functions:reset_lag", sequential=True)


def _write_reset(builder, arguments):
    [u] = arguments
    return builder.external(RESET, builder.input("t"), u, *(builder.lookup(name) for name in ("k", "T", "limit")))


def reset_function() -> ModelFunction:
    """Return the lag with a limit as a function of u."""
    return ModelFunction("reset", (FunctionInput("u"),), (FunctionOutput("y"),), _write_reset)
