"""Start points of a multistart, drawn from a Sobol sequence, and the distance between results."""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.problem.problem import Problem

BITS = 32

# Primitive polynomials and first direction numbers of the dimensions from the second on: S. Joe and F. Kuo,
# Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput. 30, 2008.
_JOE_KUO = """
3 1; 7 1 3; 11 1 3 1; 13 1 1 1; 19 1 1 3 3; 25 1 3 5 13; 37 1 1 5 5 17; 41 1 1 5 5 5; 47 1 1 7 11 19;
55 1 1 5 1 1; 59 1 1 1 3 11; 61 1 3 5 5 31; 67 1 3 3 9 7 49; 91 1 1 1 15 21 21; 97 1 3 1 13 27 49;
103 1 1 1 15 7 5; 109 1 3 1 15 13 25; 115 1 1 5 5 19 61; 131 1 3 7 11 23 15 103; 137 1 3 7 13 13 15 69;
143 1 1 3 13 7 35 63; 145 1 3 5 9 1 25 53; 157 1 3 1 13 9 35 107; 167 1 3 1 5 27 61 31; 171 1 1 5 11 19 41 61;
185 1 3 5 3 3 13 69; 191 1 1 7 13 1 19 1; 193 1 3 7 5 13 19 59; 203 1 1 3 9 25 29 41; 211 1 3 5 13 23 1 55;
213 1 3 7 3 13 59 17; 229 1 3 1 3 5 53 69; 239 1 1 5 5 23 33 13; 241 1 1 7 7 1 61 123; 247 1 1 7 9 13 61 49;
253 1 3 3 5 3 55 33; 285 1 3 1 15 31 13 49 245; 299 1 3 5 15 31 59 63 97; 301 1 3 1 11 11 11 77 249;
333 1 3 1 11 27 43 71 9; 351 1 1 7 15 21 11 81 45; 355 1 3 7 3 25 31 65 79; 357 1 3 1 1 19 11 3 205;
361 1 1 5 9 19 21 29 157; 369 1 3 7 11 1 33 89 185; 391 1 3 3 3 15 9 79 71; 397 1 3 7 11 15 39 119 27;
425 1 1 3 1 11 31 97 225; 451 1 1 1 3 23 43 57 177; 463 1 3 7 7 17 17 37 71; 487 1 3 1 5 27 63 123 213;
501 1 1 3 5 11 43 53 133; 529 1 3 5 5 29 17 47 173 479; 539 1 3 3 11 3 1 109 9 69; 545 1 1 1 5 17 39 23 5 343;
557 1 3 1 5 25 15 31 103 499; 563 1 1 1 11 11 17 63 105 183; 601 1 1 5 11 9 29 97 231 363;
607 1 1 5 15 19 45 41 7 383; 617 1 3 7 7 31 19 83 137 221; 623 1 1 1 3 23 15 111 223 83;
631 1 1 5 13 31 15 55 25 161; 637 1 1 3 13 25 47 39 87 257
"""

DEGREE = 3  # of the polynomials that change a table


def sobol(index: int, dimensions: int, seed: int = 0) -> Float:
    """Return a point of a Sobol sequence in the unit cube, randomised by a digital shift.

    Coordinates beyond the 64th are pseudorandom numbers, determined by seed and index as well. A point does not depend
    on how many others are drawn.

    Args:
        index: number of the point, from 0.
        dimensions: number of coordinates.
        seed: seed of the shift.

    Returns:
        Coordinates in [0, 1), Float[dimensions].
    """
    directions = _direction_numbers()
    even = min(dimensions, len(directions))
    shift = np.random.PCG64([seed, 0]).random_raw(len(directions))[:even] >> np.uint64(64 - BITS)
    # in the order of the Gray code, point i is the exclusive or of the directions at the bits of gray(i)
    gray = index ^ (index >> 1)
    bits = [bit for bit in range(BITS) if gray >> bit & 1]
    mixed = np.bitwise_xor.reduce(directions[:even, bits], axis=1) ^ shift
    # the upper 53 bits, as many as a double holds
    rest = np.random.PCG64([seed, 1, index]).random_raw(dimensions - even) >> np.uint64(11)
    return np.asarray(np.concatenate([mixed * 2.0**-BITS, rest * 2.0**-53]))


