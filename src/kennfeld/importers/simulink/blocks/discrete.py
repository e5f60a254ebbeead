"""Discrete library: memories, integrators, state space models, and filters in powers of z or 1/z."""

from collections.abc import Iterable
from functools import cache

from kennfeld.importers.simulink.blocks.bus_states import delay_members
from kennfeld.importers.simulink.blocks.bus_values import parameter_or_bus
from kennfeld.importers.simulink.blocks.continuous import (
    divide_by_lead,
    external_reset,
    feedthrough_inputs,
    has_feedthrough,
    integrator_start,
    limit_output,
    linear_output,
    quotient,
    read_matrices,
    with_saturation,
    zero_pole_feedthrough,
)
from kennfeld.importers.simulink.flattening.flat_model import is_triggered
from kennfeld.importers.simulink.lowering import (
    ARITHMETIC,
    LIKE_INPUT,
    BlockContext,
    Outputs,
    UnsupportedError,
    block,
    no_feedthrough,
)
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.signals import CONSTANT, Signal, SignalOrBus, SignalRule, apply, map_members, select

_FIR_STRUCTURES = ("", " symmetric", " antisymmetric", " transposed")
_FILTER = {
    "Numerator": "[1]", "Denominator": "[1 0.5]", "InitialStates": "0", "NumeratorSource": "Dialog",
    "DenominatorSource": "Dialog", "InitialStatesSource": "Dialog", "ExternalReset": "None",
    "FilterStructure": "Direct form II", "SampleTime": "-1",
}  # fmt: skip
_METHODS = {"ForwardEuler": "forward", "BackwardEuler": "backward", "Trapezoidal": "trapezoidal"}


def _filter_needs(block: BlockContext) -> Iterable[int]:
    """Return the input unless the first numerator coefficient is 0."""
    return range(1 if block.builder.value(int(block.matrix("Numerator").ravel()[0])) == 0 else 0, block.input_count)


@block("DiscreteTransferFcn", needs=lambda block: range(not has_feedthrough(block), block.input_count), **_FILTER)  # type: ignore[arg-type]
def discrete_transfer_function(block: BlockContext) -> SignalOrBus:
    """Lower b(z)/a(z) in powers of z, highest first."""
    b, a = _coefficients(block)
    if b.size > a.size:
        raise UnsupportedError("its numerator has a higher order than its denominator")
    return _filter_input(block, [block.builder.const(0.0)] * (a.size - b.size) + b.flat, a.flat)


@block("DiscreteFilter", needs=_filter_needs, **_FILTER)  # type: ignore[arg-type]
def discrete_filter(block: BlockContext) -> SignalOrBus:
    """Lower b/a in powers of 1/z, lowest first."""
    b, a = _coefficients(block)
    size = max(b.size, a.size)
    zero = block.builder.const(0.0)
    return _filter_input(block, b.flat + [zero] * (size - b.size), a.flat + [zero] * (size - a.size))


@block("DiscreteFir", Coefficients="[0.5 0.5]", InitialStates="0", CoefSource="Dialog", ExternalReset="None",
       FilterStructure="Direct form", ShowEnablePort="off", SampleTime="-1")  # fmt: skip
def fir_filter(block: BlockContext) -> SignalOrBus:
    """Lower an FIR filter in powers of 1/z, lowest first."""
    block.option("CoefSource", "Dialog", "Dialog parameters")
    kind = block.option("FilterStructure", *(f"Direct form{structure}" for structure in _FIR_STRUCTURES))
    _check_starts(block, kind != "Direct form transposed")
    if block.is_on("ShowEnablePort"):
        raise UnsupportedError("it has an enable port, which is not supported")
    b = _row(block, "Coefficients").flat
    return _filter_input(block, b, [block.builder.const(1.0)] + [block.builder.const(0.0)] * (len(b) - 1))


def _coefficients(block: BlockContext) -> tuple[Signal, Signal]:
    for name in ("Numerator", "Denominator", "InitialStates"):
        block.option(f"{name}Source", "Dialog")
    _check_starts(block, block.is_set_to("FilterStructure", "Direct form II"))
    return _row(block, "Numerator"), _row(block, "Denominator")


