"""Sources library: signals of time and parameters."""

import numpy as np

from kennfeld.importers.simulink.blocks.bus_values import fit_to_bus, parameter_or_bus
from kennfeld.importers.simulink.blocks.lookup_tables import lookup_field, named_method, table_axes
from kennfeld.importers.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.lowering import (
    ARITHMETIC,
    BLOCK_TYPES,
    BlockContext,
    OutputType,
    UnsupportedError,
    block,
)
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.signals import (
    CONSTANT,
    Bus,
    Signal,
    SignalOrBus,
    apply,
    select,
    select_by_index,
)
from kennfeld.importers.simulink.variables.data_types import BusType
from kennfeld.models.imperative.evaluation_errors import EvaluationError

_BIND = "Bind it to a measured channel."


@block("Constant", output=OutputType(floating=True, states=True), Value="1", SampleTime="inf", VectorParams1D="on")
def constant(block: BlockContext) -> SignalOrBus:
    """Return a constant or a variable; a struct is a bus."""
    value = parameter_or_bus(block, "Value")
    if isinstance(block.output_type, BusType):
        return fit_to_bus(block, block.output_type, value, fill=True)
    if isinstance(value, Bus):
        return value
    if not block.is_set_to("VectorParams1D", "on", default="on"):
        value = block.signal(block.matrix("Value"), CONSTANT)
    return apply("ne", value, 0.0) if block.is_boolean else value


@block("EnumeratedConstant", "Enumerated Constant", library_mask=True, Value="SlDemoSign.Positive", SampleTime="inf")
def enumerated_constant(block: BlockContext) -> SignalOrBus:
    """Return the integer of an enumeration member."""
    return block.parameter("Value")


@block("Clock", output=ARITHMETIC, SampleTime="-1")
@block("DigitalClock", "Digital Clock", output=ARITHMETIC, SampleTime="1")
def clock(block: BlockContext) -> SignalOrBus:
    """Return the time since the start in s, for a digital clock at the hits of its sample time."""
    return block.time


@block("Step", output=ARITHMETIC, Time="1", Before="0", After="1", SampleTime="-1")
def step(block: BlockContext) -> SignalOrBus:
    """Switch from one value to another at a time."""
    reached = block.time + block.time_tolerance() >= block.parameter("Time")
    return select(reached, block.parameter("After"), block.parameter("Before"))


@block("Ramp", output=ARITHMETIC, library_mask=True, slope="1", start="0", InitialOutput="0")
def ramp(block: BlockContext) -> SignalOrBus:
    """Rise along a line from a time in s on."""
    start = block.parameter("start")
    since = apply("max", block.time - start, 0.0)
    first = block.parameter("X0" if block.field_text("X0", "") else "InitialOutput")  # X0 in older files
    return first + block.parameter("slope") * since


@block("Sin", output=ARITHMETIC,
       SineType="Time based", TimeSource="Use simulation time", Amplitude="1", Bias="0", Frequency="1",
       Phase="0", Samples="10", Offset="0", SampleTime="-1")  # fmt: skip
def sine(block: BlockContext) -> SignalOrBus:
    """Compute amplitude sin(angle) + bias; the angle is frequency t + phase, or 2 pi (sample + offset) / samples."""
    if block.option("SineType", "Time based", "Sample based") == "Sample based":
        angle = _angle_of_hit(block)
    else:
        t = block.time if block.is_set_to("TimeSource", "Use simulation time") else block.input()
        angle = block.parameter("Frequency") * t + block.parameter("Phase")
    return block.parameter("Amplitude") * apply("sin", angle) + block.parameter("Bias")


def _angle_of_hit(block: BlockContext) -> Signal:
    sample = block.compiler.timing.specified_period(block.flat)
    if sample is None or not 0 < sample < CONSTANT:
        raise UnsupportedError("it counts samples, but its sample time is inherited")
    # 0.3 s / 0.1 s is a little below 3, which would repeat a sample
    hit = apply("floor", block.time / sample + 1e-6)
    return 2 * np.pi * ((hit + block.parameter("Offset")) / block.parameter("Samples"))


@block("chirp", "Chirp Signal", output=ARITHMETIC, linked=True, f1="0.1", T="100", f2="1")
def chirp(block: BlockContext) -> SignalOrBus:
    """Lower a sine whose frequency rises linearly from f1 in Hz at 0 s to f2 at T in s and beyond."""
    f1, f2, t = block.parameter("f1"), block.parameter("f2"), block.time
    # phase = 2 pi integral(f1 + (f2 - f1) t / T)
    rate = (f2 - f1) / (2.0 * block.parameter("T"))
    return apply("sin", 2 * np.pi * (t * (f1 + rate * t)))


@block("SignalGenerator", output=ARITHMETIC, WaveForm="sine", Amplitude="1", Frequency="1", Units="Hertz",
       TimeSource="Use simulation time")  # fmt: skip
