"""Breakpoints of axes: counted in steps, listed, or found from other curves, and in rising order."""

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.a2l.cursor import UnusableError
from kennfeld.calfiles.a2l.objects import AxisDescr
from kennfeld.parameters import Axis

__all__ = ["fixed_count", "fixed_points", "resolved", "rising", "spaced"]


def fixed_count(axis: AxisDescr) -> int:
    """How many breakpoints a fixed axis states, 0 where it states none."""
    if axis.fix_axis_par is not None:
        return axis.fix_axis_par[2]
    if axis.fix_axis_par_dist is not None:
        return axis.fix_axis_par_dist[2]
    return len(axis.fix_axis_par_list)


def fixed_points(axis: AxisDescr, count: int) -> Float:
    """The raw numbers of the first breakpoints of a fixed axis."""
    if axis.fix_axis_par is not None:
        offset, shift, _ = axis.fix_axis_par
        return spaced(offset, 2.0**shift, count)
    if axis.fix_axis_par_dist is not None:
        offset, distance, _ = axis.fix_axis_par_dist
        return spaced(offset, distance, count)
    if not axis.fix_axis_par_list:
        raise UnusableError(f"has a {axis.attribute} without breakpoints")
    return np.array(axis.fix_axis_par_list[:count])


def spaced(offset: float, distance: float, count: int) -> Float:
    """Numbers at equal distances."""
    points: Float = offset + distance * np.arange(count, dtype=np.float64)
    return points


def rising(points: Float) -> tuple[Float, bool]:
    """Breakpoints in rising order, and whether they fell; `UnusableError` where they do neither."""
    if not np.all(np.isfinite(points)):
        raise UnusableError("has breakpoints that have no physical value")
    steps = np.diff(points)
    if np.all(steps > 0):
        return points, False
    if np.all(steps < 0):
        return points[::-1], True
    at = int(np.flatnonzero((steps <= 0) if steps[0] > 0 else (steps >= 0))[0]) if steps[0] else 0
    raise UnusableError(
        f"has breakpoints that neither rise nor fall: number {at + 1} is {points[at]:g}, "
        f"number {at + 2} is {points[at + 1]:g}"
    )


def resolved(inputs: Float, positions: Float, count: int, name: str, unit: str, quantity: str) -> Axis:
    """The inputs of the columns 0, 1, ...: the same lookup only where every pair is a column."""
    if not np.array_equal(positions, np.arange(count)) or np.any(np.diff(inputs) <= 0):
        raise UnusableError(f"has breakpoints that do not follow from the positions of {name}")
    return Axis(inputs, input=quantity, unit=unit)
