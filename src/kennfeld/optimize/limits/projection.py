"""Projection of a start onto its limits, and the description of limits that contradict each other."""

import numpy as np

from kennfeld.base.arrays import Bool, Float, ignore_floating_errors
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import count_noun
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.native.cholesky import Factor
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.validation import check_linear_limits
from kennfeld.optimize.solver.linear_constraints import LinearLimits
from kennfeld.optimize.solver.quadratic_program import QuadraticProgram

MAX_LISTED = 3
UNMOVED = 1e-6  # of a push: what is left of it where limits determine a value
SLACK = 1e-9  # of the size of a limit: a row this close to its side is active
FEASIBLE = 1e-9  # of the limits' scale


@ignore_floating_errors()  # a scale that overflows is checked as any other
def project(values: Float, limits: LinearLimits) -> tuple[Float | None, str]:
    """Move values, Float[values], to the nearest that keep the limits; distances are relative to the size of each.

    Returns:
        The values, None if the limits cannot be satisfied; and a remark, empty if nothing was moved.
    """
    clipped = limits.clip(values)
    count = int(np.count_nonzero((clipped != values) & ~np.isnan(values)))
    if not limits.rows.lower.size or limits.violation(clipped) <= FEASIBLE:
        verb = "was" if count == 1 else "were"
        return clipped, f"{count_noun(count, 'start value')} outside the bounds {verb} clipped." if count else ""
    movable = np.flatnonzero(limits.movable)
    here = clipped[movable]
    known = np.abs(np.nan_to_num(clipped))
    # a value near 0 may move as far as others of a typical size
    size = np.maximum(known, float(known.mean()) or 1.0)[movable]
    narrow = limits.restricted_to(movable, clipped)
    # min d'H d with H = diag(1 / size^2), whose factor is diag(1 / size); without limits, d is 0
    solution = QuadraticProgram(narrow).solve(Factor.of(np.diag(1 / size)), np.zeros(here.size), here)
    there = clipped.copy()
    there[movable] = solution.apply_to(here, narrow)
    violations = limits.violations(there, limits.sizes(there))
    if not np.all(violations <= FEASIBLE):
        worst = np.argsort(-np.nan_to_num(violations, nan=np.inf), kind="stable")
        violated = worst[~(violations[worst] <= FEASIBLE)][:MAX_LISTED]
        clauses = "; ".join(_describe_contradiction(limits, there, row) for row in violated.tolist())
        return None, f"The limits contradict the bounds, the locks or each other: {clauses}."
    return there, "The start violated its limits and was moved to the nearest values that satisfy them."


def leaves_room(values: Float, limits: LinearLimits, which: Bool) -> bool:
    """Return True if the limits let any of some values move.

    They do unless the nearest points to values pushed in two opposite directions are the values themselves: both
    directions are then combinations of the limits' gradients.

    Args:
        values: values that keep the limits, Float[values].
        limits: bounds and linear rows.
        which: marks the values that are pushed, each by another share of its size.
    """
    movable = np.flatnonzero(limits.movable)
    here, pushed = values[movable], which[movable]
    if not pushed.any():
        return False
    size = np.maximum(np.abs(here), float(np.abs(here).mean()) or 1.0)
    # different for each value, by the golden ratio: equal pushes may cancel in a row that leaves room
    shares = 1 + np.modf(np.arange(1, here.size + 1) * 0.618034)[0]
    narrow = limits.restricted_to(movable, values)
    program, factor = QuadraticProgram(narrow), Factor.of(np.diag(1 / size))
    for sign in (1.0, -1.0):
        step = np.where(pushed, sign * shares * size, 0.0)
        movement = program.solve(factor, step, here).apply_to(here, narrow) - here
        if np.any(np.abs(movement[pushed]) > UNMOVED * size[pushed]):
            return True
    return False


def _describe_contradiction(limits: LinearLimits, nearest: Float, row: int) -> str:
    """Return a clause such as "pin of C at 0 must be 3, but ..." on a row that the `nearest` values violate."""
    rows = limits.rows
    used = rows.coefficients[row] != 0
    factors, columns = rows.coefficients[row][used], rows.columns[row][used]
    # the range of the row within the bounds of its values
    ends = np.sort(factors[:, None] * np.stack([limits.lower[columns], limits.upper[columns]], axis=1), axis=1)
    low, high = ends.sum(axis=0).tolist()
    slack = SLACK * max(abs(side) for side in (low, high, rows.lower[row], rows.upper[row], 1.0) if np.isfinite(side))
    if rows.lower[row] > high + slack or rows.upper[row] < low - slack:
        against = f"bounds and locks {'fix' if low == high else 'keep'} it {_range_text(low, high, 'at ')}"
    else:
        others = [f"{rows.names[other]} ({_required(limits, other)})" for other in _rivals(limits, nearest, row)]
        against = f"that contradicts {' and '.join(others)}" if others else "other limits prevent that"
    return f"{rows.names[row]} {_required(limits, row)}, but {against}"


def _required(limits: LinearLimits, row: int) -> str:
    return f"must be {_range_text(limits.rows.lower[row], limits.rows.upper[row])}"


def _range_text(low: float, high: float, at: str = "") -> str:
    if low == high:
        return f"{at}{low:g}"
    if np.isinf(high):
        return f">= {low:g}"
    return f"<= {high:g}" if np.isinf(low) else f"between {low:g} and {high:g}"


def _rivals(limits: LinearLimits, nearest: Float, row: int) -> list[int]:
    """Return the first other rows that share a value with a row and are active or violated."""
    rows = limits.rows
    touched = rows.columns[row][rows.coefficients[row] != 0]
    # rows that are far from their sides do not stand in the way
    product, slack = rows.times(nearest), SLACK * (rows.size(nearest) + 1e-300)
    tight = (product <= rows.lower + slack) | (product >= rows.upper - slack)
    sharing = (np.isin(rows.columns, touched) & (rows.coefficients != 0)).any(axis=1)
    others = np.flatnonzero(tight & sharing)
    return list(others[others != row][: MAX_LISTED - 1])


def missed_limits(values: Float, limits: LinearLimits) -> str:
    """Name the bounds and rows that values, Float[values], violate by more than rounding; empty if none."""
    rows = ~(limits.violations(values, limits.sizes(values)) <= FEASIBLE)
    names = [limits.rows.names[row] for row in np.flatnonzero(rows)[:MAX_LISTED]]
    beyond = int(np.count_nonzero((values < limits.lower) | (values > limits.upper)))
    return "; ".join([*names, *([f"bounds of {beyond} values"] if beyond else [])])


def infeasible(problem: Problem) -> list[Finding]:
    """Report bounds, locks and linear limits of a problem that contradict each other."""
    if not problem.pins and not problem.constraints:
        return []
    findings = list(check_linear_limits(problem))
    if findings:
        return findings
    values = _plain_layout(problem)
    limits = linear_limits(problem, values)
    nearest, remark = project(values.pack(problem.parameters)[: values.free], limits)
    return [Finding(Location("constraints"), remark)] if nearest is None else []


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
