"""Continuous library: integrators, transfer functions, state space models, derivative and transport delays."""

from collections.abc import Callable, Iterable
from typing import TypeAlias

import numpy as np

from kennfeld.base.formatting import size_text, toml_text
from kennfeld.importers.simulink.lowering import (
    ARITHMETIC,
    BlockContext,
    Outputs,
    UnsupportedError,
    block,
    no_feedthrough,
)
from kennfeld.importers.simulink.lowering.diagnostics import STEP_REMEDY
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.signals import (
    Signal,
    SignalOrBus,
    SignalRule,
    apply,
    clip,
    interpolate_line,
    limit,
    select,
)
from kennfeld.models.imperative.node_arrays import Nodes, reduce_nodes
from kennfeld.models.imperative.path_facts import bound_of

_MAX_ORDER = 100  # of a zero-pole transfer function
_MAX_STATES = 1000  # of a variable delay, which needs a state for each step


@block("TransportDelay", needs=no_feedthrough, DelayTime="1", InitialOutput="0", TransDelayFeedthrough="off")
def transport_delay(block: BlockContext) -> SignalOrBus:
    """Delay the input by a constant time in s, interpolated linearly between steps."""
    time, step = block.numeric_field("DelayTime"), _fixed_step(block)
    count = time / step
    # 0.3 s / 0.1 s is a little below 3
    whole = int(np.floor(count + 1e-9))
    if not 1 <= whole <= 100_000:
        raise UnsupportedError(f"its delay of {time:g} s must be between 1 and 100000 steps of {step:g} s")
    init = block.parameter("InitialOutput")
    late = block.discrete_state(init, lambda _: block.input(), whole)
    share = count - whole
    if abs(share) < 1e-9:
        return _delay_output(block, block.constant(time), late, init)
    # u[k - whole] and u[k - whole - 1], between which the delayed time lies
    later = block.discrete_state(init, lambda _: late)
    return _delay_output(block, block.constant(time), late + share * (later - late), init)


def _fixed_step(block: BlockContext) -> float:
    if block.compiler.clock.step is None:
        raise UnsupportedError("a transport delay requires a fixed-step model", STEP_REMEDY)
    return block.compiler.clock.step


def _delay_output(block: BlockContext, delay: Signal, late: Signal, init: Signal) -> Signal:
    """Return the delayed signal once the time exceeds the delay, the initial output before."""
    passed = block.hold_in_minor_steps(block.time) > delay + block.time_tolerance()
    return select(passed, late, init)


def _steps(block: BlockContext, time: Signal) -> tuple[int, bool]:
    """Return how many steps a variable delay may reach back: its longest one, or less if its input is limited.

    The second value is True if that is less than its `MaximumDelay`; a longer delay is then unknown.
    """
    step, longest = _fixed_step(block), block.numeric_field("MaximumDelay")
    count = int(np.ceil(longest / step - 1e-9))
    bound = bound_of(block.builder, time.flat[0], up=True)
    if 0.0 <= bound < longest:
        # one more, as distances travelled are rounded
        count = min(count, int(np.ceil(bound / step - 1e-9)) + 1)
    if count < 1:
        raise UnsupportedError(f"its MaximumDelay of {longest:g} s is less than a step of {step:g} s")
    if count <= _MAX_STATES:
        return count, False
    # NaN is seen, where the value of the longest delay would look right
    field = toml_text(f"{block.flat.path}:MaximumDelay")
    block.warn(
        f"is NaN while its delay exceeds {_MAX_STATES * step:g} s: its MaximumDelay of {longest:g} s is {count} steps, "
        f"and at most {_MAX_STATES} are supported. A shorter MaximumDelay, or a Saturation of its delay with constant "
        f"limits, saves memory and time: [parameters.{field}]"
    )
    return _MAX_STATES, True


def _handles_zero(block: BlockContext) -> bool:
    """Return True if the delay may be shorter than a step, so that the signal has feedthrough."""
    return block.is_on("ZeroDelay") and block.is_set_to("VariableDelayType", "Variable time delay")


