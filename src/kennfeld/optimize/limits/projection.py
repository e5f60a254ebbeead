"""A start that keeps the limits: the nearest values that do."""

import numpy as np

from kennfeld.arrays import Float, silent
from kennfeld.errors import Finding, InputError
from kennfeld.native import Factor, Values
from kennfeld.optimize.limits.contradictions import contradictions
from kennfeld.optimize.limits.limiting import limits_of
from kennfeld.optimize.limits.limits import Limits
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.solver.quadratic import solve

__all__ = ["FEASIBLE", "infeasible", "missed_limits", "movable", "project"]

FEASIBLE = 1e-9  # of the limits' scale


@silent()  # a scale that overflows is checked as any other
def project(values: Float, limits: Limits) -> tuple[Float | None, str]:
    """The values moved into the limits, None where that is impossible; and a remark, empty where nothing was moved.

    Distances are measured in units of each value's size.
    """
    clipped = limits.clip(values)
    moved = int(np.count_nonzero((clipped != values) & ~np.isnan(values)))
    remark = f"The start lay outside its bounds in {moved} values and was moved onto them." if moved else ""
    size = _sizes(clipped)
    if limits.violation(clipped) <= FEASIBLE:
        return clipped, remark
    movable = np.flatnonzero(limits.movable)
    here = clipped[movable]
    narrow = limits.narrowed(movable, clipped)
    solution = solve(Factor.of(np.diag(1 / size[movable])), np.zeros(here.size), here, narrow)
    there = clipped.copy()
    there[movable] = solution.reached(here, narrow)
    missed = limits.violations(there, limits.sizes(there))
    if not np.all(missed <= FEASIBLE):
        worst = np.argsort(-np.nan_to_num(missed, nan=np.inf), kind="stable")
        told = contradictions(limits, there, worst[~(missed[worst] <= FEASIBLE)])
        return None, f"Limits contradict bounds, locks or each other: {told}."
    return there, "The start did not keep its limits and was moved to the nearest values that do."


def missed_limits(values: Float, limits: Limits) -> str:
    """Name the bounds and rows that values miss by more than rounding; empty if all are kept."""
    rows = ~(limits.violations(values, limits.sizes(values)) <= FEASIBLE)
    names = [limits.rows.names[row] for row in np.flatnonzero(rows)[:3]]
    beyond = int(np.count_nonzero((values < limits.lower) | (values > limits.upper)))
    return "; ".join([*names, *([f"bounds of {beyond} values"] if beyond else [])])


def infeasible(problem: Problem) -> list[Finding]:
    """Bounds, locks and linear limits of a problem that contradict each other."""
    if not problem.pins and not problem.constraints:
        return []
    values = _in_order(problem)
    try:
        limits = limits_of(problem, values)
    except InputError as error:
        return list(error.findings)
    moved, remark = project(values.pack(problem.parameters)[: values.free], limits)
    return [Finding("constraints", remark)] if moved is None else []


def movable(problem: Problem) -> int:
    """Return how many of the free values may change: those that neither a lock nor two equal bounds hold.

    Raises `InputError` where a limit concerns what is not free.
    """
    return int(limits_of(problem, _in_order(problem)).movable.sum())


def _in_order(problem: Problem) -> Values:
    """The free values one after the other, as no kernel is needed to compare limits."""
    offsets, end = {}, 0
    for name in problem.free_names:
        offsets[name] = end
        end += problem.parameters[name].size
    moving, places = {}, {}
    for key, axis in problem.free_axes.items():
        moving[key], places[key] = end, axis.places[0]
        end += len(axis.axis)
    return Values(offsets, free=end, reach=0, total=end, moving=moving, places=places)


def _sizes(values: Float) -> Float:
    """A typical size of each value, above 0."""
    known = np.abs(np.nan_to_num(values))
    typical = float(known.mean()) if known.size else 0.0
    sizes: Float = np.maximum(known, typical if typical > 0 else 1.0)
    return sizes
