"""Blocks that pass a signal on, tell of it, or check it."""

import math
import re

import numpy as np

from kennfeld.models.simulink.expressions.signals import CONSTANT, CONTINUOUS, Signal, Wired, leaves
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site


@block("Conversion Inherited", "Data Type Conversion Inherited", linked=True)
def like_another(site: Site) -> Wired:
    """The second input; the first one only lends its type."""
    return site.wired(1)


@block("Scaling Strip", "Data Type Scaling Strip", linked=True, refused=True)
def stripped(site: Site) -> Wired:
    """The stored number of a fixed-point number, which is not known."""
    raise UnsupportedError("it takes the scaling of a fixed-point number away, and number types are left aside")


@block("Environment Controller", linked=True)
def environment(site: Site) -> Wired:
    """The first input, which counts where a model is simulated."""
    return site.wired(0)


@block("BusToVector")
def bus_to_vector(site: Site) -> Wired:
    """The signals of a bus behind each other."""
    wired = site.wired(0)
    nodes = [node for _, signal in leaves(wired) for node in signal.flat]
    return Signal(np.array(nodes, dtype=np.int64), wired.period)


@block("Width")
def width(site: Site) -> Wired:
    """How many elements the input has."""
    return site.constant(float(sum(signal.size for _, signal in leaves(site.wired(0)))))


@block("Probe", ProbeWidth="on", ProbeSampleTime="on", ProbeComplexSignal="on", ProbeSignalDimensions="on",
       ProbeFramedSignal="off")  # fmt: skip
def probe(site: Site) -> tuple[Wired, ...]:
    """What is known of the input: its width, its sample time and offset, that it is real, its dimensions."""
    asked = [name for name in _ASKED if site.on(name)]
    return tuple(_told(site, name, site.input()) for name in asked)


_ASKED = ("ProbeWidth", "ProbeSampleTime", "ProbeComplexSignal", "ProbeSignalDimensions", "ProbeFramedSignal")


def _told(site: Site, name: str, u: Signal) -> Signal:
    match name:
        case "ProbeWidth":
            return site.constant(float(u.size))
        case "ProbeSampleTime":
            return _sample_time(site, u)
        case "ProbeSignalDimensions":
            return site.constant(*map(float, u.shape))
    return site.constant(0.0)


def _sample_time(site: Site, u: Signal) -> Signal:
    if u.period == CONTINUOUS:
        raise UnsupportedError("it asks for the sample time of a signal that states none")
    return site.constant(math.inf if u.period == CONSTANT else u.period, 0.0)


@block("ComplexToRealImag", Output="Real and imag")
def real_and_imaginary(site: Site) -> tuple[Wired, ...]:
    """The real and the imaginary part of a signal, which is real."""
    u = site.input()
    parts = {"Real": u, "Imag": site.call("mul", site.constant(0.0), u)}
    return _parts(site, parts, "Real and imag")


@block("ComplexToMagnitudeAngle", Output="Magnitude and angle")
def magnitude_and_angle(site: Site) -> tuple[Wired, ...]:
    """The magnitude and the angle of a signal, which is real."""
    u = site.input()
    angle = site.select(site.call("lt", u, site.constant(0.0)), site.constant(math.pi), site.constant(0.0))
    return _parts(site, {"Magnitude": site.call("abs", u), "Angle": angle}, "Magnitude and angle")


def _parts(site: Site, parts: dict[str, Signal], both: str) -> tuple[Wired, ...]:
    wanted = site.chosen("Output", both, *parts)
    return tuple(part for name, part in parts.items() if wanted in (name, both))


@block("RealImagToComplex", "MagnitudeAngleToComplex", refused=True)
def to_complex(site: Site) -> Wired:
    """A complex signal, which the graph does not know."""
    raise UnsupportedError("its output is complex, and the graph is real", "Bind what is computed from it.")


@block("Algebraic Constraint", "AlgebraicConstraint", refused=True)
def algebraic_constraint(site: Site) -> Wired:
    """A value that makes another one 0, which would have to be searched for in each step."""
    raise UnsupportedError(
        "it searches for a value that makes its input 0, in each step", "Solve for it, and bind that."
    )


_CHECKS = (
    "Checks_DGap", "Checks_DMax", "Checks_DMin", "Checks_DRange", "Checks_Gradient", "Checks_Resolution", "Checks_SGap",
    "Checks_SMax", "Checks_SMin", "Checks_SRange",
)  # fmt: skip


@block(*_CHECKS, linked=True, needs=lambda site: (), sink=True, export="off")
def check(site: Site) -> Wired:
    """Nothing: it only checks."""
    if site.on("export"):
        raise UnsupportedError("it gives out what it has checked")
    return site.constant()


@block("CMBlock", "XY scope.", "Record", linked=True, needs=lambda site: (), sink=True)
def note(site: Site) -> Wired:
    """Nothing: it only shows."""
    return site.constant()


@block("HitCross", refused=True)
def hit_crossing(site: Site) -> Wired:
    """Whether a signal crosses a value, which depends on the steps that a solver takes to find that."""
    raise UnsupportedError(
        "it makes the solver search for a crossing between two steps", "Put a Detect block in its place, or bind it."
    )


@block("MATLABFcn", "Interpreted MATLAB Function", refused=True, MATLABFcn="sin")
def interpreted(site: Site) -> Wired:
    """A function that MATLAB would run in each step."""
    called = re.sub(r"\s+", " ", site.text("MATLABFcn"))[:60]
    raise UnsupportedError(
        f"it has MATLAB run {called} in each step", "Put a MATLAB Function in its place, or bind it."
    )
