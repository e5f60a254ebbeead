"""A published engine: the torque polynomial of Crossley and Cook (1991), as given in the Modelica Standard Library."""

from typing import TypeVar

import numpy as np

from kennfeld.arrays import Float

__all__ = ["FULL_CHARGE", "best_spark", "drag", "efficiency", "torque", "torque_of_charge"]

Number = TypeVar("Number", float, Float)

FULL_CHARGE = 0.6  # g of air in a cylinder at 100 % relative air mass
AIR_FUEL_RATIO = 14.6


def torque(speed: Float, air: Float, spark: Float) -> Float:
    """Torque in Nm at `speed` in rpm, relative air mass `air` in % and `spark` advance in degrees.

    P. R. Crossley, J. A. Cook: A nonlinear engine model for drivetrain system development, IEE Conference Control 1991.
    """
    return torque_of_charge(speed * (np.pi / 30), air * (FULL_CHARGE / 100), spark)


def torque_of_charge(n: Number, charge: Number, spark: Number) -> Number:
    """The same at `n` in rad/s and a `charge` of air in g."""
    mixture = 21.91 * AIR_FUEL_RATIO - 0.85 * AIR_FUEL_RATIO**2
    timing = spark * (0.26 + 0.00048 * n + 2.55 * charge) - spark**2 * (0.0028 + 0.05 * charge)
    return -181.3 + 379.36 * charge + mixture + timing + 0.027 * n - 0.000107 * n**2


def best_spark(speed: Float, air: Float) -> Float:
    """Spark advance in degrees at which the torque is greatest."""
    n, charge = speed * (np.pi / 30), air * (FULL_CHARGE / 100)
    result: Float = (0.26 + 0.00048 * n + 2.55 * charge) / (2 * (0.0028 + 0.05 * charge))
    return result


def drag(speed: Float) -> Float:
    """Torque in Nm that turns the engine at `speed` in rpm while nothing burns in it: no charge, so no spark."""
    result: Float = -torque_of_charge(speed * (np.pi / 30), np.zeros_like(speed), np.zeros_like(speed))
    return result


def efficiency(speed: Float, air: Float, distance: Float) -> Float:
    """Share of the inner torque, torque plus drag, that is left at a `distance` in degrees from the best spark."""
    best = best_spark(speed, air)
    inner = torque(speed, air, best - distance) + drag(speed)
    result: Float = inner / (torque(speed, air, best) + drag(speed))
    return result
