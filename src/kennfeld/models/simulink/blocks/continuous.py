"""Continuous library: integrators, transfer functions, state space models, derivative and transport delays."""

from collections.abc import Iterable

import numpy as np

from kennfeld.models.imperative.node_arrays import Nodes, reduce_nodes
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block, no_feedthrough
from kennfeld.models.simulink.signals import Signal, SignalOrBus, scalar, size_text

_MAX_STATES = 1000  # of a variable delay, which needs a state for each step


@block("TransportDelay", needs=no_feedthrough, DelayTime="1", InitialOutput="0", TransDelayFeedthrough="off")
def transport_delay(block: BlockContext) -> SignalOrBus:
    """Return the input delayed by a constant time, interpolated linearly between steps."""
    step = block.compiler.clock.step
    time = block.numeric_field("DelayTime")
    if step is None:
        raise UnsupportedError("a transport delay requires a fixed-step model", "Set a fixed step.")
    count = time / step
    whole = int(np.floor(count + 1e-9))
    if not 1 <= whole <= 100_000:
        raise UnsupportedError(f"its delay of {time:g} s must be between 1 and 100000 steps of {step:g} s")
    init = block.parameter("InitialOutput")
    late = block.discrete_state(init, lambda _: block.input(), whole)
    share = count - whole
    if abs(share) < 1e-9:
        return _delay_output(block, block.constant(time), late, init)
    later = block.discrete_state(init, lambda _: late)
    between = block.apply("add", late, block.apply("mul", block.constant(share), block.apply("sub", later, late)))
    return _delay_output(block, block.constant(time), between, init)


def _delay_output(block: BlockContext, delay: Signal, late: Signal, init: Signal) -> Signal:
    """Return the delayed signal once the time exceeds the delay, the initial output before."""
    near = block.constant(1e-6 * (block.compiler.clock.step or 0.0))
    passed = block.apply("gt", block.hold_in_minor_steps(block.time), block.apply("add", delay, near))
    return block.select(passed, late, init)


def _steps(block: BlockContext) -> int:
    """Return how many steps a variable delay may reach back."""
    step, longest = block.compiler.clock.step, block.numeric_field("MaximumDelay")
    if step is None:
        raise UnsupportedError("a transport delay requires a fixed-step model", "Set a fixed step.")
    count = int(np.ceil(longest / step - 1e-9))
    if not 1 <= count <= _MAX_STATES:
        message = (
            f"its MaximumDelay of {longest:g} s is {count} steps of {step:g} s; at most {_MAX_STATES} are supported"
        )
        field = f"{block.flat.path}:MaximumDelay"
        raise UnsupportedError(
            message,
            f'Set a shorter one: [parameters."{field}"] initial = {_MAX_STATES * step:g} in the project, in '
            f'Python parameters=[{{"{field}": {_MAX_STATES * step:g}}}].',
        )
    return count


def _variable_needs(block: BlockContext) -> Iterable[int]:
    """Return the inputs with feedthrough: the signal, if the delay may be shorter than a step."""
    return (0, 1) if _handles_zero(block) else (1,)


def _handles_zero(block: BlockContext) -> bool:
    return block.is_on("ZeroDelay") and block.field_text("VariableDelayType") == "Variable time delay"


@block("VariableTransportDelay", needs=_variable_needs, VariableDelayType="Variable transport delay",
       MaximumDelay="10", InitialOutput="0", PadeOrder="0", ZeroDelay="off")  # fmt: skip
def variable_delay(block: BlockContext) -> SignalOrBus:
    """Return the input delayed by a variable time, or by the transport time of a pipe."""
    kind = block.option("VariableDelayType", "Variable transport delay", "Variable time delay")
    time = block.hold_in_minor_steps(block.input(1))
    if time.size != 1:
        raise UnsupportedError("its delay is a vector, which is not supported")
    count, init = _steps(block), block.parameter("InitialOutput")
    late = [
        block.discrete_state(init, lambda _: block.hold_in_minor_steps(block.input(0)), at)
        for at in range(1, count + 1)
    ]
    if kind == "Variable transport delay":
        return _transport(block, time, late, init)
    time = block.apply("max", time, block.constant(0.0))
    if not _handles_zero(block):
        return _delay_output(block, time, _interpolate_past(block, time, late, 1), init)
    u = block.hold_in_minor_steps(block.input(0))
    y = _delay_output(block, time, _interpolate_past(block, time, [u, *late], 0), init)
    return block.select(block.apply("eq", time, block.constant(0.0)), u, y)


def _interpolate_past(block: BlockContext, time: Signal, late: list[Signal], first: int) -> Signal:
    """Interpolate linearly between the two steps around `time`.

    `late` holds the inputs of past steps, latest first, beginning `first` steps ago. Before the earliest the line is
    extrapolated; after the latest the value is held.
    """
    steps = block.apply("div", time, block.base_step)
    result = late[-1]
    for at in range(len(late) - 1, 0, -1):
        share = block.apply("sub", steps, block.constant(float(first + at - 1)))
        between = block.apply(
            "add", late[at - 1], block.apply("mul", share, block.apply("sub", late[at], late[at - 1]))
        )
        result = block.select(block.apply("lt", steps, block.constant(float(first + at))), between, result)
    return result


