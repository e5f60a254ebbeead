"""A published engine at idle, simulated: throttle and load in, engine speed out.

P. R. Crossley, J. A. Cook: A nonlinear engine model for drivetrain system development, IEE Conference Control 1991,
with the values of the Modelica Standard Library (Modelica.Clocked.Examples.Systems.EngineThrottleControl, BSD-3).
"""

import math
from collections.abc import Callable

import numpy as np

from kennfeld.arrays import Float
from kennfeld.project.demo.engine import torque_of_charge

__all__ = ["SPARK", "START_CHARGE", "START_PRESSURE", "START_SPEED", "random_steps", "simulate_engine"]

START_SPEED = 209.0  # rad/s
START_PRESSURE = 0.543  # bar
START_CHARGE = 0.152  # g
SPARK = 15.0  # degrees before top dead centre
INERTIA = 0.14  # kg m2
MANIFOLD = 0.41328  # bar/g
SLOWEST = 1.0  # rad/s; below, the engine has stalled
RPM = 30 / math.pi


Throttle = Callable[[int, float], float]  # its angle from the number of a sample and the speed there in rpm


def simulate_engine(throttle: Float | Throttle, load: Float, step: float, fine: float = 5e-4) -> Float:
    """Engine speed in rpm at each sample, Float[samples].

    `throttle` in degrees, which a governor may find, and `load` in Nm, Float[samples], are held over a `step` in s. The
    manifold and the crank are integrated by Euler steps of about `fine` s; the charge drawn in over 180 degrees of
    crank acts 180 degrees later. An engine that stalls stays at 1 rad/s.
    """
    governor = throttle if callable(throttle) else _recorded(throttle)
    inner = max(round(step / fine), 1)
    dt = step / inner
    speed, pressure = START_SPEED, START_PRESSURE
    charge = collected = START_CHARGE
    drawn, angle = 0.0, 0.0
    made = np.empty(len(load))
    for k, brake in enumerate(load.tolist()):
        made[k] = speed * RPM
        angle_of_plate = governor(k, made[k])
        opened = 2.821 - 0.05231 * angle_of_plate + 0.10299 * angle_of_plate**2 - 0.00063 * angle_of_plate**3
        for _ in range(inner):
            out = _pumped(speed, pressure)
            accelerated = (torque_of_charge(speed, charge, SPARK) - brake) / INERTIA
            pressure += dt * MANIFOLD * (opened * _sucked(pressure) - out)
            drawn += dt * out
            angle += dt * speed
            speed = max(speed + dt * accelerated, SLOWEST)
            if angle >= np.pi:
                angle -= np.pi
                charge, collected, drawn = collected, drawn, 0.0
    return made


def _recorded(throttle: Float) -> Throttle:
    angles = throttle.tolist()
    return lambda k, speed: float(angles[k])


def _sucked(pressure: float) -> float:
    """How much of the flow at critical pressure passes the throttle; 1 bar ahead of it."""
    if pressure <= 0.5:
        return 1.0
    return 2 * math.sqrt(max(pressure - pressure**2, 0.0))


def _pumped(speed: float, pressure: float) -> float:
    """Air from the manifold into the cylinders in g/s."""
    return -0.366 + 0.08979 * speed * pressure - 0.0337 * speed * pressure**2 + 0.0001 * speed**2 * pressure


def random_steps(
    rng: np.random.Generator, samples: int, range_: tuple[float, float], shortest: int, longest: int
) -> Float:
    """A signal that jumps to a random value within a range and stays there for a random number of samples."""
    lengths = rng.integers(shortest, longest, size=samples // shortest + 1, endpoint=True)
    return np.repeat(rng.uniform(*range_, size=lengths.size), lengths)[:samples]
