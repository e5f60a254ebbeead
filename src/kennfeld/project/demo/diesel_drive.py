"""A simulated drive: desired velocities on several roads, and a diesel car with a driver that follows them.

The car is a mass with rolling resistance, drag and slope (L. Guzzella, A. Sciarretta: Vehicle Propulsion Systems,
chapter 2). The driver closes the gap between actual and wanted speed in some seconds, as hard as his temper and the
engine allow, and changes gear by engine speed.

A passenger-car diesel: 2.0 l, four cylinders, turbocharged. What it burns, breathes, and how hot that makes it.

The equations are energy and mass balances of one stroke with textbook coefficients (J. B. Heywood, Internal Combustion
Engine Fundamentals, chapters 6, 12 and 13); all of them are smooth, none is piecewise linear.
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float

IDLE_SPEED, TOP_SPEED = 820.0, 5000.0  # rpm
HEATING_VALUE = 42.5  # J/mg
STROKES = 2.0  # combustions a turn
EFFICIENCY = 0.43  # indicated
TORQUE_PER_FUEL = STROKES * HEATING_VALUE * EFFICIENCY / (2 * np.pi)  # Nm per mg/stk
DISPLACED = 590.0  # mg of air that a cylinder displaces at ambient pressure
AMBIENT = 22.0  # degC
HEAT_CAPACITY = 1.09e-3  # J/(mg K), of the exhaust gas

STEP = 0.1  # s
RPM = 30 / float(np.pi)  # of one rad/s

MASS, ROTATING = 1560.0, 1.05  # kg, and the factor for what turns with the wheels
ROLLING, WIND, GRAVITY = 0.011, 0.5 * 1.2 * 0.66, 9.81  # share of the weight; N per (m/s)^2; m/s^2
WHEEL = 0.312  # m, rolling radius
RATIOS = (13.4, 7.4, 4.75, 3.5, 2.75, 2.28)  # gear and final drive
LEVERS = tuple(ratio / WHEEL for ratio in RATIOS)  # 1/m
INERTIA = MASS * ROTATING
CHAIN = 0.93  # efficiency of the drive train
SHIFT = 6  # steps with the clutch open
BRAKE = 3.2  # m/s^2

# Wanted speed in km/h from ... to, how long it is wanted in s, share of stops, duration in s of each part of the drive.
PARTS = (
    ((18.0, 58.0), (9.0, 32.0), 0.28, 420.0),  # urban
    ((55.0, 105.0), (14.0, 50.0), 0.05, 480.0),  # rural
    ((95.0, 165.0), (20.0, 70.0), 0.0, 420.0),  # motorway
)


def drag(speed: Float) -> Float:
    """Return the torque of friction, pumping and auxiliaries in Nm at `speed` in rpm."""
    result: Float = 16.0 + 4.5 * (speed / 1000) + 0.75 * (speed / 1000) ** 2
    return result


def full_load(speed: Float) -> Float:
    """Return the maximum injection quantity in mg/stk at `speed` in rpm, limited by smoke."""
    result: Float = 53.0 * np.exp(-(((speed - 2400.0) / 2700.0) ** 2)) * (1 - 0.5 * np.exp(-(speed - 700.0) / 450.0))
    return result


def stroke_air(speed: Float, fuel: Float) -> Float:
    """Return the steady-state air mass in mg/stk: filling, boost, less recirculated gas."""
    filling = 0.9 - 0.14 * ((speed - 2300.0) / 2300.0) ** 2
    boost = 1 + 1.25 * np.tanh(fuel / 38.0) / (1 + np.exp(-(speed - 1700.0) / 420.0))
    recirculated = 0.36 / (1 + np.exp((fuel - 19.0) / 4.0)) / (1 + np.exp((speed - 2700.0) / 350.0))
    result: Float = DISPLACED * filling * boost * (1 - recirculated)
    return result


def air_flow(speed: Float, air: Float) -> Float:
    """Return the air mass flow in kg/h of `air` in mg/stk at `speed` in rpm."""
    result: Float = air * STROKES * speed * 60e-6
    return result


def turbo_lag(speed: Float) -> Float:
    """Return the time constant in s of turbine and recirculation."""
    result: Float = 0.25 + 1.1 * np.exp(-(speed - 800.0) / 900.0)
    return result


def settled_temperature(speed: Float, fuel: Float) -> Float:
    """Return the steady-state exhaust gas temperature in degC at `speed` in rpm and `fuel` in mg/stk.

    Of the fuel's heat one part leaves with the gas; the port and the pipe take a share of it that falls with the flow.
    """
    air = stroke_air(speed, fuel)
    part = 0.33 + 0.05 * np.tanh((speed - 1800.0) / 1500.0) + 0.035 * fuel / 50.0
    rise = part * fuel * HEATING_VALUE / (HEAT_CAPACITY * (air + fuel))
    warmed = 62.0 + 40.0 * fuel / 50.0  # K above ambient, by compression and warm walls
    kept = 1 - 0.30 * np.exp(-air_flow(speed, air) / 130.0)
    result: Float = AMBIENT + kept * (rise + warmed)
    return result


def lag(flow: Float) -> Float:
    """Return the time constant in s of pipe and sensor; heat transfer grows with `flow`^0.8, in kg/h."""
    result: Float = 1.2 + 20.0 * (flow / 50.0) ** -0.8
    return result


def drive(samples: int, seed: int) -> tuple[Float, Float, Float]:
    """Simulate a drive; return time in s, engine speed in rpm and injection quantity in mg/stk, each Float[samples].

    It goes through town, country and along a motorway, in turns.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(float(samples)) * STEP
    wanted, temper = _wishes(rng, samples)
    aids = 3.5 + _waves(rng, time, ((25.0, 1.2), (140.0, 2.0)))  # Nm, alternator and air conditioning
    slope = _waves(rng, time, ((45.0, 0.012), (110.0, 0.022), (310.0, 0.02), (700.0, 0.012)))
    asked = (
        *(wanted, 0.15 + 0.45 * temper),
        *(-BRAKE * (0.3 + 0.7 * temper), 0.7 + 3.0 * temper),
        *(MASS * GRAVITY * (ROLLING + slope), aids),
        *(1550.0 + 2500.0 * temper, 1500.0 + 1300.0 * temper),
    )
    step = _Car().step
    states = [step(*now) for now in zip(*(column.tolist() for column in asked), strict=True)]
    speed, fuel = np.array(states).T
    return time, speed, fuel


