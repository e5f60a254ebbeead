"""Errors whose weighted squares are too small for numbers: a search then sees none, and ends where it began."""

from collections.abc import Collection, Sequence
from dataclasses import replace

from kennfeld.optimize.quality import Quality
from kennfeld.optimize.solver.gauss_newton import Descent

__all__ = ["without_vanished"]

FAINT = 1e-290  # a cost below has lost digits
REACHED = 1e-10  # share of the cost at the start below which a fit is as good as exact
VANISHED = (
    "The weighted squares of the errors are too small for numbers. Use larger weights, a smaller scale or other units."
)


def without_vanished(end: Descent, before: float, quality: Sequence[Quality], scored: Collection[str]) -> Descent:
    """Return an end that has failed where errors are left that the cost does not show, else the same end.

    Args:
        end: where the search ended.
        before: the cost at the start.
        quality: the errors at the end.
        scored: the criteria of a weight > 0.
    """
    left = any(q.max_abs_after > 0 for q in quality if q.use == "training" and q.criterion in scored)
    if end.status != "converged" or not left or not REACHED * before <= end.cost < FAINT:
        return end
    return replace(end, status="failed", message=VANISHED)