@block("VariableTransportDelay", needs=lambda block: (0, 1) if _handles_zero(block) else (1,),
       VariableDelayType="Variable transport delay", MaximumDelay="10", InitialOutput="0", PadeOrder="0",
       ZeroDelay="off")  # fmt: skip
def variable_delay(block: BlockContext) -> SignalOrBus:
    """Delay the input by a variable time in s, or by the transport time of a pipe."""
    kind = block.option("VariableDelayType", "Variable transport delay", "Variable time delay")
    arriving = block.input(1)
    time = block.hold_in_minor_steps(arriving)
    if time.size != 1:
        raise UnsupportedError("its delay is a vector, which is not supported")
    (count, is_capped), init = _steps(block, arriving), block.parameter("InitialOutput")
    steps = range(1, count + 1)
    late = [block.discrete_state(init, lambda _: block.hold_in_minor_steps(block.input(0)), at) for at in steps]
    oldest = block.constant(np.nan) if is_capped else late[-1]
    if kind == "Variable transport delay":
        return _transport(block, time, late, init, oldest)
    time = apply("max", time, 0.0)
    if not _handles_zero(block):
        return _delay_output(block, time, _interpolate_past(block, time, late, 1, oldest), init)
    u = block.hold_in_minor_steps(block.input(0))
    y = _delay_output(block, time, _interpolate_past(block, time, [u, *late], 0, oldest), init)
    return select(apply("eq", time, 0.0), u, y)


def _interpolate_past(block: BlockContext, time: Signal, late: list[Signal], first: int, oldest: Signal) -> Signal:
    """Interpolate linearly between the two steps around `time`.

    `late` holds the inputs of past steps, latest first, beginning `first` steps ago. The line between the two latest
    ones is extrapolated to a shorter delay; `oldest` is the result for a longer delay.
    """
    steps = time / block.base_step
    result = oldest
    # from the longest delay to the shortest, so that the last condition that holds selects
    for at in range(len(late) - 1, 0, -1):
        share = steps - float(first + at - 1)
        between = late[at - 1] + share * (late[at] - late[at - 1])
        result = select(steps < float(first + at), between, result)
    return result


def _transport(block: BlockContext, time: Signal, late: list[Signal], init: Signal, oldest: Signal) -> Signal:
    """Return the input one transport ago; the distance travelled, in pipe lengths, is the integral of 1/time."""
    zero, rate = block.constant(0.0), 1.0 / time

    def travel(before: Signal) -> Signal:
        rate_before = block.discrete_state(rate, lambda _: rate)
        begun = block.discrete_state(zero, lambda _: block.constant(1.0))
        # trapezoidal rule: s[k] = s[k-1] + T / 2 (1 / tau[k] + 1 / tau[k-1]), s[0] = 0
        return select(begun, before + 0.5 * block.base_step * (rate + rate_before), zero)

    distance = block.feedback(zero, travel)
    distances = [block.discrete_state(zero, lambda _: distance, at) for at in range(1, len(late) + 1)]
    # what leaves the pipe entered it when the distance was one pipe length less
    entered = distance - 1.0
    y = oldest
    for at in range(len(late) - 1, 0, -1):
        between = interpolate_line(entered, (distances[at], distances[at - 1]), (late[at], late[at - 1]))
        y = select(entered >= distances[at], between, y)
    # less than a step ago: held, as the present input may not feed through
    y = select(entered >= distances[0], late[0], y)
    return select(entered < zero, init, y)


def external_reset(block: BlockContext, sampled: bool = False, port: int = 1) -> Signal | None:
    """Return 1 if the external reset at an input occurs, None if there is none; see `reset_signal`."""
    kind = block.field_text("ExternalReset")
    return reset_signal(block, block.input(port), kind, sampled) if has_external_reset(block) else None


def has_external_reset(block: BlockContext) -> bool:
    """Return True if a block has a reset port."""
    return not block.is_set_to("ExternalReset", "none")


