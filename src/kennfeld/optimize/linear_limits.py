"""Bounds and linear rows over the free values: locks, pins, shapes, equalities, and the order of breakpoints."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.constraints import Equality, Pin, Shape, Term
from kennfeld.errors import Finding, InputError
from kennfeld.free_axes import AxisKey, FreeAxis, key_of
from kennfeld.graph.interpolation import cell_weights, position, table_weights
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.optimize.problem import Place, Problem
from kennfeld.optimize.solver.linear_constraints import LinearLimits, LinearRows
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter

TOUCHING = 1e-6  # of the mean distance: tolerance within which breakpoints are at their minimum distance
DIRECTIONS = "xyzw"


def breakpoint_bounds(axis: FreeAxis, parameters: ParameterSet, held: Sequence[Place] = ()) -> tuple[Float, Float]:
    """Return lower and upper bounds of the breakpoints of an axis, equal for those that are fixed.

    The ends are fixed unless the axis has a range. So are breakpoints whose grid points are all locked, and those
    around places `held` by a pin, which is linear only if they do not move.
    """
    points = axis.axis.breakpoints
    stays = np.zeros(points.size, dtype=bool)
    low, high = axis.axis.range or (points[0], points[-1])
    if axis.axis.range is None:
        stays[[0, -1]] = True
    for name, which in axis.places:
        table = parameters[name]
        stays |= np.moveaxis(table.locked, which, 0).reshape(points.size, -1).all(axis=1)
        for place, at in held:
            if place == name and len(at) > which:
                stays |= _around(table, which, at[which])
    return np.where(stays, points, low), np.where(stays, points, high)


def _around(table: Parameter, which: int, x: float) -> Bool:
    """Mark the breakpoints that a lookup at x uses."""
    axis = table.axes[which]
    weights, _ = cell_weights(position(np.array([x]), axis.breakpoints, table.extrapolation), len(axis))
    return np.asarray(weights[0] != 0)


def breakpoint_order(axes: Mapping[AxisKey, FreeAxis], values: ValueLayout) -> LinearRows:
    """Return rows for the order and the minimum distance of neighbouring breakpoints of all axes."""
    parts = []
    for key, axis in axes.items():
        at = values.moving.get(key, values.free)
        if at < values.free:
            gaps = np.arange(len(axis.axis) - 1)
            columns = at + np.stack([gaps, gaps + 1], axis=1)
            names = tuple(f"distance of breakpoints {i + 1} and {i + 2} of {key}" for i in gaps)
            lower, upper = (np.full(gaps.size, side) for side in (axis.axis.least_distance, np.inf))
            parts.append(LinearRows(columns, np.broadcast_to([-1.0, 1.0], columns.shape), lower, upper, names))
    return LinearRows.together(parts)


def slopes_along(values: Int, points: Int, sides: tuple[float, float], names: tuple[str, ...]) -> LinearRows:
    """Return rows for slopes over moving breakpoints: `lower (x2 - x1) <= z2 - z1 <= upper (x2 - x1)`.

    Linear in values and breakpoints together. `values` and `points` are the columns of z1, z2 and of x1, x2, both
    Int[rows, 2].
    """
    columns, parts = np.hstack([values, points]), []
    zeros = np.zeros(len(columns))
    for side, (low, high) in zip(sides, ((0.0, np.inf), (-np.inf, 0.0)), strict=True):
        if np.isfinite(side):
            coefficients = np.broadcast_to([-1.0, 1.0, side, -side], columns.shape)
            parts.append(LinearRows(columns, coefficients, zeros + low, zeros + high, names))
    return LinearRows.together(parts)


def is_ordered(order: LinearRows, values: Float) -> bool:
    """Return True if breakpoints are in order; rounding of their distance is allowed."""
    return order.count == 0 or bool(np.all(order.times(values) >= 0.5 * order.lower))


def touching_pairs(points: Float, least: float) -> Int:
    """Return the indices of breakpoints that are at the minimum distance from the next one."""
    gaps = np.diff(points)
    return np.flatnonzero(gaps <= least + TOUCHING * gaps.mean())


def linear_limits(problem: Problem, values: ValueLayout) -> LinearLimits:
    """Return bounds, locks, shapes, pins and equalities of the free values.

    Args:
        problem: with its constraints.
        values: layout of the free values.

    Raises:
        InputError: a constraint concerns a parameter that is not free.
    """
    lower, upper = np.full(values.free, -np.inf), np.full(values.free, np.inf)
    tables = np.zeros(values.free, dtype=np.int64)
    for table, name in enumerate(problem.free_names):
        parameter, at = problem.parameters[name], values.offsets[name]
        part = slice(at, at + parameter.size)
        tables[part] = table
        held = parameter.locked.ravel()
        lower[part] = np.where(held, parameter.values.ravel(), parameter.lower.ravel())
        upper[part] = np.where(held, parameter.values.ravel(), parameter.upper.ravel())
    for table, (key, axis) in enumerate(problem.free_axes.items(), len(problem.free_names)):
        part = slice(values.moving[key], values.moving[key] + len(axis.axis))
        tables[part] = table
        lower[part], upper[part] = breakpoint_bounds(axis, problem.parameters, problem.held)
    findings = list(_findings(problem))
    if findings:
        raise InputError(findings)
    writer = _RowBuilder(problem, values)
    order = breakpoint_order(problem.free_axes, values)
    return LinearLimits(lower, upper, LinearRows.together([writer.pins(), *writer.constraints(), order]), tables)


def _findings(problem: Problem) -> Iterator[Finding]:
    """Report pins, shapes and equalities that cannot be used."""
    for pin in problem.pins:
        yield from _check_term(problem, f"pin of {pin.parameter}", Term(pin.parameter, pin.at))
    for constraint in problem.constraints:
        if isinstance(constraint, Shape):
            message = f"{constraint.kind} of {constraint.parameter}"
            yield from _check_term(problem, message, Term(constraint.parameter))
            if constraint.parameter in problem.parameters:
                yield from _check_curvature(problem, message, constraint)
                axes = len(problem.parameters[constraint.parameter].index_axes)
                if not 0 <= constraint.axis < axes:
                    yield Finding(message, f"axis {constraint.axis} does not exist, the parameter has {axes} axes")
        else:
            for term in constraint.terms:
                yield from _check_term(problem, f"equality {constraint}", term)


def _check_term(problem: Problem, message: str, term: Term) -> Iterator[Finding]:
    if term.parameter not in problem.free_names:
        yield Finding(message, f"{term.parameter} is not free", "Free it, or remove the limit.")
    elif term.at is not None:
        axes = problem.parameters[term.parameter].index_axes
        if len(term.at) != len(axes):
            yield Finding(message, f"{list(term.at)} has {len(term.at)} coordinates for {len(axes)} axes")


def _check_curvature(problem: Problem, message: str, shape: Shape) -> Iterator[Finding]:
    """Report limits of the curvature over free breakpoints, which are not linear."""
    if shape.kind == "curvature" and _moving(problem, shape) is not None:
        yield Finding(message, "the breakpoints along this axis are free", "Fix them, or remove the limit.")


def _moving(problem: Problem, shape: Shape) -> AxisKey | None:
    """Return the axis of a shape if its breakpoints are fitted."""
    table = problem.parameters[shape.parameter]
    if not 0 <= shape.axis < len(table.axes):
        return None
    key = key_of(table, shape.axis)
    return key if key in problem.free_axes else None


class _RowBuilder:
    """Builds rows over the free values."""

    def __init__(self, problem: Problem, values: ValueLayout) -> None:
        self.problem, self.values = problem, values

    def pins(self) -> LinearRows:
        """Return pins as equalities."""
        pins = [(_pin_name(pin), Term(pin.parameter, pin.at), pin.value) for pin in self.problem.pins]
        return LinearRows.together([self._equality(Equality([term], value), name) for name, term, value in pins])

    def constraints(self) -> Iterator[LinearRows]:
        """Yield shapes and equalities in their order."""
        for constraint in self.problem.constraints:
            if isinstance(constraint, Shape):
                yield self._shape(constraint)
            else:
                yield self._equality(constraint, f"equality {constraint}")

    def _equality(self, equality: Equality, name: str) -> LinearRows:
        row = np.zeros(self.values.free)
        for term in equality.terms:
            columns, weights = grid_points(self.problem.parameters[term.parameter], term.at)
            np.add.at(row, columns + self.values.offsets[term.parameter], term.factor * weights)
        side = np.array([equality.value])
        return LinearRows.of(row[None], side, side, [name])

    def _shape(self, shape: Shape) -> LinearRows:
        parameter = self.problem.parameters[shape.parameter]
        points, coefficients = _differences(parameter, shape)
        columns = points.reshape(-1, points.shape[-1]) + self.values.offsets[shape.parameter]
        names = tuple(_places(parameter, shape, points))
        key = _moving(self.problem, shape)
        if key is not None:
            steps = np.repeat(np.arange(len(points)), points.shape[1]) + self.values.moving[key]
            return slopes_along(columns, np.stack([steps, steps + 1], axis=1), (shape.lower, shape.upper), names)
        lower, upper = (np.full(len(columns), side) for side in (shape.lower, shape.upper))
        return LinearRows(columns, np.repeat(coefficients, points.shape[1], axis=0), lower, upper, names)


def _pin_name(pin: Pin) -> str:
    at = ", ".join(f"{DIRECTIONS[i]} = {x:g}" for i, x in enumerate(pin.at))
    return f"pin of {pin.parameter} at {at}" if at else f"pin of {pin.parameter}"


def _differences(parameter: Parameter, shape: Shape) -> tuple[Int, Float]:
    """Return grid points Int[steps, lines, points] of differences along an axis, and coefficients [steps, points].

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
        coefficients = np.stack([-left[:, 0], right[:, 0] - left[:, 1], right[:, 1]], axis=1)
    steps, width = coefficients.shape
    points = np.arange(parameter.size).reshape(parameter.values.shape)
    lines = np.moveaxis(points, shape.axis, 0).reshape(x.size, -1)
    return np.stack([lines[i : steps + i] for i in range(width)], axis=-1), coefficients