def _row(block: BlockContext, name: str) -> Signal:
    signal = block.parameter(name)
    if signal.nodes.ndim > 1:
        raise UnsupportedError(f"its {name} is a matrix of {signal.shape[0]} filters, which is not supported")
    return signal


def _check_starts(block: BlockContext, known: bool) -> None:
    """Raise `UnsupportedError` if initial states belong to a filter structure with other states than direct form II."""
    if not known and any(block.builder.value(node) != 0 for node in block.parameter("InitialStates").flat):
        structure = block.field_text("FilterStructure")
        raise UnsupportedError(f"initial states are not supported for the structure {structure!r}")


def _filter_input(block: BlockContext, b: list[int], a: list[int]) -> Signal:
    resets = external_reset(block)
    return _direct_form(block, b, a, block.parameter("InitialStates"), resets)


def _direct_form(block: BlockContext, b: list[int], a: list[int], inits: Signal, anew: Signal | None = None) -> Signal:
    """Lower direct form II for each element: w = u - a1 w1 - ..., y = b0 w + b1 w1 + ...

    w1, w2, ... are w of previous samples. Coefficients are divided by a0, and w is a0 times the state. `inits` are the
    initial states, to which `anew` resets.
    """
    lead, order = a[0], len(a) - 1
    # `ahead` is b0, the only coefficient through which the input reaches the output in the same sample
    ahead, *gains = (block.signal([divide_by_lead(block, node, lead)], CONSTANT) for node in b)
    back = [block.signal([divide_by_lead(block, node, lead)], CONSTANT) for node in a[1:]]
    states: list[Signal] = []

    @cache
    def enter() -> Signal:
        w = block.hold_in_minor_steps(block.input())
        for gain, state in zip(back, states, strict=True):
            w = w - gain * state
        return w

    def follow(at: int) -> SignalRule:
        return lambda _: enter() if at == 0 else states[at - 1]

    starts = _initial_states(block, inits, order, lead)
    states += [block.discrete_state(start, follow(at)) for at, start in enumerate(starts)]
    if anew is not None:
        # in place, because `enter` reads the same list when the states are completed
        states[:] = [select(anew, start, state) for start, state in zip(starts, states, strict=True)]
    terms = [gain * state for gain, state in zip(gains, states, strict=True)]
    if block.builder.value(ahead.flat[0]) != 0:
        terms.insert(0, ahead * enter())
    return block.reduce("add", terms)


def _initial_states(block: BlockContext, inits: Signal, order: int, lead: int) -> list[Signal]:
    """Return the initial states times the leading coefficient."""
    if inits.size not in (1, order) and order:
        raise UnsupportedError(f"it has {inits.size} initial states for an order of {order}")
    signals = [block.signal([block.builder.call("mul", lead, node)]) for node in inits.flat]
    return signals * order if inits.size == 1 else signals[:order]


@block("UnitDelay", output=LIKE_INPUT, needs=no_feedthrough, InitialCondition="0", SampleTime="1")
@block("Memory", output=LIKE_INPUT, needs=no_feedthrough, InitialCondition="0", InheritSampleTime="off")
def unit_delay(block: BlockContext) -> SignalOrBus:
    """Delay the input by one sample, or by one major step."""
    init = parameter_or_bus(block, block.field_name("X0", "InitialCondition"))
    return delay_members(block, init, lambda start, arriving: block.discrete_state(start, lambda _: arriving()))


@block("ZeroOrderHold", "Zero-Order Hold", output=LIKE_INPUT, SampleTime="1")
def zero_order_hold(block: BlockContext) -> SignalOrBus:
    """Hold the input of the last sample hit."""
    return map_members(block.hold_in_minor_steps, "", block.input_or_bus(0))


@block("InitialCondition", Value="1", SampleTime="-1")
def initial_condition(block: BlockContext) -> SignalOrBus:
    """Return a constant in the first step, the input afterwards."""
    begun = block.discrete_state(block.constant(0.0), lambda _: block.constant(1.0))
    return select(begun, block.input(), block.parameter("Value"))


def _method(block: BlockContext) -> tuple[str, bool]:
    """Return the method of a discrete integrator, and True if it accumulates without the sample time."""
    # "ForwardEuler" in older files, "Integration: Forward Euler" or "Accumulation: ..." in newer ones
    written = block.field_text("IntegratorMethod")
    kind, _, method = written.rpartition(":")
    name, form = match_word(method, _METHODS), match_word(kind or "Integration", ("Integration", "Accumulation"))
    if name is None or form is None:
        raise UnsupportedError(f"IntegratorMethod {written!r} is not supported")
    return _METHODS[name], form == "Accumulation"


