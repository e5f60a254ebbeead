"""The engine torque problem of the paper, on data from a published engine with known noise.

Points under load cannot distinguish drag from inner torque. The demo therefore includes a few motored points;
`load-only.toml` is the problem of the paper, without them.
"""

from pathlib import Path

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.domain.axis import Axis
from kennfeld.domain.dataset import Channel, Dataset, Use
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map
from kennfeld.project.demo.petrol_engine import drag, torque

NOISE, UNIT = 1.8, "Nm"  # standard deviation of the torque measurement
SPEED, AIR, IGNITION = (700.0, 6100.0), (28.0, 100.0), (10.0, 40.0)
LEVELS = (37, 19, 4)  # full factorial: 2812 points
MOTORED = (9, 3)  # speeds and relative air masses at which the engine is motored: 27 points
CUT = 20.0  # ignition in degrees that the control unit reports meanwhile
SCATTER = (2.5, 0.15, 0.5)  # standard deviation of what the bench holds around its set points

# Figure 3 of Gutjahr, Kleinegraeber, Kruse: Automated Optimization of Physics-Based Sensor Models.
FORMULA = """\
1 trqOpt[-] = MapOptTorque(Speed,Rel_Airmass)
2 ignOpt[-] = MapOptIgnition(Speed,Rel_Airmass)
3 deltaSpark[-] = ignOpt - Ignition
4 etaSpark[-] = CurveEtaDeltaSpark(deltaSpark)
5 product[-] = trqOpt * etaSpark
6 dragTorque[-] = MapDragTorque(Speed,Rel_Airmass)
7 TorquePredict[-] = product - dragTorque
"""

SMOOTHNESS = {"MapOptTorque": 100.0, "MapOptIgnition": 10.0, "CurveEtaDeltaSpark": 1e4, "MapDragTorque": 100.0}
BOUNDS = {"MapOptTorque": (0.0, 600.0), "MapOptIgnition": (0.0, 60.0), "CurveEtaDeltaSpark": (0.0, 1.0)}
PIN = ("CurveEtaDeltaSpark", (0.0,), 1.0)  # at the best ignition nothing is lost


def bench(seed: int = 0) -> Dataset:
    """Return 2812 points of a test bench: full factorial over speed, relative air mass and ignition, as recorded.

    A bench meets its set points nearly, not exactly. That matters: with four exact levels of ignition a constant map
    of the best ignition would turn the efficiency curve into a list of four unrelated numbers, which fits and is wrong.
    """
    # far from the seeds of the noise, so that both are independent
    rng = np.random.default_rng(seed + 2_000_000)
    levels = [np.linspace(*span, count) for span, count in zip((SPEED, AIR, IGNITION), LEVELS, strict=True)]
    grid = np.meshgrid(*levels, indexing="ij")
    points = [
        (axis.ravel() + rng.normal(0.0, scatter, axis.size)).round(1)
        for axis, scatter in zip(grid, SCATTER, strict=True)
    ]
    return _measure("bench", *points, seed=seed, use="training")


def fresh(count: int = 1000, seed: int = 1) -> Dataset:
    """Return points with uniform distribution in the same range, for tests."""
    rng = np.random.default_rng(seed + 1_000_000)
    points = [rng.uniform(*span, count).round(1) for span in (SPEED, AIR, IGNITION)]
    return _measure("fresh", *points, seed=seed, use="test")


def motored(seed: int = 0) -> Dataset:
    """Return 27 points with the fuel cut: the bench turns the engine and measures the required torque."""
    rng = np.random.default_rng(seed + 3_000_000)
    levels = [np.linspace(*span, count) for span, count in zip((SPEED, AIR), MOTORED, strict=True)]
    speed, air = (
        (axis.ravel() + rng.normal(0.0, scatter, axis.size)).round(1)
        for axis, scatter in zip(np.meshgrid(*levels, indexing="ij"), SCATTER, strict=False)
    )
    channels = (
        Channel("Speed", speed, "rpm"),
        Channel("Rel_Airmass", air, "%"),
        Channel("Ignition", np.full(speed.size, CUT), "deg"),
        Channel("MotoringTorque", (drag(speed) + rng.normal(0.0, NOISE, speed.size)).round(2), "Nm"),
    )
    return Dataset("motored", channels)


def _measure(name: str, speed: Float, air: Float, ignition: Float, *, seed: int, use: Use) -> Dataset:
    noise = np.random.default_rng(seed).normal(0.0, NOISE, speed.size)
    channels = (
        Channel("Speed", speed, "rpm"),
        Channel("Rel_Airmass", air, "%"),
        Channel("Ignition", ignition, "deg"),
        Channel("Torque", (torque(speed, air, ignition) + noise).round(2), "Nm"),
    )
    return Dataset(name, channels, use=use)


def start() -> ParameterSet:
    """Return the initial calibration of the paper: constant maps, and an almost constant efficiency."""
    eta = Axis(np.linspace(-15.0, 40.0, 12), input="deltaSpark", unit="deg")
    return ParameterSet(
        [
            _constant("MapOptTorque", (19, 13), 82.5, "Nm", "Inner torque at the best ignition"),
            _constant("MapOptIgnition", (10, 9), 20.0, "deg", "Best ignition"),
            Curve(
                "CurveEtaDeltaSpark",
                eta,
                1.0 - 0.0002 * eta.breakpoints**2,
                unit="-",
                description="Efficiency over the distance from the best ignition",
                lower=0.0,
                upper=1.0,
            ),
            _constant("MapDragTorque", (17, 10), 20.0, "Nm", "Drag torque"),
        ]
    )


def _constant(name: str, shape: tuple[int, int], value: float, unit: str, description: str) -> Map:
    x = Axis(np.linspace(*SPEED, shape[0]), input="Speed", unit="rpm")
    y = Axis(np.linspace(*AIR, shape[1]), input="Rel_Airmass", unit="%")
    return Map(name, x, y, np.full(shape, value), unit=unit, description=description)


def load_only() -> str:
    """Return the project file without the motored points."""
    return Path(__file__).with_name("torque_load_only.toml").read_text(encoding="utf-8")


FILES = {
    "load-only.toml": load_only,
    "torque.kf": lambda: FORMULA,
    "bench.csv": bench,
    "motored.csv": motored,
    "fresh.csv": fresh,
    "start.dcm": start,
}
