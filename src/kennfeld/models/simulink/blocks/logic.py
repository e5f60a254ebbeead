"""Logic library: comparisons (true is 1, false 0), edge detection, truth tables, flip-flops, counters, running
extremes.
"""

from collections.abc import Callable

from kennfeld.models.simulink.flattening.flat_model import is_triggered
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.registry import block, no_feedthrough
from kennfeld.models.simulink.signals import Signal, SignalOrBus

_COMPARISONS = {"==": "eq", "~=": "ne", "!=": "ne", "<": "lt", "<=": "le", ">": "gt", ">=": "ge"}

_MAX_ROWS = 1024


def compare(block: BlockContext, operator: str, a: Signal, b: Signal) -> Signal:
    """Compare two signals."""
    if operator not in _COMPARISONS:
        raise UnsupportedError(f"the operator {operator!r} is not supported")
    return block.apply(_COMPARISONS[operator], a, b)


@block("RelationalOperator", Operator=">=", SampleTime="-1")
def relational_operator(block: BlockContext) -> SignalOrBus:
    """Compare two inputs, or classify a single one (NaN, infinite, finite)."""
    operator, u = block.field_text("Operator"), block.input(0)
    match operator:
        case "isNaN":
            return block.apply("ne", u, u)
        case "isInf":
            return block.apply("eq", block.apply("abs", u), block.constant(float("inf")))
        case "isFinite":
            return block.apply("lt", block.apply("abs", u), block.constant(float("inf")))
    return compare(block, operator, u, block.input(1))


@block("Logic", Operator="AND", Inputs="2", SampleTime="-1")
def logic(block: BlockContext) -> SignalOrBus:
    """Apply a logical operator to the inputs, or to the elements of a single input."""
    operator = block.option("Operator", "AND", "OR", "NAND", "NOR", "XOR", "NXOR", "NOT")
    if operator == "NOT":
        return block.apply("not", block.input())
    inputs = block.inputs
    if len(inputs) == 1:
        inputs = inputs[0].elements
    truths = [block.apply("ne", signal, block.constant(0.0)) for signal in inputs]
    result = block.reduce({"AND": "and", "NAND": "and", "OR": "or", "NOR": "or"}.get(operator, "ne"), truths)
    return block.apply("not", result) if operator in ("NAND", "NOR", "NXOR") else result


@block("Compare To Constant", "Compare to constant", relop="<=", const="3.0")
def compare_to_constant(block: BlockContext) -> SignalOrBus:
    """Compare the input with a constant."""
    return compare(block, block.field_text("relop"), block.input(), block.parameter("const"))


@block("Compare To Zero", relop="<=")
def compare_to_zero(block: BlockContext) -> SignalOrBus:
    """Compare the input with 0."""
    return compare(block, block.field_text("relop"), block.input(), block.constant(0.0))


@block("Interval Test", IntervalClosedRight="on", IntervalClosedLeft="on", uplimit="0.5", lowlimit="-0.5")
def interval_test(block: BlockContext) -> SignalOrBus:
    """Return 1 if the input is between two constants."""
    return _between(block, block.parameter("lowlimit"), block.parameter("uplimit"), block.input())


@block("Interval Test Dynamic", IntervalClosedRight="on", IntervalClosedLeft="on")
def interval_test_dynamic(block: BlockContext) -> SignalOrBus:
    """Return 1 if the second input is between the lower limit (third input) and the upper limit (first input)."""
    return _between(block, block.input(2), block.input(0), block.input(1))


def _between(block: BlockContext, low: Signal, high: Signal, u: Signal) -> Signal:
    above = block.apply("ge" if block.is_on("IntervalClosedLeft") else "gt", u, low)
    below = block.apply("le" if block.is_on("IntervalClosedRight") else "lt", u, high)
    return block.apply("and", above, below)


@block("Detect Increase", vinit="0.0")
def detect_increase(block: BlockContext) -> SignalOrBus:
    """Return 1 if the input is greater than in the previous step."""
    return _changed(block, "gt")


