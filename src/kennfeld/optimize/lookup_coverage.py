"""Coordinates, cells and grid points at which a function looks up its tables, over the data."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.graph import Graph
from kennfeld.graph.interpolation import position
from kennfeld.graph.lookup_lowering import LoweredGraph, lower_lookups
from kennfeld.graph.traversal import dependents, with_names
from kennfeld.native.simulator import Simulator
from kennfeld.optimize.problem import Problem, difference
from kennfeld.optimize.quality import SAMPLES_PER_BLOCK, NodeSimulator
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter
from kennfeld.preprocessing.binding import BoundDataset


@dataclass(frozen=True)
class LookupBlock:
    """Coordinates of one lookup over some samples; `first` is the number of the first sample."""

    name: str
    first: int
    coordinates: tuple[Float, ...]


class Coverage:
    """The lookups of some tables; with `of_data_alone`, only those whose coordinates no parameter can change."""

    def __init__(
        self, graph: Graph, parameters: ParameterSet, names: Collection[str], *, of_data_alone: bool = False
    ) -> None:
        lowered = lower_lookups(graph, parameters)
        nodes = lowered.graph.nodes
        self._parameters, self._states = parameters, bool(lowered.graph.states)
        self._lookups = _lookups(lowered, names, of_data_alone)
        places = dict.fromkeys(at for _, places in self._lookups for at in places)
        self._inputs = {at: nodes[at].payload for at in places if nodes[at].op == "input"}
        self._roots = [at for at in places if at not in self._inputs]
        # most axes carry an input as it is, and compiling takes longer than all else here
        self._simulator = Simulator(lowered, self._roots, parameters) if self._roots else None

    def blocks(self, bound: BoundDataset) -> Iterator[LookupBlock]:
        """Yield the coordinates of every lookup, block by block."""
        columns = bound.columns
        for first, last in self._ranges(bound):
            held = {name: values[first:last] for name, values in columns.items()}
            found = {at: held[name] for at, name in self._inputs.items()}
            if self._simulator is not None:
                found |= zip(self._roots, self._simulator.over(held, last - first, self._parameters), strict=True)
            for name, places in self._lookups:
                yield LookupBlock(name, first, tuple(found[at] for at in places))

    def _ranges(self, bound: BoundDataset) -> Iterator[tuple[int, int]]:
        """Yield pieces if there are states, else blocks."""
        firsts = bound.starts.tolist() if self._states else range(0, bound.count, SAMPLES_PER_BLOCK)
        yield from pairwise([*firsts, bound.count])


def _lookups(lowered: LoweredGraph, names: Collection[str], of_data_alone: bool) -> list[tuple[str, tuple[int, ...]]]:
    nodes = lowered.graph.nodes
    moving: Collection[int] = ()
    if of_data_alone:
        moving = dependents(lowered.graph, lambda node: node.op == "interpolate")
    found = []
    for node in nodes:
        if node.op == "interpolate" and node.args and node.payload.name in names:
            places = tuple(nodes[at].args[0] for at in node.args)
            if moving == () or not any(at in moving for at in places):
                found.append((node.payload.name, places))
    return found


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
        table = parameters[block.name]
        mask = seen.setdefault(block.name, np.zeros(table.values.shape, dtype=bool))
        some = counting[block.first : block.first + block.coordinates[0].size]
        _mark(mask, table, [x[some] for x in block.coordinates])
    return seen


def _mark(mask: Bool, table: Parameter, coordinates: list[Float]) -> None:
    sides = []
    known = np.logical_and.reduce([np.isfinite(x) for x in coordinates])
    for x, axis in zip(coordinates, table.index_axes, strict=True):
        place = position(x[known], axis.breakpoints, table.extrapolation)
        last = max(len(axis) - 2, 0)
        cell = np.clip(np.floor(place), 0, last).astype(np.int64)
        sides.append([(cell, place - cell != 1.0), (np.minimum(cell + 1, len(axis) - 1), place != cell)])
    for corner in product(*sides):
        used = np.logical_and.reduce([weighted for _, weighted in corner])
        mask[tuple(cell[used] for cell, _ in corner)] = True


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
        return np.ravel_multi_index(self.cells, cell_shape(self.table))

    def corners(self) -> Iterator[tuple[Int, Float]]:
        """Yield for each corner of the cell the flat grid point number and its weight, of each sample."""
        shape = self.table.values.shape
        sides = [
            ((cell, 1.0 - share), (np.minimum(cell + 1, count - 1), share))
            for cell, share, count in zip(self.cells, self.shares, shape, strict=True)
        ]
        for corner in product(*sides):
            weight = np.prod([weight for _, weight in corner], axis=0)
            yield np.ravel_multi_index([at for at, _ in corner], shape), np.where(self.known, weight, 0.0)


def cell_shape(table: Parameter) -> tuple[int, ...]:
    """Return the number of cells along each axis."""
    return tuple(max(count - 1, 1) for count in table.values.shape)


def coordinates(problem: Problem) -> dict[int, str]:
    """Return the nodes that are lookup coordinates but not inputs, with hidden names."""
    graph = problem.graph
    places = dict.fromkeys(at for node in graph.nodes if node.op == "lookup" for at in node.args)
    return {at: f"\0at {at}" for at in places if graph.nodes[at].op != "input"}


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
        self._lookups = [
            (node.payload, node.args) for node in graph.nodes if node.op == "lookup" and self.reached.get(node.payload)
        ]
        self._inputs = {
            at: graph.nodes[at].payload for _, args in self._lookups for at in args if graph.nodes[at].op == "input"
        }
        self._computed = coordinates(problem)
        self._values = dict(zip((d.name for d in problem.datasets), computed, strict=False))
        self._nodes: NodeSimulator | None = None
        if self._computed and not computed:
            self._nodes = NodeSimulator(with_names(graph, self._computed), parameters, list(self._computed.values()))
        self._kept: dict[str, list[Lookup]] = {}

    def blocks(self, bound: BoundDataset) -> Iterable[Lookup]:
        """Return every lookup over the kept samples of a dataset."""
        if bound.count > SAMPLES_PER_BLOCK:
            return self._blocks(bound)
        if bound.dataset.name not in self._kept:
            self._kept[bound.dataset.name] = list(self._blocks(bound))
        return self._kept[bound.dataset.name]

    def _blocks(self, bound: BoundDataset) -> Iterator[Lookup]:
        inputs = bound.columns
        for here, values in self._coordinates(bound):
            columns = {at: inputs[name][here] for at, name in self._inputs.items()}
            columns |= zip(self._computed, values, strict=True)
            searched: dict[tuple[int, bytes, str], tuple[Bool, Int, Float]] = {}
            for name, args in self._lookups:
                yield self._locate(self._parameters[name], here.start, args, columns, searched)

    def _coordinates(self, bound: BoundDataset) -> Iterator[tuple[slice, Float]]:
        """Yield the computed coordinates, Float[coordinates, samples], block by block."""
        known = self._values.get(bound.dataset.name)
        if known is None and self._nodes is not None:
            yield from self._nodes.blocks(bound, self._parameters)
            return
        for first in range(0, bound.count, SAMPLES_PER_BLOCK):
            here = slice(first, min(first + SAMPLES_PER_BLOCK, bound.count))
            yield here, np.zeros((0, bound.count)) if known is None else known[:, here]

    def _locate(
        self,
        table: Parameter,
        first: int,
        args: tuple[int, ...],
        columns: dict[int, Float],
        searched: dict[tuple[int, bytes, str], tuple[Bool, Int, Float]],
    ) -> Lookup:
        sides = []
        for at, axis in zip(args, table.index_axes, strict=True):
            key = (at, axis.breakpoints.tobytes(), table.extrapolation)
            if key not in searched:
                searched[key] = _place(columns[at], axis.breakpoints, table)
            sides.append(searched[key])
        known = np.logical_and.reduce([side[0] for side in sides])
        return Lookup(table, first, known, tuple(side[1] for side in sides), tuple(side[2] for side in sides))


def _reaches(problem: Problem, name: str) -> frozenset[int]:
    """Return the numbers of the criteria that depend on a table."""
    graph = problem.graph
    moving = dependents(graph, lambda node: node.op == "lookup" and node.payload == name)
    return frozenset(i for i in range(len(problem.criteria)) if graph.names[difference(i)] in moving)


def _place(x: Float, breakpoints: Float, table: Parameter) -> tuple[Bool, Int, Float]:
    """Return where the coordinate is finite, its cell, and its position in the cell from 0 to 1."""
    known = np.isfinite(x)
    place = position(np.where(known, x, breakpoints[0]), breakpoints, table.extrapolation)
    cell = np.clip(np.floor(place), 0, max(breakpoints.size - 2, 0)).astype(np.int64)
    return known, cell, place - cell
