"""Where the starts of a multistart lie, and how far apart their ends are."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.problem import Problem
from kennfeld.optimize.search.sobol import sobol
from kennfeld.parameters import Parameter

__all__ = ["distance", "drawn_start"]

DEGREE = 3  # of the polynomials that change a table


def drawn_start(problem: Problem, number: int, seed: int, spread: float) -> dict[str, Float]:
    """The values of start `number`, from 1; the first is the given one.

    A table is changed by a level and a smooth shape, so that it stays a table an engineer could have drawn: products of
    Legendre polynomials along the axes of a total degree from 1 (slopes) to 3, each with a random share, those of
    degree n weighing 1/n. Within two bounds the mean value is drawn between them and the shape reaches `spread` times
    half their distance. Without them both reach `spread` times the largest magnitude in the table (1 where all is 0).
    Nothing leaves its bounds, and locked values stay. The shares are a point of a Sobol sequence, levels first.
    """
    free = [problem.parameters[name] for name in problem.free_names]
    given = {parameter.name: np.asarray(parameter.values) for parameter in free}
    if number == 1:
        return given
    shares = 2 * sobol(number - 2, sum(len(_shapes(p)) + 1 for p in free), seed) - 1
    levels, rest = shares[: len(free)], shares[len(free) :]
    for parameter, level in zip(free, levels, strict=True):
        count = len(_shapes(parameter))
        given[parameter.name] = _moved(parameter, float(level), rest[:count], spread)
        rest = rest[count:]
    return given


def _shapes(parameter: Parameter) -> Sequence[tuple[int, ...]]:
    """Degrees along each axis of the polynomials that change a table; axes of a single point have none."""
    ranges = [range(DEGREE + 1 if len(axis) > 1 else 1) for axis in parameter.axes]
    found = [degrees for degrees in product(*ranges) if 0 < sum(degrees) <= DEGREE]
    return sorted(found, key=lambda degrees: (sum(degrees), max(degrees)))


def _moved(parameter: Parameter, level: float, shares: Float, spread: float) -> Float:
    """The values of a parameter, changed by a level from -1 to 1 and a shape."""
    values, lower, upper = parameter.values, parameter.lower, parameter.upper
    shape = _shape(parameter, shares)
    if np.all(np.isfinite(lower) & np.isfinite(upper)):
        half = (upper - lower) / 2
        mean = float(np.mean(lower + half) + level * np.mean(half))
        moved = values - values.mean() + mean + spread * half * shape
    else:
        size = float(np.max(np.abs(values), initial=0.0)) or 1.0
        moved = values + spread * size * (level + shape)
    return np.where(parameter.locked, values, np.clip(moved, lower, upper))


def _shape(parameter: Parameter, shares: Float) -> Float:
    """A smooth function on the grid, of no mean over its span; its standard size is that of the slopes alone."""
    from numpy.polynomial.legendre import legval

    total = np.zeros(parameter.values.shape)
    for degrees, share in zip(_shapes(parameter), shares, strict=True):
        along = np.array(share / sum(degrees))
        for axis, degree in zip(parameter.axes, degrees, strict=True):
            points = axis.breakpoints
            place = 2 * (points - points[0]) / max(points[-1] - points[0], 1e-300) - 1
            along = np.multiply.outer(along, legval(place, np.eye(DEGREE + 1)[degree]))
        total += along
    return total / max(len(parameter.axes), 1)


def distance(values: Mapping[str, Float], best: Mapping[str, Float]) -> float:
    """How far values lie from the best ones: 0.01 says that they differ by about 1 %.

    The root mean square, over parameters, of the root mean square difference in each, relative to the largest magnitude
    of its best values (1 where these are 0). A map counts as much as a scalar.
    """
    shares = []
    for name, reference in ((name, best[name]) for name in best if name in values):
        size = float(np.max(np.abs(reference), initial=0.0)) or 1.0
        shares.append(float(np.mean(((values[name] - reference) / size) ** 2)))
    return float(np.sqrt(np.mean(shares))) if shares else 0.0