@block("Detect Decrease", vinit="0.0")
def detect_decrease(block: BlockContext) -> SignalOrBus:
    """Return 1 if the input is less than in the previous step."""
    return _changed(block, "lt")


@block("Detect Change", vinit="0")
def detect_change(block: BlockContext) -> SignalOrBus:
    """Return 1 if the input differs from that of the previous step."""
    return _changed(block, "ne")


def _changed(block: BlockContext, op: str) -> Signal:
    u = block.hold_in_minor_steps(block.input())
    return block.apply(op, u, block.discrete_state(block.parameter("vinit"), lambda _: u))


@block("Detect Rise Positive", vinit="0")
def detect_rise_positive(block: BlockContext) -> SignalOrBus:
    """Return 1 if the input has become positive."""
    return _detect_change(block, lambda x: block.apply("gt", x, block.constant(0.0)))


@block("Detect Rise Nonnegative", vinit="0")
def detect_rise_nonnegative(block: BlockContext) -> SignalOrBus:
    """Return 1 if the input has become non-negative."""
    return _detect_change(block, lambda x: block.apply("ge", x, block.constant(0.0)))


@block("Detect Fall Negative", vinit="0")
def detect_fall_negative(block: BlockContext) -> SignalOrBus:
    """Return 1 if the input has become negative."""
    return _detect_change(block, lambda x: block.apply("lt", x, block.constant(0.0)))


@block("Detect Fall Nonpositive", vinit="0")
def detect_fall_nonpositive(block: BlockContext) -> SignalOrBus:
    """Return 1 if the input has become non-positive."""
    return _detect_change(block, lambda x: block.apply("le", x, block.constant(0.0)))


def _detect_change(block: BlockContext, holds: Callable[[Signal], Signal]) -> Signal:
    """Return 1 if a condition holds now but not in the previous step; `vinit` is its value before the first step."""
    now = holds(block.hold_in_minor_steps(block.input()))
    before = block.discrete_state(block.parameter("vinit"), lambda _: now)
    return block.apply("and", now, block.apply("not", before))


@block("CombinatorialLogic", TruthTable="[0 0;0 1;0 1;1 0;0 1;1 0;1 0;1 1]", SampleTime="-1")
def combinatorial_logic(block: BlockContext) -> SignalOrBus:
    """Return the row of a truth table whose index is given by the inputs as bits, most significant first."""
    table, u = block.matrix("TruthTable"), block.input()
    if table.shape[0] != 2**u.size or table.shape[0] > _MAX_ROWS:
        raise UnsupportedError(f"a table of {table.shape[0]} rows does not match {u.size} inputs")
    row = block.constant(0.0)
    for element in u.elements:
        bit = block.apply("ne", element, block.constant(0.0))
        row = block.apply("add", block.apply("mul", block.constant(2.0), row), bit)
    result = Signal(table[-1], u.period)
    for at in reversed(range(table.shape[0] - 1)):
        result = block.select(block.apply("lt", row, block.constant(at + 1.0)), Signal(table[at], u.period), result)
    return result


def _true(block: BlockContext, at: int) -> Signal:
    return block.apply("ne", block.hold_in_minor_steps(block.input(at)), block.constant(0.0))


def _state(block: BlockContext, rule: Callable[[Signal], Signal]) -> Signal:
    """Return a state q updated by a rule; `initial_condition` is its first value."""
    signals: list[Signal] = []
    init = block.apply("ne", block.parameter("initial_condition", "0"), block.constant(0.0))
    signals.append(rule(block.discrete_state(init, lambda _: signals[0])))
    return signals[0]


