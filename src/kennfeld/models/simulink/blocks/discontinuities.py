"""Discontinuities library: saturation, dead zone, relay, backlash, rate limiter, friction."""

from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.reader.model_tree import ModelBlock
from kennfeld.models.simulink.signals import CONTINUOUS, Signal, SignalOrBus


@block("Saturate", UpperLimit="0.5", LowerLimit="-0.5", UpperLimitSource="Dialog", LowerLimitSource="Dialog",
       SampleTime="-1")  # fmt: skip
def saturate(block: BlockContext) -> SignalOrBus:
    """Limit the input."""
    if "Input port" in (block.field_text("UpperLimitSource"), block.field_text("LowerLimitSource")):
        raise UnsupportedError(
            "its limits are inputs, which is not supported", "Use a Saturation Dynamic block instead."
        )
    return block.clip(block.input(), block.parameter("LowerLimit"), block.parameter("UpperLimit"))


@block("Saturation Dynamic")
def saturation_dynamic(block: BlockContext) -> SignalOrBus:
    """Limit the second input to the range from the third to the first input."""
    up, u, low = (block.input(at) for at in range(3))
    clipped = block.select(block.apply("lt", u, low), low, u)
    return block.select(block.apply("gt", u, up), up, clipped)


@block("DeadZone", LowerValue="-0.5", UpperValue="0.5", SampleTime="-1")
def dead_zone(block: BlockContext) -> SignalOrBus:
    """Return 0 inside the zone, the distance from it outside."""
    return _zone(block, block.parameter("LowerValue"), block.parameter("UpperValue"), block.input())


@block("Dead Zone Dynamic")
def dead_zone_dynamic(block: BlockContext) -> SignalOrBus:
    """Return a dead zone of the second input between the third and the first input."""
    return _zone(block, block.input(2), block.input(0), block.input(1))


def _zone(block: BlockContext, low: Signal, high: Signal, u: Signal) -> Signal:
    below = block.select(block.apply("lt", u, low), block.apply("sub", u, low), block.constant(0.0))
    return block.select(block.apply("gt", u, high), block.apply("sub", u, high), below)


@block("Wrap To Zero", Threshold="255")
def wrap_to_zero(block: BlockContext) -> SignalOrBus:
    """Return the input up to a threshold, 0 above it."""
    u = block.input()
    return block.select(block.apply("gt", u, block.parameter("Threshold")), block.constant(0.0), u)


@block("Quantizer", QuantizationInterval="0.5", SampleTime="-1")
def quantizer(block: BlockContext) -> SignalOrBus:
    """Round the input to a multiple of the quantization interval."""
    q = block.parameter("QuantizationInterval")
    return block.apply("mul", q, block.apply("round", block.apply("div", block.input(), q)))


@block("Relay", OnSwitchValue="eps", OffSwitchValue="eps", OnOutputValue="1", OffOutputValue="0", SampleTime="-1")
def relay(block: BlockContext) -> SignalOrBus:
    """Switch on at one value and off at another, hold in between; initially off."""
    u = block.hold_in_minor_steps(block.input())
    on, off = block.parameter("OnSwitchValue"), block.parameter("OffSwitchValue")
    one, zero = block.constant(1.0), block.constant(0.0)
    state: list[Signal] = []
    before = block.discrete_state(zero, lambda _: state[0])
    kept = block.select(block.apply("le", u, off), zero, before)
    state.append(block.select(block.apply("ge", u, on), one, kept))
    return block.select(state[0], block.parameter("OnOutputValue"), block.parameter("OffOutputValue"))


@block("Backlash", BacklashWidth="1", InitialOutput="0", SampleTime="-1")
def backlash(block: BlockContext) -> SignalOrBus:
    """Return an output that the input moves once it leaves the dead band."""
    u = block.hold_in_minor_steps(block.input())
    half = block.apply("mul", block.constant(0.5), block.parameter("BacklashWidth"))
    signals: list[Signal] = []
    before = block.discrete_state(block.parameter("InitialOutput"), lambda _: signals[0])
    lifted = block.apply("max", before, block.apply("sub", u, half))
    signals.append(block.apply("min", lifted, block.apply("add", u, half)))
    return signals[0]


def _sample_of_limiter(block: ModelBlock) -> str:
    """Return the field with the sample time; a rate limiter runs in every step unless it inherits it."""
    return "SampleTime" if block.value("SampleTimeMode") == "inherited" else "ContinuousTime"


@block("RateLimiter", sample=_sample_of_limiter, RisingSlewLimit="1", FallingSlewLimit="-1", InitialCondition="0",
       SampleTimeMode="continuous", SampleTime="-1", ContinuousTime="0")  # fmt: skip
def rate_limiter(block: BlockContext) -> SignalOrBus:
    """Limit the rate of the input; start at the initial value, or in continuous time at the input."""
    mode = block.option("SampleTimeMode", "continuous", "inherited")
    u = block.hold_in_minor_steps(block.input())
    in_time = mode == "continuous" or (block.compiler.clock.continuous and block.period() == CONTINUOUS)
    init = u if in_time else block.parameter("InitialCondition")
    return _limited(block, u, block.parameter("RisingSlewLimit"), block.parameter("FallingSlewLimit"), init)


@block("Rate Limiter Dynamic", InitialCondition="0")
def rate_limiter_dynamic(block: BlockContext) -> SignalOrBus:
    """Limit the rate of the second input; rising limit at the first input, falling limit at the third."""
    u = block.hold_in_minor_steps(block.input(1))
    return _limited(block, u, block.input(0), block.input(2), block.parameter("InitialCondition"))


def _limited(block: BlockContext, u: Signal, up: Signal, down: Signal, init: Signal) -> Signal:
    signals: list[Signal] = []
    before = block.discrete_state(init, lambda _: signals[0])
    step = block.sample_step()
    moved = block.clip(block.apply("sub", u, before), block.apply("mul", down, step), block.apply("mul", up, step))
    signals.append(block.apply("add", before, moved))
    return signals[0]


@block("Coulomb & Viscous Friction", offset="[1 3 2 0]", gain="1")
def friction(block: BlockContext) -> SignalOrBus:
    """Return friction in the direction of the input: sign(u) (gain |u| + offset)."""
    u = block.input()
    size = block.apply(
        "add", block.apply("mul", block.parameter("gain"), block.apply("abs", u)), block.parameter("offset")
    )
    return block.apply("mul", block.apply("sign", u), size)
