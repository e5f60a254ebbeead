"""Inputs and output in units of their own spread, in which training works."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float
from kennfeld.errors import ArgumentError
from kennfeld.expansion import Expansion

__all__ = ["Scaling", "checked_points"]


@dataclass(frozen=True, eq=False)
class Scaling:
    """Mean and standard deviation of each input and of the output over the training data."""

    centre: Float  # Float[inputs]
    spread: Float  # Float[inputs], > 0
    level: float
    height: float  # > 0

    @classmethod
    def of(cls, x: Float, y: Float) -> "Scaling":
        """The scaling of points Float[points, inputs] and values Float[points]; a constant output keeps its unit."""
        height = float(y.std())
        return cls(x.mean(0), x.std(0), float(y.mean()), height if height > 0 else 1.0)

    def inward(self, x: Float) -> Float:
        """Points in units of spread."""
        scaled: Float = (x - self.centre) / self.spread
        return scaled

    def expansion(self, offset: float, slopes: Float, weights: Float, centres: Float, lengths: Float) -> Expansion:
        """An expansion over scaled inputs and output, written in physical units; `lengths` as `centres`, or one row."""
        steep = self.height * slopes / self.spread
        return Expansion(
            self.level + self.height * offset - float(steep @ self.centre),
            steep,
            self.height * weights,
            self.centre + self.spread * centres,
            np.broadcast_to(self.spread * lengths, centres.shape),
        )


def checked_points(x: Float, y: Float, names: Sequence[str] = ()) -> tuple[Float, Float]:
    """Points and values as arrays, after the checks that every training begins with.

    Raises `ArgumentError` that names the input where shapes differ, a number is not finite, an input never changes or
    there are too few points to fit a plane.
    """
    points, values = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if points.ndim != 2 or values.shape != points.shape[:1]:
        raise ArgumentError(
            f"x of shape {points.shape} and y of shape {values.shape} must be [points, inputs], [points]"
        )
    count, inputs = points.shape
    named = list(names) or [f"input {d}" for d in range(inputs)]
    if not inputs or count < inputs + 3:
        raise ArgumentError(f"{count} points are too few for {inputs} inputs; {max(inputs, 1) + 3} are the least")
    bad = np.flatnonzero(~np.isfinite(points).all(0))
    if bad.size or not np.isfinite(values).all():
        what = named[bad[0]] if bad.size else "the output"
        raise ArgumentError(f"{what} has values that are not finite; leave those samples out")
    constant = np.flatnonzero(~(points.std(0) > 1e-14 * np.abs(points).max(0)))
    if constant.size:
        first = int(constant[0])
        raise ArgumentError(
            f"{named[first]} is {points[0, first]:g} at every training sample; leave it out of the inputs"
        )
    return points, values
