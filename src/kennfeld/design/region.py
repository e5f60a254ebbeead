"""The region that a bench may be driven in: ranges, conditions, boundary curves, and the envelope of the data."""

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Dataset
from kennfeld.graph import Graph
from kennfeld.preprocessing.calculated import holds

MOST_JOINT = 4  # channels up to which the envelope is one convex hull; of more, those of all pairs
HULL_TOLERANCE = 1e-9  # of the range of a channel
Columns = Mapping[str, Float]  # by channel, Float[points]


@dataclass(frozen=True, eq=False)
class RegionCondition:
    """A formula that holds in the region, or, if `forbidden`, nowhere in it."""

    text: str
    graph: Graph
    forbidden: bool = False

    def admits(self, columns: Columns) -> Bool:
        """Mark the points that satisfy the condition, Bool[points]; NaN does not."""
        needed = {name: columns[name] for name in self.graph.inputs}
        true = holds(self.graph, Dataset.of("points", needed or dict(columns)))
        return ~true if self.forbidden else true

    def __str__(self) -> str:
        return f"forbidden {self.text}" if self.forbidden else self.text


@dataclass(frozen=True, eq=False)
class BoundaryCurve:
    """A limit of one channel that depends on another, such as the full load over speed; constant beyond its ends."""

    channel: str
    over: str
    breakpoints: Float  # Float[points], rising
    limits: Float  # Float[points]
    above: bool = False  # True if the channel lies above the curve

    def admits(self, columns: Columns) -> Bool:
        """Mark the points on the right side of the curve, Bool[points]."""
        limit = np.interp(columns[self.over], self.breakpoints, self.limits)
        return np.asarray(columns[self.channel] >= limit if self.above else columns[self.channel] <= limit)

    def __str__(self) -> str:
        return f"{self.channel} {'above' if self.above else 'below'} its curve over {self.over}"


class DataEnvelope:
    """The convex hull of measured points, of all channels together or, of more than four, of every pair of them.

    Args:
        columns: the measured points by channel; those with NaN are left out.

    >>> envelope = DataEnvelope({"x": np.array([0.0, 1.0, 0.0]), "y": np.array([0.0, 0.0, 1.0])})
    >>> envelope.admits({"x": np.array([0.2, 0.9]), "y": np.array([0.2, 0.9])})
    array([ True, False])
    """

    def __init__(self, columns: Columns) -> None:
        stacked = np.column_stack(list(columns.values()))
        stacked = stacked[np.isfinite(stacked).all(axis=1)]
        self._low = stacked.min(axis=0, initial=np.inf)
        spans = stacked.max(axis=0, initial=-np.inf) - self._low
        # a constant channel has no direction of its own in a hull
        self._names = [name for name, span in zip(columns, spans, strict=True) if span > 0]
        self._constants = {n: float(low) for n, low, s in zip(columns, self._low, spans, strict=True) if not s > 0}
        moving = spans > 0
        self._low, self._span = self._low[moving], spans[moving]
        self._points = (stacked[:, moving] - self._low) / self._span

    @cached_property
    def _hulls(self) -> list[tuple[list[int], Float]]:
        """The channels of each hull, and its planes n x + c <= 0 as rows (n, c)."""
        size = len(self._names)
        groups = [list(range(size))] if size <= MOST_JOINT else [[i, j] for j in range(size) for i in range(j)]
        return [(group, _planes(self._points[:, group])) for group in groups if group]

    def admits(self, columns: Columns) -> Bool:
        """Mark the points within the envelope, Bool[points]."""
        count = len(next(iter(columns.values())))
        inside = np.ones(count, dtype=bool)
        for name, value in self._constants.items():
            inside &= np.isclose(columns[name], value, rtol=1e-9, atol=1e-12)
        if not self._names:
            return inside
        points = (np.column_stack([columns[name] for name in self._names]) - self._low) / self._span
        for group, planes in self._hulls:
            inside &= (points[:, group] @ planes[:, :-1].T + planes[:, -1] <= HULL_TOLERANCE).all(axis=1)
        return inside

    def __str__(self) -> str:
        return "the envelope of the data"


def _planes(points: Float) -> Float:
    """Return the planes of the convex hull of points, Float[points, channels], as rows (n, c)."""
    if points.shape[1] == 1:
        return np.array([[-1.0, float(points.min())], [1.0, -float(points.max())]])
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(ConvexHull(points).equations)
    except QhullError:
        # points on a line or in a plane have no volume: joggled by less than a bench can hold
        return np.asarray(ConvexHull(points, qhull_options="QJ").equations)


@dataclass(frozen=True, eq=False)
class BenchRegion:
    """The region in which points may be measured.

    Attributes:
        ranges: lower and upper end of each channel; equal ones keep it constant.
        limits: conditions, boundary curves and envelopes, all of which hold.
    """

    ranges: Mapping[str, tuple[float, float]]
    limits: Sequence[RegionCondition | BoundaryCurve | DataEnvelope] = ()

    def admits(self, columns: Columns) -> Bool:
        """Mark the points within the region, Bool[points]."""
        count = len(next(iter(columns.values()))) if columns else 0
        inside = np.ones(count, dtype=bool)
        for name, (low, high) in self.ranges.items():
            slack = HULL_TOLERANCE * (high - low)
            inside &= (columns[name] >= low - slack) & (columns[name] <= high + slack)
        for limit in self.limits:
            inside &= limit.admits(columns)
        return inside

    def require_room(self, columns: Columns, location: Location) -> None:
        """Raise `InputError` if none of some points is within the region, naming the limits that exclude most."""
        if self.admits(columns).any():
            return
        alone = [str(limit) for limit in self.limits if not limit.admits(columns).any()]
        message = "no point satisfies all limits"
        if alone:
            message = f"no point within the ranges satisfies {join_names(alone, 3, ' or ')}"
        ranges = join_names([f"{name} {low:g} to {high:g}" for name, (low, high) in self.ranges.items()])
        raise InputError.of(location, message, f"Check the limits; the ranges are {ranges}.")


def contradictions(ranges: Mapping[str, tuple[float, float]], location: Location) -> list[Finding]:
    """Return the ranges whose ends are reversed or not finite."""
    return [
        Finding(location.within(f"ranges {name}"), f"{low:g} exceeds {high:g}", "Swap them.")
        if low > high
        else Finding(location.within(f"ranges {name}"), f"must have finite ends, got {low:g} and {high:g}")
        for name, (low, high) in ranges.items()
        if low > high or not np.isfinite([low, high]).all()
    ]
