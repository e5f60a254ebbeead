"""Limits that cannot be kept together, in words: each with what it asks for, and what stands against it.

A start that keeps the limits: the nearest values that do.
"""

from collections.abc import Iterator

import numpy as np

from kennfeld.arrays import Float, Int, silent
from kennfeld.errors import Finding, InputError
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.native import Factor
from kennfeld.optimize.linear_limits import linear_limits
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.solver.quadratic_program import solve

__all__ = ["FEASIBLE", "infeasible", "missed_limits", "movable", "project"]

MOST = 3  # limits that are named
SLACK = 1e-9  # of the size of a limit: how near to its side a row counts as met

FEASIBLE = 1e-9  # of the limits' scale


def contradictions(limits: LinearLimits, nearest: Float, missed: Int) -> str:
    """Return a clause for each of the first rows that are missed, such as "pin of C at 0 must be 3, but ...".

    Args:
        limits: bounds and rows.
        nearest: the values that come nearest to keeping them all.
        missed: the rows that these values miss, worst first.
    """
    return "; ".join(_clause(limits, nearest, int(row)) for row in missed[:MOST])


def _clause(limits: LinearLimits, nearest: Float, row: int) -> str:
    rows = limits.rows
    low, high = _reach(limits, row)
    slack = SLACK * max(abs(side) for side in (low, high, rows.lower[row], rows.upper[row], 1.0) if np.isfinite(side))
    if rows.lower[row] > high + slack or rows.upper[row] < low - slack:
        against = (
            f"bounds and locks hold it at {low:g}" if low == high else f"bounds and locks keep it {_side(low, high)}"
        )
    else:
        others = [f"{rows.names[other]} ({_required(limits, other)})" for other in _rivals(limits, nearest, row)]
        against = f"that contradicts {' and '.join(others)}" if others else "other limits keep it from that"
    return f"{rows.names[row]} {_required(limits, row)}, but {against}"


def _required(limits: LinearLimits, row: int) -> str:
    low, high = limits.rows.lower[row], limits.rows.upper[row]
    return f"must be {low:g}" if low == high else f"must be {_side(low, high)}"


def _side(low: float, high: float) -> str:
    if np.isinf(high):
        return f">= {low:g}"
    return f"<= {high:g}" if np.isinf(low) else f"between {low:g} and {high:g}"


def _reach(limits: LinearLimits, row: int) -> tuple[float, float]:
    """Return the least and the largest value that the bounds of its values allow a row."""
    used = limits.rows.coefficients[row] != 0
    factors, columns = limits.rows.coefficients[row][used], limits.rows.columns[row][used]
    ends = np.sort(factors[:, None] * np.stack([limits.lower[columns], limits.upper[columns]], axis=1), axis=1)
    low, high = ends.sum(axis=0)
    return float(low), float(high)


def _rivals(limits: LinearLimits, nearest: Float, row: int) -> Iterator[int]:
    """Yield the first other rows that share a value with a row and are at one of their sides, or miss it."""
    rows = limits.rows
    touched = set(rows.columns[row][rows.coefficients[row] != 0].tolist())
    product, slack = rows.times(nearest), SLACK * (rows.size(nearest) + 1e-300)
    tight = np.flatnonzero((product <= rows.lower + slack) | (product >= rows.upper - slack))
    left = MOST - 1
    for other in tight.tolist():
        used = rows.columns[other][rows.coefficients[other] != 0].tolist()
        if other != row and left and touched.intersection(used):
            left -= 1
            yield other


@silent()  # a scale that overflows is checked as any other
def project(values: Float, limits: LinearLimits) -> tuple[Float | None, str]:
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


def missed_limits(values: Float, limits: LinearLimits) -> str:
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
        limits = linear_limits(problem, values)
    except InputError as error:
        return list(error.findings)
    moved, remark = project(values.pack(problem.parameters)[: values.free], limits)
    return [Finding("constraints", remark)] if moved is None else []


def movable(problem: Problem) -> int:
    """Return how many of the free values may change: those that neither a lock nor two equal bounds hold.

    Raises `InputError` where a limit concerns what is not free.
    """
    return int(linear_limits(problem, _in_order(problem)).movable.sum())


def _in_order(problem: Problem) -> ValueLayout:
    """The free values one after the other, as no kernel is needed to compare limits."""
    offsets, end = {}, 0
    for name in problem.free_names:
        offsets[name] = end
        end += problem.parameters[name].size
    moving, places = {}, {}
    for key, axis in problem.free_axes.items():
        moving[key], places[key] = end, axis.places[0]
        end += len(axis.axis)
    return ValueLayout(offsets, free=end, reach=0, total=end, moving=moving, places=places)


def _sizes(values: Float) -> Float:
    """A typical size of each value, above 0."""
    known = np.abs(np.nan_to_num(values))
    typical = float(known.mean()) if known.size else 0.0
    sizes: Float = np.maximum(known, typical if typical > 0 else 1.0)
    return sizes
