"""Projection of a start onto its limits, and the description of limits that contradict each other."""

from collections.abc import Iterator

import numpy as np

from kennfeld.arrays import Float, Int, ignore_floating_errors
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import count_noun
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.native.cholesky import Factor
from kennfeld.optimize.linear_limits import linear_limits
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.solver.quadratic_program import solve

MAX_LISTED = 3
SLACK = 1e-9  # of the size of a limit: a row this close to its side is active
FEASIBLE = 1e-9  # of the limits' scale


def _describe_contradictions(limits: LinearLimits, nearest: Float, violated: Int) -> str:
    """Return a clause for each of the first violated rows, such as "pin of C at 0 must be 3, but ...".

    Args:
        limits: bounds and rows.
        nearest: the values that come closest to satisfying all.
        violated: the rows that these values violate, worst first.
    """
    return "; ".join(_clause(limits, nearest, int(row)) for row in violated[:MAX_LISTED])


def _clause(limits: LinearLimits, nearest: Float, row: int) -> str:
    rows = limits.rows
    low, high = _reach(limits, row)
    slack = SLACK * max(abs(side) for side in (low, high, rows.lower[row], rows.upper[row], 1.0) if np.isfinite(side))
    if rows.lower[row] > high + slack or rows.upper[row] < low - slack:
        against = (
            f"bounds and locks fix it at {low:g}" if low == high else f"bounds and locks keep it {_side(low, high)}"
        )
    else:
        others = [f"{rows.names[other]} ({_required(limits, other)})" for other in _rivals(limits, nearest, row)]
        against = f"that contradicts {' and '.join(others)}" if others else "other limits prevent that"
    return f"{rows.names[row]} {_required(limits, row)}, but {against}"


def _required(limits: LinearLimits, row: int) -> str:
    low, high = limits.rows.lower[row], limits.rows.upper[row]
    return f"must be {low:g}" if low == high else f"must be {_side(low, high)}"


def _side(low: float, high: float) -> str:
    if np.isinf(high):
        return f">= {low:g}"
    return f"<= {high:g}" if np.isinf(low) else f"between {low:g} and {high:g}"


def _reach(limits: LinearLimits, row: int) -> tuple[float, float]:
    """Return the range of a row within the bounds of its values."""
    used = limits.rows.coefficients[row] != 0
    factors, columns = limits.rows.coefficients[row][used], limits.rows.columns[row][used]
    ends = np.sort(factors[:, None] * np.stack([limits.lower[columns], limits.upper[columns]], axis=1), axis=1)
    low, high = ends.sum(axis=0)
    return float(low), float(high)


def _rivals(limits: LinearLimits, nearest: Float, row: int) -> Iterator[int]:
    """Yield the first other rows that share a value with a row and are active or violated."""
    rows = limits.rows
    touched = set(rows.columns[row][rows.coefficients[row] != 0].tolist())
    product, slack = rows.times(nearest), SLACK * (rows.size(nearest) + 1e-300)
    tight = np.flatnonzero((product <= rows.lower + slack) | (product >= rows.upper - slack))
    left = MAX_LISTED - 1
    for other in tight.tolist():
        used = rows.columns[other][rows.coefficients[other] != 0].tolist()
        if other != row and left and touched.intersection(used):
            left -= 1
            yield other


@ignore_floating_errors()  # a scale that overflows is checked as any other
def project(values: Float, limits: LinearLimits) -> tuple[Float | None, str]:
    """Move values to the nearest ones that keep the limits; distances are relative to the size of each value.

    Returns:
        The values, None if the limits cannot be satisfied; and a remark, empty if nothing was moved.
    """
    clipped = limits.clip(values)
    moved = int(np.count_nonzero((clipped != values) & ~np.isnan(values)))
    remark = (
        f"{count_noun(moved, 'start value')} outside the bounds {'was' if moved == 1 else 'were'} clipped."
        if moved
        else ""
    )
    size = _sizes(clipped)
    if limits.violation(clipped) <= FEASIBLE:
        return clipped, remark
    movable = np.flatnonzero(limits.movable)
    here = clipped[movable]
    narrow = limits.restricted_to(movable, clipped)
    solution = solve(Factor.of(np.diag(1 / size[movable])), np.zeros(here.size), here, narrow)
    there = clipped.copy()
    there[movable] = solution.apply_to(here, narrow)
    violations = limits.violations(there, limits.sizes(there))
    if not np.all(violations <= FEASIBLE):
        worst = np.argsort(-np.nan_to_num(violations, nan=np.inf), kind="stable")
        clauses = _describe_contradictions(limits, there, worst[~(violations[worst] <= FEASIBLE)])
        return None, f"The limits contradict the bounds, the locks or each other: {clauses}."
    return there, "The start violated its limits and was moved to the nearest values that satisfy them."


def missed_limits(values: Float, limits: LinearLimits) -> str:
    """Name the bounds and rows that values violate by more than rounding; empty if none."""
    rows = ~(limits.violations(values, limits.sizes(values)) <= FEASIBLE)
    names = [limits.rows.names[row] for row in np.flatnonzero(rows)[:MAX_LISTED]]
    beyond = int(np.count_nonzero((values < limits.lower) | (values > limits.upper)))
    return "; ".join([*names, *([f"bounds of {beyond} values"] if beyond else [])])


def infeasible(problem: Problem) -> list[Finding]:
    """Report bounds, locks and linear limits of a problem that contradict each other."""
    if not problem.pins and not problem.constraints:
        return []
    values = _plain_layout(problem)
    try:
        limits = linear_limits(problem, values)
    except InputError as error:
        return list(error.findings)
    moved, remark = project(values.pack(problem.parameters)[: values.free], limits)
    return [Finding("constraints", remark)] if moved is None else []


def movable(problem: Problem) -> int:
    """Return the number of free values that neither a lock nor equal bounds fix.

    Raises:
        InputError: a limit concerns a parameter that is not free.
    """
    return int(linear_limits(problem, _plain_layout(problem)).movable.sum())


def _plain_layout(problem: Problem) -> ValueLayout:
    """Return a layout of the free values alone; comparing limits needs no kernel."""
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
    """Return a typical size > 0 of each value."""
    known = np.abs(np.nan_to_num(values))
    typical = float(known.mean()) if known.size else 0.0
    sizes: Float = np.maximum(known, typical if typical > 0 else 1.0)
    return sizes