@block("DiscreteIntegrator", output=ARITHMETIC,
       needs=lambda block: range(_method(block)[0] == "forward", block.input_count),
       IntegratorMethod="Integration: Forward Euler", gainval="1.0", ExternalReset="none",
       InitialConditionSource="internal", InitialCondition="0", InitialConditionSetting="Output", LimitOutput="off",
       UpperSaturationLimit="inf", LowerSaturationLimit="-inf", ShowSaturationPort="off", ShowStatePort="off",
       SampleTime="1")  # fmt: skip
def discrete_integrator(block: BlockContext) -> Outputs:
    """Accumulate K T u by forward Euler, backward Euler or the trapezoidal rule."""
    method, accumulates = _method(block)
    init = integrator_start(block)
    gain, ahead = block.parameter("gainval"), block.parameter("gainval")
    if not accumulates:
        _check_not_triggered(block)
        # on uneven time, T before the sample (gain) and T after it (ahead) differ
        gain, ahead = gain * block.sample_step(), ahead * block.next_sample_step()
    reset = external_reset(block, sampled=True)
    y = with_saturation(block, _accumulate(block, method, (gain, ahead), init, reset))
    if method == "forward" or not block.is_on("ShowStatePort"):
        return y
    if reset is not None:
        raise UnsupportedError(f"its state port outputs the state before a reset, which is not supported for {method}")
    return (*y, y[0]) if isinstance(y, tuple) else (y, y)


def _check_not_triggered(block: BlockContext) -> None:
    """Raise `UnsupportedError` in a triggered subsystem, which would need the time since it last ran."""
    if is_triggered(block.flat):
        raise UnsupportedError("it integrates over time in a triggered subsystem, which is not supported")


def _accumulate(
    block: BlockContext, method: str, gains: tuple[Signal, Signal], init: Signal, reset: Signal | None
) -> Signal:
    """Lower the sum; `gains` are K T of the steps before and after the sample."""

    def increment(gain: Signal) -> Signal:
        step = gain * block.hold_in_minor_steps(block.input(0))
        return 0.5 * step if method == "trapezoidal" else step

    signals: list[Signal] = []

    def then(_: Signal) -> Signal:
        return signals[0] if method == "backward" else limit_output(block, signals[0] + increment(gains[1]))

    # forward: y = x, x' = y + K T2 u; backward: y = x + K T1 u, x' = y;
    # trapezoidal: y = x + K T1 u / 2, x' = y + K T2 u / 2, with T1 before the sample and T2 after it
    # the output of the forward rule is its state, which starts, resets and advances within the limits
    x = block.discrete_state(limit_output(block, init) if method == "forward" else init, then, ported=True)
    # the output, not the state before the input is added, starts at the initial value
    as_output = block.is_set_to("InitialConditionSetting", "Output", "State and output")
    anew = None
    if method != "forward" and as_output:  # in the first step and on reset
        first = ~block.discrete_state(block.constant(0.0), lambda _: block.constant(1.0))
        anew = first if reset is None else first | reset
    if anew is None:
        x = x if reset is None else select(reset, limit_output(block, init), x)
    if method == "forward":
        signals.append(x)
    else:
        y = x + increment(gains[0])
        signals.append(limit_output(block, y if anew is None else select(anew, init, y)))
    return signals[0]


@block("DiscreteStateSpace", needs=feedthrough_inputs, A="1", B="1", C="1", D="1",
       InitialCondition="0", X0="0", SampleTime="1")  # fmt: skip
def discrete_state_space(block: BlockContext) -> SignalOrBus:
    """Lower x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k]."""
    matrices, init = read_matrices(block)
    return linear_output(block, matrices, lambda rule: block.discrete_state(init, rule))


@block("Discrete Derivative", gainval="1.0", ICPrevScaledInput="0.0")
def discrete_derivative(block: BlockContext) -> SignalOrBus:
    """Compute the difference of K u / T to the previous sample, T in s."""
    _check_not_triggered(block)
    scaled = block.parameter("gainval") * block.hold_in_minor_steps(block.input())
    return scaled_difference(block, scaled, "ICPrevScaledInput")


