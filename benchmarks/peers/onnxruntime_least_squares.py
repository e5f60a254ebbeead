"""ONNX Runtime, its finite differences, and `scipy.optimize.least_squares` over it."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import repeated, threads
from benchmarks.onnx_problem import AFTER, LOAD, SPEED, START, data_of

__all__ = ["evaluate", "solve"]

Float = NDArray[np.float64]
STEP = 1e-6


def _network(path: str) -> Callable[[Float], Float]:
    """Return the network as a function of rows: Float[samples, 2] -> Float[samples]."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads(None)
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    return lambda x: session.run(None, {"x": x})[0][:, 0]


def evaluate(path: str, samples: int) -> dict[str, Any]:
    """Durations of the outputs, and of the outputs with central differences along both inputs."""
    network, data = _network(path), data_of(samples)
    x = np.column_stack([0.5 * np.sin(data["n"] / 1000), data["T"]])
    steps = STEP * np.eye(2)

    def with_slopes() -> list[Float]:
        return [network(x), *((network(x + step) - network(x - step)) / (2 * STEP) for step in steps)]

    pairs = ("outputs", lambda: network(x)), ("slopes", with_slopes)
    return {name: repeated(work, lasting=2.0)["best"] for name, work in pairs}


def solve(path: str, samples: int, fitted: int, measured: str, chain: bool) -> dict[str, Any]:
    """Calibrate map and curve.

    Args:
        path: the network.
        samples: number of samples.
        fitted: number of those that count, from the first one on.
        measured: file with the values to be reproduced.
        chain: True for a Jacobian by the chain rule, with a central difference along the input of the network only;
            False for the differences of scipy.
    """
    from scipy.optimize import least_squares

    network, target = _network(path), np.load(measured)[:fitted]
    data = {name: column[:fitted] for name, column in data_of(samples).items()}
    map_weights = _map_weights(data["n"], data["load"])
    points, size = np.arange(fitted)[:, None], SPEED.size * LOAD.size

    def raw(values: Float, shift: float = 0.0) -> Float:
        before = (values[:size][map_weights[0]] * map_weights[1]).sum(axis=1)
        return network(np.column_stack([before + shift, data["T"]]))

    def residuals(values: Float) -> Float:
        places, weights, _ = _curve_weights(raw(values))
        return (values[size:][places] * weights).sum(axis=1) - target

    def jacobian(values: Float) -> Float:
        places, weights, spacing = _curve_weights(raw(values))
        slope = (raw(values, STEP) - raw(values, -STEP)) / (2 * STEP)
        along = np.diff(values[size:][places], axis=1)[:, 0] / spacing * slope
        rows = np.zeros((fitted, values.size))
        rows[points, map_weights[0]] = along[:, None] * map_weights[1]
        rows[points, size + places] = weights
        return rows

    begin = np.concatenate([START[name].ravel() for name in ("Before", "After")])
    began = time.perf_counter()
    result = least_squares(residuals, begin, jacobian if chain else "2-point", x_scale="jac")
    return {
        "seconds": time.perf_counter() - began,
        "cost": 2 * result.cost,
        "evaluations": result.nfev,
        "start": float(np.sum(residuals(begin) ** 2)),
    }


def _cell(x: Float, axis: Float) -> tuple[NDArray[np.int64], Float]:
    """Return cell and position within it, clipped at the ends."""
    cell = np.clip(np.searchsorted(axis, x, "right") - 1, 0, axis.size - 2)
    return cell, np.clip((x - axis[cell]) / (axis[cell + 1] - axis[cell]), 0.0, 1.0)


def _map_weights(n: Float, load: Float) -> tuple[NDArray[np.int64], Float]:
    """Return the numbers of the four values around each sample, and their weights; shape (samples, 4)."""
    (i, s), (j, t) = _cell(n, SPEED), _cell(load, LOAD)
    corner = i * LOAD.size + j
    places = corner[:, None] + [0, 1, LOAD.size, LOAD.size + 1]
    return places, np.stack([(1 - s) * (1 - t), (1 - s) * t, s * (1 - t), s * t], axis=1)


def _curve_weights(x: Float) -> tuple[NDArray[np.int64], Float, Float]:
    """Return the numbers of both values around each sample, their weights, and the spacing; infinite outside."""
    cell, s = _cell(x, AFTER)
    inside = (x >= AFTER[0]) & (x <= AFTER[-1])
    spacing = np.where(inside, AFTER[cell + 1] - AFTER[cell], np.inf)
    return cell[:, None] + [0, 1], np.stack([1 - s, s], axis=1), spacing
