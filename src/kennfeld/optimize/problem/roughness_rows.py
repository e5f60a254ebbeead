"""Second differences along one axis: the rows whose squares are the roughness of a table.

With breakpoints e apart, the coefficients of their second differences grow as 1/e and fall out of the digits of all
others in J'J. Such breakpoints are a group here. The slope s within a group occurs in two rows only, those to the
slopes l and r on either side of it, whose sum of squares is

    (a (s - l))^2 + (b (r - s))^2 = (a b)^2 / (a^2 + b^2) (r - l)^2 + (a^2 + b^2) (s - m)^2

with m = (a^2 l + b^2 r) / (a^2 + b^2). The first term does not contain s and remains. The second one ties the values
of the group to a line of slope m, with the weight that it has for breakpoints `CLOSE` apart: far above that of data.
"""

from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float, Int

CLOSE = 1e-6  # of the mean spacing: neighbours up to here are a group


class RoughnessRows(NamedTuple):
    """Rows over the values of one line of a table, padded with coefficients of 0.

    `points` are the numbers of the breakpoints, Int[rows, entries]; `coefficients` is Float[rows, entries].
    """

    points: Int
    coefficients: Float


def roughness_rows(breakpoints: Float) -> RoughnessRows:
    """Return the rows whose sum of squares is that of the second differences, without its factor.

    Args:
        breakpoints: Float[points].

    >>> roughness_rows(np.array([0.0, 10.0, 20.0])).points
    array([[0, 1, 2]])
    """
    count = breakpoints.size
    if count < 3:
        return RoughnessRows(np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3)))
    x = breakpoints / ((breakpoints[-1] - breakpoints[0]) / (count - 1))
    # first breakpoint of each group; mostly each is a group of its own
    firsts = np.append(0, np.flatnonzero(np.diff(x) > CLOSE) + 1)
    if firsts.size == count:
        return RoughnessRows(np.arange(count - 2)[:, None] + np.arange(3), second_differences(breakpoints))
    lasts = np.append(firsts[1:], count) - 1
    rows = [row for group in range(firsts.size) for row in _rows_of_group(x, firsts, lasts, group)]
    points, coefficients = zip(*rows, strict=True)
    return RoughnessRows(np.array(points), np.array(coefficients))


def _rows_of_group(x: Float, firsts: Int, lasts: Int, group: int) -> list[tuple[list[int], list[float]]]:
    """Return the row of the slopes beside a group and the rows within it, as points and coefficients."""
    first, last = int(firsts[group]), int(lasts[group])
    before = int(lasts[group - 1]) if group else first
    after = int(firsts[group + 1]) if group + 1 < firsts.size else last
    points = [before, first, last, after]
    # the slopes on both sides, over these points; 0 beyond an end
    slope_before = np.array([-1.0, 1.0, 0.0, 0.0]) / (x[first] - x[before]) if before < first else np.zeros(4)
    slope_after = np.array([0.0, 0.0, -1.0, 1.0]) / (x[after] - x[last]) if last < after else np.zeros(4)
    # a and b; the distances include the group, as those of second differences include both neighbours
    a = 2 / (x[last] - x[before]) if before < first else 0.0
    b = 2 / (x[after] - x[first]) if last < after else 0.0
    rows = []
    # a single breakpoint: a second difference as usual
    if first == last and a and b:
        rows.append((points, (2 / (x[after] - x[before]) * (slope_after - slope_before)).tolist()))
    elif a and b:
        rows.append((points, (a * b / np.hypot(a, b) * (slope_after - slope_before)).tolist()))
    # m, as a row over the four points
    slope = (a**2 * slope_before + b**2 * slope_after) / (a**2 + b**2)
    for point in range(first + 1, last + 1):
        # z_point - z_first - slope (x_point - x_first)
        tie = (np.hypot(a, b) / CLOSE) * np.append([-1.0, 1.0], -slope * (x[point] - x[first]))
        rows.append(([first, point, *points], tie.tolist()))
    width = 6
    # rows of equal width: a point again, with the coefficient 0
    return [(p + p[:1] * (width - len(p)), c + [0.0] * (width - len(c))) for p, c in rows]


def second_differences(breakpoints: Float) -> Float:
    """Return the coefficients of d = 2 [(z3-z2)/(x3-x2) - (z2-z1)/(x2-x1)] / (x3-x1), x in mean spacings.

    Args:
        breakpoints: Float[points].

    Returns:
        Float[points - 2, 3]: of z1, z2 and z3. On an even axis d is z1 - 2 z2 + z3.

    >>> second_differences(np.array([0.0, 10.0, 20.0]))
    array([[ 1., -2.,  1.]])
    """
    count = breakpoints.size
    if count < 3:
        return np.zeros((0, 3))
    x = breakpoints / ((breakpoints[-1] - breakpoints[0]) / (count - 1))
    left, right, both = x[1:-1] - x[:-2], x[2:] - x[1:-1], x[2:] - x[:-2]
    return np.stack([2 / (left * both), -2 / (left * right), 2 / (right * both)], axis=1)
