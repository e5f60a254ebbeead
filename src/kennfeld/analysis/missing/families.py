"""Families of candidates: columns that are hat functions of channels, or series in time, times the slope by a node."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kennfeld.analysis.missing.probes import Probes, factor, offset
from kennfeld.analysis.missing.recordings import RECORDING
from kennfeld.analysis.missing.terms import Kind, MissingTerm
from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.models.formula.functions import FUNCTIONS
from kennfeld.native.hat_products import MAX_FACTORS

T = TypeVar("T")  # Python 3.11

MAX_ENTRIES = 4_000_000  # of the products of the values with the columns of a family, 32 MB
MAX_COLUMNS = 1536  # with many states, a row of a sample has all columns of a family
MAX_STORED = 8_000_000  # numbers of series, 64 MB


@dataclass(frozen=True)
class HatAxis:
    """The hat functions of a channel, one for each breakpoint.

    >>> HatAxis("x", "x", (0.0, 1.0, 3.0)).positions(np.array([-1.0, 0.5, 2.0])).tolist()
    [0.0, 0.5, 1.5]
    """

    name: str  # the input of the function
    channel: str  # of the data
    points: tuple[float, ...]

    def positions(self, values: Float) -> Float:
        """Return the number of the hat before each value plus the weight of the next one; of NaN, the middle."""
        positions: Float = np.interp(values, self.points, np.arange(len(self.points)))
        unknown = np.isnan(positions)
        if unknown.any():
            positions[unknown] = 0.5 * (len(self.points) - 1)
        return positions

    @property
    def single(self) -> tuple["HatAxis", ...]:
        """The axes of single channels."""
        return (self,)


@dataclass(frozen=True)
class ProductAxis:
    """The product of two channels, each by its place between the breakpoints, from -1 to 1, as an axis of two hats.

    One column tells whether two channels act together, for a small part of what all values of a map cost.
    """

    first: HatAxis
    second: HatAxis
    points: tuple[float, ...] = (-1.0, 1.0)

    @property
    def single(self) -> tuple[HatAxis, ...]:
        """The axes of single channels."""
        return (self.first, self.second)


@dataclass(frozen=True)
class Series:
    """A change of a node in time: that by a lag or a delay."""

    node: str
    kind: Kind
    seconds: float = 0.0
    steps: int = 0

    @property
    def name(self) -> str:
        """The name of the node that computes it; no formula text can contain it."""
        return f"\0{self.node} {self.kind} {self.seconds!r} {self.steps}"


@dataclass(frozen=True)
class Family:
    """Candidates that are scored together: each factor with each axis.

    Attributes:
        factors: names of the probes whose slopes are the factors.
        terms: by factor, then by axis.
        axes: of channels; none if the columns are series.
        series: what each factor is multiplied with, if there are no axes.
        grid: True for maps over the two axes, whose hats are the products of those of the axes.
    """

    factors: tuple[str, ...]
    terms: tuple[tuple[MissingTerm, ...], ...]
    axes: tuple[HatAxis, ...] | tuple[ProductAxis, ...] = ()
    series: tuple[Series, ...] = ()
    grid: bool = False

    @property
    def hats(self) -> tuple[int, ...]:
        """Number of hats of each axis, or of the map."""
        if self.grid:
            return (math.prod(len(axis.points) for axis in self.axes),)
        return tuple(len(axis.points) for axis in self.axes) or (1,)


def channel_families(
    probes: Probes, axes: Sequence[HatAxis], kinds: Sequence[Kind], constant: frozenset[str], values: int
) -> Iterator[Family]:
    """Yield the families of curves of channels.

    Args:
        probes: the nodes.
        axes: the channels.
        kinds: the forms of terms that take part.
        constant: nodes that are constant, to which adding a curve is the same as scaling by it.
        values: number of free values.
    """
    for some in _groups(_places(probes, kinds, constant), MAX_FACTORS):
        most = max(min(MAX_ENTRIES // max(values, 1), MAX_COLUMNS) // len(some), 1)
        for own in _by_hats(axes, most):
            terms = tuple(
                tuple(MissingTerm(node, kind, axis.name, axis.points) for axis in own) for _, node, kind in some
            )
            yield Family(tuple(name for name, _, _ in some), terms, own)


def _places(probes: Probes, kinds: Sequence[Kind], constant: frozenset[str]) -> list[tuple[str, str, Kind]]:
    """Return probe, node and kind of each place where a table of channels may be missing."""
    names: dict[Kind, Callable[[int], str]] = {"add": offset, "multiply": factor}
    return [
        (name(number), node, kind)
        for number, node in enumerate(probes.nodes)
        for kind, name in names.items()
        if kind in kinds and not (kind == "add" and node in constant and "multiply" in kinds)
    ]


def product_families(
    probes: Probes, pairs: Sequence[tuple[HatAxis, HatAxis]], kind: Kind, values: int
) -> Iterator[Family]:
    """Yield the families of products of two channels; see `channel_families`."""
    for some in _groups(_places(probes, [kind], frozenset()), MAX_FACTORS):
        most = max(min(MAX_ENTRIES // max(values, 1), MAX_COLUMNS) // len(some) // 2, 1)
        for own in _groups(pairs, most):
            terms = tuple(
                tuple(MissingTerm(node, each, a.name, a.points, second=b.name) for a, b in own)
                for _, node, each in some
            )
            yield Family(tuple(name for name, _, _ in some), terms, tuple(ProductAxis(a, b) for a, b in own))


def map_families(
    probes: Probes,
    pairs: Sequence[tuple[HatAxis, HatAxis]],
    kinds: Sequence[Kind],
    constant: frozenset[str],
    values: int,
) -> Iterator[Family]:
    """Yield the families of maps of two channels, one pair each; see `channel_families`."""
    for a, b in pairs:
        size = len(a.points) * len(b.points)
        most = max(min(MAX_ENTRIES // max(values, 1), MAX_COLUMNS) // size, 1)
        for some in _groups(_places(probes, kinds, constant), min(most, MAX_FACTORS)):
            terms = tuple(
                (MissingTerm(node, kind, a.name, a.points, second=b.name, second_breakpoints=b.points),)
                for _, node, kind in some
            )
            yield Family(tuple(name for name, _, _ in some), terms, (a, b), grid=True)


def offset_families(probes: Probes, constant: frozenset[str], recordings: int) -> Iterator[Family]:
    """Yield the families of offsets of each recording, at the nodes that are not constant."""
    points = tuple(float(number) for number in range(recordings + 1))
    pairs = [(offset(number), node) for number, node in enumerate(probes.nodes) if node not in constant]
    for some in _groups(pairs, MAX_FACTORS):
        terms = tuple((MissingTerm(node, "offset", breakpoints=points),) for _, node in some)
        yield Family(tuple(name for name, _ in some), terms, (HatAxis(RECORDING, RECORDING, points),))


def _by_hats(axes: Sequence[HatAxis], most: int) -> Iterator[tuple[HatAxis, ...]]:
    group: list[HatAxis] = []
    for axis in axes:
        if group and sum(len(each.points) for each in [*group, axis]) > most:
            yield tuple(group)
            group = []
        group.append(axis)
    if group:
        yield tuple(group)


def _groups(items: Sequence[T], most: int) -> Iterator[Sequence[T]]:
    for first in range(0, len(items), most):
        yield items[first : first + most]


def series_families(probes: Probes, series: Sequence[Series], stored: int = 0) -> Iterator[Family]:
    """Yield the families of lags and delays.

    Args:
        probes: the nodes.
        series: the candidates.
        stored: numbers of each series that are stored.
    """
    for own in _groups(series, max(min(MAX_FACTORS, MAX_STORED // max(stored, 1)), 1)):
        terms = tuple((MissingTerm(each.node, each.kind, seconds=each.seconds, steps=each.steps),) for each in own)
        factors = tuple(offset(probes.nodes.index(each.node)) for each in own)
        yield Family(factors, terms, series=tuple(own))


def passes(families: Iterable[Family], values: int, blocks: int, stored: int = 0) -> Iterator[list[Family]]:
    """Yield families in groups, as one pass over the samples sums them up.

    Args:
        families: the candidates.
        values: number of free values.
        blocks: number of blocks.
        stored: numbers of each series that are stored.
    """
    group: list[Family] = []
    size = kept = 0
    for family in families:
        columns = len(family.factors) * sum(family.hats)
        own = columns * (values + (blocks + 1) * max(family.hats))
        series = stored * len(family.series)
        if group and (size + own > MAX_ENTRIES or kept + series > MAX_STORED):
            yield group
            group, size, kept = [], 0, 0
        group.append(family)
        size, kept = size + own, kept + series
    if group:
        yield group


def with_series(graph: Graph, series: Sequence[Series]) -> Graph:
    """Return a graph with the named nodes that compute series."""
    b = GraphBuilder.of(graph)
    names = dict(graph.names)
    for each in series:
        node = names[each.node]
        if each.kind == "lag":
            changed = int(FUNCTIONS["PT1"].rule(b, node, b.const(each.seconds), node))
        else:
            changed = b.prev(node, node, each.steps)
        names[each.name] = b.call("sub", changed, node)
    b.settle()
    return b.finish(names, graph.units, graph.outputs)


class HatPlaces:
    """Finds the hats of the axes of a family at samples.

    Args:
        axes: of channels; without any, each sample has the one hat of weight 1.
    """

    def __init__(self, axes: Sequence[HatAxis] | Sequence[ProductAxis]) -> None:
        self._firsts = np.cumsum([0, *(len(axis.points) for axis in axes[:-1])]).astype(np.int32)
        # each channel once, as many pairs share it
        numbers = {axis: at for at, axis in enumerate(dict.fromkeys(each for axis in axes for each in axis.single))}
        self._single = tuple(numbers)
        self._last = np.array([len(axis.points) - 1 for axis in numbers], dtype=np.int32)
        pairs = [axis.single for axis in axes if isinstance(axis, ProductAxis)]
        self._pairs = np.array([[numbers[axis] for axis in pair] for pair in pairs])

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels of the data that are read."""
        return tuple(axis.channel for axis in self._single)

    def locate(self, columns: Mapping[str, Float], numbers: Int) -> tuple[NDArray[np.int32], Float]:
        """Return the first hat of each axis, counted over all axes, and the weight of the next one.

        Args:
            columns: the channels, Float[all samples] each.
            numbers: of the samples.

        Returns:
            Shapes (samples, axes) each; with the one hat of a family without axes, (samples, 1).
        """
        if not self._single:
            return np.zeros((numbers.size, 1), dtype=np.int32), np.zeros((numbers.size, 1))
        positions = np.stack([axis.positions(columns[axis.channel][numbers]) for axis in self._single], axis=1)
        if self._pairs.size:
            ranks = 2 * positions / self._last - 1
            # rows of samples, as they are read; an index in place of `take` would return columns
            first, second = (ranks.take(side, axis=1) for side in self._pairs.T)
            return np.tile(self._firsts, (numbers.size, 1)), 0.5 + 0.5 * first * second
        cells = np.minimum(positions.astype(np.int32), self._last - 1)
        return cells + self._firsts, positions - cells