def _places(parameter: Parameter, shape: Shape, points: Int) -> Iterator[str]:
    """Yield the label of each row: `slope of MapX along x between 1000 and 1500 at y = 20`."""
    axes = parameter.index_axes
    for first, *_, last in points.reshape(-1, points.shape[-1]):
        begin, end = (np.unravel_index(at, parameter.values.shape)[shape.axis] for at in (first, last))
        x = axes[shape.axis].breakpoints
        others = [
            f"{DIRECTIONS[i]} = {axes[i].breakpoints[j]:g}"
            for i, j in enumerate(np.unravel_index(first, parameter.values.shape))
            if i != shape.axis
        ]
        where = f" at {', '.join(others)}" if others else ""
        direction = DIRECTIONS[shape.axis]
        yield f"{shape.kind} of {parameter.name} along {direction} between {x[begin]:g} and {x[end]:g}{where}"


def grid_points(parameter: Parameter, at: tuple[float, ...] | None) -> tuple[Int, Float]:
    """Return flat grid points around a coordinate and their weights; all grid points if it is None."""
    if at is None:
        return np.arange(parameter.size), np.ones(parameter.size)
    sides = [
        cell_weights(position(np.array([x]), axis.breakpoints, parameter.extrapolation), len(axis))[0]
        for x, axis in zip(at, parameter.index_axes, strict=True)
    ]
    weights = table_weights(sides, parameter.values.shape)[0]
    columns = np.flatnonzero(weights)
    return columns, weights[columns]
