"""Delays by a time: constant, or given by an input.

Continuous states, which the solver advances.
"""

from collections.abc import Iterable

import numpy as np

from kennfeld.models.imperative.node_arrays import Nodes, reduce_nodes
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block, no_feedthrough
from kennfeld.models.simulink.signals import Signal, SignalOrBus, scalar

__all__ = [
    "fed_through",
    "has_feedthrough",
    "matrices",
    "matrix_times_vector",
    "rational",
    "reset_signal",
    "resetting",
    "scaled",
    "with_saturation",
]

_MOST_MEMORIES = 1000  # of a delay that changes; each step of it is a memory of its own


@block("TransportDelay", needs=no_feedthrough, DelayTime="1", InitialOutput="0", TransDelayFeedthrough="off")
def transport_delay(site: BlockContext) -> SignalOrBus:
    """The input of some time before, between two steps as a line."""
    step = site.compiler.clock.step
    time = site.number("DelayTime")
    if step is None:
        raise UnsupportedError("a transport delay needs a model with a fixed step", "Give the model a fixed step.")
    count = time / step
    whole = int(np.floor(count + 1e-9))
    if not 1 <= whole <= 100_000:
        raise UnsupportedError(f"a delay of {time:g} s is less than a step of {step:g} s, or far too many of them")
    init = site.parameter("InitialOutput")
    late = site.remember(init, lambda _: site.input(), whole)
    share = count - whole
    if abs(share) < 1e-9:
        return _since(site, site.constant(time), late, init)
    later = site.remember(init, lambda _: late)
    between = site.call("add", late, site.call("mul", site.constant(share), site.call("sub", later, late)))
    return _since(site, site.constant(time), between, init)


def _since(site: BlockContext, delay: Signal, late: Signal, init: Signal) -> Signal:
    """A signal that is late from when more time than its delay has passed, the initial output until then."""
    near = site.constant(1e-6 * (site.compiler.clock.step or 0.0))
    passed = site.call("gt", site.discrete(site.time), site.call("add", delay, near))
    return site.select(passed, late, init)


def _steps(site: BlockContext) -> int:
    """How many steps back a delay that changes may reach."""
    step, longest = site.compiler.clock.step, site.number("MaximumDelay")
    if step is None:
        raise UnsupportedError("a transport delay needs a model with a fixed step", "Give the model a fixed step.")
    count = int(np.ceil(longest / step - 1e-9))
    if not 1 <= count <= _MOST_MEMORIES:
        message = f"a MaximumDelay of {longest:g} s is {count} steps of {step:g} s, and {_MOST_MEMORIES} is the most"
        field = f"{site.atom.path}:MaximumDelay"
        raise UnsupportedError(
            message,
            f'Give a shorter one: [parameters."{field}"] initial = {_MOST_MEMORIES * step:g} in the project, '
            f'in Python parameters=[{{"{field}": {_MOST_MEMORIES * step:g}}}].',
        )
    return count


def _variable_needs(site: BlockContext) -> Iterable[int]:
    """Only where a delay may be shorter than a step, its output depends on the input of this one."""
    return (0, 1) if _handles_zero(site) else (1,)


def _handles_zero(site: BlockContext) -> bool:
    return site.on("ZeroDelay") and site.text("VariableDelayType") == "Variable time delay"


@block("VariableTransportDelay", needs=_variable_needs, VariableDelayType="Variable transport delay",
       MaximumDelay="10", InitialOutput="0", PadeOrder="0", ZeroDelay="off")  # fmt: skip
def variable_delay(site: BlockContext) -> SignalOrBus:
    """The input of a time before that changes, or of when it entered a pipe whose passage takes such a time."""
    kind = site.chosen("VariableDelayType", "Variable transport delay", "Variable time delay")
    time = site.discrete(site.input(1))
    if time.size != 1:
        raise UnsupportedError("its delay is a vector")
    count, init = _steps(site), site.parameter("InitialOutput")
    late = [site.remember(init, lambda _: site.discrete(site.input(0)), at) for at in range(1, count + 1)]
    if kind == "Variable transport delay":
        return _passed(site, time, late, init)
    time = site.call("max", time, site.constant(0.0))
    if not _handles_zero(site):
        return _since(site, time, _past(site, time, late, 1), init)
    u = site.discrete(site.input(0))
    y = _since(site, time, _past(site, time, [u, *late], 0), init)
    return site.select(site.call("eq", time, site.constant(0.0)), u, y)


def _past(site: BlockContext, time: Signal, late: list[Signal], first: int) -> Signal:
    """Between the two steps that a time lies between, of which `late` holds the inputs from the `first` on.

    Below the first one the line through the next two goes on; beyond the last one it stays.
    """
    steps = site.call("div", time, site.major_step)
    made = late[-1]
    for at in range(len(late) - 1, 0, -1):
        share = site.call("sub", steps, site.constant(float(first + at - 1)))
        between = site.call("add", late[at - 1], site.call("mul", share, site.call("sub", late[at], late[at - 1])))
        made = site.select(site.call("lt", steps, site.constant(float(first + at))), between, made)
    return made


