"""The length of ranges, which must not depend on signals."""

import math

from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import EvaluationError


def range_length(context: EvaluationContext, span: float, step: float) -> int:
    """Return the number of elements of a range over this distance; raises `ProgramError` if it is too large."""
    steps = span / step if step else -1.0
    if math.isnan(steps):
        raise EvaluationError("the ends of a range are not numbers")
    context.room(steps)
    return math.floor(steps * (1 + 1e-12) + 1e-10) + 1 if steps > -1 else 0


def constant_distance(context: EvaluationContext, first: int, last: int) -> float | None:
    """Return b - a if it is constant: of two constants, or of the same signal plus constants; else None."""
    begin, end = context.constant(first), context.constant(last)
    if begin is not None and end is not None:
        return end - begin
    (base, offset), (other_base, other_offset) = _offset(context, first), _offset(context, last)
    return other_offset - offset if base == other_base else None


def _offset(context: EvaluationContext, node: int) -> tuple[int, float]:
    """Return a node and the constant whose sum a node is."""
    total = 0.0
    for _ in range(100):
        op, args, _ = context.builder.nodes[node]
        fixed = [context.constant(arg) for arg in args] if op in ("add", "sub") else []
        if fixed and fixed[1] is not None:
            node, total = args[0], total + (fixed[1] if op == "add" else -fixed[1])
        elif fixed and fixed[0] is not None and op == "add":
            node, total = args[1], total + fixed[0]
        else:
            break
    return node, total
