"""A passenger-car diesel: 2.0 l, four cylinders, turbocharged. What it burns, breathes, and how hot that makes it.

The equations are energy and mass balances of one stroke with textbook coefficients (J. B. Heywood, Internal Combustion
Engine Fundamentals, chapters 6, 12 and 13); all of them are smooth, none is piecewise linear.
"""

import numpy as np

from kennfeld.arrays import Float

__all__ = [
    "IDLE_SPEED",
    "TOP_SPEED",
    "TORQUE_PER_FUEL",
    "air_flow",
    "drag",
    "full_load",
    "lag",
    "settled_temperature",
    "stroke_air",
    "turbo_lag",
]

IDLE_SPEED, TOP_SPEED = 820.0, 5000.0  # rpm
HEATING_VALUE = 42.5  # J/mg
STROKES = 2.0  # combustions a turn
EFFICIENCY = 0.43  # indicated
TORQUE_PER_FUEL = STROKES * HEATING_VALUE * EFFICIENCY / (2 * np.pi)  # Nm per mg/stk
DISPLACED = 590.0  # mg of air that a cylinder displaces at ambient pressure
AMBIENT = 22.0  # degC
HEAT_CAPACITY = 1.09e-3  # J/(mg K), of the exhaust gas


def drag(speed: Float) -> Float:
    """Friction, pumping and auxiliaries in Nm at `speed` in rpm."""
    result: Float = 16.0 + 4.5 * (speed / 1000) + 0.75 * (speed / 1000) ** 2
    return result


def full_load(speed: Float) -> Float:
    """Greatest injection quantity in mg/stk at `speed` in rpm: what the air allows without smoke."""
    result: Float = 53.0 * np.exp(-(((speed - 2400.0) / 2700.0) ** 2)) * (1 - 0.5 * np.exp(-(speed - 700.0) / 450.0))
    return result


def stroke_air(speed: Float, fuel: Float) -> Float:
    """Air in mg/stk in a cylinder once the turbine has run up: filling, boost, and what recirculated gas displaces."""
    filling = 0.9 - 0.14 * ((speed - 2300.0) / 2300.0) ** 2
    boost = 1 + 1.25 * np.tanh(fuel / 38.0) / (1 + np.exp(-(speed - 1700.0) / 420.0))
    recirculated = 0.36 / (1 + np.exp((fuel - 19.0) / 4.0)) / (1 + np.exp((speed - 2700.0) / 350.0))
    result: Float = DISPLACED * filling * boost * (1 - recirculated)
    return result


def air_flow(speed: Float, air: Float) -> Float:
    """Air mass flow in kg/h of `air` in mg/stk at `speed` in rpm."""
    result: Float = air * STROKES * speed * 60e-6
    return result


def turbo_lag(speed: Float) -> Float:
    """Time constant in s with which turbine and recirculation follow."""
    result: Float = 0.25 + 1.1 * np.exp(-(speed - 800.0) / 900.0)
    return result


def settled_temperature(speed: Float, fuel: Float) -> Float:
    """Exhaust gas temperature in degC that constant `speed` in rpm and `fuel` in mg/stk lead to.

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
    """Time constant in s of pipe and sensor in an air mass flow in kg/h: heat transfer grows with flow^0.8."""
    result: Float = 1.2 + 20.0 * (flow / 50.0) ** -0.8
    return result