@block("SRFlipFlop", "S-R Flip-Flop", linked=True, initial_condition="0")
def set_and_reset(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Lower an S-R flip-flop; S and R together make both Q and !Q 0."""
    s, r = _true(block, 0), _true(block, 1)
    q = _state(block, lambda before: block.apply("and", block.apply("or", s, before), block.apply("not", r)))
    neither = block.apply("not", block.apply("and", s, r))
    return q, block.apply("and", block.apply("not", q), neither)


@block("D Latch", linked=True)
def latch(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Lower a D latch: Q follows D while C is true."""
    d, c = _true(block, 0), _true(block, 1)
    q = _state(block, lambda before: block.select(c, d, before))
    return q, block.apply("not", q)


@block("D Flip-Flop", linked=True)
def clocked(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Lower a D flip-flop: Q takes D on the rising edge of CLK and is 0 while !CLR is 0."""
    d, kept = _true(block, 0), _true(block, 2)
    rises = block.zero_crossing(block.hold_in_minor_steps(block.input(1)), "rising")
    q = _state(block, lambda before: block.apply("and", kept, block.select(rises, d, before)))
    return q, block.apply("not", q)


@block("J-K Flip-Flop", linked=True, initial_condition="0")
def toggled(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Lower a J-K flip-flop: on the falling edge of CLK, J sets Q, K resets it, both toggle it."""
    j, k = _true(block, 0), _true(block, 2)
    falls = block.zero_crossing(block.hold_in_minor_steps(block.input(1)), "falling")

    def after(before: Signal) -> Signal:
        new = block.select(before, block.apply("not", k), j)
        return block.select(falls, new, before)

    q = _state(block, after)
    return q, block.apply("not", q)


@block("Counter Free-Running", needs=no_feedthrough, sample="tsamp", linked=True, NumBits="16", tsamp="-1")
def counter(block: BlockContext) -> SignalOrBus:
    """Count samples from 0 and wrap around at a number of bits."""
    return _counted(block, 2.0 ** block.integer_field("NumBits", 1, 53))


@block("Counter Limited", needs=no_feedthrough, sample="tsamp", linked=True, uplimit="7", tsamp="-1")
def limited_counter(block: BlockContext) -> SignalOrBus:
    """Count samples from 0 and restart after a limit."""
    return _counted(block, block.integer_field("uplimit", 0, 2**53 - 1) + 1.0)


def _counted(block: BlockContext, count: float) -> Signal:
    zero, one = block.constant(0.0), block.constant(1.0)

    def following(now: Signal) -> Signal:
        more = block.apply("add", now, one)
        return block.select(block.apply("ge", more, block.constant(count)), zero, more)

    return block.discrete_state(zero, following)


@block("MinMax Running Resettable", linked=True, Function="max", vinit="0.0")
def running_extreme(block: BlockContext) -> SignalOrBus:
    """Return the running minimum or maximum of the input; the second input resets it to the initial value."""
    op, init = block.option("Function", "min", "max"), block.parameter("vinit")
    signals: list[Signal] = []
    so_far = block.apply(
        op, block.hold_in_minor_steps(block.input(0)), block.discrete_state(init, lambda _: signals[0])
    )
    signals.append(block.select(_true(block, 1), init, so_far))
    return signals[0]


@block("Increment Real World", linked=True)
def incremented(block: BlockContext) -> SignalOrBus:
    """Return the input plus 1."""
    return block.apply("add", block.input(), block.constant(1.0))


@block("Decrement Real World", linked=True)
def decremented(block: BlockContext) -> SignalOrBus:
    """Return the input minus 1."""
    return block.apply("sub", block.input(), block.constant(1.0))


@block("Decrement To Zero", linked=True)
def decremented_to_zero(block: BlockContext) -> SignalOrBus:
    """Return the input minus 1, at least 0."""
    return block.apply("max", block.apply("sub", block.input(), block.constant(1.0)), block.constant(0.0))


@block("Decrement Time To Zero", linked=True)
def time_to_zero(block: BlockContext) -> SignalOrBus:
    """Return the input minus the sample time, at least 0."""
    if is_triggered(block.flat):
        raise UnsupportedError("it counts time in a triggered subsystem, which is not supported")
    return block.apply("max", block.apply("sub", block.input(), block.sample_step()), block.constant(0.0))