def _transport(block: BlockContext, time: Signal, late: list[Signal], init: Signal) -> Signal:
    """Return the input one transport ago; the distance travelled, in pipe lengths, is the integral of 1/time."""
    zero, one = block.constant(0.0), block.constant(1.0)
    rate = block.apply("div", one, time)
    signals: list[Signal] = []
    before = block.discrete_state(zero, lambda _: signals[0])
    rate_before = block.discrete_state(rate, lambda _: rate)
    begun = block.discrete_state(zero, lambda _: one)
    moved = block.apply(
        "mul", block.apply("mul", block.constant(0.5), block.base_step), block.apply("add", rate, rate_before)
    )
    signals.append(block.select(begun, block.apply("add", before, moved), zero))
    distances = [block.discrete_state(zero, lambda _: signals[0], at) for at in range(1, len(late) + 1)]
    entered = block.apply("sub", signals[0], one)
    y = late[-1]
    for at in range(len(late) - 1, -1, -1):
        signal = (
            late[0]
            if at == 0
            else _between(block, entered, (distances[at], distances[at - 1]), (late[at], late[at - 1]))
        )
        y = block.select(block.apply("ge", entered, distances[at]), signal, y)
    return block.select(block.apply("lt", entered, zero), init, y)


def _between(block: BlockContext, x: Signal, xs: tuple[Signal, Signal], ys: tuple[Signal, Signal]) -> Signal:
    share = block.apply("div", block.apply("sub", x, xs[0]), block.apply("sub", xs[1], xs[0]))
    return block.apply("add", ys[0], block.apply("mul", share, block.apply("sub", ys[1], ys[0])))


def external_reset(block: BlockContext) -> str:
    """Return the kind of external reset, "none" if there is none."""
    kind = block.field_text("ExternalReset")
    return "none" if kind.casefold() == "none" else kind


def _integrator_needs(block: BlockContext) -> Iterable[int]:
    return range(1, block.input_count)


@block("Integrator", needs=_integrator_needs, InitialCondition="0", InitialConditionSource="internal",
       ExternalReset="none", LimitOutput="off", UpperSaturationLimit="inf", LowerSaturationLimit="-inf",
       ShowSaturationPort="off", ShowStatePort="off", WrapState="off")  # fmt: skip
