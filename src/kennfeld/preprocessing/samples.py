"""Training samples as a kernel reads them: columns, pieces, and the order in which samples are visited.

Columns that depend on data alone are computed once. Samples of models without memory are sorted by table cell, so that
neighbouring samples use the same values. They are sorted within blocks, which hold several samples of every cell of a
usual table but need little memory.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import map_in_order
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lookup_lowering import LoweredGraph
from kennfeld.graph.node import extract
from kennfeld.graph.partition import GraphPartition
from kennfeld.graph.traversal import dependents
from kennfeld.native.column_table import Order
from kennfeld.native.kernel import Kernel
from kennfeld.native.samples import Piece, Samples
from kennfeld.native.simulator import Simulator
from kennfeld.preprocessing.binding import BoundDataset

SAMPLES_PER_BLOCK = 2**17  # samples
SAMPLES_PER_LOOKUP = 2**13  # samples whose cells are computed at once, within the cache
MAX_CELLS = 2**40  # times SAMPLES_PER_BLOCK, fits into 63 bits

Columns = Mapping[str, Float]


class CellNumbering:
    """Numbering of samples by the cells of all tables whose coordinates depend on inputs alone."""

    def __init__(self, lowered: LoweredGraph) -> None:
        self._counts = _data_coordinates(lowered)
        self._graph = extract(lowered.graph.nodes, (), {str(at): at for at in self._counts}, {}, ())
        self._inputs = {node.payload for node in self._graph.nodes if node.op == "input"}
        self._interpreter = Interpreter(lowered, ParameterSet())

    def numbers(self, columns: Mapping[str, Float], first: int, last: int) -> Int:
        """Number the samples of a range by their cells, Int[last - first]."""
        numbers = np.zeros(last - first, dtype=np.int64)
        for begin in range(first, last, SAMPLES_PER_LOOKUP):
            part = slice(begin, min(begin + SAMPLES_PER_LOOKUP, last))
            inputs = {name: columns[name][part] for name in self._inputs}
            self._number(numbers[begin - first : part.stop - first], inputs)
        return numbers

    def _number(self, numbers: Int, columns: Mapping[str, Float]) -> None:
        with np.errstate(all="ignore"):
            positions = self._interpreter.run(self._graph.nodes, (), columns)
        # a number in mixed radix, one digit for each axis; beyond either end of an axis is a cell of its own
        cells = 1
        for at, count in self._counts.items():
            cells *= count
            if cells > MAX_CELLS:
                break
            cell = np.clip(np.floor(np.nan_to_num(positions[self._graph.names[str(at)]])), -1, count - 2)
            numbers *= count
            numbers += cell.astype(np.int64) + 1


def _data_coordinates(lowered: LoweredGraph) -> dict[int, int]:
    """Return the table coordinates that do not depend on other tables, each with its number of cells."""
    nodes = lowered.graph.nodes
    moving = dependents(lowered.graph, lambda node: node.op in ("interpolate", "dense"))
    return {
        at: lowered.axes[axis.number].size + 2
        for node in nodes
        if node.op == "interpolate"
        for at, axis, smoothed in zip(node.args, node.payload.axes, node.payload.smoothed, strict=True)
        if not smoothed and at not in moving
    }


def scored_in_order(columns: Mapping[str, Float], targets: Sequence[Float], cells: CellNumbering) -> Iterator[Int]:
    """Sort the samples that have a target by cell, block by block."""
    count = targets[0].size

    def sort_block(first: int) -> Int:
        last = min(first + SAMPLES_PER_BLOCK, count)
        numbers = cells.numbers(columns, first, last)
        # (cell, sample) in one integer: sorted in place, the lower bits are the order, without a second array
        numbers *= SAMPLES_PER_BLOCK
        numbers += np.arange(last - first)
        numbers = numbers[np.any([np.isfinite(target[first:last]) for target in targets], axis=0)]
        numbers.sort()
        numbers &= SAMPLES_PER_BLOCK - 1
        numbers += first
        return numbers

    return map_in_order(sort_block, range(0, count, SAMPLES_PER_BLOCK))


@dataclass(frozen=True)
class TrainingSource:
    """A bound dataset, the functions that return its targets, and the weight of each target."""

    bound: BoundDataset
    targets: Sequence[Callable[[], Float]]
    scores: Float  # Float[outputs]


class SampleAssembly:
    """Assembly of the samples of a kernel, with the columns that depend on data alone.

    Args:
        lowered: the graph with its lookups lowered.
        split: its parts.
        kernel: of the part that depends on free values.
        parameters: those of the shapes and axes that count.
    """

    def __init__(self, lowered: LoweredGraph, split: GraphPartition, kernel: Kernel, parameters: ParameterSet) -> None:
        self._lowered, self._split, self._inputs = lowered, split, tuple(kernel.layout.inputs)
        self._prepared = [name for name in self._inputs if name in split.columns]
        self._simulator = self._compiled(parameters) if self._prepared else None

    def _compiled(self, parameters: ParameterSet) -> Simulator:
        graph, shapes = self._split.prepared, self._lowered.shapes
        tables = {node.payload.name for node in graph.nodes if node.op in ("interpolate", "expansion", "dense")}
        prepared = LoweredGraph(graph, self._lowered.axes, {name: shapes[name] for name in tables})
        return Simulator(prepared, [graph.names[name] for name in self._prepared], parameters)

    @cached_property
    def _cells(self) -> CellNumbering:
        return CellNumbering(LoweredGraph(self._split.graph, self._lowered.axes, self._lowered.shapes))

    def samples(self, sources: Sequence[TrainingSource], parameters: ParameterSet, *, in_time: bool) -> Samples:
        """Return the samples of all sources, given the values of the parameters that are not fitted.

        Unless all are visited in the order of time, samples without a target are dropped, and the others visited by
        cell.
        """
        columns = [source.bound.columns | self._prepare(source.bound, parameters) for source in sources]
        targets = [[target() for target in source.targets] for source in sources]
        pieces: list[Piece] = []
        order, end = None, 0
        if in_time:
            for source in sources:
                edges = [*source.bound.starts.tolist(), source.bound.count]
                pieces += [Piece(end + a, end + b, source.scores) for a, b in pairwise(edges)]
                end += source.bound.count
        else:
            pieces, order = _by_cell(sources, columns, targets, self._cells)
        rows = [[source[name] for source in columns] for name in self._inputs]
        return Samples(rows, zip(*targets, strict=True), pieces, order)

    def _prepare(self, bound: BoundDataset, parameters: ParameterSet) -> dict[str, Float]:
        """Return the columns that depend on data alone."""
        if self._simulator is None:
            return {}
        starts = bound.starts.tolist() if self._split.prepared.states else [0]
        prepared = self._simulator.over(bound.columns, bound.count, parameters, starts)
        return dict(zip(self._prepared, prepared, strict=True))


def _by_cell(
    sources: Sequence[TrainingSource],
    columns: Sequence[Columns],
    targets: Sequence[Sequence[Float]],
    cells: CellNumbering,
) -> tuple[list[Piece], Order | None]:
    """Return one piece per source, and the order of visits; None if it is the order of the samples."""
    total = sum(source.bound.count for source in sources)
    order = np.empty(total, dtype=np.uint32)
    pieces, before, end = [], 0, 0
    for source, own_columns, own_targets in zip(sources, columns, targets, strict=True):
        first = end
        for block in scored_in_order(own_columns, own_targets, cells):
            order[end : end + block.size] = before + block
            end += block.size
        pieces += [Piece(first, end, source.scores)] if end > first else []
        before += source.bound.count
    # an order that is that of the samples would only cost an indirection in the kernel
    straight = end == total and bool(np.all(order[1:] > order[:-1]))
    return pieces, None if straight else order[:end]
