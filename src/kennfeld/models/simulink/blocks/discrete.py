"""Filters at the hits of a sample time: quotients of polynomials in z or in 1/z.

Memories that are written at the hits of a sample time.
"""

from collections.abc import Iterable
from functools import cached_property

from kennfeld.models.simulink.blocks.continuous import (
    fed_through,
    has_feedthrough,
    matrices,
    matrix_times_vector,
    reset_signal,
    resetting,
    scaled,
    with_saturation,
)
from kennfeld.models.simulink.flattening.flat_model import is_triggered
from kennfeld.models.simulink.lowering.block_context import BlockContext, Then
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block, no_feedthrough
from kennfeld.models.simulink.signals import CONSTANT, Signal, SignalOrBus, scalar

__all__ = ["direct_form"]

_FIR_STRUCTURES = (
    "Direct form", "Direct form symmetric", "Direct form antisymmetric", "Direct form transposed",
)  # fmt: skip

_METHODS = {"ForwardEuler": "forward", "BackwardEuler": "backward", "Trapezoidal": "trapezoidal"}


def _first_order(site: BlockContext) -> Iterable[int]:
    """A transfer function passes its input through where its numerator has the order of its denominator."""
    return range(0 if has_feedthrough(site) else 1, site.count)


def _filter_needs(site: BlockContext) -> Iterable[int]:
    """A filter passes its input through unless the first coefficient of its numerator is 0."""
    return range(1 if site.builder.value(int(site.matrix("Numerator").ravel()[0])) == 0 else 0, site.count)