def output_limits(block: BlockContext) -> tuple[Signal, Signal] | None:
    """Read the lower and upper limit of the output, None if it is not limited."""
    if not block.is_on("LimitOutput"):
        return None
    return block.parameter("LowerSaturationLimit"), block.parameter("UpperSaturationLimit")


def limit_output(block: BlockContext, y: Signal) -> Signal:
    """Limit the output as the block specifies, and to the limits of its type if it saturates."""
    limits = output_limits(block)
    y = y if limits is None else clip(y, *limits)
    # a state that is limited by its type does not wind up beyond
    return y if block.type_limits is None else limit(y, *block.type_limits)


def integrator_start(block: BlockContext) -> Signal:
    """Read the initial value of an integrator: a parameter, or its last input."""
    external = block.is_set_to("InitialConditionSource", "external")
    return block.input(block.input_count - 1) if external else block.parameter("InitialCondition")


@block("Integrator", output=ARITHMETIC, continuous=True,
       needs=lambda block: range(1, block.input_count), InitialCondition="0",
       InitialConditionSource="internal", ExternalReset="none", LimitOutput="off", UpperSaturationLimit="inf",
       LowerSaturationLimit="-inf", ShowSaturationPort="off", ShowStatePort="off", WrapState="off",
       WrappedStateUpperValue="pi", WrappedStateLowerValue="-pi")  # fmt: skip
def integrator(block: BlockContext) -> Outputs:
    """Integrate the input over time, with external reset and limits."""
    if block.is_on("WrapState"):
        return _wrapped_integral(block)
    init, limits, reset = integrator_start(block), output_limits(block), external_reset(block)
    # the state starts, resets and advances within its limits: its output needs no limits of its own
    return with_saturation(block, block.continuous_state(init, lambda _: block.input(0), reset, limits, ported=True))


def _wrapped_integral(block: BlockContext) -> Signal:
    """Integrate an angle, which goes on at the other end of its range; the slope does not depend on the turns."""
    if block.is_on("LimitOutput") or block.is_on("ShowStatePort"):
        raise UnsupportedError("its state is wrapped and has limits or a state port, which is not supported")
    lower, upper = block.parameter("WrappedStateLowerValue"), block.parameter("WrappedStateUpperValue")
    turned = block.continuous_state(integrator_start(block), lambda _: block.input(0), external_reset(block))
    return lower + (turned - lower) % (upper - lower)


def with_saturation(block: BlockContext, y: Signal) -> Outputs:
    """Return the output of an integrator and, if shown, its saturation port: 1 at the upper limit, -1 at the lower."""
    if not block.is_on("ShowSaturationPort"):
        return y
    limits = output_limits(block)
    return y, 0.0 * y if limits is None else select(y >= limits[1], 1.0, select(y <= limits[0], -1.0, 0.0))


def reset_signal(block: BlockContext, u: Signal, kind: str, sampled: bool = False) -> Signal:
    """Return 1 if an external reset occurs; a `sampled` one only compares the sign of the signal."""
    u = block.hold_in_minor_steps(u)
    if (edge := match_word(kind, ("rising", "falling", "either"))) is not None:
        return block.level_crossing(u, edge) if sampled else block.zero_crossing(u, edge)
    if match_word(kind, ("level hold", "sampled level")) is not None:
        return apply("ne", u, 0.0)
    if match_word(kind, ("level",)) is not None:
        # a level resets while it is not 0, and once more in the step in which it returns to 0
        before = block.discrete_state(block.constant(0.0), lambda _: u)
        return apply("ne", u, 0.0) | apply("ne", before, 0.0)
    raise UnsupportedError(f"its reset {kind!r} is not supported")


def has_feedthrough(block: BlockContext) -> bool:
    """Return True if the numerator of a transfer function has the order of its denominator."""
    numerator = block.matrix("Numerator")
    # a leading coefficient that is the constant 0 feeds nothing through, whatever the order
    same_order = numerator.shape[-1] >= block.matrix("Denominator").size
    return same_order and any(block.builder.value(int(node)) != 0 for node in numerator[..., 0])


