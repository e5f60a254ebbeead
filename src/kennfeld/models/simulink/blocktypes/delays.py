"""Delays by a time: constant, or given by an input."""

from collections.abc import Iterable

import numpy as np

from kennfeld.models.simulink.expressions.signals import Signal, Wired
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block, nothing
from kennfeld.models.simulink.weaving.site import Site

_MOST_MEMORIES = 1000  # of a delay that changes; each step of it is a memory of its own


@block("TransportDelay", needs=nothing, DelayTime="1", InitialOutput="0", TransDelayFeedthrough="off")
def transport_delay(site: Site) -> Wired:
    """The input of some time before, between two steps as a line."""
    step = site.weaver.clock.step
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


def _since(site: Site, delay: Signal, late: Signal, init: Signal) -> Signal:
    """A signal that is late from when more time than its delay has passed, the initial output until then."""
    near = site.constant(1e-6 * (site.weaver.clock.step or 0.0))
    passed = site.call("gt", site.discrete(site.time), site.call("add", delay, near))
    return site.select(passed, late, init)


def _steps(site: Site) -> int:
    """How many steps back a delay that changes may reach."""
    step, longest = site.weaver.clock.step, site.number("MaximumDelay")
    if step is None:
        raise UnsupportedError("a transport delay needs a model with a fixed step", "Give the model a fixed step.")
    count = int(np.ceil(longest / step - 1e-9))
    if not 1 <= count <= _MOST_MEMORIES:
        what = f"a MaximumDelay of {longest:g} s is {count} steps of {step:g} s, and {_MOST_MEMORIES} is the most"
        field = f"{site.atom.path}:MaximumDelay"
        raise UnsupportedError(
            what,
            f'Give a shorter one: [parameters."{field}"] initial = {_MOST_MEMORIES * step:g} in the project, '
            f'in Python parameters=[{{"{field}": {_MOST_MEMORIES * step:g}}}].',
        )
    return count


def _variable_needs(site: Site) -> Iterable[int]:
    """Only where a delay may be shorter than a step, its output depends on the input of this one."""
    return (0, 1) if _handles_zero(site) else (1,)


def _handles_zero(site: Site) -> bool:
    return site.on("ZeroDelay") and site.text("VariableDelayType") == "Variable time delay"


@block("VariableTransportDelay", needs=_variable_needs, VariableDelayType="Variable transport delay",
       MaximumDelay="10", InitialOutput="0", PadeOrder="0", ZeroDelay="off")  # fmt: skip
def variable_delay(site: Site) -> Wired:
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


def _past(site: Site, time: Signal, late: list[Signal], first: int) -> Signal:
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


def _passed(site: Site, time: Signal, late: list[Signal], init: Signal) -> Signal:
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


def _between(site: Site, x: Signal, xs: tuple[Signal, Signal], ys: tuple[Signal, Signal]) -> Signal:
    share = site.call("div", site.call("sub", x, xs[0]), site.call("sub", xs[1], xs[0]))
    return site.call("add", ys[0], site.call("mul", share, site.call("sub", ys[1], ys[0])))
