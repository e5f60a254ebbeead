"""Ranges: evenly spaced numbers, whose count is fixed."""

import math
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.code.values import constants
from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.signals import Nodes

if TYPE_CHECKING:
    from kennfeld.models.simulink.code.calls import Calls

__all__ = ["distance", "spaced", "steps_within"]


def spaced(calls: "Calls", tree: m.Range) -> Nodes:
    """`first:step:last`; rounding does not take the last number away.

    The beginning may depend on signals where the distance to the end does not, as in `k:k+2`.
    """
    first, last = calls.nodes(tree.first), calls.nodes(tree.last)
    step = 1.0 if tree.step is None else calls.number(tree.step, "the step of a range")
    if first.size != 1 or last.size != 1:
        raise CodeError("a range from or to an array")
    calls.desk.numbers(np.concatenate([first, last]), "the ends of a range")
    span = distance(calls, int(first.item()), int(last.item()))
    if span is None:
        raise CodeError("the length of a range depends on signals", "Loop over fixed numbers, with if within.")
    begin, count = calls.desk.constant(int(first.item())), steps_within(calls, span, step)
    if begin is not None:
        return constants(calls.loom, begin + step * np.arange(count).reshape(1, -1))
    return each(calls.loom, "add", first, constants(calls.loom, step * np.arange(count).reshape(1, -1)))


def steps_within(calls: "Calls", span: float, step: float) -> int:
    """How many numbers a range has that goes so far; refused where no model has room for them."""
    steps = span / step if step else -1.0
    if math.isnan(steps):
        raise CodeError("the ends of a range are no numbers")
    calls.desk.room(steps)
    return math.floor(steps * (1 + 1e-12) + 1e-10) + 1 if steps > -1 else 0


def distance(calls: "Calls", first: int, last: int) -> float | None:
    """How far it is from one node to another, where that is fixed: both are, or the same signal plus fixed numbers."""
    begin, end = calls.desk.constant(first), calls.desk.constant(last)
    if begin is not None and end is not None:
        return end - begin
    (base, offset), (other, more) = _offset(calls, first), _offset(calls, last)
    return more - offset if base == other else None


def _offset(calls: "Calls", node: int) -> tuple[int, float]:
    total = 0.0
    for _ in range(100):
        op, args, _ = calls.loom.nodes[node]
        fixed = [calls.desk.constant(arg) for arg in args] if op in ("add", "sub") else []
        if fixed and fixed[1] is not None:
            node, total = args[0], total + (fixed[1] if op == "add" else -fixed[1])
        elif fixed and fixed[0] is not None and op == "add":
            node, total = args[1], total + fixed[0]
        else:
            break
    return node, total