@block(
    "TransferFcn",
    continuous=True,
    needs=lambda block: range(has_feedthrough(block)),
    Numerator="[1]",
    Denominator="[1 2 1]",
)
def transfer_function(block: BlockContext) -> SignalOrBus:
    """Lower b(s)/a(s) in controllable canonical form with zero initial states."""
    numerator, denominator = block.matrix("Numerator"), block.matrix("Denominator").ravel()
    if numerator.shape[0] != 1:
        raise UnsupportedError("its numerator has several rows (several outputs), which is not supported")
    return rational_output(block, [int(n) for n in numerator.ravel()], [int(n) for n in denominator])


def rational_output(block: BlockContext, numerator: list[int], denominator: list[int]) -> Signal:
    """Lower a rational function of s with zero initial states; coefficients have the highest power first."""
    const, call, order = block.builder.const, block.builder.call, len(denominator) - 1
    if len(numerator) > order + 1:
        raise UnsupportedError("its numerator has a higher order than its denominator")
    padded = [const(0.0)] * (order + 1 - len(numerator)) + numerator
    b = [divide_by_lead(block, node, denominator[0]) for node in padded]
    a = [divide_by_lead(block, node, denominator[0]) for node in denominator[1:]]
    if order == 0:
        return block.signal([b[0]]) * block.input()
    # x1' = -a1 x1 - a2 x2 - ... + u, x2' = x1, ...; y = (b1 - a1 b0) x1 + ... + b0 u
    A = np.full((order, order), const(0.0), dtype=np.int64)
    A[0, :] = [call("neg", node) for node in a]
    A[range(1, order), range(order - 1)] = const(1.0)
    B = np.array([[const(1.0)]] + [[const(0.0)]] * (order - 1), dtype=np.int64)
    C = np.array([[call("sub", b[i + 1], call("mul", a[i], b[0])) for i in range(order)]], dtype=np.int64)
    init = block.constant(*[0.0] * order)
    return linear_output(block, (A, B, C, np.array([[b[0]]])), lambda slope: block.continuous_state(init, slope))


def divide_by_lead(block: BlockContext, node: int, lead: int) -> int:
    """Divide a coefficient by the leading one; a constant 0 stays 0."""
    # 0 over a parameter would be a node that is not known to be 0, and a loop through it an algebraic one
    return node if block.builder.value(node) == 0 else block.builder.call("div", node, lead)


def feedthrough_inputs(block: BlockContext) -> tuple[int, ...]:
    """Return the input if D is not zero."""
    return () if _is_zero(block, block.matrix("D")) else (0,)


def _is_zero(block: BlockContext, matrix: Nodes) -> bool:
    return all(block.builder.value(int(node)) == 0 for node in matrix.ravel())


@block(
    "StateSpace", continuous=True, needs=feedthrough_inputs, A="1", B="1", C="1", D="1", InitialCondition="0", X0="0"
)
def state_space(block: BlockContext) -> SignalOrBus:
    """Lower x' = A x + B u, y = C x + D u."""
    matrices, init = read_matrices(block)
    return linear_output(block, matrices, lambda slope: block.continuous_state(init, slope))


Matrices: TypeAlias = tuple[Nodes, Nodes, Nodes, Nodes]


def linear_output(block: BlockContext, matrices: Matrices, create: Callable[[SignalRule], Signal]) -> Signal:
    """Compute y = C x + D u; `create` returns the states x, whose slopes or next values are A x + B u."""
    A, B, C, D = matrices
    x = create(lambda x: _matrix_times_vector(block, A, x) + _matrix_times_vector(block, B, block.input()))
    y = _matrix_times_vector(block, C, x)
    return y if _is_zero(block, D) else y + _matrix_times_vector(block, D, block.input())


