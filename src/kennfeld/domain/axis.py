"""Axes of tables: breakpoints in rising order, fixed or free."""

from dataclasses import fields
from typing import Any

import numpy as np

from kennfeld.base.arrays import ArrayLike, Float, readonly
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import array
from kennfeld.domain.breakpoint_rounding import rounded, separated

AXIS_LETTERS = ("x", "y", "z", "w")
MIN_SPACING = 0.05  # of the mean distance of breakpoints, to which free ones may approach each other
LEAST_SPACING = 1e-6  # the same if they are closer at the start; slopes of a narrower cell are mostly rounding


@dataclass(frozen=True, eq=False, init=False)
class Axis:
    """Breakpoints of one direction of a table, strictly increasing.

    Args:
        breakpoints: Float[points], in the unit of the axis.
        input: the quantity on the axis.
        unit: its unit.
        name: the name of a group axis, which several tables share.
        free: True if a calibration moves the breakpoints.
        min_distance: how close free breakpoints may come, by default a twentieth of their mean distance, or the
            smallest distance if that is less, but at least a millionth.
        range: limits within which all free breakpoints may move; without it, the first and the last one are fixed.
        falling: True if files store the greatest breakpoint first; `breakpoints` are in rising order all the same. Axes
            that differ in this alone are equal; of a single breakpoint it is False.

    Raises:
        ArgumentError: the breakpoints do not increase, or contradict `min_distance` or `range`.

    >>> Axis([700, 1000, 1500], input="Speed", unit="rpm").breakpoints
    array([ 700., 1000., 1500.])
    """

    breakpoints: Float  # Float[points]
    input: str = ""
    unit: str = ""
    name: str = ""
    free: bool = False
    min_distance: float | None = None
    range: tuple[float, float] | None = None
    falling: bool = False

    def __init__(
        self,
        breakpoints: ArrayLike,
        input: str = "",  # noqa: A002
        unit: str = "",
        name: str = "",
        *,
        free: bool = False,
        min_distance: float | None = None,
        range: tuple[float, float] | None = None,  # noqa: A002
        falling: bool = False,
    ) -> None:
        vars(self).update(input=input, unit=unit, name=name, free=bool(free))
        vars(self)["min_distance"] = None if min_distance is None else float(min_distance)
        vars(self)["range"] = None if range is None else (float(range[0]), float(range[1]))
        points = readonly(np.atleast_1d(array(breakpoints, f"breakpoints of axis {self.label}")))
        if points.ndim != 1 or points.size == 0:
            raise ArgumentError(f"breakpoints of axis {self.label} must be one-dimensional, got shape {points.shape}")
        if not np.all(np.isfinite(points)):
            raise ArgumentError(f"breakpoints of axis {self.label} must be finite: {points.tolist()}")
        repeated = np.flatnonzero(points[1:] <= points[:-1])
        if repeated.size:
            at = int(repeated[0])
            raise ArgumentError(
                f"breakpoints of axis {self.label} must increase: "
                f"number {at + 2} ({points[at + 1]:g}) does not exceed number {at + 1} ({points[at]:g})"
            )
        vars(self).update(breakpoints=points, falling=bool(falling) and points.size > 1)
        self._check_freedom()

    @classmethod
    def of_quantiles(
        cls,
        values: ArrayLike,
        count: int,
        input: str = "",  # noqa: A002
        unit: str = "",
        *,
        name: str = "",
        round: bool = True,  # noqa: A002
    ) -> "Axis":
        """Return an axis whose breakpoints are quantiles of data, including both ends.

        Args:
            values: the data in the unit of the axis, Float[samples]; NaN is not counted.
            count: number of quantiles, >= 2. Equal ones are one breakpoint, so that the axis may be shorter.
            input: the quantity on the axis.
            unit: its unit.
            name: the name of a group axis.
            round: round the quantiles like `rounded`, and merge those that are very close.

        Raises:
            ArgumentError: no values, or fewer than two quantiles.

        >>> Axis.of_quantiles([703.2, 805.9536, 836.145, 1502.7], 3, input="Speed").breakpoints
        array([ 700.,  820., 1520.])
        """
        data = array(values, f"values of axis {name or input}".rstrip())
        data = data[np.isfinite(data)]
        if count < 2 or not data.size:
            raise ArgumentError(f"count={count} of {data.size} values: quantiles require two, and a value")
        points = np.unique(np.quantile(data, np.linspace(0.0, 1.0, count)))
        return cls(rounded(separated(points)).points if round else points, input, unit, name)

    def rounded(self) -> "Axis":
        """Return the axis with fixed breakpoints, rounded to as many digits as their spacing warrants.

        A step is 1, 2 or 5 times a power of ten and at most a twentieth of the distance to the nearer neighbour. The
        ends are rounded outwards. After rounding fitted breakpoints, fit the values of their tables once more.

        >>> Axis([0.0, 12.9973, 20.0], input="Load").rounded().breakpoints
        array([ 0., 13., 20.])
        """
        points = rounded(self.breakpoints).points
        return self.changed(breakpoints=points, free=False, min_distance=None, range=None)

    def _check_freedom(self) -> None:
        """Check that the breakpoints are within the limits that free ones will keep."""
        points = self.breakpoints
        if self.range is not None and not (self.range[0] <= points[0] and points[-1] <= self.range[1]):
            low, high = self.range
            raise ArgumentError(
                f"range=({low:g}, {high:g}) of axis {self.label} must contain all its breakpoints, "
                f"{points[0]:g} to {points[-1]:g}"
            )
        if self.min_distance is None or not self.free:
            return
        if not (self.min_distance > 0 and np.isfinite(self.min_distance)):
            raise ArgumentError(f"min_distance={self.min_distance:g} of axis {self.label} must be > 0")
        gaps = np.diff(points)
        # breakpoints that were fitted with this distance may be a rounding error closer
        if gaps.size and gaps.min() < self.min_distance - 1e-6 * gaps.mean():
            at = int(gaps.argmin())
            raise ArgumentError(
                f"min_distance={self.min_distance:g} of axis {self.label} exceeds the distance of its breakpoints "
                f"{points[at]:g} and {points[at + 1]:g}"
            )

    @property
    def label(self) -> str:
        """The axis' name, or what lies on it."""
        return self.name or self.input or "without a name"

    @property
    def least_distance(self) -> float:
        """Smallest distance to which free neighbouring breakpoints may approach; infinite for a single one."""
        gaps = np.diff(self.breakpoints)
        if not gaps.size:
            return np.inf if self.min_distance is None else self.min_distance
        least, mean = float(gaps.min()), float(gaps.mean())
        if self.min_distance is None:
            return min(max(least, LEAST_SPACING * mean), MIN_SPACING * mean)
        # by rounding, the smallest gap may be the lesser one
        return min(least, self.min_distance)

    def changed(self, **changes: Any) -> "Axis":
        """Return the same axis with some of its attributes replaced."""
        return Axis(**({f.name: getattr(self, f.name) for f in fields(Axis)} | changes))

    def __len__(self) -> int:
        return self.breakpoints.size

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Axis):
            return NotImplemented
        plain = ("input", "unit", "name", "free", "min_distance", "range")
        same = all(getattr(self, a) == getattr(other, a) for a in plain)
        return same and np.array_equal(self.breakpoints, other.breakpoints)

    def __hash__(self) -> int:
        return hash((self.breakpoints.tobytes(), self.name))
