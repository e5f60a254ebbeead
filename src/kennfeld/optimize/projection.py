"""A start that keeps the limits: the nearest values that do."""

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.quadratic import Limits, solve

__all__ = ["project"]

FEASIBLE = 1e-9  # of the limits' scale


def project(values: Float, limits: Limits) -> tuple[Float | None, str]:
    """The values moved into the limits, None where that is impossible; and a remark, empty where nothing was moved.

    Distances are measured in units of each value's size.
    """
    clipped = limits.clip(values)
    moved = int(np.count_nonzero(clipped != values))
    remark = f"The start lay outside its bounds in {moved} values and was moved onto them." if moved else ""
    if limits.violation(clipped) <= FEASIBLE:
        return clipped, remark
    movable = limits.movable
    rest = limits.target - limits.matrix[:, ~movable] @ clipped[~movable]
    narrow = Limits(limits.lower[movable], limits.upper[movable], limits.matrix[:, movable], rest)
    here = clipped[movable]
    size = np.maximum(np.abs(here), np.abs(here).mean() if here.size else 1.0) + 1e-12
    step = solve(np.asfortranarray(np.diag(1 / size)), np.zeros(here.size), here, narrow).step
    there = clipped.copy()
    there[movable] = narrow.clip(here + step)
    if limits.violation(there) > FEASIBLE:
        rows = np.flatnonzero(np.abs(limits.matrix @ there - limits.target) > FEASIBLE)
        return None, f"Pins contradict bounds, locks or each other: pin {int(rows[0]) + 1} cannot be met."
    return there, "The start did not keep the pins and was moved to the nearest values that do."
