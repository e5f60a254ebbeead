"""Discontinuities library: saturation, dead zone, hit crossing, relay, backlash, rate limiter, friction."""

from kennfeld.importers.simulink.lowering import ARITHMETIC, BlockContext, UnsupportedError, block
from kennfeld.importers.simulink.reader.model_tree import ModelBlock
from kennfeld.importers.simulink.signals import CONTINUOUS, Signal, SignalOrBus, apply, clip, select


@block("Saturate", output=ARITHMETIC,
       UpperLimit="0.5", LowerLimit="-0.5", UpperLimitSource="Dialog", LowerLimitSource="Dialog",
       SampleTime="-1")  # fmt: skip
def saturate(block: BlockContext) -> SignalOrBus:
    """Limit the input."""
    if any(block.is_set_to(source, "Input port") for source in ("UpperLimitSource", "LowerLimitSource")):
        remedy = "Use a Saturation Dynamic block instead."
        raise UnsupportedError("its limits are inputs, which is not supported", remedy)
    return clip(block.input(), block.parameter("LowerLimit"), block.parameter("UpperLimit"))


@block("Saturation Dynamic")
def saturation_dynamic(block: BlockContext) -> SignalOrBus:
    """Limit the second input to the range from the third to the first input."""
    up, u, low = (block.input(at) for at in range(3))
    return select(u > up, up, select(u < low, low, u))


@block("DeadZone", output=ARITHMETIC, LowerValue="-0.5", UpperValue="0.5", SampleTime="-1")
def dead_zone(block: BlockContext) -> SignalOrBus:
    """Return 0 inside the zone, the distance from it outside."""
    return _dead_zone(block.parameter("LowerValue"), block.parameter("UpperValue"), block.input())


@block("Dead Zone Dynamic")
def dead_zone_dynamic(block: BlockContext) -> SignalOrBus:
    """Return a dead zone of the second input between the third and the first input."""
    return _dead_zone(block.input(2), block.input(0), block.input(1))


@block("HitCross", HitCrossingOffset="0", HitCrossingDirection="either", SampleTime="-1")
def hit_crossing(block: BlockContext) -> SignalOrBus:
    """Return 1 in the first step in which the input has reached or crossed an offset, and while it rests there.

    With the direction "either", any value equal to the offset counts.
    """
    if any(text.strip() == "Message" for text in block.flat.block.parameters.values()):
        raise UnsupportedError("its output is a message, which is not supported", "Let it output a signal.")
    direction = block.option("HitCrossingDirection", "rising", "falling", "either")
    x = block.hold_in_minor_steps(block.input()) - block.parameter("HitCrossingOffset")
    hits, rests, zero = block.zero_crossing(x, direction), apply("eq", x, 0.0), block.constant(0.0)
    following: list[Signal] = []
    # as generated code does: a crossing inverts the output, and the step after one does not look for another
    before = block.discrete_state(zero, lambda _: following[0])
    has_hit = block.discrete_state(zero, lambda _: following[1])
    stays = before & rests
    y = select(has_hit, stays, select(hits, ~before, rests if direction == "either" else stays))
    following += [y, hits & ~has_hit]
    return y


def _dead_zone(low: Signal, high: Signal, u: Signal) -> Signal:
    return select(u > high, u - high, select(u < low, u - low, 0.0))


@block("Wrap To Zero", Threshold="255")
def wrap_to_zero(block: BlockContext) -> SignalOrBus:
    """Return the input up to a threshold, 0 above it."""
    u = block.input()
    return select(u > block.parameter("Threshold"), 0.0, u)


@block("Quantizer", QuantizationInterval="0.5", SampleTime="-1")
def quantizer(block: BlockContext) -> SignalOrBus:
    """Round the input to a multiple of the quantization interval."""
    q = block.parameter("QuantizationInterval")
    return q * apply("round", block.input() / q)


@block("Relay", OnSwitchValue="eps", OffSwitchValue="eps", OnOutputValue="1", OffOutputValue="0", SampleTime="-1")
def relay(block: BlockContext) -> SignalOrBus:
    """Switch on at one value and off at another, hold in between; initially off."""
    # it switches at major steps only, and keeps its state within a step of the solver
    u = block.hold_in_minor_steps(block.input())
    on, off = block.parameter("OnSwitchValue"), block.parameter("OffSwitchValue")
    is_on = block.feedback(block.constant(0.0), lambda before: select(u >= on, 1.0, select(u <= off, 0.0, before)))
    return select(is_on, block.parameter("OnOutputValue"), block.parameter("OffOutputValue"))


@block("Backlash", BacklashWidth="1", InitialOutput="0", SampleTime="-1")
def backlash(block: BlockContext) -> SignalOrBus:
    """Return an output that the input moves once it leaves the dead band."""
    u = block.hold_in_minor_steps(block.input())
    half = 0.5 * block.parameter("BacklashWidth")
    init = block.parameter("InitialOutput")

    def moved(before: Signal) -> Signal:
        return select(u < before - half, u + half, select(u <= before + half, before, u - half))

    return block.feedback(init, moved)


def _sample_of_limiter(block: ModelBlock) -> str:
    """Return the field with the sample time; a rate limiter runs in every step unless it inherits it."""
    return "SampleTime" if block.is_set_to("SampleTimeMode", "inherited") else "ContinuousTime"


@block("RateLimiter", sample=_sample_of_limiter, RisingSlewLimit="1", FallingSlewLimit="-1", InitialCondition="0",
       SampleTimeMode="continuous", SampleTime="-1", ContinuousTime="0")  # fmt: skip
def rate_limiter(block: BlockContext) -> SignalOrBus:
    """Limit the rate of the input; start at the initial value, or in continuous time at the input."""
    mode = block.option("SampleTimeMode", "continuous", "inherited")
    u = block.hold_in_minor_steps(block.input())
    in_time = mode == "continuous" or (block.compiler.clock.continuous and block.period() == CONTINUOUS)
    init = u if in_time else block.parameter("InitialCondition")
    return _limit_rate(block, u, block.parameter("RisingSlewLimit"), block.parameter("FallingSlewLimit"), init)


@block("Rate Limiter Dynamic", InitialCondition="0")
def rate_limiter_dynamic(block: BlockContext) -> SignalOrBus:
    """Limit the rate of the second input; rising limit at the first input, falling limit at the third."""
    u = block.hold_in_minor_steps(block.input(1))
    return _limit_rate(block, u, block.input(0), block.input(2), block.parameter("InitialCondition"))


def _limit_rate(block: BlockContext, u: Signal, up: Signal, down: Signal, init: Signal) -> Signal:
    step = block.sample_step()
    rise, fall = up * step, down * step

    def limited(before: Signal) -> Signal:
        # within the limits it is u itself, which before + (u - before) is up to rounding only
        change = u - before
        return select(change > rise, before + rise, select(change < fall, before + fall, u))

    return block.feedback(init, limited)


@block("Coulomb & Viscous Friction", offset="[1 3 2 0]", gain="1")
def friction(block: BlockContext) -> SignalOrBus:
    """Return friction in the direction of the input: sign(u) (gain |u| + offset)."""
    u = block.input()
    size = block.parameter("gain") * abs(u) + block.parameter("offset")
    return apply("sign", u) * size
