"""Signals made from nothing but time and parameters.

Signals over time whose values are in the model: lines between points, once or again and again.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Numbers
from kennfeld.models.simulink.blocks.lookup_tables import Method, constant_curve
from kennfeld.models.simulink.expressions.parameter_expressions import Expressions
from kennfeld.models.simulink.flattening.flat_model import FlatBlock
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES, block
from kennfeld.models.simulink.signals import CONSTANT, CONTINUOUS, Signal, SignalOrBus, scalar

_BIND = "Bind it to a channel of the measurement, which takes its place."

_MOST_STEPS = 2000  # of a signal that jumps; each takes a comparison


@block("Constant", Value="1", SampleTime="inf", VectorParams1D="on")
def constant(site: BlockContext) -> SignalOrBus:
    """A constant or a named variable."""
    return Signal(_vector(site, "Value").nodes, CONSTANT)


@block("EnumeratedConstant", "Enumerated Constant", Value="SlDemoSign.Positive", SampleTime="inf")
def enumerated_constant(site: BlockContext) -> SignalOrBus:
    """A member of an enumeration: its whole number."""
    return site.parameter("Value")


def _vector(site: BlockContext, name: str) -> Signal:
    if site.text("VectorParams1D", "on") == "on":
        return site.parameter(name)
    return Signal(site.matrix(name), CONSTANT)


@block("Clock", SampleTime="-1")
def clock(site: BlockContext) -> SignalOrBus:
    """The time since the start in s."""
    return site.time


@block("DigitalClock", "Digital Clock", SampleTime="1")
def digital_clock(site: BlockContext) -> SignalOrBus:
    """The time since the start in s, at the hits of its sample time."""
    return site.time


@block("Step", Time="1", Before="0", After="1", SampleTime="-1")
def step(site: BlockContext) -> SignalOrBus:
    """One value before a time, another from it on."""
    return site.select(_reached(site, site.parameter("Time")), site.parameter("After"), site.parameter("Before"))


def _reached(site: BlockContext, time: Signal) -> Signal:
    """Whether a time has come; what rounding takes from a time does not count."""
    near = 1e-6 * (site.compiler.clock.step or 0.0)
    return site.call("ge", site.call("add", site.time, site.constant(near)), time)


@block("Ramp", slope="1", start="0", InitialOutput="0")
def ramp(site: BlockContext) -> SignalOrBus:
    """A line that begins to rise at a time."""
    start = site.parameter("start")
    since = site.call("max", site.call("sub", site.time, start), site.constant(0.0))
    first = site.parameter("X0" if site.text("X0", "") else "InitialOutput")  # X0 in older files
    return site.call("add", first, site.call("mul", site.parameter("slope"), since))


@block("Sin", SineType="Time based", TimeSource="Use simulation time", Amplitude="1", Bias="0", Frequency="1",
       Phase="0", Samples="10", Offset="0", SampleTime="-1")  # fmt: skip
def sine(site: BlockContext) -> SignalOrBus:
    """The wave amplitude sin(angle) + bias, its angle frequency t + phase, or 2 pi (hit + offset) / samples."""
    if site.chosen("SineType", "Time based", "Sample based") == "Sample based":
        angle = _angle_of_hit(site)
    else:
        t = site.time if site.text("TimeSource") == "Use simulation time" else site.input()
        angle = site.call("add", site.call("mul", site.parameter("Frequency"), t), site.parameter("Phase"))
    wave = site.call("mul", site.parameter("Amplitude"), site.call("sin", angle))
    return site.call("add", wave, site.parameter("Bias"))


def _angle_of_hit(site: BlockContext) -> Signal:
    sample = site.compiler.timing.stated_period(site.atom)
    if sample is None or not 0 < sample < CONSTANT:
        raise UnsupportedError("it counts samples, and its sample time is inherited")
    hit = site.call("floor", site.call("add", site.call("div", site.time, site.constant(sample)), site.constant(1e-6)))
    turns = site.call("div", site.call("add", hit, site.parameter("Offset")), site.parameter("Samples"))
    return site.call("mul", site.constant(2 * np.pi), turns)


@block("chirp", "Chirp Signal", linked=True, f1="0.1", T="100", f2="1")
def chirp(site: BlockContext) -> SignalOrBus:
    """A sine whose frequency rises from f1 at 0 s to f2 at T, and on."""
    f1, f2, t = site.parameter("f1"), site.parameter("f2"), site.time
    rate = site.call("div", site.call("sub", f2, f1), site.call("mul", site.constant(2.0), site.parameter("T")))
    turns = site.call("mul", t, site.call("add", f1, site.call("mul", rate, t)))
    return site.call("sin", site.call("mul", site.constant(2 * np.pi), turns))


@block("SignalGenerator", WaveForm="sine", Amplitude="1", Frequency="1", Units="Hertz",
       TimeSource="Use simulation time")  # fmt: skip
def generator(site: BlockContext) -> SignalOrBus:
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
def pulses(site: BlockContext) -> SignalOrBus:
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
    near = site.constant(1e-6 * (site.compiler.clock.step or 0.0))
    since = site.call("add", site.call("sub", site.time, site.constant(delay)), near)
    within = site.call("mod", since, site.constant(period))
    high = site.call("lt", within, site.constant(width))
    started = site.call("ge", since, site.constant(0.0))
    made = site.select(site.call("and", started, high), site.parameter("Amplitude"), site.constant(0.0))
    return site.compiler.timing.at_major(made)


@block("FromFile", "FromSpreadsheet", "Signal Editor", "RandomNumber", "UniformRandomNumber", "Random Number",
       "Sigbuilder block", "Band-Limited White Noise.", "Band-Limited White Noise", refused=True)  # fmt: skip
def recorded(site: BlockContext) -> SignalOrBus:
    """A signal that is not in the model."""
    raise UnsupportedError("its signal is recorded or random and not part of the model", _BIND)


@block("Repeating Sequence Stair", sample="", OutValues="[3 1 4 2 1].'", tsamp="-1")
def stairs(site: BlockContext) -> SignalOrBus:
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


def pulse_times(atom: FlatBlock, expressions: Expressions) -> list[float]:
    """The times between which a block's pulses change, in s; none of other blocks. Raises `NoValueError`."""
    if atom.kind != "DiscretePulseGenerator":
        return []
    block, defaults = atom.block, BLOCK_TYPES[atom.kind].defaults

    def number(name: str, default: str = "") -> float:
        found = expressions.numbers(block.value(name) or defaults.get(name, default), atom.scope)
        if found.size != 1:
            raise EvaluationError(f"its {name} has {found.size} values where one is expected")
        return float(found.item())

    if (block.value("PulseType") or defaults["PulseType"]) != "Time based":
        return [number("SampleTime", "1")]
    period = number("Period")
    return [period, period * number("PulseWidth") / 100, number("PhaseDelay")]