def scaled_difference(block: BlockContext, u: Signal, init: str, reset: Signal | None = None) -> Signal:
    """Compute (u - u') / T, T in s, u' being the previous input; a field states u' / T at first and at a reset."""
    # the state holds u' divided by the step that ends at the next sample
    now, then = u / block.sample_step(), u / block.next_sample_step()
    start = block.parameter(init)
    before = block.discrete_state(start, lambda _: then)
    return now - (before if reset is None else select(reset, start, before))


@block("Difference", library_mask=True, ICPrevInput="0.0")
def difference(block: BlockContext) -> SignalOrBus:
    """Subtract the input of the previous sample."""
    u = block.hold_in_minor_steps(block.input())
    return u - block.discrete_state(block.parameter("ICPrevInput"), lambda _: u)


@block("First Order Transfer Fcn", "First-Order Transfer Fcn", PoleZ="0.95", ICPrevOutput="0.0")
def first_order(block: BlockContext) -> SignalOrBus:
    """Lower the first-order lag y = p (y' - u) + u, in which y' is the previous output."""
    u, pole = block.hold_in_minor_steps(block.input()), block.parameter("PoleZ")
    return block.feedback(block.parameter("ICPrevOutput"), lambda before: pole * (before - u) + u)


@block("DiscreteZeroPole", needs=zero_pole_feedthrough, Zeros="[1]", Poles="[0 0.5]", Gain="1", SampleTime="1")
def discrete_zero_pole(block: BlockContext) -> SignalOrBus:
    """Lower K (z - z1) ... / ((z - p1) ...) with zero initial states."""
    b, a = quotient(block)
    b = [block.builder.const(0.0)] * (len(a) - len(b)) + b
    return _direct_form(block, b, a, block.constant(0.0))


@block("Lead or Lag Compensator", "Transfer Fcn Lead or Lag", linked=True, PoleZ="0.95", ZeroZ="0.75",
       ICPrevOutput="0.0", ICPrevInput="0.0")  # fmt: skip
def lead_or_lag(block: BlockContext) -> SignalOrBus:
    """Compute u - z u' + p y', in which u' and y' are the input and output of the previous sample."""
    init, pole = block.parameter("ICPrevOutput"), block.parameter("PoleZ")
    return block.feedback(init, lambda before: pole * before + _with_zero(block))


@block("Transfer Fcn Real Zero", linked=True, ZeroZ="0.75", ICPrevInput="0.0")
def real_zero(block: BlockContext) -> SignalOrBus:
    """Compute u - z u', in which u' is the input of the previous sample."""
    return _with_zero(block)


def _with_zero(block: BlockContext) -> Signal:
    u = block.hold_in_minor_steps(block.input())
    before = block.discrete_state(block.parameter("ICPrevInput"), lambda _: u)
    return u - block.parameter("ZeroZ") * before


@block("Weighted Moving Average", sample="samptime", linked=True, mgainval="[0.1:0.1:1]", vinit="0.0", samptime="-1")
def moving_average(block: BlockContext) -> SignalOrBus:
    """Add up the last inputs with weights, latest first."""
    weights = block.parameter("mgainval").flat
    number, zero = block.builder.const(1.0), block.builder.const(0.0)
    # an FIR filter: all poles are 0
    return _direct_form(block, weights, [number] + [zero] * (len(weights) - 1), block.parameter("vinit"))


@block("SampleTimeMath", "Weighted Sample Time Math", TsampMathOp="+", weightValue="1.0",
       SampleTime="-1")  # fmt: skip
def sample_time_math(block: BlockContext) -> SignalOrBus:
    """Combine the input with the weighted sample time, or return that time alone."""
    if is_triggered(block.flat):
        raise UnsupportedError("it uses the sample time in a triggered subsystem, which is not supported")
    operation = block.option("TsampMathOp", "+", "-", "*", "/", "Ts Only", "1/Ts Only")
    weighted = block.parameter("weightValue") * block.sample_step()
    match operation:
        case "Ts Only":
            return weighted
        case "1/Ts Only":
            return 1.0 / weighted
    return apply({"+": "add", "-": "sub", "*": "mul", "/": "div"}[operation], block.input(), weighted)
