"""Conditions as nodes, simplified where that is simple, and what is known of them along a path of decisions."""

from collections.abc import Mapping
from typing import Final

from kennfeld.models.formula.functions import Loom

__all__ = ["TRUTHS", "assumed", "both", "either", "known", "negated", "truth_of"]

TRUTHS: Final = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not"})  # operations that give 1 or 0
_DEEPEST = 40
_MOST = 200  # conditions that are looked at for one


def truth_of(loom: Loom, node: int) -> int:
    """A condition as 1 or 0: whatever is not 0 holds."""
    value = loom.value(node)
    if value is not None:
        return loom.const(float(value != 0))
    return node if loom.nodes[node].op in TRUTHS else loom.call("ne", node, loom.const(0.0))


def negated(loom: Loom, node: int) -> int:
    """Whether a condition does not hold."""
    return loom.nodes[node].args[0] if loom.nodes[node].op == "not" else loom.call("not", node)


def both(loom: Loom, one: int, other: int) -> int:
    """Whether two conditions hold."""
    for first, second in ((one, other), (other, one)):
        value = loom.value(first)
        if value is not None:
            return second if value else loom.const(0.0)
    return one if one == other else loom.call("and", one, other)


def either(loom: Loom, one: int, other: int) -> int:
    """Whether one of two conditions holds."""
    for first, second in ((one, other), (other, one)):
        value = loom.value(first)
        if value is not None:
            return loom.const(1.0) if value else second
    if one == other or negated(loom, one) == other:
        return one if one == other else loom.const(1.0)
    return loom.call("or", one, other)


def assumed(loom: Loom, facts: Mapping[int, bool], node: int, holds: bool) -> dict[int, bool]:
    """What is known once a condition is known too, with what follows from it."""
    made, waiting = dict(facts), [(node, holds)]
    while waiting:
        at, truth = waiting.pop()
        made[at] = truth
        op, args, _ = loom.nodes[at]
        if op == "not":
            waiting.append((args[0], not truth))
        elif op == ("and" if truth else "or"):
            waiting += [(arg, truth) for arg in args if arg not in made]
    return made


def known(loom: Loom, facts: Mapping[int, bool], node: int) -> bool | None:
    """Whether a condition holds by what is known; None where that does not tell."""
    value = loom.value(node)
    if value is not None or not facts:
        return None if value is None else bool(value)
    return _known(loom, facts, node, {}, 0)


def _known(loom: Loom, facts: Mapping[int, bool], node: int, seen: dict[int, bool | None], depth: int) -> bool | None:
    """As `known`; parts that several conditions share are looked at once."""
    if node in facts or depth > _DEEPEST or len(seen) > _MOST:
        return facts.get(node)
    if node not in seen:
        op, args, _ = loom.nodes[node]
        value = loom.value(node)
        found = None if value is None else bool(value)
        if op in ("not", "and", "or"):
            parts = [_known(loom, facts, arg, seen, depth + 1) for arg in args]
            strong = op == "or"  # one such part decides
            found = strong if strong in parts else None if None in parts else not strong
            found = (None if parts[0] is None else not parts[0]) if op == "not" else found
        seen[node] = found
    return seen[node]