def _wishes(rng: np.random.Generator, samples: int) -> tuple[Float, Float]:
    """Return the desired velocity in m/s, and the effort of the driver from 0 (gentle) to 1 (full load)."""
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
    """Return a sum of slow waves of about these periods in s and amplitudes, such as the slope of the road."""
    total = np.zeros(time.size)
    for period, height in waves:
        total += height * np.sin(2 * np.pi * time / (period * rng.uniform(0.8, 1.25)) + rng.uniform(0, 2 * np.pi))
    return total


class _Car:
    """The running state of a drive. A step runs on plain floats; engine characteristics are looked up every rpm."""

    def __init__(self) -> None:
        rpm = np.arange(TOP_SPEED)
        self.drag: list[float] = drag(rpm).tolist()
        self.full_load: list[float] = full_load(rpm).tolist()
        self.speed, self.velocity, self.acceleration = IDLE_SPEED, 0.0, 0.0
        self.gear, self.shifting = 0, 0

    def step(
        self,
        wish: float,
        eagerness: float,
        hardest: float,
        strongest: float,
        weight: float,
        aids: float,
        too_fast: float,
        too_slow: float,
    ) -> tuple[float, float]:
        """Return engine speed in rpm and injection quantity in mg/stk after the next `STEP`.

        The driver wants the velocity `wish` in m/s and closes a share `eagerness` of the gap in a second, within the
        accelerations `hardest` and `strongest` in m/s^2; he shifts up above `too_fast` rpm, and at full load down below
        `too_slow`. `weight` in N resists at any velocity, `aids` in Nm load the engine.
        """
        velocity, gear, speed = self.velocity, self.gear, int(self.speed)
        gap = eagerness * (wish - velocity)
        asked = strongest if gap > strongest else hardest if gap < hardest else gap
        self.acceleration += 0.2 * (asked - self.acceleration)  # the foot takes half a second
        turning = RPM * LEVERS[gear] * velocity
        resistance = weight + WIND * velocity * velocity
        losses, most = self.drag[speed] + aids, self.full_load[speed]
        if self.shifting or (wish == 0.0 and turning < IDLE_SPEED):
            return self._open(turning, losses, most, resistance)
        lever = LEVERS[gear]
        # the drive train loses power in either direction: 1 / CHAIN when the engine drives, CHAIN when it brakes
        force = INERTIA * self.acceleration + resistance
        fuel = (force / lever * (1 / CHAIN if force > 0.0 else CHAIN) + losses) / TORQUE_PER_FUEL
        missing = (fuel - most) * TORQUE_PER_FUEL * lever * CHAIN if fuel > most else 0.0
        if turning > too_fast and gear < len(LEVERS) - 1:
            self.gear, self.shifting = gear + 1, SHIFT
        elif gear and (turning < 1150.0 or (missing and turning < too_slow)):
            self.gear, self.shifting = gear - 1, SHIFT
        # a driver who sets off lets the clutch slip; brakes do what the drag of the engine does not
        slipping = IDLE_SPEED + 450.0 * min(self.acceleration, 1.5)
        target = turning if turning > slipping else slipping
        return self._move(self.acceleration - missing / INERTIA, max(target, IDLE_SPEED), fuel, most)

    def _open(self, turning: float, losses: float, most: float, resistance: float) -> tuple[float, float]:
        """Return speed and fuel with the clutch open: the governor holds idle speed or matches the next gear."""
        target = max(IDLE_SPEED, turning) if self.shifting else IDLE_SPEED
        self.shifting = max(self.shifting - 1, 0)
        fuel = losses / TORQUE_PER_FUEL * (1.0 + 0.004 * (target - self.speed))
        # a car at rest does not roll backwards
        rolling = resistance / INERTIA if self.velocity > 0.0 else 0.0
        return self._move(min(self.acceleration, 0.0) - rolling, target, fuel, most)

    def _move(self, acceleration: float, target: float, fuel: float, most: float) -> tuple[float, float]:
        velocity = self.velocity + STEP * acceleration
        self.velocity = velocity if velocity > 0.0 else 0.0
        speed = self.speed + 0.5 * (target - self.speed)
        self.speed = speed = speed if speed < TOP_SPEED - 1.0 else TOP_SPEED - 1.0
        return speed, most if fuel > most else fuel if fuel > 0.0 else 0.0
