"""Lines on the result of a calibration."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kennfeld.formatting import shorten, under_heading

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation
    from kennfeld.optimize.result import Result

MAX_LINES = 3  # under one heading
MORE = "; see result.json"


def choice_lines(result: "Result") -> list[str]:
    """Return a line for each estimated shift, and for each table with automatic smoothness."""
    shifts = [
        f"shift of {channel} in {name}: {shift:g}"
        for name, channels in result.shifts.items()
        for channel, shift in channels.items()
    ]
    factors = [
        f"smoothness of {name}: {', '.join(f'{axis} {factor:.3g}' for axis, factor in by_axis.items())}"
        for name, by_axis in result.smoothness.items()
    ]
    return shifts + factors


def extrapolation_lines(extrapolations: Sequence["Extrapolation"], pointer: str = MORE) -> list[str]:
    """Return the surrogates used outside their training data, the largest share first.

    Args:
        extrapolations: one row for each surrogate.
        pointer: where to find the rows that are not listed.
    """
    outside = sorted((row for row in extrapolations if row.worst is not None), key=lambda row: -row.share)
    return under_heading("Surrogate extrapolation:", shorten(list(map(str, outside)), MAX_LINES, pointer))