def integrator(block: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """Integrate the input over time, with external reset and limits."""
    if block.is_on("WrapState"):
        raise UnsupportedError("WrapState is on, which is not supported")
    kind = external_reset(block)
    external = block.field_text("InitialConditionSource") == "external"
    init = block.input(block.input_count - 1) if external else block.parameter("InitialCondition")
    limits = None
    if block.is_on("LimitOutput"):
        limits = (block.parameter("LowerSaturationLimit"), block.parameter("UpperSaturationLimit"))
    reset = reset_signal(block, block.input(1), kind) if kind != "none" else None
    x = block.continuous_state(init, lambda _: block.input(0), reset, limits, ported=True)
    return with_saturation(block, x if limits is None else block.clip(x, *limits))


def with_saturation(block: BlockContext, y: Signal) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """Return the output of an integrator and, if shown, its saturation port: 1 at the upper limit, -1 at the lower."""
    return (y, _saturated(block, y)) if block.is_on("ShowSaturationPort") else y


def _saturated(block: BlockContext, y: Signal) -> Signal:
    if not block.is_on("LimitOutput"):
        return block.apply("mul", block.constant(0.0), y)
    low, high = block.parameter("LowerSaturationLimit"), block.parameter("UpperSaturationLimit")
    below = block.select(block.apply("le", y, low), block.constant(-1.0), block.constant(0.0))
    return block.select(block.apply("ge", y, high), block.constant(1.0), below)


def reset_signal(block: BlockContext, u: Signal, kind: str, sampled: bool = False) -> Signal:
    """Return 1 if an external reset occurs; a `sampled` one only compares the sign of the signal."""
    u, zero = block.hold_in_minor_steps(u), block.constant(0.0)
    kind = kind.casefold()
    if kind in ("rising", "falling", "either"):
        return block.level_crossing(u, kind) if sampled else block.zero_crossing(u, kind)
    if kind in ("level hold", "sampled level"):
        return block.apply("ne", u, zero)
    if kind == "level":
        before = block.discrete_state(zero, lambda _: u)
        return block.apply("or", block.apply("ne", u, zero), block.apply("ne", before, zero))
    raise UnsupportedError(f"its reset {kind!r} is not supported")


@block("TransferFcn", needs=lambda block: _through(block), Numerator="[1]", Denominator="[1 2 1]")
def transfer_function(block: BlockContext) -> SignalOrBus:
    """Lower b(s)/a(s) in controllable canonical form with zero initial states."""
    numerator, denominator = block.matrix("Numerator"), block.matrix("Denominator").ravel()
    if numerator.shape[0] != 1:
        raise UnsupportedError("its numerator has several rows (several outputs), which is not supported")
    return rational(block, [int(n) for n in numerator.ravel()], [int(n) for n in denominator])


def rational(block: BlockContext, numerator: list[int], denominator: list[int]) -> Signal:
    """Lower a rational function of s with zero initial states; coefficients have the highest power first."""
    order = len(denominator) - 1
    b = [divide_by_lead(block, node, denominator[0]) for node in _padded(block, numerator, order + 1)]
    a = [divide_by_lead(block, node, denominator[0]) for node in denominator[1:]]
    if order == 0:
        return block.apply("mul", scalar(b[0]), block.input())
    A = np.full((order, order), block.builder.const(0.0), dtype=np.int64)
    A[0, :] = [block.builder.call("neg", node) for node in a]
    for row in range(1, order):
        A[row, row - 1] = block.builder.const(1.0)
    B = np.array([[block.builder.const(1.0)]] + [[block.builder.const(0.0)]] * (order - 1), dtype=np.int64)
    gains = [block.builder.call("sub", b[i + 1], block.builder.call("mul", a[i], b[0])) for i in range(order)]
    zeros = Signal(np.full((order,), block.builder.const(0.0), dtype=np.int64))
    return _state_space(block, A, B, np.array([gains], dtype=np.int64), np.array([[b[0]]], dtype=np.int64), zeros)


def _through(block: BlockContext) -> Iterable[int]:
    return (0,) if has_feedthrough(block) else ()


def has_feedthrough(block: BlockContext) -> bool:
    """Return True if the numerator of a transfer function has the order of its denominator."""
    numerator = block.matrix("Numerator")
    same_order = numerator.shape[-1] >= block.matrix("Denominator").size
    return same_order and any(block.builder.value(int(node)) != 0 for node in numerator[..., 0])


def _padded(block: BlockContext, nodes: list[int], count: int) -> list[int]:
    if len(nodes) > count:
        raise UnsupportedError("its numerator has a higher order than its denominator")
    return [block.builder.const(0.0)] * (count - len(nodes)) + nodes


def divide_by_lead(block: BlockContext, node: int, lead: int) -> int:
    """Return a coefficient divided by the leading one; a constant 0 stays 0."""
    return node if block.builder.value(node) == 0 else block.builder.call("div", node, lead)


@block("StateSpace", needs=lambda block: feedthrough_inputs(block), A="1", B="1", C="1", D="1", InitialCondition="0",
       X0="0")  # fmt: skip
def state_space(block: BlockContext) -> SignalOrBus:
    """Lower x' = A x + B u, y = C x + D u."""
    A, B, C, D, first = matrices(block)
    return _state_space(block, A, B, C, D, first)


def feedthrough_inputs(block: BlockContext) -> tuple[int, ...]:
    """Return the input if D is not zero."""
    return (0,) if any(block.builder.value(int(node)) != 0 for node in block.matrix("D").ravel()) else ()


def _state_space(block: BlockContext, A: Nodes, B: Nodes, C: Nodes, D: Nodes, init: Signal) -> Signal:
    def slope(x: Signal) -> Signal:
        return block.apply("add", matrix_times_vector(block, A, x), matrix_times_vector(block, B, block.input()))

    x = block.continuous_state(init, slope, None, None)
    y = matrix_times_vector(block, C, x)
    if all(block.builder.value(int(node)) == 0 for node in D.ravel()):
        return y
    return block.apply("add", y, matrix_times_vector(block, D, block.input()))


def matrices(block: BlockContext) -> tuple[Nodes, Nodes, Nodes, Nodes, Signal]:
    """Return A, B, C, D and the initial states of a state space model."""
    A, B, C, D = (block.matrix(name) for name in "ABCD")
    key = "InitialCondition" if block.flat.block.value("InitialCondition") is not None else "X0"
    init = block.parameter(key)
    first = Signal(np.full((A.shape[0],), init.flat[0], dtype=np.int64)) if init.size == 1 else init
    if A.shape[0] != A.shape[1] or first.size != A.shape[0]:
        raise UnsupportedError(
            f"the sizes of A ({size_text(A.shape)}) and its initial values ({first.size}) do not match"
        )
    return A, B, C, D, first


def matrix_times_vector(block: BlockContext, matrix: Nodes, x: Signal) -> Signal:
    """Return the product of a matrix and a vector."""
    if matrix.shape[1] != x.size:
        raise UnsupportedError(
            f"a matrix of size {size_text(matrix.shape)} cannot be multiplied by a vector of {x.size} elements"
        )
    rows = [
        reduce_nodes(
            block.builder, "add", [block.builder.call("mul", int(a), b) for a, b in zip(row, x.flat, strict=True)]
        )
        for row in matrix
    ]
    return Signal(np.array(rows, dtype=np.int64), x.period)


@block("Derivative", CoefficientInTFapproximation="inf")
def derivative(block: BlockContext) -> SignalOrBus:
    """Return the difference quotient of the input since the previous major step; 0 in the first step."""
    u = block.hold_in_minor_steps(block.input())
    before = block.discrete_state(u, lambda _: u)
    return block.apply("div", block.apply("sub", u, before), block.base_step)