@block("DiscreteTransferFcn", needs=_first_order, Numerator="[1]", Denominator="[1 0.5]", InitialStates="0",
       NumeratorSource="Dialog", DenominatorSource="Dialog", InitialStatesSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form II", SampleTime="-1")  # fmt: skip
def discrete_transfer_function(site: BlockContext) -> SignalOrBus:
    """b(z)/a(z) in powers of z, the highest first."""
    b, a = _coefficients(site)
    if b.size > a.size:
        raise UnsupportedError("the order of its numerator is above that of its denominator")
    zero = site.builder.const(0.0)
    return _filtered(site, [zero] * (a.size - b.size) + b.flat, a.flat)


@block("DiscreteFilter", needs=_filter_needs, Numerator="[1]", Denominator="[1 0.5]", InitialStates="0",
       NumeratorSource="Dialog", DenominatorSource="Dialog", InitialStatesSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form II", SampleTime="-1")  # fmt: skip
def discrete_filter(site: BlockContext) -> SignalOrBus:
    """b/a in powers of 1/z, the lowest first."""
    b, a = _coefficients(site)
    size = max(b.size, a.size)
    zero = site.builder.const(0.0)
    return _filtered(site, b.flat + [zero] * (size - b.size), a.flat + [zero] * (size - a.size))


@block("DiscreteFir", Coefficients="[0.5 0.5]", InitialStates="0", CoefSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form", ShowEnablePort="off", SampleTime="-1")  # fmt: skip
def fir_filter(site: BlockContext) -> SignalOrBus:
    """B in powers of 1/z, the lowest first."""
    site.chosen("CoefSource", "Dialog", "Dialog parameters")
    kind = site.chosen("FilterStructure", *_FIR_STRUCTURES)
    _check_starts(site, kind != "Direct form transposed")
    if site.on("ShowEnablePort"):
        raise UnsupportedError("it has an enable port")
    b = _row(site, "Coefficients").flat
    return _filtered(site, b, [site.builder.const(1.0)] + [site.builder.const(0.0)] * (len(b) - 1))


def _coefficients(site: BlockContext) -> tuple[Signal, Signal]:
    site.chosen("NumeratorSource", "Dialog")
    site.chosen("DenominatorSource", "Dialog")
    site.chosen("InitialStatesSource", "Dialog")
    _check_starts(site, site.text("FilterStructure") == "Direct form II")
    return _row(site, "Numerator"), _row(site, "Denominator")


def _row(site: BlockContext, name: str) -> Signal:
    """The coefficients of one filter."""
    found = site.parameter(name)
    if found.nodes.ndim > 1:
        raise UnsupportedError(f"its {name} is a matrix of {found.shape[0]} filters")
    return found


def _check_starts(site: BlockContext, known: bool) -> None:
    """Raise `UnsupportedError` where states begin with values in a structure whose states are others than here."""
    if not known and any(site.builder.value(node) != 0 for node in site.parameter("InitialStates").flat):
        raise UnsupportedError(f"its states in the {site.text('FilterStructure').lower()} have initial values")


def _filtered(site: BlockContext, b: list[int], a: list[int]) -> Signal:
    kind = resetting(site)
    anew = reset_signal(site, site.input(1), kind) if kind != "none" else None
    return direct_form(site, b, a, site.parameter("InitialStates"), anew)


def direct_form(site: BlockContext, b: list[int], a: list[int], inits: Signal, anew: Signal | None = None) -> Signal:
    """Direct form II: states w of the hits before, w = u - a1 w1 - ..., y = b0 w + b1 w1 + ..., for each element.

    The coefficients are those over a0, w is a0 times the state. `inits` are the states at first, and where they begin
    `anew`.
    """
    lead = a[0]
    order, ahead = len(a) - 1, [scaled(site, node, lead) for node in b]
    line = _Line(site, [scaled(site, node, lead) for node in a[1:]])
    states = line.remembered(_starts(site, inits, order, lead), anew)
    terms = [site.call("mul", scalar(node, CONSTANT), state) for node, state in zip(ahead[1:], states, strict=True)]
    if site.builder.value(ahead[0]) != 0:
        terms.insert(0, site.call("mul", scalar(ahead[0], CONSTANT), line.entering))
    return site.fold("add", terms) if terms else site.constant(0.0)


def _starts(site: BlockContext, inits: Signal, order: int, lead: int) -> list[Signal]:
    """What the states begin with, times the leading coefficient."""
    if inits.size not in (1, order) and order:
        raise UnsupportedError(f"it has {inits.size} initial states for an order of {order}")
    found = [scalar(site.builder.call("mul", lead, node)) for node in inits.flat]
    return found * order if inits.size == 1 else found[:order]


class _Line:
    """The delay line of a filter: what enters it in this hit, and what has entered in those before."""

    def __init__(self, site: BlockContext, back: list[int]) -> None:
        self.site = site
        self.back = back
        self.states: list[Signal] = []

    def remembered(self, first: list[Signal], anew: Signal | None) -> list[Signal]:
        """The states, the youngest first; `first` at first, and where they begin anew."""
        site = self.site
        found = [site.remember(one, self._following(at)) for at, one in enumerate(first)]
        if anew is not None:
            found = [site.select(anew, one, state) for one, state in zip(first, found, strict=True)]
        self.states += found
        return found

    def _following(self, at: int) -> Then:
        return lambda _: self.entering if at == 0 else self.states[at - 1]

    @cached_property
    def entering(self) -> Signal:
        """The input less what is fed back, w = u - a1 w1 - ..."""
        w = self.site.discrete(self.site.input())
        for node, state in zip(self.back, self.states, strict=True):
            w = self.site.call("sub", w, self.site.call("mul", scalar(node, CONSTANT), state))
        return w


@block("UnitDelay", needs=no_feedthrough, InitialCondition="0", SampleTime="1")
def unit_delay(site: BlockContext) -> SignalOrBus:
    """The input of the hit before."""
    init = site.parameter("InitialCondition" if site.atom.block.value("X0") is None else "X0")
    return site.remember(init, lambda _: site.input())


@block("Memory", needs=no_feedthrough, InitialCondition="0", InheritSampleTime="off")
def memory(site: BlockContext) -> SignalOrBus:
    """The input of the major step before."""
    init = site.parameter("InitialCondition" if site.atom.block.value("X0") is None else "X0")
    return site.remember(init, lambda _: site.input())


@block("ZeroOrderHold", "Zero-Order Hold", SampleTime="1")
def zero_order_hold(site: BlockContext) -> SignalOrBus:
    """The input as it was at the last hit."""
    return site.discrete(site.input())


@block("InitialCondition", Value="1", SampleTime="-1")
def initial_condition(site: BlockContext) -> SignalOrBus:
    """A value in the first step, the input from the second on."""
    zero, one = site.constant(0.0), site.constant(1.0)
    begun = site.remember(zero, lambda _: one)
    return site.select(begun, site.input(), site.parameter("Value"))


def _method(site: BlockContext) -> tuple[str, bool]:
    """The method of a discrete integrator, and whether it adds up without the sample time."""
    written = site.text("IntegratorMethod").replace(" ", "")
    kind, _, method = written.partition(":")
    if not method:
        kind, method = "Integration", kind
    if method not in _METHODS or kind not in ("Integration", "Accumulation"):
        raise UnsupportedError(f"IntegratorMethod is {written!r}, which is not supported")
    return _METHODS[method], kind == "Accumulation"


def _discrete_integrator_needs(site: BlockContext) -> Iterable[int]:
    return range(1 if _method(site)[0] == "forward" else 0, site.count)


@block("DiscreteIntegrator", needs=_discrete_integrator_needs, IntegratorMethod="Integration: Forward Euler",
       gainval="1.0", ExternalReset="none", InitialConditionSource="internal", InitialCondition="0",
       InitialConditionSetting="Output", LimitOutput="off", UpperSaturationLimit="inf", LowerSaturationLimit="-inf",
       ShowSaturationPort="off", ShowStatePort="off", SampleTime="1")  # fmt: skip
def discrete_integrator(site: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
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


def _step(site: BlockContext) -> Signal:
    """The sample time of the block; in a triggered subsystem the time since it ran last would be needed."""
    if is_triggered(site.atom):
        raise UnsupportedError("it integrates over time in a triggered subsystem")
    return site.step()


def _added_up(site: BlockContext, method: str, gain: Signal, init: Signal, reset: Signal | None) -> Signal:
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


def _starts_as_output(site: BlockContext) -> bool:
    """Whether it is the output that begins with the initial value, and not the state before the input is added."""
    return site.text("InitialConditionSetting") in ("Output", "State and output")


def _begins(site: BlockContext, reset: Signal | None) -> Signal:
    """1 in the first step, and where it is reset."""
    first = site.call("not", site.remember(site.constant(0.0), lambda _: site.constant(1.0)))
    return first if reset is None else site.call("or", first, reset)


@block("DiscreteStateSpace", needs=lambda site: fed_through(site), A="1", B="1", C="1", D="1", InitialCondition="0",
       X0="0", SampleTime="1")  # fmt: skip
def discrete_state_space(site: BlockContext) -> SignalOrBus:
    """The state space model x of the next hit = A x + B u, y = C x + D u."""
    A, B, C, D, first = matrices(site)
    x = site.remember(
        first, lambda x: site.call("add", matrix_times_vector(site, A, x), matrix_times_vector(site, B, site.input()))
    )
    y = matrix_times_vector(site, C, x)
    return site.call("add", y, matrix_times_vector(site, D, site.input())) if fed_through(site) else y


@block("Discrete Derivative", gainval="1.0", ICPrevScaledInput="0.0")
def discrete_derivative(site: BlockContext) -> SignalOrBus:
    """The change of K u / T since the hit before."""
    scaled = site.call("div", site.call("mul", site.parameter("gainval"), site.discrete(site.input())), _step(site))
    return site.call("sub", scaled, site.remember(site.parameter("ICPrevScaledInput"), lambda _: scaled))


@block("Difference", ICPrevInput="0.0")
def difference(site: BlockContext) -> SignalOrBus:
    """The change of the input since the hit before."""
    u = site.discrete(site.input())
    return site.call("sub", u, site.remember(site.parameter("ICPrevInput"), lambda _: u))


@block("First Order Transfer Fcn", "First-Order Transfer Fcn", PoleZ="0.95", ICPrevOutput="0.0")
def first_order(site: BlockContext) -> SignalOrBus:
    """The first-order lag y = p (y - u) + u."""
    u, pole = site.discrete(site.input()), site.parameter("PoleZ")
    made: list[Signal] = []
    before = site.remember(site.parameter("ICPrevOutput"), lambda _: made[0])
    made.append(site.call("add", site.call("mul", pole, site.call("sub", before, u)), u))
    return made[0]
