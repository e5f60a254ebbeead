"""Logic library: comparisons (true is 1, false 0), edges, truth tables, flip-flops, counters, running extremes."""

from kennfeld.importers.simulink.flattening.flat_model import is_triggered
from kennfeld.importers.simulink.lowering import BlockContext, UnsupportedError, block, no_feedthrough
from kennfeld.importers.simulink.lowering.integer_signals import fixed_point_type_of, is_floating
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.signals import Signal, SignalOrBus, SignalRule, apply, select, select_by_index

_COMPARISONS = {"==": "eq", "~=": "ne", "!=": "ne", "<": "lt", "<=": "le", ">": "gt", ">=": "ge"}
# comparison of the input with its previous value, and with 0 now but not in the previous step
_CHANGES = {"Detect Increase": "gt", "Detect Decrease": "lt", "Detect Change": "ne"}
_EDGES = {
    "Detect Rise Positive": "gt",
    "Detect Rise Nonnegative": "ge",
    "Detect Fall Negative": "lt",
    "Detect Fall Nonpositive": "le",
}
_MAX_ROWS = 1024


def _compare(operator: str, a: Signal, b: Signal | float) -> Signal:
    if operator not in _COMPARISONS:
        raise UnsupportedError(f"the operator {operator!r} is not supported")
    return apply(_COMPARISONS[operator], a, b)


@block("RelationalOperator", Operator=">=", SampleTime="-1")
def relational_operator(block: BlockContext) -> SignalOrBus:
    """Compare two inputs, or classify a single one (NaN, infinite, finite)."""
    operator, u = block.field_text("Operator"), block.input(0)
    match match_word(operator, ("isNaN", "isInf", "isFinite")):
        case "isNaN":
            # NaN alone differs from itself
            return apply("ne", u, u)
        case "isInf":
            return apply("eq", abs(u), float("inf"))
        case "isFinite":
            return abs(u) < float("inf")
    return _compare(operator, u, block.input(1))


@block("Logic", Operator="AND", Inputs="2", SampleTime="-1")
def logic(block: BlockContext) -> SignalOrBus:
    """Apply a logical operator to the inputs, or to the elements of a single input."""
    operator = block.option("Operator", "AND", "OR", "NAND", "NOR", "XOR", "NXOR", "NOT")
    if operator == "NOT":
        return ~block.input()
    inputs = block.inputs if block.input_count > 1 else block.input().elements
    truths = [apply("ne", signal, 0.0) for signal in inputs]
    result = block.reduce({"AND": "and", "NAND": "and", "OR": "or", "NOR": "or"}.get(operator, "ne"), truths)
    return ~result if operator in ("NAND", "NOR", "NXOR") else result


@block("Compare To Constant", "Compare to constant", relop="<=", const="3.0")
def compare_to_constant(block: BlockContext) -> SignalOrBus:
    """Compare the input with a constant."""
    return _compare(block.field_text("relop"), block.input(), block.parameter("const"))


@block("Compare To Zero", relop="<=")
def compare_to_zero(block: BlockContext) -> SignalOrBus:
    """Compare the input with 0."""
    return _compare(block.field_text("relop"), block.input(), 0.0)


@block("Interval Test", IntervalClosedRight="on", IntervalClosedLeft="on", uplimit="0.5", lowlimit="-0.5")
def interval_test(block: BlockContext) -> SignalOrBus:
    """Test if the input is between two constants."""
    return _between(block, block.parameter("lowlimit"), block.parameter("uplimit"), block.input())


@block("Interval Test Dynamic", IntervalClosedRight="on", IntervalClosedLeft="on")
def interval_test_dynamic(block: BlockContext) -> SignalOrBus:
    """Test if the second input is between the lower limit (third input) and the upper limit (first input)."""
    return _between(block, block.input(2), block.input(0), block.input(1))


def _between(block: BlockContext, low: Signal, high: Signal, u: Signal) -> Signal:
    above = apply("ge" if block.is_on("IntervalClosedLeft") else "gt", u, low)
    below = apply("le" if block.is_on("IntervalClosedRight") else "lt", u, high)
    return above & below


@block(*_CHANGES, vinit="0")
def detect_change(block: BlockContext) -> SignalOrBus:
    """Detect that the input has increased, decreased or changed since the previous step."""
    u = block.hold_in_minor_steps(block.input())
    return apply(_CHANGES[block.flat.type], u, block.discrete_state(block.parameter("vinit"), lambda _: u))


@block(*_EDGES, vinit="0")
def detect_edge(block: BlockContext) -> SignalOrBus:
    """Detect that a condition holds now but not in the previous step; `vinit` is its value before the first step."""
    now = apply(_EDGES[block.flat.type], block.hold_in_minor_steps(block.input()), 0.0)
    return now & ~block.discrete_state(block.parameter("vinit"), lambda _: now)


