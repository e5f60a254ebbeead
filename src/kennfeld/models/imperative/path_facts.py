"""How large or small a node can become, by the operations that make it.

Conditions as nodes, simplified where that is simple, and what is known of them along a path of decisions.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from kennfeld.graph.builder import GraphBuilder

__all__ = [
    "assume",
    "bound_of",
    "known_truth",
    "logical_and",
    "logical_not",
    "logical_or",
    "round_half_away",
    "truth_of",
]

TRUTHS: Final = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not"})  # operations that give 1 or 0
_DEEPEST = 40
_MOST = 200  # conditions that are looked at for one

_DEEPEST_BOUNDS = 30


def truth_of(builder: GraphBuilder, node: int) -> int:
    """A condition as 1 or 0: whatever is not 0 holds."""
    value = builder.value(node)
    if value is not None:
        return builder.const(float(value != 0))
    return node if builder.nodes[node].op in TRUTHS else builder.call("ne", node, builder.const(0.0))


def logical_not(builder: GraphBuilder, node: int) -> int:
    """Whether a condition does not hold."""
    return builder.nodes[node].args[0] if builder.nodes[node].op == "not" else builder.call("not", node)


def logical_and(builder: GraphBuilder, one: int, other: int) -> int:
    """Whether two conditions hold."""
    for first, second in ((one, other), (other, one)):
        value = builder.value(first)
        if value is not None:
            return second if value else builder.const(0.0)
    return one if one == other else builder.call("and", one, other)


def logical_or(builder: GraphBuilder, one: int, other: int) -> int:
    """Whether one of two conditions holds."""
    for first, second in ((one, other), (other, one)):
        value = builder.value(first)
        if value is not None:
            return builder.const(1.0) if value else second
    if one == other or logical_not(builder, one) == other:
        return one if one == other else builder.const(1.0)
    return builder.call("or", one, other)


def assume(builder: GraphBuilder, facts: Mapping[int, bool], node: int, holds: bool) -> dict[int, bool]:
    """What is known once a condition is known too, with what follows from it."""
    made, waiting = dict(facts), [(node, holds)]
    while waiting:
        at, truth = waiting.pop()
        made[at] = truth
        op, args, _ = builder.nodes[at]
        if op == "not":
            waiting.append((args[0], not truth))
        elif op == ("and" if truth else "or"):
            waiting += [(arg, truth) for arg in args if arg not in made]
    return made


def known_truth(builder: GraphBuilder, facts: Mapping[int, bool], node: int) -> bool | None:
    """Whether a condition holds by what is known; None where that does not tell."""
    value = builder.value(node)
    if value is not None or not facts:
        return None if value is None else bool(value)
    return _known(builder, facts, node, {}, 0)


def _known(
    builder: GraphBuilder, facts: Mapping[int, bool], node: int, seen: dict[int, bool | None], depth: int
) -> bool | None:
    """As `known`; parts that several conditions share are looked at once."""
    if node in facts or depth > _DEEPEST or len(seen) > _MOST:
        return facts.get(node)
    if node not in seen:
        op, args, _ = builder.nodes[node]
        value = builder.value(node)
        found = None if value is None else bool(value)
        if op in ("not", "and", "or"):
            parts = [_known(builder, facts, arg, seen, depth + 1) for arg in args]
            strong = op == "or"  # one such part decides
            found = strong if strong in parts else None if None in parts else not strong
            found = (None if parts[0] is None else not parts[0]) if op == "not" else found
        seen[node] = found
    return seen[node]


class Interval(NamedTuple):
    """The values between which a node stays."""

    low: float = -math.inf
    high: float = math.inf


def round_half_away(x: float) -> float:
    """The nearest whole number, of two equally near the one farther from 0."""
    return math.copysign(math.floor(abs(x) + 0.5), x)


_RISING: dict[str, Callable[[float], float]] = {
    "floor": math.floor,
    "ceil": math.ceil,
    "round": round_half_away,
}


def bound_of(builder: GraphBuilder, node: int, up: bool) -> float:
    """The largest value that a node can have, or the smallest."""
    found = interval_of(builder, node)
    return found.high if up else found.low


def interval_of(builder: GraphBuilder, node: int) -> Interval:
    """The values between which a node stays, as far as its operations tell."""
    return _IntervalAnalysis(builder).limits(node, 0)


class _IntervalAnalysis:
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
        if op in TRUTHS or op == "sign":
            return Interval(-1.0 if op == "sign" else 0.0, 1.0)
        if depth > _DEEPEST_BOUNDS:
            return Interval()
        if op == "select":
            return self._select(args, depth + 1)
        if op not in _RULES:
            return Interval()
        return Interval(*_RULES[op](*(self.limits(arg, depth + 1) for arg in args)))

    def _select(self, args: tuple[int, ...], depth: int) -> Interval:
        """Of both sides; a side that its own condition bounds is bounded by it."""
        choice, yes, no = args
        a, b = self.limits(yes, depth), self.limits(no, depth)
        op, sides, _ = self.builder.nodes[choice]
        if op in ("gt", "ge", "lt", "le"):
            x, limit = sides if op in ("gt", "ge") else sides[::-1]  # the condition is x > limit
            a, b = self._bounded(a, yes, x, limit, depth), self._bounded(b, no, limit, x, depth)
        return Interval(min(a.low, b.low), max(a.high, b.high))

    def _bounded(self, found: Interval, node: int, greater: int, less: int, depth: int) -> Interval:
        """The limits of a side where one node is known to be greater than another."""
        if node == greater:
            return Interval(max(found.low, self.limits(less, depth).low), found.high)
        if node == less:
            return Interval(found.low, min(found.high, self.limits(greater, depth).high))
        return found


def _whole(op: str, x: Interval) -> Interval:
    return Interval(*(_RISING[op](one) if math.isfinite(one) else one for one in x))


def _mod(a: Interval, b: Interval) -> Interval:
    return Interval(0.0, b.high) if b.low > 0 else Interval()


def _abs(x: Interval) -> Interval:
    low = 0.0 if x.low <= 0 <= x.high else min(abs(x.low), abs(x.high))
    return Interval(low, max(abs(x.low), abs(x.high)))


def _mul(a: Interval, b: Interval) -> Interval:
    ends = [p * q for p in a for q in b]
    return Interval() if any(math.isnan(end) for end in ends) else Interval(min(ends), max(ends))


_RULES: dict[str, Callable[..., tuple[float, float]]] = {
    "min": lambda a, b: (min(a.low, b.low), min(a.high, b.high)),
    "max": lambda a, b: (max(a.low, b.low), max(a.high, b.high)),
    "add": lambda a, b: (a.low + b.low, a.high + b.high),
    "sub": lambda a, b: (a.low - b.high, a.high - b.low),
    "neg": lambda x: (-x.high, -x.low),
    "floor": lambda x: _whole("floor", x),
    "ceil": lambda x: _whole("ceil", x),
    "round": lambda x: _whole("round", x),
    "abs": _abs,
    "mod": _mod,
    "mul": _mul,
}
