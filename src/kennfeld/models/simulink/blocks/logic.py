"""Comparison and logic; truth is 1 and 0.

Logic with memory: truth tables, flip-flops, counters, running extremes.
"""

from collections.abc import Callable

from kennfeld.models.simulink.flattening.flat_model import is_triggered
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block, no_feedthrough
from kennfeld.models.simulink.signals import Signal, SignalOrBus

_COMPARISONS = {"==": "eq", "~=": "ne", "!=": "ne", "<": "lt", "<=": "le", ">": "gt", ">=": "ge"}

_MOST_ROWS = 1024


def compared(site: BlockContext, operator: str, a: Signal, b: Signal) -> Signal:
    """A comparison by its sign."""
    if operator not in _COMPARISONS:
        raise UnsupportedError(f"the comparison {operator!r} is not supported")
    return site.call(_COMPARISONS[operator], a, b)


@block("RelationalOperator", Operator=">=", SampleTime="-1")
def relational_operator(site: BlockContext) -> SignalOrBus:
    """A comparison of two inputs, or what kind of number the only one is."""
    operator, u = site.text("Operator"), site.input(0)
    match operator:
        case "isNaN":
            return site.call("ne", u, u)
        case "isInf":
            return site.call("eq", site.call("abs", u), site.constant(float("inf")))
        case "isFinite":
            return site.call("lt", site.call("abs", u), site.constant(float("inf")))
    return compared(site, operator, u, site.input(1))


@block("Logic", Operator="AND", Inputs="2", SampleTime="-1")
def logic(site: BlockContext) -> SignalOrBus:
    """A logical operation on the inputs; on the elements of a single one."""
    operator = site.chosen("Operator", "AND", "OR", "NAND", "NOR", "XOR", "NXOR", "NOT")
    if operator == "NOT":
        return site.call("not", site.input())
    inputs = site.inputs
    if len(inputs) == 1:
        inputs = inputs[0].elements
    truths = [site.call("ne", one, site.constant(0.0)) for one in inputs]
    made = site.fold({"AND": "and", "NAND": "and", "OR": "or", "NOR": "or"}.get(operator, "ne"), truths)
    return site.call("not", made) if operator in ("NAND", "NOR", "NXOR") else made


@block("Compare To Constant", "Compare to constant", relop="<=", const="3.0")
def compare_to_constant(site: BlockContext) -> SignalOrBus:
    """The input compared with a constant."""
    return compared(site, site.text("relop"), site.input(), site.parameter("const"))


@block("Compare To Zero", relop="<=")
def compare_to_zero(site: BlockContext) -> SignalOrBus:
    """The input compared with 0."""
    return compared(site, site.text("relop"), site.input(), site.constant(0.0))


@block("Interval Test", IntervalClosedRight="on", IntervalClosedLeft="on", uplimit="0.5", lowlimit="-0.5")
def interval_test(site: BlockContext) -> SignalOrBus:
    """Whether the input is between two limits."""
    return _between(site, site.parameter("lowlimit"), site.parameter("uplimit"), site.input())


@block("Interval Test Dynamic", IntervalClosedRight="on", IntervalClosedLeft="on")
def interval_test_dynamic(site: BlockContext) -> SignalOrBus:
    """Whether the middle input is between the lower limit, the third, and the upper, the first."""
    return _between(site, site.input(2), site.input(0), site.input(1))


def _between(site: BlockContext, low: Signal, high: Signal, u: Signal) -> Signal:
    above = site.call("ge" if site.on("IntervalClosedLeft") else "gt", u, low)
    below = site.call("le" if site.on("IntervalClosedRight") else "lt", u, high)
    return site.call("and", above, below)


@block("Detect Increase", vinit="0.0")
def detect_increase(site: BlockContext) -> SignalOrBus:
    """Whether the input is more than in the step before."""
    return _changed(site, "gt")


@block("Detect Decrease", vinit="0.0")
def detect_decrease(site: BlockContext) -> SignalOrBus:
    """Whether the input is less than in the step before."""
    return _changed(site, "lt")


@block("Detect Change", vinit="0")
def detect_change(site: BlockContext) -> SignalOrBus:
    """Whether the input is another than in the step before."""
    return _changed(site, "ne")


def _changed(site: BlockContext, op: str) -> Signal:
    u = site.discrete(site.input())
    return site.call(op, u, site.remember(site.parameter("vinit"), lambda _: u))


@block("Detect Rise Positive", vinit="0")
def detect_rise_positive(site: BlockContext) -> SignalOrBus:
    """Whether the input has become positive."""
    return _crossed(site, lambda x: site.call("gt", x, site.constant(0.0)))


@block("Detect Rise Nonnegative", vinit="0")
def detect_rise_nonnegative(site: BlockContext) -> SignalOrBus:
    """Whether the input has ceased to be negative."""
    return _crossed(site, lambda x: site.call("ge", x, site.constant(0.0)))


@block("Detect Fall Negative", vinit="0")
def detect_fall_negative(site: BlockContext) -> SignalOrBus:
    """Whether the input has become negative."""
    return _crossed(site, lambda x: site.call("lt", x, site.constant(0.0)))


@block("Detect Fall Nonpositive", vinit="0")
def detect_fall_nonpositive(site: BlockContext) -> SignalOrBus:
    """Whether the input has ceased to be positive."""
    return _crossed(site, lambda x: site.call("le", x, site.constant(0.0)))


