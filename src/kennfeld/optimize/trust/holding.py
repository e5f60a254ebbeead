"""Which limits hold what at the end of a fit, in words: those of outputs, and the distance of breakpoints."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.graph.free_axes import AxisKey, FreeAxis
from kennfeld.native import Values
from kennfeld.optimize.data.binding import Bound
from kennfeld.optimize.free_axes.breakpoints import touching_pairs
from kennfeld.optimize.limits.sides import Side
from kennfeld.optimize.trust.pressing import Pressed

__all__ = ["Holding", "distances", "outputs_held"]

SLIGHT = 0.1  # of what is held most, that another parameter needs to be named
NAMED = 3  # parameters that a sentence names


@dataclass(frozen=True)
class Holding:
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
    pressed: Pressed, sides: Sequence[Side], bounds: Sequence[Bound], columns: Mapping[str, Int], sizes: Float
) -> Iterator[Holding]:
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
            yield Holding(limit, sentence, count, 0)
            continue
        names = _strongest(rows, columns, sizes)
        more = ", ..." if len(names) > NAMED else ""
        changes = "one change" if len(rows) == 1 else f"{len(rows)} changes"
        told = f"It decides {changes} of {', '.join(names[:NAMED])}{more} in place of the data."
        yield Holding(limit, f"The limit {limit} {met}. {told}", count, len(rows), names)


def _strongest(rows: Float, columns: Mapping[str, Int], sizes: Float) -> tuple[str, ...]:
    """The parameters that a limit holds, most first."""
    each = np.where(sizes > 0, np.abs(rows).max(axis=0) / np.where(sizes > 0, sizes, 1.0), 0.0)
    strength = {name: float(each[at].max(initial=0.0)) for name, at in columns.items()}
    most = max(strength.values(), default=0.0)
    ranked = sorted(strength, key=lambda name: -round(strength[name] / (most or 1.0), 6))  # no order by rounding errors
    return tuple(name for name in ranked if strength[name] >= SLIGHT * most and most > 0)


def distances(
    axes: Mapping[AxisKey, FreeAxis], values: Values, full: Float, names: Mapping[AxisKey, str]
) -> Iterator[Holding]:
    """Neighbouring breakpoints that stand as close as they may."""
    for key, axis in axes.items():
        at = values.moving.get(key, values.free)
        points = full[at : at + len(axis.axis)]
        least = axis.axis.least_distance
        for i in touching_pairs(points, least).tolist() if at < values.free else ():
            pair = f"Breakpoints {i + 1} and {i + 2} of {names[key]} ({points[i]:.6g} and {points[i + 1]:.6g})"
            sentence = f"{pair} stand at their least distance {least:.4g} and move as one: fewer may do."
            yield Holding(f"least distance of {names[key]}", sentence, 0, 1, (names[key],))
