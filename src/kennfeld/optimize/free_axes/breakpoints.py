"""Breakpoints as values to be fitted: which axes move, and what they keep while they do."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.errors import Finding
from kennfeld.graph.free_axes import AxisKey, FreeAxis, free_axes
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.native import Values
from kennfeld.optimize.limits.limits import Rows
from kennfeld.parameters import Parameter, ParameterSet

__all__ = [
    "Place",
    "bounds_of",
    "fitted_axes",
    "left_behind",
    "order_of",
    "rising",
    "slopes_along",
    "told",
    "touching_pairs",
]

Place = tuple[str, tuple[float, ...]]  # a parameter, and coordinates in it
TOUCHING = 1e-6  # of the mean distance, within which two breakpoints stand at their least distance


def fitted_axes(parameters: ParameterSet, free: Collection[str]) -> dict[AxisKey, FreeAxis]:
    """The axes marked as free on which a free parameter lies."""
    axes = free_axes(parameters)
    return {key: axis for key, axis in axes.items() if any(name in free for name, _ in axis.places)}


def left_behind(axes: Mapping[AxisKey, FreeAxis], free: Collection[str]) -> list[Finding]:
    """Tables that would change with an axis although they are not fitted."""
    findings = []
    for key, axis in axes.items():
        others = list(dict.fromkeys(name for name, _ in axis.places if name not in free))
        if others:
            names = ", ".join(others[:5]) + (", ..." if len(others) > 5 else "")
            what = f"its breakpoints are free, but {names} on it {'is' if len(others) == 1 else 'are'} not fitted"
            mend = "Such a table would change with the axis: fit it as well, or give it an axis of its own."
            findings.append(Finding(f"axis {key}", what, mend))
    return findings


def bounds_of(axis: FreeAxis, parameters: ParameterSet, held: Sequence[Place] = ()) -> tuple[Float, Float]:
    """Lower and upper bounds of the breakpoints, equal for those that stay.

    The ends stay unless the axis has a range. So do breakpoints whose grid points are all locked, and those around the
    places `held` by a pin: it is an equality between values as long as these stand still.
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
    """The breakpoints that a lookup at x touches."""
    axis = table.axes[which]
    weights, _ = cell_weights(position(np.array([x]), axis.breakpoints, table.extrapolation), len(axis))
    return np.asarray(weights[0] != 0)


def order_of(axes: Mapping[AxisKey, FreeAxis], values: Values) -> Rows:
    """Limits that keep the order and the distance of neighbouring breakpoints of all axes."""
    parts = []
    for key, axis in axes.items():
        at = values.moving.get(key, values.free)
        if at < values.free:
            gaps = np.arange(len(axis.axis) - 1)
            columns = at + np.stack([gaps, gaps + 1], axis=1)
            names = tuple(f"distance of breakpoints {i + 1} and {i + 2} of {key}" for i in gaps)
            lower, upper = (np.full(gaps.size, side) for side in (axis.axis.least_distance, np.inf))
            parts.append(Rows(columns, np.broadcast_to([-1.0, 1.0], columns.shape), lower, upper, names))
    return Rows.together(parts)


def slopes_along(values: Int, points: Int, sides: tuple[float, float], names: tuple[str, ...]) -> Rows:
    """Limits of the slope between neighbours whose breakpoints move: `lower (x2 - x1) <= z2 - z1 <= upper (x2 - x1)`.

    Linear in values and breakpoints together. `values` and `points` are the columns of z1, z2 and of x1, x2, both
    Int[rows, 2].
    """
    columns, parts = np.hstack([values, points]), []
    nothing = np.zeros(len(columns))
    for side, (low, high) in zip(sides, ((0.0, np.inf), (-np.inf, 0.0)), strict=True):
        if np.isfinite(side):
            coefficients = np.broadcast_to([-1.0, 1.0, side, -side], columns.shape)
            parts.append(Rows(columns, coefficients, nothing + low, nothing + high, names))
    return Rows.together(parts)


def rising(order: Rows, values: Float) -> bool:
    """Whether breakpoints stand in their order, whatever rounding does to their distance."""
    return order.count == 0 or bool(np.all(order.times(values) >= 0.5 * order.lower))


def touching_pairs(points: Float, least: float) -> Int:
    """The breakpoints that stand as close to the next one as they may, by number."""
    gaps = np.diff(points)
    return np.flatnonzero(gaps <= least + TOUCHING * gaps.mean())


def told(axes: Mapping[AxisKey, FreeAxis], parameters: ParameterSet) -> str:
    """Sentences on breakpoints that ended as close as they may: fewer would do as well."""
    parts = []
    for key, before in axes.items():
        table, which = before.places[0]
        points, least = parameters[table].axes[which].breakpoints, before.axis.least_distance
        close = touching_pairs(points, least)
        if close.size and not np.array_equal(points, before.axis.breakpoints):
            pairs = ", ".join(f"{points[i]:g} and {points[i + 1]:g}" for i in close[:5])
            parts.append(f"Breakpoints of {key} ended at their least distance: {pairs}; fewer may do.")
    return " ".join(parts)
