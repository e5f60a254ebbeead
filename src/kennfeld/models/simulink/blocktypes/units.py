"""Conversions between units: a factor, for temperatures an offset as well."""

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Final, TypeAlias

from kennfeld.models.simulink.expressions.signals import Signal, Wired
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site

_Scale: TypeAlias = "Mapping[str, Fraction | float]"

_FOOT, _INCH, _MILE = Fraction("0.3048"), Fraction("0.0254"), Fraction("1609.344")
_POUND, _G = Fraction("0.45359237"), Fraction("9.80665")
_FORCE = _POUND * _G
_SLUG = _FORCE / _FOOT

# what one unit is in the unit of the SI, by the block that converts it
_SCALES: Final[Mapping[str, _Scale]] = {
    "Length": {"m": 1, "km": 1000, "ft": _FOOT, "in": _INCH, "mi": _MILE, "naut mi": 1852},
    "Velocity": {
        "m/s": 1, "ft/s": _FOOT, "km/s": 1000, "in/s": _INCH, "km/h": Fraction(5, 18), "mph": _MILE / 3600,
        "kts": Fraction(1852, 3600), "ft/min": _FOOT / 60,
    },
    "Acceleration": {
        "m/s^2": 1, "ft/s^2": _FOOT, "km/s^2": 1000, "in/s^2": _INCH, "km/h-s": Fraction(5, 18), "mph/s": _MILE / 3600,
        "G's": _G,
    },
    "Angle": {"rad": 1.0, "deg": math.pi / 180, "rev": 2 * math.pi},
    "Angular Velocity": {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30},
    "Angular Acceleration": {"rad/s^2": 1.0, "deg/s^2": math.pi / 180, "rpm/s": math.pi / 30},
    "Mass": {"kg": 1, "lbm": _POUND, "slug": _SLUG},
    "Force": {"N": 1, "lbf": _FORCE},
    "Pressure": {"Pa": 1, "psi": _FORCE / _INCH**2, "psf": _FORCE / _FOOT**2, "atm": 101_325},
    "Density": {
        "kg/m^3": 1, "lbm/ft^3": _POUND / _FOOT**3, "slug/ft^3": _SLUG / _FOOT**3, "lbm/in^3": _POUND / _INCH**3,
    },
}  # fmt: skip
_KELVIN = {
    "K": (1.0, 0.0),
    "C": (1.0, 273.15),
    "F": (5 / 9, 459.67 * 5 / 9),
    "R": (5 / 9, 0.0),
}  # K = factor x + offset


def _unit(site: Site, name: str, known: Mapping[str, object]) -> str:
    written = site.text(name).replace("G''s", "G's")
    if written not in known:
        raise UnsupportedError(
            f"{name} is {written[:40]!r}, a unit that is not known", f"Known are {', '.join(known)}."
        )
    return written


@block(*(f"{quantity} Conversion" for quantity in _SCALES), linked=True)
def conversion(site: Site) -> Wired:
    """The input in another unit of the same quantity."""
    scale = _SCALES[site.atom.kind.removesuffix(" Conversion")]
    ratio = scale[_unit(site, "IU", scale)] / scale[_unit(site, "OU", scale)]
    return _times(site, float(ratio))


@block("Temperature Conversion", linked=True)
def temperature(site: Site) -> Wired:
    """A temperature in another unit."""
    (factor, offset), (other, beyond) = (_KELVIN[_unit(site, name, _KELVIN)] for name in ("IU", "OU"))
    return site.call("add", _times(site, factor / other), site.constant((offset - beyond) / other))


def _times(site: Site, factor: float) -> Signal:
    return site.call("mul", site.input(), site.constant(factor))


@block("DegreesToRadians", "Degrees to Radians", linked=True)
def degrees_to_radians(site: Site) -> Wired:
    """An angle in rad."""
    return _times(site, math.pi / 180)


@block("RadiansToDegrees", "Radians to Degrees", linked=True)
def radians_to_degrees(site: Site) -> Wired:
    """An angle in degrees."""
    return _times(site, 180 / math.pi)


@block("Fahrenheit to Celsius", linked=True)
def fahrenheit_to_celsius(site: Site) -> Wired:
    """A temperature in degrees Celsius."""
    return site.call("mul", site.call("sub", site.input(), site.constant(32.0)), site.constant(5 / 9))


@block("Celsius to Fahrenheit", linked=True)
def celsius_to_fahrenheit(site: Site) -> Wired:
    """A temperature in degrees Fahrenheit."""
    return site.call("add", _times(site, 9 / 5), site.constant(32.0))


@block("Cartesian to Polar", linked=True)
def cartesian_to_polar(site: Site) -> tuple[Wired, ...]:
    """The radius and the angle of x and y."""
    x, y = site.input(0), site.input(1)
    squares = site.call("add", site.call("mul", x, x), site.call("mul", y, y))
    return site.call("sqrt", squares), site.call("atan2", y, x)


@block("Polar to Cartesian", linked=True)
def polar_to_cartesian(site: Site) -> tuple[Wired, ...]:
    """The x and y of a radius and an angle."""
    radius, angle = site.input(0), site.input(1)
    return site.call("mul", radius, site.call("cos", angle)), site.call("mul", radius, site.call("sin", angle))


@block("UnitConversion", refused=True)
def by_ports(site: Site) -> Wired:
    """The input in the unit of what it leads to."""
    raise UnsupportedError(
        "it converts between the units of ports, which are left aside", "Put a Gain in its place, or bind it."
    )
