"""Comparison and logic; truth is 1 and 0."""

from collections.abc import Callable

from kennfeld.models.simulink.expressions.signals import Signal, Wired
from kennfeld.models.simulink.weaving.registry import UnsupportedError, block
from kennfeld.models.simulink.weaving.site import Site

_COMPARISONS = {"==": "eq", "~=": "ne", "!=": "ne", "<": "lt", "<=": "le", ">": "gt", ">=": "ge"}


def compared(site: Site, operator: str, a: Signal, b: Signal) -> Signal:
    """A comparison by its sign."""
    if operator not in _COMPARISONS:
        raise UnsupportedError(f"the comparison {operator!r} is not supported")
    return site.call(_COMPARISONS[operator], a, b)


@block("RelationalOperator", Operator=">=", SampleTime="-1")
def relational_operator(site: Site) -> Wired:
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
def logic(site: Site) -> Wired:
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
def compare_to_constant(site: Site) -> Wired:
    """The input compared with a constant."""
    return compared(site, site.text("relop"), site.input(), site.parameter("const"))


@block("Compare To Zero", relop="<=")
def compare_to_zero(site: Site) -> Wired:
    """The input compared with 0."""
    return compared(site, site.text("relop"), site.input(), site.constant(0.0))


@block("Interval Test", IntervalClosedRight="on", IntervalClosedLeft="on", uplimit="0.5", lowlimit="-0.5")
def interval_test(site: Site) -> Wired:
    """Whether the input is between two limits."""
    return _between(site, site.parameter("lowlimit"), site.parameter("uplimit"), site.input())


@block("Interval Test Dynamic", IntervalClosedRight="on", IntervalClosedLeft="on")
def interval_test_dynamic(site: Site) -> Wired:
    """Whether the middle input is between the lower limit, the third, and the upper, the first."""
    return _between(site, site.input(2), site.input(0), site.input(1))


def _between(site: Site, low: Signal, high: Signal, u: Signal) -> Signal:
    above = site.call("ge" if site.on("IntervalClosedLeft") else "gt", u, low)
    below = site.call("le" if site.on("IntervalClosedRight") else "lt", u, high)
    return site.call("and", above, below)


@block("Detect Increase", vinit="0.0")
def detect_increase(site: Site) -> Wired:
    """Whether the input is more than in the step before."""
    return _changed(site, "gt")


@block("Detect Decrease", vinit="0.0")
def detect_decrease(site: Site) -> Wired:
    """Whether the input is less than in the step before."""
    return _changed(site, "lt")


@block("Detect Change", vinit="0")
def detect_change(site: Site) -> Wired:
    """Whether the input is another than in the step before."""
    return _changed(site, "ne")


def _changed(site: Site, op: str) -> Signal:
    u = site.discrete(site.input())
    return site.call(op, u, site.remember(site.parameter("vinit"), lambda _: u))


@block("Detect Rise Positive", vinit="0")
def detect_rise_positive(site: Site) -> Wired:
    """Whether the input has become positive."""
    return _crossed(site, lambda x: site.call("gt", x, site.constant(0.0)))


@block("Detect Rise Nonnegative", vinit="0")
def detect_rise_nonnegative(site: Site) -> Wired:
    """Whether the input has ceased to be negative."""
    return _crossed(site, lambda x: site.call("ge", x, site.constant(0.0)))


@block("Detect Fall Negative", vinit="0")
def detect_fall_negative(site: Site) -> Wired:
    """Whether the input has become negative."""
    return _crossed(site, lambda x: site.call("lt", x, site.constant(0.0)))


@block("Detect Fall Nonpositive", vinit="0")
def detect_fall_nonpositive(site: Site) -> Wired:
    """Whether the input has ceased to be positive."""
    return _crossed(site, lambda x: site.call("le", x, site.constant(0.0)))


def _crossed(site: Site, holds: Callable[[Signal], Signal]) -> Signal:
    """Whether a condition holds now that did not in the step before; `vinit` is its value before the first."""
    now = holds(site.discrete(site.input()))
    before = site.remember(site.parameter("vinit"), lambda _: now)
    return site.call("and", now, site.call("not", before))
