"""Long signals reduced to a bounded number of points for a picture, in one pass over their parts."""

from dataclasses import field

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass


class TraceEnvelope:
    """Reduces traces to at most `most` points: the minimum and the maximum of each group of consecutive samples."""

    def __init__(self, count: int, most: int) -> None:
        self.count, self.whole = count, count <= most
        # each group gives two points
        self.size = 1 if self.whole else -(-count // max(most // 2, 1))
        self.groups = -(-count // self.size)

    def firsts(self, first: int, last: int) -> Int:
        """Return the first samples of the groups that begin from `first` to before `last`, Int[groups]."""
        return np.arange(-(-first // self.size) * self.size, last, self.size)


@dataclass
class Trace:
    """The smallest and the largest number of each group of samples of one signal.

    >>> groups, trace = TraceEnvelope(8, most=4), Trace()
    >>> for first in (0, 6):
    ...     trace.add(groups, first, np.array([0.0, 5, 1, 2, 3, 3, 9, -1])[first : first + 6])
    >>> trace.points(groups)
    array([ 0.,  5., -1.,  9.])
    """

    ranges: list[tuple[int, Float, Float]] = field(default_factory=list)  # of the groups from a number on

    def add(self, groups: TraceEnvelope, first: int, values: Float) -> None:
        """Add consecutive samples, Float[samples], of which the first has this number."""
        if not values.size:
            return
        if groups.size == 1:
            own = values.astype(np.float64)  # a copy: the array may be a view of a large one
            self.ranges.append((first, own, own))
            return
        number = first // groups.size
        edges = np.arange(number * groups.size, first + values.size, groups.size) - first
        # the first group may have begun in the part before
        edges[0] = 0
        self.ranges.append((number, np.fmin.reduceat(values, edges), np.fmax.reduceat(values, edges)))

    def merge(self, later: "Trace") -> None:
        """Take in the ranges of later samples."""
        self.ranges += later.ranges

    def points(self, groups: TraceEnvelope) -> Float:
        """Return minimum and maximum of each group in turn, Float[2 groups]; or the values, Float[samples], if few.

        A group without numbers is NaN.
        """
        if groups.whole and sum(values.size for _, values, _ in self.ranges) == groups.count:
            return np.concatenate([np.zeros(0), *(values for _, values, _ in self.ranges)])
        pair = np.full((groups.groups, 2), np.nan)
        for number, low, high in self.ranges:
            part = pair[number : number + low.size]
            np.fmin(part[:, 0], low, out=part[:, 0])
            np.fmax(part[:, 1], high, out=part[:, 1])
        return pair[:, 0] if groups.whole else pair.ravel()
