"""Conversions between units: a factor, for temperatures an offset as well.

Blocks that pass a signal on, tell of it, or check it.

Signals passed on between sample times: held for a slower one, a hit late for a faster one.

Where a transition need not be deterministic, a faster sample time sees what the slower one has left last: that of the
same step in a single task, that of the step before where each sample time is a task of its own.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Final, TypeAlias

import numpy as np

from kennfeld.models.simulink.flattening.flat_model import FlatBlock
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES, block
from kennfeld.models.simulink.lowering.scheduling import CONTINUOUS_BLOCK_TYPES, SampleTime
from kennfeld.models.simulink.reader.model_tree import ModelBlock
from kennfeld.models.simulink.signals import CONSTANT, CONTINUOUS, Bus, ExternalBus, Signal, SignalOrBus, leaf_signals

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

_ASKED = ("ProbeWidth", "ProbeSampleTime", "ProbeComplexSignal", "ProbeSignalDimensions", "ProbeFramedSignal")

_CHECKS = (
    "Checks_DGap", "Checks_DMax", "Checks_DMin", "Checks_DRange", "Checks_Gradient", "Checks_Resolution", "Checks_SGap",
    "Checks_SMax", "Checks_SMin", "Checks_SRange",
)  # fmt: skip

_NEAR = 1e-6  # of a sample time, as far as it may be rounded
_OPTIONS = ("Specify", "Inherit", "Multiple of input port sample time")


def _unit(site: BlockContext, name: str, known: Mapping[str, object]) -> str:
    written = site.text(name).replace("G''s", "G's")
    if written not in known:
        raise UnsupportedError(
            f"{name} is {written[:40]!r}, a unit that is not known", f"Known are {', '.join(known)}."
        )
    return written


@block(*(f"{quantity} Conversion" for quantity in _SCALES), linked=True)
def conversion(site: BlockContext) -> SignalOrBus:
    """The input in another unit of the same quantity."""
    scale = _SCALES[site.atom.kind.removesuffix(" Conversion")]
    ratio = scale[_unit(site, "IU", scale)] / scale[_unit(site, "OU", scale)]
    return _times(site, float(ratio))


@block("Temperature Conversion", linked=True)
def temperature(site: BlockContext) -> SignalOrBus:
    """A temperature in another unit."""
    (factor, offset), (other, beyond) = (_KELVIN[_unit(site, name, _KELVIN)] for name in ("IU", "OU"))
    return site.call("add", _times(site, factor / other), site.constant((offset - beyond) / other))


def _times(site: BlockContext, factor: float) -> Signal:
    return site.call("mul", site.input(), site.constant(factor))


@block("DegreesToRadians", "Degrees to Radians", linked=True)
def degrees_to_radians(site: BlockContext) -> SignalOrBus:
    """An angle in rad."""
    return _times(site, math.pi / 180)


@block("RadiansToDegrees", "Radians to Degrees", linked=True)
def radians_to_degrees(site: BlockContext) -> SignalOrBus:
    """An angle in degrees."""
    return _times(site, 180 / math.pi)


@block("Fahrenheit to Celsius", linked=True)
def fahrenheit_to_celsius(site: BlockContext) -> SignalOrBus:
    """A temperature in degrees Celsius."""
    return site.call("mul", site.call("sub", site.input(), site.constant(32.0)), site.constant(5 / 9))


@block("Celsius to Fahrenheit", linked=True)
def celsius_to_fahrenheit(site: BlockContext) -> SignalOrBus:
    """A temperature in degrees Fahrenheit."""
    return site.call("add", _times(site, 9 / 5), site.constant(32.0))


@block("Cartesian to Polar", linked=True)
def cartesian_to_polar(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """The radius and the angle of x and y."""
    x, y = site.input(0), site.input(1)
    squares = site.call("add", site.call("mul", x, x), site.call("mul", y, y))
    return site.call("sqrt", squares), site.call("atan2", y, x)


@block("Polar to Cartesian", linked=True)
def polar_to_cartesian(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """The x and y of a radius and an angle."""
    radius, angle = site.input(0), site.input(1)
    return site.call("mul", radius, site.call("cos", angle)), site.call("mul", radius, site.call("sin", angle))


@block("UnitConversion", refused=True)
def by_ports(site: BlockContext) -> SignalOrBus:
    """The input in the unit of what it leads to."""
    raise UnsupportedError(
        "it converts between the units of ports, which are left aside", "Put a Gain in its place, or bind it."
    )


@block("Conversion Inherited", "Data Type Conversion Inherited", linked=True)
def like_another(site: BlockContext) -> SignalOrBus:
    """The second input; the first one only lends its type."""
    return site.wired(1)


@block("Scaling Strip", "Data Type Scaling Strip", linked=True, refused=True)
def stripped(site: BlockContext) -> SignalOrBus:
    """The stored number of a fixed-point number, which is not known."""
    raise UnsupportedError("it takes the scaling of a fixed-point number away, and number types are left aside")


@block("Environment Controller", linked=True)
def environment(site: BlockContext) -> SignalOrBus:
    """The first input, which counts where a model is simulated."""
    return site.wired(0)


@block("BusToVector")
def bus_to_vector(site: BlockContext) -> SignalOrBus:
    """The signals of a bus behind each other."""
    wired = site.wired(0)
    nodes = [node for _, signal in leaf_signals(wired) for node in signal.flat]
    return Signal(np.array(nodes, dtype=np.int64), wired.period)


@block("Width")
def width(site: BlockContext) -> SignalOrBus:
    """How many elements the input has."""
    return site.constant(float(sum(signal.size for _, signal in leaf_signals(site.wired(0)))))


@block("Probe", ProbeWidth="on", ProbeSampleTime="on", ProbeComplexSignal="on", ProbeSignalDimensions="on",
       ProbeFramedSignal="off")  # fmt: skip
def probe(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """What is known of the input: its width, its sample time and offset, that it is real, its dimensions."""
    asked = [name for name in _ASKED if site.on(name)]
    return tuple(_told(site, name, site.input()) for name in asked)


def _told(site: BlockContext, name: str, u: Signal) -> Signal:
    match name:
        case "ProbeWidth":
            return site.constant(float(u.size))
        case "ProbeSampleTime":
            return _sample_time(site, u)
        case "ProbeSignalDimensions":
            return site.constant(*map(float, u.shape))
    return site.constant(0.0)


def _sample_time(site: BlockContext, u: Signal) -> Signal:
    if u.period == CONTINUOUS:
        raise UnsupportedError("it asks for the sample time of a signal that states none")
    return site.constant(math.inf if u.period == CONSTANT else u.period, 0.0)


@block("ComplexToRealImag", Output="Real and imag")
def real_and_imaginary(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """The real and the imaginary part of a signal, which is real."""
    u = site.input()
    parts = {"Real": u, "Imag": site.call("mul", site.constant(0.0), u)}
    return _parts(site, parts, "Real and imag")


@block("ComplexToMagnitudeAngle", Output="Magnitude and angle")
def magnitude_and_angle(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """The magnitude and the angle of a signal, which is real."""
    u = site.input()
    angle = site.select(site.call("lt", u, site.constant(0.0)), site.constant(math.pi), site.constant(0.0))
    return _parts(site, {"Magnitude": site.call("abs", u), "Angle": angle}, "Magnitude and angle")


def _parts(site: BlockContext, parts: dict[str, Signal], both: str) -> tuple[SignalOrBus, ...]:
    wanted = site.chosen("Output", both, *parts)
    return tuple(part for name, part in parts.items() if wanted in (name, both))


@block("RealImagToComplex", "MagnitudeAngleToComplex", refused=True)
def to_complex(site: BlockContext) -> SignalOrBus:
    """A complex signal, which the graph does not know."""
    raise UnsupportedError("its output is complex, and the graph is real", "Bind what is computed from it.")


@block("Algebraic Constraint", "AlgebraicConstraint", refused=True)
def algebraic_constraint(site: BlockContext) -> SignalOrBus:
    """A value that makes another one 0, which would have to be searched for in each step."""
    raise UnsupportedError(
        "it searches for a value that makes its input 0, in each step", "Solve for it, and bind that."
    )


@block(*_CHECKS, linked=True, needs=lambda site: (), sink=True, export="off")
def check(site: BlockContext) -> SignalOrBus:
    """Nothing: it only checks."""
    if site.on("export"):
        raise UnsupportedError("it gives out what it has checked")
    return site.constant()


@block("CMBlock", "XY scope.", "Record", linked=True, needs=lambda site: (), sink=True)
def note(site: BlockContext) -> SignalOrBus:
    """Nothing: it only shows."""
    return site.constant()


@block("HitCross", refused=True)
def hit_crossing(site: BlockContext) -> SignalOrBus:
    """Whether a signal crosses a value, which depends on the steps that a solver takes to find that."""
    raise UnsupportedError(
        "it makes the solver search for a crossing between two steps", "Put a Detect block in its place, or bind it."
    )


@block("MATLABFcn", "Interpreted MATLAB Function", refused=True, MATLABFcn="sin")
def interpreted(site: BlockContext) -> SignalOrBus:
    """A function that MATLAB would run in each step."""
    called = re.sub(r"\s+", " ", site.text("MATLABFcn"))[:60]
    raise UnsupportedError(
        f"it has MATLAB run {called} in each step", "Put a MATLAB Function in its place, or bind it."
    )


def _sample_of_output(one: ModelBlock) -> str:
    """The parameter with the sample time of the output, where one may be stated."""
    return "OutPortSampleTime" if (one.value("OutPortSampleTimeOpt") or "Specify") == "Specify" else ""


@block("RateTransition", sample=_sample_of_output, held=False, Integrity="on", Deterministic="on", X0="0",
       OutPortSampleTimeOpt="Specify", OutPortSampleTime="-1", OutPortSampleTimeMultiple="1")  # fmt: skip
def rate_transition(site: BlockContext) -> SignalOrBus:
    """The signal itself; a slower sample time holds it, a faster one sees it a hit of its own late.

    Where no sample time is stated for the output, it is the shortest one that the blocks behind it state.
    """
    return _passed(site, site.wired(0))


def _passed(site: BlockContext, wired: SignalOrBus) -> SignalOrBus:
    if isinstance(wired, ExternalBus):
        return wired
    if isinstance(wired, Bus):
        return Bus({name: _passed(site, member) for name, member in wired.members.items()})
    if wired.period == CONSTANT:
        return wired
    wanted = _stated(site, wired)
    if wanted is not None and wanted > wired.period * (1 + _NEAR):
        return site.compiler.timing.held(site.atom, wired, SampleTime(wanted))
    wanted = min(_behind(site), default=wired.period) if wanted is None else wanted
    if wanted >= wired.period * (1 - _NEAR):
        return wired
    if site.on("Integrity") and site.on("Deterministic"):
        return replace(_late(site, wired), period=wanted)
    return _at_own_hits(site, _as_tasks_leave_it(site, wired), wanted)


def _as_tasks_leave_it(site: BlockContext, u: Signal) -> Signal:
    """A slower signal as a faster task reads it, which runs before the slower one where both are hit."""
    tasks = site.compiler.clock.multitasking
    if tasks is None:
        site.remark(
            "passes on what a slower sample time makes in the same step, as in a single task; the file does not say "
            "whether each sample time is a task of its own, where it would be what the step before has left. Set "
            "Deterministic, or the model's SolverMode or EnableMultiTasking"
        )
    return site.remember(_initial(site), lambda _: u) if tasks else u


def _at_own_hits(site: BlockContext, u: Signal, period: float) -> Signal:
    """A signal that changes at the hits of a sample time only."""
    if period == CONTINUOUS:
        return replace(u, period=period)
    return site.compiler.timing.held(site.atom, u, SampleTime(period))


def _stated(site: BlockContext, u: Signal) -> float | None:
    """The sample time that is stated for the output; None where it is inherited."""
    if site.chosen("OutPortSampleTimeOpt", *_OPTIONS) != "Multiple of input port sample time":
        return site.compiler.timing.stated_period(site.atom)
    if u.period == CONTINUOUS:
        raise UnsupportedError("its sample time is a multiple of that of its input, which states none")
    return u.period * site.number("OutPortSampleTimeMultiple")


def _behind(site: BlockContext) -> Iterator[float]:
    """The sample times that blocks behind it state, those that come first on each way."""
    seen, waiting = set[FlatBlock](), [site.atom]
    while waiting:
        for reader in site.compiler.flat.readers.get(waiting.pop(), ()):
            kind, period = BLOCK_TYPES.get(reader.kind), site.compiler.timing.stated_period(reader)
            if reader in seen or (kind is not None and kind.sink) or reader.kind == "RateTransition":
                continue
            seen.add(reader)
            if reader.kind in CONTINUOUS_BLOCK_TYPES:
                yield CONTINUOUS
            elif period is None or period == CONSTANT:
                waiting.append(reader)
            else:
                yield period


def _late(site: BlockContext, u: Signal) -> Signal:
    """What a signal was before the last hit of its own sample time; an initial value before the first."""
    init = _initial(site)
    made: list[Signal] = []
    before, shown = site.remember(init, lambda _: u), site.remember(init, lambda _: made[0])
    made.append(site.select(site.compiler.timing.hits(u.period), before, shown))
    return made[0]


def _initial(site: BlockContext) -> Signal:
    """What a faster sample time sees before the first hit of the slower one."""
    return site.parameter("InitialCondition" if site.atom.block.value("InitialCondition") is not None else "X0")
