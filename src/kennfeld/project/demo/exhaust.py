"""The exhaust gas temperature problem of the paper, on drives of a simulated car with known noise."""

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.domain.axis import Axis
from kennfeld.domain.dataset import Channel, Dataset, Use
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map
from kennfeld.project.demo import diesel_drive
from kennfeld.project.demo.diesel_drive import STEP, drive

NOISE, UNIT = 3.7, "degC"  # standard deviation of the thermometer
SAMPLES, FEWER = 26_482, 12_000
SPEED, INJECTION = (800.0, 4000.0), (0.0, 55.0)
AIR_MASS = (30.0, 40.0, 55.0, 75.0, 100.0, 135.0, 180.0, 240.0, 330.0, 450.0)

# The structure of Gutjahr, Kleinegraeber, Kruse: Automated Optimization of Physics-Based Sensor Models.
FORMULA = """\
# Exhaust gas temperature: what it would settle at, and how fast it gets there.
input Speed[rpm]
input Injection[mg/stk]
input AirMass[kg/h]

settled[degC] = MapSettled(Speed, Injection)
TemperaturePredict[degC] = PT1(settled, CurveTimeConstant(AirMass))
"""

SMOOTHNESS = {"MapSettled": 1.0, "CurveTimeConstant": 1.0}
BOUNDS = {"MapSettled": (0.0, 1200.0), "CurveTimeConstant": (0.1, 100.0)}


def training(seed: int = 0) -> Dataset:
    """Return a drive of 44 minutes at 10 Hz: urban, rural and motorway."""
    return _record("drive", SAMPLES, seed, "training")


def another(seed: int = 1) -> Dataset:
    """Return another drive of 20 minutes, for tests."""
    return _record("another", FEWER, seed, "test")


def _record(name: str, samples: int, seed: int, use: Use) -> Dataset:
    """Return a drive as recorded: channels with the resolution of the bus, temperature with noise."""
    time, speed, fuel = drive(samples, seed)
    settled = diesel_drive.stroke_air(speed, fuel)
    air = _lag(settled, diesel_drive.turbo_lag(speed))
    flow = diesel_drive.air_flow(speed, air)
    temperature = _lag(diesel_drive.settled_temperature(speed, fuel), diesel_drive.lag(flow))
    # far from the seed of the drive, so that both are independent
    noise = np.random.default_rng(seed + 1_000_000).normal(0.0, NOISE, samples)
    channels = (
        Channel("Speed", speed.round(1), "rpm"),
        Channel("Injection", fuel.round(2), "mg/stk"),
        Channel("AirMass", flow.round(1), "kg/h"),
        Channel("Temperature", (temperature + noise).round(1), "degC"),
    )
    return Dataset(name, channels, time=time.round(1), use=use)


def _lag(values: Float, constant: Float) -> Float:
    """Return a first-order lag with a variable time constant in s, from rest; exact for inputs held over a step."""
    # x_k = x_{k-1} + (1 - exp(-step / T_k)) (u_k - x_{k-1})
    share = -np.expm1(-STEP / constant)
    y = float(values[0])
    lagged = [y := y + part * (x - y) for x, part in zip(values.tolist(), share.tolist(), strict=True)]
    return np.array(lagged)


def start() -> ParameterSet:
    """Return an uninformed calibration: constant temperature and time constant."""
    speed = Axis(np.linspace(*SPEED, 12), input="Speed", unit="rpm")
    injection = Axis(np.linspace(*INJECTION, 12), input="Injection", unit="mg/stk")
    air = Axis(np.array(AIR_MASS), input="AirMass", unit="kg/h")
    return ParameterSet(
        [
            Map(
                "MapSettled",
                speed,
                injection,
                np.full((12, 12), 230.0),
                unit="degC",
                description="Temperature at rest",
            ),
            Curve("CurveTimeConstant", air, np.full(10, 5.0), unit="s", description="Time constant"),
        ]
    )


FILES = {
    "exhaust.kf": lambda: FORMULA,
    "drive.csv": training,
    "another_drive.csv": another,
    "start.dcm": start,
}
