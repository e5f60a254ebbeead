"""Signals made from nothing but time and parameters."""

import numpy as np

from kennfeld.models.simulink.expressions.expressions import Expressions
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.signals import CONSTANT, Signal, Wired, scalar
from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.weaving.registry import KINDS, UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site


@block("Constant", Value="1", SampleTime="inf", VectorParams1D="on")
def constant(site: Site) -> Wired:
    """A constant or a named variable."""
    return Signal(_vector(site, "Value").nodes, CONSTANT)


@block("EnumeratedConstant", "Enumerated Constant", Value="SlDemoSign.Positive", SampleTime="inf")
def enumerated_constant(site: Site) -> Wired:
    """A member of an enumeration: its whole number."""
    return site.parameter("Value")


def _vector(site: Site, name: str) -> Signal:
    if site.text("VectorParams1D", "on") == "on":
        return site.parameter(name)
    return Signal(site.matrix(name), CONSTANT)


@block("Clock", SampleTime="-1")
def clock(site: Site) -> Wired:
    """The time since the start in s."""
    return site.time


@block("DigitalClock", "Digital Clock", SampleTime="1")
def digital_clock(site: Site) -> Wired:
    """The time since the start in s, at the hits of its sample time."""
    return site.time


@block("Step", Time="1", Before="0", After="1", SampleTime="-1")
def step(site: Site) -> Wired:
    """One value before a time, another from it on."""
    return site.select(_reached(site, site.parameter("Time")), site.parameter("After"), site.parameter("Before"))


def _reached(site: Site, time: Signal) -> Signal:
    """Whether a time has come; what rounding takes from a time does not count."""
    near = 1e-6 * (site.weaver.clock.step or 0.0)
    return site.call("ge", site.call("add", site.time, site.constant(near)), time)


@block("Ramp", slope="1", start="0", InitialOutput="0")
def ramp(site: Site) -> Wired:
    """A line that begins to rise at a time."""
    start = site.parameter("start")
    since = site.call("max", site.call("sub", site.time, start), site.constant(0.0))
    first = site.parameter("X0" if site.text("X0", "") else "InitialOutput")  # X0 in older files
    return site.call("add", first, site.call("mul", site.parameter("slope"), since))


@block("Sin", SineType="Time based", TimeSource="Use simulation time", Amplitude="1", Bias="0", Frequency="1",
       Phase="0", Samples="10", Offset="0", SampleTime="-1")  # fmt: skip
def sine(site: Site) -> Wired:
    """The wave amplitude sin(angle) + bias, its angle frequency t + phase, or 2 pi (hit + offset) / samples."""
    if site.chosen("SineType", "Time based", "Sample based") == "Sample based":
        angle = _angle_of_hit(site)
    else:
        t = site.time if site.text("TimeSource") == "Use simulation time" else site.input()
        angle = site.call("add", site.call("mul", site.parameter("Frequency"), t), site.parameter("Phase"))
    wave = site.call("mul", site.parameter("Amplitude"), site.call("sin", angle))
    return site.call("add", wave, site.parameter("Bias"))


def _angle_of_hit(site: Site) -> Signal:
    sample = site.weaver.timing.stated_period(site.atom)
    if sample is None or not 0 < sample < CONSTANT:
        raise UnsupportedError("it counts samples, and its sample time is inherited")
    hit = site.call("floor", site.call("add", site.call("div", site.time, site.constant(sample)), site.constant(1e-6)))
    turns = site.call("div", site.call("add", hit, site.parameter("Offset")), site.parameter("Samples"))
    return site.call("mul", site.constant(2 * np.pi), turns)


@block("chirp", "Chirp Signal", linked=True, f1="0.1", T="100", f2="1")
def chirp(site: Site) -> Wired:
    """A sine whose frequency rises from f1 at 0 s to f2 at T, and on."""
    f1, f2, t = site.parameter("f1"), site.parameter("f2"), site.time
    rate = site.call("div", site.call("sub", f2, f1), site.call("mul", site.constant(2.0), site.parameter("T")))
    turns = site.call("mul", t, site.call("add", f1, site.call("mul", rate, t)))
    return site.call("sin", site.call("mul", site.constant(2 * np.pi), turns))


@block("SignalGenerator", WaveForm="sine", Amplitude="1", Frequency="1", Units="Hertz",
       TimeSource="Use simulation time")  # fmt: skip
