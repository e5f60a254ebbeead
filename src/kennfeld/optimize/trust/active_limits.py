"""Limits that are active at the end of a fit, and the directions of the values that they determine.

With a quadratic cost of curvature H, minimising it subject to the output limits A p <= b reduces to a problem in the
multipliers l of the samples at which the limits are reached:

    minimise  l'Gl / 2 - l'v  over l >= 0,    G = A H^-1 A'

where v is the amount by which the unconstrained step would exceed the limits. Source: J. Nocedal and S. Wright,
Numerical Optimization, chapter 16; the algorithm is that of C. Lawson and R. Hanson, Solving Least Squares Problems,
1974, chapter 23.

Neighbouring samples have nearly equal rows, so the noise decides at which of them a limit is reached. The problem is
therefore solved repeatedly with simulated noise. Directions that hardly scatter then are determined by the limits,
whichever samples are involved; a limit that is reached in few of the repetitions determines nothing.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.free_axes import AxisKey, FreeAxis
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.optimize.limits.linear_limits import touching_pairs
from kennfeld.optimize.problem.limit_nodes import LimitSide
from kennfeld.optimize.strategies.limit_excess import NearActiveSamples
from kennfeld.optimize.trust.inverse import Inverse
from kennfeld.preprocessing.binding import BoundDataset

ROUNDING = 1e-12  # relative to the largest number
RIDGE = 1e-10  # on the unit diagonal of G, so that of two equal rows the one with the smaller excess gives way
RANK_TOLERANCE = 1e-9  # of the largest eigenvalue of G
NOISE_DRAWS = 200
MAX_HELD_VARIANCE = 0.25  # of a direction, relative to that without limits, for it to count as held
MIN_STRENGTH = 0.1  # relative to the parameter that is held most, for another one to be named
MAX_NAMED = 3  # parameters in a sentence


@dataclass(frozen=True)
class ActiveOutputLimits:
    """Samples at which output limits are reached.

    `presses` marks those with a positive multiplier. `rows` are linear combinations of their gradients, one for each
    direction of the values that is held, and `sides` the number of the limit side that contributes most to it.
    """

    touched: NearActiveSamples
    presses: Bool  # Bool[samples]
    rows: Float  # Float[held, values]
    sides: Int  # Int[held]


def find_active_output_limits(
    touched: NearActiveSamples, rows: Float, inverse: Inverse, gradient: Float, dispersion: float
) -> ActiveOutputLimits:
    """Find the directions of the values that the output limits determine.

    Args:
        touched: the samples at which limits are reached.
        rows: gradients of the limited outputs there by the moving values; shape (samples, moving values).
        inverse: inverse of the curvature of the cost by the moving values.
        gradient: half the gradient of the cost; shape (moving values,).
        dispersion: variance per unit of cost, phi.
    """
    gram = inverse.times(rows) @ rows.T
    beyond = touched.excess - rows @ inverse.times(gradient)
    presses = multipliers(gram, beyond) > 0
    if not (presses.any() and dispersion > 0):
        return ActiveOutputLimits(touched, presses, np.zeros((0, touched.rows.shape[1])), np.zeros(0, dtype=np.int64))
    # A p scatters with the covariance phi G: independently along the eigenvectors of G, by the roots of the eigenvalues
    sizes, vectors = np.linalg.eigh(gram)
    independent = sizes > RANK_TOLERANCE * sizes[-1]
    axes, units = vectors[:, independent], np.sqrt(sizes[independent])
    held, sides = _by_side(axes * units, touched.side, _held(gram, beyond, axes, np.sqrt(dispersion) * units))
    return ActiveOutputLimits(touched, presses, (axes / units @ held).T @ touched.rows, sides)


def _held(gram: Float, beyond: Float, axes: Float, units: Float) -> Float:
    """Return the directions that hardly scatter while the limits are kept, as columns in terms of the axes.

    `axes` are directions of the samples that scatter independently without the limits, by `units`.
    """
    noise = np.random.default_rng(0).standard_normal((NOISE_DRAWS, units.size)) * units @ axes.T
    # the step within the limits reaches A p - b = v - G l
    ends = [excess - gram @ multipliers(gram, excess) for excess in beyond + noise]
    # in units of the scatter without limits, which is 1 in each direction
    covariance = np.cov((np.array(ends) @ axes / units).T).reshape(units.size, units.size)
    variances, directions = np.linalg.eigh(covariance)
    return directions[:, variances < MAX_HELD_VARIANCE]


def _by_side(samples: Float, sides: Int, held: Float) -> tuple[Float, Int]:
    """Return another basis of the held directions, each belonging to one side as far as possible, and these sides.

    `samples` are the rows of the samples in the same coordinates.
    """
    rest, columns, numbers = held, [held[:, :0]], []
    known = np.unique(sides).tolist()
    while rest.shape[1]:
        # cosines of the principal angles between the rest and the span of each side, the largest first
        angles = {side: np.linalg.svd(_span(samples[sides == side]).T @ rest)[1:] for side in known}
        side = max(known, key=lambda number: float(np.max(angles[number][0], initial=0.0)))
        rotated = rest @ angles[side][1].T
        columns.append(rotated[:, :1])
        numbers.append(side)
        rest = rotated[:, 1:]
    return np.hstack(columns), np.array(numbers, dtype=np.int64)


def _span(rows: Float) -> Float:
    """Return an orthonormal basis of the row space, as columns."""
    _, sizes, right = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(right[sizes > RANK_TOLERANCE**0.5 * sizes[:1]].T)


def multipliers(gram: Float, beyond: Float) -> Float:
    """Minimise l'Gl / 2 - l'v over l >= 0, Float[samples], for G Float[samples, samples] and v, which is `beyond`.

    >>> multipliers(np.eye(2), np.array([3.0, -1.0])).round(6).tolist()
    [3.0, 0.0]
    """
    units = np.sqrt(np.maximum(np.diag(gram), 0.0))
    usable = np.flatnonzero(units > ROUNDING * units.max(initial=0.0))
    scaled = gram[np.ix_(usable, usable)] / np.outer(units[usable], units[usable])
    result = np.zeros(beyond.size)
    result[usable] = _lawson_hanson(scaled, beyond[usable] / units[usable]) / units[usable]
    return result


def _lawson_hanson(gram: Float, beyond: Float) -> Float:
    """Return `multipliers` for a matrix G of unit diagonal."""
    size = beyond.size
    values, inside = np.zeros(size), np.zeros(size, dtype=bool)  # l, and its passive set
    tolerance = 1e-10 * float(np.abs(beyond).max(initial=0.0))
    for _ in range(3 * size):
        # the steepest multiplier enters the passive set; ends once none would lower the cost
        slope = np.where(inside, -np.inf, beyond - gram @ values)
        best = int(slope.argmax())
        if not slope[best] > tolerance:
            break
        inside[best] = True
        values = _minimise_inside(gram, beyond, values, inside)
        if not inside[best]:  # linearly dependent on the passive set
            beyond = np.where(np.arange(size) == best, -np.inf, beyond)
    return values


def _minimise_inside(gram: Float, beyond: Float, values: Float, inside: Bool) -> Float:
    """Return the best point of the passive set, starting from `values`; drop what turns negative, in place."""
    while inside.any():
        target = np.zeros(values.size)
        block = gram[np.ix_(inside, inside)] + RIDGE * np.eye(int(inside.sum()))
        target[inside] = np.linalg.solve(block, beyond[inside])
        low = inside & (target <= 0)
        if not low.any():
            return target
        # as far towards the target as all stay >= 0; those that reach 0 leave
        share = float(np.min(values[low] / np.maximum(values[low] - target[low], 1e-300)))
        values = np.where(inside, values + share * (target - values), 0.0)
        inside &= ~(low & (values <= ROUNDING * np.abs(values).max(initial=0.0)))
        values = np.where(inside, values, 0.0)
    return values


@dataclass(frozen=True)
class ActiveLimit:
    """A limit that is reached at the end of a fit.

    Attributes:
        limit: the limit.
        sentence: where it is reached and what it determines.
        samples: number of training samples at which it is reached; 0 for a limit of values.
        directions: number of independent combinations of values that it determines instead of the data.
        parameters: the parameters of these values, the most affected first.
    """

    limit: str
    sentence: str
    samples: int
    directions: int
    parameters: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.sentence


def describe_output_limits(
    pressed: ActiveOutputLimits,
    sides: Sequence[LimitSide],
    bounds: Sequence[BoundDataset],
    columns: Mapping[str, Int],
    sizes: Float,
) -> Iterator[ActiveLimit]:
    """Describe the output limits that are reached.

    Args:
        pressed: where they are reached, and the directions that they hold.
        sides: the sides of all output limits.
        bounds: the training data.
        columns: columns of each parameter among all values.
        sizes: effect of each value alone on the training data; shape (values,).
    """
    touched = pressed.touched
    for number in np.unique(touched.side).tolist():
        reached = touched.side == number
        count, presses = int(reached.sum()), reached & pressed.presses
        first = int(np.flatnonzero(presses if presses.any() else reached)[0])
        # samples are counted from 1 in messages
        where = f"sample {touched.sample[first] + 1} of {bounds[touched.data[first]].dataset.name}"
        where = f"at {count} samples, e.g. {where}" if count > 1 else f"at {where}"
        rows = pressed.rows[pressed.sides == number]
        names = _held_parameters(rows, columns, sizes)
        more = ", ..." if len(names) > MAX_NAMED else ""
        values = f"{combinations_of_values(len(rows))} of {', '.join(names[:MAX_NAMED])}{more}"
        effect = f". It, not the data, determines {values}." if len(rows) else ", but does not affect the result."
        limit = str(sides[number])
        yield ActiveLimit(limit, f"The limit {limit} is reached {where}{effect}", count, len(rows), names)


def combinations_of_values(count: int) -> str:
    """Return how many independent combinations of values there are, in words."""
    return "one combination of values" if count == 1 else f"{count} combinations of values"


def _held_parameters(rows: Float, columns: Mapping[str, Int], sizes: Float) -> tuple[str, ...]:
    """Return the parameters with a large part in the held directions, largest first."""
    parts = np.where(sizes > 0, np.abs(rows).max(axis=0, initial=0.0) / np.where(sizes > 0, sizes, 1.0), 0.0)
    strength = {name: float(parts[at].max(initial=0.0)) for name, at in columns.items()}
    largest = max(strength.values(), default=0.0)
    # rounded, so that rounding errors decide no order
    ranked = sorted(strength, key=lambda name: -round(strength[name] / (largest or 1.0), 6))
    return tuple(name for name in ranked if strength[name] >= MIN_STRENGTH * largest > 0)


def describe_distances(
    axes: Mapping[AxisKey, FreeAxis], values: ValueLayout, full: Float, names: Mapping[AxisKey, str]
) -> Iterator[ActiveLimit]:
    """Describe neighbouring breakpoints at their minimum distance, given free and fixed values, Float[values]."""
    for key, axis in axes.items():
        at = values.moving.get(key, values.free)
        points = full[at : at + len(axis.axis)]
        least = axis.axis.least_distance
        for i in touching_pairs(points, least).tolist() if at < values.free else ():
            pair = f"Breakpoints {i + 1} and {i + 2} of {names[key]} ({points[i]:.6g} and {points[i + 1]:.6g})"
            sentence = f"{pair} are at their minimum distance ({least:.4g}). Consider fewer breakpoints."
            yield ActiveLimit(f"minimum distance of {names[key]}", sentence, 0, 1, (names[key],))
