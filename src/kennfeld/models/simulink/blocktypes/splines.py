"""Natural cubic splines through the values of a table, which they are linear in: its derivatives stay exact.

Between two breakpoints h apart, with s + p = 1, y = s yl + p yu + ((s^3 - s) Ml + (p^3 - p) Mu) h^2 / 6. The second
derivatives M follow from the values by a matrix of the breakpoints alone; they are 0 at the ends. A table of several
dimensions is a spline along its first one for each line, then one through what these give.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.arrays import fold
from kennfeld.models.simulink.variables.scopes import Array

__all__ = ["nodes_needed", "spline"]


def nodes_needed(shape: Sequence[int]) -> int:
    """About how many nodes a spline through a table of a shape takes."""
    lines = np.cumprod([1, *reversed(shape[1:])])[::-1]
    return sum(int(count) * size * (2 * size + 4) for count, size in zip(lines, shape, strict=True))


def spline(
    loom: Loom,
    value: Callable[..., int],
    points: Sequence[Array],
    coordinates: Sequence[int],
    beyond: str,
) -> int:
    """The node of a spline at coordinates. `value` gives the node of a grid point by its places.

    `beyond` the ends it is clipped, or goes on as a line or as the cubic of the last cell ("linear", "cubic").
    """
    if not points:
        return value()
    last, x = points[-1], coordinates[-1]
    made = [
        spline(loom, lambda *rest, at=at: value(*rest, at), points[:-1], coordinates[:-1], beyond)
        for at in range(len(last))
    ]
    return _along(loom, made, last, x, beyond)


def _along(loom: Loom, values: list[int], points: Array, x: int, beyond: str) -> int:
    """A spline along one dimension."""
    low, high, first, second, at, width = _cell(loom, values, _bends(loom, values, points), points, x)
    call, const = loom.call, loom.const
    p = call("div", call("sub", x, at), width)
    if beyond == "clip":
        p = call("min", call("max", p, const(0.0)), const(1.0))
    s = call("sub", const(1.0), p)
    square = call("mul", call("mul", width, width), const(1 / 6))
    curved = call("add", call("mul", _cubic(loom, s), first), call("mul", _cubic(loom, p), second))
    rise = call("sub", high, low)
    y = call("add", call("add", low, call("mul", p, rise)), call("mul", curved, square))
    if beyond != "linear":
        return y
    up = call("add", rise, call("mul", first, square))
    down = call("sub", rise, call("mul", second, square))
    above = call("add", high, call("mul", up, call("sub", p, const(1.0))))
    below = call("add", low, call("mul", down, p))
    y = call("select", call("gt", p, const(1.0)), above, y)
    return call("select", call("lt", p, const(0.0)), below, y)


def _cubic(loom: Loom, p: int) -> int:
    return loom.call("mul", p, loom.call("sub", loom.call("mul", p, p), loom.const(1.0)))


def _cell(loom: Loom, values: list[int], bends: list[int], points: Array, x: int) -> tuple[int, ...]:
    """What holds in the cell of x: values and bends at its ends, where it begins, how wide it is."""
    begins = [loom.const(float(point)) for point in points]
    widths = [loom.const(float(width)) for width in np.diff(points)]
    rows = list(zip(values, values[1:], bends, bends[1:], begins, widths, strict=False))
    made = rows[0]
    for begin, row in zip(begins[1:], rows[1:], strict=False):
        within = loom.call("ge", x, begin)
        made = tuple(loom.call("select", within, new, old) for new, old in zip(row, made, strict=True))
    return made


def _bends(loom: Loom, values: list[int], points: Array) -> list[int]:
    """The second derivatives at the breakpoints."""
    made = []
    for row in _matrix(points):
        terms = [loom.call("mul", loom.const(float(share)), v) for share, v in zip(row, values, strict=True) if share]
        made.append(fold(loom, "add", terms))
    return made


def _matrix(points: Array) -> Array:
    """What makes the second derivatives of the values."""
    count, widths = len(points), np.diff(points)
    left, right = np.eye(count), np.zeros((count, count))
    for i, (before, after) in enumerate(pairwise(widths), 1):
        left[i, i - 1 : i + 2] = before, 2 * (before + after), after
        right[i, i - 1 : i + 2] = 6 / before, -6 / before - 6 / after, 6 / after
    return np.asarray(np.linalg.solve(left, right), dtype=np.float64)
