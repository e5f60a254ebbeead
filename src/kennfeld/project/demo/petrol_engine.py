"""A published petrol engine: its torque polynomial, and a simulation at idle from throttle and load to speed.

P. R. Crossley, J. A. Cook: A nonlinear engine model for drivetrain system development, IEE Conference Control 1991,
with the values of the Modelica Standard Library (Modelica.Clocked.Examples.Systems.EngineThrottleControl, BSD-3).
"""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from kennfeld.base.arrays import Float

Number = TypeVar("Number", float, Float)

FULL_CHARGE = 0.6  # g of air in a cylinder at 100 % relative air mass
AIR_FUEL_RATIO = 14.6

START_SPEED = 209.0  # rad/s
START_PRESSURE = 0.543  # bar
START_CHARGE = 0.152  # g
SPARK = 15.0  # degrees before top dead centre
INERTIA = 0.14  # kg m2
MANIFOLD = 0.41328  # bar/g
SLOWEST = 1.0  # rad/s; below, the engine has stalled
RPM = 30 / math.pi

Throttle = Callable[[int, float], float]  # its angle from the number of a sample and the speed there in rpm


def torque(speed: Float, air: Float, spark: Float) -> Float:
    """Return the torque in Nm at `speed` in rpm, relative air mass `air` in % and `spark` advance in degrees.

    P. R. Crossley, J. A. Cook: A nonlinear engine model for drivetrain system development, IEE Conference Control 1991.
    """
    return torque_of_charge(speed * (np.pi / 30), air * (FULL_CHARGE / 100), spark)


def torque_of_charge(n: Number, charge: Number, spark: Number) -> Number:
    """Return the torque in Nm at `n` in rad/s and a `charge` of air in g."""
    # T = -181.3 + 379.36 m + 21.91 AF - 0.85 AF^2 + 0.26 s - 0.0028 s^2 + 0.027 n - 0.000107 n^2 + 0.00048 n s
    #     + 2.55 s m - 0.05 s^2 m, with the charge m, the air-fuel ratio AF, the spark advance s and the speed n
    mixture = 21.91 * AIR_FUEL_RATIO - 0.85 * AIR_FUEL_RATIO**2
    timing = spark * (0.26 + 0.00048 * n + 2.55 * charge) - spark**2 * (0.0028 + 0.05 * charge)
    return -181.3 + 379.36 * charge + mixture + timing + 0.027 * n - 0.000107 * n**2


def best_spark(speed: Float, air: Float) -> Float:
    """Return the spark advance in degrees with maximum torque."""
    n, charge = speed * (np.pi / 30), air * (FULL_CHARGE / 100)
    # dT/ds = 0
    result: Float = (0.26 + 0.00048 * n + 2.55 * charge) / (2 * (0.0028 + 0.05 * charge))
    return result


def drag(speed: Float) -> Float:
    """Return the torque in Nm to turn the engine at `speed` in rpm without combustion."""
    result: Float = -torque_of_charge(speed * (np.pi / 30), np.zeros_like(speed), np.zeros_like(speed))
    return result


def efficiency(speed: Float, air: Float, distance: Float) -> Float:
    """Return the inner torque (torque plus drag) at a `distance` in degrees from the best spark, over its maximum."""
    best = best_spark(speed, air)
    inner = torque(speed, air, best - distance) + drag(speed)
    result: Float = inner / (torque(speed, air, best) + drag(speed))
    return result


def simulate_engine(throttle: Float | Throttle, load: Float, step: float, fine: float = 5e-4) -> Float:
    """Simulate the engine; return its speed in rpm, Float[samples].

    `throttle` in degrees, which a governor may find, and `load` in Nm, Float[samples], are held over a `step` in s. The
    manifold and the crank are integrated by Euler steps of about `fine` s; the charge drawn in over 180 degrees of
    crank acts 180 degrees later. An engine that stalls stays at 1 rad/s.
    """
    governor = throttle if callable(throttle) else _play_back(throttle)
    inner = max(round(step / fine), 1)
    dt = step / inner
    speed, pressure = START_SPEED, START_PRESSURE
    charge = collected = START_CHARGE
    drawn, angle = 0.0, 0.0
    speeds = np.empty(len(load))
    for k, brake in enumerate(load.tolist()):
        speeds[k] = speed * RPM
        angle_of_plate = governor(k, speeds[k])
        # flow through the throttle at critical pressure ratio in g/s, a polynomial in its angle in degrees
        opened = 2.821 - 0.05231 * angle_of_plate + 0.10299 * angle_of_plate**2 - 0.00063 * angle_of_plate**3
        for _ in range(inner):
            out = _pumped_flow(speed, pressure)
            accelerated = (torque_of_charge(speed, charge, SPARK) - brake) / INERTIA
            pressure += dt * MANIFOLD * (opened * _intake_flow(pressure) - out)
            drawn += dt * out
            angle += dt * speed
            speed = max(speed + dt * accelerated, SLOWEST)
            if angle >= np.pi:
                angle -= np.pi
                charge, collected, drawn = collected, drawn, 0.0
    return speeds


def _play_back(throttle: Float) -> Throttle:
    angles = throttle.tolist()
    return lambda k, speed: float(angles[k])


def _intake_flow(pressure: float) -> float:
    """Return the flow through the throttle relative to critical flow, at an inlet pressure of 1 bar."""
    # below half of the inlet pressure the flow is choked
    if pressure <= 0.5:
        return 1.0
    return 2 * math.sqrt(max(pressure - pressure**2, 0.0))


def _pumped_flow(speed: float, pressure: float) -> float:
    """Return the air flow from the manifold into the cylinders in g/s."""
    return -0.366 + 0.08979 * speed * pressure - 0.0337 * speed * pressure**2 + 0.0001 * speed**2 * pressure


def random_steps(
    rng: np.random.Generator, samples: int, range_: tuple[float, float], shortest: int, longest: int
) -> Float:
    """Return a signal with steps to random values within a range, of random lengths in samples."""
    lengths = rng.integers(shortest, longest, size=samples // shortest + 1, endpoint=True)
    return np.repeat(rng.uniform(*range_, size=lengths.size), lengths)[:samples]
