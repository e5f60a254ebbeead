"""Conditions as nodes, simplified where that is simple, and what is known of them along a path of decisions."""

from collections.abc import Mapping

from kennfeld.models.formula.functions import Loom

__all__ = ["assumed", "both", "either", "known", "negated"]

_DEEPEST = 40


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


def known(loom: Loom, facts: Mapping[int, bool], node: int, depth: int = 0) -> bool | None:
    """Whether a condition holds by what is known; None where that does not tell."""
    value = loom.value(node)
    if value is not None:
        return bool(value)
    if node in facts or depth > _DEEPEST:
        return facts.get(node)
    op, args, _ = loom.nodes[node]
    if op == "not":
        found = known(loom, facts, args[0], depth + 1)
        return None if found is None else not found
    if op in ("and", "or"):
        parts = [known(loom, facts, arg, depth + 1) for arg in args]
        strong = op == "or"  # one such part decides
        return strong if strong in parts else None if None in parts else not strong
    return None
