"""Coordinates, cells and grid points at which a function looks up its tables, over the data."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from copy import copy
from functools import cached_property, reduce
from itertools import product

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import SAMPLES_PER_BLOCK
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.graph import Graph
from kennfeld.graph.interpolation import position
from kennfeld.graph.traversal import ancestors_in_time, dependents, with_names
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.quality.quality import NodeSimulator
from kennfeld.preprocessing.binding import BoundDataset

Located = tuple[Bool, Int, Float]  # where a coordinate is finite, its cell, and its position in the cell from 0 to 1


@dataclass(frozen=True)
class LookupBlock:
    """Coordinates of one lookup over some samples; `first` is the number of the first sample."""

    name: str
    first: int
    nodes: tuple[int, ...]  # of the graph, one per coordinate
    coordinates: tuple[Float, ...]


class Coverage:
    """The lookups of some tables; with `of_data_alone`, only those whose coordinates no parameter can change."""

    def __init__(
        self, graph: Graph, parameters: ParameterSet, names: Collection[str], *, of_data_alone: bool = False
    ) -> None:
        self._graph, self._parameters = graph, parameters
        moving = dependents(graph, lambda node: node.parameter is not None) if of_data_alone else ()
        self._lookups = [
            (node.payload, node.args)
            for node in graph.nodes
            if node.op == "lookup" and node.args and node.payload in names and not any(at in moving for at in node.args)
            if parameters[node.payload].kind != "rbf"
        ]
        places = dict.fromkeys(at for _, args in self._lookups for at in args)
        self._inputs = {at: graph.nodes[at].payload for at in places if graph.nodes[at].op == "input"}
        self._computed = {at: _hidden_name(at) for at in places if at not in self._inputs}

    def at(self, parameters: ParameterSet) -> "Coverage":
        """Return the same at other values on the same breakpoints, with what is compiled already."""
        other = copy(self)
        other._parameters = parameters
        return other

    def blocks(self, bound: BoundDataset, known: Mapping[int, Float] | None = None) -> Iterator[LookupBlock]:
        """Yield the coordinates of every lookup by blocks; `known` are values of all computed nodes, Float[samples]."""
        columns = bound.columns
        for here, computed in self._computed_blocks(bound, known):
            coordinates = computed | {at: columns[name][here] for at, name in self._inputs.items()}
            for name, args in self._lookups:
                yield LookupBlock(name, here.start, args, tuple(coordinates[at] for at in args))

    def _computed_blocks(
        self, bound: BoundDataset, known: Mapping[int, Float] | None
    ) -> Iterator[tuple[slice, dict[int, Float]]]:
        if known is None and self._computed:
            for here, values in self._simulator.blocks(bound, self._parameters):
                yield here, dict(zip(self._computed, values, strict=True))
            return
        for first in range(0, bound.count, SAMPLES_PER_BLOCK):
            here = slice(first, min(first + SAMPLES_PER_BLOCK, bound.count))
            yield here, {at: values[here] for at, values in (known or {}).items()}

    @cached_property
    def _simulator(self) -> NodeSimulator:
        """Compiled only if needed: most axes carry an input as it is, and compiling takes longer than all else here."""
        graph = with_names(self._graph, self._computed)
        return NodeSimulator(graph, self._parameters, list(self._computed.values()))


def touched(
    coverage: Coverage, parameters: Mapping[str, Parameter], bound: BoundDataset, counts: Callable[[BoundDataset], Bool]
) -> dict[str, Bool]:
    """Mark in each table the values to which the lookup of a sample gives a weight.

    Args:
        coverage: the lookups.
        parameters: tables by name.
        bound: the dataset.
        counts: the samples that count, Bool[samples].
    """
    counting = counts(bound)
    seen: dict[str, Bool] = {}
    for block in coverage.blocks(bound):
        lookup = _locate(block, parameters[block.name], {})
        mask = seen.setdefault(block.name, np.zeros(lookup.table.values.shape, dtype=bool))
        for at, weight in lookup.corners:
            # a sample on a grid point touches that one only, although its cell has others
            mask.flat[at[counting[lookup.samples] & (weight != 0)]] = True
    return seen


@dataclass(frozen=True, eq=False)
class Lookup:
    """One lookup of a table over samples from number `first`: its cell along each axis, and the position in it."""

    table: Parameter
    first: int
    known: Bool  # Bool[samples]: all coordinates are finite
    cells: tuple[Int, ...]  # an axis each, Int[samples]
    shares: tuple[Float, ...]  # an axis each, Float[samples], 0 to 1; beyond that where an end is extrapolated

    @property
    def samples(self) -> slice:
        """The range of samples in the dataset."""
        return slice(self.first, self.first + self.known.size)

    @property
    def cell(self) -> Int:
        """Flat number of the cell, over `cell_shape`."""
        cell = self.cells[0]
        for other, count in zip(self.cells[1:], cell_shape(self.table)[1:], strict=True):
            cell = cell * count + other
        return cell

    @cached_property
    def corners(self) -> tuple[tuple[Int, Float], ...]:
        """For each corner of the cell the flat grid point number and its weight, Int[samples] and Float[samples]."""
        first = self.first_corner
        return tuple((first + distance, weight) for distance, weight in self.weights())

    @property
    def first_corner(self) -> Int:
        """Flat grid point number of the corner at the beginning of the cell along all axes, Int[samples]."""
        first = self.cells[0]
        for cell, count in zip(self.cells[1:], self.table.values.shape[1:], strict=True):
            first = first * count + cell
        return first

    def weights(self) -> Iterator[tuple[int, Float]]:
        """Yield for each corner how far behind the first one its grid point is, and its weight, Float[samples]."""
        # distances in the flat table from the corner at the beginning of the cell; 0 along an axis of one breakpoint
        whole, strides = bool(self.known.all()), np.cumprod([1, *self.table.values.shape[:0:-1]])[::-1].tolist()
        sides = [
            ((0, 1.0 - share), (stride if count > 1 else 0, share))
            for share, stride, count in zip(self.shares, strides, self.table.values.shape, strict=True)
        ]
        for corner in product(*sides):
            distances, shares = zip(*corner, strict=True)
            weight = reduce(np.multiply, shares)
            yield sum(distances), weight if whole else np.where(self.known, weight, 0.0)


def unmoved_tables(graph: Graph) -> frozenset[str]:
    """Return the tables all of whose lookups have coordinates that no parameter can change."""
    moving = dependents(graph, lambda node: node.parameter is not None)
    lookups = [node for node in graph.nodes if node.op == "lookup"]
    moved = {node.payload for node in lookups if any(at in moving for at in node.args)}
    return frozenset(node.payload for node in lookups) - moved


def moving_parameters(graph: Graph) -> frozenset[str]:
    """Return the parameters whose values move a coordinate at which a table is looked up."""
    coordinates = (at for node in graph.nodes if node.op == "lookup" for at in node.args)
    sources = (graph.nodes[at].parameter for at in ancestors_in_time(graph, coordinates))
    return frozenset(name for name in sources if name is not None)


def cell_shape(table: Parameter) -> tuple[int, ...]:
    """Return the number of cells along each axis."""
    return tuple(max(count - 1, 1) for count in table.values.shape)


def coordinates(problem: Problem) -> dict[int, str]:
    """Return the nodes that are lookup coordinates but not inputs, with hidden names."""
    nodes = problem.graph.nodes
    places = dict.fromkeys(at for node in nodes if node.op == "lookup" for at in node.args)
    return {at: _hidden_name(at) for at in places if nodes[at].op != "input"}


def _hidden_name(at: int) -> str:
    return f"\0at {at}"


class Lookups:
    """The lookups of the tables on which a criterion depends, at given parameters.

    `computed` holds the values of the nodes `coordinates` for each dataset of the problem; without it they are
    simulated when needed.
    """

    def __init__(self, problem: Problem, parameters: ParameterSet, computed: Sequence[Float] = ()) -> None:
        graph = problem.graph
        self._parameters, self.states = parameters, bool(graph.states)
        searched = [n for n in graph.parameters if parameters[n].index_axes and parameters[n].kind != "rbf"]
        self.reached = {n: _reaches(problem, n) for n in searched}
        self._coverage = Coverage(graph, parameters, [n for n in searched if self.reached[n]])
        self._names = list(coordinates(problem))
        self._known = {
            data.name: dict(zip(self._names, values, strict=True))
            for data, values in zip(problem.datasets, computed, strict=False)
        }
        self._kept: dict[str, list[Lookup]] = {}

    def at(self, parameters: ParameterSet) -> "Lookups":
        """Return the lookups at other values on the same breakpoints, with what is compiled already."""
        other = copy(self)
        other._parameters, other._coverage = parameters, self._coverage.at(parameters)
        other._known, other._kept = {}, {}
        return other

    def blocks(self, bound: BoundDataset) -> Iterable[Lookup]:
        """Return every lookup over the kept samples of a dataset."""
        # large datasets are located again each time, as their lookups would fill the memory
        if bound.count > SAMPLES_PER_BLOCK:
            return self._blocks(bound)
        if bound.dataset.name not in self._kept:
            self._kept[bound.dataset.name] = list(self._blocks(bound))
        return self._kept[bound.dataset.name]

    def over(self, bound: BoundDataset, computed: Float) -> list[Lookup]:
        """Locate every lookup over a part of a dataset, given `coordinates` there, Float[coordinates, samples]."""
        known = dict(zip(self._names, computed, strict=True))
        return list(self._located(self._coverage.blocks(bound, known)))

    def of_table(self, bound: BoundDataset, name: str) -> Iterator[Lookup]:
        """Return the lookups of one table over the kept samples of a dataset."""
        for block in self._coverage.blocks(bound, self._known.get(bound.dataset.name)):
            if block.name == name:
                yield _locate(block, self._parameters[name], {})

    def _blocks(self, bound: BoundDataset) -> Iterator[Lookup]:
        return self._located(self._coverage.blocks(bound, self._known.get(bound.dataset.name)))

    def _located(self, blocks: Iterable[LookupBlock]) -> Iterator[Lookup]:
        first, searched = -1, dict[tuple[int, bytes, str], Located]()
        for block in blocks:
            # locations belong to one block of samples
            if block.first != first:
                first, searched = block.first, {}
            yield _locate(block, self._parameters[block.name], searched)


def _reaches(problem: Problem, name: str) -> frozenset[int]:
    graph = problem.graph
    moving = dependents(graph, lambda node: node.parameter == name)
    return frozenset(i for i, name in enumerate(problem.differences) if graph.names[name] in moving)


def _locate(block: LookupBlock, table: Parameter, searched: dict[tuple[int, bytes, str], Located]) -> Lookup:
    """Locate coordinates on their axes; `searched` are the locations of this block, which tables may share."""
    sides = []
    for node, x, axis in zip(block.nodes, block.coordinates, table.index_axes, strict=True):
        # tables on equal axes at the same coordinate share the search
        key = (node, axis.breakpoints.tobytes(), table.extrapolation)
        if key not in searched:
            known = np.isfinite(x)
            # any place will do where a coordinate is not finite: its weight becomes 0
            finite = x if known.all() else np.where(known, x, axis.breakpoints[0])
            place = position(finite, axis.breakpoints, table.extrapolation)
            cell = np.clip(place.astype(np.int64), 0, max(len(axis) - 2, 0))
            searched[key] = known, cell, place - cell
        sides.append(searched[key])
    known_sides, cells, shares = zip(*sides, strict=True)
    return Lookup(table, block.first, np.logical_and.reduce(known_sides), cells, shares)
