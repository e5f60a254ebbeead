"""Round breakpoints: numbers that were computed from data, to as many digits as their spacing warrants.

Each breakpoint becomes a multiple of a step, the largest 1, 2 or 5 times a power of ten that is at most a twentieth of
the distance to its nearer neighbour; a multiple of the next larger step stays, such as 1750 for a step of 20. Inner
breakpoints move by at most half a step. The first one is rounded down and the last one up, so that the axis still
covers the data.
"""

from collections.abc import Callable
from math import ceil, floor, isfinite, log10

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass

STEPS_PER_DISTANCE = 20
LEAST_SHARE = 1e-3  # of the mean distance of the inner breakpoints; closer ones are one
SAME = 5e-7  # relative to their size; the single precision of control units resolves 1.2e-7
_SHORT = 12  # digits of a number that is meant to be a short one
DIGITS = 15  # that a double holds: a step below the last one would change nothing


@dataclass(frozen=True, eq=False)
class RoundedBreakpoints:
    """Rounded breakpoints with the smallest and the largest step; both are 0 if no number has changed."""

    points: Float  # Float[points]
    finest: float = 0.0
    coarsest: float = 0.0

    @property
    def steps(self) -> str:
        """The steps as text: `50`, or `0.5 to 50`."""
        ends = f"{self.finest:g}", f"{self.coarsest:g}"
        return ends[0] if ends[0] == ends[1] else " to ".join(ends)


def nice_step(distance: float) -> float:
    """Return the largest step 1, 2 or 5 times a power of ten up to a twentieth of a distance; 0 if there is none.

    >>> nice_step(30.2), nice_step(200.0), nice_step(0.07)
    (1.0, 10.0, 0.002)
    """
    most = distance / STEPS_PER_DISTANCE
    if not (isfinite(most) and most > 0):
        return 0.0
    power = floor(log10(most))
    # from text, which gives the double nearest to 0.002; a product with a power of ten may miss it
    steps = [float(f"{digit}e{power + more}") for more in (-1, 0) for digit in (1, 2, 5)]
    # 1e-12: a distance that is meant to be 20 steps may be a rounding error less
    return max((step for step in steps if step <= most * (1 + 1e-12)), default=0.0)


def evenly_spaced(begin: float, end: float, count: int) -> Float:
    """Return breakpoints at equal distances, Float[count], written as 0.3 rather than 0.30000000000000004.

    >>> evenly_spaced(0.0, 1.0, 11).tolist()[3:7]
    [0.3, 0.4, 0.5, 0.6]
    """
    with np.errstate(over="ignore"):  # rounding may carry the last one beyond all numbers; it is `end`
        points = np.linspace(begin, end, count)
    rounding = 4 * np.finfo(float).eps * max(abs(begin), abs(end))
    short = np.array([float(f"{point:.{_SHORT}g}") if abs(point) > rounding else 0.0 for point in points.tolist()])
    near = np.abs(short - points) <= rounding
    near[[0, -1]] = False  # the ends are as written
    return np.where(near, short, points)


def separated(points: Float) -> Float:
    """Drop increasing breakpoints that are too close to another one: Float[points] -> Float[kept]; the ends remain.

    Breakpoints are too close within 5e-7 of their size, or within a thousandth of the mean distance of the inner ones.
    The first and the last distance do not count: a single wrong sample stretches them.

    >>> separated(np.array([0.0, 1000.0, 1000.001, 2000.0, 3000.0])).tolist()
    [0.0, 1000.0, 2000.0, 3000.0]
    """
    if points.size < 2:
        return points
    inner = points[1:-1]
    mean = (inner[-1] - inner[0]) / (inner.size - 1) if inner.size > 2 else 0.0

    def close(first: float, second: float) -> bool:
        return second - first <= max(LEAST_SHARE * mean, SAME * max(abs(first), abs(second)))

    kept = [float(points[0])]
    for point in map(float, points[1:]):
        if not close(kept[-1], point):
            kept.append(point)
    last = float(points[-1])
    if kept[-1] != last and len(kept) > 1:
        # of two that are close at the end, the outer one stays
        kept[-1] = last
    return np.array(kept)


def rounded(points: Float) -> RoundedBreakpoints:
    """Round increasing breakpoints, the first down, the last up, and the others to the nearest multiple of a step.

    Args:
        points: strictly increasing; Float[points]. A single breakpoint is returned as it is.

    >>> rounded(np.array([703.2, 805.9536, 836.145, 1502.7])).points.tolist()
    [700.0, 806.0, 836.0, 1520.0]
    """
    points = np.asarray(points, dtype=np.float64)
    if points.size < 2:
        return RoundedBreakpoints(points)
    with np.errstate(over="ignore"):
        # a distance beyond the largest double is infinite; `nice_step` has no step for it
        gaps = np.diff(points)
    nearer = np.minimum(np.append(gaps, np.inf), np.insert(gaps, 0, np.inf))
    # outwards at both ends: the axis still covers the data
    ways: list[Callable[[float], int]] = [floor, *[round] * (points.size - 2), ceil]
    pairs = [_rounded(float(x), nice_step(float(d)), way) for x, d, way in zip(points, nearer, ways, strict=True)]
    result = np.array([number for number, _ in pairs])
    if np.array_equal(result, points):
        return RoundedBreakpoints(points)
    steps = [step for _, step in pairs if step > 0]
    return RoundedBreakpoints(result, min(steps), max(steps))


def _rounded(number: float, step: float, way: Callable[[float], int]) -> tuple[float, float]:
    """Return a number as a multiple of a step, and the step; both unchanged and 0 if no double is such a multiple."""
    # also if there is no step, which is 0
    if not step > abs(number) * 10.0**-DIGITS:
        return number, 0.0
    # 0.002 as 2 and -3: an integer with this power, as text, becomes the double nearest to the multiple
    digit, _, power = f"{step:e}".partition("e")
    unit = int(float(digit))
    for each in (unit, 5):  # 1750 is rounder than any multiple of 20
        if number == float(f"{round(number / step * unit / each) * each}e{power}"):
            return number, step
    multiple = float(f"{way(number / step) * unit}e{power}")
    return (multiple, step) if isfinite(multiple) else (number, 0.0)
