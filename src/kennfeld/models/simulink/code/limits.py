"""How large or small a node can become, by the operations that make it."""

import math
from collections.abc import Callable
from typing import NamedTuple

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.code.conditions import TRUTHS

__all__ = ["Limits", "away_from_zero", "limits_of", "most_of"]

_DEEPEST = 30


class Limits(NamedTuple):
    """The values between which a node stays."""

    low: float = -math.inf
    high: float = math.inf


def away_from_zero(x: float) -> float:
    """The nearest whole number, of two equally near the one farther from 0."""
    return math.copysign(math.floor(abs(x) + 0.5), x)


_RISING: dict[str, Callable[[float], float]] = {
    "floor": math.floor,
    "ceil": math.ceil,
    "round": away_from_zero,
}


def most_of(loom: Loom, node: int, up: bool) -> float:
    """The largest value that a node can have, or the smallest."""
    found = limits_of(loom, node)
    return found.high if up else found.low


def limits_of(loom: Loom, node: int) -> Limits:
    """The values between which a node stays, as far as its operations tell."""
    return _Search(loom).limits(node, 0)


class _Search:
    def __init__(self, loom: Loom) -> None:
        self.loom = loom
        self.seen: dict[int, Limits] = {}

    def limits(self, node: int, depth: int) -> Limits:
        if node not in self.seen:
            self.seen[node] = self._limits(node, depth)
        return self.seen[node]

    def _limits(self, node: int, depth: int) -> Limits:
        op, args, payload = self.loom.nodes[node]
        if op == "const":
            return Limits(payload, payload)
        if op in TRUTHS or op == "sign":
            return Limits(-1.0 if op == "sign" else 0.0, 1.0)
        if depth > _DEEPEST:
            return Limits()
        if op == "select":
            return self._select(args, depth + 1)
        if op not in _RULES:
            return Limits()
        return Limits(*_RULES[op](*(self.limits(arg, depth + 1) for arg in args)))

    def _select(self, args: tuple[int, ...], depth: int) -> Limits:
        """Of both sides; a side that its own condition bounds is bounded by it."""
        choice, yes, no = args
        a, b = self.limits(yes, depth), self.limits(no, depth)
        op, sides, _ = self.loom.nodes[choice]
        if op in ("gt", "ge", "lt", "le"):
            x, limit = sides if op in ("gt", "ge") else sides[::-1]  # the condition is x > limit
            a, b = self._bounded(a, yes, x, limit, depth), self._bounded(b, no, limit, x, depth)
        return Limits(min(a.low, b.low), max(a.high, b.high))

    def _bounded(self, found: Limits, node: int, greater: int, less: int, depth: int) -> Limits:
        """The limits of a side where one node is known to be greater than another."""
        if node == greater:
            return Limits(max(found.low, self.limits(less, depth).low), found.high)
        if node == less:
            return Limits(found.low, min(found.high, self.limits(greater, depth).high))
        return found


def _whole(op: str, x: Limits) -> Limits:
    return Limits(*(_RISING[op](one) if math.isfinite(one) else one for one in x))


def _mod(a: Limits, b: Limits) -> Limits:
    return Limits(0.0, b.high) if b.low > 0 else Limits()


def _abs(x: Limits) -> Limits:
    low = 0.0 if x.low <= 0 <= x.high else min(abs(x.low), abs(x.high))
    return Limits(low, max(abs(x.low), abs(x.high)))


def _mul(a: Limits, b: Limits) -> Limits:
    ends = [p * q for p in a for q in b]
    return Limits() if any(math.isnan(end) for end in ends) else Limits(min(ends), max(ends))


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
