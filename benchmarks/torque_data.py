"""Steady points of the torque engine in any number, with maps of any size."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kennfeld.domain.axis import Axis
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map
from kennfeld.project.demo import torque
from kennfeld.project.demo.petrol_engine import torque as engine_torque

__all__ = ["COLUMNS", "load_points", "parameters", "write_points"]

Float = NDArray[np.float64]
COLUMNS = ("Speed", "Rel_Airmass", "Ignition", "Torque")
SPANS = ((700.0, 6000.0), (25.0, 100.0), (10.0, 40.0))
SIZES = {  # grid of the optimal torque, the optimal ignition, the efficiency, the drag torque
    100: ((7, 6), (5, 4), 8, (6, 5)),
    520: ((18, 14), (10, 8), 12, (16, 11)),
    1000: ((25, 19), (14, 11), 16, (22, 16)),
    2000: ((35, 27), (20, 15), 24, (32, 23)),
}


def write_points(file: Path, count: int, seed: int = 0) -> None:
    """Random points with noise, an array of shape (columns, points)."""
    random = np.random.default_rng(seed)
    data = np.empty((len(COLUMNS), count))
    for row, span in zip(data, SPANS, strict=False):
        row[:] = random.uniform(*span, count)
    data[-1] = engine_torque(*data[:-1]) + random.normal(0.0, torque.NOISE, count)
    np.save(file, data)


def load_points(file: str) -> Dataset:
    """The points as a dataset."""
    data: Float = np.load(file)
    data.setflags(write=False)  # or the dataset would make a copy that nobody can write to
    return Dataset.of("points", dict(zip(COLUMNS, data, strict=True)))


def parameters(values: int) -> ParameterSet:
    """About `values` values, close to what fits, so that the arithmetic is that of a calibration under way."""
    best, spark, eta, drag = SIZES[values]
    delta = Axis(np.linspace(-15.0, 40.0, eta), input="deltaSpark")
    return ParameterSet(
        [
            _map("MapOptTorque", best, lambda speed, air: 2.2 * air - 1e-6 * (speed - 3000) ** 2),
            _map("MapOptIgnition", spark, lambda speed, air: 22 + speed / 1000 - 0.05 * air),
            Curve("CurveEtaDeltaSpark", delta, 1.0 - 0.0003 * delta.breakpoints**2),
            _map("MapDragTorque", drag, lambda speed, air: 20 + speed / 500 + 0.01 * air),
        ]
    )


def _map(name: str, shape: tuple[int, int], surface: Callable[[Float, Float], Float]) -> Map:
    x, y = (Axis(np.linspace(*span, count)) for span, count in zip(SPANS, shape, strict=False))
    return Map(name, x, y, surface(x.breakpoints[:, None], y.breakpoints[None, :]))
