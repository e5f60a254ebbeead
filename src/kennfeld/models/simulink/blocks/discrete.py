"""Discrete library: memories, integrators, state space models, and filters in powers of z or 1/z."""

from collections.abc import Iterable
from functools import cached_property

from kennfeld.models.simulink.blocks.continuous import (
    divide_by_lead,
    external_reset,
    feedthrough_inputs,
    has_feedthrough,
    matrices,
    matrix_times_vector,
    reset_signal,
    with_saturation,
)
from kennfeld.models.simulink.flattening.flat_model import is_triggered
from kennfeld.models.simulink.lowering.block_context import BlockContext, Then
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block, no_feedthrough
from kennfeld.models.simulink.signals import CONSTANT, Signal, SignalOrBus, scalar

_FIR_STRUCTURES = (
    "Direct form", "Direct form symmetric", "Direct form antisymmetric", "Direct form transposed",
)  # fmt: skip

_METHODS = {"ForwardEuler": "forward", "BackwardEuler": "backward", "Trapezoidal": "trapezoidal"}


def _first_order(block: BlockContext) -> Iterable[int]:
    """Return the input if the numerator has the order of the denominator."""
    return range(0 if has_feedthrough(block) else 1, block.input_count)


def _filter_needs(block: BlockContext) -> Iterable[int]:
    """Return the input unless the first numerator coefficient is 0."""
    return range(1 if block.builder.value(int(block.matrix("Numerator").ravel()[0])) == 0 else 0, block.input_count)


