"""Memories that are written at the hits of a sample time."""

from collections.abc import Iterable

from kennfeld.models.simulink.blocktypes.continuous import (
    applied,
    fed_through,
    matrices,
    reset_signal,
    resetting,
    with_saturation,
)
from kennfeld.models.simulink.expressions.signals import Signal, Wired
from kennfeld.models.simulink.flattening.atoms import is_triggered
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block, nothing
from kennfeld.models.simulink.weaving.site import Site


@block("UnitDelay", needs=nothing, InitialCondition="0", SampleTime="1")
def unit_delay(site: Site) -> Wired:
    """The input of the hit before."""
    init = site.parameter("InitialCondition" if site.atom.block.value("X0") is None else "X0")
    return site.remember(init, lambda _: site.input())


@block("Memory", needs=nothing, InitialCondition="0", InheritSampleTime="off")
def memory(site: Site) -> Wired:
    """The input of the major step before."""
    init = site.parameter("InitialCondition" if site.atom.block.value("X0") is None else "X0")
    return site.remember(init, lambda _: site.input())


@block("ZeroOrderHold", "Zero-Order Hold", SampleTime="1")
def zero_order_hold(site: Site) -> Wired:
    """The input as it was at the last hit."""
    return site.discrete(site.input())


@block("InitialCondition", Value="1", SampleTime="-1")
def initial_condition(site: Site) -> Wired:
    """A value in the first step, the input from the second on."""
    zero, one = site.constant(0.0), site.constant(1.0)
    begun = site.remember(zero, lambda _: one)
    return site.select(begun, site.input(), site.parameter("Value"))


_METHODS = {"ForwardEuler": "forward", "BackwardEuler": "backward", "Trapezoidal": "trapezoidal"}


def _method(site: Site) -> tuple[str, bool]:
    """The method of a discrete integrator, and whether it adds up without the sample time."""
    written = site.text("IntegratorMethod").replace(" ", "")
    kind, _, method = written.partition(":")
    if not method:
        kind, method = "Integration", kind
    if method not in _METHODS or kind not in ("Integration", "Accumulation"):
        raise UnsupportedError(f"IntegratorMethod is {written!r}, which is not supported")
    return _METHODS[method], kind == "Accumulation"


def _discrete_integrator_needs(site: Site) -> Iterable[int]:
    return range(1 if _method(site)[0] == "forward" else 0, site.count)


@block("DiscreteIntegrator", needs=_discrete_integrator_needs, IntegratorMethod="Integration: Forward Euler",
       gainval="1.0", ExternalReset="none", InitialConditionSource="internal", InitialCondition="0",
       InitialConditionSetting="Output", LimitOutput="off", UpperSaturationLimit="inf", LowerSaturationLimit="-inf",
       ShowSaturationPort="off", ShowStatePort="off", SampleTime="1")  # fmt: skip
def discrete_integrator(site: Site) -> Wired | tuple[Wired, ...]:
    """K T u added up: with the rectangle before, the one behind, or the trapezium."""
    method, accumulates = _method(site)
    external = site.text("InitialConditionSource") == "external"
    init = site.input(site.count - 1) if external else site.parameter("InitialCondition")
    gain = site.parameter("gainval") if accumulates else site.call("mul", site.parameter("gainval"), _step(site))
    kind = resetting(site)
    reset = reset_signal(site, site.input(1), kind, sampled=True) if kind != "none" else None
    y = with_saturation(site, _added_up(site, method, gain, init, reset))
    if method == "forward" or not site.on("ShowStatePort"):
        return y
    if reset is not None:
        raise UnsupportedError(f"its state port shows the state before a reset, which is not supported for {method}")
    return (*y, y[0]) if isinstance(y, tuple) else (y, y)


def _step(site: Site) -> Signal:
    """The sample time of the block; in a triggered subsystem the time since it ran last would be needed."""
    if is_triggered(site.atom):
        raise UnsupportedError("it integrates over time in a triggered subsystem")
    return site.step()


def _added_up(site: Site, method: str, gain: Signal, init: Signal, reset: Signal | None) -> Signal:
    def limited(x: Signal) -> Signal:
        if not site.on("LimitOutput"):
            return x
        return site.clip(x, site.parameter("LowerSaturationLimit"), site.parameter("UpperSaturationLimit"))

    def increment() -> Signal:
        step = site.call("mul", gain, site.discrete(site.input(0)))
        return site.call("mul", site.constant(0.5), step) if method == "trapezoidal" else step

    made: list[Signal] = []

    def then(_: Signal) -> Signal:
        return made[0] if method == "backward" else limited(site.call("add", made[0], increment()))

    x = site.remember(init, then, ported=True)
    anew = _begins(site, reset) if method != "forward" and _starts_as_output(site) else None
    if anew is None:
        x = x if reset is None else site.select(reset, limited(init), x)
    y = x if method == "forward" else site.call("add", x, increment())
    made.append(limited(y if anew is None else site.select(anew, init, y)))
    return made[0]


def _starts_as_output(site: Site) -> bool:
    """Whether it is the output that begins with the initial value, and not the state before the input is added."""
    return site.text("InitialConditionSetting") in ("Output", "State and output")


def _begins(site: Site, reset: Signal | None) -> Signal:
    """1 in the first step, and where it is reset."""
    first = site.call("not", site.remember(site.constant(0.0), lambda _: site.constant(1.0)))
    return first if reset is None else site.call("or", first, reset)


@block("DiscreteStateSpace", needs=lambda site: fed_through(site), A="1", B="1", C="1", D="1", InitialCondition="0",
       X0="0", SampleTime="1")  # fmt: skip
def discrete_state_space(site: Site) -> Wired:
    """The state space model x of the next hit = A x + B u, y = C x + D u."""
    A, B, C, D, first = matrices(site)
    x = site.remember(first, lambda x: site.call("add", applied(site, A, x), applied(site, B, site.input())))
    y = applied(site, C, x)
    return site.call("add", y, applied(site, D, site.input())) if fed_through(site) else y


@block("Discrete Derivative", gainval="1.0", ICPrevScaledInput="0.0")
def discrete_derivative(site: Site) -> Wired:
    """The change of K u / T since the hit before."""
    scaled = site.call("div", site.call("mul", site.parameter("gainval"), site.discrete(site.input())), _step(site))
    return site.call("sub", scaled, site.remember(site.parameter("ICPrevScaledInput"), lambda _: scaled))


@block("Difference", ICPrevInput="0.0")
def difference(site: Site) -> Wired:
    """The change of the input since the hit before."""
    u = site.discrete(site.input())
    return site.call("sub", u, site.remember(site.parameter("ICPrevInput"), lambda _: u))


@block("First Order Transfer Fcn", "First-Order Transfer Fcn", PoleZ="0.95", ICPrevOutput="0.0")
def first_order(site: Site) -> Wired:
    """The first-order lag y = p (y - u) + u."""
    u, pole = site.discrete(site.input()), site.parameter("PoleZ")
    made: list[Signal] = []
    before = site.remember(site.parameter("ICPrevOutput"), lambda _: made[0])
    made.append(site.call("add", site.call("mul", pole, site.call("sub", before, u)), u))
    return made[0]
