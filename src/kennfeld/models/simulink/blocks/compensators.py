"""Zero-pole transfer functions, lead-lag compensators, weighted moving average and sample time arithmetic."""

from collections.abc import Iterable

import numpy as np

from kennfeld.models.simulink.blocks.continuous import rational
from kennfeld.models.simulink.blocks.discrete import direct_form
from kennfeld.models.simulink.flattening.flat_model import is_triggered
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import Signal, SignalOrBus

_MAX_ORDER = 100


def _roots(block: BlockContext, name: str) -> list[int]:
    """Return the nodes of real zeros or poles, without infinite zeros."""
    if not block.numeric_array(name).size:
        return []
    nodes = block.matrix(name)
    if 1 not in nodes.shape:
        raise UnsupportedError(f"its {name} are a matrix (several outputs), which is not supported")
    if nodes.size > _MAX_ORDER:
        raise UnsupportedError(f"it has {nodes.size} {name.lower()}; at most {_MAX_ORDER} are supported")
    return [int(node) for node in nodes.ravel() if block.builder.value(int(node)) not in (np.inf, -np.inf)]


def _polynomial(block: BlockContext, roots: list[int]) -> list[int]:
    """Return the coefficients of (x - r1) (x - r2) ..., highest power first."""
    call, nodes = block.builder.call, [block.builder.const(1.0)]
    for root in roots:
        shifted = [block.builder.call("mul", call("neg", root), node) for node in nodes]
        nodes = [
            call("add", high, low)
            for high, low in zip([*nodes, block.builder.const(0.0)], [block.builder.const(0.0), *shifted], strict=True)
        ]
    return nodes


def _quotient(block: BlockContext) -> tuple[list[int], list[int]]:
    zeros, poles = _roots(block, "Zeros"), _roots(block, "Poles")
    if len(zeros) > len(poles):
        raise UnsupportedError(f"it has more zeros ({len(zeros)}) than poles ({len(poles)})")
    gain = block.parameter("Gain")
    if gain.size != 1:
        raise UnsupportedError("it has several gains (several outputs), which is not supported")
    return [block.builder.call("mul", gain.flat[0], node) for node in _polynomial(block, zeros)], _polynomial(
        block, poles
    )


def _through(block: BlockContext) -> Iterable[int]:
    return (0,) if len(_roots(block, "Zeros")) >= len(_roots(block, "Poles")) else ()


@block("ZeroPole", needs=_through, Zeros="[1]", Poles="[0 -1]", Gain="[1]")
def zero_pole(block: BlockContext) -> SignalOrBus:
    """Lower K (s - z1) ... / ((s - p1) ...) with zero initial states."""
    return rational(block, *_quotient(block))


@block("DiscreteZeroPole", needs=_through, Zeros="[1]", Poles="[0 0.5]", Gain="1", SampleTime="1")
def discrete_zero_pole(block: BlockContext) -> SignalOrBus:
    """Lower K (z - z1) ... / ((z - p1) ...) with zero initial states."""
    b, a = _quotient(block)
    b = [block.builder.const(0.0)] * (len(a) - len(b)) + b
    return direct_form(block, b, a, block.constant(0.0))


@block("Lead or Lag Compensator", "Transfer Fcn Lead or Lag", linked=True, PoleZ="0.95", ZeroZ="0.75",
       ICPrevOutput="0.0", ICPrevInput="0.0")  # fmt: skip
def lead_or_lag(block: BlockContext) -> SignalOrBus:
    """Return u - z u' + p y', in which u' and y' are the input and output of the previous sample."""
    signals: list[Signal] = []
    before = block.discrete_state(block.parameter("ICPrevOutput"), lambda _: signals[0])
    signals.append(block.apply("add", block.apply("mul", block.parameter("PoleZ"), before), _with_zero(block)))
    return signals[0]


@block("Transfer Fcn Real Zero", linked=True, ZeroZ="0.75", ICPrevInput="0.0")
def real_zero(block: BlockContext) -> SignalOrBus:
    """Return u - z u', in which u' is the input of the previous sample."""
    return _with_zero(block)


def _with_zero(block: BlockContext) -> Signal:
    u = block.hold_in_minor_steps(block.input())
    before = block.discrete_state(block.parameter("ICPrevInput"), lambda _: u)
    return block.apply("sub", u, block.apply("mul", block.parameter("ZeroZ"), before))


@block("Weighted Moving Average", sample="samptime", linked=True, mgainval="[0.1:0.1:1]", vinit="0.0", samptime="-1")
def moving_average(block: BlockContext) -> SignalOrBus:
    """Return the weighted sum of the last inputs, latest first."""
    weights = block.parameter("mgainval").flat
    number, zero = block.builder.const(1.0), block.builder.const(0.0)
    return direct_form(block, weights, [number] + [zero] * (len(weights) - 1), block.parameter("vinit"))


@block("SampleTimeMath", "Weighted Sample Time Math", TsampMathOp="+", weightValue="1.0",
       SampleTime="-1")  # fmt: skip
def sample_time_math(block: BlockContext) -> SignalOrBus:
    """Combine the input with the weighted sample time, or return that time alone."""
    if is_triggered(block.flat):
        raise UnsupportedError("it uses the sample time in a triggered subsystem, which is not supported")
    operation = block.option("TsampMathOp", "+", "-", "*", "/", "Ts Only", "1/Ts Only")
    weighted = block.apply("mul", block.parameter("weightValue"), block.sample_step())
    match operation:
        case "Ts Only":
            return weighted
        case "1/Ts Only":
            return block.apply("div", block.constant(1.0), weighted)
    return block.apply({"+": "add", "-": "sub", "*": "mul", "/": "div"}[operation], block.input(), weighted)


@block("SecondOrderIntegrator", needs=lambda block: (), ICX="0.0", ICDXDT="0.0", ICSourceX="internal",
       ICSourceDXDT="internal", ExternalReset="none", LimitX="off", LimitDXDT="off", ShowOutput="both")  # fmt: skip
def second_order_integrator(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Return the second and the first integral of the input."""
    for name in ("ICSourceX", "ICSourceDXDT"):
        block.option(name, "internal")
    for name in ("LimitX", "LimitDXDT", "ExternalReset"):
        block.option(name, "off", "none")
    v = block.continuous_state(block.parameter("ICDXDT"), lambda _: block.input(), None, None)
    x = block.continuous_state(block.parameter("ICX"), lambda _: v, None, None)
    shown = block.option("ShowOutput", "both", "x", "dx/dt")
    return (x, v) if shown == "both" else (x,) if shown == "x" else (v,)
