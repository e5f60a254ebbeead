"""Signal Attributes library: rate transitions, probes, checks and unit conversions.

A rate transition holds a signal for a slower task and delays it by one sample for a faster one. If it need not be
deterministic, a faster task reads the last value of the slower one: that of the same step in single-tasking mode, of
the previous step in multitasking mode.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Final, TypeAlias

from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.lowering import (
    BLOCK_TYPES,
    LIKE_INPUT,
    BlockContext,
    UnsupportedError,
    block,
    no_feedthrough,
)
from kennfeld.importers.simulink.reader.model_tree import ModelBlock
from kennfeld.importers.simulink.signals import (
    CONSTANT,
    CONTINUOUS,
    Bus,
    ExternalBus,
    Signal,
    SignalOrBus,
    apply,
    leaf_signals,
    select,
)
from kennfeld.models.sample_times import SampleTime

_Scale: TypeAlias = "Mapping[str, Fraction | float]"

# exact by definition: international yard and pound (1959), standard gravity (CGPM 1901); as fractions, the ratio of
# two units is rounded once
_FOOT, _INCH, _MILE = Fraction("0.3048"), Fraction("0.0254"), Fraction("1609.344")
_POUND, _G = Fraction("0.45359237"), Fraction("9.80665")
_FORCE = _POUND * _G
_SLUG = _FORCE / _FOOT

# units in SI units, by conversion block
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
# K = factor x + offset
_KELVIN = {"K": (1.0, 0.0), "C": (1.0, 273.15), "F": (5 / 9, 459.67 * 5 / 9), "R": (5 / 9, 0.0)}
_FACTORS = {
    **dict.fromkeys(("DegreesToRadians", "Degrees to Radians"), math.pi / 180),
    **dict.fromkeys(("RadiansToDegrees", "Radians to Degrees"), 180 / math.pi),
}
_COMPLEX = "its output is complex, but only real signals are supported"
_SOLVES = "it solves for a value that makes its input 0 in each step, which is not supported"
# reason and remedy by block type
_REFUSED = {
    "UnitConversion": (
        "it converts between the units of ports, which are ignored",
        "Use a Gain block instead, or bind it.",
    ),
    **dict.fromkeys(("RealImagToComplex", "MagnitudeAngleToComplex"), (_COMPLEX, "Bind the block that uses it.")),
    **dict.fromkeys(
        ("Algebraic Constraint", "AlgebraicConstraint"), (_SOLVES, "Solve the equation explicitly, and bind the block.")
    ),
}

_PROBE_FIELDS = ("ProbeWidth", "ProbeSampleTime", "ProbeComplexSignal", "ProbeSignalDimensions", "ProbeFramedSignal")

_CHECKS = (
    "Checks_DGap", "Checks_DMax", "Checks_DMin", "Checks_DRange", "Checks_Gradient", "Checks_Resolution", "Checks_SGap",
    "Checks_SMax", "Checks_SMin", "Checks_SRange",
)  # fmt: skip

_NOT_DETERMINISTIC = "Clear its option Ensure deterministic data transfer, or use sample times that are multiples."
_TIME_TOLERANCE = 1e-6  # relative to the sample time, for rounding
_OPTIONS = ("Specify", "Inherit", "Multiple of input port sample time")


def _unit(block: BlockContext, name: str, known: Mapping[str, object]) -> str:
    written = block.field_text(name).replace("G''s", "G's")
    if written not in known:
        raise UnsupportedError(f"unknown unit {written[:40]!r} in {name}", f"Known units: {', '.join(known)}.")
    return written


@block(*(f"{quantity} Conversion" for quantity in _SCALES), linked=True)
def conversion(block: BlockContext) -> SignalOrBus:
    """Convert the input to another unit of the same quantity."""
    scale = _SCALES[block.flat.type.removesuffix(" Conversion")]
    ratio = scale[_unit(block, "IU", scale)] / scale[_unit(block, "OU", scale)]
    return block.input() * float(ratio)


@block("Temperature Conversion", linked=True)
def temperature(block: BlockContext) -> SignalOrBus:
    """Convert a temperature to another unit."""
    # K = f x + o = f' x' + o', so that x' = x f / f' + (o - o') / f'
    (factor, offset), (other, beyond) = (_KELVIN[_unit(block, name, _KELVIN)] for name in ("IU", "OU"))
    return block.input() * (factor / other) + (offset - beyond) / other


@block(*_FACTORS, linked=True)
def convert_angle(block: BlockContext) -> SignalOrBus:
    """Convert an angle between degrees and rad."""
    return block.input() * _FACTORS[block.flat.type]


@block("Fahrenheit to Celsius", linked=True)
def fahrenheit_to_celsius(block: BlockContext) -> SignalOrBus:
    """Convert a temperature from degrees Fahrenheit to Celsius."""
    return (block.input() - 32.0) * (5 / 9)


@block("Celsius to Fahrenheit", linked=True)
def celsius_to_fahrenheit(block: BlockContext) -> SignalOrBus:
    """Convert a temperature from degrees Celsius to Fahrenheit."""
    return block.input() * (9 / 5) + 32.0


@block("Cartesian to Polar", linked=True)
def cartesian_to_polar(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Convert x and y to radius and angle in rad."""
    x, y = block.input(0), block.input(1)
    return apply("sqrt", x * x + y * y), apply("atan2", y, x)