def read_matrices(block: BlockContext) -> tuple[Matrices, Signal]:
    """Read A, [n, n], B, [n, inputs], C, [outputs, n], D, [outputs, inputs], and the initial states, [n]."""
    A, B, C, D = (block.matrix(name) for name in "ABCD")
    init = block.parameter(block.field_name("InitialCondition", "X0"))
    first = block.signal(np.full((A.shape[0],), init.flat[0])) if init.size == 1 else init
    if A.shape[0] != A.shape[1] or first.size != A.shape[0]:
        sizes = f"A ({size_text(A.shape)}) and its initial values ({first.size})"
        raise UnsupportedError(f"the sizes of {sizes} do not match")
    return (A, B, C, D), first


def _matrix_times_vector(block: BlockContext, matrix: Nodes, x: Signal) -> Signal:
    if matrix.shape[1] != x.size:
        size = size_text(matrix.shape)
        raise UnsupportedError(f"a matrix of size {size} cannot be multiplied by a vector of {x.size} elements")
    call = block.builder.call
    products = [[call("mul", int(a), b) for a, b in zip(row, x.flat, strict=True)] for row in matrix]
    return block.signal([reduce_nodes(block.builder, "add", row) for row in products], x.period)


@block("Derivative", CoefficientInTFapproximation="inf")
def derivative(block: BlockContext) -> SignalOrBus:
    """Compute the difference quotient of the input since the previous major step; 0 in the first step."""
    u = block.hold_in_minor_steps(block.input())
    return (u - block.discrete_state(u, lambda _: u)) / block.base_step


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


def multiply_out(block: BlockContext, roots: list[int]) -> list[int]:
    """Return the coefficients of (x - r1) (x - r2) ..., highest power first."""
    call, zero, nodes = block.builder.call, block.builder.const(0.0), [block.builder.const(1.0)]
    for root in roots:
        shifted = [call("mul", call("neg", root), node) for node in nodes]
        # p(x) (x - root) = x p(x) - root p(x)
        nodes = [call("add", high, low) for high, low in zip([*nodes, zero], [zero, *shifted], strict=True)]
    return nodes


def quotient(block: BlockContext) -> tuple[list[int], list[int]]:
    """Multiply out zeros, poles and gain to numerator and denominator, highest power first."""
    zeros, poles = _roots(block, "Zeros"), _roots(block, "Poles")
    if len(zeros) > len(poles):
        raise UnsupportedError(f"it has more zeros ({len(zeros)}) than poles ({len(poles)})")
    gain = block.parameter("Gain")
    if gain.size != 1:
        raise UnsupportedError("it has several gains (several outputs), which is not supported")
    numerator = [block.builder.call("mul", gain.flat[0], node) for node in multiply_out(block, zeros)]
    return numerator, multiply_out(block, poles)


def zero_pole_feedthrough(block: BlockContext) -> Iterable[int]:
    """Return the input if there are as many zeros as poles."""
    return (0,) if len(_roots(block, "Zeros")) >= len(_roots(block, "Poles")) else ()


@block("ZeroPole", continuous=True, needs=zero_pole_feedthrough, Zeros="[1]", Poles="[0 -1]", Gain="[1]")
def zero_pole(block: BlockContext) -> SignalOrBus:
    """Lower K (s - z1) ... / ((s - p1) ...) with zero initial states."""
    return rational_output(block, *quotient(block))


@block("SecondOrderIntegrator", continuous=True, needs=no_feedthrough, ICX="0.0", ICDXDT="0.0", ICSourceX="internal",
       ICSourceDXDT="internal", ExternalReset="none", LimitX="off", LimitDXDT="off", ShowOutput="both")  # fmt: skip
def second_order_integrator(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Integrate the input twice; return the second and the first integral."""
    for name in ("ICSourceX", "ICSourceDXDT"):
        block.option(name, "internal")
    for name in ("LimitX", "LimitDXDT", "ExternalReset"):
        block.option(name, "off", "none")
    v = block.continuous_state(block.parameter("ICDXDT"), lambda _: block.input())
    x = block.continuous_state(block.parameter("ICX"), lambda _: v)
    shown = block.option("ShowOutput", "both", "x", "dx/dt")
    return (x, v) if shown == "both" else (x,) if shown == "x" else (v,)
