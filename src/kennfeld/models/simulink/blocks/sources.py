"""Sources library: signals of time and parameters, and recorded signals stored in the model."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Numbers
from kennfeld.models.simulink.blocks.lookup_tables import Method, constant_curve
from kennfeld.models.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.models.simulink.flattening.flat_model import FlatBlock
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES, block
from kennfeld.models.simulink.signals import CONSTANT, CONTINUOUS, Signal, SignalOrBus, scalar

_BIND = "Bind it to a measured channel."

_MAX_STEPS = 2000  # of a piecewise constant signal; each takes a comparison


@block("Constant", Value="1", SampleTime="inf", VectorParams1D="on")
def constant(block: BlockContext) -> SignalOrBus:
    """Return a constant or a variable."""
    return Signal(_vector(block, "Value").nodes, CONSTANT)


@block("EnumeratedConstant", "Enumerated Constant", Value="SlDemoSign.Positive", SampleTime="inf")
def enumerated_constant(block: BlockContext) -> SignalOrBus:
    """Return the integer of an enumeration member."""
    return block.parameter("Value")


def _vector(block: BlockContext, name: str) -> Signal:
    if block.field_text("VectorParams1D", "on") == "on":
        return block.parameter(name)
    return Signal(block.matrix(name), CONSTANT)


@block("Clock", SampleTime="-1")
def clock(block: BlockContext) -> SignalOrBus:
    """Return the time since the start in s."""
    return block.time


@block("DigitalClock", "Digital Clock", SampleTime="1")
def digital_clock(block: BlockContext) -> SignalOrBus:
    """Return the time since the start in s at the hits of the sample time."""
    return block.time


@block("Step", Time="1", Before="0", After="1", SampleTime="-1")
def step(block: BlockContext) -> SignalOrBus:
    """Switch from one value to another at a time."""
    return block.select(
        _is_reached(block, block.parameter("Time")), block.parameter("After"), block.parameter("Before")
    )


def _is_reached(block: BlockContext, time: Signal) -> Signal:
    near = 1e-6 * (block.compiler.clock.step or 0.0)
    return block.apply("ge", block.apply("add", block.time, block.constant(near)), time)


@block("Ramp", slope="1", start="0", InitialOutput="0")
def ramp(block: BlockContext) -> SignalOrBus:
    """Return a line that starts to rise at a time."""
    start = block.parameter("start")
    since = block.apply("max", block.apply("sub", block.time, start), block.constant(0.0))
    first = block.parameter("X0" if block.field_text("X0", "") else "InitialOutput")  # X0 in older files
    return block.apply("add", first, block.apply("mul", block.parameter("slope"), since))


@block("Sin", SineType="Time based", TimeSource="Use simulation time", Amplitude="1", Bias="0", Frequency="1",
       Phase="0", Samples="10", Offset="0", SampleTime="-1")  # fmt: skip
def sine(block: BlockContext) -> SignalOrBus:
    """Return amplitude sin(angle) + bias with the angle frequency t + phase, or 2 pi (sample + offset) / samples."""
    if block.option("SineType", "Time based", "Sample based") == "Sample based":
        angle = _angle_of_hit(block)
    else:
        t = block.time if block.field_text("TimeSource") == "Use simulation time" else block.input()
        angle = block.apply("add", block.apply("mul", block.parameter("Frequency"), t), block.parameter("Phase"))
    wave = block.apply("mul", block.parameter("Amplitude"), block.apply("sin", angle))
    return block.apply("add", wave, block.parameter("Bias"))


def _angle_of_hit(block: BlockContext) -> Signal:
    sample = block.compiler.timing.specified_period(block.flat)
    if sample is None or not 0 < sample < CONSTANT:
        raise UnsupportedError("it counts samples, but its sample time is inherited")
    hit = block.apply(
        "floor", block.apply("add", block.apply("div", block.time, block.constant(sample)), block.constant(1e-6))
    )
    turns = block.apply("div", block.apply("add", hit, block.parameter("Offset")), block.parameter("Samples"))
    return block.apply("mul", block.constant(2 * np.pi), turns)


@block("chirp", "Chirp Signal", linked=True, f1="0.1", T="100", f2="1")
def chirp(block: BlockContext) -> SignalOrBus:
    """Return a sine whose frequency rises linearly from f1 at 0 s to f2 at T and beyond."""
    f1, f2, t = block.parameter("f1"), block.parameter("f2"), block.time
    rate = block.apply("div", block.apply("sub", f2, f1), block.apply("mul", block.constant(2.0), block.parameter("T")))
    turns = block.apply("mul", t, block.apply("add", f1, block.apply("mul", rate, t)))
    return block.apply("sin", block.apply("mul", block.constant(2 * np.pi), turns))


@block("SignalGenerator", WaveForm="sine", Amplitude="1", Frequency="1", Units="Hertz",
       TimeSource="Use simulation time")  # fmt: skip
def generator(block: BlockContext) -> SignalOrBus:
    """Return a sine, or a square wave that starts low; other wave forms are random or depend on rounding."""
    form = block.field_text("WaveForm")
    if form not in ("sine", "square"):
        raise UnsupportedError(f"its wave form {form[:40]!r} is not supported, only sine and square", _BIND)
    t = block.time if block.field_text("TimeSource") == "Use simulation time" else block.input()
    amplitude, frequency, whole = block.parameter("Amplitude"), block.parameter("Frequency"), block.constant(2 * np.pi)
    in_hertz = block.option("Units", "Hertz", "rad/sec") == "Hertz"
    if form == "sine":
        angle = block.apply("mul", block.apply("mul", frequency, whole) if in_hertz else frequency, t)
        return block.apply("mul", amplitude, block.apply("sin", angle))
    turns = block.apply("mul", frequency if in_hertz else block.apply("div", frequency, whole), t)
    upper = block.apply("ge", block.apply("sub", turns, block.apply("floor", turns)), block.constant(0.5))
    return block.select(upper, amplitude, block.apply("neg", amplitude))


@block("DiscretePulseGenerator", PulseType="Sample based", TimeSource="Use simulation time", Amplitude="1", Period="2",
       PulseWidth="1", PhaseDelay="0")  # fmt: skip
def pulses(block: BlockContext) -> SignalOrBus:
    """Return pulses with `Period`, `PulseWidth` (percent of the period) and `PhaseDelay`, in s or in samples."""
    block.option("TimeSource", "Use simulation time")
    period, delay = block.numeric_field("Period"), block.numeric_field("PhaseDelay")
    width = block.numeric_field("PulseWidth") * (period / 100)
    if block.option("PulseType", "Time based", "Sample based") == "Sample based":
        sample = block.numeric_field("SampleTime", "1")
        if sample <= 0:
            raise UnsupportedError("it counts samples, but its sample time is inherited")
        period, delay, width = period * sample, delay * sample, block.numeric_field("PulseWidth") * sample
    if not period > 0:
        raise UnsupportedError(f"its Period must be > 0, got {period:g}")
    near = block.constant(1e-6 * (block.compiler.clock.step or 0.0))
    since = block.apply("add", block.apply("sub", block.time, block.constant(delay)), near)
    within = block.apply("mod", since, block.constant(period))
    high = block.apply("lt", within, block.constant(width))
    started = block.apply("ge", since, block.constant(0.0))
    result = block.select(block.apply("and", started, high), block.parameter("Amplitude"), block.constant(0.0))
    return block.compiler.timing.hold_in_minor_steps(result)


@block("FromFile", "FromSpreadsheet", "Signal Editor", "RandomNumber", "UniformRandomNumber", "Random Number",
       "Sigbuilder block", "Band-Limited White Noise.", "Band-Limited White Noise", refused=True)  # fmt: skip
def recorded(block: BlockContext) -> SignalOrBus:
    """Refuse a signal that is not part of the model."""
    raise UnsupportedError("its signal is recorded or random and not part of the model", _BIND)


@block("Repeating Sequence Stair", sample="", OutValues="[3 1 4 2 1].'", tsamp="-1")
def stairs(block: BlockContext) -> SignalOrBus:
    """Return a periodic sequence of values."""
    values = block.parameter("OutValues").flat
    sample = block.numeric_field("tsamp")
    dt = block.constant(sample) if sample > 0 else block.base_step
    count = block.apply("floor", block.apply("add", block.apply("div", block.time, dt), block.constant(1e-6)))
    at = block.apply("mod", count, block.constant(float(len(values))))
    result = scalar(values[-1])
    for place in reversed(range(len(values) - 1)):
        here = scalar(values[place])
        result = block.select(block.apply("lt", at, block.constant(place + 0.5)), here, result)
    return result


def pulse_times(flat: FlatBlock, expressions: ParameterExpressions) -> list[float]:
    """Return the times in s between which a pulse generator switches, [] for other blocks; raises `EvaluationError`."""
    if flat.type != "DiscretePulseGenerator":
        return []
    block, defaults = flat.block, BLOCK_TYPES[flat.type].defaults

    def number(name: str, default: str = "") -> float:
        numbers = expressions.numbers(block.value(name) or defaults.get(name, default), flat.scope)
        if numbers.size != 1:
            raise EvaluationError(f"its {name} must be scalar, got {numbers.size} values")
        return float(numbers.item())

    if (block.value("PulseType") or defaults["PulseType"]) != "Time based":
        return [number("SampleTime", "1")]
    period = number("Period")
    return [period, period * number("PulseWidth") / 100, number("PhaseDelay")]


class _RecordedSeries(NamedTuple):
    times: Numbers
    values: Numbers


@block("Repeating table", "Repeating Sequence", linked=True, rep_seq_t="[0 2]", rep_seq_y="[0 2]")
def repeating_sequence(block: BlockContext) -> SignalOrBus:
    """Interpolate a periodic sequence of points linearly."""
    times, values = block.numeric_array("rep_seq_t").ravel(), block.numeric_array("rep_seq_y").ravel()
    _checked(times, values[:, None])
    if not times[-1] > times[0]:
        raise UnsupportedError("its points all have the same time")
    span = block.constant(float(times[-1] - times[0]))
    since = block.apply("mod", block.apply("sub", _current_time(block), block.constant(float(times[0]))), span)
    within = block.apply("add", since, block.constant(float(times[0])))
    return _line(block, "rep_seq_y", within, _RecordedSeries(times, values), "clip")


@block("FromWorkspace", VariableName="simulink_input", Interpolate="on", OutputAfterFinalValue="Extrapolation",
       SampleTime="0")  # fmt: skip
def from_workspace(block: BlockContext) -> SignalOrBus:
    """Interpolate the columns of a matrix over its first one, the time."""
    points = _points(block)
    times, values = points[:, 0], points[:, 1:]
    _checked(times, values)
    if times[0] > 0:
        raise UnsupportedError(f"its points must begin at 0 s, got {times[0]:g} s", _BIND)
    last = block.field_text("OutputAfterFinalValue")
    columns = [
        _column(block, f"column {at}", _RecordedSeries(times, column), last) for at, column in enumerate(values.T, 2)
    ]
    nodes = np.array([signal.flat[0] for signal in columns], dtype=np.int64)
    return Signal(nodes, CONTINUOUS)


def _points(block: BlockContext) -> Numbers:
    """Return the matrix of a field; other variables hold recordings."""
    try:
        points = block.numeric_array("VariableName")
    except UnsupportedError as error:
        raise UnsupportedError(f"its signal is recorded and not part of the model: {error.message}", _BIND) from None
    if points.shape[0] < 2 or points.shape[1] < 2:
        raise UnsupportedError("its signal is not a matrix of times and values", _BIND)
    return points


def _checked(times: Numbers, values: Numbers) -> None:
    if len(times) != len(values) or len(times) < 2:
        raise UnsupportedError(f"it has {len(values)} values for {len(times)} times")
    if not (np.all(np.diff(times) >= 0) and np.all(np.isfinite(times)) and np.all(np.isfinite(values))):
        raise UnsupportedError("its times must increase, and its values must be finite", _BIND)


def _current_time(block: BlockContext) -> Signal:
    """Return the time, raised by a rounding tolerance."""
    return block.apply("add", block.time, block.constant(1e-9 * (block.compiler.clock.step or 0.0)))


def _column(block: BlockContext, label: str, points: _RecordedSeries, last: str) -> Signal:
    now = _current_time(block)
    if block.is_on("Interpolate"):
        y = _line(block, label, block.time, points, "linear" if last == "Extrapolation" else "clip")
    else:
        y = _stairs(block, now, points)
    match last:
        case "Extrapolation" | "Holding final value":
            return y
        case "Setting to zero":
            return block.select(block.apply("gt", now, block.constant(_end(block, points))), block.constant(0.0), y)
    raise UnsupportedError(f"OutputAfterFinalValue {last!r} is not supported", _BIND)


def _end(block: BlockContext, points: _RecordedSeries) -> float:
    return float(points.times[-1]) + 1e-6 * (block.compiler.clock.step or 0.0)


def _stairs(block: BlockContext, now: Signal, points: _RecordedSeries) -> Signal:
    if len(points.times) > _MAX_STEPS:
        raise UnsupportedError(f"it has {len(points.times)} steps; at most {_MAX_STEPS} are supported", _BIND)
    y = block.constant(float(points.values[0]))
    for time, value in zip(points.times[1:], points.values[1:], strict=True):
        y = block.select(block.apply("ge", now, block.constant(float(time))), block.constant(float(value)), y)
    return y


def _line(block: BlockContext, label: str, x: Signal, points: _RecordedSeries, beyond: str) -> Signal:
    """Interpolate between points; two points at the same time are a jump."""
    times = points.times
    ends = [0, *(np.flatnonzero(np.diff(times) == 0) + 1), len(times)]
    if len(ends) > _MAX_STEPS:
        raise UnsupportedError(f"it has {len(ends) - 2} discontinuities; at most {_MAX_STEPS} are supported", _BIND)
    near = block.apply("add", x, block.constant(1e-9 * (block.compiler.clock.step or 0.0)))
    y: Signal | None = None
    for number, (first, end) in enumerate(pairwise(ends), 1):
        name = label if len(ends) == 2 else f"{label}, part {number}"
        part = _RecordedSeries(times[first:end], points.values[first:end])
        piece = _piece(block, name, x, part, beyond if end == len(times) else "clip")
        begun = block.apply("ge", near, block.constant(float(times[first])))
        y = piece if y is None else block.select(begun, piece, y)
    assert y is not None
    return y


def _piece(block: BlockContext, name: str, x: Signal, points: _RecordedSeries, beyond: str) -> Signal:
    if len(points.times) == 1:
        return block.constant(float(points.values[0]))
    return constant_curve(block, name, x, points.times, points.values, Method("linear", beyond))
