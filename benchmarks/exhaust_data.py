"""A drive with an exhaust thermometer: a map of speed and fuel, behind lags whose time constants depend on air mass."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kennfeld.domain.axis import Axis
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map

__all__ = [
    *("AIR", "COLUMNS", "FORMULAS", "FUEL", "NOISE", "SPEED"),
    *("drive", "filtered", "lag_of", "load_drive", "parameters", "surface", "write_drive"),
]

Float = NDArray[np.float64]
COLUMNS = ("time", "Speed", "Fuel", "Air", "Temperature")
NOISE = 3.0  # degC
SPEED, FUEL, AIR = (700.0, 4500.0), (2.0, 60.0), (20.0, 900.0)
FORMULAS = {
    1: "T[degC] = PT1(MapTemperature(Speed, Fuel), Lag1(Air))\n",
    3: "gas[degC] = PT1(MapTemperature(Speed, Fuel), Lag1(Air))\n"
    "wall[degC] = PT1(gas, Lag2(Air))\n"
    "T[degC] = PT1(wall, Lag3(Air))\n",
}


def write_drive(file: Path, samples: int, step: float, states: int = 1, seed: int = 0) -> None:
    """A drive of `samples` steps of `step` s, an array of shape (columns, samples)."""
    random = np.random.default_rng(seed)
    data = np.empty((len(COLUMNS), samples))
    time, speed, fuel, air, temperature = data
    time[:] = np.arange(samples) * step
    speed[:] = drive(random, time, SPEED)
    fuel[:] = drive(random, time, FUEL)
    air[:] = AIR[0] + (AIR[1] - AIR[0]) * (speed / SPEED[1]) * (0.35 + 0.65 * fuel / FUEL[1])
    temperature[:] = surface(speed, fuel)
    for lag in range(states):
        temperature[:] = filtered(temperature, lag_of(air, lag), step)
    temperature += random.normal(0.0, NOISE, samples)
    np.save(file, data)


def surface(speed: Float, fuel: Float) -> Float:
    """Exhaust temperature at rest in degC."""
    result: Float = 120 + 0.03 * speed + 9.5 * fuel - 0.04 * fuel**2 + 40 * np.sin(speed / 900) * fuel / 60
    return result


def lag_of(air: Float, number: int) -> Float:
    """Time constant in s, the first the longest."""
    result: Float = (2.0 + 1800.0 / (air + 60.0)) / (1 + 3 * number)
    return result


def drive(random: np.random.Generator, time: Float, span: tuple[float, float]) -> Float:
    """Levels held for some seconds, joined smoothly, with a ripple."""
    length = time[-1] - time[0]
    ends = np.cumsum(random.uniform(1.0, 12.0, int(length / 6.5) + 200))
    levels = random.beta(0.8, 0.8, ends.size)
    after = np.minimum(np.searchsorted(ends, time, side="right") + 1, ends.size - 1)
    share = np.clip((time - ends[after - 1]) / 1.5, 0.0, 1.0)
    share *= share * (3 - 2 * share)
    rough = levels[after - 1] + (levels[after] - levels[after - 1]) * share
    rough += 0.02 * np.sin(time * random.uniform(0.3, 0.5)) + 0.02 * np.sin(time * random.uniform(1.0, 2.0))
    result: Float = span[0] + (span[1] - span[0]) * np.clip(rough, 0.0, 1.0)
    return result


def filtered(values: Float, constant: Float, step: float) -> Float:
    """A PT1: y += dt/(T + dt) (x - y), beginning with the first x."""
    share = (step / (constant + step)).tolist()
    y = float(values[0])
    out = []
    for x, a in zip(values.tolist(), share, strict=True):
        y += a * (x - y)
        out.append(y)
    return np.array(out)


def load_drive(file: str, count: int = 0) -> Dataset:
    """The drive as a dataset, cut to `count` samples where that is not 0."""
    data = np.load(file)
    data = data[:, :count].copy() if count else data
    data.setflags(write=False)  # or the dataset would make a copy that nobody can write to
    channels = tuple(Channel(name, row) for name, row in zip(COLUMNS[1:], data[1:], strict=True))
    return Dataset("drive", channels, time=data[0])


def parameters(grid: tuple[int, int], lags: int, points: int) -> ParameterSet:
    """A start far off: one temperature everywhere, and equal time constants."""
    x, y = (Axis(np.linspace(*span, count)) for span, count in zip((SPEED, FUEL), grid, strict=True))
    air = Axis(np.linspace(*AIR, points))
    curves = [
        Curve(f"Lag{i + 1}", air, np.full(points, 10.0 / (1 + 3 * i)), unit="s", lower=0.05, upper=60.0)
        for i in range(lags)
    ]
    return ParameterSet([Map("MapTemperature", x, y, np.full(grid, 350.0), unit="degC"), *curves])
