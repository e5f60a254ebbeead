"""How large or small a node can become, by the operations that make it."""

import math
from collections.abc import Callable
from typing import NamedTuple

from kennfeld.models.formula.functions import Loom

__all__ = ["Limits", "limits_of", "most_of"]

_DEEPEST = 30


class Limits(NamedTuple):
    """The values between which a node stays."""

    low: float = -math.inf
    high: float = math.inf


_TRUTHS = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not"})


def _away(x: float) -> float:
    """The nearest whole number, of two equally near the one farther from 0."""
    return math.copysign(math.floor(abs(x) + 0.5), x)


_RISING: dict[str, Callable[[float], float]] = {
    "floor": math.floor,
    "ceil": math.ceil,
    "round": _away,
}


def most_of(loom: Loom, node: int, up: bool) -> float:
    """The largest value that a node can have, or the smallest."""
    found = limits_of(loom, node)
    return found.high if up else found.low


def limits_of(loom: Loom, node: int, depth: int = 0) -> Limits:
    """The values between which a node stays, as far as its operations tell."""
    op, args, payload = loom.nodes[node]
    if op == "const":
        return Limits(payload, payload)
    if op in _TRUTHS or op == "sign":
        return Limits(-1.0 if op == "sign" else 0.0, 1.0)
    if depth > _DEEPEST or op not in _RULES:
        return Limits()
    if op == "select":
        return _select(loom, args, depth)
    return Limits(*_RULES[op](*(limits_of(loom, arg, depth + 1) for arg in args)))


def _select(loom: Loom, args: tuple[int, ...], depth: int) -> Limits:
    """Of both sides; a side that its own condition bounds is bounded by it."""
    choice, yes, no = args
    a, b = limits_of(loom, yes, depth + 1), limits_of(loom, no, depth + 1)
    op, sides, _ = loom.nodes[choice]
    if op in ("gt", "ge", "lt", "le"):
        x, limit = sides if op in ("gt", "ge") else sides[::-1]  # the condition is x > limit
        a = _bounded(a, yes, x, limit, loom, depth, True)
        b = _bounded(b, no, x, limit, loom, depth, False)
    return Limits(min(a.low, b.low), max(a.high, b.high))


def _bounded(found: Limits, node: int, x: int, limit: int, loom: Loom, depth: int, above: bool) -> Limits:
    """The limits of a side where x > limit is known to hold, or not to hold."""
    greater, less = (x, limit) if above else (limit, x)
    if node == greater:
        return Limits(max(found.low, limits_of(loom, less, depth + 1).low), found.high)
    if node == less:
        return Limits(found.low, min(found.high, limits_of(loom, greater, depth + 1).high))
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
    "select": lambda *_: Limits(),
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