class _RecordedSeries(NamedTuple):
    times: Numbers
    values: Numbers


@block("Repeating table", "Repeating Sequence", linked=True, rep_seq_t="[0 2]", rep_seq_y="[0 2]")
def repeating_sequence(site: BlockContext) -> SignalOrBus:
    """Lines between points, from the first to the last, again and again."""
    times, values = site.numbers("rep_seq_t").ravel(), site.numbers("rep_seq_y").ravel()
    _checked(times, values[:, None])
    if not times[-1] > times[0]:
        raise UnsupportedError("its points are all at one time")
    span = site.constant(float(times[-1] - times[0]))
    since = site.call("mod", site.call("sub", _now(site), site.constant(float(times[0]))), span)
    within = site.call("add", since, site.constant(float(times[0])))
    return _line(site, "rep_seq_y", within, _RecordedSeries(times, values), "clip")


@block("FromWorkspace", VariableName="simulink_input", Interpolate="on", OutputAfterFinalValue="Extrapolation",
       SampleTime="0")  # fmt: skip
def from_workspace(site: BlockContext) -> SignalOrBus:
    """The columns of a matrix over its first one, the time."""
    points = _points(site)
    times, values = points[:, 0], points[:, 1:]
    _checked(times, values)
    if times[0] > 0:
        raise UnsupportedError(f"its points begin at {times[0]:g} s, after the start", _BIND)
    last = site.text("OutputAfterFinalValue")
    columns = [_column(site, f"column {at}", _RecordedSeries(times, one), last) for at, one in enumerate(values.T, 2)]
    nodes = np.array([one.flat[0] for one in columns], dtype=np.int64)
    return Signal(nodes, CONTINUOUS)