@block("DiscreteTransferFcn", needs=_first_order, Numerator="[1]", Denominator="[1 0.5]", InitialStates="0",
       NumeratorSource="Dialog", DenominatorSource="Dialog", InitialStatesSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form II", SampleTime="-1")  # fmt: skip
def discrete_transfer_function(block: BlockContext) -> SignalOrBus:
    """Lower b(z)/a(z) in powers of z, highest first."""
    b, a = _coefficients(block)
    if b.size > a.size:
        raise UnsupportedError("its numerator has a higher order than its denominator")
    zero = block.builder.const(0.0)
    return _filtered(block, [zero] * (a.size - b.size) + b.flat, a.flat)


@block("DiscreteFilter", needs=_filter_needs, Numerator="[1]", Denominator="[1 0.5]", InitialStates="0",
       NumeratorSource="Dialog", DenominatorSource="Dialog", InitialStatesSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form II", SampleTime="-1")  # fmt: skip
def discrete_filter(block: BlockContext) -> SignalOrBus:
    """Lower b/a in powers of 1/z, lowest first."""
    b, a = _coefficients(block)
    size = max(b.size, a.size)
    zero = block.builder.const(0.0)
    return _filtered(block, b.flat + [zero] * (size - b.size), a.flat + [zero] * (size - a.size))


@block("DiscreteFir", Coefficients="[0.5 0.5]", InitialStates="0", CoefSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form", ShowEnablePort="off", SampleTime="-1")  # fmt: skip
def fir_filter(block: BlockContext) -> SignalOrBus:
    """Lower an FIR filter in powers of 1/z, lowest first."""
    block.option("CoefSource", "Dialog", "Dialog parameters")
    kind = block.option("FilterStructure", *_FIR_STRUCTURES)
    _check_starts(block, kind != "Direct form transposed")
    if block.is_on("ShowEnablePort"):
        raise UnsupportedError("it has an enable port, which is not supported")
    b = _row(block, "Coefficients").flat
    return _filtered(block, b, [block.builder.const(1.0)] + [block.builder.const(0.0)] * (len(b) - 1))


def _coefficients(block: BlockContext) -> tuple[Signal, Signal]:
    block.option("NumeratorSource", "Dialog")
    block.option("DenominatorSource", "Dialog")
    block.option("InitialStatesSource", "Dialog")
    _check_starts(block, block.field_text("FilterStructure") == "Direct form II")
    return _row(block, "Numerator"), _row(block, "Denominator")


def _row(block: BlockContext, name: str) -> Signal:
    signal = block.parameter(name)
    if signal.nodes.ndim > 1:
        raise UnsupportedError(f"its {name} is a matrix of {signal.shape[0]} filters, which is not supported")
    return signal


def _check_starts(block: BlockContext, known: bool) -> None:
    """Raise `UnsupportedError` if initial states belong to a filter structure with other states than direct form II."""
    if not known and any(block.builder.value(node) != 0 for node in block.parameter("InitialStates").flat):
        raise UnsupportedError(
            f"initial states are not supported for the structure {block.field_text('FilterStructure')!r}"
        )


def _filtered(block: BlockContext, b: list[int], a: list[int]) -> Signal:
    kind = external_reset(block)
    anew = reset_signal(block, block.input(1), kind) if kind != "none" else None
    return direct_form(block, b, a, block.parameter("InitialStates"), anew)


def direct_form(block: BlockContext, b: list[int], a: list[int], inits: Signal, anew: Signal | None = None) -> Signal:
    """Lower direct form II for each element: w = u - a1 w1 - ..., y = b0 w + b1 w1 + ...

    w1, w2, ... are w of previous samples. Coefficients are divided by a0, and w is a0 times the state. `inits` are the
    initial states, to which `anew` resets.
    """
    lead = a[0]
    order, ahead = len(a) - 1, [divide_by_lead(block, node, lead) for node in b]
    line = _Line(block, [divide_by_lead(block, node, lead) for node in a[1:]])
    states = line.remembered(_starts(block, inits, order, lead), anew)
    terms = [block.apply("mul", scalar(node, CONSTANT), state) for node, state in zip(ahead[1:], states, strict=True)]
    if block.builder.value(ahead[0]) != 0:
        terms.insert(0, block.apply("mul", scalar(ahead[0], CONSTANT), line.entering))
    return block.reduce("add", terms) if terms else block.constant(0.0)


def _starts(block: BlockContext, inits: Signal, order: int, lead: int) -> list[Signal]:
    """Return the initial states times the leading coefficient."""
    if inits.size not in (1, order) and order:
        raise UnsupportedError(f"it has {inits.size} initial states for an order of {order}")
    signals = [scalar(block.builder.call("mul", lead, node)) for node in inits.flat]
    return signals * order if inits.size == 1 else signals[:order]


class _Line:
    """Delay line of a filter: its input in this sample and in previous ones."""

    def __init__(self, block: BlockContext, back: list[int]) -> None:
        self.block = block
        self.back = back
        self.states: list[Signal] = []

    def remembered(self, first: list[Signal], anew: Signal | None) -> list[Signal]:
        """Return the states, latest first; `first` are their initial values, to which `anew` resets."""
        block = self.block
        signals = [block.discrete_state(signal, self._following(at)) for at, signal in enumerate(first)]
        if anew is not None:
            signals = [block.select(anew, signal, state) for signal, state in zip(first, signals, strict=True)]
        self.states += signals
        return signals

    def _following(self, at: int) -> Then:
        return lambda _: self.entering if at == 0 else self.states[at - 1]

    @cached_property
    def entering(self) -> Signal:
        """Filter input minus feedback, w = u - a1 w1 - ..."""
        w = self.block.hold_in_minor_steps(self.block.input())
        for node, state in zip(self.back, self.states, strict=True):
            w = self.block.apply("sub", w, self.block.apply("mul", scalar(node, CONSTANT), state))
        return w


@block("UnitDelay", needs=no_feedthrough, InitialCondition="0", SampleTime="1")
def unit_delay(block: BlockContext) -> SignalOrBus:
    """Return the input of the previous sample."""
    init = block.parameter("InitialCondition" if block.flat.block.value("X0") is None else "X0")
    return block.discrete_state(init, lambda _: block.input())


@block("Memory", needs=no_feedthrough, InitialCondition="0", InheritSampleTime="off")
def memory(block: BlockContext) -> SignalOrBus:
    """Return the input of the previous major step."""
    init = block.parameter("InitialCondition" if block.flat.block.value("X0") is None else "X0")
    return block.discrete_state(init, lambda _: block.input())


@block("ZeroOrderHold", "Zero-Order Hold", SampleTime="1")
def zero_order_hold(block: BlockContext) -> SignalOrBus:
    """Return the input of the last sample hit."""
    return block.hold_in_minor_steps(block.input())


@block("InitialCondition", Value="1", SampleTime="-1")
def initial_condition(block: BlockContext) -> SignalOrBus:
    """Return a constant in the first step, the input afterwards."""
    zero, one = block.constant(0.0), block.constant(1.0)
    begun = block.discrete_state(zero, lambda _: one)
    return block.select(begun, block.input(), block.parameter("Value"))


def _method(block: BlockContext) -> tuple[str, bool]:
    """Return the method of a discrete integrator, and True if it accumulates without the sample time."""
    written = block.field_text("IntegratorMethod").replace(" ", "")
    kind, _, method = written.partition(":")
    if not method:
        kind, method = "Integration", kind
    if method not in _METHODS or kind not in ("Integration", "Accumulation"):
        raise UnsupportedError(f"IntegratorMethod {written!r} is not supported")
    return _METHODS[method], kind == "Accumulation"


def _discrete_integrator_needs(block: BlockContext) -> Iterable[int]:
    return range(1 if _method(block)[0] == "forward" else 0, block.input_count)


@block("DiscreteIntegrator", needs=_discrete_integrator_needs, IntegratorMethod="Integration: Forward Euler",
       gainval="1.0", ExternalReset="none", InitialConditionSource="internal", InitialCondition="0",
       InitialConditionSetting="Output", LimitOutput="off", UpperSaturationLimit="inf", LowerSaturationLimit="-inf",
       ShowSaturationPort="off", ShowStatePort="off", SampleTime="1")  # fmt: skip
def discrete_integrator(block: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """Accumulate K T u by forward Euler, backward Euler or the trapezoidal rule."""
    method, accumulates = _method(block)
    external = block.field_text("InitialConditionSource") == "external"
    init = block.input(block.input_count - 1) if external else block.parameter("InitialCondition")
    gain = block.parameter("gainval") if accumulates else block.apply("mul", block.parameter("gainval"), _step(block))
    kind = external_reset(block)
    reset = reset_signal(block, block.input(1), kind, sampled=True) if kind != "none" else None
    y = with_saturation(block, _added_up(block, method, gain, init, reset))
    if method == "forward" or not block.is_on("ShowStatePort"):
        return y
    if reset is not None:
        raise UnsupportedError(f"its state port outputs the state before a reset, which is not supported for {method}")
    return (*y, y[0]) if isinstance(y, tuple) else (y, y)


def _step(block: BlockContext) -> Signal:
    """Return the sample time; a triggered subsystem would need the time since it last ran."""
    if is_triggered(block.flat):
        raise UnsupportedError("it integrates over time in a triggered subsystem, which is not supported")
    return block.sample_step()


def _added_up(block: BlockContext, method: str, gain: Signal, init: Signal, reset: Signal | None) -> Signal:
    def limited(x: Signal) -> Signal:
        if not block.is_on("LimitOutput"):
            return x
        return block.clip(x, block.parameter("LowerSaturationLimit"), block.parameter("UpperSaturationLimit"))

    def increment() -> Signal:
        step = block.apply("mul", gain, block.hold_in_minor_steps(block.input(0)))
        return block.apply("mul", block.constant(0.5), step) if method == "trapezoidal" else step

    signals: list[Signal] = []

    def then(_: Signal) -> Signal:
        return signals[0] if method == "backward" else limited(block.apply("add", signals[0], increment()))

    x = block.discrete_state(init, then, ported=True)
    anew = _begins(block, reset) if method != "forward" and _starts_as_output(block) else None
    if anew is None:
        x = x if reset is None else block.select(reset, limited(init), x)
    y = x if method == "forward" else block.apply("add", x, increment())
    signals.append(limited(y if anew is None else block.select(anew, init, y)))
    return signals[0]


def _starts_as_output(block: BlockContext) -> bool:
    """Return True if the output, not the state before the input is added, starts at the initial value."""
    return block.field_text("InitialConditionSetting") in ("Output", "State and output")


def _begins(block: BlockContext, reset: Signal | None) -> Signal:
    """Return 1 in the first step and on reset."""
    first = block.apply("not", block.discrete_state(block.constant(0.0), lambda _: block.constant(1.0)))
    return first if reset is None else block.apply("or", first, reset)


@block("DiscreteStateSpace", needs=lambda block: feedthrough_inputs(block), A="1", B="1", C="1", D="1",
       InitialCondition="0", X0="0", SampleTime="1")  # fmt: skip
def discrete_state_space(block: BlockContext) -> SignalOrBus:
    """Lower x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k]."""
    A, B, C, D, first = matrices(block)
    x = block.discrete_state(
        first,
        lambda x: block.apply("add", matrix_times_vector(block, A, x), matrix_times_vector(block, B, block.input())),
    )
    y = matrix_times_vector(block, C, x)
    return block.apply("add", y, matrix_times_vector(block, D, block.input())) if feedthrough_inputs(block) else y


@block("Discrete Derivative", gainval="1.0", ICPrevScaledInput="0.0")
def discrete_derivative(block: BlockContext) -> SignalOrBus:
    """Return the difference of K u / T to the previous sample."""
    scaled = block.apply(
        "div", block.apply("mul", block.parameter("gainval"), block.hold_in_minor_steps(block.input())), _step(block)
    )
    return block.apply("sub", scaled, block.discrete_state(block.parameter("ICPrevScaledInput"), lambda _: scaled))


@block("Difference", ICPrevInput="0.0")
def difference(block: BlockContext) -> SignalOrBus:
    """Return the difference of the input to the previous sample."""
    u = block.hold_in_minor_steps(block.input())
    return block.apply("sub", u, block.discrete_state(block.parameter("ICPrevInput"), lambda _: u))


@block("First Order Transfer Fcn", "First-Order Transfer Fcn", PoleZ="0.95", ICPrevOutput="0.0")
def first_order(block: BlockContext) -> SignalOrBus:
    """Return the first-order lag y = p (y' - u) + u, in which y' is the previous output."""
    u, pole = block.hold_in_minor_steps(block.input()), block.parameter("PoleZ")
    signals: list[Signal] = []
    before = block.discrete_state(block.parameter("ICPrevOutput"), lambda _: signals[0])
    signals.append(block.apply("add", block.apply("mul", pole, block.apply("sub", before, u)), u))
    return signals[0]
