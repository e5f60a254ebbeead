"""Breakpoints as values to be fitted: which axes move, and what they keep while they do."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.errors import Finding
from kennfeld.graph.free_axes import AxisKey, FreeAxis, free_axes
from kennfeld.graph.interpolation import cell_weights, position
from kennfeld.native import Values
from kennfeld.optimize.criterion import Pin
from kennfeld.parameters import Parameter, ParameterSet

__all__ = ["Order", "bounds_of", "fitted_axes", "left_behind", "order_of", "told"]

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


def bounds_of(axis: FreeAxis, parameters: ParameterSet, pins: Sequence[Pin] = ()) -> tuple[Float, Float]:
    """Lower and upper bounds of the breakpoints, equal for those that stay.

    The ends stay unless the axis has a range. So do breakpoints whose grid points are all locked, and those around a
    pin: the pin is an equality between values as long as these stand still.
    """
    points = axis.axis.breakpoints
    stays = np.zeros(points.size, dtype=bool)
    low, high = axis.axis.range or (points[0], points[-1])
    if axis.axis.range is None:
        stays[[0, -1]] = True
    for name, which in axis.places:
        table = parameters[name]
        stays |= np.moveaxis(table.locked, which, 0).reshape(points.size, -1).all(axis=1)
        for pin in pins:
            if pin.parameter == name and len(pin.at) > which:
                stays |= _around(table, which, pin.at[which])
    return np.where(stays, points, low), np.where(stays, points, high)


def _around(table: Parameter, which: int, x: float) -> Bool:
    """The breakpoints that a lookup at x touches."""
    axis = table.axes[which]
    weights, _ = cell_weights(position(np.array([x]), axis.breakpoints, table.extrapolation), len(axis))
    return np.asarray(weights[0] != 0)


@dataclass(frozen=True)
class Order:
    """Neighbouring breakpoints keep their order and distance: `lower <= coefficients . values[columns] <= upper`.

    `names` say in words what each row keeps.
    """

    columns: Int  # Int[rows, 2]
    coefficients: Float  # Float[rows, 2]
    lower: Float  # Float[rows]
    upper: Float  # Float[rows]
    names: tuple[str, ...] = ()

    def kept(self, values: Float) -> bool:
        """Whether these values keep it, up to rounding."""
        distances = np.einsum("ij,ij->i", self.coefficients, values[self.columns])
        return bool(np.all(distances >= self.lower * (1 - TOUCHING)))


def order_of(axes: Mapping[AxisKey, FreeAxis], values: Values) -> Order:
    """The order of the breakpoints of all axes, as rows over the free values."""
    columns, lower, names = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0)], []
    for key, axis in axes.items():
        at = values.moving.get(key, values.free)
        if at >= values.free:
            continue
        gaps = np.arange(len(axis.axis) - 1)
        columns.append(at + np.stack([gaps, gaps + 1], axis=1))
        lower.append(np.full(gaps.size, axis.axis.least_distance))
        names += [f"distance of breakpoints {i + 1} and {i + 2} of {key}" for i in gaps]
    together = np.concatenate(columns)
    return Order(
        together,
        np.broadcast_to([-1.0, 1.0], together.shape),
        np.concatenate(lower),
        np.full(len(together), np.inf),
        tuple(names),
    )


def told(axes: Mapping[AxisKey, FreeAxis], moved: Mapping[AxisKey, Float]) -> str:
    """Sentences on breakpoints that ended as close as they may: fewer would do as well."""
    parts = []
    for key, points in moved.items():
        axis = axes[key].axis
        gaps, least = np.diff(points), axis.least_distance
        close = np.flatnonzero(gaps <= least + TOUCHING * gaps.mean())
        if close.size and (gaps != np.diff(axis.breakpoints)).any():
            pairs = ", ".join(f"{points[i]:g} and {points[i + 1]:g}" for i in close[:5])
            parts.append(f"Breakpoints of {key} ended at their least distance: {pairs}; fewer may do.")
    return " ".join(parts)