def _points(site: BlockContext) -> Numbers:
    """The matrix of a field; other variables hold recordings."""
    try:
        points = site.numbers("VariableName")
    except UnsupportedError as error:
        raise UnsupportedError(f"its signal is recorded and not part of the model: {error.message}", _BIND) from None
    if points.shape[0] < 2 or points.shape[1] < 2:
        raise UnsupportedError("its signal is no matrix of times and values", _BIND)
    return points


def _checked(times: Numbers, values: Numbers) -> None:
    if len(times) != len(values) or len(times) < 2:
        raise UnsupportedError(f"it has {len(values)} values at {len(times)} times")
    if not (np.all(np.diff(times) >= 0) and np.all(np.isfinite(times)) and np.all(np.isfinite(values))):
        raise UnsupportedError("its times do not increase, or a value is not finite", _BIND)


def _now(site: BlockContext) -> Signal:
    """The time, raised by what rounding may have taken from it."""
    return site.call("add", site.time, site.constant(1e-9 * (site.compiler.clock.step or 0.0)))


def _column(site: BlockContext, label: str, points: _RecordedSeries, last: str) -> Signal:
    now = _now(site)
    if site.on("Interpolate"):
        y = _line(site, label, site.time, points, "linear" if last == "Extrapolation" else "clip")
    else:
        y = _stairs(site, now, points)
    match last:
        case "Extrapolation" | "Holding final value":
            return y
        case "Setting to zero":
            return site.select(site.call("gt", now, site.constant(_end(site, points))), site.constant(0.0), y)
    raise UnsupportedError(f"OutputAfterFinalValue is {last!r}, which is not supported", _BIND)


def _end(site: BlockContext, points: _RecordedSeries) -> float:
    return float(points.times[-1]) + 1e-6 * (site.compiler.clock.step or 0.0)


def _stairs(site: BlockContext, now: Signal, points: _RecordedSeries) -> Signal:
    if len(points.times) > _MOST_STEPS:
        raise UnsupportedError(f"it has {len(points.times)} steps; {_MOST_STEPS} are the most", _BIND)
    y = site.constant(float(points.values[0]))
    for time, value in zip(points.times[1:], points.values[1:], strict=True):
        y = site.select(site.call("ge", now, site.constant(float(time))), site.constant(float(value)), y)
    return y


def _line(site: BlockContext, label: str, x: Signal, points: _RecordedSeries, beyond: str) -> Signal:
    """Lines between points; where two are at one time, the signal jumps there."""
    times = points.times
    ends = [0, *(np.flatnonzero(np.diff(times) == 0) + 1), len(times)]
    if len(ends) > _MOST_STEPS:
        raise UnsupportedError(f"it jumps at {len(ends) - 2} times; {_MOST_STEPS} are the most", _BIND)
    near = site.call("add", x, site.constant(1e-9 * (site.compiler.clock.step or 0.0)))
    y: Signal | None = None
    for number, (first, end) in enumerate(pairwise(ends), 1):
        name = label if len(ends) == 2 else f"{label}, part {number}"
        part = _RecordedSeries(times[first:end], points.values[first:end])
        piece = _piece(site, name, x, part, beyond if end == len(times) else "clip")
        begun = site.call("ge", near, site.constant(float(times[first])))
        y = piece if y is None else site.select(begun, piece, y)
    assert y is not None
    return y


def _piece(site: BlockContext, name: str, x: Signal, points: _RecordedSeries, beyond: str) -> Signal:
    if len(points.times) == 1:
        return site.constant(float(points.values[0]))
    return constant_curve(site, name, x, points.times, points.values, Method("linear", beyond))
