"""Bounds and linear rows over the free values: locks, pins, shapes, equalities, and the order of breakpoints."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import Findings
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.constraints import Equality, Pin, Shape, Term
from kennfeld.domain.free_axes import AxisKey, FreeAxis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.table_parts import grid_points_within
from kennfeld.graph.interpolation import cell_weights, position, table_weights
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.optimize.problem.problem import Place, Problem, moving_axis
from kennfeld.optimize.problem.validation import check_linear_limits
from kennfeld.optimize.solver.linear_constraints import LinearLimits, LinearRows

TOUCHING = 1e-6  # of the mean distance: tolerance within which breakpoints are at their minimum distance


def breakpoint_bounds(axis: FreeAxis, parameters: ParameterSet, fixed: Sequence[Place] = ()) -> tuple[Float, Float]:
    """Return lower and upper bounds of the breakpoints of an axis, Float[breakpoints] each, equal if fixed.

    The ends are fixed unless the axis has a range. So are breakpoints whose grid points are all locked, and those
    around places `fixed` by a pin, which is linear only if they do not move.
    """
    points = axis.axis.breakpoints
    stays = np.zeros(points.size, dtype=bool)
    low, high = axis.axis.range or (points[0], points[-1])
    if axis.axis.range is None:
        stays[[0, -1]] = True
    for name, which in axis.places:
        table = parameters[name]
        # moving the breakpoint would move a line of values that must stay
        stays |= np.moveaxis(table.locked, which, 0).reshape(points.size, -1).all(axis=1)
        for place, at in fixed:
            if place == name and len(at) > which:
                stays |= _weights(table, which, at[which]) != 0
    return np.where(stays, points, low), np.where(stays, points, high)


def _weights(table: Parameter, which: int, x: float) -> Float:
    """Return the weight of each breakpoint of an axis in a lookup at x."""
    axis = table.index_axes[which]
    weights, _ = cell_weights(position(np.array([x]), axis.breakpoints, table.extrapolation), len(axis))
    return weights.ravel()


def breakpoint_order(axes: Mapping[AxisKey, FreeAxis], values: ValueLayout) -> LinearRows:
    """Return rows for the order and the minimum distance of neighbouring breakpoints of all axes."""
    parts = []
    for key, axis in axes.items():
        at = values.moving.get(key, values.free)
        if at < values.free:
            gaps = np.arange(len(axis.axis) - 1)
            columns = at + np.stack([gaps, gaps + 1], axis=1)
            names = tuple(f"distance of breakpoints {i + 1} and {i + 2} of {key}" for i in gaps)
            parts.append(_even_rows(columns, [-1.0, 1.0], axis.axis.least_distance, np.inf, names))
    return LinearRows.together(parts)


def _even_rows(
    columns: Int, coefficients: Sequence[float], lower: float, upper: float, names: tuple[str, ...]
) -> LinearRows:
    low, high = (np.full(len(columns), side) for side in (lower, upper))
    return LinearRows(columns, np.broadcast_to(coefficients, columns.shape), low, high, names)


def is_ordered(order: LinearRows, values: Float) -> bool:
    """Return True if the breakpoints among values, Float[values], are in order; rounding is allowed."""
    return order.count == 0 or bool(np.all(order.times(values) >= 0.5 * order.lower))


def touching_pairs(points: Float, least: float) -> Int:
    """Find the indices, Int[pairs], of breakpoints, Float[breakpoints], at the minimum distance from the next one."""
    gaps = np.diff(points)
    return np.flatnonzero(gaps <= least + TOUCHING * gaps.mean())


def linear_limits(problem: Problem, values: ValueLayout) -> LinearLimits:
    """Return bounds, locks, shapes, pins and equalities of the free values, within the range of storage.

    Args:
        problem: with its constraints.
        values: layout of the free values.

    Raises:
        InputError: a constraint concerns a parameter that is not free.
    """
    lower, upper = np.full(values.free, -np.inf), np.full(values.free, np.inf)
    tables, rounding = np.zeros(values.free, dtype=np.int64), problem.rounding
    for table, name in enumerate(problem.free_names):
        parameter, at = problem.parameters[name], values.offsets[name]
        part = slice(at, at + parameter.size)
        tables[part] = table
        locked = parameter.locked.ravel()
        low, high = (parameter.lower, parameter.upper) if rounding is None else rounding.bounds(parameter)
        # a lock is a pair of equal bounds
        lower[part] = np.where(locked, parameter.values.ravel(), low.ravel())
        upper[part] = np.where(locked, parameter.values.ravel(), high.ravel())
    for table, (key, axis) in enumerate(problem.free_axes.items(), len(problem.free_names)):
        part = slice(values.moving[key], values.moving[key] + len(axis.axis))
        tables[part] = table
        lower[part], upper[part] = breakpoint_bounds(axis, problem.parameters, problem.held)
    Findings(check_linear_limits(problem)).finish()
    rows = [
        _equality(problem, values, Equality([Term(p.parameter, p.at)], p.value), _pin_name(p)) for p in problem.pins
    ]
    for constraint in problem.constraints:
        if isinstance(constraint, Shape):
            rows.append(_shape(problem, values, constraint))
        else:
            rows.append(_equality(problem, values, constraint, f"equality {constraint}"))
    rows.append(breakpoint_order(problem.free_axes, values))
    return LinearLimits(lower, upper, LinearRows.together(rows), tables)


def _pin_name(pin: Pin) -> str:
    at = ", ".join(f"{AXIS_LETTERS[i]} = {x:g}" for i, x in enumerate(pin.at))
    return f"pin of {pin.parameter} at {at}" if at else f"pin of {pin.parameter}"


def _equality(problem: Problem, values: ValueLayout, equality: Equality, name: str) -> LinearRows:
    row = np.zeros(values.free)
    for term in equality.terms:
        columns, weights = grid_points(problem.parameters[term.parameter], term.at)
        # terms may share grid points
        np.add.at(row, columns + values.offsets[term.parameter], term.factor * weights)
    side = np.array([equality.value])
    return LinearRows.of(row[None], side, side, [name])


def _shape(problem: Problem, values: ValueLayout, shape: Shape) -> LinearRows:
    parameter = problem.parameters[shape.parameter]
    points, coefficients, steps = _differences(parameter, shape)
    columns = points + values.offsets[shape.parameter]
    names = tuple(_row_names(parameter, shape, points))
    key = moving_axis(problem, shape)
    if key is None:
        lower, upper = (np.full(len(columns), side) for side in (shape.lower, shape.upper))
        return LinearRows(columns, coefficients, lower, upper, names)
    # lower (x2 - x1) <= z2 - z1 <= upper (x2 - x1) is linear in values z and moving breakpoints x together
    moving = steps + values.moving[key]
    columns, parts = np.column_stack([columns, moving, moving + 1]), []
    for side, (low, high) in ((shape.lower, (0.0, np.inf)), (shape.upper, (-np.inf, 0.0))):
        if np.isfinite(side):
            parts.append(_even_rows(columns, [-1.0, 1.0, side, -side], low, high, names))
    return LinearRows.together(parts)


def _differences(parameter: Parameter, shape: Shape) -> tuple[Int, Float, Int]:
    """Return grid points Int[rows, points] of differences along an axis, coefficients [rows, points], and steps.

    A step, Int[rows], is the number of the first breakpoint of a row along the axis.
    A slope is (z2 - z1) / (x2 - x1), a curvature the change of the slope over the mean of the two distances.
    """
    x = parameter.index_axes[shape.axis].breakpoints
    gaps = np.diff(x)
    slopes = np.stack([-1 / gaps, 1 / gaps], axis=1)
    if shape.kind == "slope":
        coefficients = slopes
    else:
        between = 2 / (x[2:] - x[:-2])
        left, right = slopes[:-1] * between[:, None], slopes[1:] * between[:, None]
        # (right slope - left slope) * 2 / (x3 - x1), by the values at the three points
        coefficients = np.stack([-left[:, 0], right[:, 0] - left[:, 1], right[:, 1]], axis=1)
    steps, width = coefficients.shape
    points = np.arange(parameter.size).reshape(parameter.values.shape)
    lines = np.moveaxis(points, shape.axis, 0).reshape(x.size, -1)
    rows = np.stack([lines[i : steps + i] for i in range(width)], axis=-1).reshape(-1, width)
    kept = grid_points_within(parameter, shape.where).ravel()[rows].all(axis=1)
    of_rows = np.repeat(np.arange(steps), lines.shape[1])[kept]
    return rows[kept], coefficients[of_rows], of_rows


def _row_names(parameter: Parameter, shape: Shape, points: Int) -> Iterator[str]:
    """Yield the label of each row: `slope of MapX along x between 1000 and 1500 at y = 20`."""
    axes = parameter.index_axes
    for first, *_, last in points:
        begin, end = (np.unravel_index(at, parameter.values.shape)[shape.axis] for at in (first, last))
        x = axes[shape.axis].breakpoints
        others = [
            f"{AXIS_LETTERS[i]} = {axes[i].breakpoints[j]:g}"
            for i, j in enumerate(np.unravel_index(first, parameter.values.shape))
            if i != shape.axis
        ]
        where = f" at {', '.join(others)}" if others else ""
        direction = AXIS_LETTERS[shape.axis]
        yield f"{shape.kind} of {parameter.name} along {direction} between {x[begin]:g} and {x[end]:g}{where}"


def grid_points(parameter: Parameter, at: tuple[float, ...] | None) -> tuple[Int, Float]:
    """Find flat grid points around a coordinate and their weights, Int[points] and Float[points]; all if it is None."""
    if at is None:
        return np.arange(parameter.size), np.ones(parameter.size)
    sides = [_weights(parameter, which, x)[None] for which, x in enumerate(at)]
    weights = table_weights(sides, parameter.values.shape)[0]
    columns = np.flatnonzero(weights)
    return columns, weights[columns]
