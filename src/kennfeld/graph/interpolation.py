"""Linear interpolation in tables, exact and smoothed, in numpy: the reference for the native code."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from kennfeld.base.arrays import Float, ignore_floating_errors
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Extrapolation

WINDOW = 4.0  # standard deviations at which the smoothing kernel is truncated


def position(x: Float, breakpoints: Float, extrapolation: Extrapolation) -> Float:
    """Compute the cell index of x plus the fraction within the cell; 2.25 is a quarter past breakpoint 2.

    Args:
        x: coordinates, shape (samples,).
        breakpoints: increasing, in the unit of x.
        extrapolation: "clip" or "linear".

    >>> position(np.array([5.0, 12.5]), np.array([0.0, 10.0, 20.0]), "clip")
    array([0.5 , 1.25])
    """
    last = breakpoints.size - 1
    if last == 0:
        return np.where(np.isfinite(x), 0.0, np.nan)
    place = np.interp(x, breakpoints, np.arange(breakpoints.size, dtype=np.float64))
    if extrapolation == "clip":
        return place
    # the first and last cell go on beyond the ends
    below, above = breakpoints[0] - x, x - breakpoints[last]
    place = np.where(below > 0, -below / (breakpoints[1] - breakpoints[0]), place)
    return np.where(above > 0, last + above / (breakpoints[last] - breakpoints[last - 1]), place)


def density(x: Float, breakpoints: Float, extrapolation: Extrapolation) -> Float:
    """Compute the slope of `position` by x, Float[samples]: 1 / width of the cell, 0 if x is clipped."""
    last = breakpoints.size - 1
    if last == 0:
        return np.zeros_like(x)
    place = position(x, breakpoints, "linear")  # next to a breakpoint, rounding decides on the cell: only once
    cell = np.clip(np.nan_to_num(np.floor(place)), 0, last - 1).astype(np.int64)
    slope = 1.0 / (breakpoints[cell + 1] - breakpoints[cell])
    inside = (x >= breakpoints[0]) & (x <= breakpoints[last])
    result: Float = slope * (inside | (extrapolation == "linear"))
    return result


def cell_weights(place: Float, count: int) -> tuple[Float, Float]:
    """Compute the weights of all `count` grid points at `place`, and their slopes; shapes (samples, count)."""
    samples = np.arange(place.size)
    weights, slopes = np.zeros((2, place.size, count))
    if count == 1:
        weights[:, 0] = np.where(np.isnan(place), np.nan, 1.0)
        return weights, slopes
    cell = np.clip(np.nan_to_num(np.floor(place)), 0, count - 2).astype(np.int64)
    weights[samples, cell], weights[samples, cell + 1] = 1.0 - (place - cell), place - cell
    slopes[samples, cell], slopes[samples, cell + 1] = -1.0, 1.0
    return weights, slopes


def regrid(values: Float, axes: Sequence[Axis], onto: Sequence[Axis], extrapolation: Extrapolation) -> Float:
    """Interpolate the values of a table, Float[points of each axis], at the grid points of as many other axes."""
    for i, (before, after) in enumerate(zip(axes, onto, strict=True)):
        if not np.array_equal(before.breakpoints, after.breakpoints):
            place = position(after.breakpoints, before.breakpoints, extrapolation)
            values = np.moveaxis(np.tensordot(cell_weights(place, len(before))[0], values, axes=(1, i)), 0, i)
    return values


def smooth_weights(x: Float, breakpoints: Float, extrapolation: Extrapolation, width: float) -> tuple[Float, Float]:
    """Compute grid-point weights of linear interpolation convolved with a Gaussian of standard deviation `width`.

    A piecewise-linear interpolation is a sum of ramps that start at the breakpoints. The convolution of a ramp is t
    Phi(t/s) + s phi(t/s), with the distance t from its start and the width s.

    Returns:
        The weights and their slopes with respect to x, shapes (samples, count).
    """
    from scipy.special import ndtr

    if width <= 0 or breakpoints.size == 1:
        weights, slopes = cell_weights(position(x, breakpoints, extrapolation), breakpoints.size)
        return weights, slopes * density(x, breakpoints, extrapolation)[:, None]
    t = x[:, None] - breakpoints
    u = t / width
    inside = np.abs(u) < WINDOW
    normal_density = np.exp(-0.5 * u * u) / np.sqrt(2 * np.pi)
    rising = np.where(inside, ndtr(u), u > 0)
    ramp = np.where(inside, t * ndtr(u) + width * normal_density, np.maximum(t, 0.0))
    if extrapolation == "linear":
        # the ramps at the ends are exact, so that the ends have no kink to smooth
        ramp[:, 0], rising[:, 0] = t[:, 0], 1.0
        ramp[:, -1], rising[:, -1] = 0.0, 0.0
    widths = np.diff(breakpoints)
    return _differences(-np.diff(ramp) / widths, 1.0), _differences(-np.diff(rising) / widths, 0.0)


def _differences(share: Float, total: float) -> Float:
    """Compute the weights of the grid points from the fraction of each interval passed, Float[samples, count - 1].

    weight[i] = share[i - 1] - share[i]; before the first interval, `total` has been passed.
    """
    edges = np.full((share.shape[0], 1), total)
    result: Float = np.hstack([edges, share]) - np.hstack([share, np.zeros_like(edges)])
    return result


def table_weights(sides: Sequence[Float], shape: tuple[int, ...]) -> Float:
    """Compute the products of the weights along each axis; shape (samples, grid points of the table)."""
    samples = sides[0].shape[0] if sides else 1
    flat: Float = np.ones((samples, 1))
    for side in sides:
        flat = (flat[:, :, None] * side[:, None, :]).reshape(samples, -1)
    return flat.reshape(samples, int(np.prod(shape)))


def look_up(values: Float, axes: Sequence[Axis], coordinates: Sequence[Float], extrapolation: Extrapolation) -> Float:
    """Look a table up at coordinates of any shape: Float[points of each axis] -> Float of that shape.

    At an infinite coordinate a table that is continued linearly is not finite: the weights of the last two grid points
    are -inf and inf there, and their sum is infinite or NaN, as in machine code and exported code.

    >>> look_up(np.array([1.0, 3.0]), [Axis([0.0, 10.0])], [np.array([5.0, 20.0])], "clip")
    array([2., 3.])
    """
    total: Float = np.zeros(np.shape(coordinates[0]))
    places = [position(np.atleast_1d(x), a.breakpoints, extrapolation) for x, a in zip(coordinates, axes, strict=True)]
    places = [place.reshape(total.shape) for place in places]
    # the last cell goes up to its end; a single breakpoint has no cell
    last = [max(len(axis) - 2, 0) for axis in axes]
    cells = [np.clip(np.nan_to_num(np.floor(p)), 0, end).astype(int) for p, end in zip(places, last, strict=True)]
    for corner in product((0, 1), repeat=len(axes)):
        if any(bit and len(axis) == 1 for bit, axis in zip(corner, axes, strict=True)):
            continue
        weight: Float = np.ones(total.shape)
        for bit, place, cell in zip(corner, places, cells, strict=True):
            weight = weight * (place - cell if bit else 1.0 - (place - cell))
        at = tuple(cell + bit for cell, bit in zip(cells, corner, strict=True))
        # a value without weight must not leak, though it is NaN
        with ignore_floating_errors():
            total = total + np.where(weight == 0.0, 0.0, weight * values[at])
    return total


def interpolate(values: Float, sides: Sequence[Float]) -> Float:
    """Interpolate a table with weights Float[samples, count] along each axis; returns Float[samples].

    Grid points of weight 0 are ignored, even if not finite.
    """
    if not sides:
        return values.reshape(1)
    # only grid points that some sample weighs
    support = [np.flatnonzero((side != 0).any(axis=0)) for side in sides]
    total = np.zeros(sides[0].shape[0])
    for corner in product(*support):
        weight = np.prod([side[:, i] for side, i in zip(sides, corner, strict=True)], axis=0)
        with ignore_floating_errors():
            total += np.where(weight == 0, 0.0, weight * values[corner])
    return total