def _passed(site: BlockContext, time: Signal, late: list[Signal], init: Signal) -> Signal:
    """What entered a pipe one passage ago; the way covered is the integral of 1/time, in pipes."""
    zero, one = site.constant(0.0), site.constant(1.0)
    rate = site.call("div", one, time)
    made: list[Signal] = []
    before = site.remember(zero, lambda _: made[0])
    rate_before = site.remember(rate, lambda _: rate)
    begun = site.remember(zero, lambda _: one)
    moved = site.call("mul", site.call("mul", site.constant(0.5), site.major_step), site.call("add", rate, rate_before))
    made.append(site.select(begun, site.call("add", before, moved), zero))
    way = [site.remember(zero, lambda _: made[0], at) for at in range(1, len(late) + 1)]
    entered = site.call("sub", made[0], one)
    y = late[-1]
    for at in range(len(late) - 1, -1, -1):
        found = late[0] if at == 0 else _between(site, entered, (way[at], way[at - 1]), (late[at], late[at - 1]))
        y = site.select(site.call("ge", entered, way[at]), found, y)
    return site.select(site.call("lt", entered, zero), init, y)


def _between(site: BlockContext, x: Signal, xs: tuple[Signal, Signal], ys: tuple[Signal, Signal]) -> Signal:
    share = site.call("div", site.call("sub", x, xs[0]), site.call("sub", xs[1], xs[0]))
    return site.call("add", ys[0], site.call("mul", share, site.call("sub", ys[1], ys[0])))


def resetting(site: BlockContext) -> str:
    """The kind of external reset, "none" where there is none."""
    kind = site.text("ExternalReset")
    return "none" if kind.casefold() == "none" else kind


def _integrator_needs(site: BlockContext) -> Iterable[int]:
    return range(1, site.count)


@block("Integrator", needs=_integrator_needs, InitialCondition="0", InitialConditionSource="internal",
       ExternalReset="none", LimitOutput="off", UpperSaturationLimit="inf", LowerSaturationLimit="-inf",
       ShowSaturationPort="off", ShowStatePort="off", WrapState="off")  # fmt: skip
def integrator(site: BlockContext) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """The integral of the input over time, reset on demand, within limits."""
    if site.on("WrapState"):
        raise UnsupportedError("WrapState is on, which is not supported")
    kind = resetting(site)
    external = site.text("InitialConditionSource") == "external"
    init = site.input(site.count - 1) if external else site.parameter("InitialCondition")
    limits = None
    if site.on("LimitOutput"):
        limits = (site.parameter("LowerSaturationLimit"), site.parameter("UpperSaturationLimit"))
    reset = reset_signal(site, site.input(1), kind) if kind != "none" else None
    x = site.integrate(init, lambda _: site.input(0), reset, limits, ported=True)
    return with_saturation(site, x if limits is None else site.clip(x, *limits))


def with_saturation(site: BlockContext, y: Signal) -> SignalOrBus | tuple[SignalOrBus, ...]:
    """The output of an integrator, and on demand whether it is at a limit: 1 the upper, -1 the lower."""
    return (y, _saturated(site, y)) if site.on("ShowSaturationPort") else y


def _saturated(site: BlockContext, y: Signal) -> Signal:
    if not site.on("LimitOutput"):
        return site.call("mul", site.constant(0.0), y)
    low, high = site.parameter("LowerSaturationLimit"), site.parameter("UpperSaturationLimit")
    below = site.select(site.call("le", y, low), site.constant(-1.0), site.constant(0.0))
    return site.select(site.call("ge", y, high), site.constant(1.0), below)


def reset_signal(site: BlockContext, u: Signal, kind: str, sampled: bool = False) -> Signal:
    """1 where an external reset takes place; a `sampled` one looks at no more than whether a signal is positive."""
    u, zero = site.discrete(u), site.constant(0.0)
    kind = kind.casefold()
    if kind in ("rising", "falling", "either"):
        return site.sampled_edge(u, kind) if sampled else site.edge(u, kind)
    if kind in ("level hold", "sampled level"):
        return site.call("ne", u, zero)
    if kind == "level":
        before = site.remember(zero, lambda _: u)
        return site.call("or", site.call("ne", u, zero), site.call("ne", before, zero))
    raise UnsupportedError(f"its reset is {kind!r}, which is not supported")


@block("TransferFcn", needs=lambda site: _through(site), Numerator="[1]", Denominator="[1 2 1]")
def transfer_function(site: BlockContext) -> SignalOrBus:
    """b(s)/a(s) in controllable form, from zero states."""
    numerator, denominator = site.matrix("Numerator"), site.matrix("Denominator").ravel()
    if numerator.shape[0] != 1:
        raise UnsupportedError("its numerator has several rows, for several outputs")
    return rational(site, [int(n) for n in numerator.ravel()], [int(n) for n in denominator])


