"""Parts of a table: the grid points within ranges of axis values."""

from collections.abc import Mapping

import numpy as np

from kennfeld.base.arrays import Bool
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.breakpoint_rounding import SAME
from kennfeld.domain.parameters import Parameter

_CELL = 1e-3  # share of the narrowest cell up to which a difference counts as rounding
Range = Mapping[str, tuple[float, float]]  # by direction, both ends included


def missing_directions(table: Parameter, part: Range) -> list[str]:
    """Return the directions of a range that the table does not have; those of a value block count positions."""
    known = AXIS_LETTERS[: len(table.index_axes)]
    return [direction for direction in part if direction not in known]


def grid_points_within(table: Parameter, part: Range) -> Bool:
    """Mark the grid points within ranges of axis values, both ends included; Bool of the table's shape.

    An end is met by a breakpoint that differs from it by rounding: 0.1 + 0.2 and 0.3, or 0.3 in single precision.
    """
    inside = np.ones(table.values.shape, dtype=bool)
    for direction, (first, last) in part.items():
        which = AXIS_LETTERS.index(direction)
        points = table.index_axes[which].breakpoints
        slack = min(SAME * np.abs(points).max(), _CELL * np.diff(points).min(initial=np.inf))
        # broadcast along the other axes
        shape = [-1 if i == which else 1 for i in range(table.values.ndim)]
        inside &= ((points >= first - slack) & (points <= last + slack)).reshape(shape)
    return inside
