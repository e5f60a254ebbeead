"""Logic with memory: truth tables, flip-flops, counters, running extremes."""

from collections.abc import Callable

from kennfeld.models.simulink.expressions.signals import Signal, Wired
from kennfeld.models.simulink.flattening.atoms import is_triggered
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block, nothing
from kennfeld.models.simulink.weaving.site import Site

_MOST_ROWS = 1024


@block("CombinatorialLogic", TruthTable="[0 0;0 1;0 1;1 0;0 1;1 0;1 0;1 1]", SampleTime="-1")
def combinatorial_logic(site: Site) -> Wired:
    """The row of a table whose number the inputs write in binary digits, the first one the highest."""
    table, u = site.matrix("TruthTable"), site.input()
    if table.shape[0] != 2**u.size or table.shape[0] > _MOST_ROWS:
        raise UnsupportedError(f"a table of {table.shape[0]} rows does not fit {u.size} inputs")
    row = site.constant(0.0)
    for element in u.elements:
        bit = site.call("ne", element, site.constant(0.0))
        row = site.call("add", site.call("mul", site.constant(2.0), row), bit)
    made = Signal(table[-1], u.period)
    for at in reversed(range(table.shape[0] - 1)):
        made = site.select(site.call("lt", row, site.constant(at + 1.0)), Signal(table[at], u.period), made)
    return made


def _true(site: Site, at: int) -> Signal:
    return site.call("ne", site.discrete(site.input(at)), site.constant(0.0))


def _state(site: Site, rule: Callable[[Signal], Signal]) -> Signal:
    """A state q that a rule makes of the one before; `initial_condition` at first."""
    made: list[Signal] = []
    init = site.call("ne", site.parameter("initial_condition", "0"), site.constant(0.0))
    made.append(rule(site.remember(init, lambda _: made[0])))
    return made[0]


@block("SRFlipFlop", "S-R Flip-Flop", linked=True, initial_condition="0")
def set_and_reset(site: Site) -> tuple[Wired, ...]:
    """Q is set by S and reset by R; both together make Q and !Q 0."""
    s, r = _true(site, 0), _true(site, 1)
    q = _state(site, lambda before: site.call("and", site.call("or", s, before), site.call("not", r)))
    neither = site.call("not", site.call("and", s, r))
    return q, site.call("and", site.call("not", q), neither)


@block("D Latch", linked=True)
def latch(site: Site) -> tuple[Wired, ...]:
    """Q follows D while C is set."""
    d, c = _true(site, 0), _true(site, 1)
    q = _state(site, lambda before: site.select(c, d, before))
    return q, site.call("not", q)


@block("D Flip-Flop", linked=True)
def clocked(site: Site) -> tuple[Wired, ...]:
    """Q takes D where CLK rises, and is 0 while !CLR is."""
    d, kept = _true(site, 0), _true(site, 2)
    rises = site.edge(site.discrete(site.input(1)), "rising")
    q = _state(site, lambda before: site.call("and", kept, site.select(rises, d, before)))
    return q, site.call("not", q)


@block("J-K Flip-Flop", linked=True, initial_condition="0")
def toggled(site: Site) -> tuple[Wired, ...]:
    """Where CLK falls, Q is set by J, reset by K, and changed by both."""
    j, k = _true(site, 0), _true(site, 2)
    falls = site.edge(site.discrete(site.input(1)), "falling")

    def after(before: Signal) -> Signal:
        new = site.select(before, site.call("not", k), j)
        return site.select(falls, new, before)

    q = _state(site, after)
    return q, site.call("not", q)


@block("Counter Free-Running", needs=nothing, sample="tsamp", linked=True, NumBits="16", tsamp="-1")
def counter(site: Site) -> Wired:
    """The number of the hit, counted from 0 up to what fits into some bits, then again."""
    return _counted(site, 2.0 ** site.whole("NumBits", 1, 53))


@block("Counter Limited", needs=nothing, sample="tsamp", linked=True, uplimit="7", tsamp="-1")
def limited_counter(site: Site) -> Wired:
    """The number of the hit, counted from 0 up to a limit, then again."""
    return _counted(site, site.whole("uplimit", 0, 2**53 - 1) + 1.0)


def _counted(site: Site, count: float) -> Signal:
    zero, one = site.constant(0.0), site.constant(1.0)

    def following(now: Signal) -> Signal:
        more = site.call("add", now, one)
        return site.select(site.call("ge", more, site.constant(count)), zero, more)

    return site.remember(zero, following)


@block("MinMax Running Resettable", linked=True, Function="max", vinit="0.0")
def running_extreme(site: Site) -> Wired:
    """The least or greatest input so far; the initial value where the second input resets it."""
    op, init = site.chosen("Function", "min", "max"), site.parameter("vinit")
    made: list[Signal] = []
    so_far = site.call(op, site.discrete(site.input(0)), site.remember(init, lambda _: made[0]))
    made.append(site.select(_true(site, 1), init, so_far))
    return made[0]


@block("Increment Real World", linked=True)
def incremented(site: Site) -> Wired:
    """The input plus 1."""
    return site.call("add", site.input(), site.constant(1.0))


@block("Decrement Real World", linked=True)
def decremented(site: Site) -> Wired:
    """The input minus 1."""
    return site.call("sub", site.input(), site.constant(1.0))


@block("Decrement To Zero", linked=True)
def decremented_to_zero(site: Site) -> Wired:
    """The input minus 1, not below 0."""
    return site.call("max", site.call("sub", site.input(), site.constant(1.0)), site.constant(0.0))


@block("Decrement Time To Zero", linked=True)
def time_to_zero(site: Site) -> Wired:
    """The input minus the sample time, not below 0."""
    if is_triggered(site.atom):
        raise UnsupportedError("it counts time in a triggered subsystem")
    return site.call("max", site.call("sub", site.input(), site.step()), site.constant(0.0))
