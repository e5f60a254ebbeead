"""Operators and functions of Python numbers by rules on nodes, which note where Python raises an exception.

A function that is called gives NaN for a sample at which it raises one, and its translation shall give the same: `math`
and the operators of floats refuse what C and NumPy answer by infinities. An exception is a condition of the path, as a
NaN in place of the value would be lost in a comparison, in `x ** 0`, or if the value is not used.
"""

import math
from collections.abc import Callable
from functools import partial, reduce
from typing import Final

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.python.reading import is_exact
from kennfeld.importers.rules import Rule as EvaluatorRule
from kennfeld.importers.rules import known_integer
from kennfeld.models.imperative.evaluation_context import SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.exact_arithmetic import remainder, round_to_even
from kennfeld.models.imperative.graph_operators import ONE, Rule
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes
from kennfeld.models.imperative.path_facts import bound_of, is_whole

_HARMLESS: Final = 4.0  # exponents up to here overflow for bases beyond 1e77 only, and are not tested for it
_MOST_EXACT: Final = 1024  # exponents below are computed exactly
_ROUNDED: Final = "integers beyond 2^53 are rounded here, as floating-point numbers, but are exact in Python"


def divide(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    """Divide as Python does, which fails for 0."""
    _fail_at_zero(evaluator, b)
    return Elementwise(evaluator.builder)("div", a, b)


def _fail_at_zero(evaluator: SymbolicEvaluator, x: Nodes) -> None:
    """Note a ZeroDivisionError."""
    if not _is_nonzero(evaluator.builder, x):
        evaluator.fail_where(Elementwise(evaluator.builder)("eq", x, 0.0))


def _is_nonzero(builder: GraphBuilder, x: Nodes) -> bool:
    nodes = [int(node) for node in x.ravel()]
    return all(bound_of(builder, n, False) > 0 or bound_of(builder, n, True) < 0 for n in nodes)


def modulo(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute a % b: the exact remainder, moved to the sign of b; NaN if b is 0."""
    apply = Elementwise(builder)
    rest = remainder(builder, a, b)
    return apply("add", rest, apply("select", _has_other_sign(apply, rest, b), b, 0.0))


def _has_other_sign(apply: Elementwise, rest: Nodes, b: Nodes) -> Nodes:
    return apply("and", apply("ne", rest, 0.0), apply("ne", apply("lt", rest, 0.0), apply("lt", b, 0.0)))


def floor_divide(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute a // b as Python does: the quotient less the remainder, which is nearly whole, rounded."""
    apply = Elementwise(builder)
    rest = remainder(builder, a, b)
    quotient = apply("div", apply("sub", a, rest), b)
    return apply("sub", round_to_even(builder, quotient), _has_other_sign(apply, rest, b))


def with_exact_remainder(rule: Rule) -> EvaluatorRule:
    """Return a rule that fails where the remainder of its arguments is not known, as their quotient is too large."""

    def apply_rule(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
        builder, apply = evaluator.builder, Elementwise(evaluator.builder)
        result: Nodes = rule(builder, a, b)
        known = [builder.value(int(node)) for node in b.ravel()]
        largest = max(-_lowest(builder, a), _highest(builder, a)) / 2.0**53
        if any(value is None or abs(value) < largest for value in known):
            is_unknown = apply("and", apply("ne", result, result), apply("ne", b, 0.0))
            evaluator.fail_where(apply("and", is_unknown, _all_finite(apply, a, b)))
        return result

    return apply_rule


def failing_at_zero(rule: Rule) -> EvaluatorRule:
    """Return a rule with an exact remainder that fails if the second argument is 0."""
    exact = with_exact_remainder(rule)

    def apply_rule(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
        _fail_at_zero(evaluator, b)
        return exact(evaluator, a, b)

    return apply_rule


def numpy_floor_divide(builder: GraphBuilder, a: Nodes, b: Nodes) -> Nodes:
    """Compute a // b as NumPy does, which divides by 0 as C does."""
    result, apply = floor_divide(builder, a, b), Elementwise(builder)
    return result if _is_nonzero(builder, b) else apply("select", apply("eq", b, 0.0), apply("div", a, b), result)


def power(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    """Compute a ** b.

    It fails for 0 to a negative power, for a result that is too large, and for one that is complex.
    """
    builder, apply = evaluator.builder, Elementwise(evaluator.builder)
    result = apply("pow", a, b)
    low, high = _lowest(builder, b), _highest(builder, b)
    if low < 0:
        is_below = apply("and", apply("lt", b, 0.0), apply("gt", b, -math.inf))
        evaluator.fail_where(apply("and", apply("eq", a, 0.0), is_below))
    if _lowest(builder, a) < 0 and not (low == high == math.floor(low)):
        is_negative = apply("and", apply("lt", a, 0.0), apply("gt", a, -math.inf))
        is_broken = apply("and", apply("lt", apply("abs", b), math.inf), apply("ne", b, apply("floor", b)))
        evaluator.fail_where(apply("and", is_negative, is_broken))
    if low < 0 or high > _HARMLESS:
        evaluator.fail_where(apply("and", _is_infinite(apply, result), _all_finite(apply, a, b)))
    return result


def _lowest(builder: GraphBuilder, x: Nodes) -> float:
    return min(bound_of(builder, int(n), False) for n in x.ravel())


def _highest(builder: GraphBuilder, x: Nodes) -> float:
    return max(bound_of(builder, int(n), True) for n in x.ravel())


def _is_infinite(apply: Elementwise, x: Nodes) -> Nodes:
    return apply("eq", apply("abs", x), math.inf)


def _all_finite(apply: Elementwise, *values: Nodes) -> Nodes:
    return reduce(partial(apply, "and"), [apply("lt", apply("abs", value), math.inf) for value in values])


def without_overflow(rule: Rule) -> EvaluatorRule:
    """Return a rule that fails with OverflowError, if a finite number gives an infinite one."""

    def apply_rule(evaluator: SymbolicEvaluator, x: Nodes) -> Nodes:
        apply = Elementwise(evaluator.builder)
        result = rule(evaluator.builder, x)
        evaluator.fail_where(apply("and", _is_infinite(apply, result), _all_finite(apply, x)))
        return result

    return apply_rule


def within(rule: Rule, low: float, high: float, ends: bool = True) -> EvaluatorRule:
    """Return a rule that fails with ValueError beyond two limits, and at them if they are not in its domain."""

    def apply_rule(evaluator: SymbolicEvaluator, x: Nodes) -> Nodes:
        builder, apply = evaluator.builder, Elementwise(evaluator.builder)
        below, above = ("lt", "gt") if ends else ("le", "ge")
        # where bounds are known, a check would cost a node and show a failure that cannot occur
        least, most = _lowest(builder, x), _highest(builder, x)
        if least < low or (least == low and not ends):
            evaluator.fail_where(apply(below, x, low))
        if most > high or (most == high and not ends and math.isfinite(high)):
            evaluator.fail_where(apply(above, x, high))
        return rule(builder, x)

    return apply_rule


def of_finite(rule: Rule) -> EvaluatorRule:
    """Return a rule that fails with ValueError for infinity."""

    def apply_rule(evaluator: SymbolicEvaluator, x: Nodes) -> Nodes:
        builder = evaluator.builder
        if not _is_bounded(builder, x):
            evaluator.fail_where(_is_infinite(Elementwise(builder), x))
        return rule(builder, x)

    return apply_rule


def to_integer(rule: Rule) -> EvaluatorRule:
    """Return a rule that rounds to an integer, which neither infinity nor NaN have."""

    def apply_rule(evaluator: SymbolicEvaluator, x: Nodes) -> Nodes:
        apply = Elementwise(evaluator.builder)
        # bounds do not tell that a number is not NaN
        evaluator.fail_where(apply("not", _all_finite(apply, x)))
        return rule(evaluator.builder, x)

    return apply_rule


def _is_bounded(builder: GraphBuilder, x: Nodes) -> bool:
    return math.isfinite(_lowest(builder, x)) and math.isfinite(_highest(builder, x))


def exact_remainder(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    """Compute `math.fmod`, which fails for a divisor of 0 and for an infinite dividend, unless the other is NaN."""
    apply = Elementwise(evaluator.builder)
    if not _is_nonzero(evaluator.builder, b):
        evaluator.fail_where(apply("and", apply("eq", b, 0.0), apply("eq", a, a)))
    if not _is_bounded(evaluator.builder, a):
        evaluator.fail_where(apply("and", _is_infinite(apply, a), apply("eq", b, b)))
    return with_exact_remainder(remainder)(evaluator, a, b)


def logarithm(evaluator: SymbolicEvaluator, x: Nodes, base: Nodes) -> Nodes:
    log = within(ONE["log"], 0.0, math.inf, ends=False)
    return divide(evaluator, log(evaluator, x), log(evaluator, base))


def integer_operation(op: str, exact: Callable[[int, int], int]) -> EvaluatorRule:
    """Return the rule of an operator of integers, which have any number of digits in Python."""

    def rule(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes, line: Nodes) -> Nodes:
        builder = evaluator.builder
        values = [builder.value(int(node.item())) for node in (a, b)]
        numbers = [int(value) for value in values if value is not None and value.is_integer()]
        if len(numbers) == 2 and (op != "pow" or 0 <= numbers[1] < _MOST_EXACT):
            number = exact(*numbers)
            if not is_exact(number):
                raise ProgramError("an integer beyond 2^53 that no double represents")
            return np.array([[builder.const(float(number))]], dtype=np.int64)
        result = power(evaluator, a, b) if op == "pow" else Elementwise(builder)(op, a, b)
        size = max(-_lowest(builder, result), _highest(builder, result))
        # a sum exceeds 2^53 only if one of its terms nearly does
        may_exceed = size > 2.0**53 and (op in ("mul", "pow") or math.isfinite(size))
        # a variable that is an integer at first may be a float in a later pass of a loop
        if may_exceed and is_whole(builder, int(a.item())) and is_whole(builder, int(b.item())):
            evaluator.context.remark(_ROUNDED, known_integer(evaluator, line))
        return result

    return rule


def integer_modulo(evaluator: SymbolicEvaluator, a: Nodes, b: Nodes) -> Nodes:
    """Compute a % b of integers; the result has the bounds that follow from a constant b."""
    result, apply = failing_at_zero(modulo)(evaluator, a, b), Elementwise(evaluator.builder)
    divisor = evaluator.builder.value(int(b.item()))
    return result if divisor is None or divisor <= 0 else apply("max", apply("min", result, divisor), 0.0)