@block("CombinatorialLogic", TruthTable="[0 0;0 1;0 1;1 0;0 1;1 0;1 0;1 1]", SampleTime="-1")
def combinatorial_logic(block: BlockContext) -> SignalOrBus:
    """Select the row of a truth table whose index the inputs state as bits, most significant first."""
    table, u = block.matrix("TruthTable"), block.input()
    # 2^width rows
    width = table.shape[0].bit_length() - 1
    if u.size == 1 < width:
        block.suggest_dimensions((width,))
    if table.shape[0] != 2**u.size or table.shape[0] > _MAX_ROWS:
        raise UnsupportedError(f"a table of {table.shape[0]} rows does not match {u.size} inputs")
    row = block.constant(0.0)
    for element in u.elements:
        row = 2.0 * row + apply("ne", element, 0.0)
    return select_by_index(row, [block.signal(values, u.period) for values in table], 1.0)


def _state(block: BlockContext, rule: SignalRule) -> Signal:
    """Return a state q updated by a rule; `initial_condition` is its first value."""
    return block.feedback(apply("ne", block.parameter("initial_condition", "0"), 0.0), rule)


@block("SRFlipFlop", "S-R Flip-Flop", linked=True, initial_condition="0")
def set_and_reset(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Lower an S-R flip-flop; S and R together make both Q and !Q 0."""
    s, r = block.is_true(0), block.is_true(1)
    q = _state(block, lambda before: (s | before) & ~r)
    return q, ~q & ~(s & r)


@block("D Latch", linked=True)
def latch(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Lower a D latch: Q follows D while C is true."""
    d, c = block.is_true(0), block.is_true(1)
    q = _state(block, lambda before: select(c, d, before))
    return q, ~q


@block("D Flip-Flop", linked=True)
def d_flip_flop(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Lower a D flip-flop: Q takes D on the rising edge of CLK and is 0 while !CLR is 0."""
    d, kept = block.is_true(0), block.is_true(2)
    rises = block.zero_crossing(block.hold_in_minor_steps(block.input(1)), "rising")
    q = _state(block, lambda before: kept & select(rises, d, before))
    return q, ~q


@block("J-K Flip-Flop", linked=True, initial_condition="0")
def jk_flip_flop(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Lower a J-K flip-flop: on the falling edge of CLK, J sets Q, K resets it, both toggle it."""
    j, k = block.is_true(0), block.is_true(2)
    falls = block.zero_crossing(block.hold_in_minor_steps(block.input(1)), "falling")
    # q' = J and not q, or not K and q
    q = _state(block, lambda before: select(falls, select(before, ~k, j), before))
    return q, ~q


@block("Counter Free-Running", needs=no_feedthrough, sample="tsamp", linked=True, NumBits="16", tsamp="-1")
def counter(block: BlockContext) -> SignalOrBus:
    """Count samples from 0 and wrap around at a number of bits."""
    return _count_up(block, 2.0 ** block.integer_field("NumBits", 1, 53))


@block("Counter Limited", needs=no_feedthrough, sample="tsamp", linked=True, uplimit="7", tsamp="-1")
def limited_counter(block: BlockContext) -> SignalOrBus:
    """Count samples from 0 and restart after a limit."""
    return _count_up(block, block.integer_field("uplimit", 0, 2**53 - 1) + 1.0)


def _count_up(block: BlockContext, count: float) -> Signal:
    return block.discrete_state(block.constant(0.0), lambda now: select(now + 1.0 >= count, 0.0, now + 1.0))


@block("MinMax Running Resettable", linked=True, Function="max", vinit="0.0")
def running_extreme(block: BlockContext) -> SignalOrBus:
    """Track the running minimum or maximum of the input; the second input resets it to the initial value."""
    op, init = block.option("Function", "min", "max"), block.parameter("vinit")
    u, resets = block.hold_in_minor_steps(block.input(0)), block.is_true(1)
    return block.feedback(init, lambda before: select(resets, init, apply(op, u, before)))


@block("Increment Real World", "Decrement Real World", "Decrement To Zero", linked=True)
def increment(block: BlockContext) -> SignalOrBus:
    """Add or subtract 1; at least 0 if the input is decremented to zero."""
    u = block.input()
    if block.flat.type == "Increment Real World":
        return u + 1.0
    return apply("max", u - 1.0, 0.0) if block.flat.type == "Decrement To Zero" else u - 1.0


@block("Stored Integer Value Increment", "Stored Integer Value Decrement", linked=True)
def stored_increment(block: BlockContext) -> SignalOrBus:
    """Add or subtract the step of the type of the input, which is 1 for integers and for floating-point numbers."""
    kind = fixed_point_type_of(block.source())
    if kind is None and not is_floating(block.source()):
        message = "its step depends on the type of its input, which the file does not specify"
        raise UnsupportedError(message, "Specify the data type of the block before it.")
    step = 1.0 if kind is None else kind.slope
    return block.input() + (step if block.flat.type.endswith("Increment") else -step)


@block("Decrement Time To Zero", linked=True)
def time_to_zero(block: BlockContext) -> SignalOrBus:
    """Subtract the sample time in s from the input; at least 0."""
    if is_triggered(block.flat):
        raise UnsupportedError("it counts time in a triggered subsystem, which is not supported")
    return apply("max", block.input() - block.sample_step(), 0.0)