def generator(block: BlockContext) -> SignalOrBus:
    """Lower a sine, a square wave that starts low, or a sawtooth that falls; another wave form is random."""
    written = block.field_text("WaveForm")
    form = match_word(written, ("sine", "square", "sawtooth"))
    if form is None:
        raise UnsupportedError(
            f"its wave form {written[:40]!r} is not supported, only sine, square and sawtooth", _BIND
        )
    t = block.time if block.is_set_to("TimeSource", "Use simulation time") else block.input()
    amplitude, frequency = block.parameter("Amplitude"), block.parameter("Frequency")
    in_hertz = block.option("Units", "Hertz", "rad/sec") == "Hertz"
    if form == "sine":
        return amplitude * apply("sin", (frequency * (2 * np.pi) if in_hertz else frequency) * t)
    turns = (frequency if in_hertz else frequency / (2 * np.pi)) * t
    part = turns - apply("floor", turns)
    if form == "sawtooth":
        return (1.0 - part * 2.0) * amplitude  # as generated code has it
    return select(part >= 0.5, amplitude, -amplitude)


@block("DiscretePulseGenerator", output=ARITHMETIC, PulseType="Sample based", TimeSource="Use simulation time",
       Amplitude="1", Period="2", PulseWidth="1", PhaseDelay="0")  # fmt: skip
def pulses(block: BlockContext) -> SignalOrBus:
    """Lower pulses with `Period`, `PulseWidth` (percent of the period) and `PhaseDelay`, in s or in samples."""
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
    # an edge at a sample must not slip to the next one by rounding
    since = block.time - delay + block.time_tolerance()
    high = (since >= 0.0) & (since % period < width)
    return block.hold_in_minor_steps(select(high, block.parameter("Amplitude"), 0.0))


@block("RandomNumber", "UniformRandomNumber", "Random Number", "Band-Limited White Noise.", "Band-Limited White Noise",
       refused=True)  # fmt: skip
def refuse_noise(block: BlockContext) -> SignalOrBus:
    """Refuse a random signal, of which no recording could be explained."""
    raise UnsupportedError("its signal is random and not part of the model", _BIND)


@block("Repeating Sequence Stair", sample="", OutValues="[3 1 4 2 1].'", tsamp="-1")
def stairs(block: BlockContext) -> SignalOrBus:
    """Repeat a sequence of values, each for a sample."""
    values = block.parameter("OutValues").flat
    sample = block.numeric_field("tsamp")
    dt = block.constant(sample) if sample > 0 else block.base_step
    count = apply("floor", block.time / dt + 1e-6)
    return select_by_index(count % float(len(values)), [block.signal([value]) for value in values], 0.5)


@block("Repeating Sequence Interpolated", output=ARITHMETIC, sample="tsamp",
       OutValues="[3 1 4 2 1].'", TimeValues="[0 0.1 0.5 0.6 1].'", LookUpMeth="Interpolation-Use End Values",
       tsamp="0.01")  # fmt: skip
def interpolated_sequence(block: BlockContext) -> SignalOrBus:
    """Repeat a sequence of points, interpolated at the sample hits; its last value is the last one of a period."""
    (axis,) = table_axes(block, "OutValues", ["TimeValues"])
    specified = block.numeric_field("tsamp")
    sample = specified if specified > 0 else block.compiler.clock.step
    if not sample:
        raise UnsupportedError("it counts samples, but its sample time is inherited and the data define the step")
    # Simulink counts its samples from 0 to that of the last time, as the counter in its generated code shows
    last = float(axis.breakpoints[-1])
    count = round(last / sample)
    if count < 0 or abs(last / sample - count) > 1e-6:
        message = f"its last time, {last:g} s, must be a multiple of its sample time, {sample:g} s"
        raise UnsupportedError(message, "Change tsamp or the last of TimeValues.")
    hit = apply("floor", block.time / sample + 1e-6) % float(count + 1)
    return lookup_field(block, "OutValues", [axis], [hit * sample], named_method(block))


def pulse_times(flat: FlatBlock, expressions: ParameterExpressions) -> list[float]:
    """List the times in s between which a pulse generator switches, [] for other blocks; raises `EvaluationError`."""
    if flat.type != "DiscretePulseGenerator":
        return []
    block, defaults = flat.block, BLOCK_TYPES[flat.type].defaults

    def number(name: str, default: str = "") -> float:
        numbers = expressions.numbers(block.value(name) or defaults.get(name, default), flat.scope)
        if numbers.size != 1:
            raise EvaluationError(f"its {name} must be scalar, got {numbers.size} values")
        return float(numbers.item())

    if not block.is_set_to("PulseType", "Time based", default=defaults["PulseType"]):
        return [number("SampleTime", "1")]
    period = number("Period")
    # a step that divides all three hits every edge
    return [period, period * number("PulseWidth") / 100, number("PhaseDelay")]