def rational(site: BlockContext, numerator: list[int], denominator: list[int]) -> Signal:
    """The quotient of two polynomials in s, by their coefficients with the highest power first, from zero states."""
    order = len(denominator) - 1
    b = [scaled(site, node, denominator[0]) for node in _padded(site, numerator, order + 1)]
    a = [scaled(site, node, denominator[0]) for node in denominator[1:]]
    if order == 0:
        return site.call("mul", scalar(b[0]), site.input())
    A = np.full((order, order), site.builder.const(0.0), dtype=np.int64)
    A[0, :] = [site.builder.call("neg", node) for node in a]
    for row in range(1, order):
        A[row, row - 1] = site.builder.const(1.0)
    B = np.array([[site.builder.const(1.0)]] + [[site.builder.const(0.0)]] * (order - 1), dtype=np.int64)
    gains = [site.builder.call("sub", b[i + 1], site.builder.call("mul", a[i], b[0])) for i in range(order)]
    zeros = Signal(np.full((order,), site.builder.const(0.0), dtype=np.int64))
    return _state_space(site, A, B, np.array([gains], dtype=np.int64), np.array([[b[0]]], dtype=np.int64), zeros)


def _through(site: BlockContext) -> Iterable[int]:
    return (0,) if has_feedthrough(site) else ()


def has_feedthrough(site: BlockContext) -> bool:
    """Whether a transfer function passes its input through: its numerator has the order of its denominator."""
    numerator = site.matrix("Numerator")
    same_order = numerator.shape[-1] >= site.matrix("Denominator").size
    return same_order and any(site.builder.value(int(node)) != 0 for node in numerator[..., 0])


def _padded(site: BlockContext, nodes: list[int], count: int) -> list[int]:
    if len(nodes) > count:
        raise UnsupportedError("the order of its numerator is above that of its denominator")
    return [site.builder.const(0.0)] * (count - len(nodes)) + nodes


def scaled(site: BlockContext, node: int, lead: int) -> int:
    """A coefficient over the leading one; one that is 0 stays 0 whatever that is."""
    return node if site.builder.value(node) == 0 else site.builder.call("div", node, lead)


@block("StateSpace", needs=lambda site: fed_through(site), A="1", B="1", C="1", D="1", InitialCondition="0",
       X0="0")  # fmt: skip
def state_space(site: BlockContext) -> SignalOrBus:
    """The state space model x' = A x + B u, y = C x + D u."""
    A, B, C, D, first = matrices(site)
    return _state_space(site, A, B, C, D, first)


def fed_through(site: BlockContext) -> tuple[int, ...]:
    """The input of a state space model, where its output depends on it within the step."""
    return (0,) if any(site.builder.value(int(node)) != 0 for node in site.matrix("D").ravel()) else ()


def _state_space(site: BlockContext, A: Nodes, B: Nodes, C: Nodes, D: Nodes, init: Signal) -> Signal:
    def slope(x: Signal) -> Signal:
        return site.call("add", matrix_times_vector(site, A, x), matrix_times_vector(site, B, site.input()))

    x = site.integrate(init, slope, None, None)
    y = matrix_times_vector(site, C, x)
    if all(site.builder.value(int(node)) == 0 for node in D.ravel()):
        return y
    return site.call("add", y, matrix_times_vector(site, D, site.input()))


def matrices(site: BlockContext) -> tuple[Nodes, Nodes, Nodes, Nodes, Signal]:
    """The matrices A, B, C and D of a state space model, and its initial values."""
    A, B, C, D = (site.matrix(name) for name in "ABCD")
    key = "InitialCondition" if site.atom.block.value("InitialCondition") is not None else "X0"
    init = site.parameter(key)
    first = Signal(np.full((A.shape[0],), init.flat[0], dtype=np.int64)) if init.size == 1 else init
    if A.shape[0] != A.shape[1] or first.size != A.shape[0]:
        raise UnsupportedError(f"A of {A.shape} and {first.size} initial values do not fit each other")
    return A, B, C, D, first


def matrix_times_vector(site: BlockContext, matrix: Nodes, x: Signal) -> Signal:
    """A matrix times a vector."""
    if matrix.shape[1] != x.size:
        raise UnsupportedError(f"a matrix of {matrix.shape} does not fit a vector of {x.size}")
    rows = [
        reduce_nodes(
            site.builder, "add", [site.builder.call("mul", int(a), b) for a, b in zip(row, x.flat, strict=True)]
        )
        for row in matrix
    ]
    return Signal(np.array(rows, dtype=np.int64), x.period)


@block("Derivative", CoefficientInTFapproximation="inf")
def derivative(site: BlockContext) -> SignalOrBus:
    """The change of the input since the major step before over the time between; 0 at first."""
    u = site.discrete(site.input())
    before = site.remember(u, lambda _: u)
    return site.call("div", site.call("sub", u, before), site.major_step)