def generator(site: Site) -> Wired:
    """A sine wave, or a square wave that begins with its lower half; the others are random, or depend on rounding."""
    form = site.text("WaveForm")
    if form not in ("sine", "square"):
        raise UnsupportedError(f"its wave form is {form[:40]!r}, and only sine and square are supported", _BIND)
    t = site.time if site.text("TimeSource") == "Use simulation time" else site.input()
    amplitude, frequency, whole = site.parameter("Amplitude"), site.parameter("Frequency"), site.constant(2 * np.pi)
    in_hertz = site.chosen("Units", "Hertz", "rad/sec") == "Hertz"
    if form == "sine":
        angle = site.call("mul", site.call("mul", frequency, whole) if in_hertz else frequency, t)
        return site.call("mul", amplitude, site.call("sin", angle))
    turns = site.call("mul", frequency if in_hertz else site.call("div", frequency, whole), t)
    upper = site.call("ge", site.call("sub", turns, site.call("floor", turns)), site.constant(0.5))
    return site.select(upper, amplitude, site.call("neg", amplitude))


@block("DiscretePulseGenerator", PulseType="Sample based", TimeSource="Use simulation time", Amplitude="1", Period="2",
       PulseWidth="1", PhaseDelay="0")  # fmt: skip
def pulses(site: Site) -> Wired:
    """Pulses of an amplitude: `Period`, `PulseWidth` (percent of it) and `PhaseDelay` in s, or in samples."""
    site.chosen("TimeSource", "Use simulation time")
    period, delay = site.number("Period"), site.number("PhaseDelay")
    width = site.number("PulseWidth") * (period / 100)
    if site.chosen("PulseType", "Time based", "Sample based") == "Sample based":
        sample = site.number("SampleTime", "1")
        if sample <= 0:
            raise UnsupportedError("its sample time is inherited, which pulses that count samples cannot")
        period, delay, width = period * sample, delay * sample, site.number("PulseWidth") * sample
    if not period > 0:
        raise UnsupportedError(f"its Period is {period:g}")
    near = site.constant(1e-6 * (site.weaver.clock.step or 0.0))
    since = site.call("add", site.call("sub", site.time, site.constant(delay)), near)
    within = site.call("mod", since, site.constant(period))
    high = site.call("lt", within, site.constant(width))
    started = site.call("ge", since, site.constant(0.0))
    made = site.select(site.call("and", started, high), site.parameter("Amplitude"), site.constant(0.0))
    return site.weaver.timing.at_major(made)


_BIND = "Bind it to a channel of the measurement, which takes its place."


@block("FromFile", "FromSpreadsheet", "Signal Editor", "RandomNumber", "UniformRandomNumber", "Random Number",
       "Sigbuilder block", "Band-Limited White Noise.", "Band-Limited White Noise", refused=True)  # fmt: skip
def recorded(site: Site) -> Wired:
    """A signal that is not in the model."""
    raise UnsupportedError("its signal is recorded or random and not part of the model", _BIND)


@block("Repeating Sequence Stair", sample="", OutValues="[3 1 4 2 1].'", tsamp="-1")
def stairs(site: Site) -> Wired:
    """Values one after the other, again and again."""
    values = site.parameter("OutValues").flat
    sample = site.number("tsamp")
    dt = site.constant(sample) if sample > 0 else site.major_step
    count = site.call("floor", site.call("add", site.call("div", site.time, dt), site.constant(1e-6)))
    at = site.call("mod", count, site.constant(float(len(values))))
    made = scalar(values[-1])
    for place in reversed(range(len(values) - 1)):
        here = scalar(values[place])
        made = site.select(site.call("lt", at, site.constant(place + 0.5)), here, made)
    return made


def pulse_times(atom: Atom, expressions: Expressions) -> list[float]:
    """The times between which a block's pulses change, in s; none of other blocks. Raises `NoValueError`."""
    if atom.kind != "DiscretePulseGenerator":
        return []
    block, defaults = atom.block, KINDS[atom.kind].defaults

    def number(name: str, default: str = "") -> float:
        found = expressions.numbers(block.value(name) or defaults.get(name, default), atom.scope)
        if found.size != 1:
            raise NoValueError(f"its {name} has {found.size} values where one is expected")
        return float(found.item())

    if (block.value("PulseType") or defaults["PulseType"]) != "Time based":
        return [number("SampleTime", "1")]
    period = number("Period")
    return [period, period * number("PulseWidth") / 100, number("PhaseDelay")]
