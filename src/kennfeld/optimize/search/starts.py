"""Where the starts of a multistart lie, and how far apart their ends are.

Sobol sequences: points that fill a cube evenly, however many of them are drawn.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product

import numpy as np

from kennfeld.arrays import Float
from kennfeld.optimize.problem import Problem
from kennfeld.parameters import Parameter

__all__ = ["distance", "drawn_start", "sobol"]

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
    """Point number `index` (from 0) of a Sobol sequence in the unit cube, shifted at random by `seed`.

    The shift, by exclusive or of the bits, keeps the evenness and makes sequences of different seeds different. From
    dimension 65 on coordinates are random numbers, equally determined by seed and index. A point does not depend on how
    many others are drawn. Shape (dimensions,), each from 0 to below 1.

    >>> sobol(5, 3, seed=1).shape
    (3,)
    """
    directions = _directions()
    even = min(dimensions, len(directions))
    shift = np.random.PCG64([seed, 0]).random_raw(len(directions))[:even] >> np.uint64(64 - BITS)
    gray = index ^ (index >> 1)
    bits = [bit for bit in range(BITS) if gray >> bit & 1]
    mixed = np.bitwise_xor.reduce(directions[:even, bits], axis=1) ^ shift
    rest = np.random.PCG64([seed, 1, index]).random_raw(dimensions - even) >> np.uint64(11)
    point: Float = np.concatenate([mixed * 2.0**-BITS, rest * 2.0**-53])
    return point


@cache
def _directions() -> np.ndarray[tuple[int, int], np.dtype[np.uint64]]:
    """Direction numbers, shape (dimensions, BITS), as whole numbers of BITS bits."""
    made = [[1 << (BITS - 1 - bit) for bit in range(BITS)]]
    made += [_recurrence(*map(int, row.split())) for row in _JOE_KUO.split(";")]
    return np.array(made, dtype=np.uint64)


def _recurrence(polynomial: int, *first: int) -> list[int]:
    """Bratley and Fox, Algorithm 659, 1988: v_i = a_1 v_{i-1} + ... + v_{i-s} + (v_{i-s} >> s), all by exclusive or."""
    degree = len(first)
    found = [number << (BITS - 1 - i) for i, number in enumerate(first)]
    for i in range(degree, BITS):
        value = found[i - degree] ^ (found[i - degree] >> degree)
        for k in range(1, degree):
            if polynomial >> (degree - k) & 1:
                value ^= found[i - k]
        found.append(value)
    return found


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
