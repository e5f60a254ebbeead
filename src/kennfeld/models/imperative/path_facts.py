"""Conditions known along a path of decisions, and bounds of nodes derived from their operations."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

from kennfeld.graph.builder import CONDITIONS, GraphBuilder

_MAX_DEPTH = 40
_MAX_CONDITIONS = 200  # conditions that are looked at for one

_MAX_BOUND_DEPTH = 30
_ROUNDING = ("floor", "ceil", "round", "sign")
_KEEP_WHOLE = ("add", "sub", "mul", "pow", "mod", "min", "max", "abs", "neg", "select")


def truth_of(builder: GraphBuilder, node: int) -> int:
    """Return a condition as 1 or 0; any value but 0 is true."""
    value = builder.value(node)
    if value is not None:
        return builder.const(float(value != 0))
    return node if builder.nodes[node].op in CONDITIONS else builder.call("ne", node, builder.const(0.0))


def logical_not(builder: GraphBuilder, node: int) -> int:
    """Return the negation of a condition, simplified."""
    return builder.nodes[node].args[0] if builder.nodes[node].op == "not" else builder.call("not", node)


def logical_and(builder: GraphBuilder, item: int, other: int) -> int:
    """Return the conjunction of two conditions, simplified."""
    for first, second in ((item, other), (other, item)):
        value = builder.value(first)
        if value is not None:
            return second if value else builder.const(0.0)
        # (a or b) and a, as of a jump on the path of all jumps
        if builder.nodes[first].op == "or" and second in builder.nodes[first].args:
            return second
    return item if item == other else builder.call("and", item, other)


def logical_or(builder: GraphBuilder, item: int, other: int) -> int:
    """Return the disjunction of two conditions, simplified."""
    for first, second in ((item, other), (other, item)):
        value = builder.value(first)
        if value is not None:
            return builder.const(1.0) if value else second
        if builder.nodes[first].op == "and" and second in builder.nodes[first].args:
            return second
    if item == other or logical_not(builder, item) == other:
        return item if item == other else builder.const(1.0)
    return builder.call("or", item, other)


def assume(builder: GraphBuilder, facts: Mapping[int, bool], node: int, holds: bool) -> dict[int, bool]:
    """Return the known conditions after adding one, with those that follow from it."""
    result, waiting = dict(facts), [(node, holds)]
    while waiting:
        at, truth = waiting.pop()
        result[at] = truth
        op, args, _ = builder.nodes[at]
        if op == "not":
            waiting.append((args[0], not truth))
        elif op == ("and" if truth else "or"):
            waiting += [(arg, truth) for arg in args if arg not in result]
        if not waiting:
            waiting = _implied(builder, result)
    return result


def _implied(builder: GraphBuilder, facts: Mapping[int, bool]) -> list[tuple[int, bool]]:
    """Return conditions that follow from others together: if not (a and b), and a, then not b.

    A loop that is left by `break` and by `return` needs them: after a pass, neither was executed, and `return` is a
    condition of its own within the path on which `break` was not.
    """
    for at, truth in facts.items():
        op, args, _ = builder.nodes[at]
        if op != ("or" if truth else "and") or any(facts.get(arg) == truth for arg in args):
            continue
        known = [_known(builder, facts, arg, {}, 0) for arg in args]
        for arg, other in zip(args, reversed(known), strict=True):
            if other == (not truth) and arg not in facts:
                return [(arg, truth)]
    return []


def known_truth(builder: GraphBuilder, facts: Mapping[int, bool], node: int) -> bool | None:
    """Return the truth of a condition that follows from known ones, or None."""
    value = builder.value(node)
    if value is not None or not facts:
        return None if value is None else bool(value)
    return _known(builder, facts, node, {}, 0)


def _known(
    builder: GraphBuilder, facts: Mapping[int, bool], node: int, seen: dict[int, bool | None], depth: int
) -> bool | None:
    """Return the truth of a condition as `known_truth`; shared parts are examined once."""
    if node in facts or depth > _MAX_DEPTH or len(seen) > _MAX_CONDITIONS:
        return facts.get(node)
    if node not in seen:
        op, args, _ = builder.nodes[node]
        value = builder.value(node)
        result = None if value is None else bool(value)
        if op in ("not", "and", "or"):
            parts = [_known(builder, facts, arg, seen, depth + 1) for arg in args]
            strong = op == "or"  # one such part decides
            result = strong if strong in parts else None if None in parts else not strong
            result = (None if parts[0] is None else not parts[0]) if op == "not" else result
        seen[node] = result
    return seen[node]


def is_whole(builder: GraphBuilder, node: int) -> bool:
    """Return False if a node is not an integer by its operations; True for NaN, and for what is too deep to tell."""
    waiting, seen = [node], {node}
    while waiting and len(seen) <= _MAX_CONDITIONS:
        op, args, payload = builder.nodes[waiting.pop()]
        if op == "const" and not (math.isnan(payload) or payload.is_integer()):
            return False
        if op == "const" or op in CONDITIONS or op in _ROUNDING:
            continue
        if op not in _KEEP_WHOLE:
            return False
        own = args[1:] if op == "select" else args
        if op == "select" and _is_below_whole(builder, args[0]):
            own = own[:1]
        waiting += [arg for arg in own if arg not in seen]
        seen.update(own)
    return True


def _is_below_whole(builder: GraphBuilder, condition: int) -> bool:
    """Return True if a condition fails for numbers that are integers by their size only."""
    op, args, _ = builder.nodes[condition]
    return op == "lt" and (builder.value(args[1]) or 0.0) >= 2.0**52


class Interval(NamedTuple):
    """The bounds of a node."""

    low: float = -math.inf
    high: float = math.inf


def round_half_away(x: float) -> float:
    """Round to the nearest integer, halves away from zero."""
    return math.copysign(math.floor(abs(x) + 0.5), x)


def bound_of(builder: GraphBuilder, node: int, up: bool) -> float:
    """Return the upper or lower bound of a node."""
    result = _IntervalAnalysis(builder).limits(node, 0)
    return result.high if up else result.low


class _IntervalAnalysis:
    """Bounds of nodes that follow from their operations."""

    def __init__(self, builder: GraphBuilder) -> None:
        self.builder = builder
        self.seen: dict[int, Interval] = {}

    def limits(self, node: int, depth: int) -> Interval:
        if node not in self.seen:
            self.seen[node] = self._limits(node, depth)
        return self.seen[node]

    def _limits(self, node: int, depth: int) -> Interval:
        op, args, payload = self.builder.nodes[node]
        if op == "const":
            return Interval(payload, payload)
        if op in CONDITIONS or op == "sign":
            return Interval(-1.0 if op == "sign" else 0.0, 1.0)
        if depth > _MAX_BOUND_DEPTH:
            return Interval()
        if op == "select":
            return self._select(args, depth + 1)
        if op not in _RULES:
            return Interval()
        return Interval(*_RULES[op](*(self.limits(arg, depth + 1) for arg in args)))

    def _select(self, args: tuple[int, ...], depth: int) -> Interval:
        """Return the bounds of both sides; each may be bounded by the condition."""
        choice, yes, no = args
        a, b = self.limits(yes, depth), self.limits(no, depth)
        op, sides, _ = self.builder.nodes[choice]
        if op in ("gt", "ge", "lt", "le"):
            x, limit = sides if op in ("gt", "ge") else sides[::-1]  # the condition is x > limit
            a, b = self._bounded(a, yes, x, limit, depth), self._bounded(b, no, limit, x, depth)
        # a side that is NaN, where code fails, is within any bounds
        if math.isnan(a.low) or math.isnan(b.low):
            return b if math.isnan(a.low) else a
        return Interval(min(a.low, b.low), max(a.high, b.high))

    def _bounded(self, result: Interval, node: int, greater: int, less: int, depth: int) -> Interval:
        """Return the bounds of a side if one node is known to be greater than another."""
        if node == greater:
            return Interval(max(result.low, self.limits(less, depth).low), result.high)
        if node == less:
            return Interval(result.low, min(result.high, self.limits(greater, depth).high))
        return result


def _whole(rule: Callable[[float], float], x: Interval) -> Interval:
    return Interval(*(rule(item) if math.isfinite(item) else item for item in x))


def _mod(a: Interval, b: Interval) -> Interval:
    return Interval(0.0, b.high) if b.low > 0 else Interval()


def _abs(x: Interval) -> Interval:
    low = 0.0 if x.low <= 0 <= x.high else min(abs(x.low), abs(x.high))
    return Interval(low, max(abs(x.low), abs(x.high)))


def _mul(a: Interval, b: Interval) -> Interval:
    ends = [p * q for p in a for q in b]
    return Interval() if any(math.isnan(end) for end in ends) else Interval(min(ends), max(ends))


def _pow(a: Interval, b: Interval) -> Interval:
    if b.low < 0 or (a.low < 0 and not (b.low == b.high and b.low.is_integer())):
        return Interval()
    try:
        ends = [base**exponent for base in a for exponent in b]
    except OverflowError:
        return Interval()
    # an even power is least at 0
    return Interval(0.0 if a.low < 0 < a.high and b.low % 2 == 0 else min(ends), max(ends))


_RULES: dict[str, Callable[..., tuple[float, float]]] = {
    "min": lambda a, b: (min(a.low, b.low), min(a.high, b.high)),
    "max": lambda a, b: (max(a.low, b.low), max(a.high, b.high)),
    "add": lambda a, b: (a.low + b.low, a.high + b.high),
    "sub": lambda a, b: (a.low - b.high, a.high - b.low),
    "neg": lambda x: (-x.high, -x.low),
    "floor": partial(_whole, math.floor),
    "ceil": partial(_whole, math.ceil),
    "round": partial(_whole, round_half_away),
    "abs": _abs,
    "mod": _mod,
    "mul": _mul,
    "pow": _pow,
}
