"""Training data as a kernel reads them: each column where it is, the rest computed, and the order of visits.

The order in which samples without memory are visited: near ones together, so that they touch the same values.

Samples are sorted within blocks: large enough to hold several of every cell of a usual table, so small that sorting
takes next to no memory.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.graph import Graph
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import LoweredGraph
from kennfeld.graph.node import extract
from kennfeld.graph.partition import GraphPartition
from kennfeld.graph.traversal import dependent
from kennfeld.native import Kernel, Piece, Samples, Simulator
from kennfeld.native.column_table import Order
from kennfeld.parameter_set import ParameterSet
from kennfeld.preprocessing.binding import BoundDataset

__all__ = ["CellNumbering", "TrainingSource", "assemble_samples", "scored_in_order"]

BLOCK = 2**17  # samples
AT_ONCE = 2**13  # samples whose cells are looked for at once, in a cache
FINEST = 2**40  # cells told apart

Columns = Mapping[str, Float]


class CellNumbering:
    """Numbers samples by the cells of all tables whose coordinates the inputs determine."""

    def __init__(self, lowered: LoweredGraph) -> None:
        self._counts = _searched(lowered)
        self._graph = extract(lowered.graph.nodes, (), {str(at): at for at in self._counts}, {}, ())
        self._inputs = {node.payload for node in self._graph.nodes if node.op == "input"}
        self._interpreter = Interpreter(lowered, ParameterSet())

    def numbers(self, columns: Mapping[str, Float], first: int, last: int) -> Int:
        """A number for each sample of a range that is the same within a cell."""
        found = np.zeros(last - first, dtype=np.int64)
        for at in range(first, last, AT_ONCE):
            here = slice(at, min(at + AT_ONCE, last))
            self._number(found[at - first : here.stop - first], {name: columns[name][here] for name in self._inputs})
        return found

    def _number(self, found: Int, columns: Mapping[str, Float]) -> None:
        with np.errstate(all="ignore"):
            places = self._interpreter.run(self._graph.nodes, (), columns)
        cells = 1
        for at, count in self._counts.items():
            cells *= count
            if cells > FINEST:
                break
            cell = np.clip(np.floor(np.nan_to_num(places[self._graph.names[str(at)]])), -1, count - 2)
            found *= count
            found += cell.astype(np.int64) + 1


def _searched(lowered: LoweredGraph) -> dict[int, int]:
    """The positions at which tables are looked up and that no table determines, with the number of their cells."""
    nodes = lowered.graph.nodes
    moving = dependent(lowered.graph, lambda node: node.op == "interpolate")
    return {
        at: lowered.axes[axis.number].size + 2
        for node in nodes
        if node.op == "interpolate"
        for at, axis, smoothed in zip(node.args, node.payload.axes, node.payload.smoothed, strict=True)
        if not smoothed and at not in moving
    }


def scored_in_order(columns: Mapping[str, Float], targets: Sequence[Float], cells: CellNumbering) -> Iterator[Int]:
    """The samples that have a target, block by block, those of a block sorted by cell."""
    count = targets[0].size
    for first in range(0, count, BLOCK):
        last = min(first + BLOCK, count)
        numbers = cells.numbers(columns, first, last)
        numbers *= BLOCK
        numbers += np.arange(last - first)
        numbers = numbers[_scored(targets, first, last)]
        numbers.sort()
        numbers &= BLOCK - 1
        numbers += first
        yield numbers


def _scored(targets: Sequence[Float], first: int, last: int) -> Bool:
    """Which samples of a range have a target."""
    scored = np.zeros(last - first, dtype=bool)
    for target in targets:
        scored |= np.isfinite(target[first:last])
    return scored


@dataclass(frozen=True)
class TrainingSource:
    """A bound dataset, what gives its targets, and the weight of each."""

    bound: BoundDataset
    targets: Sequence[Callable[[], Float]]
    scores: Float  # Float[outputs]


def assemble_samples(
    sources: Sequence[TrainingSource],
    lowered: LoweredGraph,
    split: GraphPartition,
    kernel: Kernel,
    parameters: ParameterSet,
) -> Samples:
    """The samples of all sources, data-only parts computed.

    Without memory, samples without a target are left out and the others visited by cell, so that neighbours touch the
    same values.
    """
    prepare = _preparation(lowered, split, kernel, parameters)
    columns = [source.bound.columns | prepare(source.bound) for source in sources]
    targets = [[target() for target in source.targets] for source in sources]
    if kernel.line.states:
        pieces, order = _in_time(sources), None
    else:
        pieces, order = _by_cell(
            sources, columns, targets, CellNumbering(LoweredGraph(split.graph, lowered.axes, lowered.shapes))
        )
    rows = [[held[name] for held in columns] for name in kernel.layout.inputs]
    return Samples(rows, zip(*targets, strict=True), pieces, order)


def _preparation(
    lowered: LoweredGraph, split: GraphPartition, kernel: Kernel, parameters: ParameterSet
) -> Callable[[BoundDataset], dict[str, Float]]:
    """What computes the columns that depend on the data alone."""
    graph = split.prepared
    names = [name for name in kernel.layout.inputs if name in split.columns]
    if not names:
        return lambda _: {}
    prepared = LoweredGraph(graph, lowered.axes, {name: lowered.shapes[name] for name in _tables(graph)})
    simulator = Simulator(prepared, [graph.names[name] for name in names], parameters)

    def prepare(bound: BoundDataset) -> dict[str, Float]:
        starts = bound.starts.tolist() if graph.states else [0]
        return dict(zip(names, simulator.over(bound.columns, bound.count, parameters, starts), strict=True))

    return prepare


def _tables(graph: Graph) -> set[str]:
    return {node.payload.name for node in graph.nodes if node.op in ("interpolate", "expansion")}


def _in_time(sources: Sequence[TrainingSource]) -> list[Piece]:
    """The pieces of all sources, one after the other."""
    pieces, end = [], 0
    for source in sources:
        edges = [*source.bound.starts.tolist(), source.bound.count]
        pieces += [Piece(end + a, end + b, source.scores) for a, b in pairwise(edges)]
        end += source.bound.count
    return pieces


def _by_cell(
    sources: Sequence[TrainingSource],
    columns: Sequence[Columns],
    targets: Sequence[Sequence[Float]],
    cells: CellNumbering,
) -> tuple[list[Piece], Order | None]:
    """A piece a source, and the order of visits; None where that is how the samples come."""
    total = sum(source.bound.count for source in sources)
    order = np.empty(total, dtype=np.uint32)
    pieces, before, end = [], 0, 0
    for source, held, wanted in zip(sources, columns, targets, strict=True):
        first = end
        for block in scored_in_order(held, wanted, cells):
            order[end : end + block.size] = before + block
            end += block.size
        pieces += [Piece(first, end, source.scores)] if end > first else []
        before += source.bound.count
    straight = end == total and bool(np.all(order[1:] > order[:-1]))
    return pieces, None if straight else order[:end]
