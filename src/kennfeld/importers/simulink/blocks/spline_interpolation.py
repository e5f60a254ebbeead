"""Splines over nodes: natural cubic splines of any dimension, and Akima's splines of one dimension.

The cell of the input is selected first, with the values and slopes at its ends, and its polynomial is evaluated once.

A natural spline is linear in the table values, so its derivatives with respect to them are exact. In a cell of width h
with s + p = 1: y = s yl + p yu + ((s^3 - s) Ml + (p^3 - p) Mu) h^2 / 6. The second derivatives M are a matrix of the
breakpoints times the values, and 0 at the ends. In several dimensions, a spline along the first dimension for each line
is followed by a spline through the results.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.node_arrays import Numbers, reduce_nodes


def nodes_needed(shape: Sequence[int]) -> int:
    """Estimate how many nodes a spline through a table of this shape takes."""
    # b c, c and 1 splines along the dimensions of a table of a x b x c
    lines = np.cumprod([1, *reversed(shape[1:])])[::-1]
    return sum(int(count) * size * (2 * size + 4) for count, size in zip(lines, shape, strict=True))


def interpolate_by_spline(
    builder: GraphBuilder,
    value: Callable[..., int],
    points: Sequence[Numbers],
    coordinates: Sequence[int],
    beyond: str,
) -> int:
    """Build a natural cubic spline through a table.

    Args:
        builder: graph under construction.
        value: node of the table value at the indices of a grid point.
        points: breakpoints of each dimension.
        coordinates: node of the coordinate along each dimension.
        beyond: extrapolation: "clip", "linear", or "cubic", which extends the outermost cell.

    Returns:
        Node of the interpolated value.
    """
    if not points:
        return value()
    last, x = points[-1], coordinates[-1]
    nodes = [
        interpolate_by_spline(builder, lambda *rest, at=at: value(*rest, at), points[:-1], coordinates[:-1], beyond)
        for at in range(len(last))
    ]
    return _along(builder, nodes, last, x, beyond)


def _along(builder: GraphBuilder, values: list[int], points: Numbers, x: int, beyond: str) -> int:
    """Build a spline along one dimension."""
    low, high, first, second, at, width = _cell(builder, values, _bends(builder, values, points), points, x)
    call, const = builder.call, builder.const
    p = call("div", call("sub", x, at), width)
    if beyond == "clip":
        p = call("min", call("max", p, const(0.0)), const(1.0))
    s = call("sub", const(1.0), p)
    square = call("mul", call("mul", width, width), const(1 / 6))
    curved = call("add", call("mul", _cubic(builder, s), first), call("mul", _cubic(builder, p), second))
    rise = call("sub", high, low)
    y = call("add", call("add", low, call("mul", p, rise)), call("mul", curved, square))
    if beyond != "linear":
        return y
    # slopes dy/dp at the ends of the table, where the second derivative of the outer end is 0:
    # p = 1: yu - yl + Ml h^2 / 6, p = 0: yu - yl - Mu h^2 / 6
    up = call("add", rise, call("mul", first, square))
    down = call("sub", rise, call("mul", second, square))
    above = call("add", high, call("mul", up, call("sub", p, const(1.0))))
    below = call("add", low, call("mul", down, p))
    y = call("select", call("gt", p, const(1.0)), above, y)
    return call("select", call("lt", p, const(0.0)), below, y)


def _cubic(builder: GraphBuilder, p: int) -> int:
    return builder.call("mul", p, builder.call("sub", builder.call("mul", p, p), builder.const(1.0)))


def _cell(builder: GraphBuilder, values: list[int], bends: list[int], points: Numbers, x: int) -> tuple[int, ...]:
    """Select the cell of x: values and second derivatives at its ends, its start and its width."""
    begins = [builder.const(float(point)) for point in points]
    widths = [builder.const(float(width)) for width in np.diff(points)]
    rows = list(zip(values, values[1:], bends, bends[1:], begins, widths, strict=False))
    # the last cell whose begin x has reached; below the first breakpoint, the first cell
    selected = rows[0]
    for begin, row in zip(begins[1:], rows[1:], strict=False):
        within = builder.call("ge", x, begin)
        selected = tuple(builder.call("select", within, new, old) for new, old in zip(row, selected, strict=True))
    return selected


def _bends(builder: GraphBuilder, values: list[int], points: Numbers) -> list[int]:
    """Return the second derivatives at the breakpoints."""
    nodes = []
    for row in _matrix(points):
        terms = [
            builder.call("mul", builder.const(float(share)), v) for share, v in zip(row, values, strict=True) if share
        ]
        nodes.append(reduce_nodes(builder, "add", terms))
    return nodes


def _matrix(points: Numbers) -> Numbers:
    """Return the matrix that maps values to second derivatives."""
    count, widths = len(points), np.diff(points)
    left, right = np.eye(count), np.zeros((count, count))
    for i, (before, after) in enumerate(pairwise(widths), 1):
        # h- M- + 2 (h- + h+) M + h+ M+ = 6 ((y+ - y) / h+ - (y - y-) / h-) inside, M = 0 at the ends (natural spline)
        left[i, i - 1 : i + 2] = before, 2 * (before + after), after
        right[i, i - 1 : i + 2] = 6 / before, -6 / before - 6 / after, 6 / after
    return np.asarray(np.linalg.solve(left, right), dtype=np.float64)


def interpolate_by_akima(builder: GraphBuilder, values: list[int], points: Numbers, x: int, beyond: str) -> int:
    """Build a modified Akima spline through the points of a curve.

    A cubic of Hermite in each cell, y = h00(p) yl + h10(p) h sl + h01(p) yu + h11(p) h su with p = (x - xl) / h, whose
    slopes s are means of the slopes of the cells around, as of `makima` of MATLAB.

    Args:
        builder: graph under construction.
        values: node of the value at each breakpoint.
        points: breakpoints.
        x: node of the input.
        beyond: extrapolation: "clip", or "akima", which extends the outermost cell.

    Returns:
        Node of the interpolated value.
    """
    slopes = _akima_slopes(builder, values, points)
    low, high, first, second, at, width = _cell(builder, values, slopes, points, x)
    call, const = builder.call, builder.const
    p = call("div", call("sub", x, at), width)
    if beyond == "clip":
        p = call("min", call("max", p, const(0.0)), const(1.0))
    rise = call("sub", high, low)
    # y = yl + p (h sl + p (3 r - 2 h sl - h su + p (h sl + h su - 2 r))) with the rise r = yu - yl
    start, end = call("mul", width, first), call("mul", width, second)
    third = call("sub", call("add", start, end), call("mul", const(2.0), rise))
    middle = call("sub", call("sub", rise, start), third)
    cubic = call("add", start, call("mul", p, call("add", middle, call("mul", p, third))))
    return call("add", low, call("mul", p, cubic))


def _akima_slopes(builder: GraphBuilder, values: list[int], points: Numbers) -> list[int]:
    """Return the slope of a modified Akima spline at each breakpoint.

    s = (w1 d- + w2 d) / (w1 + w2), in which d- and d are the slopes of the cells before and after the breakpoint,
    w1 = |d+ - d| + |d+ + d| / 2 and w2 = |d- - d--| + |d- + d--| / 2.
    """
    call, const = builder.call, builder.const
    rises = [call("sub", after, before) for before, after in pairwise(values)]
    d = [call("div", rise, const(float(width))) for rise, width in zip(rises, np.diff(points), strict=True)]
    if len(d) == 1:
        return [d[0], d[0]]
    # two more cells beyond each end, whose slopes go on as they change in the outermost two
    for _ in range(2):
        d.insert(0, _continued(builder, d[1], d[0]))
        d.append(_continued(builder, d[-2], d[-1]))
    weights = [_akima_weight(builder, before, after) for before, after in pairwise(d)]
    slopes = []
    for k in range(len(values)):
        first, second = weights[k + 2], weights[k]
        total = call("add", first, second)
        flat = call("eq", total, const(0.0))
        mean = call("add", call("mul", first, d[k + 1]), call("mul", second, d[k + 2]))
        # four equal slopes of 0 leave nothing to weigh: the curve is flat there
        slope = call("div", mean, call("select", flat, const(1.0), total))
        slopes.append(call("select", flat, const(0.0), slope))
    return slopes


def _continued(builder: GraphBuilder, before: int, last: int) -> int:
    return builder.call("sub", builder.call("mul", builder.const(2.0), last), before)


def _akima_weight(builder: GraphBuilder, before: int, after: int) -> int:
    """Return |d+ - d| + |d+ + d| / 2; the second part keeps flat regions from overshooting."""
    call = builder.call
    change, size = call("abs", call("sub", after, before)), call("abs", call("add", after, before))
    return call("add", change, call("mul", size, builder.const(0.5)))
