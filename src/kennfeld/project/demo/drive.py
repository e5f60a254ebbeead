"""A drive: what the road and the traffic ask for, and a car with a driver that follows.

The car is a mass with rolling resistance, drag and slope (L. Guzzella, A. Sciarretta: Vehicle Propulsion Systems,
chapter 2). The driver closes the gap between actual and wanted speed in some seconds, as hard as his temper and the
engine allow, and changes gear by engine speed.
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.arrays import Float
from kennfeld.project.demo.diesel import IDLE_SPEED, TOP_SPEED, TORQUE_PER_FUEL, drag, full_load

__all__ = ["STEP", "drive"]

STEP = 0.1  # s
RPM = 30 / float(np.pi)  # of one rad/s

MASS, ROTATING = 1560.0, 1.05  # kg, and the factor for what turns with the wheels
ROLLING, WIND, GRAVITY = 0.011, 0.5 * 1.2 * 0.66, 9.81  # share of the weight; N per (m/s)^2; m/s^2
WHEEL = 0.312  # m, rolling radius
RATIOS = (13.4, 7.4, 4.75, 3.5, 2.75, 2.28)  # gear and final drive
CHAIN = 0.93  # efficiency of the drive train
SHIFT = 6  # steps with the clutch open
BRAKE = 3.2  # m/s^2

# Wanted speed in km/h from ... to, how long it is wanted in s, share of stops, duration in s of each part of the drive.
PARTS = (
    ((18.0, 58.0), (9.0, 32.0), 0.28, 420.0),  # urban
    ((55.0, 105.0), (14.0, 50.0), 0.05, 480.0),  # rural
    ((95.0, 165.0), (20.0, 70.0), 0.0, 420.0),  # motorway
)


def drive(samples: int, seed: int) -> tuple[Float, Float, Float]:
    """Time in s, engine speed in rpm and injection quantity in mg/stk of a drive of so many samples.

    It goes through town, country and along a motorway, in turns.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(float(samples)) * STEP
    wanted, temper = _wishes(rng, samples)
    aids = 3.5 + _waves(rng, time, ((25.0, 1.2), (140.0, 2.0)))  # Nm, alternator and air conditioning
    slope = _waves(rng, time, ((45.0, 0.012), (110.0, 0.022), (310.0, 0.02), (700.0, 0.012)))
    car = _Car()
    asked = (column.tolist() for column in (wanted, temper, slope, aids))
    speed, fuel = np.array([car.step(*now) for now in zip(*asked, strict=True)]).T
    return time, speed, fuel


def _wishes(rng: np.random.Generator, samples: int) -> tuple[Float, Float]:
    """The wanted velocity in m/s, and how hard the driver goes for it: 0 is gentle, 1 is all the engine gives."""
    wanted, temper = np.zeros(samples), np.zeros(samples)
    at, part, left = int(12 / STEP), 0, PARTS[0][3]
    while at < samples:
        speeds, lengths, stops, _ = PARTS[part]
        stop = rng.random() < stops
        length = rng.uniform(6.0, 22.0) if stop else rng.uniform(*lengths)
        held = slice(at, at + int(length / STEP))
        wanted[held] = 0.0 if stop else rng.uniform(*speeds) / 3.6
        temper[held] = rng.beta(1.1, 1.5)
        at, left = held.stop, left - length
        if left < 0:
            part = (part + 1) % len(PARTS)
            left = PARTS[part][3]
    return wanted, temper


def _waves(rng: np.random.Generator, time: Float, waves: Sequence[tuple[float, float]]) -> Float:
    """A sum of slow waves of about these periods in s and heights: the road's slope, say."""
    found = np.zeros(time.size)
    for period, height in waves:
        found += height * np.sin(2 * np.pi * time / (period * rng.uniform(0.8, 1.25)) + rng.uniform(0, 2 * np.pi))
    return found


class _Car:
    """The running state of a drive. A step runs on plain floats; engine characteristics are looked up every rpm."""

    def __init__(self) -> None:
        rpm = np.arange(TOP_SPEED)
        self.drag: list[float] = drag(rpm).tolist()
        self.full_load: list[float] = full_load(rpm).tolist()
        self.speed, self.velocity, self.acceleration = IDLE_SPEED, 0.0, 0.0
        self.gear, self.shifting = 0, 0

    def step(self, wish: float, temper: float, slope: float, aids: float) -> tuple[float, float]:
        """Engine speed in rpm and injection quantity in mg/stk after the next `STEP`."""
        gap = (0.15 + 0.45 * temper) * (wish - self.velocity)
        asked = min(max(gap, -BRAKE * (0.3 + 0.7 * temper)), 0.7 + 3.0 * temper)
        self.acceleration += 0.2 * (asked - self.acceleration)  # the foot takes half a second
        turning = RPM * RATIOS[self.gear] / WHEEL * self.velocity
        resistance = MASS * GRAVITY * (ROLLING + slope) + WIND * self.velocity**2
        losses = self.drag[int(self.speed)] + aids
        if self.shifting or (wish == 0.0 and turning < IDLE_SPEED):
            return self._open(turning, losses, resistance)
        return self._closed(turning, losses, resistance, temper)

    def _open(self, turning: float, losses: float, resistance: float) -> tuple[float, float]:
        """The clutch is open: the governor holds the idle speed, or meets the speed of the next gear."""
        target = max(IDLE_SPEED, turning) if self.shifting else IDLE_SPEED
        self.shifting = max(self.shifting - 1, 0)
        fuel = losses / TORQUE_PER_FUEL * (1.0 + 0.004 * (target - self.speed))
        self._moved(min(self.acceleration, 0.0) - (0.0 if self.velocity == 0.0 else resistance / (MASS * ROTATING)))
        return self._turned(target, min(max(fuel, 0.0), self.full_load[int(self.speed)]))

    def _closed(self, turning: float, losses: float, resistance: float, temper: float) -> tuple[float, float]:
        """The engine drives, at most at full load; or it is driven, and the brakes do what its drag does not."""
        lever, most = RATIOS[self.gear] / WHEEL, self.full_load[int(self.speed)]
        force = MASS * ROTATING * self.acceleration + resistance
        torque = force / lever * (1 / CHAIN if force > 0.0 else CHAIN)
        fuel = (torque + losses) / TORQUE_PER_FUEL
        missing = max(fuel - most, 0.0) * TORQUE_PER_FUEL * lever * CHAIN
        self._moved(self.acceleration - missing / (MASS * ROTATING))
        if turning > 1550.0 + 2500.0 * temper and self.gear < len(RATIOS) - 1:
            self.gear, self.shifting = self.gear + 1, SHIFT
        elif self.gear and (turning < 1150.0 or (missing > 0.0 and turning < 1500.0 + 1300.0 * temper)):
            self.gear, self.shifting = self.gear - 1, SHIFT
        slipping = IDLE_SPEED + 450.0 * min(max(self.acceleration, 0.0), 1.5)
        return self._turned(max(turning, slipping), min(max(fuel, 0.0), most))

    def _moved(self, acceleration: float) -> None:
        self.velocity = max(self.velocity + STEP * acceleration, 0.0)

    def _turned(self, target: float, fuel: float) -> tuple[float, float]:
        self.speed = min(self.speed + 0.5 * (target - self.speed), TOP_SPEED - 1.0)
        return self.speed, fuel