@block("Polar to Cartesian", linked=True)
def polar_to_cartesian(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Convert radius and angle in rad to x and y."""
    radius, angle = block.input(0), block.input(1)
    return radius * apply("cos", angle), radius * apply("sin", angle)


@block(*_REFUSED, refused=True)
def refuse(block: BlockContext) -> SignalOrBus:
    """Refuse a block that no setting makes usable."""
    raise UnsupportedError(*_REFUSED[block.flat.type])


@block("Conversion Inherited", "Data Type Conversion Inherited", linked=True)
def like_another(block: BlockContext) -> SignalOrBus:
    """Pass on the second input; the first only provides its type."""
    return block.input_or_bus(1)


@block("Scaling Strip", "Data Type Scaling Strip", linked=True, refused=True)
def refuse_scaling_strip(block: BlockContext) -> SignalOrBus:
    """Refuse the stored integer of a fixed-point number: data types are ignored."""
    raise UnsupportedError("it removes the scaling of a fixed-point number, but data types are ignored")


@block("Width")
def width(block: BlockContext) -> SignalOrBus:
    """Count the elements of the input."""
    return block.constant(float(sum(signal.size for _, signal in leaf_signals(block.input_or_bus(0)))))


@block("Probe", ProbeWidth="on", ProbeSampleTime="on", ProbeComplexSignal="on", ProbeSignalDimensions="on",
       ProbeFramedSignal="off")  # fmt: skip
def probe(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Report width, sample time and offset in s, complexity (0) and dimensions of the input."""
    return tuple(_probe(block, name, block.input()) for name in _PROBE_FIELDS if block.is_on(name))


def _probe(block: BlockContext, name: str, u: Signal) -> Signal:
    match name:
        case "ProbeWidth":
            return block.constant(float(u.size))
        case "ProbeSampleTime" if u.period == CONTINUOUS:
            raise UnsupportedError("it outputs the sample time of a signal that does not specify one")
        case "ProbeSampleTime":
            return block.constant(math.inf if u.period == CONSTANT else u.period, 0.0)
        case "ProbeSignalDimensions":
            return block.constant(*map(float, u.shape))
    return block.constant(0.0)


@block("ComplexToRealImag", Output="Real and imag")
def real_and_imaginary(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the real and the imaginary part of a real signal."""
    u = block.input()
    return _parts(block, {"Real": u, "Imag": 0.0 * u}, "Real and imag")


@block("ComplexToMagnitudeAngle", Output="Magnitude and angle")
def magnitude_and_angle(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the magnitude and the angle of a real signal."""
    u = block.input()
    angle = select(u < 0.0, math.pi, 0.0)
    return _parts(block, {"Magnitude": abs(u), "Angle": angle}, "Magnitude and angle")


def _parts(block: BlockContext, parts: dict[str, Signal], both: str) -> tuple[SignalOrBus, ...]:
    wanted = block.option("Output", both, *parts)
    return tuple(part for name, part in parts.items() if wanted in (name, both))


@block(*_CHECKS, linked=True, needs=no_feedthrough, sink=True, export="off")
def check(block: BlockContext) -> SignalOrBus:
    """Lower a check block; it has no output."""
    if block.is_on("export"):
        raise UnsupportedError("it outputs the result of its check, which is not supported")
    return block.constant()


@block("MATLABFcn", "Interpreted MATLAB Function", refused=True, MATLABFcn="sin")
def refuse_interpreted(block: BlockContext) -> SignalOrBus:
    """Refuse a function that MATLAB would call in each step."""
    called = re.sub(r"\s+", " ", block.field_text("MATLABFcn"))[:60]
    remedy = "Use a MATLAB Function block instead, or bind it."
    raise UnsupportedError(f"it calls {called} in MATLAB in each step", remedy)


def _sample_of_output(block: ModelBlock) -> str:
    """Return the field with the output sample time, if the block has one."""
    return "OutPortSampleTime" if block.is_set_to("OutPortSampleTimeOpt", "Specify", default="Specify") else ""


@block("RateTransition", output=LIKE_INPUT,
       sample=_sample_of_output, held=False, Integrity="on", Deterministic="on", X0="0",
       OutPortSampleTimeOpt="Specify", OutPortSampleTime="-1", OutPortSampleTimeMultiple="1")  # fmt: skip
def rate_transition(block: BlockContext) -> SignalOrBus:
    """Hold a signal for a slower sample time, or delay it by one of its samples for a faster one.

    If the output sample time is not specified, it is the shortest one of the blocks downstream.
    """
    return _change_rate(block, block.input_or_bus(0))


def _change_rate(block: BlockContext, wired: SignalOrBus) -> SignalOrBus:
    if isinstance(wired, ExternalBus):
        return wired
    if isinstance(wired, Bus):
        return Bus({name: _change_rate(block, member) for name, member in wired.members.items()})
    if wired.period == CONSTANT:
        return wired
    rate = _output_sample_time(block, wired)
    # a slower output is a sample of the input, held: the faster task has run before, whether its value is copied
    # (ZOH), guarded by a semaphore (Buf) or neither
    if rate is not None and rate.period > wired.period * (1 + _TIME_TOLERANCE):
        return block.compiler.timing.hold(block.flat, wired, rate)
    rate = SampleTime(min(_downstream_sample_times(block), default=wired.period)) if rate is None else rate
    if rate.period >= wired.period * (1 - _TIME_TOLERANCE):
        return wired
    if block.is_on("Integrity") and block.is_on("Deterministic"):
        _check_deterministic(block, wired.period, rate)
        return replace(_delay_transition(block, wired), period=rate.period)
    signal = _read_from_slower_task(block, wired)
    if rate.period == CONTINUOUS:
        return replace(signal, period=CONTINUOUS)
    return block.compiler.timing.hold(block.flat, signal, rate)


def _check_deterministic(block: BlockContext, slow: float, fast: SampleTime) -> None:
    """Raise `UnsupportedError` if the delay of a transfer would vary, for which Simulink refuses it, too."""
    ratio = slow / fast.period if fast.period > 0 else 1.0
    if abs(ratio - round(ratio)) > _TIME_TOLERANCE * ratio:
        why = f"it transfers from {slow:g} s to {fast.period:g} s deterministically, but {slow:g} s is not a multiple"
        raise UnsupportedError(why, _NOT_DETERMINISTIC)
    offset = _offset_before(block, slow)
    if offset != fast.offset and fast.period > 0:
        why = f"it transfers between sample times with offsets of {offset:g} s and {fast.offset:g} s deterministically"
        raise UnsupportedError(why, _NOT_DETERMINISTIC)


def _offset_before(block: BlockContext, period: float) -> float:
    """Return the offset in s of the sample time that the input has, specified by a block upstream."""
    seen, waiting = set[FlatBlock](), [source.flat for source in block.flat.inputs if source is not None]
    while waiting:
        flat = waiting.pop()
        if flat in seen:
            continue
        seen.add(flat)
        rate = block.compiler.timing.specified_sample_time(flat)
        if rate is not None and rate.period == period:
            return rate.offset
        waiting += [source.flat for source in flat.inputs if source is not None]
    return 0.0


def _read_from_slower_task(block: BlockContext, u: Signal) -> Signal:
    """Return a slower signal as read by a faster task, which runs first.

    In each step, the faster task reads the buffer that the slower one filled last, and only then is the other buffer
    filled and made the active one: y[k] = b[k], b[k + 1] = slow hit ? u[k] : b[k].
    """
    tasks = block.compiler.clock.multitasking
    if tasks is None:
        block.warn(
            "passes on the value that a slower sample time computes in the same step, as in single-tasking mode: "
            "the file does not specify the tasking mode, and in multitasking mode it would be that of the previous "
            "step. Select deterministic transfer, or set the model's SolverMode or EnableMultiTasking"
        )
    # written at the hits of the slower task, which need not be hits of the block's own, faster sample time; between
    # them u is held, so that writing it in every step is the same
    return block.discrete_state(_initial(block), lambda _: u, sampled=False) if tasks else u


def _output_sample_time(block: BlockContext, u: Signal) -> SampleTime | None:
    """Return the specified output sample time, or None if it is inherited."""
    if block.option("OutPortSampleTimeOpt", *_OPTIONS) != "Multiple of input port sample time":
        return block.compiler.timing.specified_sample_time(block.flat)
    if u.period == CONTINUOUS:
        raise UnsupportedError("its sample time is a multiple of that of its input, which does not specify one")
    return SampleTime(u.period * block.numeric_field("OutPortSampleTimeMultiple"))


def _downstream_sample_times(block: BlockContext) -> Iterator[float]:
    """Yield the first sample time specified on each path downstream."""
    seen, waiting = set[FlatBlock](), [block.flat]
    while waiting:
        for reader in block.compiler.flat.readers.get(waiting.pop(), ()):
            kind, period = BLOCK_TYPES.get(reader.type), block.compiler.timing.specified_period(reader)
            # sinks have no say, and another transition begins a sample time of its own
            if reader in seen or (kind is not None and kind.sink) or reader.type == "RateTransition":
                continue
            seen.add(reader)
            if kind is not None and kind.continuous:
                # a solver reads its inputs in every step
                yield CONTINUOUS
            elif period is None or period == CONSTANT:
                waiting.append(reader)
            else:
                yield period


def _delay_transition(block: BlockContext, u: Signal) -> Signal:
    """Return the signal before the last hit of its own sample time, its initial value before the first."""
    init = _initial(block)
    before, hits = block.discrete_state(init, lambda _: u), block.compiler.timing.hits(u.period)
    # y = hit ? u' : y', in which u' is the input of the step before the hit
    return block.feedback(init, lambda shown: select(hits, before, shown))


def _initial(block: BlockContext) -> Signal:
    """Return what a faster task reads before the first hit of the slower one."""
    return block.parameter(block.field_name("InitialCondition", "X0"))
