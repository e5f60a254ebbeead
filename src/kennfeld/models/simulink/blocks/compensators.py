"""Transfer functions by their zeros and poles, lead and lag, and what is scaled with the sample time."""

from collections.abc import Iterable

import numpy as np

from kennfeld.models.simulink.blocks.continuous import rational
from kennfeld.models.simulink.blocks.discrete import direct_form
from kennfeld.models.simulink.flattening.flat_model import is_triggered
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import Signal, SignalOrBus

_HIGHEST_ORDER = 100


def _roots(site: BlockContext, name: str) -> list[int]:
    """The nodes of zeros or poles, which are real; an infinite zero is none."""
    if not site.numbers(name).size:
        return []
    nodes = site.matrix(name)
    if 1 not in nodes.shape:
        raise UnsupportedError(f"its {name} are a matrix, for several outputs")
    if nodes.size > _HIGHEST_ORDER:
        raise UnsupportedError(f"it has {nodes.size} {name.lower()}; {_HIGHEST_ORDER} are the most")
    return [int(node) for node in nodes.ravel() if site.builder.value(int(node)) not in (np.inf, -np.inf)]


def _polynomial(site: BlockContext, roots: list[int]) -> list[int]:
    """The coefficients of (x - r1) (x - r2) ..., the highest power first."""
    call, made = site.builder.call, [site.builder.const(1.0)]
    for root in roots:
        shifted = [site.builder.call("mul", call("neg", root), node) for node in made]
        made = [
            call("add", high, low)
            for high, low in zip([*made, site.builder.const(0.0)], [site.builder.const(0.0), *shifted], strict=True)
        ]
    return made


def _quotient(site: BlockContext) -> tuple[list[int], list[int]]:
    zeros, poles = _roots(site, "Zeros"), _roots(site, "Poles")
    if len(zeros) > len(poles):
        raise UnsupportedError(f"it has {len(zeros)} zeros and only {len(poles)} poles")
    gain = site.parameter("Gain")
    if gain.size != 1:
        raise UnsupportedError("it has several gains, for several outputs")
    return [site.builder.call("mul", gain.flat[0], node) for node in _polynomial(site, zeros)], _polynomial(site, poles)


def _through(site: BlockContext) -> Iterable[int]:
    return (0,) if len(_roots(site, "Zeros")) >= len(_roots(site, "Poles")) else ()


@block("ZeroPole", needs=_through, Zeros="[1]", Poles="[0 -1]", Gain="[1]")
def zero_pole(site: BlockContext) -> SignalOrBus:
    """K (s - z1) ... / ((s - p1) ...), from zero states."""
    return rational(site, *_quotient(site))


@block("DiscreteZeroPole", needs=_through, Zeros="[1]", Poles="[0 0.5]", Gain="1", SampleTime="1")
def discrete_zero_pole(site: BlockContext) -> SignalOrBus:
    """K (z - z1) ... / ((z - p1) ...), from zero states."""
    b, a = _quotient(site)
    b = [site.builder.const(0.0)] * (len(a) - len(b)) + b
    return direct_form(site, b, a, site.constant(0.0))


@block("Lead or Lag Compensator", "Transfer Fcn Lead or Lag", linked=True, PoleZ="0.95", ZeroZ="0.75",
       ICPrevOutput="0.0", ICPrevInput="0.0")  # fmt: skip
def lead_or_lag(site: BlockContext) -> SignalOrBus:
    """The input less z times that of the hit before, and p times the output of the hit before."""
    made: list[Signal] = []
    before = site.remember(site.parameter("ICPrevOutput"), lambda _: made[0])
    made.append(site.call("add", site.call("mul", site.parameter("PoleZ"), before), _with_zero(site)))
    return made[0]


@block("Transfer Fcn Real Zero", linked=True, ZeroZ="0.75", ICPrevInput="0.0")
def real_zero(site: BlockContext) -> SignalOrBus:
    """The input less z times that of the hit before."""
    return _with_zero(site)


def _with_zero(site: BlockContext) -> Signal:
    u = site.discrete(site.input())
    before = site.remember(site.parameter("ICPrevInput"), lambda _: u)
    return site.call("sub", u, site.call("mul", site.parameter("ZeroZ"), before))


@block("Weighted Moving Average", sample="samptime", linked=True, mgainval="[0.1:0.1:1]", vinit="0.0", samptime="-1")
def moving_average(site: BlockContext) -> SignalOrBus:
    """The inputs of the last hits, the youngest first, each times its weight."""
    weights = site.parameter("mgainval").flat
    one, zero = site.builder.const(1.0), site.builder.const(0.0)
    return direct_form(site, weights, [one] + [zero] * (len(weights) - 1), site.parameter("vinit"))


@block("SampleTimeMath", "Weighted Sample Time Math", TsampMathOp="+", weightValue="1.0",
       SampleTime="-1")  # fmt: skip
def sample_time_math(site: BlockContext) -> SignalOrBus:
    """The sum, difference, product or quotient of the input and the weighted sample time, or that time alone."""
    if is_triggered(site.atom):
        raise UnsupportedError("it takes the sample time in a triggered subsystem")
    operation = site.chosen("TsampMathOp", "+", "-", "*", "/", "Ts Only", "1/Ts Only")
    weighted = site.call("mul", site.parameter("weightValue"), site.step())
    match operation:
        case "Ts Only":
            return weighted
        case "1/Ts Only":
            return site.call("div", site.constant(1.0), weighted)
    return site.call({"+": "add", "-": "sub", "*": "mul", "/": "div"}[operation], site.input(), weighted)


@block("SecondOrderIntegrator", needs=lambda site: (), ICX="0.0", ICDXDT="0.0", ICSourceX="internal",
       ICSourceDXDT="internal", ExternalReset="none", LimitX="off", LimitDXDT="off", ShowOutput="both")  # fmt: skip
def second_order_integrator(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """The second integral of the input and the first."""
    for name in ("ICSourceX", "ICSourceDXDT"):
        site.chosen(name, "internal")
    for name in ("LimitX", "LimitDXDT", "ExternalReset"):
        site.chosen(name, "off", "none")
    v = site.integrate(site.parameter("ICDXDT"), lambda _: site.input(), None, None)
    x = site.integrate(site.parameter("ICX"), lambda _: v, None, None)
    shown = site.chosen("ShowOutput", "both", "x", "dx/dt")
    return (x, v) if shown == "both" else (x,) if shown == "x" else (v,)