@cache
def _direction_numbers() -> np.ndarray[tuple[int, int], np.dtype[np.uint64]]:
    """Return integers of BITS bits, shape (dimensions, BITS)."""
    directions = [[1 << (BITS - 1 - bit) for bit in range(BITS)]]
    directions += [_recurrence(*map(int, row.split())) for row in _JOE_KUO.split(";")]
    return np.array(directions, dtype=np.uint64)


def _recurrence(polynomial: int, *first: int) -> list[int]:
    """Bratley and Fox, Algorithm 659, 1988: v_i = a_1 v_{i-1} + ... + v_{i-s} + (v_{i-s} >> s), all by exclusive or."""
    degree = len(first)
    numbers = [number << (BITS - 1 - i) for i, number in enumerate(first)]
    for i in range(degree, BITS):
        value = numbers[i - degree] ^ (numbers[i - degree] >> degree)
        for k in range(1, degree):
            if polynomial >> (degree - k) & 1:
                value ^= numbers[i - k]
        numbers.append(value)
    return numbers


def draw_start(problem: Problem, number: int, seed: int, spread: float) -> dict[str, Float]:
    """Draw the values of a start; the first start has the given values.

    A table changes by a level and a smooth shape: products of Legendre polynomials along the axes with a total degree n
    from 1 (slopes) to 3, weighted by 1/n and by random coefficients. If all values have two bounds, the mean is drawn
    between the mean bounds and the shape is scaled by `spread` times half their distance. Otherwise both are scaled by
    `spread` times the largest magnitude in the table (1 if all values are 0). Values are clipped to their bounds, and
    locked ones stay, as do parameters that affect no criterion: no descent would bring them back. The random
    coefficients are a point of a Sobol sequence, levels first.

    Args:
        problem: the problem.
        number: number of the start, from 1.
        seed: seed of the Sobol sequence.
        spread: size of the changes, relative to the bounds or to the values.

    Returns:
        Values by free parameter, in the shape of its values.
    """
    initial = {name: np.asarray(problem.parameters[name].values) for name in problem.free_names}
    if number == 1:
        return initial
    free = [problem.parameters[name] for name in problem.free_names if name not in problem.unscored_names]
    counts = [len(_shapes(parameter)) for parameter in free]
    shares = 2 * sobol(number - 2, len(free) + sum(counts), seed) - 1
    # levels of all tables come first, then the shapes table by table
    levels, *shapes = np.split(shares, len(free) + np.cumsum([0, *counts]))
    drawn = zip(free, levels.tolist(), shapes, strict=False)  # an empty rest ends the shapes
    changed = {parameter.name: _change_values(parameter, level, shape, spread) for parameter, level, shape in drawn}
    return {**initial, **changed}


def _shapes(parameter: Parameter) -> Sequence[tuple[int, ...]]:
    """Return the degrees along each axis of the polynomials that change a table."""
    ranges = [range(DEGREE + 1 if len(axis) > 1 else 1) for axis in parameter.axes]
    degrees = [each for each in product(*ranges) if 0 < sum(each) <= DEGREE]
    return sorted(degrees, key=lambda each: (sum(each), max(each)))


def _change_values(parameter: Parameter, level: float, shares: Float, spread: float) -> Float:
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
    """Return a smooth function on the grid with zero mean over its span, of the size of its slopes alone."""
    from numpy.polynomial.legendre import legval

    total = np.zeros(parameter.values.shape)
    for degrees, share in zip(_shapes(parameter), shares, strict=True):
        along = np.array(share / sum(degrees))
        for axis, degree in zip(parameter.axes, degrees, strict=True):
            points = axis.breakpoints
            # Legendre polynomials are orthogonal over -1 to 1
            place = 2 * (points - points[0]) / max(points[-1] - points[0], 1e-300) - 1
            along = np.multiply.outer(along, legval(place, np.eye(DEGREE + 1)[degree]))
        total += along
    return total / max(len(parameter.axes), 1)


def distance(values: Mapping[str, Float], best: Mapping[str, Float]) -> float:
    """Return the relative distance of values from the best ones: 0.01 is a difference of about 1 %.

    It is the root mean square, over parameters, of the root mean square difference in each, relative to the largest
    magnitude of its best values (1 if these are 0). A map counts as much as a scalar.
    """
    shares = []
    for name, reference in ((name, best[name]) for name in best if name in values):
        size = float(np.max(np.abs(reference), initial=0.0)) or 1.0
        shares.append(float(np.mean(((values[name] - reference) / size) ** 2)))
    return float(np.sqrt(np.mean(shares))) if shares else 0.0
