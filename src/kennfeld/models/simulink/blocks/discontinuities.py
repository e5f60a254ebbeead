"""Limits, dead zones, relays, rate limits."""

from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.reader.model_tree import ModelBlock
from kennfeld.models.simulink.signals import CONTINUOUS, Signal, SignalOrBus


@block("Saturate", UpperLimit="0.5", LowerLimit="-0.5", UpperLimitSource="Dialog", LowerLimitSource="Dialog",
       SampleTime="-1")  # fmt: skip
def saturate(site: BlockContext) -> SignalOrBus:
    """The input within limits."""
    if "Input port" in (site.text("UpperLimitSource"), site.text("LowerLimitSource")):
        raise UnsupportedError("its limits are inputs", "Put a Saturation Dynamic in its place.")
    return site.clip(site.input(), site.parameter("LowerLimit"), site.parameter("UpperLimit"))


@block("Saturation Dynamic")
def saturation_dynamic(site: BlockContext) -> SignalOrBus:
    """The middle input within the upper limit, the first, and the lower, the third."""
    up, u, low = (site.input(at) for at in range(3))
    clipped = site.select(site.call("lt", u, low), low, u)
    return site.select(site.call("gt", u, up), up, clipped)


@block("DeadZone", LowerValue="-0.5", UpperValue="0.5", SampleTime="-1")
def dead_zone(site: BlockContext) -> SignalOrBus:
    """0 within the zone, the distance to it outside."""
    return _zone(site, site.parameter("LowerValue"), site.parameter("UpperValue"), site.input())


@block("Dead Zone Dynamic")
def dead_zone_dynamic(site: BlockContext) -> SignalOrBus:
    """As a dead zone between the third input and the first."""
    return _zone(site, site.input(2), site.input(0), site.input(1))


def _zone(site: BlockContext, low: Signal, high: Signal, u: Signal) -> Signal:
    below = site.select(site.call("lt", u, low), site.call("sub", u, low), site.constant(0.0))
    return site.select(site.call("gt", u, high), site.call("sub", u, high), below)


@block("Wrap To Zero", Threshold="255")
def wrap_to_zero(site: BlockContext) -> SignalOrBus:
    """The input up to a threshold, 0 beyond it."""
    u = site.input()
    return site.select(site.call("gt", u, site.parameter("Threshold")), site.constant(0.0), u)


@block("Quantizer", QuantizationInterval="0.5", SampleTime="-1")
def quantizer(site: BlockContext) -> SignalOrBus:
    """The nearest multiple of an interval."""
    q = site.parameter("QuantizationInterval")
    return site.call("mul", q, site.call("round", site.call("div", site.input(), q)))


@block("Relay", OnSwitchValue="eps", OffSwitchValue="eps", OnOutputValue="1", OffOutputValue="0", SampleTime="-1")
def relay(site: BlockContext) -> SignalOrBus:
    """On from one value upwards, off from another downwards, in between as before; off at first."""
    u = site.discrete(site.input())
    on, off = site.parameter("OnSwitchValue"), site.parameter("OffSwitchValue")
    one, zero = site.constant(1.0), site.constant(0.0)
    state: list[Signal] = []
    before = site.remember(zero, lambda _: state[0])
    kept = site.select(site.call("le", u, off), zero, before)
    state.append(site.select(site.call("ge", u, on), one, kept))
    return site.select(state[0], site.parameter("OnOutputValue"), site.parameter("OffOutputValue"))


@block("Backlash", BacklashWidth="1", InitialOutput="0", SampleTime="-1")
def backlash(site: BlockContext) -> SignalOrBus:
    """The output stays until the input has moved it by half of the width."""
    u = site.discrete(site.input())
    half = site.call("mul", site.constant(0.5), site.parameter("BacklashWidth"))
    made: list[Signal] = []
    before = site.remember(site.parameter("InitialOutput"), lambda _: made[0])
    lifted = site.call("max", before, site.call("sub", u, half))
    made.append(site.call("min", lifted, site.call("add", u, half)))
    return made[0]


def _sample_of_limiter(one: ModelBlock) -> str:
    """A rate limiter runs in every step unless it inherits its sample time."""
    return "SampleTime" if one.value("SampleTimeMode") == "inherited" else "ContinuousTime"


@block("RateLimiter", sample=_sample_of_limiter, RisingSlewLimit="1", FallingSlewLimit="-1", InitialCondition="0",
       SampleTimeMode="continuous", SampleTime="-1", ContinuousTime="0")  # fmt: skip
def rate_limiter(site: BlockContext) -> SignalOrBus:
    """The input followed at a limited rate: from the initial value on, in continuous time from the input at first."""
    mode = site.chosen("SampleTimeMode", "continuous", "inherited")
    u = site.discrete(site.input())
    in_time = mode == "continuous" or (site.compiler.clock.continuous and site.period() == CONTINUOUS)
    init = u if in_time else site.parameter("InitialCondition")
    return _limited(site, u, site.parameter("RisingSlewLimit"), site.parameter("FallingSlewLimit"), init)


@block("Rate Limiter Dynamic", InitialCondition="0")
def rate_limiter_dynamic(site: BlockContext) -> SignalOrBus:
    """As a rate limiter with the rising limit at the first input and the falling one at the third."""
    u = site.discrete(site.input(1))
    return _limited(site, u, site.input(0), site.input(2), site.parameter("InitialCondition"))


def _limited(site: BlockContext, u: Signal, up: Signal, down: Signal, init: Signal) -> Signal:
    made: list[Signal] = []
    before = site.remember(init, lambda _: made[0])
    step = site.step()
    moved = site.clip(site.call("sub", u, before), site.call("mul", down, step), site.call("mul", up, step))
    made.append(site.call("add", before, moved))
    return made[0]


@block("Coulomb & Viscous Friction", offset="[1 3 2 0]", gain="1")
def friction(site: BlockContext) -> SignalOrBus:
    """Friction of the size gain |u| + offset, in the direction of the input."""
    u = site.input()
    size = site.call("add", site.call("mul", site.parameter("gain"), site.call("abs", u)), site.parameter("offset"))
    return site.call("mul", site.call("sign", u), size)
