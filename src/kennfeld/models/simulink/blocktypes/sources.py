"""Signals made from nothing but time and parameters."""

import numpy as np

from kennfeld.models.simulink.blocktypes.registry import KINDS, UnsupportedError, block
from kennfeld.models.simulink.expressions import Expressions, NoValueError
from kennfeld.models.simulink.flatten import Atom
from kennfeld.models.simulink.signals import CONSTANT, CONTINUOUS, Signal, Wired
from kennfeld.models.simulink.site import Site


@block("Constant", Value="1", SampleTime="inf", VectorParams1D="on")
def constant(site: Site) -> Wired:
    """A constant or a named variable."""
    return Signal(_vector(site, "Value").nodes, CONSTANT)


@block("EnumeratedConstant", Value="SlDemoSign.Positive", SampleTime="inf")
def enumerated_constant(site: Site) -> Wired:
    """A member of an enumeration: its whole number."""
    return site.parameter("Value")


def _vector(site: Site, name: str) -> Signal:
    if site.text("VectorParams1D", "on") == "on":
        return site.parameter(name)
    return Signal(site.matrix(name), CONSTANT)


@block("Clock", "DigitalClock", "Digital Clock", SampleTime="-1")
def clock(site: Site) -> Wired:
    """The time since the start in s."""
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
    return site.call("add", site.parameter("InitialOutput"), site.call("mul", site.parameter("slope"), since))


@block("Sin", SineType="Time based", TimeSource="Use simulation time", Amplitude="1", Bias="0", Frequency="1",
       Phase="0", SampleTime="-1")  # fmt: skip
def sine(site: Site) -> Wired:
    """The wave amplitude sin(frequency t + phase) + bias."""
    site.chosen("SineType", "Time based")
    t = site.time if site.text("TimeSource") == "Use simulation time" else site.input()
    angle = site.call("add", site.call("mul", site.parameter("Frequency"), t), site.parameter("Phase"))
    wave = site.call("mul", site.parameter("Amplitude"), site.call("sin", angle))
    return site.call("add", wave, site.parameter("Bias"))


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
    return site.weaver.at_major(made)


@block("FromWorkspace", "FromFile", "Signal Editor", "SignalGenerator", "RandomNumber", "UniformRandomNumber",
       "Random Number", "Sigbuilder block", "Repeating table", "Band-Limited White Noise.")  # fmt: skip
def recorded(site: Site) -> Wired:
    """A signal that is not in the model."""
    mend = "Bind it to a channel of the measurement, which takes its place."
    raise UnsupportedError("its signal is recorded or random and not part of the model", mend)


@block("Repeating Sequence Stair", OutValues="[3 1 4 2 1].'", tsamp="-1")
def stairs(site: Site) -> Wired:
    """Values one after the other, again and again."""
    values = site.parameter("OutValues").flat
    sample = site.number("tsamp")
    dt = site.constant(sample) if sample > 0 else Signal(np.array([site.loom.input("dt")], dtype=np.int64), CONTINUOUS)
    count = site.call("floor", site.call("add", site.call("div", site.time, dt), site.constant(1e-6)))
    at = site.call("mod", count, site.constant(float(len(values))))
    made = Signal(np.array([values[-1]], dtype=np.int64), CONTINUOUS)
    for place in reversed(range(len(values) - 1)):
        here = Signal(np.array([values[place]], dtype=np.int64), CONTINUOUS)
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