def _crossed(site: BlockContext, holds: Callable[[Signal], Signal]) -> Signal:
    """Whether a condition holds now that did not in the step before; `vinit` is its value before the first."""
    now = holds(site.discrete(site.input()))
    before = site.remember(site.parameter("vinit"), lambda _: now)
    return site.call("and", now, site.call("not", before))


@block("CombinatorialLogic", TruthTable="[0 0;0 1;0 1;1 0;0 1;1 0;1 0;1 1]", SampleTime="-1")
def combinatorial_logic(site: BlockContext) -> SignalOrBus:
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


def _true(site: BlockContext, at: int) -> Signal:
    return site.call("ne", site.discrete(site.input(at)), site.constant(0.0))


def _state(site: BlockContext, rule: Callable[[Signal], Signal]) -> Signal:
    """A state q that a rule makes of the one before; `initial_condition` at first."""
    made: list[Signal] = []
    init = site.call("ne", site.parameter("initial_condition", "0"), site.constant(0.0))
    made.append(rule(site.remember(init, lambda _: made[0])))
    return made[0]


@block("SRFlipFlop", "S-R Flip-Flop", linked=True, initial_condition="0")
def set_and_reset(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """Q is set by S and reset by R; both together make Q and !Q 0."""
    s, r = _true(site, 0), _true(site, 1)
    q = _state(site, lambda before: site.call("and", site.call("or", s, before), site.call("not", r)))
    neither = site.call("not", site.call("and", s, r))
    return q, site.call("and", site.call("not", q), neither)


@block("D Latch", linked=True)
def latch(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """Q follows D while C is set."""
    d, c = _true(site, 0), _true(site, 1)
    q = _state(site, lambda before: site.select(c, d, before))
    return q, site.call("not", q)


@block("D Flip-Flop", linked=True)
def clocked(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """Q takes D where CLK rises, and is 0 while !CLR is."""
    d, kept = _true(site, 0), _true(site, 2)
    rises = site.edge(site.discrete(site.input(1)), "rising")
    q = _state(site, lambda before: site.call("and", kept, site.select(rises, d, before)))
    return q, site.call("not", q)


@block("J-K Flip-Flop", linked=True, initial_condition="0")
def toggled(site: BlockContext) -> tuple[SignalOrBus, ...]:
    """Where CLK falls, Q is set by J, reset by K, and changed by both."""
    j, k = _true(site, 0), _true(site, 2)
    falls = site.edge(site.discrete(site.input(1)), "falling")

    def after(before: Signal) -> Signal:
        new = site.select(before, site.call("not", k), j)
        return site.select(falls, new, before)

    q = _state(site, after)
    return q, site.call("not", q)


@block("Counter Free-Running", needs=no_feedthrough, sample="tsamp", linked=True, NumBits="16", tsamp="-1")
def counter(site: BlockContext) -> SignalOrBus:
    """The number of the hit, counted from 0 up to what fits into some bits, then again."""
    return _counted(site, 2.0 ** site.whole("NumBits", 1, 53))


@block("Counter Limited", needs=no_feedthrough, sample="tsamp", linked=True, uplimit="7", tsamp="-1")
def limited_counter(site: BlockContext) -> SignalOrBus:
    """The number of the hit, counted from 0 up to a limit, then again."""
    return _counted(site, site.whole("uplimit", 0, 2**53 - 1) + 1.0)


def _counted(site: BlockContext, count: float) -> Signal:
    zero, one = site.constant(0.0), site.constant(1.0)

    def following(now: Signal) -> Signal:
        more = site.call("add", now, one)
        return site.select(site.call("ge", more, site.constant(count)), zero, more)

    return site.remember(zero, following)


@block("MinMax Running Resettable", linked=True, Function="max", vinit="0.0")
def running_extreme(site: BlockContext) -> SignalOrBus:
    """The least or greatest input so far; the initial value where the second input resets it."""
    op, init = site.chosen("Function", "min", "max"), site.parameter("vinit")
    made: list[Signal] = []
    so_far = site.call(op, site.discrete(site.input(0)), site.remember(init, lambda _: made[0]))
    made.append(site.select(_true(site, 1), init, so_far))
    return made[0]


@block("Increment Real World", linked=True)
def incremented(site: BlockContext) -> SignalOrBus:
    """The input plus 1."""
    return site.call("add", site.input(), site.constant(1.0))


@block("Decrement Real World", linked=True)
def decremented(site: BlockContext) -> SignalOrBus:
    """The input minus 1."""
    return site.call("sub", site.input(), site.constant(1.0))


@block("Decrement To Zero", linked=True)
def decremented_to_zero(site: BlockContext) -> SignalOrBus:
    """The input minus 1, not below 0."""
    return site.call("max", site.call("sub", site.input(), site.constant(1.0)), site.constant(0.0))


@block("Decrement Time To Zero", linked=True)
def time_to_zero(site: BlockContext) -> SignalOrBus:
    """The input minus the sample time, not below 0."""
    if is_triggered(site.atom):
        raise UnsupportedError("it counts time in a triggered subsystem")
    return site.call("max", site.call("sub", site.input(), site.step()), site.constant(0.0))
