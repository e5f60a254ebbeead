"""Which directions of the values limits of outputs hold at the end of a fit, as rows kept with equality.

Near the end, keeping the limits A p <= b in a quadratic cost is a small problem in the multipliers l of the samples at
which they are met: the least l'Gl / 2 - l'v over l >= 0, with G = A C A', C the inverse of the curvature, and v how far
the best step without the limits would exceed them (J. Nocedal and S. Wright, Numerical Optimization, chapter 16; the
search is that of C. Lawson and R. Hanson, Solving Least Squares Problems, 1974, chapter 23).

Neighbouring samples have nearly equal rows, and which of them a limit is met at is a matter of noise. So the problem is
solved again and again with the noise of other measurements. What hardly scatters then, of what would scatter evenly
without the limits, is held, whichever samples do it; a limit that is met only now and then holds nothing.

Which limits hold what at the end of a fit, in words: those of outputs, and the distance of breakpoints.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.free_axes import AxisKey, FreeAxis
from kennfeld.graph.value_layout import ValueLayout
from kennfeld.optimize.limit_nodes import LimitSide
from kennfeld.optimize.linear_limits import touching_pairs
from kennfeld.optimize.strategies.output_limits import NearActiveSamples
from kennfeld.optimize.trust.inverse import Inverse
from kennfeld.preprocessing.binding import BoundDataset

__all__ = ["ActiveLimit", "ActiveOutputLimits", "distances", "find_active_output_limits", "multipliers", "outputs_held"]

NOTHING = 1e-12  # of the largest, what is rounding
RIDGE = 1e-10  # so that of two equal rows the one that asks for less gives way
ALIKE = 1e-9  # of the largest eigenvalue of G, below which rows tell nothing apart
DRAWS = 200  # of the noise
HELD = 0.25  # variance of a direction, of that without limits, below which it counts as held

SLIGHT = 0.1  # of what is held most, that another parameter needs to be named
NAMED = 3  # parameters that a sentence names


@dataclass(frozen=True)
class ActiveOutputLimits:
    """Samples at which limits of outputs are met.

    `presses` marks those that the cost presses against the limit. `rows` are mixtures of their slopes, one for each
    direction of the values that is held, and `sides` the number of the side that holds it most.
    """

    touched: NearActiveSamples
    presses: Bool  # Bool[samples]
    rows: Float  # Float[held, values]
    sides: Int  # Int[held]


def find_active_output_limits(
    touched: NearActiveSamples, rows: Float, inverse: Inverse, gradient: Float, dispersion: float
) -> ActiveOutputLimits:
    """What the limits hold; rows, inverse of the curvature and half the gradient are over the values that move.

    `dispersion` is the noise of the cost, phi.
    """
    gram = inverse.times(rows) @ rows.T
    beyond = touched.excess - rows @ inverse.times(gradient)
    presses = multipliers(gram, beyond) > 0
    if not (presses.any() and dispersion > 0):
        return ActiveOutputLimits(touched, presses, np.zeros((0, touched.rows.shape[1])), np.zeros(0, dtype=np.int64))
    sizes, vectors = np.linalg.eigh(gram)
    apart = sizes > ALIKE * sizes[-1]
    axes, units = vectors[:, apart], np.sqrt(sizes[apart])
    held, sides = _by_side(axes * units, touched.side, _held(gram, beyond, axes, np.sqrt(dispersion) * units))
    return ActiveOutputLimits(touched, presses, (axes / units @ held).T @ touched.rows, sides)


def _held(gram: Float, beyond: Float, axes: Float, units: Float) -> Float:
    """Directions that hardly scatter where the limits are kept, as columns in terms of the axes.

    `axes` are directions of the samples that scatter independently without the limits, by `units`.
    """
    noise = np.random.default_rng(0).standard_normal((DRAWS, units.size)) * units @ axes.T
    ends = [drawn - gram @ multipliers(gram, drawn) for drawn in beyond + noise]
    left = np.cov((np.array(ends) @ axes / units).T).reshape(units.size, units.size)
    shares, mixed = np.linalg.eigh(left)
    found: Float = mixed[:, shares < HELD]
    return found


def _by_side(samples: Float, sides: Int, held: Float) -> tuple[Float, Int]:
    """Other columns that span the same directions, each of one side as far as that is possible; and these sides.

    `samples` are the rows of the samples in the same terms.
    """
    left, found, numbers = held, [held[:, :0]], []
    known = np.unique(sides).tolist()
    while left.shape[1]:
        turned = {side: np.linalg.svd(_span(samples[sides == side]).T @ left)[1:] for side in known}
        side = max(known, key=lambda number: float(np.max(turned[number][0], initial=0.0)))
        mixed = left @ turned[side][1].T
        found.append(mixed[:, :1])
        numbers.append(side)
        left = mixed[:, 1:]
    return np.hstack(found), np.array(numbers, dtype=np.int64)


def _span(rows: Float) -> Float:
    """An orthonormal basis of some rows, as columns."""
    _, sizes, turned = np.linalg.svd(rows, full_matrices=False)
    found: Float = turned[sizes > ALIKE**0.5 * sizes[:1]].T
    return found


def multipliers(gram: Float, beyond: Float) -> Float:
    """The l >= 0 of least l'Gl / 2 - l'v; few of them are not 0.

    >>> multipliers(np.eye(2), np.array([3.0, -1.0])).round(6).tolist()
    [3.0, 0.0]
    """
    units = np.sqrt(np.maximum(np.diag(gram), 0.0))
    usable = np.flatnonzero(units > NOTHING * units.max(initial=0.0))
    scaled = gram[np.ix_(usable, usable)] / np.outer(units[usable], units[usable])
    found = np.zeros(beyond.size)
    found[usable] = _lawson_hanson(scaled, beyond[usable] / units[usable]) / units[usable]
    return found


def _lawson_hanson(gram: Float, wanted: Float) -> Float:
    """For a diagonal of ones."""
    size = wanted.size
    at, inside = np.zeros(size), np.zeros(size, dtype=bool)
    enough = 1e-10 * float(np.abs(wanted).max(initial=0.0))
    for _ in range(3 * size):
        slope = np.where(inside, -np.inf, wanted - gram @ at)
        best = int(slope.argmax())
        if not slope[best] > enough:
            break
        inside[best] = True
        at = _within(gram, wanted, at, inside)
        if not inside[best]:  # it says nothing that those inside do not say
            wanted = np.where(np.arange(size) == best, -np.inf, wanted)
    return at


def _within(gram: Float, wanted: Float, at: Float, inside: Bool) -> Float:
    """The best point of those inside, from `at`; what turns negative on the way leaves, in place."""
    while inside.any():
        aim = np.zeros(at.size)
        block = gram[np.ix_(inside, inside)] + RIDGE * np.eye(int(inside.sum()))
        aim[inside] = np.linalg.solve(block, wanted[inside])
        low = inside & (aim <= 0)
        if not low.any():
            return aim
        share = float(np.min(at[low] / np.maximum(at[low] - aim[low], 1e-300)))
        at = np.where(inside, at + share * (aim - at), 0.0)
        inside &= ~(low & (at <= NOTHING * np.abs(at).max(initial=0.0)))
        at = np.where(inside, at, 0.0)
    return at


@dataclass(frozen=True)
class ActiveLimit:
    """A limit that is met at the end of a fit.

    Attributes:
        limit: the limit.
        sentence: what it holds.
        samples: training samples at which it is met; 0 for a limit of values.
        directions: how many independent changes of the values it decides in place of the data.
        parameters: those that it holds, the most firmly held first.
    """

    limit: str
    sentence: str
    samples: int
    directions: int
    parameters: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.sentence


def outputs_held(
    pressed: ActiveOutputLimits,
    sides: Sequence[LimitSide],
    bounds: Sequence[BoundDataset],
    columns: Mapping[str, Int],
    sizes: Float,
) -> Iterator[ActiveLimit]:
    """The limits of outputs that are met; `sizes` is how far each value would move the data, alone.

    `columns` are those of each parameter among all values.
    """
    touched = pressed.touched
    for number in np.unique(touched.side).tolist():
        mine = touched.side == number
        count, presses = int(mine.sum()), mine & pressed.presses
        first = int(np.flatnonzero(presses if presses.any() else mine)[0])
        where = f"sample {touched.sample[first]} of {bounds[touched.data[first]].dataset.name}"
        met = f"is met at {count} samples, as at {where}" if count > 1 else f"is met at {where}"
        rows = pressed.rows[pressed.sides == number]
        limit = str(sides[number])
        if not len(rows):
            sentence = f"The limit {limit} {met}. It holds nothing: the data keep the values there by themselves."
            yield ActiveLimit(limit, sentence, count, 0)
            continue
        names = _strongest(rows, columns, sizes)
        more = ", ..." if len(names) > NAMED else ""
        changes = "one change" if len(rows) == 1 else f"{len(rows)} changes"
        told = f"It decides {changes} of {', '.join(names[:NAMED])}{more} in place of the data."
        yield ActiveLimit(limit, f"The limit {limit} {met}. {told}", count, len(rows), names)


def _strongest(rows: Float, columns: Mapping[str, Int], sizes: Float) -> tuple[str, ...]:
    """The parameters that a limit holds, most first."""
    each = np.where(sizes > 0, np.abs(rows).max(axis=0) / np.where(sizes > 0, sizes, 1.0), 0.0)
    strength = {name: float(each[at].max(initial=0.0)) for name, at in columns.items()}
    most = max(strength.values(), default=0.0)
    ranked = sorted(strength, key=lambda name: -round(strength[name] / (most or 1.0), 6))  # no order by rounding errors
    return tuple(name for name in ranked if strength[name] >= SLIGHT * most and most > 0)


def distances(
    axes: Mapping[AxisKey, FreeAxis], values: ValueLayout, full: Float, names: Mapping[AxisKey, str]
) -> Iterator[ActiveLimit]:
    """Neighbouring breakpoints that stand as close as they may."""
    for key, axis in axes.items():
        at = values.moving.get(key, values.free)
        points = full[at : at + len(axis.axis)]
        least = axis.axis.least_distance
        for i in touching_pairs(points, least).tolist() if at < values.free else ():
            pair = f"Breakpoints {i + 1} and {i + 2} of {names[key]} ({points[i]:.6g} and {points[i + 1]:.6g})"
            sentence = f"{pair} stand at their least distance {least:.4g} and move as one: fewer may do."
            yield ActiveLimit(f"least distance of {names[key]}", sentence, 0, 1, (names[key],))
